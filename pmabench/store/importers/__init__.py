"""Other programs' files to runs: a map says what a file means, nothing is guessed, nothing is mended.

- `map_file`: a map as people write it; `map_rules`: the same in SI; `questions`: what it leaves open
- `table`: the columns of one file, read in another process (`warm`, `child`), on disk where they are many (`spool`)
- `prepare`: one file scaled, checked and cut into trials, in parts where it has many rows (`long`)
- checks: `quality` and `outliers` of one channel; `plausible` runs those of several, `frozen`, `lag`, `magnitude`,
  `midfile`; `order`, `units`; `siblings` compares files; `effect`: what samples change, `found`: a finding
- cuts: `segments`, by what `motion` finds in a signal; `commanded` reads commands off columns
- `importing` writes the runs; `guess` proposes a map
"""
