"""What speaks for the pooled fit beside its residual: loads left out, the other direction, friction.

Every check is a least squares on the segments that the fit has already; no trial is read again.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.verdict.checks import Check
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.intervals import Pooled
from pmabench.kinds.contraction_relaxation.pooled import prior_of
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.store.records import Array

FEWEST = 3
"""Fewest loads for one to be left out: two others tell F_ce from K."""
ENOUGH = 20
"""Fewest segments of a load or a direction."""
WORSE = 2.0
"""Residual of what was left out, by that of the fit, from which on the fit does not carry over ..."""
NOTABLE = 0.01
"""... where it is more than this share of the largest load."""


def checks(campaign: Campaign, pooled: Pooled) -> list[dict[str, Any]]:
    """Held-out loads, the other direction, friction by sign of the velocity; as `Analysis.facts` holds checks."""
    segments = pooled.segments
    size = float(np.max(np.abs(segments.force)))
    found = [
        _held_out(campaign, pooled, size),
        _other_direction(pooled, size),
        _friction(pooled, size),
    ]
    return [asdict(check) for check in found if check is not None]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _level(error: float, residual: float, size: float) -> str:
    return "doubt" if error > WORSE * residual and error > NOTABLE * size else "note"


def _held_out(campaign: Campaign, pooled: Pooled, size: float) -> Check | None:
    """Each load predicted by a fit to all others, where these tell what it will be; the worst of them counts.

    The error is the rms of the residuals of the segments whose prediction is as sure as one segment is.
    """
    segments, fit = pooled.segments, pooled.fit
    loads = np.array([round(samples.load, 2) for samples in campaign.samples])[segments.trial]
    prior = prior_of(segments, fit.design, fit.knots, pooled.expected)
    normal = fit.design.T @ fit.design + prior.T @ prior
    right = fit.design.T @ segments.force
    errors: dict[float, float] = {}
    for load in np.unique(loads) if len(np.unique(loads)) >= FEWEST else ():
        design, force = fit.design[loads == load], segments.force[loads == load]
        inverse = _inverse(normal - design.T @ design)
        theta = inverse @ (right - design.T @ force)
        sure = _variance(design, inverse) <= 1.0
        if sure.sum() >= ENOUGH:
            errors[float(load)] = _rms(force[sure] - design[sure] @ theta)
    if not errors:
        return None
    worst = max(errors, key=lambda load: errors[load])
    text = (
        f"loads predicted by a fit to all others, {len(errors)} of {len(np.unique(loads))}: within "
        f"{show(errors[worst], 'force', 2)} rms, worst at {show(worst, 'force', 4)}, "
        f"{100 * errors[worst] / size:.2g} % of the largest; "
        f"the residual of the fit to all is {show(fit.rms, 'force', 2)}"
    )
    level = _level(errors[worst], fit.rms, size)
    if level == "doubt":
        text += ": the fit does not carry over to other loads"
    return Check("held_out", errors[worst] / size, "ratio", level, text)


def _other_direction(pooled: Pooled, size: float) -> Check | None:
    """Relaxation with K and F_ce of a fit to contraction alone: only B_r and friction are fitted to it.

    One direction cannot tell F_c from F_ce: twice F_c is between them, and one constant stands for it here.
    """
    segments, fit = pooled.segments, pooled.fit
    k = len(fit.knots)
    both, theirs, own = slice(0, 2 * k), slice(0, 3 * k), np.r_[3 * k : 4 * k, 4 * k]
    up, down = segments.way > 0, segments.way < 0
    if min(up.sum(), down.sum()) < ENOUGH:
        return None
    prior = prior_of(segments, fit.design, fit.knots, pooled.expected)
    design = fit.design[up, theirs]
    inverse = _inverse(design.T @ design + prior[:, theirs].T @ prior[:, theirs])
    alone = inverse @ (design.T @ segments.force[up])
    rows = np.flatnonzero(down)
    rows = rows[_variance(fit.design[rows, both], inverse[both, both]) <= 1.0]
    if len(rows) < ENOUGH:
        return None
    target = segments.force[rows] - fit.design[rows, both] @ alone[both]
    design = fit.design[np.ix_(rows, own)]
    free = _solved(design, target, prior[:, own])
    error = _rms(target - design @ free)
    level = _level(error, fit.rms, size)
    text = (
        f"relaxation with K and F_ce of contraction alone: missed by {show(error, 'force', 2)} rms, "
        f"{100 * error / size:.2g} % of the largest load; "
        f"the residual of the fit to both is {show(fit.rms, 'force', 2)}"
    )
    if level == "doubt":
        text += ": the two directions do not have one K and F_ce, as with hysteresis they have not"
    return Check("other_direction", error / size, "ratio", level, text)


def _inverse(normal: Array) -> Array:
    """Inverse of a normal matrix, scaled to its diagonal first."""
    scale = np.sqrt(np.diag(normal))
    return np.asarray(np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale))


def _variance(design: Array, inverse: Array) -> Array:
    """Variance of a prediction by that of one segment; shape (n,)."""
    return np.asarray(np.sum(design @ inverse * design, axis=1))


def _solved(design: Array, target: Array, prior: Array) -> Array:
    both = np.vstack([design, prior])
    return np.asarray(np.linalg.lstsq(both, np.concatenate((target, np.zeros(len(prior)))), rcond=None)[0])


def _friction(pooled: Pooled, size: float) -> Check | None:
    """Residual by the sign of the velocity: without the Coulomb term, and what is left of it with it."""
    segments, fit = pooled.segments, pooled.fit
    if not fit.friction:
        return None
    design = fit.design[:, :-1]
    prior = prior_of(segments, fit.design, fit.knots, pooled.expected)[:, :-1]
    theta = _solved(design, segments.force, prior)
    without = _rms(segments.force - design @ theta)
    left = max(abs(float(fit.residual[rows].mean())) for rows in _groups(segments))
    needed = without > WORSE * fit.rms
    doubt = left > max(WORSE * fit.rms, NOTABLE * size)
    seen = "is seen in the data" if needed else "is hardly seen in the data"
    text = (
        f"friction {seen}: without F_c the residual is {show(without, 'force', 2)} rms instead of "
        f"{show(fit.rms, 'force', 2)}; with it, the mean residual by direction and speed is at most "
        f"{show(left, 'force', 2)}"
    )
    if doubt:
        text += ": it depends on speed in a way that the model does not have"
    return Check("friction", left / size, "ratio", "doubt" if doubt else "note", text)


def _groups(segments: Segments) -> list[NDArray[np.bool_]]:
    """Segments by direction, slower and faster half of each."""
    speed = np.abs(segments.v.mean(axis=1))
    found = []
    for way in (-1.0, 1.0):
        mine = segments.way == way
        middle = float(np.median(speed[mine])) if mine.any() else 0.0
        found += [mine & (speed <= middle), mine & (speed > middle)]
    return [rows for rows in found if rows.sum() >= ENOUGH] or [np.ones(len(segments), dtype=bool)]
