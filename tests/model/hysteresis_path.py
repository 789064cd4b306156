"""The hysteresis of Dahl along a path of contractions, point by point: what the closed forms are compared with."""

import numpy as np


def hysteresis_path(contraction, height, width, start=0.0):
    """F_h [N] along contractions [1], shape (n,), from F_h = `start` [N] on; between two points it is monotone."""
    force = np.empty(len(contraction))
    last, at = start, float(contraction[0])
    for index, eps in enumerate(np.asarray(contraction, dtype=np.float64).tolist()):
        end = -float(np.sign(eps - at)) * height
        last = end + (last - end) * float(np.exp(-abs(eps - at) / width)) if eps != at else last
        force[index], at = last, eps
    return force
