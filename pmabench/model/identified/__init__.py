"""A muscle as the surface of an analysis describes it: force over pressure and contraction, hysteresis, damping, creep.

- `muscle`: its numbers as plain data, and what they mean at a place
- `plant`: the same along a path, with what the muscle remembers, and a load on its free end, in time; the pressure that
  a wanted contraction needs
- `library`: the muscle among the models that `pmabench model` shows and evaluates

The fit is `pmabench.analysis.surface`. Nothing here knows the simulated muscles that a fit is tried on.
"""
