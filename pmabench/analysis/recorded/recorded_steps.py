"""Steps of pressure that others recorded: dead time, rise, size of the stroke, and what its ringing says of K and B.

Knows trials with one command each and measured pressure and displacement; not where they come from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from pmabench.analysis.declared import Result
from pmabench.analysis.recorded.driven_motion import respond
from pmabench.analysis.recorded.imported import flagged_counts, import_findings, measured, unusable_because
from pmabench.analysis.results import Analysis, Estimate, Finding, Parts, Trace
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.student import mean_over, mean_with_half
from pmabench.base.quantities import show
from pmabench.store.records import Array, Flag, RunData, TrialData

KIND = "recorded-step"
RESULTS = (
    Result("K", "stiffness", "stiffness", headline=True),
    Result("B", "damping, mean of both directions", "damping", headline=True, plot="Damping"),
    Result("t_d", "dead time", "time", headline=True, plot="Dead times t_d"),
    Result("tau_P", "rise time of the pressure", "time", headline=True),
    Result("X", "stroke", "length", headline=True),
    Result("dP/dx", "pressure per contraction", "gain", headline=True),
)
"""What it can give; columns and figures have this order."""
STEP, RINGING = "recorded-step", "ringing-of-known-mass"
BEFORE, AFTER = 0.5, 0.8
"""Samples so long before and after the command [s] enter the fit of the motion."""
FEWEST = 30
"""Samples on each side that are needed."""
SEEN = 5.0
"""An onset counts where it exceeds this many standard deviations of the baseline, and a twentieth of the step."""
FREQUENCY = (3.0, 400.0)
DAMPING = (0.01, 3.0)
"""Bounds of natural frequency [rad/s] and damping ratio [1] of the motion; a fit at a bound found nothing."""
ILL_FITTED = 0.1
"""Rms of the misfit as a share of the stroke, above which K and B are not told."""
ONCE = "no repeats part: one step only"
UNASSESSED = "no method part: how far it has settled is not assessed"
SHIFTS = 4
OVERSHOOT = 0.05


@dataclass(frozen=True)
class Motion:
    """x'' + 2 D w x' + w^2 x = w^2 g P, fitted with one assumed lateness of the pressure."""

    late: float
    """[s]."""
    w: float
    """Natural frequency [rad/s]."""
    D: float
    """Damping ratio [1]."""
    g: float
    """Stroke per pressure [m/Pa]."""
    rms: float
    """[m]."""
    model: Array


@dataclass(frozen=True, eq=False)
class Step:
    """One measured step; times in seconds from the command."""

    trial: TrialData
    t: Array
    P: Array
    x: Array
    size: float
    """Change of measured pressure [Pa]."""
    stroke: float
    """Change of contraction at the end of the trial [m]."""
    dead: float
    """Command to pressure [s]: both in the middle of the samples that they lie between, the lateness taken off."""
    dead_half: float
    """Half of those intervals together [s]."""
    rise: float
    """From onset to 63 % of the change of pressure [s]."""
    rise_half: float
    """Half the time between the samples that the onset lies between [s]."""
    motions: tuple[Motion, ...]

    @property
    def best(self) -> Motion:
        """The motion with the least misfit."""
        return min(self.motions, key=lambda motion: motion.rms)

    @property
    def name(self) -> str:
        """`run/index`."""
        return self.trial.name

    @property
    def found(self) -> bool:
        """Found in the measured pressure, since no command was recorded."""
        return any(command.data.get("found") for command in self.trial.commands)


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """t_d [s], tau_P [s], X [m], dP/dx [Pa/m] and, where they can be told, K [N/m] and B [N.s/m] of recorded steps.

    Pressure and displacement at one load give the ratios B/K and (dF_ce/dP)/K only, never K itself. Where the moving
    `mass` of the point is known and the motion rings, M x'' + B x' + K x = (dF_ce/dP) P + const, driven by the
    measured pressure, gives K = M w^2 and B = 2 D w M. The pressure may be older than its time stamp (`late_by` of the
    map): K and B are told as the range over that time, and not at all where the range is as wide as the value.

    Repeats are trials with the same commanded pressures before and after. `options`: `mass` [kg] and `late_by`
    [[least, most] in s] instead of what the record says.
    """
    options = options or {}
    steps, dropped, told = measured(runs, options, measure)
    groups: dict[tuple[float, float], list[tuple[RunData, Step]]] = {}
    for run, step in steps:
        point = step.trial.point
        groups.setdefault((round(point["from"], -2), round(point["pressure"], -2)), []).append((run, step))
    commanded = [step for _, step in steps if not step.found]
    estimates: list[Estimate] = [_dead_time(commanded)] if commanded else []
    findings: list[Finding] = []
    for (before, after), group in sorted(groups.items()):
        at = {"from": before, "pressure": after}
        estimates += _at(at, group, options)
        findings += _sentences(at, [step for _, step in group])
    if len(commanded) < len(steps):
        text = f"{len(steps) - len(commanded)} steps were found in the measured pressure: they tell no dead time"
        findings.append(Finding("note", text))
    if steps and not told:
        findings.append(Finding("doubt", "nothing is known of the time between the channels: K and B assume none"))
    if any(e.symbol == "K" and e.value is not None for e in estimates):
        text = "K and B rest on the moving mass alone, taken as exact; the load hangs and F_ce(P) is not known here"
        findings.append(Finding("doubt", text))
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates,
        dropped=dropped,
        findings=(*import_findings(runs), *findings),
        traces=(_trace(group[0][1]) for _, group in sorted(groups.items())),
        facts={
            "options": dict(options),
            "trials": len(steps),
            "cells": len(groups),
            "flagged": flagged_counts(runs),
            "steps": [_facts(step) for _, step in steps],
        },
    )


def measure(trial: TrialData, late: tuple[float, float]) -> Step | str:
    """One step from its samples, or the reason why it cannot be measured."""
    missing = [name for name in ("pressure", "displacement") if name not in trial.channels]
    command = next((c for c in trial.commands if c.kind == "set" and c.output == "pressure"), None)
    if missing or command is None or not {"from", "pressure"} <= set(trial.point):
        return f"{' and '.join(missing)} not recorded" if missing else "it has no commanded step"
    if trial.status != "finished":
        return f"the trial is {trial.status}"
    if np.any(trial.flags & np.uint16(Flag.TIME_JUMP)):
        return "its clock jumps"
    good = trial.usable
    t = trial.t[good] - command.t
    P, x = trial.channels["pressure"][good], trial.channels["displacement"][good]
    within = command.data.get("within", 0.0)
    before, after = (t >= -BEFORE) & (t < -within), t > 0
    if np.count_nonzero(before) < FEWEST or np.count_nonzero(after) < FEWEST or t[-1] < AFTER:
        return f"too few usable samples around the step (flagged: {unusable_because(trial)})"
    settled = t > max(AFTER, t[-1] - 1.0)
    size = float(np.median(P[settled]) - np.median(P[before])) if settled.any() else 0.0
    stroke = float(np.median(x[settled]) - np.median(x[before])) if settled.any() else 0.0
    noise = float(P[before].std())
    if abs(size) < 2 * SEEN * max(noise, 1.0):
        return f"the pressure follows by {show(size, 'pressure', 3)} only, no more than its noise"
    rise = (P - np.median(P[before])) * np.sign(size)
    begun = np.flatnonzero((rise > max(SEEN * noise, 0.05 * abs(size))) & (t > -within))
    most = np.flatnonzero((rise > (1 - np.exp(-1)) * abs(size)) & (t > -within))
    if not len(begun) or not len(most) or begun[0] == 0:
        return "no onset of the pressure is seen"
    first = int(begun[0])
    onset, doubt = float(t[first] + t[first - 1]) / 2, float(t[first] - t[first - 1]) / 2
    near = (t >= -BEFORE) & (t <= AFTER)
    shifts = np.linspace(*late, SHIFTS if late[1] > late[0] else 1)
    motions = tuple(fit_motion(t[near], P[near], x[near], float(shift)) for shift in shifts)
    dead = onset + within / 2 - (late[0] + late[1]) / 2
    dead_half = doubt + within / 2 + (late[1] - late[0]) / 2
    return Step(trial, t, P, x, size, stroke, dead, dead_half, float(t[most[0]]) - onset, doubt, motions)


def fit_motion(t: Array, P: Array, x: Array, late: float) -> Motion:
    """Least squares of the driven motion over natural frequency and damping; gain and offset follow linearly.

    The measured pressure is held between its changes, as a polled channel reads, and moved `late` [s] ahead. The
    response is the sum of the exact step responses of all changes, at the stamps as they are: no resampling.
    """
    changes = np.flatnonzero(np.diff(P)) + 1
    jumps = np.diff(P)[changes - 1]
    at = t[changes] - late

    def answer(p: Array) -> tuple[Array, float]:
        driven = respond(t, at, jumps, float(np.exp(p[0])), float(np.exp(p[1])))
        off = driven - driven.mean()
        power = float(np.sum(off * off))
        g = float(np.sum(off * x)) / power if power > 0 else 0.0
        return np.asarray(x.mean() + g * off), g

    def misfit(p: Array) -> Array:
        return np.asarray((answer(p)[0] - x) / scale)

    scale = max(float(np.ptp(x)), 1e-9)
    start = np.log([40.0, 0.3])
    bounds = (np.log([FREQUENCY[0], DAMPING[0]]), np.log([FREQUENCY[1], DAMPING[1]]))
    solved = least_squares(misfit, start, bounds=bounds, max_nfev=60)
    model, g = answer(solved.x)
    rms = float(np.sqrt(np.mean((model - x) ** 2)))
    w, D = (float(value) for value in np.exp(solved.x))
    return Motion(late, w, D, g, rms, model)


def _dead_time(steps: Sequence[Step]) -> Estimate:
    """Of the regulator and its line: one value over all steps, of which those between other pressures are unlike."""
    pairs = [(round(step.trial.point["from"], -2), round(step.trial.point["pressure"], -2)) for step in steps]
    mean, half, _ = mean_over([step.dead for step in steps], [sorted(set(pairs)).index(pair) for pair in pairs])
    parts = Parts(repeats=half, method=max(step.dead_half for step in steps), calibration=0.0)
    parents = tuple(step.name for step in steps)
    resolved = "command to pressure, all steps; the log resolves no less than the method part"
    note = sentences(resolved, "no repeats part: no step was repeated" if half is None else "")
    return Estimate("t_d", mean, "s", "time", STEP, {}, parts, len(steps), note=note, trials=parents)


def _at(at: Mapping[str, float], group: Sequence[tuple[RunData, Step]], options: Mapping[str, Any]) -> list[Estimate]:
    """All estimates at one pair of commanded pressures."""
    steps = [step for _, step in group]
    parents = tuple(step.name for step in steps)
    scales = Scales.of([run for run, _ in group])

    def estimate(
        symbol: str, kind: tuple[str, str], values: Sequence[float], method: float | None, scaled: tuple[str, ...] = (),
        note: str = "",
    ) -> Estimate:  # fmt: skip
        mean, half = mean_with_half(values)
        parts = Parts(half, method, scales.part(dict.fromkeys(scaled, mean)))
        note = sentences(
            note, ONCE if half is None else "", "" if method is not None else UNASSESSED, scales.lack(scaled)
        )
        return Estimate(symbol, mean, *kind, STEP, at, parts, len(values), note=note, trials=parents)

    seconds, slopes = ("s", "time"), [step.size / step.stroke if step.stroke else inf for step in steps]
    return [
        *(
            []
            if any(s.found for s in steps)
            else [
                estimate("t_d", seconds, [s.dead for s in steps], max(s.dead_half for s in steps), note="to pressure")
            ]
        ),
        estimate("tau_P", seconds, [s.rise for s in steps], max(s.rise_half for s in steps), note="63 %"),
        estimate("X", ("m", "length"), [step.stroke for step in steps], None, ("displacement",)),
        estimate("dP/dx", ("Pa/m", "gain"), slopes, None, ("pressure", "displacement"), "at rest, includes friction"),
        *_muscle(at, steps, parents, options),
    ]


def _muscle(
    at: Mapping[str, float], steps: Sequence[Step], parents: tuple[str, ...], options: Mapping[str, Any]
) -> list[Estimate]:
    """K and B from the ringing, or why they cannot be told; from times and a mass, no scale of a channel enters."""
    kinds = (("K", "N/m", "stiffness"), ("B", "N.s/m", "damping"))
    masses = [float(options.get("mass", step.trial.point.get("mass", 0.0))) for step in steps]
    ranges: dict[str, list[tuple[float, float]]] = {"K": [], "B": []}
    why = ""
    if not all(masses):
        why = "pressure and displacement at one load give ratios only; neither F_ce(P) nor the moving mass is known"
    for step, mass in zip(steps, masses, strict=True):
        why = why or _why_not(step)
        K = [mass * motion.w**2 for motion in step.motions]
        B = [2 * motion.D * motion.w * mass for motion in step.motions]
        ranges["K"].append((min(K), max(K)))
        ranges["B"].append((min(B), max(B)))
    found = []
    for symbol, unit, quantity in kinds:
        middle = [(low + high) / 2 for low, high in ranges[symbol]]
        value, half = mean_with_half(middle)
        wide = max((high - low) / 2 for low, high in ranges[symbol])
        reason = why
        if not reason and wide > 0.5 * value:
            reason = f"lies within {wide / value:.0%} only for what is known of the time between pressure and position"
        if reason:
            found.append(Estimate(symbol, None, unit, quantity, RINGING, at, note=reason, n=len(steps), trials=parents))
            continue
        parts = Parts(repeats=half, method=wide, calibration=0.0)
        once = ONCE if half is None else ""
        found.append(Estimate(symbol, value, unit, quantity, RINGING, at, parts, len(steps), note=once, trials=parents))
    return found


def _why_not(step: Step) -> str:
    """The reason why the motion of a step says nothing of the muscle; empty where it does."""
    at_bound = [
        m
        for m in step.motions
        if not (1.02 * FREQUENCY[0] < m.w < FREQUENCY[1] / 1.02 and 1.02 * DAMPING[0] < m.D < DAMPING[1] / 1.02)
    ]
    if at_bound:
        return f"the motion follows the pressure without ringing of its own (trial {step.name})"
    worst = max(motion.rms for motion in step.motions)
    if worst > ILL_FITTED * abs(step.stroke):
        return f"the misfit is {worst / abs(step.stroke):.0%} of the stroke (trial {step.name})"
    return ""


def _sentences(at: Mapping[str, float], steps: Sequence[Step]) -> list[Finding]:
    where = f"{show(at['from'], 'pressure')} to {show(at['pressure'], 'pressure')}"
    overshoot = [
        float(np.max(np.sign(s.size) * (s.P[s.t > 0] - np.median(s.P[s.t > AFTER])))) / abs(s.size) for s in steps
    ]
    best = [step.best.late for step in steps]
    lines = []
    if np.mean(overshoot) > OVERSHOOT:
        text = f"{where}: the pressure overshoots by {float(np.mean(overshoot)):.0%}: no first-order lag describes it"
        lines.append(Finding("note", text))
    if max(best) > 0:
        lines.append(
            Finding(
                "note",
                f"{where}: the motion fits best with the pressure {show(float(np.mean(best)), 'time', 2)} late: "
                "position seems to move before the pressure that drives it",
            )
        )
    return lines


def _facts(step: Step) -> dict[str, Any]:
    return {
        "trial": step.name,
        "from": step.trial.point["from"],
        "pressure": step.trial.point["pressure"],
        "size": step.size,
        "stroke": step.stroke,
        "motions": [
            {"late": m.late, "natural_frequency": m.w, "damping_ratio": m.D, "gain": m.g, "rms": m.rms}
            for m in step.motions
        ],
    }


def _trace(step: Step) -> Trace:
    """The first trial of a pair of pressures, measured and with the best motion."""
    near = (step.t >= -BEFORE) & (step.t <= AFTER)
    point = step.trial.point
    before, after = point["from"], point["pressure"]
    return Trace(
        name=f"step-{before / 1e3:.0f}-{after / 1e3:.0f}kPa",
        figure="overlay",
        title=f"{show(before, 'pressure')} to {show(after, 'pressure')}: measured and fitted motion",
        columns={"t": step.t[near], "pressure": step.P[near], "displacement": step.x[near], "model": step.best.model},
        quantities={"t": "time", "pressure": "pressure", "displacement": "length", "model": "length"},
        marks={"pressure": after, "load": point.get("load", 0.0)},
    )
