"""Converts other programs' files to runs: a map defines their meaning; nothing is guessed, nothing is repaired.

- `map_file`: a map as the user writes it, its units and open questions; `map_rules`: the same in SI
- `table`: the columns of one file, read in separate processes (`apart`)
- `prepare`: reads, scales and checks one file, a long one in parts (`long`); `importing`: makes the runs
- checks: `quality` of one channel; `plausible` of several against each other, with `magnitude`, `scales` and `midfile`;
  `importing` compares files; `found`: a finding
- `segments` cuts a file into trials, by the steps, ramps and sines that `motion` finds; `commands` names them
- `guess`: proposes a map for unknown files
"""
