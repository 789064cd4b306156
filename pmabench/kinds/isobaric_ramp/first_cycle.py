"""How much more hysteresis the first loop of a rested muscle has than the loops after it have faded.

The gap of the first cycle minus that of the cycles that count, over the gap at speed 0: damping is in both gaps, and no
longer in their difference. Knows the loops of a cell and what the plan did before the first of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from typing import Any

import numpy as np

from pmabench.analysis.shared import student
from pmabench.analysis.shared.calibration import sentences
from pmabench.analysis.shared.lines import Line
from pmabench.analysis.shared.ramp_loop import Loop, measure_as_planned
from pmabench.analysis.shared.samples import NotUsable, settings_of
from pmabench.base.quantities import show
from pmabench.kinds.isobaric_ramp.cell import CYCLES, GAP, ONE_SPEED, Cell, Member
from pmabench.store.analyses.results import Estimate, Parts
from pmabench.store.records import Array, RunData, TrialData

SYMBOL = "h_1"
LONG = 600.0
"""Rest [s] from which a muscle counts as rested; how fast one recovers is not published."""
FEWEST = 3
"""Cycles that count, whose gaps are what the first one is compared with."""
MIDDLE = 0.05
"""Half width of the middle of the stroke, as a share of it."""
FADED = 0.25
"""Share of what the first gap is wider by, by which later gaps may change; share of H that its half width may be."""
NO_HYSTERESIS = "the gap at speed 0, which it is a share of, is not known well enough"


@dataclass(frozen=True)
class Wider:
    """The first loop of one trial; half widths 95 %, all [N]."""

    trial: str
    rest: float
    """[s]"""
    gap: float
    """What its gap is wider by."""
    scatter: float
    open: float
    """Drift and creep that were another in the first cycle, and what the later cycles still fade by."""


def first_cycle(runs: Sequence[RunData], cells: Sequence[Cell], options: Mapping[str, Any]) -> Iterator[Estimate]:
    """The coefficient of each cell that holds the first loops of a run; none where no rest before them is recorded."""
    firsts = {min(run.trials, key=_begin).name for run in runs if run.trials and _rest(run)}
    for cell in cells:
        if cell.upside_down or not (members := [m for m in cell.members if m.trial.name in firsts]):
            continue
        found = [_wider(member, options) for member in members]
        known = [one for one in found if isinstance(one, Wider)]
        lacks = ONE_SPEED if cell.one_speed else "" if _known(cell.gap) else NO_HYSTERESIS
        if len(known) < len(found) or lacks:
            why = next((one for one in found if isinstance(one, str)), lacks)
            trials = tuple(m.trial.name for m in members)
            yield Estimate(SYMBOL, None, "1", "ratio", GAP, dict(cell.at), n=len(found), note=why, trials=trials)
        else:
            yield _estimate(cell, known)


def _known(gap: Line) -> bool:
    """Whether the gap at speed 0 is known well enough to be what another one is a share of."""
    return gap.half_start is not None and gap.half_start < FADED * gap.start


def _begin(trial: TrialData) -> float:
    return float(trial.t[0]) if len(trial.t) else np.inf


def _rest(run: RunData) -> float:
    """How long the vented muscle rested before the first trial [s]."""
    return float(settings_of(run).get("rest", 0.0))


def _wider(member: Member, options: Mapping[str, Any]) -> Wider | str:
    """What the first gap of a trial is wider by, or why that is not known."""
    run = member.run
    rest, first = _rest(run), int(settings_of(run, options).get("discard", 1))
    if rest < LONG:
        return f"the muscle rested for {show(rest, 'time')} only: let it rest for {show(LONG, 'time')} or more"
    try:
        loop = measure_as_planned(run, member.trial, {**options, "discard": 0})
    except NotUsable as reason:
        return f"of all cycles: {reason}"
    gaps, grown = _at_middle(loop)
    later = gaps[first:]
    if first < 1 or len(later) < FEWEST:
        return f"it needs `discard` of 1 or more cycles, and {FEWEST} after them; there are {len(later)}"
    gap, fades = float(gaps[0] - later.mean()), float(np.ptp(later))
    scatter = float(student.ppf(0.975, len(later) - 1) * later.std(ddof=1) * sqrt(1 + 1 / len(later)))
    if fades > FADED * abs(gap) and fades > 2 * loop.noise:
        change = f"{show(fades, 'force', 2)} of {show(gap, 'force', 2)}"
        return f"the loops after `discard` still change by {change}: more cycles, and a larger `discard`"
    return Wider(member.trial.name, rest, gap, scatter, hypot(fades, grown))


def _at_middle(loop: Loop) -> tuple[Array, float]:
    """The gap of each cycle at mid stroke, and what was taken off the first of them as drift or creep [N].

    Half of what the mean of both branches grows by until the next cycle. Of the first cycle a part of that is friction
    that fades on the way, so that all of it is left open. The ends of a first stroke are no guide: there it is not yet
    known which way friction acts.
    """
    near = np.abs(loop.x - 0.5 * (loop.ends[0] + loop.ends[1])) <= MIDDLE * (loop.ends[1] - loop.ends[0])
    contracting, expanding = (branch[:, near].mean(axis=1) for branch in (loop.contracting, loop.expanding))
    grown = 0.5 * np.gradient(0.5 * (contracting + expanding))
    return expanding - contracting - grown, abs(float(grown[0]))


def _estimate(cell: Cell, known: Sequence[Wider]) -> Estimate:
    gaps = np.array([one.gap for one in known])
    line, n = cell.gap, len(known)
    value = float(gaps.mean()) / line.start
    between = float(student.ppf(0.975, n - 1) * gaps.std(ddof=1) / sqrt(n)) if n > 1 else 0.0
    within = sqrt(float(np.mean([one.scatter**2 for one in known])) / n)
    repeats = hypot(max(between, within) / line.start, value * (line.half_start or 0.0) / line.start)
    parts = Parts(repeats, max(one.open for one in known) / line.start, 0.0)
    note = sentences(
        CYCLES if n == 1 else "",
        f"after a rest of {show(min(one.rest for one in known), 'time')}; H holds the gap that creep makes",
    )
    trials = tuple(one.trial for one in known)
    return Estimate(SYMBOL, value, "1", "ratio", GAP, dict(cell.at), parts, n, note=note, trials=trials)
