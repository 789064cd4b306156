"""The muscle as it is: bent stiffness, hysteresis over contraction and pressure, creep; free end and driven end.

`muscle` is its parameters and what they mean, `stops` the hysteresis along a path, `creep` the creep along a path,
`driven` the driven end, `free` a load on the free end.
"""
