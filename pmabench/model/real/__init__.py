"""A realistic muscle: nonlinear stiffness, hysteresis over contraction and pressure, creep; free and driven end.

`muscle` has the parameters and the force, `plants` the simulation with a driven end and with a load.
"""
