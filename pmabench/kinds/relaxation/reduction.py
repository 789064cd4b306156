"""Reduction of relaxation: s per decade, force at 1 s, exponentials, at each contraction and pressure.

One trial is the force after the step divided by the measured pressure. A straight line over log t and exponentials are
fitted to means over equal parts of log t, so that each decade has the same weight. Also the figure, and with
`one_trial` the values of one trial for the display.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log10, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from pmabench.analysis.shared import student
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.samples import NotUsable, autocorrelation, noise_of, refuse_unusable, settings_of
from pmabench.analysis.shared.student import half_of_trials
from pmabench.analysis.shared.trials import Reduction
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.relaxation import RESULTS
from pmabench.plotting.chart import PALETTE, Chart, Series
from pmabench.plotting.pictures import (
    Picture,
    column,
    has,
    head,
    of_traces,
    spread,
    unit_of,
)
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, Command, RunData, TrialData

PER_DECADE = 20
"""Means in each decade of time."""
TIMES = (1.0, 10.0, 100.0, 1000.0)
"""Time constants of the exponentials [s]."""
JUMPS_OVER, JUMPS, LEAST_JUMP = 9, 8.0, 5e-3
"""Samples on either side of a jump; a jump in usual differences between them, and as a share of the force."""
LONGEST_LAG = 0.1
"""Longest lag of the noise's correlation, as a share of the samples."""


@dataclass(frozen=True, eq=False)
class Relaxing:
    """Samples y at equally spaced times t [s] after a step, shape (n,)."""

    t: Array
    y: Array

    @cached_property
    def _parts(self) -> NDArray[np.intp]:
        """Index of the part of log t for each sample; empty parts are not counted."""
        place = np.log10(self.t / self.t[0]) * PER_DECADE
        return np.asarray(np.unique(place.astype(int), return_inverse=True)[1])

    @cached_property
    def _count(self) -> NDArray[np.intp]:
        return np.bincount(self._parts)

    def means(self, values: Array) -> Array:
        """Means of values (n,) over the parts, shape (parts,)."""
        return np.asarray(np.bincount(self._parts, values) / self._count)

    @cached_property
    def decades(self) -> Array:
        """Mean of log10 t in each part."""
        return self.means(np.log10(self.t))

    def slope_weights(self, low: float = 0.0, high: float = 1.0) -> Array:
        """Weights of samples whose sum with y is the slope over log10 t, from shares `low` to `high` of the decades."""
        u = (self.decades - self.decades[0]) / (self.decades[-1] - self.decades[0])
        rows = (u >= low - 1e-9) & (u <= high + 1e-9)
        off = np.where(rows, self.decades - self.decades[rows].mean(), 0.0)
        return self._of_parts(off / np.sum(off**2))

    @cached_property
    def bent(self) -> float:
        """Value at t = 1 s of a parabola over log10 t minus that of the straight line [as y]."""
        return float(np.polyfit(self.decades, self.means(self.y), 2)[2]) - self.line[0]

    @cached_property
    def jump(self) -> tuple[float, float]:
        """The largest step between two samples that a course over log t cannot have, and its time; 0 without one.

        What the line through the medians of the next samples before and after has, is no step.
        """
        over, n = np.log10(self.t), JUMPS_OVER

        def steps(y: Array) -> Array:
            near = np.median(np.lib.stride_tricks.sliding_window_view(y, n), axis=1)
            return np.asarray(1.5 * (near[2 * n : -n] - near[n : -2 * n] - (near[3 * n :] - near[: -3 * n]) / 3))

        found, beyond = steps(self.y), np.abs(steps(self.y - np.polyval(np.polyfit(over, self.y, 1), over)))
        if not len(found):
            return 0.0, 0.0
        least = max(JUMPS * float(np.median(beyond)) / 0.6745, LEAST_JUMP * abs(float(self.y.mean())))
        place = int(np.argmax(np.abs(found) * (beyond > least)))
        return (float(found[place]), float(self.t[place + 2 * n])) if beyond[place] > least else (0.0, 0.0)

    def _of_parts(self, weights: Array) -> Array:
        """Weights of samples from those of the parts' means."""
        return np.asarray((weights / self._count)[self._parts])

    @cached_property
    def line(self) -> tuple[float, float]:
        """Value at t = 1 s and slope of the straight line over log10 t [as y]."""
        slope = float(self.slope_weights() @ self.y)
        return float(self.means(self.y).mean() - slope * self.decades.mean()), slope

    def _correlation(self, order: int) -> tuple[Array, float]:
        """Autocovariance of the noise by lag, and the number of independent samples.

        Noise is the residual of a polynomial of `order` over log t. Lags are tapered (Bartlett).
        """
        left = self.y - np.polyval(np.polyfit(self.decades, self.means(self.y), order), np.log10(self.t))
        n, most = len(left), max(1, int(LONGEST_LAG * len(self.t)))
        tapered = autocorrelation(left, most) / n * (1 - np.arange(most + 1) / (most + 1))
        total = tapered[0] + 2 * float(np.sum(tapered[1:]))
        alike = max(1.0, total / tapered[0]) if tapered[0] > 0 else 1.0
        return tapered, n / alike

    def half(self, weights: Array, order: int = 1) -> float:
        """Half width of the 95 % interval of the sum of `weights` (n,) and y, from its correlated noise.

        Noise is the residual of the straight line, so it includes a bend; with `order` 3 it does not.
        """
        covariance, independent = self._correlation(order)
        own = autocorrelation(weights, len(covariance) - 1)
        variance = own[0] * covariance[0] + 2 * float(own[1:] @ covariance[1:])
        white = own[0] * covariance[0]
        return float(student.ppf(0.975, max(independent - 2, 2))) * sqrt(max(variance, white, 0.0))

    @cached_property
    def prony(self) -> tuple[Array, Array, float]:
        """Constant and sizes of exponentials of `TIMES` (5,), their half widths (5,), and the rms residual [y].

        The half widths ignore the bound at 0; inf for a term that the samples do not show.
        """
        design = np.column_stack([np.ones(len(self._count)), *(self.means(np.exp(-self.t / T)) for T in TIMES)])
        sizes, left = nnls(design, self.means(self.y))
        shown = [0, *(1 + i for i, T in enumerate(TIMES) if self.shows(T))]
        inverse = np.linalg.pinv(design[:, shown])
        halves = np.full(len(TIMES) + 1, np.inf)
        for row, term in zip(inverse, shown, strict=True):
            halves[term] = self.half(self._of_parts(row))
        return np.asarray(sizes), halves, float(left) / sqrt(len(self._count))

    def shows(self, T: float) -> bool:
        """Whether the time constant T [s] of an exponential lies within the samples."""
        return bool(self.t[0] <= T <= self.t[-1])


FEWEST_DECADES = 1.0
"""Decades of time that a slope needs."""
MOST_POINTS = 8000
"""Most time steps in which a hold is averaged."""
SEEN = 2.0
"""Half widths from which on a bend over log t is significant."""
CALM = 2.0
"""Time before the step and at the end of the trial whose mean is the zero of the force [s]."""
UNLIKE = 1.5
"""Factor by which an earlier hold may have relaxed more than this one."""
ZERO_SEEN = 6.0
"""Change of the force without pressure, in its noise, from which on it is attributed to the cell."""
UNPROPORTIONAL = 3.0
"""Bound for the force growing faster than in proportion to the pressure: reached by a muscle at a quarter of its force
without contraction.
"""
BEND, BEFORE, ZERO, JUMP = "bend over log t", "holds before", "zero of the force", "jump of the force"


@dataclass(frozen=True)
class Bend:
    """Difference between slopes of parts of a hold, per decade [1], and whether it is significant."""

    size: float
    seen: bool


@dataclass(frozen=True, eq=False)
class Course:
    """The force of one trial from `begin` on, at the nominal pressure."""

    trial: TrialData
    relaxing: Relaxing
    raw: Relaxing
    """The same without division by the measured pressure."""
    zero: float
    """Change of the force without pressure over the trial [N]."""
    noise: float
    """Noise of the force's mean before the step [N]."""
    rise: float
    """Time until the pressure is reached [s]."""
    off: float
    """Relative deviation of the mean pressure from that of the step [1]."""
    before: tuple[tuple[float, float, float], ...]
    """Earlier holds of the run: pressure relative to this one [1], start and end as times before this step [s]."""
    drifted: float = 0.0
    """Change of the force without pressure since the start of the run [N], if it went on as within this trial."""

    @property
    def start(self) -> float:
        """Force F_1 of the line at 1 s [N]."""
        return self.relaxing.line[0]

    @cached_property
    def per_decade(self) -> float:
        """Share s of F_1 that is lost in each decade [1]."""
        start, slope = self.relaxing.line
        return -slope / start

    @cached_property
    def half(self) -> float:
        """Half width of s from the noise [1]."""
        return self.relaxing.half(self.relaxing.slope_weights()) / abs(self.start)

    @cached_property
    def bend(self) -> Bend:
        """Largest difference between slopes of parts of the decades: early and late half, middle third and outer
        thirds.
        """
        one = self.relaxing
        outer = 0.5 * (one.slope_weights(0.0, 1 / 3) + one.slope_weights(2 / 3, 1.0))
        early, late, middle = (one.slope_weights(a, b) for a, b in ((0.0, 0.5), (0.5, 1.0), (1 / 3, 2 / 3)))
        found = []
        for weights in (late - early, middle - outer):
            size = abs(float(weights @ one.y))
            found.append(Bend(size / abs(self.start), size > SEEN * one.half(weights, order=3)))
        return max(found, key=lambda bend: (bend.seen, bend.size))

    @property
    def left_behind(self) -> float:
        """Effect of earlier holds on the force at 1 s [N], if they relax up to `UNLIKE` times as much as this one."""
        return UNLIKE * abs(self.start * self.per_decade * sum(P * log10((1 + a) / (1 + b)) for P, a, b in self.before))

    def doubts_of_start(self) -> list[Doubt]:
        """Effects on F_1 [N]: the line is read at 1 s, away from the middle of the decades that give its slope."""
        one, away = self.relaxing, abs(self.start * float(self.relaxing.decades.mean()))
        bend = self.bend
        # if parts differ, the slope before the first of them is unknown
        off = max(abs(one.bent), away * bend.size if bend.seen else 0.0)
        reason = (
            f"parts of the hold relax by {bend.size:.2%} per decade unlike each other: the line may be "
            f"{show(off, 'force', 2)} off at 1 s. Begin earlier"
        )
        # the effect of earlier holds at 1 s is known better from `left_behind`
        others = [d for d in self.doubts() if d.name not in {BEND, BEFORE, ZERO, JUMP}]
        seen = abs(self.zero) > ZERO_SEEN * self.noise
        text = f"without pressure the cell may read {self.drifted:+.3g} N more than at first: zero it, and look "
        return [
            Doubt(BEND, "method", off, bend.seen, reason),
            Doubt(ZERO, "drift", abs(self.drifted), seen, f"{text}for what warms it"),
            *(Doubt(d.name, d.part, away * d.half, d.seen) for d in others),
        ]

    def doubts(self) -> list[Doubt]:
        """Effects of other causes than the rubber on s [1]."""
        one, F, s = self.relaxing, self.start, abs(self.per_decade)
        weights = one.slope_weights()
        bend, (start, slope) = self.bend, self.raw.line
        ends = float(weights @ (self.zero * one.t / one.t[-1])) / F
        left = UNLIKE * sum(
            P * float(weights @ np.log10((one.t + begin) / (one.t + end))) for P, begin, end in self.before
        )
        other = -slope / start - self.per_decade
        moment = float(weights @ np.log10((one.t + self.rise / 2) / one.t))
        bent = (
            f"parts of the hold relax by {bend.size:.2%} per decade unlike each other: this is no straight line over "
            "log t. Hold longer, or take the exponentials"
        )
        zero = (
            f"without pressure the cell reads {self.zero:+.3g} N after the trial, against before: zero the cell, and "
            "look for what warms it"
        )
        before = f"what the holds before left behind changes s by about {abs(s * left):.2%} per decade: rest longer"
        pressure = f"the pressure changes along the hold: without it s would be {other:+.2%} per decade other"
        return [
            Doubt(BEND, "method", abs(bend.size / 2), bend.seen, bent),
            Doubt(ZERO, "drift", abs(ends), abs(self.zero) > ZERO_SEEN * self.noise, zero),
            Doubt(BEFORE, "drift", abs(s * left), bool(self.before), before),
            Doubt("pressure", "method", UNPROPORTIONAL * abs(other), False, f"{pressure}. Look at the regulator"),
            Doubt("moment of the step", "method", abs(s * moment), False),
            Doubt(JUMP, "drift", abs(self.jumped.line[1] / F), bool(one.jump[0]), self.of_jump if one.jump[0] else ""),
        ]

    @property
    def jumped(self) -> Relaxing:
        """What the jump adds to the force [N]."""
        size, since = self.relaxing.jump
        return replace(self.relaxing, y=np.where(self.relaxing.t >= since, size, 0.0))

    @property
    def of_jump(self) -> str:
        """The sentence about the jump of the force."""
        size, since = self.relaxing.jump
        return (
            f"{since:.0f} s after the step of trial {self.trial.number} the force jumps by {size / self.start:+.1%}, "
            "not with the pressure: the gain of the cell or of the gauge changed, or a mount slipped. Whether trials "
            "before or after it are right is not known. Look for the cause, and measure again"
        )


def measure(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Course:
    """Evaluation of one trial; `NotUsable` where it ended early, lacks a channel, or has too few decades."""
    refuse_unusable(trial, "pressure", "force")
    step, end = _step(trial)
    if end >= trial.t[-1]:
        raise NotUsable(
            f"it ends under pressure: without {CALM:g} s after the vent a drift of the cell looks like relaxation"
        )
    begin = float(settings_of(run, options).get("begin", 5.0))
    t, F, P = (values[trial.usable] for values in (trial.t, trial.channels["force"], trial.channels["pressure"]))
    calm, last = (t >= step.t - CALM) & (t < step.t), t > t[-1] - CALM
    held = (t > step.t) & (t < end)
    if min(calm.sum(), last.sum(), held.sum()) < 8:
        raise NotUsable("fewer than 8 samples before the step, in the hold or after it")
    final, base = float(np.median(P[held])), float(P[calm].mean())
    risen = (P[held] - base) / (final - base) if abs(final - base) > 0 else np.zeros(held.sum())
    if not (risen > 0.95).any() or final <= 0:
        raise NotUsable("the pressure does not follow the step")
    half_way, there = (float(t[held][np.argmax(risen > share)]) for share in (0.5, 0.95))
    since = t - half_way
    rows = held & (since >= begin)
    decades = log10((end - half_way) / begin) if 0 < begin < end - half_way else 0.0
    if decades < FEWEST_DECADES:
        raise NotUsable(
            f"the hold has {decades:.1f} decades of time from {begin:g} s on, {FEWEST_DECADES:g} are needed: hold for "
            f"{begin * 10**FEWEST_DECADES:.0f} s or more"
        )
    even, divided, plain = _even(since[rows], F[rows] * step.value / P[rows], F[rows])
    if np.mean(divided) <= 6 * noise_of(F[calm]):
        raise NotUsable("the force is not above its noise: the muscle is slack at this contraction and pressure")
    # pressure remaining after the vent makes force: that part is no change of the cell
    change = float(F[last].mean() - F[calm].mean())
    pulls = float((P[last].mean() - base) / (final - base) * np.mean(divided))
    zero = change - float(np.clip(pulls, min(change, 0.0), max(change, 0.0)))
    return Course(
        trial=trial,
        relaxing=Relaxing(even, divided),
        raw=Relaxing(even, plain),
        zero=zero,
        noise=noise_of(F[calm]) / float(np.sqrt(calm.sum())),
        rise=there - step.t,
        off=abs(float(P[rows].mean()) / step.value - 1),
        before=_earlier(run, trial, step),
        drifted=zero * max(1.0, float((t[-1] - run.trials[0].t[0]) / (t[-1] - t[0]))),
    )


def _step(trial: TrialData) -> tuple[Command, float]:
    """The command of the step, and the end of its hold, when the next pressure command comes [s]."""
    commands = [c for c in trial.commands if c.output == "pressure"]
    for i, command in enumerate(commands):
        if command.phase == "step":
            return command, commands[i + 1].t if i + 1 < len(commands) else float(trial.t[-1])
    raise NotUsable("it holds no step of pressure")


def _earlier(run: RunData, trial: TrialData, step: Command) -> tuple[tuple[float, float, float], ...]:
    """Earlier holds of the run, from their commands; see `Course.before`."""
    found = []
    for other in run.trials:
        if other.t.size and other.t[0] < trial.t[0]:
            try:
                begin, end = _step(other)
            except NotUsable:
                continue
            found.append((begin.value / step.value, step.t - begin.t, step.t - end))
    return tuple(found)


def _even(t: Array, *values: Array) -> list[Array]:
    """Times and values as means over equal time steps; raises `NotUsable` if one is empty."""
    gap = 1.5 * float(np.max(np.diff(t)))
    count = max(8, min(MOST_POINTS, int((t[-1] - t[0]) / gap)))
    place = np.minimum(((t - t[0]) / (t[-1] - t[0]) * count).astype(int), count - 1)
    number = np.bincount(place, minlength=count)
    if (number == 0).any():
        raise NotUsable("there are gaps in the hold")
    return [np.bincount(place, column, count) / number for column in (t, *values)]


KIND = "relaxation"
LINE, PRONY = "relaxation, log t", "relaxation, Prony"
LEAST = 0.05
"""Smallest s per decade to which effects are compared [1]: 2 % of it is the wanted accuracy of 0.1 % per decade."""
ALONE = (
    "one trial at each operating point: a cell whose gain changes between two trials, or within the begin of a hold, "
    "gives forces that another muscle would have, and nothing shows it. Do the first operating point again at the end"
)
ONE = "one trial: the repeats part is its noise, and repeated tests may scatter more"


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Relaxation s [1 per decade], F_1 [N] and shares g [1] of exponentials at each contraction [m] and pressure [Pa].

    F = F_1 (1 - s log10(t/1 s)), with t counted from half of the pressure step, used from `begin` on. `options`:
    `begin` [s], in place of the plan's.
    """
    result = Reduction.of(KIND, RESULTS, runs, options, measure)
    cells, jumps = result.cells(_place), [one for one in result.measured if one.relaxing.jump[0]]
    for (x, P), group in cells:
        at = {"pressure": P, "contraction": x}
        result.estimates += [*_line(at, group, result.scales, jumps), *_prony(at, group, result.scales)]
        result.traces.append(_trace(x, P, group[0]))
    result.findings += [Finding("doubt", one.of_jump) for one in jumps]
    if 1 < len(cells) == len(result.measured):
        result.findings.append(Finding("note", ALONE))
    result.estimates.sort(key=lambda e: e.method != LINE)
    result.note_lack(("force",))
    return result.analysis(cells=len(cells))


def _place(one: Course) -> tuple[float, float]:
    """Contraction [m] and pressure [Pa] of a trial."""
    point = one.trial.point
    return round(point.get("contraction", 0.0), 6), round(point.get("pressure", 0.0), 3)


def _line(at: Mapping[str, float], group: Sequence[Course], scales: Scales, jumps: Sequence[Course]) -> list[Estimate]:
    """Relaxation s and F_1 of one cell, with the largest doubts of its trials; `jumps` are the trials with a jump."""
    names = tuple(one.trial.name for one in group)
    note = ONE if len(group) == 1 else ""
    s, F = [one.per_decade for one in group], [one.start for one in group]
    half = half_of_trials(s, [one.half for one in group])
    level, P = float(np.mean(F)), at.get("pressure", 0.0)
    # the force is scaled to the pressure of the step, and relaxation is relative to the force
    zeros = {"force": 1.0} | ({"pressure": level / P} if P > 0 else {})
    by_zero = scales.part({}, {"force": float(np.mean(s)) / level}) if level else None
    n, parts = len(group), Parts(half, calibration=by_zero)
    slope = Estimate("s", float(np.mean(s)), "1", "ratio", LINE, dict(at), parts, n, note=note, trials=names)
    whole = [one.relaxing.half(np.full(len(one.relaxing.t), 1 / len(one.relaxing.t))) for one in group]
    noise = [one.half * one.start * float(one.relaxing.decades.mean()) + w for one, w in zip(group, whole, strict=True)]
    by_scales = scales.part(dict.fromkeys(("force", "pressure"), level), zeros)
    parts = Parts(half_of_trials(F, noise), calibration=by_scales)
    start = Estimate("F_1", level, "N", "force", LINE, dict(at), parts, n, note=note, trials=names)
    left = Doubt(BEFORE, "drift", max(one.left_behind for one in group), seen=False)
    # the scaling to the pressure of the step assumes a proportional force
    most = UNPROPORTIONAL * max(one.off * abs(one.start) for one in group)
    share = Doubt("mean pressure", "method", most, seen=False)
    doubts, of_start = _largest([one.doubts() for one in group]), _largest([one.doubts_of_start() for one in group])
    # what was right, the trials before the jump or those after it, is not known
    of_start += [
        Doubt(JUMP, "drift", level * abs(one.relaxing.jump[0] / one.start) + own, True, one.of_jump)
        for one in jumps
        for own in [abs(one.jumped.line[0]) if one in group else 0.0]
    ]
    return [weighed(slope, doubts, max(LEAST, abs(slope.value or 0.0))), weighed(start, [*of_start, left, share])]


def _largest(of_trials: Sequence[Sequence[Doubt]]) -> list[Doubt]:
    """For each kind of doubt the largest of all trials, significant ones first."""
    return [max(same, key=lambda d: (d.seen, d.half)) for same in zip(*of_trials, strict=True)]


def _prony(at: Mapping[str, float], group: Sequence[Course], scales: Scales) -> list[Estimate]:
    """Shares of the exponentials of one cell."""
    found = []
    names = tuple(one.trial.name for one in group)
    fits, level = [one.relaxing.prony for one in group], float(np.mean([one.start for one in group]))
    begin, end = (group[0].relaxing.t[i] for i in (0, -1))
    for i, T in enumerate(TIMES, 1):
        size, parts = None, Parts()
        note = f"the samples are from {begin:.3g} to {end:.3g} s after the step and do not show {show(T, 'time')}"
        if all(one.relaxing.shows(T) for one in group):
            values = [sizes[i] / one.start for (sizes, _, _), one in zip(fits, group, strict=True)]
            noise = [halves[i] / one.start for (_, halves, _), one in zip(fits, group, strict=True)]
            size, note = float(np.mean(values)), ONE if len(group) == 1 else ""
            parts = Parts(half_of_trials(values, noise), calibration=scales.part({}, {"force": size / level}))
        found.append(
            Estimate("g", size, "1", "ratio", PRONY, dict(at), parts, len(group), note=note, trials=names,
                     coordinate=show(T, "time"))
        )  # fmt: skip
    return found


def _trace(x: float, P: float, course: Course) -> Trace:
    """Means over equal parts of log t, with line and exponentials."""
    one = course.relaxing
    start, slope = one.line
    sizes = one.prony[0]
    curve = sizes[0] + sum(size * one.means(np.exp(-one.t / T)) for size, T in zip(sizes[1:], TIMES, strict=True))
    columns = {"t": 10**one.decades, "force": one.means(one.y), "line": start + slope * one.decades, "curve": curve}
    quantities = {name: "time" if name == "t" else "force" for name in columns}
    title = f"{show(x, 'length')}, {show(P, 'pressure')}: force over time after the step"
    return Trace(f"relaxation-{x:g}-{P:g}", "relaxation", title, columns, quantities, {"s": course.per_decade})


def per_decade(run: RunData, trial: TrialData) -> float:
    """Relaxation s of one trial [1]; raises `NotUsable`."""
    return measure(run, trial, {}).per_decade


COURSES = 4


def courses(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure with the force over log t of all points."""
    able = [t for t in traces if has(t, "t", "force", "line")]
    chosen = spread(able, COURSES)
    if not chosen:
        return []
    labels = "decades of time after the step, log10(t / 1 s)", unit_of(chosen[0], "force").label("force")
    values = "".join(f"; {head(t)}: s = {t.marks['s']:.2%} per decade" for t in chosen)
    caption = (
        "Marks: means of the force over equal parts of log t, the pressure divided out; lines: F = F_1 (1 − s log10 t)"
        f"{values}."
    )
    series = [one for i, trace in enumerate(chosen) for one in _series(trace, PALETTE[i % len(PALETTE)])]
    charts = [[Chart(*labels, tuple(series), legend=True)]]
    return [of_traces(charts, "Force over time after the step", caption, analysis, chosen, able)]


def _series(trace: Trace, color: str) -> list[Series]:
    x = np.log10(column(trace, "t"))
    return [Series("", x, column(trace, "line"), color), Series(head(trace), x, column(trace, "force"), color, "o")]


def one_trial(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Relaxation per decade and force at 1 s, with doubts about other causes."""
    try:
        course = measure(run, trial, {})
    except NotUsable as reason:
        return [Measured("s", "ratio", None)], [str(reason)]
    doubts = [one.reason for one in course.doubts() if one.seen and one.half > course.half]
    s = Measured("s", "ratio", course.per_decade, noise=course.half)
    return [s, Measured("F_1", "force", course.start)], doubts
