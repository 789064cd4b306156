"""Proposes a map for files that were never seen: every choice with its reason, and nothing is written to a run."""
