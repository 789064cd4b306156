"""A muscle as it is: force over contraction and pressure as a smooth surface, with hysteresis, damping and creep.

- `record`: one slow trial as arrays; `trials`: how they come from a trial of a run
- `columns`: what each term makes of the past of a trial; `muscle`: the terms, and what a fitted muscle does
- `fit`: bounded least squares of all trials
- `choice`: which terms the data need, by trials that are left out; `spread`: how well a value is known
- `replay`: measured trials next to a fitted muscle and to straight lines
"""
