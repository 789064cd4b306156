"""Proposes a map for unknown files, with a reason for every choice; writes no run.

- `guess`: the whole; `layout` of text; `signs`: the kind of test
- `columns`: the data of a guess; roles of columns, by names and units; choice of the time
- `asked`: questions; `write`: the map as YAML
"""
