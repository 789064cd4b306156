"""Proposes a map for files that were never seen: every choice with its reason, and nothing is written to a run.

- `guess` looks at files, `record` is what it finds out; `look`: one file, with the `layout` of text and the `clock`
- `columns`: what each column is; `signs`: which kind of test a file shows; `names`: what its name contains
- `exported`: files that this program exported; `asked`: questions; `write`, `written_time`, `spell`: the map as YAML
"""
