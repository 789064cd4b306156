"""The straight form by plain least squares, to compare with: F = F_ce(P) - K(P) x - B(P, sign v) v - F_c sign v."""

import numpy as np


def _hats(P, knots):
    return np.column_stack([np.interp(P, knots, row) for row in np.eye(len(knots))])


def _columns(P, x, v, knots):
    hats = _hats(P, knots)
    ends = _hats(P, knots[[0, -1]])
    return np.column_stack(
        [hats, -hats * x[:, None], -ends * np.maximum(v, 0)[:, None], -ends * np.minimum(v, 0)[:, None], -np.sign(v)]
    )


def straight_form(records, others, step=50e3):
    """Force [N] that it predicts along the rows of `others`, fitted to those of `records`, polygons each `step` [Pa]."""
    P, x, v, F = (np.concatenate([getattr(r, name)[r.used] for r in records]) for name in ("P", "x", "v", "F"))
    knots = np.arange(P.min(), P.max() + step, step)
    weights = np.linalg.lstsq(_columns(P, x, v, knots), F, rcond=1e-8)[0]
    return [_columns(r.P, r.x, r.v, knots) @ weights for r in others]
