"""Reduction of steps of displacement at constant pressure: static and instantaneous stiffness, the way back to rest.

Knows the samples. One trial is measured in `step_relaxation`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot
from typing import Any

import numpy as np

from pmabench.analysis.results import Analysis, Dropped, Estimate, Finding, Parts, Trace
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.lines import mean_half
from pmabench.analysis.shared.samples import NotUsable
from pmabench.base.quantities import show
from pmabench.kinds.step_displacement import RESULTS
from pmabench.kinds.step_displacement.relaxation import Relaxation, Steps, measure
from pmabench.store.records import RunData, TrialData

KIND = "step-displacement"
RELAXED, PEAK, BACK = "step, relaxed", "step, peak", "step, recovery"
EXTREME = 3.0
"""Standard deviations of the noise by which a peak lies beyond the signal."""
TAIL = 0.1
"""What the end of the motion, where the actuator creeps in, may make of a time constant, as a share of it."""
CELL = ("pressure", "start", "step", "speed")
STEPS_OF_ONE = "one trial: the repeats part is the scatter of its steps, and repeated tests may scatter more"
ONE_STEP = "no repeats part: one step"
DRIFTS = 0.05
"""Drift at the end of a rest, as a share of the step of the force, that is doubted."""
LONGEST_TRACE = 1500


@dataclass(frozen=True, eq=False)
class _Member:
    trial: TrialData
    steps: Steps


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """K [N/m] from relaxed forces and from the peak, forces [N] around each step, time constants [s] of the recovery.

    Static stiffness is -(F relaxed - F before)/(step as measured), the instantaneous one has the peak in place of the
    relaxed force: damping (K + B v/step for three elements) and the pressure that the step makes are in it. Steps there
    and back are told apart by their sign: above 0 the muscle contracts. The time constants are those of one exponential
    from the end of the motion on. `options`: `discard`
    (cycles at the start; else the plan's setting, else 1).
    """
    members: list[_Member] = []
    dropped: list[Dropped] = []
    for run in runs:
        for trial in run.trials:
            try:
                members.append(_Member(trial, measure(run, trial, options or {})))
            except NotUsable as reason:
                dropped.append(Dropped(trial.name, trial.point, str(reason)))
    scales = Scales.of(runs)
    cells: dict[tuple[tuple[str, float], ...], list[_Member]] = {}
    for member in members:
        point = member.trial.point
        cells.setdefault(tuple((name, round(point[name], 9)) for name in CELL if name in point), []).append(member)
    estimates: list[Estimate] = []
    findings: list[Finding] = []
    traces: list[Trace] = []
    for key, group in sorted(cells.items()):
        at = dict(key)
        for sign, of in ((1.0, lambda steps: steps.there), (-1.0, lambda steps: steps.back)):
            here = {**at, "step": sign * at.get("step", 0.0)}
            estimates += _estimates(here, group, of, scales)
        findings += _findings(at, group)
        traces.append(_trace(at, group[0]))
    if estimates and (lack := scales.lack(("force", "displacement"))):
        findings.append(Finding("note", lack))
    order = {RELAXED: 0, PEAK: 1}
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=sorted(estimates, key=lambda e: order.get(e.method, 2)),
        dropped=dropped,
        findings=findings,
        traces=traces,
        facts={"options": dict(options or {}), "trials": len(members), "cells": len(cells)},
    )


def _estimates(
    at: Mapping[str, float],
    group: Sequence[_Member],
    of: Callable[[Steps], tuple[Relaxation, ...]],
    scales: Scales,
) -> list[Estimate]:
    """All of one direction of one cell."""
    each = [of(member.steps) for member in group]
    names = tuple(member.trial.name for member in group)
    noise = max(one.noise for steps in each for one in steps)
    moved = abs(float(np.mean([one.moved for steps in each for one in steps])))
    drift = max(abs(one.drift) for steps in each for one in steps)
    told: list[Estimate] = []

    def estimate(
        symbol: str, kind: tuple[str, str], method: str, value: Callable[[Relaxation], float],
        powers: Mapping[str, int], extra: float, coordinate: str = "",
    ) -> None:  # fmt: skip
        values = [np.array([value(one) for one in steps]) for steps in each]
        means = np.array([float(one.mean()) for one in values])
        half, mean = mean_half(means, values), float(means.mean())
        part = scales.part({name: mean * power for name, power in powers.items()})
        note = ONE_STEP if half is None else STEPS_OF_ONE if len(group) == 1 else ""
        if part is None and set(powers) - {"force", "displacement"}:
            note = sentences(note, scales.lack(powers))
        told.append(
            Estimate(symbol, mean, *kind, method, dict(at), Parts(half, extra, part), len(group), note=note,
                     trials=names, coordinate=coordinate)
        )  # fmt: skip

    stiffness, newton, second = ("N/m", "stiffness"), ("N", "force"), ("s", "time")
    slope = {"force": 1, "displacement": -1}
    estimate("K", stiffness, RELAXED, lambda one: one.static, slope, drift / moved)
    estimate("K", stiffness, PEAK, lambda one: one.instant, slope, EXTREME * noise / moved)
    estimate("F", newton, RELAXED, lambda one: one.before, {"force": 1}, drift, "before")
    estimate("F", newton, PEAK, lambda one: one.peak, {"force": 1}, EXTREME * noise, "peak")
    estimate("F", newton, RELAXED, lambda one: one.relaxed, {"force": 1}, drift, "relaxed")
    if all(np.isfinite(one.pressure_peak) for steps in each for one in steps):
        estimate("P_err", ("Pa", "pressure"), PEAK, lambda one: one.pressure_peak, {"pressure": 1}, 0.0)
    for symbol, name in (("tau_F", "force_back"), ("tau_p", "pressure_back")):
        if all(getattr(one, name) is not None for steps in each for one in steps):
            estimate(symbol, second, BACK, lambda one, name=name: getattr(one, name).tau, {}, 0.0)  # type: ignore[misc]
            last = told.pop()
            note = sentences(last.note, "no calibration part: a time has no scale")
            apart = max(getattr(one, name).apart for steps in each for one in steps)
            tail = Parts(last.parts.repeats, hypot(TAIL * abs(last.value or 0.0), apart))
            told.append(replace(last, parts=tail, note=note))
            continue
        note = "no recovery shows above the noise, or it is over within a few samples"
        told.append(Estimate(symbol, None, *second, BACK, dict(at), n=len(group), note=note, trials=names))
    return told


def _findings(at: Mapping[str, float], group: Sequence[_Member]) -> list[Finding]:
    """What catches the eye."""
    told = []
    for member in group:
        every = (*member.steps.there, *member.steps.back)
        drift = max(abs(one.drift) / max(abs(one.peak - one.before), 1e-9) for one in every)
        worst = max(every, key=lambda one: abs(one.drift))
        if drift > DRIFTS and abs(worst.drift) > 3 * worst.noise:
            text = f"trial {member.trial.name}: the force still drifts by {show(worst.drift, 'force', 2)} at the end of"
            told.append(Finding("doubt", f"{text} a rest; K is not static yet, hold longer"))
        if any(one.static <= 0 for one in every):
            text = f"trial {member.trial.name}: the force rises with contraction: a sign is wrong, or the step is lost"
            told.append(Finding("fault", text))
    return told


def _trace(at: Mapping[str, float], member: _Member) -> Trace:
    """Around the last step away from the start."""
    columns = member.steps.last
    stride = max(1, -(-len(columns["t"]) // LONGEST_TRACE))
    step = member.steps.there[-1]
    told = [show(at[name], quantity) for name, quantity in
            (("pressure", "pressure"), ("step", "length"), ("speed", "speed")) if name in at]  # fmt: skip
    return Trace(
        "step-" + "-".join(f"{value:g}" for value in at.values()),
        "displacement-step",
        f"{', '.join(told)}: step of displacement",
        {name: values[::stride] for name, values in columns.items()},
        {"t": "time", "force": "force", "displacement": "length", "pressure": "pressure"},
        {"before": step.before, "peak": step.peak, "relaxed": step.relaxed},
    )
