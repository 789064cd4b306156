"""The muscle as it is: bent stiffness, hysteresis over contraction and pressure, creep; free end and driven end.

`muscle` is its parameters and what they mean, `plants` the muscle along a path, at a driven end and with a load.
"""
