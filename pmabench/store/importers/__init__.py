"""Other programs' files to runs: a map says what a file means, nothing is guessed, nothing is mended.

- `map_file`: a map as people write it, its units and open questions; `map_rules`: the same in SI
- `table`: the columns of one file, read in processes of their own (`apart`)
- `prepare`: one file read, scaled and checked, in parts where it is long (`long`); `importing`: the runs
- checks: `quality` of one channel; `plausible` of several against each other, with `magnitude` and `midfile`;
  `importing` compares files; `found`: a finding, and what its samples change
- `segments` cuts into trials, by the steps, ramps and sines that `motion` finds; `commands` names them
- `guess`: a proposed map for files that were never seen
"""
