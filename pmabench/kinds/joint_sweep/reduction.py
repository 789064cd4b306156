"""Reduction of sweeps of a joint: torque, stiffness, gap and loop area, each with an interval."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from pmabench.analysis.shared import joint
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.joint import BY_PRESSURE, MUSCLES, STIFFNESS, TORQUE
from pmabench.analysis.shared.trials import grouped, measured_trials
from pmabench.base.quantities import show
from pmabench.kinds.joint_sweep import RESULTS
from pmabench.kinds.joint_sweep.sweep import Sweep, flatter_by, steeper_by, sweep_of
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Trace
from pmabench.store.records import RunData, TrialData

KIND = "joint-sweep"
BRANCHES, LOOP, MEAN = "branches, 3 w cut", "loop", "mean curve"
NEAR = 0.02
"""Range around a place, as a share of the sweep, in which the steepest slope of the mean curve is taken for it."""
SURE = 4.0
"""Standard errors from which on a difference of the pressures between the directions is significant."""
PLAY = "play under the torque"
PLACES = 5
"""Number of places along the sweep at which the mean curve is given."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Stiffness K_th [N m/rad], gap H_tau [N m], loop area W [J] and torque tau [N m] of sweeps at constant pressures.

    The stiffness is minus the slope of the torque at mid sweep (joints-endurance, antagonistic muscles: a small sweep
    gives the slope of the hysteresis instead, three times as much). A sweep that is too small is refused with the
    reason. `options`: `discard` (cycles at the start; else the plan's setting, else 1).
    """
    options = options or {}
    sweeps, dropped = measured_trials(runs, lambda run, trial: sweep_of(run, trial, options))
    scales = Scales.of(runs)
    estimates, findings, traces = list[Estimate](), list[Finding](), list[Trace]()
    for at, members in _cells(sweeps).items():
        estimates += _estimates(dict(at), members, scales)
        traces.append(_trace(dict(at), members[-1]))
    findings += [Finding("doubt", f"{one.trial}: {one.reason}") for one in dropped]
    for one, turns in ((one, one.loop.turns) for one in sweeps):
        if turns is not None:
            text = f"{one.trial.name}: a turn fades on w = {show(turns.w, 'angle', 3)}; 3 w are cut after each"
            findings.append(Finding("note", text))
    findings += joint.findings(runs, [(one.trial.point, one.kept) for one in sweeps], scales, estimates)
    facts = {"options": dict(options), "trials": len(sweeps)}
    return Analysis.of(
        KIND, runs, results=RESULTS, estimates=estimates, dropped=dropped, findings=findings, traces=traces, facts=facts
    )


def stiffness_of(run: RunData, trial: TrialData) -> float:
    """Stiffness of one trial [N m/rad]; raises `NotUsable`."""
    return float(sweep_of(run, trial, {}).stiffness.mean())


COORDINATES = (*MUSCLES, "angular_speed", "lowest_angle", "highest_angle")


def _cells(sweeps: Sequence[Sweep]) -> dict[tuple[tuple[str, float], ...], list[Sweep]]:
    """The trials of one operating point together."""
    varied = [name for name in COORDINATES[3:] if len({one.trial.point[name] for one in sweeps}) > 1]
    names = (*COORDINATES[:3], *varied)
    cells = grouped(sweeps, lambda one: tuple((name, round(one.trial.point[name], 9)) for name in names))
    return dict(sorted(cells.items()))


def _estimates(at: Mapping[str, float], members: Sequence[Sweep], scales: Scales) -> Iterator[Estimate]:
    """All estimates of one operating point; a wrong pressure changes the stiffness."""
    kept, seconds = [one.kept for one in members], [one.second for one in members]
    made = partial(joint.estimate, trials=tuple(one.trial.name for one in members), kept=kept, scales=scales)
    K = float(np.mean([one.stiffness.mean() for one in members]))
    sweep, x = max(one.loop.ends[1] - one.loop.ends[0] for one in members), members[0].loop.x
    total = sum(at[name] for name in MUSCLES)
    share = 1 / total if total > 0 else 0.0
    pulls = K * float(np.ptp(x)) * share * total
    of_gap = _of_gap(members, K, pulls * share)
    stiffness, taken_off = [one.stiffness for one in members], max(one.taken_off for one in members)
    found = made("K_th", STIFFNESS, BRANCHES, stiffness, taken_off, at, by_pressure=BY_PRESSURE * K * share, by_gain=-K)
    steeper = [steeper_by(s) if s else 0.0 for s in seconds]
    flat = Doubt(PLAY, "method", max(flatter_by(one) for one in members), False)
    yield weighed(found, [joint.way(kept, K), _second(members, steeper), flat])
    # difference of the fitted open gap to that at mid sweep, and remainder of the turns in the mean curve [N.m]
    fits = [(one.loop, one.loop.turns) for one in members]
    unclosed = max(abs(2 * t.h - float(loop.middle_gap.mean())) if t else 0.0 for loop, t in fits)
    unclosed = max(unclosed, *(2 * s.w * more if s else 0.0 for s, more in zip(seconds, steeper, strict=True)))
    of_turns = [np.abs(t.of_mean(loop.x)) if t else np.zeros_like(loop.x) for loop, t in fits]
    yield weighed(made("H_tau", TORQUE, LOOP, [one.loop.middle_gap for one in members], unclosed, at), of_gap)
    corners = max(2 * abs(float(m.loop.middle_gap.mean())) * m.loop.speed / m.run.rate for m in members)
    lost = [one.loop.lost for one in members]
    W = float(np.mean([one.mean() for one in lost]))
    of_work = [replace(one, half=sweep * one.half) for one in of_gap]
    yield weighed(made("W", ("J", "work"), LOOP, lost, corners, at, by_gain=W), [*of_work, joint.way(kept, W)])
    steep = np.abs(np.gradient(members[0].loop.mean.mean(axis=0), x))
    fades = min((one.loop.turns.w for one in members if one.loop.turns is not None), default=np.inf)
    for place in np.linspace(x[0], x[-1], PLACES):
        curves = [np.array([np.interp(place, one.loop.x, cycle) for cycle in one.loop.mean]) for one in members]
        where = {**at, "angle": round(float(place), 7)}
        off = max(float(np.interp(place, m.loop.x, left)) for m, left in zip(members, of_turns, strict=True))
        # bound of the torque of both muscles, of which a pressure error changes a share
        whole = max(abs(float(np.mean(curve))) for curve in curves) + pulls
        steepest = float(steep[np.abs(x - place) <= NEAR * np.ptp(x)].max()) + off / fades
        found = made("tau", TORQUE, MEAN, curves, 0.1 * off, where, by_pressure=whole * share,
                     by_angle=steepest, by_gain=steepest * where["angle"])  # fmt: skip
        left = _second(members, [float(s.of_mean(np.array([place]))[0]) if s else 0.0 for s in seconds])
        yield weighed(found, [joint.place(kept, float(place), steepest), left], whole)


def _of_gap(members: Sequence[Sweep], K: float, per_pressure: float) -> list[Doubt]:
    """Effects of a late torque, backlash, drift and pressures on a gap [N m]; `per_pressure` [N m/Pa]."""
    late = max((one.loop.late for one in members), key=lambda doubt: (doubt.seen, doubt.half))
    gap = 2 * abs(K) * max(one.loop.speed for one in members) * late.half
    apart = np.concatenate([one.apart for one in members])
    size = float(np.abs(apart.mean(axis=0)).sum())
    scatter = float(np.linalg.norm(apart.std(axis=0, ddof=1))) / np.sqrt(len(apart)) if len(apart) > 1 else size
    text = f"the pressures differ by {show(size, 'pressure', 2)}, both muscles together, between the directions"
    reason = f"{text}: the regulators cannot follow. Sweep more slowly"
    return [
        replace(late, half=gap),
        Doubt("drift", "drift", 0.5 * max(one.loop.uneven_drift for one in members), False),
        Doubt(PLAY, "method", 2 * max(one.flank for one in members), False),
        Doubt("pressures of both directions", "method", per_pressure * size, size > SURE * scatter, reason),
    ]


def _second(members: Sequence[Sweep], each: Sequence[float]) -> Doubt:
    """Effect of a second turn on a value, from its effect in `each` member."""
    half = abs(float(np.mean(each)))
    ways = [one.second.w for one in members if one.second is not None]
    way = show(float(np.mean(ways)), "angle", 2) if ways else ""
    reason = (
        f"a part of the hysteresis, or of what creeps, fades on {way} only, and is not over at mid sweep, where it "
        "counts as stiffness. Sweep farther"
    )
    return Doubt("a second turn", "method", half, bool(ways), reason)


def _trace(at: Mapping[str, float], one: Sweep) -> Trace:
    """The last loop of an operating point, and its mean curve on the loop's own samples."""
    angle, torque = one.loop.last
    mean = np.interp(angle, one.loop.x, one.loop.mean.mean(axis=0), left=np.nan, right=np.nan)
    title = f"Torque over angle at {' and '.join(show(at[name], 'pressure') for name in MUSCLES)}"
    name = "joint-loop-" + "-".join(f"{at[name] / 1e3:g}" for name in MUSCLES) + f"-{one.trial.number}"
    marks = {**at, "K_th": float(one.stiffness.mean()), "H_tau": float(one.loop.middle_gap.mean())}
    columns = {"angle": angle, "torque": torque, "mean": mean}
    return Trace(name, "joint-loop", title, columns, {"angle": "angle", "torque": "torque", "mean": "torque"}, marks)
