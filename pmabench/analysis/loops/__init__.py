"""Closed loops: ultimate gain and period, controller settings, positioning, and the model that a plan carries.

- ultimate-gain: `ultimate_gain`, made of `gain_levels`, `oscillation` (rising gain), `relay_gain`, `relay_levels`
  (relay), `open_loop_gain`, `open_loop`, `open_loop_fit` (steps without a loop), `model_gain` (a campaign of
  contractions), `gain_ways` (the ways against each other), on `gain_cell`
- controller settings: `tuning`, `simc`
- positioning: `positioning`, made of `position_response`; validation: `validation`; both beside `simulated`, the model
  that a plan carries
"""
