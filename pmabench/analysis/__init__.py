"""From trials to coefficients: segmentation, fits, uncertainty, tuning rules; pure functions over loaded runs.

`kinds.py` is the table: kind of run -> the module whose `reduce(runs, options)` makes the `Analysis` (`results.py`),
and where its other parts are; `reduce.py` calls them.
`declared` is what a reduction says that it can give: title, unit, headline.
`many` reduces many runs at once, `cluster` does so on a Dask cluster. Each folder says what its modules are:

- kinds of test: `contraction`, `driven` (the free end is moved: ramps, steps, sines), `loops` (ultimate gain,
  positioning, tuning rules, validation), `statics` (at rest: static load, free contraction, isometric, closed volume,
  arm angle), `recorded` (files of other programs)
- a library model fitted to a table: `fitting`
- what speaks for or against a result, and results beside each other: `verdict`
- what all of these share: `shared`
"""
