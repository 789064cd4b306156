"""Proposes a map for files that were never seen: every choice with its reason, and nothing is written to a run.

- `guess`: the whole; `layout` of text; `signs`: which kind of test it shows; `proposal`: what was found
- `columns`: what they are, by names and units, and by their `shapes`; which is the time
- `asked`: questions; `write`: the map as YAML
"""
