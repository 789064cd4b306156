"""A muscle as it is: force over contraction and pressure as a smooth surface, with hysteresis, damping and creep.

- `trials`: one slow trial as arrays, and how they come from a trial of a run
- `muscle`: the terms, what each makes of the past of a trial, and what a fitted muscle does
- `fit`: bounded least squares of all trials
- `choice`: which terms the data need, by trials that are left out, and how well a value is known
- `replay`: measured trials next to a fitted muscle and to straight lines
"""
