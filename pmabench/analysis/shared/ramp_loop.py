"""One isobaric loop: branches on a common grid of contraction, their gap, mean and work.

After a turn the force approaches the other branch as exp(-distance/w), at any speed. In a periodic loop between
`lower` and `upper`, with E = exp(-(upper - lower)/w) and d1, d2 the distances from the two ends:

    gap  = 2 h - 2 h/(1 + E) (exp(-d1/w) + exp(-d2/w))
    mean = mean without hysteresis + h/(1 + E) (exp(-d1/w) - exp(-d2/w))

The gap does not contain the curve without hysteresis, so h and w are found independently of it.

Hysteresis and damping change the force at the moment at which the motion turns, however slowly it approaches the other
branch. A filter of the force cell, another clock or backlash of the displacement sensor separate the two moments; on
the branches each of them looks like hysteresis or damping. So the delay of the force behind the motion is found from
the times at which both turn.

Measures one trial of slow ramps. The torque of a joint over its angle is evaluated in the same way with other `Axes`:
it falls while the angle rises, as the force does while the muscle contracts (`joint`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import student
from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.lines import left_by
from pmabench.analysis.shared.samples import (
    NotUsable,
    between_new,
    ends,
    lag_of,
    lag_open,
    noise_of,
    on_time,
    refuse_flagged,
    refuse_incomplete,
    settings_of,
)
from pmabench.analysis.shared.sine_loop import lost_work
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.store.records import Array, Command, Flag, RunData, TrialData

FEWEST_AT_A_TURN = 6
"""Fewest samples on either side of a turn."""
TRIED = 41
"""Number of delays tried in each direction, including 0."""
REACH = 0.6
"""Longest tried delay over the time span on either side of a turn."""
REACHED = 0.8
"""Share of the longest delay above which the search is repeated over a longer span."""
WIDER = 3.0
"""Spans before and after its command within which the turn of the motion is searched."""
ORDER = 3
ALIKE = 1e-9
"""Relative difference below which sums of squares count as equal, as for delays between the same two samples."""
OF_FILTER = 4.0
"""Span on either side of a turn, in time constants of the filter."""
SURE = 4.0
"""Standard deviations by which a filter must fit better than a delay, to be taken in its place."""


@dataclass(frozen=True)
class Behind:
    """Delay of the force behind the motion [s], its half width [s], and whether it is within the tried range."""

    time: float
    half: float
    within: bool


def behind(t: Array, moved: Array, pulls: Array, turns: Sequence[float], span: float) -> Behind | None:
    """Delay of `pulls` behind `moved`; None where too few samples are near a turn.

    `t` [s], `moved`, `pulls` have shape (n,), `turns` are the commanded times [s]. Within half of `span` [s] about each
    turn the force is a straight line before, and after it a jump and a cubic polynomial, delayed or through a
    first-order filter. The result for the whole `span` shows the effect of this form, and is in the half width. Delays
    near the limit of half the span are searched within `span` and twice that. The interval is by profile likelihood,
    with Student's t corrected for the number of distinguishable delays, because the residual is not smooth.
    """
    near, wide = (_of_turns(t, moved, pulls, turns, share * span) for share in (0.5, 1.0))
    if wide is not None and abs(wide.time) > REACHED * REACH * 0.5 * span:
        near, wide = wide, _of_turns(t, moved, pulls, turns, 2 * span) or wide
    if near is None or wide is None:
        return wide
    return replace(near, half=float(np.hypot(near.half, abs(near.time - wide.time))))


def through_filter(t: Array, moved: Array, pulls: Array, turns: Sequence[float], constant: float) -> bool:
    """Whether the turns agree with `pulls` being filtered by a first-order filter of time `constant` [s]."""
    span = OF_FILTER * constant
    windows = _windows(t, moved, pulls, turns, span)
    if not windows:
        return False
    _, least, variance = min((_best(windows, REACH * span, of) for of in (_delayed, _filtered)), key=lambda one: one[1])
    period, one = max(float(np.median(np.diff(t))) for t, _ in windows), np.array([constant])
    near = [[(t - by, y) for t, y in windows] for by in period * np.linspace(-0.5, 0.5, 3)]  # between samples
    return min(float(_left(those, _filtered, one)[0]) for those in near) <= least + SURE**2 * variance


def _windows(t: Array, moved: Array, pulls: Array, turns: Sequence[float], span: float) -> list[tuple[Array, Array]]:
    return [window for turn in turns if (window := _window(t, moved, pulls, turn, span)) is not None]


def _of_turns(t: Array, moved: Array, pulls: Array, turns: Sequence[float], span: float) -> Behind | None:
    windows = _windows(t, moved, pulls, turns, span)
    if not windows:
        return None
    (delayed, by_delay, _), (filtered, by_filter, variance) = (
        _best(windows, REACH * span, of) for of in (_delayed, _filtered)
    )
    return filtered if by_delay - by_filter > SURE**2 * variance else delayed


def _window(t: Array, moved: Array, pulls: Array, turn: float, span: float) -> tuple[Array, Array] | None:
    """Times [s] since the turn of the motion, and `pulls` at these times; None with too few samples or no turn."""
    wide = _about(t, turn, WIDER * span)
    begin = None if wide is None else corner(t[wide] - turn, moved[wide])
    near = None if begin is None else _about(t, turn + begin, span)
    return None if near is None or begin is None else (t[near] - turn - begin, pulls[near])


def _about(t: Array, moment: float, span: float) -> NDArray[np.intp] | None:
    rows = np.flatnonzero(np.abs(t - moment) <= span)
    before = int(np.count_nonzero(t[rows] < moment))
    return rows if min(before, len(rows) - before) >= FEWEST_AT_A_TURN else None


def corner(t: Array, y: Array) -> float | None:
    """Time [s] at which y(t) changes from one straight line to another; None where that is at an end."""
    tried = np.linspace(0.7 * float(t[0]), 0.7 * float(t[-1]), 2 * TRIED)
    left = left_by(np.stack([np.ones_like(t), t]), np.maximum(t - tried[:, None], 0.0)[:, None], y)
    return None if int(np.argmin(left)) in (0, len(tried) - 1) else _lowest(tried, left)


def _lowest(tried: Array, left: Array) -> float:
    """Where `left` is least, between values `tried` at even distances: at an end, or by a parabola."""
    place = int(np.argmin(left))
    if place in (0, len(tried) - 1):
        return float(tried[place])
    low, mid, high = left[place - 1 : place + 2]
    bend = low - 2 * mid + high
    vertex = float(0.5 * (low - high) / bend) if bend > 0 else 0.0  # of the parabola through these, in steps
    return float(tried[place] + vertex * (tried[1] - tried[0]))


def _delayed(t: Array, late: Array) -> Array:
    """1, s, s^2, s^3 of the time s since each of `late`, 0 before, shape (k, 4, n)."""
    since = np.maximum(t - late[:, None], 0.0)
    return np.stack([np.where(t >= late[:, None], 1.0, 0.0), since, since * since, since * since * since], axis=1)


def _filtered(t: Array, constant: Array) -> Array:
    """1, t, t^2, t^3 from t = 0, filtered by first-order filters of each time constant, shape (k, 4, n).

    A constant of 0 or below is a delay.
    """
    early = constant <= 0
    tau = np.where(early, 1.0, constant)[:, None]
    since = np.maximum(t, 0.0)
    found = [1 - np.exp(-since / tau)]
    for n in range(1, ORDER + 1):
        found.append(since**n - n * tau * found[-1])
    columns = np.stack(found, axis=1)
    columns[early] = _delayed(t, constant[early])
    return columns


def _left(windows: Sequence[tuple[Array, Array]], of: Callable[[Array, Array], Array], tried: Array) -> Array:
    """Residual sum of squares for each of `tried` [square of what pulls], shape (k,)."""
    every = [left_by(np.stack([np.ones_like(t), t]), of(t, tried), y) for t, y in windows]
    return np.asarray(np.sum(every, axis=0))


def _best(
    windows: Sequence[tuple[Array, Array]], reach: float, of: Callable[[Array, Array], Array]
) -> tuple[Behind, float, float]:
    """Best delay of one form, its residual sum of squares [square of what pulls], and the variance per sample."""
    tried = np.linspace(-reach, reach, 2 * TRIED - 1)
    left = _left(windows, of, tried)
    least = float(left.min())
    freedom = max(1, sum(len(t) for t, _ in windows) - len(windows) * (ORDER + 3) - 1)
    variance = least / freedom
    best = tried[left <= least * (1 + ALIKE)]
    period = max(float(np.median(np.diff(t))) for t, _ in windows)
    apart = min(2 * TRIED - 1, 1 + 2 * reach / period)
    sure = float(student.ppf(1 - 0.025 / apart, freedom))
    held = tried[left <= least * (1 + ALIKE) + sure**2 * variance]
    time, step = 0.5 * float(best[0] + best[-1]), float(tried[1] - tried[0])
    half = max(time - float(held[0]), float(held[-1]) - time) + step
    return Behind(time, min(half, reach), bool(-reach < best[0] and best[-1] < reach)), least, variance


BETTER = 0.5
"""Turns are accepted where they reduce the rms residual of the gap to this share."""
UNEVEN = 0.2
"""Relative difference that the drift within a cycle may have from a straight line through the cycles."""
LATE = "time between what moves and what pulls"
FINER = 2
"""How often w is searched among steps 20 times finer, until a parabola is exact."""
WIDEST = 0.4
"""Largest w over the stroke."""


@dataclass(frozen=True)
class Axes:
    """Channels of a loop, and names of the phases of its ramps."""

    moved: str = "displacement"
    pulls: str = "force"
    pressures: tuple[str, ...] = ("pressure",)
    rises: str = "contract"
    falls: str = "expand"


OF_A_MUSCLE = Axes()


@dataclass(frozen=True)
class Turns:
    """h: half the gap of the open loop [N]; w: distance in which a turn fades to 1/e [m]; ends of the stroke [m]."""

    h: float
    w: float
    lower: float
    upper: float
    rms: float
    """Of the gap about the fit [N]."""

    def of_mean(self, x: Array) -> Array:
        """Contribution of the turns to the mean of the branches [N] at `x` [m]."""
        first, second = fading(x, self.lower, self.upper, self.w)
        return np.asarray(0.5 * self.h * (first - second))


def fading(x: Array, lower: float, upper: float, w: float | Array) -> tuple[Array, Array]:
    """2/(1 + E) exp(-d1/w) and 2/(1 + E) exp(-d2/w) at `x`, shape (n,) each; (k, n) for `w` (k, 1)."""
    size = 2.0 / (1.0 + np.exp(-(upper - lower) / w))
    return size * np.exp(-(x - lower) / w), size * np.exp(-(upper - x) / w)


def turns_of(x: Array, gap: Array, lower: float, upper: float) -> Turns | None:
    """The turns in a gap [N] at `x` [m], both of shape (n,); None where none are significant.

    The gap of the open loop is a constant, or where that does not fit a parabola over the stroke, as pressure that
    depends on the motion makes it.
    """
    for order in (0, 2):
        found, shown = _found(x, gap, lower, upper, order)
        if shown:
            return found
    return None


def _found(x: Array, gap: Array, lower: float, upper: float, order: int) -> tuple[Turns | None, bool]:
    """The turns with a polynomial of `order` for the gap of the open loop, and whether they are accepted.

    None with too few points, or where the gap has no variation or h is not above 0.
    """
    z, stroke = (2 * x - lower - upper) / (upper - lower), upper - lower
    if len(x) < 8:
        return None, False
    flat = _rms(_beyond(z[:, None] ** np.arange(order + 1), gap))
    if flat <= 1e-9 * float(np.max(np.abs(gap))):
        return None, False
    others = z[:, None] ** np.arange(1, order + 1)
    rest = _beyond(others, gap)

    def solve(w: Array) -> tuple[Array, Array]:
        """Size h and rms of the residual [N] for each w [m], shape (k,); h by variable projection."""
        first, second = fading(x, lower, upper, w[:, None])
        one = _beyond(others, (2.0 - first - second).T)
        h = rest @ one / np.sum(one**2, axis=0)
        return h, np.sqrt(np.mean((rest[:, None] - h * one) ** 2, axis=0))

    tried = np.linspace(np.log(0.5 * float(x[1] - x[0])), np.log(WIDEST * stroke), 40)
    ends = -np.inf, np.inf
    for _ in range(FINER):
        best, step = tried[int(np.argmin(solve(np.exp(tried))[1]))], tried[1] - tried[0]
        ends = max(ends[0], best - step), min(ends[1], best + step)
        tried = np.linspace(*ends, 40)
    w = float(np.exp(_lowest(tried, solve(np.exp(tried))[1])))
    h, rms = (float(found[0]) for found in solve(np.array([w])))
    found = Turns(h, w, lower, upper, rms)
    return (found if h > 0 else None), rms <= BETTER * flat and w < WIDEST * stroke and h > 0


def _beyond(columns: Array, y: Array) -> Array:
    """What least squares by `columns` (n, m) leave of y, shape (n,) or (n, k)."""
    basis, _ = np.linalg.qr(columns)
    return np.asarray(y - basis @ (basis.T @ y))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


POINTS = 81
"""Number of points of the grid."""
FEWEST = 40
"""Fewest samples of a branch between the ends of the grid."""
TURN = 0.05
"""Default share of the stroke that is left out at each end."""
COVERED = 0.9
"""Share of the grid that all branches must cover."""


@dataclass(frozen=True, eq=False)
class Loop:
    """One trial; grids of shape (n,), branches of shape (cycles, n)."""

    x: Array
    """Rising contractions [m]: points of the grid that all branches reach."""
    contracting: Array
    """Force [N]."""
    expanding: Array
    turns: Turns | None
    """The accepted turns; None where there are none."""
    possible: Turns | None
    """The fitted turns, accepted or not; None where none can be fitted."""
    speed: float
    """Speed of the measured displacement [m/s], mean of both directions."""
    pressure: float
    """Mean pressure [Pa] on the grid; nan where it is not recorded."""
    apart: float
    """Mean pressure while expanding minus while contracting [Pa]; nan where it is not recorded."""
    given: Array
    """Work done by the muscle while contracting [J], shape (cycles,)."""
    lost: Array
    """Work lost in the loop [J], -integral of F dx over the whole cycle, shape (cycles,)."""
    last: tuple[Array, Array]
    """Displacement [m] and force [N] of the last cycle, as sampled."""
    noise: float
    """Of the force [N]."""
    drift: Array
    """Increase of the force over each cycle [N], shape (cycles,); it is not in the gap."""
    late: Doubt
    """Possible delay between force and displacement, either way [s]."""
    ends: tuple[float, float]
    """Of the stroke [m]."""
    moments: Array
    """Commanded begin, turn and end of each cycle [s], shape (cycles, 3)."""

    @cached_property
    def gap(self) -> Array:
        """Force while expanding minus force while contracting, without drift [N], shape (cycles, n)."""
        return np.asarray(self.expanding - self.contracting - _between_branches(self.x, self.drift, *self.ends))

    @cached_property
    def raw_mean(self) -> Array:
        """Mean of both branches [N], shape (cycles, n), to which models without hysteresis are compared (paper 3)."""
        return np.asarray(0.5 * (self.expanding + self.contracting))

    @cached_property
    def mean(self) -> Array:
        """`raw_mean` without the contribution of the turns at the ends of the stroke [N]."""
        return self.raw_mean - self.turns.of_mean(self.x) if self.turns is not None else self.raw_mean

    def cropped(self, x: Array) -> Loop:
        """The loop restricted to the grid points that are in `x`."""
        kept = np.isin(np.round(self.x, 9), np.round(x, 9))
        return replace(self, x=self.x[kept], contracting=self.contracting[:, kept], expanding=self.expanding[:, kept])

    @property
    def uneven_drift(self) -> float:
        """Possible difference of the drift of a cycle from a straight line [N]."""
        return max(UNEVEN * float(np.max(np.abs(self.drift))), float(np.ptp(self.drift)))

    @property
    def whole_drift(self) -> float:
        """Possible change of the force since the begin of the trial, mean over its cycles [N]."""
        return 0.5 * float(np.sum(np.abs(self.drift))) * (1 + 1 / len(self.drift))

    @property
    def middle_gap(self) -> Array:
        """Gap at mid stroke [N], mean over the middle tenth of the grid, shape (cycles,)."""
        n = self.x.size
        wide = max(1, n // 20)
        return np.asarray(np.mean(self.gap[:, n // 2 - wide : n // 2 + wide + 1], axis=1))


def measure(run: RunData, trial: TrialData, discard: int, turn: float, axes: Axes = OF_A_MUSCLE) -> Loop:
    """The loop of a trial, without the first `discard` cycles and `turn` [m] at both ends, corrected for sensor lags.

    With other `axes` units are those of their channels: rad for m and N m for N. Raises `NotUsable` where the trial
    ended early, lacks a channel or whole cycles, has too many flagged samples, or went slack.
    """
    cycles, whole = _usable_cycles(trial, discard, axes)
    lower, upper = cycles[0][0].before, cycles[0][0].value
    grid = np.linspace(lower + turn, upper - turn, POINTS)
    if not grid[-1] > grid[0]:
        raise NotUsable("nothing is left of the stroke between its ends")
    trial, good = _followed(trial, axes), trial.usable
    X, Y = on_time(run, trial, axes.moved), on_time(run, trial, axes.pulls)
    P = np.mean([on_time(run, trial, name) for name in axes.pressures], axis=0)
    branches: tuple[list[Array], list[Array]] = ([], [])
    pressures: tuple[list[float], list[float]] = ([], [])
    lines, lost = [], []
    last: tuple[Array, Array] = (np.empty(0), np.empty(0))
    for contract, expand, end in cycles:
        for phase, (begin, until) in enumerate(((contract.t, expand.t), (expand.t, end))):
            rows = _between(trial, begin, until)
            x, F = X[rows], Y[rows]
            moved = (x >= grid[0]) & (x <= grid[-1])
            if int(moved.sum()) < FEWEST:
                raise NotUsable(f"fewer than {FEWEST} samples between the ends of a ramp")
            lines.append(np.polyfit(trial.t[rows][moved] - expand.t, x[moved], 1))
            pressures[phase].append(float(np.mean(P[rows][moved])))
            slack = (trial.flags[rows] & np.uint16(Flag.SLACK)) != 0
            branches[phase].append(on_grid(grid, x, np.where(slack, np.nan, F)))
        rows = _between(trial, contract.t, end)
        last = X[rows], Y[rows]
        lost.append(lost_work(*last))
    contracting, expanding = (np.array(branch) for branch in branches)
    known = _reached(contracting + expanding, trial, Y[whole], axes)
    contracting, expanding, x = contracting[:, known], expanding[:, known], grid[known]
    level = 0.5 * (contracting + expanding).mean(axis=1)
    drift = np.gradient(level) if len(level) > 1 else np.zeros(1)
    gap = (expanding - contracting - _between_branches(x, drift, lower, upper)).mean(axis=0)
    turns, speed = turns_of(x, gap, lower, upper), float(np.mean([abs(slope) for slope, _ in lines]))
    fades = 0.02 * (upper - lower) if turns is None else turns.w
    moments = sorted([expand.t for _, expand, _ in cycles] + [contract.t for contract, _, _ in cycles[1:]])
    return Loop(
        x, contracting, expanding, turns, turns or _found(x, gap, lower, upper, 0)[0], speed,
        pressure=float(np.mean(pressures[0] + pressures[1])),
        apart=float(np.mean(pressures[1]) - np.mean(pressures[0])),
        given=_given(trial.t[good], X[good], Y[good], cycles, lines),
        lost=np.array(lost) - 0.5 * drift * (upper - lower),
        last=last,
        noise=noise_of(Y[whole]),
        drift=drift,
        late=_late(run, trial, (X, Y), moments, fades / speed, axes),
        ends=(lower, upper),
        moments=np.array([(contract.t, expand.t, end) for contract, expand, end in cycles]),
    )  # fmt: skip


def _given(
    t: Array, x: Array, F: Array, cycles: Sequence[tuple[Command, Command, float]], lines: Sequence[Array]
) -> Array:
    """Work done while contracting [J], shape (cycles,), from turn to turn of the motion.

    `lines` are slope and start of each branch over the time since the commanded turn of its cycle; the motion turns
    where the two of a cycle intersect. This is used because drives turn late and gradually, and noise hides the last
    sample of a branch.
    """
    pairs = zip(lines[::2], lines[1::2], strict=True)
    late = float(np.median([(two[1] - one[1]) / (one[0] - two[0]) for one, two in pairs]))
    done = np.append(0.0, np.cumsum(0.5 * (F[1:] + F[:-1]) * np.diff(x)))
    turned = np.array([(contract.t, expand.t) for contract, expand, _ in cycles]) + late
    return np.asarray(np.diff(np.interp(turned, t, done), axis=1)[:, 0])


def _reached(forces: Array, trial: TrialData, seen: Array, axes: Axes) -> NDArray[np.bool_]:
    """Mask of grid points that all branches reach, from forces (cycles, n); raises `NotUsable` with too few."""
    known = np.isfinite(forces).all(axis=0)
    if known.mean() < COVERED and trial.point.get("pressure", 1.0) > 0:
        reached = show(float(np.nanmin(seen)), CHANNEL_QUANTITY[axes.pulls], 3)
        raise NotUsable(f"its branches cover {known.mean():.0%} of the stroke; {axes.pulls} down to {reached}: slack?")
    if not known.any():
        raise NotUsable("the specimen was slack over the whole stroke")
    return np.asarray(known)


def _between_branches(x: Array, drift: Array, lower: float, upper: float) -> Array:
    """Contribution of a drift to the gap [N], shape (cycles, n): at `lower` the branches are a whole cycle apart."""
    return np.asarray(np.outer(drift, (upper - x) / (upper - lower)))


def _late(
    run: RunData, trial: TrialData, channels: tuple[Array, Array], moments: Sequence[float], span: float, axes: Axes
) -> Doubt:
    """Doubt about a delay between force and displacement, from the record and from the turns."""
    good, known, (x, F), lag = trial.usable, lag_open(run, axes.pulls), channels, lag_of(run, axes.pulls)
    shown = behind(trial.t[good], x[good], F[good], moments, span)
    sample = float(np.median(np.diff(trial.t)))
    if lag > 0 and through_filter(trial.t[good], x[good], trial.channels[axes.pulls][good], moments, lag):
        shown = None  # a filter as declared: on a branch it is a delay, which is taken off, and at a turn it is none
    if shown is None:
        return Doubt(LATE, "method", max(known, 2 * sample), False)
    doubtful = shown.half + 0.5 * sample
    seen = abs(shown.time) > doubtful + known
    way, channel = ("behind", axes.pulls) if shown.time > 0 else ("ahead of", axes.moved)
    size = f"{1e3 * abs(shown.time):.2g} ms" if shown.within else "far"
    reason = (
        f"at its turns the {axes.pulls} is {size} {way} the {axes.moved}, and that looks like hysteresis or damping: "
        f"look at the {channel} sensor (a filter, backlash, another clock), and declare its `sensor_lag`"
    )
    if shown.time > 0:
        reason += "; or friction builds up on a small way, which at another speed is the same way and not the same time"
    most = 1.5 * abs(shown.time) + doubtful  # of a filter the turns may show a part
    return Doubt(LATE, "method", max(known, most), seen, reason)


def measure_as_planned(run: RunData, trial: TrialData) -> Loop:
    """`measure` with `discard` and `turn` of the plan, else the defaults."""
    settings = settings_of(run)
    stroke = trial.point.get("upper", 0.0) - trial.point.get("lower", 0.0)
    return measure(run, trial, int(settings.get("discard", 1)), float(settings.get("turn", TURN * stroke)))


def _followed(trial: TrialData, axes: Axes) -> TrialData:
    """The trial with motion and force interpolated between new values where they are read less often than recorded."""
    names = {axes.moved, axes.pulls} & set(trial.channels)
    return replace(
        trial, channels={**trial.channels, **{name: between_new(trial.t, trial.channels[name])[0] for name in names}}
    )


def _usable_cycles(
    trial: TrialData, discard: int, axes: Axes
) -> tuple[list[tuple[Command, Command, float]], NDArray[np.bool_]]:
    """The cycles to measure, and the mask of samples in them; raises `NotUsable`."""
    refuse_incomplete(trial, axes.moved, axes.pulls)
    cycles = _cycles(trial, axes)[discard:]
    if not cycles:
        raise NotUsable("it holds no whole cycle beyond those left out")
    whole = (trial.t >= cycles[0][0].t) & (trial.t < cycles[-1][2])
    refuse_flagged(trial.usable[whole] if whole.any() else np.zeros(1, dtype=bool))
    return cycles, whole


def _cycles(trial: TrialData, axes: Axes) -> list[tuple[Command, Command, float]]:
    """Whole cycles: the contracting ramp, the expanding ramp, and the end of that [s]."""
    ramps = [c for c in trial.commands if c.output == axes.moved and c.kind == "ramp"]
    found = []
    for one, two in pairwise(ramps):
        if one.phase != axes.rises or two.phase != axes.falls:
            continue
        end = ends(two) if two.data.get("rate", 0.0) > 0 else float(trial.t[-1])
        if end <= float(trial.t[-1]) + 2 * float(np.median(np.diff(trial.t))):
            found.append((one, two, end))
    return found


def _between(trial: TrialData, begin: float, end: float) -> NDArray[np.intp]:
    return np.flatnonzero((trial.t >= begin - 1e-9) & (trial.t < end - 1e-9) & trial.usable)


def on_grid(grid: Array, x: Array, F: Array) -> Array:
    """Means of `F` about each point of an even `grid`, from samples of one branch, shape (n,); NaN beyond them."""
    step = grid[1] - grid[0]
    known = np.isfinite(F)
    place = np.floor((x[known] - grid[0]) / step + 0.5).astype(int) + 1
    inside = (place >= 0) & (place < len(grid) + 2)
    place, x, F = place[inside], x[known][inside], F[known][inside]
    count = np.bincount(place, minlength=len(grid) + 2)
    filled = count > 0
    if filled.sum() < 2:
        return np.full(grid.shape, np.nan)
    mean_x = np.bincount(place, x, len(grid) + 2)[filled] / count[filled]
    mean_F = np.bincount(place, F, len(grid) + 2)[filled] / count[filled]
    return np.interp(grid, mean_x, mean_F, left=np.nan, right=np.nan)


def stiffness_of(run: RunData, trial: TrialData) -> float:
    """Stiffness [N/m]: negative slope of the mean curve of one trial; raises `NotUsable`."""
    loop = measure_as_planned(run, trial)
    return -float(np.polyfit(loop.x, loop.mean.mean(axis=0), 1)[0])
