"""From torques at locked angles to maps of torque and stiffness, each value with an interval."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.joint import BY_PRESSURE, CUT, MUSCLES
from pmabench.analysis.shared.lines import mean_half
from pmabench.analysis.shared.samples import NotUsable
from pmabench.base.quantities import show
from pmabench.kinds.joint_torque import RESULTS
from pmabench.kinds.joint_torque.plane import plane_estimates
from pmabench.kinds.joint_torque.staircase import ORDERS, Staircase, staircase_of
from pmabench.store.analyses.results import Analysis, Dropped, Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import Array, RunData, TrialData

KIND = "joint-torque"
SIDES, GAP, SLOPE = "both sides", "gap", "polynomial"
Cells = dict[tuple[float, ...], list[Staircase]]


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Torque tau [N m] at each angle and pair of pressures, stiffness K_th [N m/rad], gap H_tau [N m].

    Where there are three pairs of pressures or more, also torque by pressure s_1, s_2 [N m/Pa] and tau_0 [N m] at each
    angle. `options`: `angles` [rad], else the plan's.
    """
    staircases, dropped = list[Staircase](), list[Dropped]()
    for run in runs:
        for trial in run.trials:
            try:
                staircases.append(staircase_of(run, trial, options or {}))
            except NotUsable as reason:
                dropped.append(Dropped(trial.name, trial.point, str(reason)))
    scales = Scales.of(runs)
    cells: Cells = {}
    for one in staircases:
        cells.setdefault(tuple(round(one.trial.point[name], 3) for name in MUSCLES), []).append(one)
    estimates = list[Estimate]()
    for pressures, members in sorted(cells.items()):
        estimates += _estimates(dict(zip(MUSCLES, pressures, strict=True)), members, scales)
    estimates += plane_estimates([e for e in estimates if e.symbol == "tau"], scales)
    findings = [Finding("doubt", f"{one.trial}: {one.reason}") for one in dropped]
    if estimates and (lack := scales.lack(("torque", "angle", *MUSCLES))):
        findings.append(Finding("note", lack))
    apart = skew.apart(runs, ("angle", "torque")) if runs else 0.0
    findings += skew.findings(runs, ("angle", "torque"), apart, estimates)
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates,
        dropped=dropped,
        findings=findings,
        traces=list(_map(cells, estimates)),
        facts={"options": dict(options or {}), "trials": len(staircases)},
    )


def gap_of(run: RunData, trial: TrialData) -> float:
    """Gap of one trial [N m]; raises `NotUsable`."""
    return float(_gap(staircase_of(run, trial, {})).mean())


def _gap(one: Staircase) -> Array:
    """The gap at the angle that is farthest from both turns [N m], shape (cycles,)."""
    middle = 0.5 * (one.trial.point["lowest_angle"] + one.trial.point["highest_angle"])
    return np.asarray(one.gap[:, int(np.argmin(np.abs(one.nominal - middle)))])


def _estimates(at: Mapping[str, float], members: Sequence[Staircase], scales: Scales) -> Iterator[Estimate]:
    """Everything at one pair of pressures; calibration to first order, a pressure that is off changes the torque."""
    trials = tuple(one.trial.name for one in members)
    total = max(sum(at.values()), 1.0)
    likely = max(float(np.max(np.abs(np.diff(m.mean.mean(axis=0)) / np.diff(m.angles)))) for m in members)
    per_pressure = BY_PRESSURE * likely / total
    """Change of the stiffness by that of one pressure [N m/rad/Pa]."""
    whole = max(float(np.abs(m.mean).max()) for m in members) + likely * float(np.ptp(members[0].nominal))
    off = max(float(np.abs(m.pressures - [at[name] for name in MUSCLES]).max()) for m in members)
    """How far a measured pressure is from the one that the trial is for [Pa]."""

    def made(
        symbol: str, kind: tuple[str, str], method: str, values: Sequence[Array], extra: float,
        angles: float, by_pressure: float = 0.0, where: Mapping[str, float] | None = None,
    ) -> Estimate:  # fmt: skip
        means = np.array([float(v.mean()) for v in values])
        value = float(means.mean())
        gains = {"torque": value} | ({"angle": angles} if angles else {})
        gains |= {name: by_pressure * at[name] for name in MUSCLES if by_pressure}
        part = scales.part(gains, dict.fromkeys(MUSCLES, by_pressure) if by_pressure else {})
        parts = Parts(mean_half(means, values), float(np.hypot(extra, by_pressure * off)), part)
        note = "one trial: the repeats part is the scatter of its cycles" if len(members) == 1 else ""
        return Estimate(symbol, value, *kind, method, where or at, parts, len(members), note=note, trials=trials)

    torque = ("N.m", "torque")
    opened = np.all([one.open for one in members], axis=0)
    yield made("H_tau", torque, GAP, [_gap(one) for one in members], _uneven(members, opened), 0.0)
    slack = next((one.slack for one in members if one.slack), "")
    why = next((one.why_no_stiffness for one in members if one.why_no_stiffness), "")
    slopes = [] if why else [(one.stiffness(), one.stiffness(ORDERS[1]).mean(axis=0)) for one in members]
    for n, angle in enumerate(members[0].nominal):
        where = {**at, "angle": round(float(angle), 9)}
        left = max(abs(float(one.left[n])) for one in members)
        misplaced = likely * max(abs(float(one.angles[n] - angle)) for one in members)
        one = made("tau", torque, SIDES, [m.mean[:, n] for m in members], float(np.hypot(left, misplaced)),
                   likely * abs(float(angle)), whole / total, where)  # fmt: skip
        lacks = slack if opened[n] else _near_a_turn(members)
        yield withhold(one, lacks) if lacks else one
        if not why and opened[n]:
            place = int(opened[:n].sum())
            other = max(abs(float(K[:, place].mean() - K3[place])) for K, K3 in slopes)
            values = [K[:, place] for K, _ in slopes]
            yield made("K_th", ("N.m/rad", "torsional stiffness"), SLOPE, values, other,
                       float(values[0].mean()), per_pressure, where)  # fmt: skip
    if why:
        middle = {**at, "angle": round(float(np.median(members[0].nominal)), 9)}
        K = made("K_th", ("N.m/rad", "torsional stiffness"), SLOPE, [np.zeros(2)], 0.0, 0.0, 0.0, middle)
        yield withhold(K, why)


def _near_a_turn(members: Sequence[Staircase]) -> str:
    w = max(one.turns.w for one in members if one.turns is not None)
    return (
        f"a turn fades on {show(w, 'angle', 3)}, and this angle is within 3 times that of one: give an overrun of at "
        f"least {show(CUT * w, 'angle', 3)}"
    )


def _uneven(members: Sequence[Staircase], opened: Array) -> float:
    """Half the change of the gap over the angles [N m]."""
    return max(0.5 * float(np.ptp(one.gap.mean(axis=0)[opened])) for one in members)


def _map(cells: Cells, estimates: Sequence[Estimate]) -> Iterator[Trace]:
    """Torque and stiffness over the angles, columns for each pair of pressures; a map for each set of angles."""
    sets: dict[tuple[float, ...], list[tuple[float, ...]]] = {}
    for pressures, members in sorted(cells.items()):
        sets.setdefault(tuple(members[0].nominal), []).append(pressures)
    for number, (angles, pairs) in enumerate(sets.items(), start=1):
        columns, quantities = {"angle": np.array(angles)}, {"angle": "angle"}
        for pressures in pairs:
            held = dict(zip(MUSCLES, pressures, strict=True))
            for name, symbol, quantity in (("torque", "tau", "torque"), ("stiffness", "K_th", "torsional stiffness")):
                values = {
                    e.at["angle"]: e.value
                    for e in estimates
                    if e.symbol == symbol and e.value is not None and held.items() <= e.at.items()
                }
                column = f"{name} at {show(pressures[0], 'pressure')} and {show(pressures[1], 'pressure')}"
                columns[column] = np.array([values.get(round(angle, 9), np.nan) for angle in angles])
                quantities[column] = quantity
        title = "Torque and stiffness over angle, by the pressures of muscle 1 and muscle 2"
        yield Trace(f"joint-map-{number}", "joint-map", title, columns, quantities)
