"""Least squares where one number of the form is tried at many values: variable projection (Golub and Pereyra 1973).

Knows columns and rows; no test.
"""

from __future__ import annotations

import numpy as np

from pmabench.store.records import Array

ALIKE = 1e-12
"""Columns that differ by less than the root of this share of their size are taken for one."""
AT_ONCE = 30_000
"""Numbers that are worked on at once: more than the processor's cache holds takes longer."""


def left_by(fixed: Array, tried: Array, y: Array) -> Array:
    """Sum of squares that least squares leaves of y, shape (n,), for each set of columns: shape (k,).

    `fixed`, shape (p, n), are the columns of every set, `tried`, shape (k, m, n), those that differ from set to set.
    """
    basis, _ = np.linalg.qr(fixed.T)
    y = y - basis @ (basis.T @ y)
    share = max(1, AT_ONCE // tried[0].size)
    return np.concatenate([_left(basis, tried[i : i + share], y) for i in range(0, len(tried), share)])


def _left(basis: Array, tried: Array, y: Array) -> Array:
    tried = tried - (tried @ basis) @ basis.T
    products = tried @ tried.transpose(0, 2, 1)
    size = np.sqrt(np.diagonal(products, axis1=1, axis2=2))
    size = np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(products / (size[:, :, None] * size[:, None, :]), ALIKE, hermitian=True)
    terms = (inverse @ (tried @ y / size)[:, :, None])[:, :, 0] / size
    rest = y - (terms[:, None] @ tried)[:, 0]
    return np.asarray(np.sum(rest**2, axis=1))
