"""Quantiles of Student's t, without `scipy.stats`: its import takes longer than most reductions."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtrit

from pmabench.store.records import Array


def ppf(share: float, freedom: float | Array) -> Array:
    """Value below which t of `freedom` degrees [1] stays with probability `share` [1]; NaN without a degree.

    As `scipy.stats.t.ppf`; same shape as `freedom`.

    >>> round(float(ppf(0.975, 4)), 3)
    2.776
    """
    return np.asarray(stdtrit(freedom, share), dtype=np.float64)
