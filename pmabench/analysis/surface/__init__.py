"""Model of a muscle: force as a smooth surface over contraction and pressure, with hysteresis, damping and creep.

- `trials`: one slow trial as arrays, from a trial of a run
- `muscle`: the terms, their memory of the past of a trial, and the fitted muscle
- `fit`: bounded least squares of all trials, choice of terms by cross-validation, and intervals of values
"""
