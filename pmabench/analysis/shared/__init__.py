"""What reductions share: trials sorted, lines fitted, and what instruments do to a result.

- `trials` (by operating point, repeats, references, sessions), `samples` of one trial (noise, motion, onset, rest)
- `lines` (weighted lines and their intervals, least squares where one number is tried at many values), `student`
  (quantiles, means with half widths)
- `isometric_lines` (F over P at a contraction), `ramp_loop` (loops of a driven end, or of a joint), `sine_loop`,
  `signals` (spikes, noise and the filter of a sensor off a signal; its peaks and swings), `response` (one step of a
  set-point), `simulated` (a model run next to a trial)
- `joint` (what sweeps and locked torques of a joint share: turns, play, commands that are not kept)
- `form` (whether trials follow the form of a value), `calibration` (what the channels' uncertainties do to a result),
  `skew` (what clocks apart do), `turn_times` (whether motion and force turn at one moment)
"""
