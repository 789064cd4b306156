"""Kinds of test: one folder for each, with its record `KIND`, its protocol, reduction and live display.

- `registry` finds them; `compile` makes plans of protocol files, one or several, `reduce` analyses of runs
- muscles that lift weights: `static_load`, `contraction_relaxation`, `validation`
- the free end is moved: `isobaric_ramp`, `step_displacement`, `sinusoidal_displacement`, `closed_volume`,
  `relaxation`
- two muscles against each other: `joint_sweep`, `joint_torque`; in closed loop `joint_step`
- three muscles that tilt a platform: `platform_step`
- at rest: `isometric_pressurisation`, `free_contraction`, `arm_angle`
- in closed loop: `ultimate_gain`, `positioning`
- all slow tests of a muscle together: `surface`
- files of other programs: `isometric`, `recorded_step`, `recorded_sine`
"""
