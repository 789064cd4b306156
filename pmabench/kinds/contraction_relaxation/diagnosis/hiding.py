"""Departures that could hide in a fit that passes its tests, and their effect on its coefficients.

Each is sized by generalised least squares together with the coefficients. The effect of the largest possible size on
each coefficient is a line of the budget.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf, sqrt
from statistics import NormalDist

import numpy as np

from pmabench.analysis.shared.calibration import HYSTERESIS, Scales
from pmabench.analysis.shared.samples import sticks
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.diagnosis import columns
from pmabench.kinds.contraction_relaxation.diagnosis.cell import Weighed
from pmabench.kinds.contraction_relaxation.diagnosis.columns import RADII, TIMES, Followed
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import shown
from pmabench.kinds.contraction_relaxation.diagnosis.held_out import SURE, Test
from pmabench.kinds.contraction_relaxation.intervals import Cause, Trust
from pmabench.kinds.contraction_relaxation.pooled import SYMBOLS, Fit, force_by_pressure
from pmabench.kinds.contraction_relaxation.segments import Campaign, Segments
from pmabench.kinds.contraction_relaxation.values import WIDE, name_of
from pmabench.store.records import Array

FALSE_ALARMS = 0.01
"""Share of campaigns without any departure of which one or more is called significant (Bonferroni)."""
HIDES = 2.0
"""Possible size of a departure: the size found plus this many standard deviations."""
EVEN = 2.0
"""A departure of this many standard deviations is as likely present as not: it improves the fit as much as two more
coefficients cost by Akaike's criterion.
"""
RARELY = 3.5
"""The same for a drift of scales, which is hardly distinguishable from the coefficients and would double all intervals
of campaigns without it.
"""
MOST_HIDDEN = 0.02
"""Largest change of a coefficient, as a share, that a significant departure may cause and still be covered by the
interval; beyond it the value is withheld.
"""
GAIN, ZERO = "gain of the force cell against the weights", "zero of the force cell against the weights"
REVERSAL = "backlash of the displacement sensor"
GAUGE = "hysteresis of the pressure gauge, a third of its uncertainty"
LATE = "{} is late by {{size}} against the other channels, or filtered with that time constant"
ALONE = 1e-6
"""A column of which the coefficients leave a smaller share than this cannot be distinguished from them."""
HARDLY = 0.01
"""Share of a column not explained by the coefficients below which its size may be due to noise in the columns or bends
between the knots.
"""
REPLAYS, FEWEST_REPLAYS = 6, 3
"""Replays run where a departure is significant, to find what size noise alone makes; fewest that must show it."""
INEXACT = 0.1
"""Share of the effect of a known delay that its first and second order may miss. For a departure that is itself a delay
the whole effect counts, since both differ only by such small terms.
"""


@dataclass(frozen=True, eq=False)
class Way:
    """One departure, at one place or of one kind."""

    text: str
    """Completes `it fits that ...`; `{size}` is replaced by the size found."""
    quantity: str
    """Quantity of the size, for its unit."""
    column: Array
    """Change of F_L by size 1 [N per SI unit of the size], shape (n,)."""
    known: float = 0.0
    """Size [SI] that other lines of the budget already cover."""
    most: float = inf
    """Size [SI] that a calibration allows; a larger one counts only if significant."""


@dataclass(frozen=True, eq=False)
class Departure:
    """Departures of one kind, of which at most one is expected at a time."""

    name: str
    """For the budget."""
    part: str
    """Field of `Parts` that it belongs to."""
    ways: tuple[Way, ...]
    even: float = EVEN
    """Standard deviations at which it is as likely present as not."""


@dataclass(frozen=True, eq=False)
class Size:
    """Size of a departure by least squares together with the coefficients."""

    cause: Departure
    way: Way
    size: float
    """[SI of the way]."""
    error: float
    """Standard deviation [SI of the way]."""
    other: float
    """Part of the size that departures with known bounds may cause [SI of the way]."""
    share: float
    """Share of its column that the coefficients do not explain [1]."""

    @property
    def beyond(self) -> float:
        """Size in standard deviations, including the effect of departures with known bounds."""
        return abs(self.size) / sqrt(self.error**2 + self.other**2)

    @property
    def hidden(self) -> float:
        """Largest size that the data allow, beyond what other lines of the budget cover [SI of the way]."""
        least, most = abs(self.size) - HIDES * self.error, abs(self.size) + HIDES * self.error
        return max(0.0, (most if least > self.way.most else min(most, self.way.most)) - self.way.known)

    @property
    def text(self) -> str:
        """Sentence with the size."""
        return self.way.text.format(
            size=f"{shown(self.size, self.way.quantity)} +- {shown(2 * self.error, self.way.quantity)}"
        )


def causes(test: Test, followed: Followed) -> tuple[Departure, ...]:
    """All causes that the channels of the campaign allow."""
    every = (*_over_time(test), *_of_the_muscle(test, followed), *_of_the_displacement(test))
    return tuple(cause for cause in every if cause.ways)


def _over_time(test: Test) -> Iterator[Departure]:
    """Drifts over the campaign, slips between two trials, and late channels."""
    campaign, segments, fit, P = test.campaign, test.segments, test.fit, test.segments.pressure
    course = columns.drift(campaign, segments) - 0.5  # its mean is a zero, which `of_the_sensors` has
    text = "the zero of the force cell drifted by {size} over the campaign"
    own = (Way(text, "force", course, columns.zero_known(campaign)),) if campaign.cell else ()
    yield Departure("drift of the force cell that weights and fit do not exclude", "drift", own)

    text = "the scale of the {}, or the {} of the muscle, drifted by {{size}} over the campaign"
    scales = (
        ("pressure", "force", force_by_pressure(segments, fit) * P),
        ("displacement", "stiffness", fit.values("K", P) * segments.contraction),
    )
    ways = tuple(Way(text.format(name, of), "ratio", -force * course) for name, of, force in scales)
    yield Departure("drift of a scale, or of the muscle, that the fit does not exclude", "drift", ways, RARELY)

    text = "the mount or the displacement sensor slipped by {{size}} before trial {}"
    ways = tuple(  # shifts all later contractions equally
        Way(text.format(campaign.name(place)), "length", columns.slip(campaign, segments, fit, place))
        for place in columns.slip_places(campaign, segments)
    )
    yield Departure("slip of the mount that the fit does not exclude", "drift", ways)

    bounds, late = columns.clock_bounds(campaign), columns.late(segments, fit, campaign.cell)
    ways = tuple(  # a delay and a first-order filter are the same at first order
        Way(LATE.format(name), "time", column, bounds.get(name, 0.0)) for name, (column, _) in late.items()
    )
    yield Departure("delay or filter of a channel that the fit does not exclude", "method", ways)


def _of_the_muscle(test: Test, followed: Followed) -> Iterator[Departure]:
    """Behaviour of the muscle beyond the straight form. With a bend, K is the slope at the middle of the tested
    contractions; from hysteresis the part that F_c describes is subtracted.
    """
    both, grows = (followed, test.segments, test.fit), ", in proportion to pressure"
    text = "the force over contraction is bent: K changes by {size} over the contractions tested"
    bends = columns.bend("line", *both).T
    ways = tuple(Way(text + more, "stiffness", column) for column, more in zip(bends, ("", grows), strict=True))
    yield Departure("bend of the force over contraction that the fit does not exclude", "method", ways)

    text = "there is hysteresis of {{size}} that turns over {:g} mm of contraction{}"
    kinds = [(1e3 * radius, more) for radius in RADII for more in ("", grows)]
    turns = zip(kinds, columns.hysteresis(*both).T, strict=True)
    ways = tuple(Way(text.format(*kind), "force", column) for kind, column in turns)
    yield Departure("hysteresis that the fit does not exclude", "method", ways)

    decades = columns.creep("by decade", *both).T
    texts = ["in a decade of time", *(f"within about {time:g} s" for time in TIMES[1::2])]
    creeps = zip(texts, (np.sum(decades, axis=0), *decades), strict=True)
    ways = tuple(Way(f"the muscle creeps by {{size}} of its contraction {when}", "ratio", one) for when, one in creeps)
    yield Departure("creep that the fit does not exclude", "method", ways)


def _of_the_displacement(test: Test) -> Iterator[Departure]:
    """Nonlinearity of the displacement sensor, which also changes its slope over the stroke; and backlash after each
    reversal, which looks nearly like a friction that grows with K.
    """
    known = columns.sensor_known(test.campaign)
    text = "the displacement sensor is off its straight line by {{size}}, as on a wheel of {:g} mm off its middle"
    ways = tuple(
        Way(text.format(1e3 * radius), "length", columns.off_straight(test.segments, test.fit, radius, phase),
            most=known or inf)
        for radius in columns.WHEELS
        for phase in columns.PHASES
    )  # fmt: skip
    yield Departure("error of the displacement sensor that the fit does not exclude", "method", ways)

    text = "the displacement sensor lags by {size} behind the motion, either way (backlash)"
    column = columns.play(test.segments, test.fit)
    play = Way(text, "length", column, known or columns.UNDECLARED, known or inf)
    yield Departure("backlash of the displacement sensor that the fit does not exclude", "method", (play,))


@dataclass(frozen=True, eq=False)
class Hidden:
    """Sizes of all departures in a fit."""

    sizes: tuple[Size, ...]
    found: tuple[Size, ...]
    """Significant departures that move a coefficient by more than its interval, the clearest first."""
    moved: str
    """The coefficient that the first of `found` moves most, and by how much; empty without."""

    def late(self, channel: str) -> float:
        """How late a channel may be against the others [s]; infinite where that was not sized."""
        return next((size.hidden for size in self.sizes if size.way.text == LATE.format(channel)), inf)

    def lines(self, fit: Fit) -> list[Cause]:
        """Lines of the budget of the fit."""
        found: list[Cause] = []
        clear = {one.cause.name for one in self.found}
        for cause in {id(size.cause): size.cause for size in self.sizes}.values():
            mine = [size for size in self.sizes if size.cause is cause]
            strength = np.array([0.5 * (one.beyond**2 - cause.even**2) for one in mine])
            likely = np.exp(strength - max(0.0, strength.max())) / len(mine)
            none = np.exp(-max(0.0, strength.max()))
            change = fit.change(np.column_stack([size.way.column for size in mine]))
            most = (change * [size.hidden for size in mine]).T
            likely = likely / (none + likely.sum())
            found.append(Cause(cause.name, cause.part, most, likely=likely, seen=cause.name in clear))
        return found


def hidden(
    test: Test, followed: Followed, weights: Weighed, trust: Trust, replays: Callable[[int], Sequence[Test]]
) -> Hidden:
    """Departures that could hide in a fit; `trust`: of the fit without them; `replays(count)`: tests of replays of the
    fit.
    """
    sizes = _sizes(test, causes(test, followed))
    limit = NormalDist().inv_cdf(1 - 0.5 * FALSE_ALARMS / max(1, len(sizes)))
    if any(size.beyond > limit for size in sizes):
        again = [_sizes(other, causes(other, followed)) for other in replays(REPLAYS)]
        sizes = [_as_replayed(size, again) if size.beyond > limit else size for size in sizes]
    sizes = [_with_weights(size, weights) for size in sizes]
    significant = [size for size in sizes if size.beyond > limit]
    found, moved = _matter(significant, test.fit, trust, test.campaign.tested)
    return Hidden(tuple(sizes), tuple(found), moved)


def of_the_sensors(campaign: Campaign, weights: Weighed, segments: Segments, fit: Fit) -> Iterator[Cause]:
    """Sensor errors that no fit can show.

    The cell against the weights, where the difference exceeds the cell's calibration: either may be right. Backlash of
    the displacement sensor, from its calibration or assumed: it looks like Coulomb friction of K times its size; where
    K is the same at all pressures, no data can separate them. Hysteresis of the pressure gauge, a third (`HYSTERESIS`)
    of the uncertainty of its zero; none where that is not declared. The gauge reads low while pressure rises and high
    while it falls. If that persists at rest, it looks like friction. A sticking gauge is freed by noise at rest; then
    the reading lags by a fixed amount while pressure changes.
    """
    scales, cell = Scales.of(campaign.runs), np.where(segments.mass > 0, 0.0, 1.0)
    kinds = ((GAIN, weights.gain, scales.gains, segments.force * cell), (ZERO, weights.offset, scales.offsets, cell))
    for name, found, known, column in kinds:
        if found is not None:
            size = max(0.0, abs(found[0]) + HIDES * found[1] - known.get("force", 0.0))
            seen = abs(found[0]) > known.get("force", 0.0) + SURE * found[1]
            yield Cause(name, "calibration", size * fit.change(column[:, None]).T, seen=seen)

    declared = columns.sensor_known(campaign)
    size = declared or columns.UNDECLARED
    assumed = f"{REVERSAL}, assumed {show(size, 'length', 2)}: the record gives no uncertainty"
    change = size * fit.change(columns.play(segments, fit)[:, None])
    yield Cause(REVERSAL if declared else assumed, "method", change.T)

    if size := HYSTERESIS * scales.offsets.get("pressure", 0.0):
        push = size * force_by_pressure(segments, fit)
        ways = [push * segments.way]
        if any(sticks(trial.channels["pressure"][trial.usable]) for trial in campaign.trials):
            quarter = max(1, segments.P_mid.shape[1] // 4)
            moved = segments.P_mid[:, -quarter:].mean(axis=1) - segments.P_mid[:, :quarter].mean(axis=1)
            ways.append(push * np.clip(moved / size, -1.0, 1.0))
        yield Cause(GAUGE, "method", fit.change(np.column_stack(ways)).T)


def _sizes(test: Test, known: Sequence[Departure]) -> list[Size]:
    """Size of each departure, fitted together with the coefficients and with departures of known bounds (`Test.may`).

    One departure at a time, by generalised least squares.
    """
    segments, fit, own, after, scatter, may = test.segments, test.fit, test.own, test.after, test.scatter, test.may
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
    # noise above that at rest widens all errors, except the part that the departure itself explains
    more = (fit.residual @ fit.residual - size**2 * left) / (own.sum() + scatter * len(own) + np.sum(may**2))
    error = np.sqrt(np.maximum(variance, 1e-300) * np.maximum(1.0, more))
    kept = [member for member, one in zip(members, seen, strict=True) if one]
    missed = np.array([1.0 if way.quantity == "time" else INEXACT for _, way in kept])
    other = np.sqrt(np.sum((may.T @ weights) ** 2 + (missed * (may.T @ unaided)) ** 2, axis=0))
    share = left / power[seen]
    return [Size(*member, *map(float, found)) for member, *found in zip(kept, size, error, other, share, strict=True)]


def _weights(columns: Array, design: Array, may: Array, noise: float) -> Array:
    """Weight of each row in the size of each column, shape (n, k): optimal for rows of variance `noise` [N^2] plus the
    columns `may` (n, m) with sizes of 0 +- 1; insensitive to the coefficients of `design`.
    """

    def weigh(rows: Array) -> Array:
        return rows - may @ np.linalg.solve(noise * np.eye(may.shape[1]) + may.T @ may, may.T @ rows)

    scaled = design / np.maximum(np.sqrt(np.sum(design**2, axis=0)), 1e-300)
    weighed, alone = weigh(scaled), weigh(columns)
    alone = alone - weighed @ np.linalg.lstsq(scaled.T @ weighed, scaled.T @ alone)[0]
    return np.asarray(alone / np.sum(columns * alone, axis=0))


def _as_replayed(size: Size, replays: Sequence[Sequence[Size]]) -> Size:
    """The size minus its mean in replays of the fitted muscle, which have no departure, with at least their scatter as
    error: noise in the columns biases sizes as it biases coefficients.
    """
    seen = [one.size for replay in replays for one in replay if one.way.text == size.way.text]
    if len(seen) < FEWEST_REPLAYS:
        return size
    variance = float(np.var(seen, ddof=1))
    error = sqrt(max(size.error**2, variance) + variance / len(seen))
    return replace(size, size=size.size - float(np.mean(seen)), error=error)


def _with_weights(size: Size, weights: Weighed) -> Size:
    """The drift of the cell as the weighted mean of the fit's and the weights' result."""
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


def _matter(significant: Sequence[Size], fit: Fit, trust: Trust, tested: Sequence[float]) -> tuple[list[Size], str]:
    """Significant departures that move a coefficient by more than its interval, the clearest of each cause; and the
    effect of the first one, in words.
    """
    places: list[tuple[str, float | None]] = [(symbol, P) for symbol in SYMBOLS for P in tested]
    places += [("F_c", None)] if fit.friction else []
    rows = np.array([fit.row(symbol, P or 0.0) for symbol, P in places])
    values = np.abs(rows @ fit.theta)
    halves = np.array([trust.parts(row)[0].combined or 0.0 for row in rows])
    known = (halves > 0) & (halves <= WIDE * values)
    found: dict[str, Size] = {}
    moved = ""
    for one in sorted(significant, key=lambda s: s.beyond, reverse=True):
        change = fit.change(one.way.column[:, None])[:, 0] * max(0.0, abs(one.size) - one.way.known)
        by = np.abs(rows @ change)
        worst = int(np.argmax(np.where(known, by / np.maximum(halves, 1e-300), 0.0)))
        if known[worst] and by[worst] > halves[worst] and one.cause.name not in found:
            found[one.cause.name] = one
            size, half = (100 * each[worst] / values[worst] for each in (by, halves))
            name = name_of(*places[worst])
            text = f"it would move {name} by {size:.2g} %, where its interval without that is +-{half:.2g} %"
            moved = moved or text
    return list(found.values()), moved
