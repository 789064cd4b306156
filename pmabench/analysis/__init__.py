"""From trials to coefficients: segmentation, fits, uncertainty, tuning rules; pure functions over loaded runs.

`reduce.py` is the table: kind of run -> the module whose `reduce(runs, options)` makes the `Analysis` (`results.py`).

- contraction-relaxation: `contraction`, made of `campaign`, `segments`, `pooled`, `replay`, `intervals`, `drift`,
  `contraction_values`; the papers' way and the dead times are in `contraction_steps`, `steps`, `onset`; words and
  figures in `contraction_view`; where asked for: chosen forms over pressure in `contraction_joint`, `joint`, `forms`,
  draws over trials in `bootstrap`, the regulator in `regulator_response`
- the same by paper 1: `contraction_paper1`, made of `contraction_paper1_steps` and `contraction_known_force`; model
  against test in `contraction_paper1_view`
- static-load: `static_load`
- isobaric-ramp: `isobaric`, made of `isobaric_cell`, `ramp_loop`, `turns` (where branches turn into each other),
  `rubber`; step-displacement: `step_displacement`, made of `step_relaxation`
- sinusoidal-displacement: `sine`, made of `sine_loop`, `sine_fit`, `sine_mean`, `sine_pressure`,
  `sine_traces`
- ultimate-gain: `ultimate_gain`, made of `gain_levels`, `oscillation` (rising gain), `relay_gain`, `relay_levels`,
  `open_loop_gain`, `open_loop`, `open_loop_fit` (steps without a loop), `gain_ways` (the ways against each other);
  controller settings in `tuning`, `simc`
- positioning: `positioning`, made of `position_response`; validation: `validation`; both beside `simulated`, the model
  that a plan carries
- isometric-pressurisation: `isometric_pressurisation`, made of `isometric_lines`, `isometric_curve`, `section` (S over
  contraction), `isometric_sections` (all contractions at one pressure); words and figures in `isometric_view`
- closed-volume: `closed_volume`, made of `closed_stroke`, `volume_fit`
- free-contraction: `free_contraction`; arm-angle: `arm_angle`, on `arm_stairs`; words and figures in `..._view`
- isometric, recorded-pull: `isometric`, on `isometric_lines`; recorded-step: `recorded_steps`, with `driven_motion`;
  recorded-sine: `recorded_sines`; what imports say beside their samples: `imported`
- a library model fitted to a table (`model fit`): `model_fit`, made of `model_problem`, `identifiability`
- two analyses coefficient by coefficient (`compare`): `comparison`; a specimen over its runs (`history`): `life`,
  `control_chart`
- what speaks for a result beside its residual: `checks`, `contraction_checks`; limits of a protocol: `acceptance`
- many runs at once: `many`; the same on a Dask cluster: `cluster`
- what recalibration changed: `changes`; independent tests of one specimen against each other: `agreement`
- shared: `cells` (trials by operating point), `curves` (regressions on pressure), `lines` (weighted lines and their
  intervals), `student` (quantiles), `calibration` (what the channels' uncertainties do to a result), `skew` (what
  clocks apart do), `reference` (trials of reference and what drifted)
"""
