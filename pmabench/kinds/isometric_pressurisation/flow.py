"""Volume of the muscle from the mass flow while it is pressurised at a set contraction (paper 3).

V = r T m/ΔP_abs - V_dead, m = ∫ q dt over the ramp and the rest at its top; slow, so that the air has room temperature.
The zero of the meter is interpolated between its means at rest before and after the ramp; a zero error of 0.5 % of the
range would be 3.5 % of the mass. Uses the samples of a trial and the plan, not the force.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot, inf, sqrt
from typing import Any

import numpy as np

from pmabench.analysis.shared import samples
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.isometric_lines import SAME, spread
from pmabench.analysis.shared.samples import STEPS, UNUSABLE_SHARE, NotUsable, ends, noise_of
from pmabench.analysis.shared.trials import grouped, measured_trials
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Dropped, Estimate, Finding, Parts
from pmabench.store.records import Array, RunData, TrialData

FLOW = "flow"
METHOD, MEAN = "mass flow, filling", "mass flow, mean while filling"
R_AIR = 287.0
"""Gas constant of air [J/(kg K)] (paper 3)."""
ANR = 1.185e-3 / 60
"""Mass flow of one litre a minute of air at 20 degC, 1 bar and 65 % humidity, ANR (ISO 8778) [kg/s]."""
SETTLED = 0.5
"""Last share of each rest that is averaged, after regulator and meter have settled."""
PARTS = (0.15, 0.55, 0.95)
"""Shares of the ramp's pressure between which two volumes are compared."""
FEWEST = 20
SEEN = 5.0
"""Standard errors from which on a difference is significant."""
SAME_FLOW, ROUNDING = 1e-9, 1e-9
"""Flows closer than this share of the range, and pressures closer than this share of their value, count as equal."""
PILED, UNSEEN = 0.25, 0.005
"""Share of samples at exactly one value from which on the meter stays there; of a ramp at the value of a rest."""
STILL = (
    "the meter stays at one value: it is cut off at the end of the meter's range or below its least flow, its steps "
    "are too coarse, or at rest it shows no flow back, so that its zero is not seen. Fill more slowly if it is at "
    "the end of its range, faster if it is below its least flow; or use a meter for both directions without a cut-off"
)
BY_VESSEL = (
    "its plan scales the flow by a known vessel (times {:g}), which is no longer done, and unscaled the volume would "
    "be wrong by that. Calibrate the meter and measure again"
)
ONE = "one ramp: the repeats part is the noise of the meter, and repeated tests may scatter more"


@dataclass(frozen=True, eq=False)
class Filling:
    """Evaluation of one ramp after correction of the meter's zero; volumes include the dead volume."""

    trial: TrialData
    P: Array
    q: Array
    """Gauge pressure [Pa] and flow [kg/s] along the ramp up, shape (n,)."""
    volume: float
    """r T m/ΔP while filling [m3]."""
    emptied: float
    """The same while emptying [m3]; a leak or a zero error has the opposite effect on it."""
    low: float
    high: float
    """Volumes by the lower and the upper half of the ramp [m3]."""
    zero: tuple[float, float]
    """Zero of the meter before and after [kg/s]."""
    noise: float
    """Standard error of `volume` from the noise of the meter, its zero included [m3]."""
    drift: float
    """Largest error of `volume` due to the change of the zero from before to after [m3]."""
    coarse: float
    """Error of `volume` because the flow is read in steps [m3]."""

    @property
    def both_ways(self) -> bool:
        """Whether the meter measures outflow."""
        return self.emptied > 0.5 * self.volume


def measured(trial: TrialData, rT: float) -> Filling:
    """One trial with r T [J/kg]; `NotUsable` where flow, a whole ramp or a rest is missing."""
    samples.refuse_incomplete(trial, FLOW, "pressure")
    commands = [c for c in trial.commands if c.output == "pressure" and c.kind == "ramp"]
    ramps = {c.phase: c for c in commands if c.phase in ("fill", "empty")}
    moved = [ends(c) for c in trial.commands if "fill" in ramps and c.kind == "ramp" and c.t < ramps["fill"].t - 1e-9]
    if len(ramps) < 2:
        raise NotUsable("it holds no ramp up and down")
    if "contraction" not in trial.point:
        raise NotUsable("its point names no contraction")
    fill, empty = ramps["fill"], ramps["empty"]
    later = [c.t for c in trial.commands if c.t > ends(empty) + 1e-9]
    use = trial.usable & np.isfinite(trial.channels[FLOW]) & np.isfinite(trial.channels["pressure"])
    if (bad := float(np.mean(~use))) > UNUSABLE_SHARE:
        raise NotUsable(f"{bad:.0%} of the samples are flagged, and air that flowed meanwhile is not counted")
    t, q, P = trial.t[use], trial.channels[FLOW][use], trial.channels["pressure"][use]

    def rest(begin: float, end: float) -> np.ndarray[Any, np.dtype[np.bool_]]:
        rows = (t >= end - SETTLED * (end - begin)) & (t < end - 1e-9)
        if rows.sum() < FEWEST:
            raise NotUsable(f"fewer than {FEWEST} usable samples in a rest before, between or after the ramps")
        return np.asarray(rows)

    before = rest(max(moved, default=float(trial.t[0])), fill.t)
    top, after = rest(ends(fill), empty.t), rest(ends(empty), min(later, default=float(trial.t[-1])))
    zeros = float(q[before].mean()), float(q[after].mean())
    up = (t >= fill.t) & (t <= ends(fill))
    apart = np.diff(np.unique(q))
    step = float(apart.min(where=apart > SAME_FLOW * np.ptp(q), initial=inf))
    middle = float(t[before].mean()), float(t[after].mean())
    shown, q = q, q - np.interp(t, middle, zeros)
    levels = [float(P[rows].mean()) for rows in (before, top, after)]
    if levels[1] - max(levels[0], levels[2]) <= 20 * noise_of(P[top]) + ROUNDING * abs(levels[1]):
        raise NotUsable("the pressure does not rise along the ramp")
    if _stays(shown[up][_middle(P[up])], (shown[before], shown[after]), float(shown.min())):
        raise NotUsable(STILL)
    mass = np.concatenate(([0.0], np.cumsum(0.5 * (q[1:] + q[:-1]) * np.diff(t))))
    at = [float(mass[rows].mean()) for rows in (before, top, after)]
    per = rT / (levels[1] - levels[0])
    low, high = _halves(P[up], mass[up], levels[0], levels[1])
    duration, n = float(t[top].mean() - t[before].mean()), float(min(before.sum(), after.sum()))
    scatter = noise_of(q[up])
    noise = per * scatter * hypot(duration / sqrt(2 * n), sqrt(duration * float(np.median(np.diff(t)))))
    drift = per * 0.5 * abs(zeros[1] - zeros[0]) * duration
    coarse = per * duration * hypot(samples.unresolved(shown[up], step), samples.unresolved(shown[before], step))
    return Filling(
        trial, P[up], q[up], per * (at[1] - at[0]), rT * (at[1] - at[2]) / (levels[1] - levels[2]), rT * low, rT * high,
        zeros, noise, drift, coarse,
    )  # fmt: skip


def _share_at(q: Array, value: float) -> float:
    """Share of samples that are exactly `value`."""
    return float(np.mean(q == value))


def _stays(ramp: Array, rests: Sequence[Array], least: float) -> bool:
    """Whether the meter stays at one value along the ramp, at its least value at rest, or along the ramp as at rest."""
    rest = np.concatenate(rests)
    still = float(np.median(rest))
    return (
        np.unique(ramp, return_counts=True)[1].max() > PILED * len(ramp)
        or any(_share_at(one, least) > PILED for one in rests)
        or (_share_at(rest, still) > PILED and _share_at(ramp, still) > UNSEEN)
    )


def _halves(P: Array, mass: Array, bottom: float, top: float) -> list[float]:
    """Slopes of mass over pressure along the lower and the upper half of a ramp [kg/Pa]."""
    share = (P - bottom) / (top - bottom)
    parts = [(share >= begin) & (share < end) for begin, end in pairwise(PARTS)]
    if min(rows.sum() for rows in parts) < FEWEST:
        raise NotUsable("too few samples along the ramp")
    return [float(np.polyfit(P[rows] - P[rows].mean(), mass[rows], 1)[0]) for rows in parts]


def by_flow(runs: Sequence[RunData], scales: Scales) -> tuple[list[Estimate], list[Finding], list[Dropped]]:
    """V [m3] and mean flow [kg/s] at each contraction, if the plan has a meter."""
    found: list[Filling] = []
    dropped: list[Dropped] = []
    given: Mapping[str, Any] = {}
    for run in runs:
        settings = samples.settings_of(run).get(FLOW)
        if settings and (gain := float(settings.get("gain", 1.0))) != 1:
            why = f"no volume by mass flow: {BY_VESSEL.format(gain)}"
            dropped += [Dropped(trial.name, trial.point, why) for trial in run.trials]
            continue
        if not settings or (given and settings != given):
            continue
        given = settings
        rT = R_AIR * float(settings["temperature"])
        some, lacking = measured_trials([run], lambda _, trial, rT=rT: measured(trial, rT))  # type: ignore[misc]
        found += some
        dropped += [replace(one, reason=f"no volume by mass flow: {one.reason}") for one in lacking]
    cells = grouped(found, lambda filling: round(filling.trial.point["contraction"], SAME))
    estimates: list[Estimate] = []
    findings: list[Finding] = []
    for x, group in sorted(cells.items()):
        estimates += _estimates(x, group, given, scales)
        findings.append(_words(x, group))
    if estimates:
        dead, half = (show(given[name], "volume", 4) for name in ("dead", "dead_half"))
        text = f"volumes by mass flow: {dead} +- {half} between meter and muscle taken off, air at "
        findings.append(Finding("note", f"{text}{given['temperature']:g} +- {given['temperature_half']:g} K"))
        if lack := scales.lack((FLOW, "pressure")):
            findings.append(Finding("note", lack))
    return estimates, findings, dropped


def _estimates(x: float, group: Sequence[Filling], given: Mapping[str, Any], scales: Scales) -> list[Estimate]:
    """V and mean flow of one contraction."""
    whole = float(np.mean([one.volume for one in group]))
    noise = sqrt(float(np.mean([one.noise**2 for one in group])) / len(group)) * 2.0
    scatter = spread([one.volume for one in group]) or 0.0
    air = whole * float(given["temperature_half"]) / float(given["temperature"])
    method, calibration = hypot(float(given["dead_half"]), air), scales.part({FLOW: whole, "pressure": -whole})
    how: dict[str, Any] = {"at": {"contraction": x}, "n": len(group), "trials": tuple(one.trial.name for one in group)}
    how["note"] = ONE if len(group) == 1 else ""
    parts = Parts(max(noise, scatter), method, calibration)
    V = Estimate("V", whole - float(given["dead"]), "m3", "volume", METHOD, parts=parts, **how)
    flows = [float(one.q[_middle(one.P)].mean()) for one in group]
    flow, flow_noise = float(np.mean(flows)), 2.0 * abs(flows[0]) * noise / whole if whole > 0 else 0.0
    parts = Parts(max(flow_noise, spread(flows) or 0.0), calibration=scales.part({FLOW: flow}))
    q = Estimate("q", flow, "kg/s", "mass flow", MEAN, parts=parts, **how)
    doubts = _doubts(group)
    # missing or false flow has the same relative effect on the mean flow
    of_flow = [replace(one, half=abs((q.value or 0.0) / whole) * one.half) for one in doubts]
    return [weighed(V, doubts), weighed(q, of_flow)]


def _middle(P: Array) -> Array:
    """Rows of a ramp between the shares of pressure that are evaluated."""
    share = (P - P.min()) / np.ptp(P)
    return np.asarray((share >= PARTS[0]) & (share <= PARTS[-1]))


def _doubts(group: Sequence[Filling]) -> list[Doubt]:
    """Leak, volume that depends on pressure, and zero errors of the meter."""
    noise = sqrt(float(np.mean([one.noise**2 for one in group])) / len(group))
    apart = float(np.mean([one.high - one.low for one in group]))
    more = (
        f"the upper half of the ramp gives {show(apart, 'volume', 3)} more than the lower: the volume depends on the "
        "pressure, air leaks, or the zero of the meter is wrong. Look for the leak, and take a longer zero"
    )
    # half the ramp has the same zero error of the flow, for half of the mass
    found = [
        Doubt("dependence on pressure", "method", abs(apart) / 2, abs(apart) > 3 * SEEN * noise, more),
        Doubt("zero of the meter", "drift", max(one.drift for one in group), seen=False),
        Doubt(STEPS, "method", max(one.coarse for one in group), seen=False),
    ]
    if all(one.both_ways for one in group):
        back = float(np.mean([one.volume - one.emptied for one in group]))
        less = (
            f"emptying gives {show(back, 'volume', 3)} less than filling: air leaks between meter and muscle, it has "
            "not the room's temperature, or the meter is not alike in both directions. Look for the leak, and "
            "fill more slowly"
        )
        found.append(Doubt("filling and emptying", "method", abs(back) / 2, abs(back) > 2 * SEEN * noise, less))
    return found


def _words(x: float, group: Sequence[Filling]) -> Finding:
    """Flow in litres per minute and the zero at one contraction."""
    flow = float(np.mean([one.q[_middle(one.P)].mean() for one in group])) / ANR
    before, after = (float(np.mean([one.zero[i] for one in group])) / ANR for i in (0, 1))
    text = (
        f"{show(x, 'length')}: {flow:.4g} l/min (ANR) while filling; zero of the meter {before:.4g} before and "
        f"{after:.4g} after, taken off"
    )
    return Finding("note", text)
