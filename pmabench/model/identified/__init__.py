"""A muscle identified by an analysis of kind surface: force over pressure and contraction, hysteresis, damping, creep.

- `muscle`: its parameters as plain data, and their values at an operating point
- `plant`: the muscle along a path, with its memory; its free end with a load, over time; the pressure for a wanted
contraction
- `library`: the muscle among the models that `pmabench model` shows and evaluates

The fit is `pmabench.analysis.surface`. Nothing here knows the simulated muscles that test the fit.
"""
