"""Reduction of isobaric ramps: mean curve, K, F_ce, loop gap and work over pressure and speed; rubber at 0 kPa.

Knows the samples and the protocol's settings. One trial is measured in `ramp_loop`, one cell in `isobaric_cell`, the
rubber's force is fitted in `rubber`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import hypot
from typing import Any

import numpy as np

from pmabench.analysis.results import Analysis, Dropped, Estimate, Finding, Trace
from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.ramp_loop import measure_as_planned
from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.verdict.offers import Offer, Place, at_pressures, between, everywhere, values_of
from pmabench.base.quantities import show
from pmabench.kinds.isobaric_ramp import RESULTS
from pmabench.kinds.isobaric_ramp.cell import CURVE, GAP, LOCAL, Cell, Member
from pmabench.kinds.isobaric_ramp.rubber import rubber
from pmabench.store.records import RunData

KIND = "isobaric-ramp"
CHANNELS = ("displacement", "force")
UNPRESSED = 1.0
"""Set pressure up to which a loop is of the rubber alone [Pa]."""
STRAIGHT = 0.02
"""Rms of a mean curve about a straight line, as a share of its range, up to which it counts as one."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Mean curve F(x), K [N/m], F_ce [N], gap H [N] and work [J] of slow ramps at constant pressure (paper 3).

    The gap is the force while expanding minus that while contracting at mid stroke: above 0 where the contracting
    branch is the lower one. H = 2 F_c + (B_c + B_r) v, a line over the speed v: its start is true hysteresis. The mean
    of both branches is taken to speed 0 in the same way. K is minus its slope. At 0 kPa it is the rubber's force, and
    F_e = A eps (eps - B1)/(eps + B2) is fitted to it (paper 3 eq. 8).

    `options`: `discard` (cycles at the start; else the plan's setting, else 1), `turn` [m] (left out at both ends; else
    the plan's setting, else a twentieth of the stroke).
    """
    options = options or {}
    members, dropped = _members(runs, options)
    scales = Scales.of(runs)
    cells = _cells(members)
    estimates: list[Estimate] = []
    findings: list[Finding] = []
    traces: list[Trace] = []
    for cell in cells:
        estimates += cell.estimates(scales, _slope_over_pressure(cell, cells))
        findings += cell.findings()
        traces += cell.traces()
    unpressed = [cell for cell in cells if cell.pressure <= UNPRESSED]
    for cell in unpressed:
        found = rubber(cell, scales)
        estimates += found.estimates
        findings += found.findings
        traces += found.traces
    findings += _sentences(cells)
    findings += skew.findings(runs, CHANNELS, max((cell.skew for cell in cells), default=0.0), estimates)
    if estimates and (lack := scales.lack(("force", "displacement"))):
        findings.append(Finding("note", lack))
    order = {CURVE: 0}
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=sorted(estimates, key=lambda e: order.get(e.method, 1)),
        dropped=dropped,
        findings=findings,
        traces=traces,
        facts={
            "options": dict(options),
            "trials": len(members),
            "cells": len(cells),
            "loops": [cell.facts() for cell in cells],
        },
    )


def _members(runs: Sequence[RunData], options: Mapping[str, Any]) -> tuple[list[Member], list[Dropped]]:
    members: list[Member] = []
    dropped: list[Dropped] = []
    for run in runs:
        for trial in run.trials:
            try:
                members.append(Member(run, trial, measure_as_planned(run, trial, options)))
            except NotUsable as reason:
                dropped.append(Dropped(trial.name, trial.point, str(reason)))
    return members, dropped


def _cells(members: Sequence[Member]) -> list[Cell]:
    """The trials of one pressure and stroke together, by rising pressure."""
    groups: dict[tuple[float, ...], list[Member]] = {}
    for member in members:
        point = member.trial.point
        key = tuple(round(point.get(name, 0.0), 9) for name in ("pressure", "lower", "upper"))
        groups.setdefault(key, []).append(member)
    pressures = [key[0] for key in groups]
    return [
        Cell.of({"pressure": key[0]} | ({"lower": key[1], "upper": key[2]} if pressures.count(key[0]) > 1 else {}), g)
        for key, g in sorted(groups.items())
    ]


def _slope_over_pressure(cell: Cell, cells: Sequence[Cell]) -> float | None:
    """dF/dP at mid stroke [N/Pa] from the cells next to this one; None without another pressure."""
    others = [c for c in cells if c.pressure != cell.pressure and c.x[0] <= cell.middle <= c.x[-1]]
    if not others:
        return None
    near = min(others, key=lambda c: abs(c.pressure - cell.pressure))
    return (near.force_at(cell.middle) - cell.force_at(cell.middle)) / (near.pressure - cell.pressure)


def _sentences(cells: Sequence[Cell]) -> list[Finding]:
    """Which branch is the lower one, and where one K does not say all."""
    wrong = [cell for cell in cells if cell.upside_down]
    if wrong:
        where = ", ".join(show(cell.pressure, "pressure") for cell in wrong)
        text = (
            f"at {where} the force is larger while contracting than while expanding: no muscle gives work back like "
            "that; look for a wrong sign, or force and displacement that are apart in time"
        )
        return [Finding("fault", text)]
    if not cells:
        return []
    gaps = ", ".join(f"{show(cell.gap.start, 'force', 3)} at {show(cell.pressure, 'pressure')}" for cell in cells)
    found = [Finding("note", f"the contracting branch is the lower one; gap at mid stroke {gaps}")]
    if bent := [show(cell.pressure, "pressure") for cell in cells if cell.bent]:
        text = f"at {', '.join(bent)} the mean curve is bent: K by pressure alone is a mean over the stroke"
        found.append(Finding("note", f"{text}; that at each contraction stands in the tables"))
    return found


def offers(analysis: Analysis) -> Iterator[Offer]:
    """F along the mean curves, K of those that are straight and along those that are bent, B, F_c."""
    K = at_pressures(analysis, "K", CURVE)
    for trace in analysis.traces:
        P = trace.marks.get("pressure")
        if trace.figure == "mean-curve" and P is not None:
            F_here, K_here = (
                sorted(((e.at["contraction"], e) for e in values_of(analysis, symbol, LOCAL) if e.at["pressure"] == P),
                       key=lambda one: one[0]) for symbol in ("F", "K")
            )  # fmt: skip
            if F_here:
                yield _along(P, F_here, trace)
            if P in K and _is_straight(trace):
                yield _of_stroke(P, K[P], trace)
            elif K_here:
                yield _along(P, K_here)
    yield from (everywhere(symbol, at_pressures(analysis, symbol, GAP)) for symbol in ("B", "F_c"))


def _along(P: float, known: Sequence[tuple[float, Estimate]], course: Trace | None = None) -> Offer:
    """F along the mean curve of a pressure [Pa], `course`, with an interval between those of its places; K, of places.

    Between the places K is taken as a bent curve.
    """

    def at(place: Place) -> Estimate | None:
        x = place[1]
        found = None if place[0] != P or x is None else between(known, x, bent=course is None)
        if found is None or course is None or x is None:
            return found
        return replace(found, value=float(np.interp(x, course.columns["displacement"], course.columns["force"])))

    return Offer(known[0][1].symbol, {(P, x): e for x, e in known}, at, bent=course is None)


def _of_stroke(P: float, K: Estimate, course: Trace) -> Offer:
    """K of a straight mean curve: that at its middle, and elsewhere as far off as a parabola through it says."""
    x, F = course.columns["displacement"], course.columns["force"]
    bend = 2 * abs(float(np.polyfit(x, F, 2)[0]))

    def at(place: Place) -> Estimate | None:
        there = place[1]
        if place[0] != P or (there is not None and not x[0] <= there <= x[-1]):
            return None
        off = 0.0 if there is None else bend * abs(there - float(x.mean()))
        return replace(K, parts=replace(K.parts, method=hypot(K.parts.method or 0.0, off)))

    return Offer("K", {(P, None): K}, at)


def _is_straight(trace: Trace) -> bool:
    x, F = trace.columns["displacement"], trace.columns["force"]
    return len(x) > 2 and float(np.std(F - np.polyval(np.polyfit(x, F, 1), x))) <= STRAIGHT * float(np.ptp(F))
