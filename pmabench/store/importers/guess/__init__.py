"""Proposes a map for files that were never seen: every choice with its reason, and nothing is written to a run.

- `guess`: the whole; `look`: one file; `layout` of text; `columns`, `signs`, `clock`: what they are
- `asked`: questions; `write`: the map as YAML
"""
