"""Analyses as files: `results` is the record of what was found; `folder` writes and reads it, and what made it.

By that it decides whether analyses of the last time can be used again.
"""
