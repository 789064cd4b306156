"""Searches of static load: loads, the pressures at which they lift and set down, and those carried to x = 0.

A load that was lifted hangs a little above its support, at x_s, until friction lets go of it, so that set-down belongs
to F_ce(P) = F_L + K x_s - f and not to F_L - f. With s = dF_ce/dP, P - K x/s is the pressure that the same friction
would need at x = 0. Before it breaks away friction grows with the ramp, and after that it falls: the least of
P - K x/s on the way down, and the largest on the way up, are of the break-away.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmabench.analysis.verdict.agreement import Offer
from pmabench.store.analyses.results import Dropped
from pmabench.store.records import Array, RunData, TrialData

MEAN, LIFT, SET_DOWN = "static-mean", "static-lift", "static-set-down"
PHASES = ("lift", "set-down")


@dataclass(frozen=True, eq=False)
class Points:
    """What was found, one row per trial: load [N] and pressures [Pa]; nan where a search found nothing."""

    names: tuple[str, ...]
    load: Array
    lift: Array
    set_down: Array
    uncertain: float = 0.0
    """What the half width of K makes of a set-down that was carried to x = 0 [Pa], the mean over trials."""
    place: float = 0.0
    """Contraction at which set-down broke away [m], the mean over trials."""

    def side(self, method: str) -> Array:
        """Pressures of a method [Pa]."""
        if method == MEAN:
            return 0.5 * (self.lift + self.set_down)
        return self.lift if method == LIFT else self.set_down


def points_of(runs: Sequence[RunData]) -> tuple[Points, list[Dropped]]:
    """One row per trial that found something, and the trials that did not."""
    rows: list[tuple[str, float, float, float]] = []
    dropped: list[Dropped] = []
    for run in runs:
        for trial in run.trials:
            name = trial.name
            found = {phase: trial.found.get(phase) or {} for phase in PHASES}
            pressures = {phase: pressure_of(result) for phase, result in found.items()}
            if trial.status not in ("finished", "failed"):
                dropped.append(Dropped(name, trial.point, f"the trial is {trial.status}"))
            elif "load" not in trial.point:
                dropped.append(Dropped(name, trial.point, "the trial names no load"))
            elif not np.isfinite(list(pressures.values())).any():
                reasons = [str(result["reason"]) for result in found.values() if result.get("reason")]
                dropped.append(Dropped(name, trial.point, "; ".join(reasons) or "neither lift nor set-down was found"))
            else:
                rows.append((name, trial.point["load"], pressures["lift"], pressures["set-down"]))
    columns = np.array([row[1:] for row in rows], dtype=np.float64).reshape(len(rows), 3)
    return Points(tuple(row[0] for row in rows), columns[:, 0], columns[:, 1], columns[:, 2]), dropped


def pressure_of(result: Mapping[str, Any]) -> float:
    """Pressure of a search's result [Pa]; nan where it found nothing."""
    value = result.get("pressure")
    return float(value) if result.get("found", True) and isinstance(value, int | float) else float("nan")


def mean_pressure(run: RunData, trial: TrialData) -> float | None:
    """Mean of the pressures at which a load lifts and sets down [Pa]; None where one was not found."""
    known = [pressure_of(trial.found.get(phase) or {}) for phase in PHASES]
    return sum(known) / 2 if np.isfinite(known).all() else None


SMOOTH = 0.1
"""Pressure and displacement are means over this time [s]: the ramps are slow, and the pressure has noise."""


@dataclass(frozen=True, eq=False)
class Stiffness:
    """K [N/m] with the half width of its interval over pressure [Pa], shapes (n,); between them on straight lines."""

    P: Array
    K: Array
    half: Array
    kind: str
    """Of the test that it is from."""

    @classmethod
    def of(cls, option: Any) -> Stiffness | None:
        """From the option `stiffness`, as `option_of` makes it; None without it."""
        if not isinstance(option, Mapping):
            return None
        P, K, half = np.array(option["points"], dtype=np.float64).T
        return cls(P, K, half, str(option["from"]))

    def at(self, P: float) -> tuple[float, float]:
        """K and its half width [N/m] at a pressure [Pa], beyond the ends as at them."""
        return float(np.interp(P, self.P, self.K)), float(np.interp(P, self.P, self.half))


def option_of(others: Mapping[str, Sequence[Offer]]) -> dict[str, Any]:
    """The option `stiffness` of a static-load test from the offers of other kinds of test; empty where none has K.

    K is the one at x = 0 where a test has it there; of several tests that with the narrowest interval counts.
    """
    known = []
    for kind, offers in others.items():
        mine = [offer for offer in offers if (offer.symbol, offer.words, offer.side) == ("K", "", 0)]
        found = {P: offer.at((P, 0.0)) or e for offer in mine for (P, _), e in offer.points.items()}
        rows = [[P, e.value or 0.0, e.parts.combined or 0.0] for P, e in sorted(found.items())]
        if rows:
            share = max(half / abs(K) if K and half else np.inf for _, K, half in rows)
            known.append((share, {"stiffness": {"from": kind, "points": rows}}))
    return min(known, key=lambda one: one[0])[1] if known else {}


@dataclass(frozen=True)
class Carried:
    """What of a trial's lift and set-down belongs to x = 0: pressures [Pa]; NaN where a search found nothing."""

    lift: float
    set_down: float
    half: float
    """What the half width of K makes of the set-down [Pa]."""
    place: float
    """Contraction at which set-down broke away [m]."""


def carried(trial: TrialData, found: Mapping[str, float], slope: float, stiffness: Stiffness) -> Carried:
    """Lift and set-down of a trial; `found`: phase -> pressure [Pa] of its search, `slope` dF_ce/dP [N/Pa]."""
    nothing = float("nan")
    lift, set_down, half, place = found["lift"], found["set-down"], 0.0, nothing
    times = {phase: float((trial.found.get(phase) or {}).get("t", nothing)) for phase in found}
    for phase, up in (("lift", True), ("set-down", False)):
        if not np.isfinite(found[phase]):
            continue
        K, of_K = stiffness.at(found[phase])
        rows = _way(trial, phase, times)
        P, x = found[phase], float((trial.found.get(phase) or {}).get("displacement", 0.0))
        if rows is not None:
            carried_there = rows[0] - K / slope * rows[1]
            at = int(np.argmax(carried_there) if up else np.argmin(carried_there))
            P, x = float(rows[0][at]), float(rows[1][at])
        if up:
            lift = P - K / slope * x
        else:
            set_down, half, place = P - K / slope * x, of_K / slope * abs(x), x
    return Carried(lift, set_down, half, place)


def _way(trial: TrialData, phase: str, times: Mapping[str, float]) -> tuple[Array, Array] | None:
    """Pressure and displacement along the slow ramp that ended at the crossing, smoothed; None where not recorded."""
    if "pressure" not in trial.channels or "displacement" not in trial.channels or not np.isfinite(times[phase]):
        return None
    ramps = [c.t for c in trial.commands if c.kind == "ramp" and c.phase == phase and c.t < times[phase]]
    begin = max(ramps, default=float(trial.t[0]) if phase == "lift" else times["lift"])
    use = (trial.t >= begin) & (trial.t <= times[phase]) & trial.usable
    width = max(1, round(SMOOTH / float(np.median(np.diff(trial.t))))) if len(trial.t) > 1 else 1
    if not np.isfinite(begin) or np.count_nonzero(use) < 2 * width:
        return None
    window = np.ones(width) / width
    P, x = (np.convolve(trial.channels[name][use], window, mode="valid") for name in ("pressure", "displacement"))
    return P, x
