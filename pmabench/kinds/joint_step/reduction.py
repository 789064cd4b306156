"""From steps and sines of a joint in closed loop to errors, times, gain and phase, each with an interval."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import pi
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.lines import mean_of_cycles
from pmabench.analysis.shared.samples import lag_open, lags_of, settings_of
from pmabench.analysis.shared.skew import off
from pmabench.analysis.shared.student import mean_with_half
from pmabench.analysis.shared.trials import grouped, measured_trials, point_of
from pmabench.base.quantities import show
from pmabench.kinds.joint_step import RESULTS
from pmabench.kinds.joint_step.course import Course, Stepped, Swung, course_of
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData

STEP, SINE = "step in closed loop", "sine in closed loop"
SATURATED = 0.05
"""Share of the samples with a pressure at a limit above which it is said."""
Made = tuple[str, str, str, Array, float]
"""Symbol, unit, quantity, value of each trial, and what sampling and noise leave open."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """End error e_th [rad], settling and rise time [s] and overshoot [rad] of steps; gain, phase and error of sines.

    `options`: `window` [s], `band` [rad] and `begin` [s], else the plan's.
    """
    courses, dropped = measured_trials(runs, lambda run, trial: course_of(run, trial, options or {}))
    cells = grouped(courses, lambda one: point_of(one.trial))
    scales = Scales.of(runs)
    estimates, traces, findings = list[Estimate](), list[Trace](), list[Finding]()
    for key, members in sorted(cells.items()):
        steps = [one for one in members if isinstance(one, Stepped)]
        sines = [one for one in members if isinstance(one, Swung)]
        band = float(settings_of(members[0].run, options or {})["band"])
        estimates += _of_steps(dict(key), steps, scales, band) if steps else _of_sines(dict(key), sines, scales)
        traces.append(_trace(dict(key), members[-1]))
        if (most := max(one.saturated for one in members)) > SATURATED:
            text = f"{members[0].trial.name}: a pressure was at its limit for {most:.0%} of the time"
            findings.append(Finding("doubt", f"{text}: the joint is not as stiff as asked for, and the loop is slower"))
    findings += [Finding("doubt", f"{one.trial}: {one.reason}") for one in dropped]
    if estimates and (lack := scales.lack(("angle",), ("angle",))):
        findings.append(Finding("note", lack))
    facts = {"options": dict(options or {}), "trials": len(courses)}
    return Analysis.of(
        "joint-step", runs, results=RESULTS, estimates=estimates, dropped=dropped, findings=findings, traces=traces,
        facts=facts,
    )  # fmt: skip


def _of_steps(at: Mapping[str, float], steps: Sequence[Stepped], scales: Scales, band: float) -> Iterator[Estimate]:
    trials = tuple(one.trial.name for one in steps)
    found = [one.response for one in steps]
    errors = np.array([-one.sign * r.error for one, r in zip(steps, found, strict=True)])
    overshoots = np.array([r.overshoot * one.size for one, r in zip(steps, found, strict=True)])
    late = _late(steps)
    unsure = {
        "e_th": max(r.unsure.error for r in found),
        "OS_th": max(r.unsure.overshoot * one.size for one, r in zip(steps, found, strict=True)),
        "t_s": float(np.hypot(max(r.unsure.settling for r in found), late)),
        "t_r": float(np.hypot(max(r.unsure.rise for r in found), late + _slowed(steps))),
    }
    angle = ("rad", "angle")
    rows: list[tuple[str, tuple[str, str], list[float | None]]] = [
        ("e_th", angle, list(errors)),
        ("t_s", ("s", "time"), [r.settling for r in found]),
        ("t_r", ("s", "time"), [r.rise for r in found]),
        ("OS_th", angle, list(overshoots)),
    ]
    for symbol, kind, values in rows:
        known = [value for value in values if value is not None]
        mean, half = mean_with_half(known) if known else (0.0, None)
        part = scales.part({"angle": at["goal"]}, {"angle": 1.0}) if symbol == "e_th" else None
        note = "one trial: no interval" if len(steps) == 1 else ""
        parts = Parts(half, unsure[symbol], part)
        one = Estimate(symbol, mean, *kind, STEP, at, parts, len(known), note=note, trials=trials)
        if len(known) < len(values):
            ends, count = show(float(errors.mean()), "angle", 3), len(values) - len(known)
            place = f"within {show(band, 'angle')} of the goal" if symbol == "t_s" else "from 10 to 90 % of the step"
            why = f"{count} of {len(values)} trials do not come {place}: they end {ends} off it"
            one = replace(one, value=None, parts=Parts(), note=why)
        yield one


def _late(courses: Sequence[Course]) -> float:
    """What is open of the time between the angle and the commands [s]: the sensor's filter and its clock."""
    return max(lag_open(one.run, "angle") + off([one.run], "angle") for one in courses)


def _slowed(steps: Sequence[Stepped]) -> float:
    """By how much the filter of the angle makes a rise longer, which a shift in time does not take off [s]."""
    rises = [(one.response.rise, 2.2 * lags_of(one.run, one.trial)["angle"]) for one in steps]
    return max((r - max(r**2 - slow**2, 0.0) ** 0.5 for r, slow in rises if r is not None), default=0.0)


def _of_sines(at: Mapping[str, float], sines: Sequence[Swung], scales: Scales) -> Iterator[Estimate]:
    trials = tuple(one.trial.name for one in sines)
    # phases of cycles are compared about their common direction: one near -180 deg may turn up as +180
    middle = complex(np.mean(np.concatenate([one.answers for one in sines])))
    phases = [np.angle(one.answers / middle) + np.angle(middle) for one in sines]
    turned = 2 * pi * at["frequency"] * _late(sines)
    filtered = 2 * pi * at["frequency"] * max(lags_of(one.run, one.trial)["angle"] for one in sines)
    late = {"g_th": turned * (turned + filtered), "phi_th": turned, "e_s": turned * abs(at["goal"]) / 2**0.5}
    rows: tuple[tuple[str, tuple[str, str], list[Array], dict[str, float]], ...] = (
        ("g_th", ("1", "ratio"), [np.abs(one.answers) for one in sines], {"angle": abs(middle)}),
        ("phi_th", ("rad", "angle"), phases, {}),
        ("e_s", ("rad", "angle"), [one.errors for one in sines], {"angle": at["goal"]}),
    )
    for symbol, kind, values, gains in rows:
        mean, half = mean_of_cycles(values)
        parts = Parts(half, late[symbol], scales.part(gains) if gains else None)
        yield Estimate(symbol, mean, *kind, SINE, at, parts, len(sines), trials=trials)


def _trace(at: Mapping[str, float], one: Course) -> Trace:
    """Angle, reference and pressures of the last trial of an operating point."""
    ok, shown = (
        one.trial.usable,
        f"{show(at['goal'], 'angle', 3)}, integral {show(at['integral'], 'angular integral gain', 3)}",
    )
    columns = {"t": one.t, "angle": one.angle, "reference": one.reference}
    columns |= {n: one.trial.channels[n][ok] for n in ("pressure_1", "pressure_2") if n in one.trial.channels}
    quantities = {"t": "time", "angle": "angle", "reference": "angle"}
    kind = "sine" if isinstance(one, Swung) else "step"
    return Trace(
        f"joint-{kind}-{one.trial.number}",
        "joint-step",
        f"{kind} of {shown}",
        columns,
        quantities | {name: "pressure" for name in columns if name not in quantities},
        dict(at),
    )
