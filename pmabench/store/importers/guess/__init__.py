"""A proposed map for files that were never seen.

- `guess`: the whole; `look`: one file; `layout` of text; `columns`, `signs`, `clock`: what they are
- `asked`: questions; `write`: the map as YAML
"""
