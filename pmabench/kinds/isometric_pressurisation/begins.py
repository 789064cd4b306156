"""The pressure at which the force of a muscle held at one length begins: by its onset, and by the line at force 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.isometric_lines import METHOD, by_repeat, spread
from pmabench.analysis.shared.samples import SEEN, ends, noise_of, onset
from pmabench.kinds.isometric_pressurisation.curve import PHASES, REST
from pmabench.kinds.isometric_pressurisation.sections import BEYOND, Cell
from pmabench.store.analyses.results import Estimate, Parts
from pmabench.store.records import Array, TrialData

THRESHOLD, ONE_TEST = "force-threshold", "no repeats part: one test only"
LEAST = 0.2
"""Change of the force that counts as one, where there is less noise [N]."""
AROUND = 0.25
"""The pressure at a moment is that of a line through the samples so far to both sides [s]."""
STEPS = 2.0
"""By so many times its noise the pressure leaves that line where it goes, or is read, in steps."""
TIMES = 3.0
"""Another threshold of the force, as a multiple: noise hides how it begins, and that it begins late grows with it."""
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
    """Half of the step in which the pressure passes there [Pa]; 0 where it has none."""


def begins(trial: TrialData, times: float = 1.0) -> tuple[Begin | None, Begin | None]:
    """Pressure at which the force leaves its level of rest while filling, and reaches it while emptying.

    The rule is that of `onset`: the first sample that leaves the level of the rest before the ramp by six times its
    noise, at least 0.2 N or a thousandth of the largest force, followed back along the line through the next samples.
    While emptying the same backwards in time, from the rest after the ramp. `times` as large a threshold is another
    choice that an analyst could have made.
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
    """Pressure at a moment; a step of size J in the middle of a line leaves it by J/4 rms."""
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
    """The pressure at which the force begins, by its onset and by the line at force 0 [Pa]."""
    late = cell.rate * skew.apart([test.run for test in cell.tests], ("pressure", "force"))
    found = [_by_onset(cell, scales, late), _by_line(cell, scales, late)]
    return [one for one in found if one is not None]


def _estimate(cell: Cell, value: float, method: str, parts: Parts, n: int, how: str) -> Estimate:
    """Of p_0 at one contraction; `how` says how its method part came about."""
    at, names = {"contraction": cell.contraction}, tuple(test.name for test in cell.tests)
    note = sentences("" if n > 1 else ONE_TEST, how)
    return Estimate("p_0", value, "Pa", "pressure", method, at, parts, n, note=note, trials=names)


def _both(pairs: Sequence[tuple[Begin | None, Begin | None]]) -> Array:
    """Mean of the pressures while filling and emptying [Pa], NaN where one is missing; shape (tests,)."""
    return np.array([0.5 * (a.pressure + b.pressure) if a and b else np.nan for a, b in pairs])


def _by_onset(cell: Cell, scales: Scales, late: float) -> Estimate | None:
    """By the threshold of the force, the mean of filling and emptying."""
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
    # at the level before the step noise may hide a force
    step = BEYOND * float(np.mean([0.5 * (a.step + b.step) for a, b in each.values()]))
    half = sqrt(half**2 + (float(later.mean()) if len(later) else 0.0) ** 2 + step**2)
    parts = Parts(spread(values), half, scales.part({"pressure": value}, {"pressure": 1.0}), late)
    how = f"{OF_ONSET}; and half of the step that the pressure goes in there" if step else OF_ONSET
    return _estimate(cell, value, THRESHOLD, parts, len(values), how)


def _by_line(cell: Cell, scales: Scales, late: float) -> Estimate | None:
    """By the line through the straight part, at force 0."""
    if cell.pooled is None or cell.pooled.line.m <= 0 or cell.low is None:
        return None
    line = cell.pooled.line
    value = -line.c / line.m
    if not float(cell.mean.P[0]) < value <= cell.low:
        return None
    each = [-c / m for m, c in cell.pooled.repeats if m > 0]
    scale = scales.part({"pressure": value}, {"pressure": 1.0, "force": 1 / line.m})
    parts = Parts(spread(each), BEYOND * abs(value - _bent_zero(cell, value)), scale, late)
    return _estimate(cell, value, METHOD, parts, len(each), "the line at force 0")


def _bent_zero(cell: Cell, value: float) -> float:
    """Where a parabola through the straight part is 0 [Pa], from where the line is: as good a choice as the line."""
    known = np.isfinite(cell.mean.force) & (cell.mean.P >= (cell.low or 0.0))
    P, F = cell.mean.P[known] - value, cell.mean.force[known]
    bend, slope, start = np.polyfit(P, F, 2)
    inner = slope * slope - 4 * bend * start
    off = 2 * start / (slope + np.sqrt(inner)) if inner > 0 and slope > 0 else start / slope
    return value - float(off)
