"""Tests whose free end is moved by an actuator: isobaric ramps, steps and sines of displacement.

- isobaric-ramp: `isobaric`, made of `isobaric_cell`, `ramp_loop`, `turns` (where branches turn into each other),
  `rubber`
- step-displacement: `step_displacement`, made of `step_relaxation`
- sinusoidal-displacement: `sine`, made of `sine_loop`, `sine_fit`, `sine_lines`, `sine_mean`, `sine_form` (whether the
  harmonics allow a straight line), `sine_pressure`, `sine_traces`, `sine_work`
"""
