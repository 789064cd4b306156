"""Whether the data have the form that the pooled fit assumes, and what departures from it could hide in the fit.

Three tests: trials that are left out are predicted no worse than noise allows; residuals of neighbouring segments do
not agree; no known departure (`departures`) is significant. Where the first two fail nothing may be reported. The
effect of each departure on each coefficient, at the size that could be there, is a line of the budget.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import Scales
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.departures import Cause, Way, allowed, causes, order
from pmabench.kinds.contraction_relaxation.drift import Weighed, weighed
from pmabench.kinds.contraction_relaxation.intervals import Hiding, Trust
from pmabench.kinds.contraction_relaxation.pooled import FLOOR, SYMBOLS, Fit, Solved, noise_covariance, prior_of, rms_of
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.store.analyses.results import Estimate
from pmabench.store.records import Array

MOST_RATIO = 1.2
"""Rms of what trials that were left out are missed by, over what noise allows, from which on values are withheld."""
MOST_ALIKE = 0.3
"""Mean product of neighbouring residuals, over the variance of the noise, from which on values are withheld."""
SURE = 4.0
"""Both count only beyond so many standard deviations of them by chance, which few segments make large."""
FALSE_ALARMS = 0.01
"""Share of campaigns without any departure of which one or more is called significant (Bonferroni)."""
HIDES = 2.0
"""What hides is as large as it was found, and so many standard deviations more."""
NEAR = 5e-4
"""A residual this small, as a share of the typical force, says nothing against the form."""
EVEN = 2.0
"""A departure of so many standard deviations is as likely to be there as not: the fit is better for it by as much as
two more coefficients cost by Akaike's criterion."""
MOST_HIDDEN = 0.02
"""A significant departure that could change a coefficient by more than this share is not left to its interval."""
GAIN, ZERO = "gain of the force cell against the weights", "zero of the force cell against the weights"
FOLDS = 6
"""Every sixth trial is left out at a time."""
ENOUGH = 50
"""Fewest segments that a fit to other trials predicts well for a comparison with noise."""
ALONE = 1e-6
"""A column of which the coefficients leave a smaller share than this cannot be distinguished from them."""
HARDLY = 0.01
"""A column of which less than this share is left is hardly distinguished from the coefficients: its size may be that of
the columns' noise, and of bends between the knots."""
HICCUPS = 0.02
"""Share of the rows of polled devices that answers may displace which came much later than usual: a busy computer."""
INEXACT = 0.1
"""Share of the effect of a known delay that its first and second order may miss. Another delay is not sized beyond what
a known one may do at all: the two differ by such small terms only."""
FEWEST_REPEATS = 10
"""Fewest repetitions in all that tell how much trials scatter by themselves."""
MOST_NAMED = 3
REMEDY = "Look for the cause, mend it and measure again, or repeat trials if they differ by themselves"


@dataclass(frozen=True, eq=False)
class Size:
    """How large a departure is by least squares, fitted together with the coefficients."""

    cause: Cause
    way: Way
    size: float
    """[SI of the way]."""
    error: float
    """Standard deviation [SI of the way]."""
    other: float
    """What departures of known size may make of it [SI of the way]."""
    share: float
    """Share of its column that the coefficients do not explain [1]."""

    @property
    def beyond(self) -> float:
        """Size in standard deviations, those that other lines of the budget hold among them."""
        return abs(self.size) / sqrt(self.error**2 + self.other**2)

    @property
    def hidden(self) -> float:
        """Largest size that could hide [SI of the way]."""
        return max(0.0, abs(self.size) + HIDES * self.error - self.way.known)

    @property
    def text(self) -> str:
        """What it is, with its size."""
        return self.way.text.format(size=f"{_show(self.size, self.way)} +- {_show(2 * self.error, self.way)}")


@dataclass(frozen=True, eq=False)
class Form:
    """What the tests of the form found."""

    ratio: float
    """Rms of what left-out trials are missed by, over what noise allows."""
    held_out: bool
    """False where trials are too few: the ratio is that of the residual of the fit."""
    alike: float
    """Mean product of neighbouring residuals over the variance of the noise."""
    found: tuple[Size, ...]
    """Departures that are significant, and move a coefficient by more than its interval; the clearest first."""
    sizes: tuple[Size, ...]
    """All departures."""
    moved: str
    """The coefficient that the clearest of `found` moves most, and by how much; empty without."""
    weighed: Weighed
    most_ratio: float
    most_alike: float

    @property
    def missed(self) -> str:
        """What the ratio is of, in words."""
        return "trials that are left out of the fit are missed by" if self.held_out else "the residual is"

    @property
    def fits(self) -> str:
        """The significant departures in words, the clearest first; empty without."""
        return "; or that ".join(one.text for one in self.found[:MOST_NAMED])

    @property
    def reason(self) -> str:
        """Why nothing of the fit may be reported, with numbers; empty where nothing speaks against the form."""
        parts = []
        if self.ratio >= self.most_ratio:
            limit = f"below {self.most_ratio:.3g} is expected"
            parts.append(f"{self.missed} {self.ratio:.3g} times what the noise allows ({limit})")
        if self.alike >= self.most_alike:
            limit = f"below {self.most_alike:.2g} is expected"
            parts.append(f"residuals of neighbouring segments agree by {self.alike:.2g} of the noise ({limit})")
        if not parts:
            return ""
        fits = f"it fits that {self.fits}" if self.found else "no departure that is looked for fits it"
        return f"the data do not have the form of the model: {'; '.join([*parts, fits])}. {REMEDY}"

    def hides(self, estimates: Sequence[Estimate]) -> dict[int, str]:
        """Place of each value that may not be reported although the form holds as a whole -> why.

        Values that one departure concerns have one reason, with the largest share that it could change one of them by.
        """
        found: dict[int, tuple[Size, float]] = {}
        for place, estimate in enumerate(estimates):
            lines = {s.name: s.half or 0.0 for s in estimate.budget}
            mine = [(one, lines.get(one.cause.name, 0.0)) for one in self.found]
            one, half = max(mine, key=lambda pair: pair[1], default=(None, 0.0))
            if one is not None and estimate.value is not None and half > MOST_HIDDEN * abs(estimate.value):
                found[place] = (one, half / abs(estimate.value))
        most = {id(one): max(share for other, share in found.values() if other is one) for one, _ in found.values()}
        return {place: _why_hidden(one, most[id(one)]) for place, (one, _) in found.items()}

    @property
    def facts(self) -> dict[str, Any]:
        """The same as plain data, sizes in SI."""
        return {
            "ratio": self.ratio,
            "held_out": self.held_out,
            "alike": self.alike,
            "departures": [
                {"cause": s.cause.name, "text": s.text, "size": s.size, "error": s.error, "beyond": s.beyond}
                for s in self.sizes
            ],
        }


def _why_hidden(one: Size, share: float) -> str:
    """Why values may not be reported that a departure could change by up to this share."""
    effect = f"could change these values by up to {100 * share:.2g} %"
    limit = f"more than {100 * MOST_HIDDEN:g} % is not left to an interval"
    if one.share < HARDLY:
        most = one.way.text.format(size=_show(one.hidden, one.way))
        return (
            f"it cannot be excluded that {most}: these trials hardly distinguish that from the coefficients, and it"
            f" {effect} ({limit}). Test at more loads, which differ more"
        )
    return f"it fits that {one.text}, which {effect} ({limit}). {REMEDY}"


def _show(value: float, way: Way) -> str:
    if way.quantity == "ratio":
        return f"{100 * abs(value):.2g} %"
    return show(abs(value), way.quantity, 2)


def examine(campaign: Campaign, segments: Segments, fit: Fit, trust: Trust, noise: Array) -> tuple[Form, Trust]:
    """The tests of a pooled fit, and its trust with what could hide.

    `trust` is without that; `noise` (n,) [N] is what the channels explain of each segment.
    """
    own, after = _noise(campaign, segments, fit)
    own = np.maximum(own, (FLOOR * rms_of(segments.force)) ** 2)
    known = causes(campaign, segments, fit)
    may = allowed(campaign, segments, known)
    scatter = _scatter(campaign, segments, fit.residual, own)
    weights = weighed(campaign, order(campaign))
    sizes = [_with_weights(size, weights) for size in _sizes(segments, fit, known, own, after, scatter, may)]
    whole = own + np.sum(may**2, axis=1) + scatter + (NEAR * rms_of(segments.force)) ** 2
    late = HICCUPS if any(vars(campaign.late).values()) else 0.0
    ratio, free, held_out = _ratio(segments, fit, whole, own, rms_of(noise), late)
    pairs = np.flatnonzero(_neighbours(segments))
    expected = after[pairs] + np.sum(may[pairs] * may[pairs + 1], axis=1) + scatter
    product = fit.residual[pairs] * fit.residual[pairs + 1] - expected
    alike = float(np.sum(product) / np.sum(whole[pairs])) if len(pairs) else 0.0
    limit = NormalDist().inv_cdf(1 - 0.5 * FALSE_ALARMS / max(1, len(sizes)))
    found, moved = _matter([s for s in sizes if s.beyond > limit], fit, trust, campaign.tested)
    form = Form(
        ratio, held_out, alike, tuple(found), tuple(sizes), moved, weights,
        max(MOST_RATIO, sqrt(1 + SURE * sqrt(2 / free))), max(MOST_ALIKE, SURE / sqrt(max(1, len(pairs)))),
    )  # fmt: skip
    return form, hiding(form, Scales.of(campaign.runs), segments, fit, trust, np.ones(len(segments), bool))


def _noise(campaign: Campaign, segments: Segments, fit: Fit) -> tuple[Array, Array]:
    """Variance of each row [N^2], shape (n,), and covariance with the next, shape (n - 1,).

    The times of polled samples scatter by no more than half a poll; how much of that they do is estimated from the
    residuals, which grow with the speed by it. Of each row that counts which the fit leaves free: the few fast ones are
    fitted closely, and would say that nothing scatters.
    """
    still, after = noise_covariance(segments, fit, campaign.noise_of_means)
    moving, following = noise_covariance(segments, fit, campaign.noise_of_means, campaign.late)
    more = moving - still
    if not more.any():
        return still, after
    free = np.maximum(0.0, 1.0 - np.sum(fit.design @ fit.inverse * fit.design, axis=1))
    weights = more / moving**2
    share = float(weights @ (fit.residual**2 - free * still)) / float(weights @ (free * more))
    share = min(max(share, 0.0), 1.0)
    return still + share * more, after + share * (following - after)


def hiding(form: Form, scales: Scales, segments: Segments, fit: Solved, trust: Trust, rows: NDArray[np.bool_]) -> Trust:
    """The trust of a fit to these `segments`, with what could hide in it by the sizes of `form`.

    `rows` says which of the segments of `form` they are.
    """
    lines: list[Hiding] = []
    clear = {one.cause.name for one in form.found}
    for cause in {id(size.cause): size.cause for size in form.sizes}.values():
        mine = [size for size in form.sizes if size.cause is cause]
        strength = np.array([0.5 * (one.beyond**2 - EVEN**2) for one in mine])
        likely = np.exp(strength - max(0.0, strength.max())) / len(mine)
        none = np.exp(-max(0.0, strength.max()))
        change = fit.change(np.column_stack([size.way.column[rows] for size in mine]))
        most = change * [size.hidden for size in mine]
        lines.append(Hiding(cause.name, cause.part, most, likely / (none + likely.sum()), cause.name in clear))
    return replace(trust, hides=(*lines, *_cell(form.weighed, scales, segments, fit)))


def _cell(weights: Weighed, scales: Scales, segments: Segments, fit: Solved) -> list[Hiding]:
    """The cell against the weights, as far as its calibration does not hold the difference: either may be right."""
    cell = np.where(segments.mass > 0, 0.0, 1.0)
    kinds = ((GAIN, weights.gain, scales.gains, segments.force * cell), (ZERO, weights.offset, scales.offsets, cell))
    lines = []
    for name, found, known, column in kinds:
        if found is not None:
            size = max(0.0, abs(found[0]) + HIDES * found[1] - known.get("force", 0.0))
            seen = abs(found[0]) > known.get("force", 0.0) + SURE * found[1]
            lines.append(Hiding(name, "calibration", size * fit.change(column[:, None]), np.ones(1), seen))
    return lines


def _scatter(campaign: Campaign, segments: Segments, residual: Array, own: Array) -> float:
    """Variance between repeats of a cell beyond that of noise, as a force that is constant in each trial [N^2]."""
    trials, rows, count = np.unique(segments.trial, return_inverse=True, return_counts=True)
    mean = np.bincount(rows, residual) / count
    noise = np.bincount(rows, own) / count**2
    _, cell, members = np.unique(campaign.cells[trials], return_inverse=True, return_counts=True)
    freedom = len(trials) - len(members)
    if freedom < FEWEST_REPEATS:
        return 0.0
    off = mean - (np.bincount(cell, mean) / members)[cell]
    expected = float(np.sum(noise * (1 - 1 / members[cell])))
    return max(0.0, (float(off @ off) - expected) / freedom)


def _inverse(normal: Array) -> Array:
    """Inverse of a normal matrix, scaled to its diagonal first."""
    scale = np.sqrt(np.diag(normal))
    return np.asarray(np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale))


def _sizes(
    segments: Segments, fit: Fit, known: Sequence[Cause], own: Array, after: Array, scatter: float, may: Array
) -> list[Size]:
    """Size of each column, fitted together with the coefficients and with what departures of known size may do.

    One at a time, by generalised least squares. `may` (n, m) is as `allowed` gives it: columns of size 0 +- 1.
    """
    members = [(cause, way) for cause in known for way in cause.ways]
    if not members:
        return []
    columns = np.column_stack([way.column for _, way in members])
    power = np.sum(columns**2, axis=0)
    left = power - np.sum((fit.design.T @ columns) * fit.change(columns), axis=0)
    seen = left > ALONE * np.maximum(power, 1e-300)
    columns, left = columns[:, seen], left[seen]
    noise = float(own.mean()) + scatter
    weights = _weights(columns, fit.design, may, noise)
    unaided = _weights(columns, fit.design, may[:, :0], noise)
    size = fit.residual @ weights
    variance = own @ weights**2 + 2 * (after @ (weights[1:] * weights[:-1]))
    _, trial = np.unique(segments.trial, return_inverse=True)
    whole = np.zeros((trial.max() + 1, weights.shape[1]))
    np.add.at(whole, trial, weights)
    variance += scatter * np.sum(whole**2, axis=0)
    # noise that is larger than rest shows widens all; what the departure itself explains does not count
    more = (fit.residual @ fit.residual - size**2 * left) / (own.sum() + scatter * len(own) + np.sum(may**2))
    error = np.sqrt(np.maximum(variance, 1e-300) * np.maximum(1.0, more))
    kept = [member for member, one in zip(members, seen, strict=True) if one]
    missed = np.array([1.0 if way.quantity == "time" else INEXACT for _, way in kept])
    other = np.sqrt(np.sum((may.T @ weights) ** 2 + (missed * (may.T @ unaided)) ** 2, axis=0))
    share = left / power[seen]
    return [Size(*member, *map(float, found)) for member, *found in zip(kept, size, error, other, share, strict=True)]


def _weights(columns: Array, design: Array, may: Array, noise: float) -> Array:
    """Weight of each row in the size of each column, shape (n, k): best where rows have the variance `noise` [N^2] and
    `may` (n, m) adds columns of size 0 +- 1; no change of the coefficients of `design` has an effect.
    """

    def weigh(rows: Array) -> Array:
        return rows - may @ np.linalg.solve(noise * np.eye(may.shape[1]) + may.T @ may, may.T @ rows)

    scaled = design / np.maximum(np.sqrt(np.sum(design**2, axis=0)), 1e-300)
    weighed, alone = weigh(scaled), weigh(columns)
    alone = alone - weighed @ np.linalg.lstsq(scaled.T @ weighed, scaled.T @ alone)[0]
    return np.asarray(alone / np.sum(columns * alone, axis=0))


def _with_weights(size: Size, weights: Weighed) -> Size:
    """The drift of the cell by the fit and by the weights together, each as sure as it is."""
    if weights.drift is None or size.way.quantity != "force" or size.cause.part != "drift":
        return size
    drift, error = weights.drift
    fit = error**2 / (error**2 + size.error**2 + size.other**2)
    return replace(
        size,
        size=fit * size.size + (1 - fit) * drift,
        error=sqrt((fit * size.error) ** 2 + ((1 - fit) * error) ** 2),
        other=fit * size.other,
    )


def _ratio(
    segments: Segments, fit: Fit, whole: Array, own: Array, expected: float, late: float
) -> tuple[float, float, bool]:
    """Rms of what trials are missed by that were left out, over what noise and the fit's own uncertainty make of it;
    degrees of freedom, and whether trials were left out.

    Every `FOLDS`-th trial is left out at a time. Only what the others predict as well as one segment is known counts;
    where that is little, the residual of the fit to all. `whole` (n,) [N^2] is the variance of a row, `own` that by
    noise alone. `late` is the share of rows that a late answer of a device may have displaced.
    """
    prior = prior_of(segments, fit.design, fit.knots, expected)
    normal, right = fit.design.T @ fit.design + prior.T @ prior, fit.design.T @ segments.force
    trials, trial = np.unique(segments.trial, return_inverse=True)
    squares: list[Array] = []
    for fold in range(min(FOLDS, len(trials))):
        mine = trial % FOLDS == fold
        design, force = fit.design[mine], segments.force[mine]
        inverse = _inverse(normal - design.T @ design)
        miss = force - design @ (inverse @ (right - design.T @ force))
        lever = np.sum(design @ inverse * design, axis=1)
        sure = (lever >= 0) & (lever <= 1)
        squares.append((miss**2 / (whole[mine] + own[mine] * lever))[sure])
    every = np.sort(np.concatenate(squares))
    if len(every) >= ENOUGH:
        return sqrt(_mean_without(every, late)), len(every), True
    free = max(1.0, len(own) - float(np.sum(fit.design @ fit.inverse * fit.design)))
    return sqrt(float(fit.residual @ fit.residual) / free / float(np.mean(whole))), free, False


def _mean_without(squares: Array, share: float) -> float:
    """Mean of rising squares without the largest `share` of them, scaled so that it is 1 for normal noise of size 1."""
    kept = squares[: len(squares) - int(share * len(squares))]
    if len(kept) == len(squares):
        return float(squares.mean())
    normal = NormalDist()
    end = normal.inv_cdf(1 - share / 2)
    return float(kept.mean()) / (1 - 2 * end * normal.pdf(end) / (1 - share))


def _neighbours(segments: Segments) -> Array:
    """Whether a segment is followed at once by the next, shape (n - 1,)."""
    apart = segments.v.shape[1] * segments.dt
    return np.asarray((np.diff(segments.trial) == 0) & (np.abs(np.diff(segments.t) - apart) < 0.5 * segments.dt))


def _matter(significant: Sequence[Size], fit: Fit, trust: Trust, tested: Sequence[float]) -> tuple[list[Size], str]:
    """Those that move a coefficient by more than its interval, the clearest of each cause; the first one's effect."""
    places = [(symbol, P) for symbol in SYMBOLS for P in tested]
    combinations = {f"{symbol} at {show(P, 'pressure', 4)}": fit.row(symbol, P) for symbol, P in places}
    if fit.friction:
        combinations["F_c"] = fit.row("F_c", 0.0)
    halves = {name: trust.parts(row)[0] for name, row in combinations.items()}
    found: dict[int, Size] = {}
    moves: dict[int, tuple[float, str]] = {}
    for one in sorted(significant, key=lambda s: s.beyond, reverse=True):
        change = fit.change(one.way.column[:, None])[:, 0] * max(0.0, abs(one.size) - one.way.known)
        share, text = max(
            (_moved(name, row, change, halves[name].combined, fit) for name, row in combinations.items()),
            default=(0.0, ""),
        )
        if share > 1.0 and id(one.cause) not in found:
            found[id(one.cause)], moves[id(one.cause)] = one, (share, text)
    return list(found.values()), next(iter(moves.values()))[1] if moves else ""


def _moved(name: str, row: Array, change: Array, half: float | None, fit: Fit) -> tuple[float, str]:
    """By how many half widths a coefficient is moved, and that in words."""
    value, by = abs(float(row @ fit.theta)), abs(float(row @ change))
    if not half or not value or half > 0.25 * value:
        return 0.0, ""
    moved, interval = 100 * by / value, 100 * half / value
    return by / half, f"it would move {name} by {moved:.2g} %, where its interval without that is +-{interval:.2g} %"
