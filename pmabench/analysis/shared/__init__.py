"""What reductions share: trials sorted, lines fitted, and what instruments do to a result.

- `cells` (trials by operating point), `reference` (trials of reference and what drifted)
- `samples` (noise, unusable ones, time), `onset` (when something begins)
- `repeats` (trials of one operating point over each other), `motion` (whether anything moved)
- `lines` (weighted lines and their intervals), `student` (quantiles, means with half widths)
- `sessions` (which tests are of one session)
- `isometric_lines` (F over P at a contraction), `ramp_loop`, `turns`, `sine_loop` (loops of a driven end),
  `oscillation` (swings of a signal), `simulated`, `replay` (a model run next to a trial)
- `rest` (values of trials at rest), `form` (whether trials follow the form of a value)
- `calibration` (what the channels' uncertainties do to a result), `skew` (what clocks apart do)
"""
