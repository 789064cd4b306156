"""How far the coefficients of a pooled fit can be trusted, by cause; knows no protocol.

*Repeats*: covariance of least squares with the noise that was seen, checked by replays and widened
where trials scatter more than that. *Method*: what replays of the fitted muscle come back with. *Calibration*: the fit
once more with each channel off by its uncertainty. *Skew*: the same with the clock of each stream off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis import student
from pmabench.analysis.calibration import Scales
from pmabench.analysis.pooled import SYMBOLS, Fit, solve
from pmabench.analysis.results import Parts
from pmabench.analysis.segments import Segments
from pmabench.store.records import Array

NORMAL = 1.96
"""Half width of a 95 % interval by its standard deviation."""
FEW = 10
"""With fewer repetitions than this in all, scatter is taken between all trials instead of within cells."""


@dataclass(frozen=True, eq=False)
class Trust:
    """Interval parts of `Fit.theta`, half widths of 95 % intervals, and the bias to take off; shape (p,) each."""

    bias: Array
    covariance: Array
    """For the repeats part, shape (p, p)."""
    mean_error: Array
    """Half width of the mean bias of the replays."""
    shifts: Array
    """Change of theta by each cause of calibration error at its 95 % bound, shape (causes, p)."""
    skews: Array
    """Change of theta by the clock of each stream at its bound, shape (clocks, courses, p); (0, 0, p) for one."""
    excess: Mapping[str, float]
    """Scatter between trials by the scatter from noise, as variance ratio, for each symbol."""
    within: bool
    """True where that scatter is within cells, between repeats."""

    def parts(self, combination: Array, extra_method: float = 0.0) -> tuple[Parts, float]:
        """Interval parts and bias of a linear combination (p,) of the coefficients."""
        repeats = NORMAL * float(np.sqrt(max(0.0, float(combination @ self.covariance @ combination))))
        bias = float(combination @ self.bias)
        calibration = float(np.sqrt(np.sum((self.shifts @ combination) ** 2))) if len(self.shifts) else None
        method = float(np.sqrt(bias**2 + np.sum((combination * self.mean_error) ** 2) + extra_method**2))
        skew = float(np.sum(np.max(np.abs(self.skews @ combination), axis=1, initial=0.0)))
        return Parts(repeats=repeats, method=method, calibration=calibration, skew=skew), bias


@dataclass(frozen=True, eq=False)
class Pooled:
    """A pooled fit with its segments and its trust."""

    segments: Segments
    fit: Fit
    expected: float
    """Noise of a segment [N] that the channels explain."""
    trust: Trust


def assess(
    segments: Segments,
    fit: Fit,
    expected: float,
    cells: NDArray[np.intp],
    replays: Sequence[Array],
    scales: Scales,
    skews: Array,
) -> Trust:
    """All parts for a fit.

    Parameters
    ----------
    expected
        Noise of a segment [N] that the channels explain.
    cells
        Cell number of each trial number in `segments.trial`.
    replays
        `Fit.theta` of fits to replays of `fit`.
    scales
        How well the channels are known.
    skews
        As in `Trust`.
    """
    bias, spread = _replayed(fit, replays)
    noise = max(fit.rms, expected)
    covariance = noise**2 * fit.inverse
    analytic = np.diag(covariance)
    seen = analytic
    if expected > 0 and len(replays) > 1:
        seen = 0.5 * (analytic + (noise / expected * spread) ** 2)
    between, freedom, within = _between(segments, fit, cells)
    stretch = student.ppf(0.975, freedom) / NORMAL
    ratio = between / np.maximum(seen, 1e-300)
    excess = {symbol: _pooled(fit, symbol, ratio, segments) for symbol in (*SYMBOLS, "F_c")}
    pooled = np.append(np.repeat([excess[symbol] for symbol in SYMBOLS], len(fit.knots)), excess["F_c"])
    widen = np.maximum(1.0, 0.5 * (pooled + ratio))
    scale = np.sqrt(seen / analytic * (1.0 + stretch**2 * (widen - 1.0)))
    return Trust(
        bias=bias,
        covariance=covariance * np.outer(scale, scale),
        mean_error=2.0 * spread / np.sqrt(max(1, len(replays))),
        shifts=_calibration(segments, fit, expected, scales),
        skews=skews,
        excess=excess,
        within=within,
    )


def _replayed(fit: Fit, replays: Sequence[Array]) -> tuple[Array, Array]:
    """Mean and standard deviation of what replays come back with, less what went in."""
    if not replays:
        return np.zeros(len(fit.theta)), np.zeros(len(fit.theta))
    off = np.array(replays) - fit.theta
    return off.mean(axis=0), off.std(axis=0, ddof=1) if len(off) > 1 else np.zeros(len(fit.theta))


def _between(segments: Segments, fit: Fit, cells: NDArray[np.intp]) -> tuple[Array, Array, bool]:
    """Variance of theta from the scatter between trials, its degrees of freedom (p,), and whether within cells.

    The bootstrap over trials (resampling their normal equations) in its limit of many draws: the variance of
    inverse @ sum of the trials' scores A'r. Within a cell, scores count from their mean, with n/(n - 1). Degrees of
    freedom as by Satterthwaite, from how unequally the trials bear on a coefficient.
    """
    trials, rows = np.unique(segments.trial, return_inverse=True)
    scores, bearing = (np.zeros((len(trials), len(fit.theta))) for _ in range(2))
    np.add.at(scores, rows, fit.design * fit.residual[:, None])
    np.add.at(bearing, rows, (fit.design @ fit.inverse) ** 2)
    effective = bearing.sum(axis=0) ** 2 / np.maximum(1e-300, (bearing**2).sum(axis=0))
    own = cells[trials]
    _, cell, count = np.unique(own, return_inverse=True, return_counts=True)
    total, freedom = len(trials), len(trials) - len(count)
    within = freedom >= FEW
    if within:
        means = np.zeros((len(count), scores.shape[1]))
        np.add.at(means, cell, scores)
        n = count[cell]
        repeated = n > 1
        off = (scores - (means / count[:, None])[cell])[repeated] * np.sqrt(n[repeated] / (n[repeated] - 1))[:, None]
        off *= np.sqrt(total / int(repeated.sum()))
    else:
        freedom = max(1, total - 1)
        off = scores * np.sqrt(total / freedom)
    return np.sum((off @ fit.inverse) ** 2, axis=0), np.maximum(1.0, effective * freedom / total), within


def _pooled(fit: Fit, symbol: str, ratio: Array, segments: Segments) -> float:
    """Mean of `ratio` over the coefficients of a symbol that rest on samples."""
    if symbol == "F_c":
        return float(ratio[-1]) if fit.friction else 1.0
    k = len(fit.knots)
    columns = slice(fit.index(symbol), fit.index(symbol) + k)
    weight = np.sum(fit.design[:, columns] ** 2, axis=0)
    solid = weight > 0.05 * weight.max()
    return float(np.mean(ratio[columns][solid])) if solid.any() else 1.0


def _calibration(segments: Segments, fit: Fit, expected: float, scales: Scales) -> Array:
    """Shift of theta with each channel's offset, then gain, off by its expanded uncertainty."""
    shifts = []
    for channel in ("pressure", "displacement", "force"):
        for gain, offset in ((0.0, scales.offsets.get(channel, 0.0)), (scales.gains.get(channel, 0.0), 0.0)):
            if gain or offset:
                again = solve(segments.shifted(channel, gain, offset), fit.knots, expected)
                shifts.append(again.theta - fit.theta)
    return np.array(shifts).reshape(len(shifts), len(fit.theta))


def replay_fits(replay: Callable[[int], Segments], fit: Fit, expected: float, count: int) -> list[Array]:
    """`Fit.theta` of fits on the same knots to `count` replays; `replay(seed)` gives the segments of one."""
    return [solve(replay(seed), fit.knots, expected).theta for seed in range(count)]
