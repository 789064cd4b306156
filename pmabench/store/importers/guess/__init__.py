"""Proposes a map for files that were never seen: every choice with its reason, and nothing is written to a run.

- `guess`: the whole; `layout` of text; `columns`: what they are; `signs`: which kind of test they show
- `asked`: questions; `write`: the map as YAML
"""
