"""Proposes a map for unknown files, with a reason for every choice; writes no run.

- `guess`: the whole; `layout` of text; `signs`: the kind of test; `proposal`: the data of a guess
- `columns`: roles of columns, by names and units, and by `shapes` of their numbers; choice of the time
- `asked`: questions; `write`: the map as YAML
"""
