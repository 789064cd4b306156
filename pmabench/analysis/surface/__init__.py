"""A muscle as it is: force over contraction and pressure as a smooth surface, with hysteresis, damping and creep.

- `record`: one slow trial as arrays
- `columns`: what each term makes of a trial's past
- `fit`: bounded least squares of all trials, and the muscle that comes out
- `choice`: which terms the data need, by trials that are left out
"""
