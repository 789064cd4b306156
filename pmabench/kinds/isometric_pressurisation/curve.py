"""Force over pressure at one contraction: both branches in bins, the straight part, and where the force begins.

Works on the tests of one contraction, without a model over contractions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Any

import numpy as np

from pmabench.analysis.shared import isometric_lines, skew
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.isometric_lines import METHOD, Line, Mask, Pooled, Test, by_repeat, spread
from pmabench.analysis.shared.samples import SEEN, ends, noise_of, onset
from pmabench.analysis.shared.trials import thinned
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import Array, RunData, TrialData

PHASES = ("fill", "empty")
BINS = 50
SHIFTS = 20
"""Number of bin offsets that are tried so that no bin edge lies in a hold of a staircase."""
WITHIN = 0.02
"""Largest distance of the straight part from its line, and force below its start, as a share of the span."""
SHORTEST = 0.5
"""Smallest straight part, as a share of the bins with force."""
FEWEST_BINS, FEWEST_HOLDS = 5, 3
REST = 1.0
"""Rest before and after the ramps that is evaluated [s]."""
BRIDGED = 3.5
"""Gap between bins, in their widths, across which values are interpolated."""
BEYOND = 1.3
"""Factor on the change by a parabola, for a bend that is not corrected."""
FURTHEST = 10.0
"""A larger displacement reading is invalid [m]."""


@dataclass(frozen=True, eq=False)
class Mean:
    """The mean curve of the tests of one contraction, and the branches of each; shape (bins,), (tests, bins)."""

    P: Array
    """Middle of each bin [Pa]."""
    fill: Array
    """Mean force while the pressure rises [N]; NaN where there is no sample."""
    empty: Array
    """Mean force while it falls [N]."""
    held: bool = False
    """Whether the pressure was a staircase, of which only the holds count."""

    @property
    def each(self) -> Array:
        """Mean of both branches of each test [N]."""
        return np.asarray(0.5 * (self.fill + self.empty))

    @property
    def force(self) -> Array:
        """Mean over the tests that have the bin [N]."""
        known = np.isfinite(self.each)
        total = np.where(known, self.each, 0.0).sum(axis=0)
        return np.asarray(np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan))

    def of(self, rows: Mask) -> Mean:
        """The same for some of the tests."""
        return Mean(self.P, self.fill[rows], self.empty[rows], self.held)

    @property
    def opened(self) -> tuple[Array, Array, float]:
        """Pressures [Pa], the gap there over all tests [N], and its median in the middle half of the pressures [N]."""
        known = np.isfinite(self.empty - self.fill)
        seen = known.any(axis=0)
        gap = np.where(known, self.empty - self.fill, 0.0).sum(axis=0)[seen] / known.sum(axis=0)[seen]
        middle = np.abs((self.P[seen] - self.P[0]) / (self.P[-1] - self.P[0]) - 0.5) < 0.25
        return self.P[seen], gap, float(np.median(gap[middle] if middle.any() else gap)) if seen.any() else 0.0

    @property
    def turned(self) -> tuple[Array, Array]:
        """Pressures [Pa], and excess of the mean of both branches over the middle of the fully open loop there [N].

        Half the difference between the gap, where the loop has not opened or closed yet, and that of the middle half of
        the pressures. There both branches are near the one just left: the mean is too high at the lower end, too low at
        the upper one.
        """
        P, gap, usual = self.opened
        return P, np.copysign(0.5 * np.abs(gap - usual), 0.5 * (self.P[0] + self.P[-1]) - P)

    def gaps(self, low: float) -> Array:
        """Force while emptying minus while filling of each test, mean over the pressures above `low` [Pa] [N].

        The highest pressure of a staircase, one hold for both directions, is left out.
        """
        gap = self.empty - self.fill
        high = self.P[np.isfinite(gap).any(axis=0)].max(initial=0.0)
        part = gap[:, (self.P >= low) & ((self.P < high) | (not self.held))]
        known = np.isfinite(part)
        return np.asarray(np.where(known, part, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1))


def pulling(test: Test) -> Mask:
    """Samples in which the muscle pulls; without force its end may be moved."""
    return np.asarray(test.F > WITHIN * float(test.F.max()))


def mean_of(tests: Sequence[Test]) -> Mean:
    """The branches of tests at one contraction in equal bins of pressure; both ramps weigh the same in each bin."""
    held = any(isometric_lines.stairs(test.trial, PHASES) is not None for test in tests)
    edges = _edges(np.concatenate([test.P for test in tests]), held=held)
    middle = 0.5 * (edges[1:] + edges[:-1])

    def branch(test: Test, phase: int) -> Array:
        P, F = test.P[test.phase == phase], test.F[test.phase == phase]
        return _binned(np.clip(np.searchsorted(edges, P, side="right") - 1, 0, len(middle) - 1), P, F, middle)

    fill, empty = (np.array([branch(test, phase) for test in tests]) for phase in (0, 1))
    return Mean(middle, fill, empty, held)


def _edges(P: Array, *, held: bool) -> Array:
    """Edges of the bins [Pa], for a staircase placed outside its holds as far as possible."""
    edges = np.linspace(P.min(), P.max(), BINS + 1)
    if not held:
        return edges
    width = float(edges[1] - edges[0])
    tried = np.linspace(0.0, width, SHIFTS, endpoint=False)
    away = [float(np.abs((P - P.min() + shift + 0.5 * width) % width - 0.5 * width).min()) for shift in tried]
    return np.asarray(np.append(edges, edges[-1] + width) - tried[int(np.argmax(away))])


def _binned(place: Array, P: Array, F: Array, middle: Array) -> Array:
    """Mean force of each bin, moved to the bin's middle along the slope between the means."""
    count = np.bincount(place, minlength=len(middle))
    full = count > 0
    at, force = (np.bincount(place, values, len(middle))[full] / count[full] for values in (P, F))
    result = np.full(len(middle), np.nan)
    slope = np.gradient(force, at) if full.sum() > 1 and np.all(np.diff(at) > 0) else np.zeros(len(at))
    result[full] = force + slope * (middle[full] - at)
    return result


def straight_from(mean: Mean) -> tuple[float | None, float]:
    """Pressure from which on F(P) is a straight line [Pa], and the largest distance from that line [N].

    Of the pressures at which the force is more than `WITHIN` of its span above its least value, the lowest from which
    on no bin is further than `WITHIN` of the span from the line through all of them, if at least `SHORTEST` of these
    bins remain. None without one; the distance is then that of the shortest part. For a staircase fewer bins are
    enough, and its lowest hold may already have force.
    """
    known = np.isfinite(mean.force)
    P, F = mean.P[known], mean.force[known]
    if not len(F):
        return None, 0.0
    span = float(np.ptp(F))
    slack = np.flatnonzero(F - (min(0.0, F.min()) if mean.held else F.min()) <= WITHIN * span)
    first = len(F) if span <= 0 else int(slack[-1]) + 1 if len(slack) else 0
    least = max(FEWEST_HOLDS if mean.held else FEWEST_BINS, int(np.ceil(SHORTEST * (len(F) - first))))
    off = 0.0
    for start in range(first, len(F) - least + 1):
        off = float(np.abs(F[start:] - np.polyval(np.polyfit(P[start:], F[start:], 1), P[start:])).max())
        if off <= WITHIN * span:
            edge = P[start] - 0.5 * float(mean.P[1] - mean.P[0])
            return float(edge), off
    return None, off


def largest_force(run: RunData, trial: TrialData) -> float | None:
    """Largest force of a muscle held at one length [N]; None where no sample is usable; raises `NotUsable`."""
    test = isometric_lines.as_test(run, trial, PHASES)
    return float(test.F.max()) if len(test.F) else None


@dataclass(frozen=True, eq=False)
class Cell:
    """All tests at one contraction."""

    contraction: float
    tests: Sequence[Test]
    mean: Mean
    low: float | None
    """Start of the straight part of F(P) [Pa]; None if there is none."""
    off: float
    pooled: Pooled | None
    upper: Line | None = None
    """The line through the upper half of the straight part."""

    @cached_property
    def place(self) -> Array:
        """Measured contraction of each test [m], else the commanded one; shape (tests,)."""
        found = []
        for test in self.tests:
            known = test.x[np.abs(test.x) < FURTHEST]
            found.append(float(known.mean()) if len(known) else self.contraction)
        return np.array(found)

    @property
    def gaps(self) -> Array:
        """Force while emptying minus while filling of each test, mean over the straight part [N]."""
        return self.mean.gaps(self.low or 0.0)

    @property
    def rate(self) -> float:
        """Fastest ramp [Pa/s]."""
        return max((c.data.get("rate", 0.0) for test in self.tests for c in test.trial.commands), default=0.0)

    def force_at(self, P: float) -> Array:
        """Mean of the branches of each test at a pressure [N]; NaN where it was not there."""
        return np.array([_at_pressure(P, self.mean.P, row) for row in self.mean.each])


def _at_pressure(P: float, at: Array, F: Array) -> float:
    """F at P, interpolated between bins that are not too far apart, at most half a bin beyond them; NaN elsewhere."""
    known = np.isfinite(F)
    width = float(at[1] - at[0])
    if known.sum() < 2 or not at[known][0] - 0.51 * width <= P <= at[known][-1] + 0.51 * width:
        return float("nan")
    x, y = at[known], F[known]
    i = int(np.clip(np.searchsorted(x, P), 1, len(x) - 1))
    away = min(abs(P - x[i - 1]), abs(P - x[i]))
    if x[i] - x[i - 1] > BRIDGED * width and away > 0.51 * width:  # between two holds of a staircase
        return float("nan")
    return float(y[i - 1] + (y[i] - y[i - 1]) * (P - x[i - 1]) / (x[i] - x[i - 1]))


def cell_of(contraction: float, tests: Sequence[Test]) -> Cell:
    """Evaluation of all tests at one contraction [m]."""
    mean = mean_of(tests)
    side = np.array([test.trial.point.get("side", 0.0) for test in tests])
    parts = [straight_from(mean.of(side == one)) for one in np.unique(side)]
    off = max(part[1] for part in parts)
    if None in [part[0] for part in parts]:
        return Cell(contraction, tests, mean, None, off, None)
    low = max(float(part[0] or 0.0) for part in parts)
    pooled = isometric_lines.pool(tests, lambda test: low <= test.P)
    middle = 0.5 * (low + float(mean.P[-1]))
    upper = isometric_lines.pool(tests, lambda test: middle <= test.P)
    return Cell(contraction, tests, mean, low, off, pooled, None if upper is None else upper.line)


THRESHOLD, ONE_TEST = "force-threshold", "no repeats part: one test only"
LEAST = 0.2
"""Smallest change of the force that counts as onset [N]."""
AROUND = 0.25
"""Range to both sides of a moment over which a line is fitted to the pressure [s]."""
STEPS = 2.0
"""Deviation of the pressure from that line, in its noise, from which on it changes, or is read, in steps."""
TIMES = 3.0
"""Factor of an alternative threshold: noise hides the onset, and the delay by that grows with the threshold."""
SOONER = 0.5
"""Share of the zero of its upper part below which a force begins too soon."""
TOP = 0.75
"""Share of the highest pressure from which on the force's tangent is taken where it has no straight part."""
FROM_REST = (
    "the force rises from the vented pressure on, and its upper part begins at {} only: the cell may read the "
    "pressure, or the muscle pulls softly at first. Pressurise without a muscle on the cell, and take that off"
)
OF_ONSET = (
    "method: half the difference of filling and emptying, with half a sample, or of the two sides; and what a "
    "threshold three times as large makes of it"
)


@dataclass(frozen=True)
class Begin:
    """Where a force begins or ends along one ramp."""

    pressure: float
    """[Pa]."""
    step: float
    """Half of the pressure step there [Pa]; 0 without steps."""


def begins(trial: TrialData, times: float = 1.0) -> tuple[Begin | None, Begin | None]:
    """Pressure at which the force leaves its rest level while filling, and reaches it while emptying.

    The rule is that of `onset`: the first sample that leaves the level of the rest before the ramp by six times its
    noise, at least 0.2 N or a thousandth of the largest force, extrapolated back along the line through the next
    samples. Emptying is evaluated backwards in time from the rest after the ramp. `times` is a factor on the threshold,
    to test the effect of another choice.
    """
    ramps = {c.phase: c for c in trial.commands if c.kind == "ramp" and c.phase in PHASES and c.data.get("rate")}
    use = trial.usable & np.isfinite(trial.channels["force"]) & np.isfinite(trial.channels["pressure"])
    t, P, F = trial.t[use], trial.channels["pressure"][use], trial.channels["force"][use]
    if len(ramps) < 2 or len(t) < 2:
        return None, None
    rest = F[t < ramps["fill"].t - 1e-9] if times > 1 else F[:0]
    least = times * max(LEAST, 1e-3 * float(np.max(np.abs(F))), SEEN * noise_of(rest))
    turn, over = ramps["empty"].t, ends(ramps["empty"])
    up = (t >= ramps["fill"].t - REST) & (t < turn)
    down = (t >= turn) & (t <= over + REST)
    rise = onset(t[up], F[up], ramps["fill"].t, least)
    fall = onset(-t[down][::-1], F[down][::-1], -over, least)
    return _at(t[up], P[up], rise), _at(t[down], P[down], None if fall is None else -fall)


def _at(t: Array, P: Array, moment: float | None) -> Begin | None:
    """Pressure at a moment, and its step, if any: one of size J at the middle leaves a residual of J/4 rms."""
    if moment is None:
        return None
    near = np.abs(t - moment) <= AROUND
    if np.count_nonzero(near) < 3:
        return Begin(float(np.interp(moment, t, P)), 0.0)
    slope, pressure = np.polyfit(t[near] - moment, P[near], 1)
    off = float(np.std(P[near] - slope * (t[near] - moment)))
    noise = noise_of(P)
    return Begin(float(pressure), 2 * sqrt(off**2 - noise**2) if off > STEPS * noise else 0.0)


def begin_estimates(cell: Cell, scales: Scales) -> list[Estimate]:
    """The pressure at which the force begins [Pa], by its onset and by extrapolation of the straight part."""
    late = cell.rate * skew.apart([test.run for test in cell.tests], ("pressure", "force"))
    begun = _by_onset(cell, scales, late)
    return [one for one in (begun, _by_line(cell, scales, late, begun)) if one is not None]


def _estimate(cell: Cell, value: float, method: str, parts: Parts, n: int, how: str) -> Estimate:
    """Estimate of p_0 at one contraction; `how` explains its method part."""
    at, names = {"contraction": cell.contraction}, tuple(test.name for test in cell.tests)
    note = sentences("" if n > 1 else ONE_TEST, how)
    return Estimate("p_0", value, "Pa", "pressure", method, at, parts, n, note=note, trials=names)


def _both(pairs: Sequence[tuple[Begin | None, Begin | None]]) -> Array:
    """Mean of the pressures while filling and emptying [Pa], NaN where one is missing; shape (tests,)."""
    return np.array([0.5 * (a.pressure + b.pressure) if a and b else np.nan for a, b in pairs])


def _by_onset(cell: Cell, scales: Scales, late: float) -> Estimate | None:
    """By the threshold of the force, mean of filling and emptying."""
    each = {test: (a, b) for test in cell.tests for a, b in [begins(test.trial)] if a and b}
    if not each:
        return None
    both = np.array([[a.pressure, b.pressure] for a, b in each.values()])
    values, value = by_repeat(list(each), both.mean(axis=1)), float(both.mean())
    sample = max(1.0 / test.run.rate if test.run.rate else 0.0 for test in cell.tests)
    half = 0.5 * (abs(float((both[:, 0] - both[:, 1]).mean())) + cell.rate * sample)
    side = np.array([test.trial.point.get("side", 0.0) for test in each])
    half = max(half, 0.5 * float(np.ptp([both[side == one].mean() for one in np.unique(side)])))
    later = _both([begins(test.trial, TIMES) for test in each]) - both.mean(axis=1)
    later = later[np.isfinite(later)]
    # the force may begin unnoticed at the level before the step
    step = BEYOND * float(np.mean([0.5 * (a.step + b.step) for a, b in each.values()]))
    half = sqrt(half**2 + (float(later.mean()) if len(later) else 0.0) ** 2 + step**2)
    parts = Parts(spread(values), half, scales.part({"pressure": value}, {"pressure": 1.0}), late)
    how = f"{OF_ONSET}; and half of the step that the pressure goes in there" if step else OF_ONSET
    e = _estimate(cell, value, THRESHOLD, parts, len(values), how)
    return withhold(e, FROM_REST.format(show(_zero(cell), "pressure", 3))) if _rises_from_rest(cell, e) else e


def _zero(cell: Cell) -> float:
    """Pressure at which the upper part of the force is 0 when extrapolated [Pa]; nan if it does not rise."""
    if cell.pooled is not None:
        m, c = cell.pooled.line.m, cell.pooled.line.c
    else:
        upper = np.isfinite(cell.mean.force) & (cell.mean.P >= TOP * cell.mean.P[-1])
        m, c = np.polyfit(cell.mean.P[upper], cell.mean.force[upper], 1) if upper.sum() > 2 else (0.0, 0.0)
    return float(-c / m) if m > 0 else float("nan")


def _rises_from_rest(cell: Cell, begun: Estimate) -> bool:
    """Whether the force begins at the lowest pressure, far below the zero of its upper part."""
    value, half = begun.value or 0.0, begun.parts.combined or 0.0
    return value - half <= float(cell.mean.P[0]) and value < SOONER * _zero(cell)


def _by_line(cell: Cell, scales: Scales, late: float, begun: Estimate | None) -> Estimate | None:
    """By the line through the straight part, at zero force."""
    if cell.pooled is None or cell.pooled.line.m <= 0 or cell.low is None:
        return None
    line = cell.pooled.line
    value = -line.c / line.m
    if not float(cell.mean.P[0]) < value <= cell.low:
        return None
    each = [-c / m for m, c in cell.pooled.repeats if m > 0]
    scale = scales.part({"pressure": value}, {"pressure": 1.0, "force": 1 / line.m})
    half = BEYOND * abs(value - _bent_zero(cell, value))
    how = "the line at force 0"
    if begun is not None and begun.withheld and np.isfinite(off := cell.force_at(value)).any():
        read = abs(float(np.nanmean(off)))  # a share of the pressure is in the slope, too
        half, how = half + read / max(line.m - read / value, 0.5 * line.m), f"{how}, and the force that is read there"
    return _estimate(cell, value, METHOD, Parts(spread(each), half, scale, late), len(each), how)


def _bent_zero(cell: Cell, value: float) -> float:
    """Zero of a parabola through the straight part [Pa], on the side of `value`, the zero of the line."""
    known = np.isfinite(cell.mean.force) & (cell.mean.P >= (cell.low or 0.0))
    P, F = cell.mean.P[known] - value, cell.mean.force[known]
    bend, slope, start = np.polyfit(P, F, 2)
    inner = slope * slope - 4 * bend * start
    off = 2 * start / (slope + np.sqrt(inner)) if inner > 0 and slope > 0 else start / slope
    return value - float(off)


MOVED = 0.01
"""Change of the force because the driven end moves, as a share of its span, from which on it is a doubt."""
NEAR = 0.01
"""Contractions that count as 0, as a share of the nominal length."""


def of_cells(cells: Sequence[Cell]) -> list[Finding]:
    """Doubts about contractions without a straight part, and about ends that gave way."""
    found = []
    for cell in cells:
        where = f"contraction {show(cell.contraction, 'length', 4)}"
        if cell.pooled is None or cell.low is None:
            why = f"even its upper half leaves a line by {show(cell.off, 'force', 3)}"
            why = why if cell.off > 0 else "filling and emptying have too few pressures in common for a line"
            found.append(Finding("doubt", f"{where}: F(P) has no straight part: {why}; no slope is reported"))
        else:
            found += _moved(cell, where)
    return found


def _moved(cell: Cell, where: str) -> Iterator[Finding]:
    """A doubt if the driven end gave way while the force rose."""
    pulled = [test.x[np.isfinite(test.x) & pulling(test)] for test in cell.tests]
    most = max((float(np.ptp(x)) for x in pulled if len(x)), default=0.0)
    off = cell.place - cell.contraction
    if most > 2e-4 and most > MOVED * max(abs(cell.contraction), 10e-3):
        span = show(float(np.nanmax(cell.mean.force) - np.nanmin(cell.mean.force)), "force", 3)
        text = f"the driven end moved by up to {show(most, 'length', 2)} while the force changed by {span}"
        yield Finding("doubt", f"{where}: {text}; it is not isometric")
    if np.abs(off).max() > 5e-4:
        text = f"it was measured {show(float(off[np.argmax(np.abs(off))]), 'length', 2)} off; what was measured counts"
        yield Finding("note", f"{where}: {text}")


def of_threshold(begun: Sequence[Estimate], given: Mapping[str, Any]) -> list[Finding]:
    """The dead band: the pressure at which the force begins at the nominal length."""
    known = [e for e in begun if e.value is not None]
    if not known:
        return []
    at = min((e.at["contraction"] for e in known), key=abs)
    if abs(at) > NEAR * float(given.get("nominal_length", 0.25)):
        return [Finding("note", "the dead band of pressure is that at contraction 0, which is not among the tests")]
    found = []
    for e in (e for e in known if e.at["contraction"] == at):
        half = e.parts.combined
        interval = f" +- {show(half, 'pressure', 2)}" if half is not None else ""
        found.append(f"{show(e.value or 0.0, 'pressure', 4)}{interval} ({e.method})")
    where = f"contraction {show(at, 'length', 3)}"
    return [Finding("note", f"dead band: at {where} the force begins at {', '.join(found)}")]


def force_trace(cell: Cell) -> Trace:
    """Force over pressure of all tests, and the line through the straight part."""
    P, F, phase = (np.concatenate([getattr(test, name) for test in cell.tests]) for name in ("P", "F", "phase"))
    marks = {"contraction": cell.contraction}
    fitted = np.full(len(P), np.nan)
    if cell.pooled is not None and cell.low is not None:
        line = cell.pooled.line
        fitted = np.where(cell.low <= P, line(P), np.nan)
        marks |= {"m": line.m, "c": line.c, "low": cell.low, "high": line.high}
    title = f"Force over pressure at a contraction of {show(cell.contraction, 'length', 3)}, and its straight part"
    columns = {"pressure": P, "force": F, "fit": fitted, "branch": phase}
    quantities = {"pressure": "pressure", "force": "force", "fit": "force", "branch": "count"}
    return Trace(f"isometric-{cell.contraction * 1e3:g}mm", "isometric", title, thinned(columns), quantities, marks)


def over_time(cell: Cell) -> Trace:
    """Pressure and force of the first test over time (paper 4)."""
    test = cell.tests[0]
    trial = test.trial
    during = np.flatnonzero((trial.t >= test.t[0] - REST) & (trial.t <= test.t[-1] + REST))
    columns = {"t": trial.t[during] - trial.t[during[0]]}
    columns |= {name: trial.channels[name][during] for name in ("pressure", "force")}
    title = f"Pressure and force over time at a contraction of {show(cell.contraction, 'length', 3)}"
    quantities, marks = {"t": "time", "pressure": "pressure", "force": "force"}, {"contraction": cell.contraction}
    return Trace(
        f"over-time-{cell.contraction * 1e3:g}mm", "pressurisation", title, thinned(columns), quantities, marks
    )
