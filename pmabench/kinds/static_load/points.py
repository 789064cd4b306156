"""Searches of static load: loads, the pressures at which they lift and set down, and their correction to x = 0.

A lifted load hangs a little above its support, at x_s, until friction releases it, so set-down belongs to F_ce(P) = F_L
+ K x_s - f and not to F_L - f. Lines x over P along the load's first 2 mm up and last 2 mm down, evaluated at x = 0,
have K at the right contraction, and friction of either direction. Where the load moved less, K comes from another test:
with s = dF_ce/dP, P - K x/s is the pressure that the same friction would need at x = 0. Friction increases with the
ramp until break-away and decreases after it, so the smallest P - K x/s on the way down, and the largest on the way up,
belong to break-away.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.samples import NotUsable, noise_of, on_time, step_of
from pmabench.analysis.shared.trials import measured_trials
from pmabench.analysis.verdict.agreement import Offer
from pmabench.store.analyses.results import Dropped
from pmabench.store.records import Array, RunData, TrialData

VALUES = 8
"""Fewest different pressures in a trial for recognising the step in which they are read."""
ZEROS, LEAST_ZERO = 6.0, 100.0
"""Readings of the vented gauge differ if they are this many standard errors plus this pressure [Pa] apart."""
UNKNOWN_GAIN, UNKNOWN_OFFSET = 0.005, 1.0
"""Gain [1] and offset [N] of a load cell whose calibration gives none."""
BEYOND = 1.5
"""Factor on what a calibration allows, from which on it is contradicted: one good cell in 20 exceeds its 95 %."""
MEAN, LIFT, SET_DOWN = "static-mean", "static-lift", "static-set-down"
PHASES = ("lift", "set-down")


@dataclass(frozen=True, eq=False)
class Points:
    """Results, one row per trial: load [N] and pressures [Pa]; nan where a search found nothing."""

    names: tuple[str, ...]
    load: Array
    lift: Array
    set_down: Array
    uncertain: float = 0.0
    """Half width of a corrected set-down because of K [Pa], mean of the trials."""
    place: float = 0.0
    """Contraction at which set-down broke away [m], the mean over trials."""
    step: float = 0.0
    """Step in which the pressure was read [Pa]; 0 if none is recognised."""
    zero: float = 0.0
    """Range of the vented gauge's reading between trials [Pa]; 0 within noise."""

    def only(self, rows: NDArray[np.bool_], later: Array) -> Points:
        """Only these `rows`, with lift and set-down shifted by `later` [Pa]; both of shape (n,)."""
        names = tuple(name for name, use in zip(self.names, rows, strict=True) if use)
        lift, set_down = (side[rows] + later[rows] for side in (self.lift, self.set_down))
        return replace(self, names=names, load=self.load[rows], lift=lift, set_down=set_down)

    def side(self, method: str) -> Array:
        """Pressures of a method [Pa]."""
        if method == MEAN:
            return 0.5 * (self.lift + self.set_down)
        return self.lift if method == LIFT else self.set_down


def step_in(runs: Sequence[RunData]) -> float:
    """Largest step in which a trial's pressures were read [Pa]; 0 if none is recognised."""
    read = [
        trial.channels["pressure"][trial.usable] for run in runs for trial in run.trials if "pressure" in trial.channels
    ]
    read = [P[np.isfinite(P)] for P in read]
    return max((step_of(P) for P in read if len(np.unique(P)) >= VALUES), default=0.0)


def zero_moved(runs: Sequence[RunData]) -> float:
    """Range of the gauge's reading before the first command of trials that begin vented [Pa]; 0 within its noise."""
    means, errors = list[float](), list[float]()
    for trial in (one for run in runs for one in run.trials if "pressure" in one.channels):
        first = next((c for c in trial.commands if c.output == "pressure"), None)
        P = trial.channels["pressure"][trial.usable & (trial.t < (-np.inf if first is None else first.t))]
        if first is not None and first.before <= 0 and len(P) >= FEWEST and np.ptp(P) > 0:  # else it is dead
            means.append(float(P.mean()))
            errors.append(max(noise_of(P), float(P.std())) / float(np.sqrt(len(P))))
    apart = max(means, default=0.0) - min(means, default=0.0)
    return apart if apart > ZEROS * max(errors, default=0.0) + LEAST_ZERO else 0.0


def on_time_run(run: RunData) -> RunData:
    """The run corrected for the lags that its channels declare: channels, and results of the searches."""
    late = {name: run.channels[name].sensor_lag for name in ("pressure", "displacement") if name in run.channels}
    return replace(run, trials=tuple(_on_time(run, trial, late) for trial in run.trials)) if any(late.values()) else run


def _on_time(run: RunData, trial: TrialData, late: Mapping[str, float]) -> TrialData:
    """The crossings are searched again in the displacement without its lag, and the pressure there without its own."""
    if len(trial.t) < 2:
        return trial
    channels = {name: on_time(run, trial, name) if name in late else y for name, y in trial.channels.items()}
    by = late.get("displacement", 0.0) if "displacement" in channels else 0.0
    found = {}
    for phase, result in trial.found.items():
        t = result.get("t") if isinstance(result, Mapping) else None
        if isinstance(t, int | float) and np.isfinite(pressure_of(result)) and "pressure" in channels:
            earlier = _crossed(trial, by, float(t), phase, result.get("displacement")) if by else float(t)
            before, after = (float(np.interp(at, trial.t, trial.channels["pressure"])) for at in (t, earlier))
            later = float(np.interp(earlier, trial.t, channels["pressure"])) - after
            result = {**result, "t": earlier, "pressure": pressure_of(result) + after - before + later}
        found[phase] = result
    return replace(trial, channels=channels, found=found)


def _crossed(trial: TrialData, lag: float, t: float, phase: str, read: object) -> float:
    """Actual time of lift or set-down [s], where the displacement behind a filter showed it at `t` [s].

    `read` is the displacement then [m], which gives the searched level above rest. The input of a first-order filter is
    its output plus the lag times its rate.
    """
    times, x = trial.t, trial.channels["displacement"]
    width = max(1, round(SMOOTH / float(np.median(np.diff(times))))) if len(times) > 1 else 1
    if len(times) < 2 * width or width < 2:
        return t - lag
    smooth = moving_mean(np.pad(x, (width // 2, width - 1 - width // 2), mode="edge"), width)
    given = smooth + lag * np.gradient(smooth, times)
    rest = float(np.median(x[: max(FEWEST, len(x) // 100)]))
    level = read - rest if isinstance(read, int | float) and read - rest > LIFTED else LIFTED
    down = np.flatnonzero((given - rest <= level) & (times <= t) & ((times > t - LASTS * lag) | (phase == "lift")))
    if not len(down):
        return t - lag
    return float(times[down[-1] if phase == "lift" else down[0]])


@dataclass(frozen=True)
class ByCell:
    """What the load cell reads of hanging loads minus what is marked on them [N], a line over the load."""

    start: float
    slope: float
    share: float
    """Largest difference as a share of its load [1]."""

    @classmethod
    def of(cls, runs: Sequence[RunData], gain: float | None, offset: float) -> ByCell | None:
        """None where the force is not recorded, or agrees within the calibration of the cell: `gain` [1], `offset` [N].

        At rest and on slow ramps the muscle pulls with the weight that hangs on it, whatever its friction.
        """
        read: dict[float, list[float]] = {}
        for trial in (one for run in runs for one in run.trials if "force" in one.channels and "load" in one.point):
            times = times_of(trial)
            F = trial.channels["force"]
            hanging = trial.usable & np.isfinite(F) & (trial.t > times["lift"]) & (trial.t < times["set-down"])
            if np.count_nonzero(hanging) >= FEWEST:
                read.setdefault(trial.point["load"], []).append(float(np.median(F[hanging])))
        loads = np.array(sorted(load for load in read if load > 0))
        off = np.array([float(np.mean(read[load])) - load for load in loads])
        known = (UNKNOWN_GAIN if gain is None else gain) * loads, offset or UNKNOWN_OFFSET
        if not (np.abs(off) > BEYOND * np.hypot(*known)).any():
            return None
        slope, start = np.polyfit(loads, off, 1) if len(loads) > 1 else (0.0, off[0])
        return cls(float(start), float(slope), float(max(off / loads, key=abs)))

    def of_force(self, a: float, s: float, row: Array) -> float:
        """Half width that it adds to `row` @ (a, s) of the line F_ce = a + s P."""
        return abs(float(row @ (self.start + self.slope * a, self.slope * s)))


def points_of(runs: Sequence[RunData]) -> tuple[Points, list[Dropped]]:
    """One row per trial that found something, and the trials that did not."""
    rows, dropped = measured_trials(runs, _searched)
    columns = np.array([row[1:] for row in rows], dtype=np.float64).reshape(len(rows), 3)
    return Points(tuple(row[0] for row in rows), columns[:, 0], columns[:, 1], columns[:, 2]), dropped


def _searched(_run: RunData, trial: TrialData) -> tuple[str, float, float, float]:
    """Name, load [N] and pressures [Pa] of a trial; raises `NotUsable`."""
    lift, down = pressures_of(trial)
    if trial.status not in ("finished", "failed"):
        raise NotUsable(f"the trial is {trial.status}")
    if "load" not in trial.point:
        raise NotUsable("no load: a column of force, its name or `point` gives it")
    if not (np.isfinite(lift) or np.isfinite(down)):
        found = [trial.found.get(phase) or {} for phase in PHASES]
        reasons = [str(result["reason"]) for result in found if result.get("reason")]
        raise NotUsable("; ".join(reasons) or "neither lift nor set-down was found")
    return trial.name, trial.point["load"], lift, down


def pressure_of(result: Mapping[str, Any]) -> float:
    """Pressure in a search's result [Pa]; nan where it found nothing."""
    value = result.get("pressure")
    return float(value) if result.get("found", True) and isinstance(value, int | float) else float("nan")


def times_of(trial: TrialData) -> dict[str, float]:
    """Phase -> time of lift and set-down [s]; NaN where not found."""
    return {phase: float((trial.found.get(phase) or {}).get("t", float("nan"))) for phase in PHASES}


def moving_mean(y: Array, width: int) -> Array:
    """Means of `width` consecutive samples."""
    return np.convolve(y, np.ones(width) / width, mode="valid")


def raised(trial: TrialData, times: Mapping[str, float]) -> Array:
    """Height of the load above its support [m], shape (n,), relative to its rest: the sensor's zero may differ, and
    drift.
    """
    x = trial.channels["displacement"]
    resting = trial.usable & (trial.t <= times["lift"])
    return x - float(np.median(x[resting])) if np.count_nonzero(resting) >= FEWEST else x


def smoothed(trial: TrialData, times: Mapping[str, float], begin: float, end: float) -> tuple[Array, Array] | None:
    """Pressure and displacement above the support from `begin` to `end` [s], smoothed over `SMOOTH`.

    None where they were not recorded, or where samples are too few.
    """
    rows = trial.usable & (trial.t >= begin) & (trial.t <= end)
    if not {"pressure", "displacement"} <= set(trial.channels) or np.count_nonzero(rows) < 3:
        return None
    width = max(1, round(SMOOTH / float(np.median(np.diff(trial.t[rows])))))
    if np.count_nonzero(rows) < 2 * width:
        return None
    return moving_mean(trial.channels["pressure"][rows], width), moving_mean(raised(trial, times)[rows], width)


def pressures_of(trial: TrialData) -> list[float]:
    """Pressures at which the load lifts and sets down [Pa]; NaN where not found."""
    return [pressure_of(trial.found.get(phase) or {}) for phase in PHASES]


def mean_pressure(run: RunData, trial: TrialData) -> float | None:
    """Mean of the pressures at which a load lifts and sets down [Pa]; None where one was not found."""
    known = pressures_of(trial)
    return sum(known) / 2 if np.isfinite(known).all() else None


SMOOTH = 0.1
"""Averaging time of pressure and displacement [s]: the ramps are slow, and the pressure is noisy."""


@dataclass(frozen=True, eq=False)
class Stiffness:
    """K [N/m] with its half width over pressure [Pa], shapes (n,); linear in between."""

    P: Array
    K: Array
    half: Array
    kind: str
    """Kind of the test from which it comes."""

    @classmethod
    def of(cls, option: Any) -> Stiffness | None:
        """From the option `stiffness` in the form of `option_of`; None without it."""
        if not isinstance(option, Mapping):
            return None
        P, K, half = np.array(option["points"], dtype=np.float64).T
        return cls(P, K, half, str(option["from"]))

    def at(self, P: float) -> tuple[float, float]:
        """K and its half width [N/m] at a pressure [Pa]; constant beyond the ends."""
        return float(np.interp(P, self.P, self.K)), float(np.interp(P, self.P, self.half))


def option_of(others: Mapping[str, Sequence[Offer]]) -> dict[str, Any]:
    """The option `stiffness` of a static-load test from the offers of other kinds of test; empty where none has K.

    K is the one at x = 0 if a test has it; of several tests the one with the narrowest interval is used.
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


NEAR = (0.8e-3, 2e-3)
"""Smallest and largest contraction of the ways up and down that are fitted [m]: the curve is bent near 0."""
LIFTED, LASTS = 0.02e-3, 8.0
"""Smallest contraction of a lifted load [m]; largest delay by a filter, in time constants."""
CLEAR = 10e-6
"""Contraction from which on samples count as lifted [m]."""
FEWEST = 20
"""Fewest samples of a way."""
BENT = 0.9
"""A parabola is used if its residual is below this share of the line's: the curve is then bent, not stepped."""
SLIP = 3.5
"""Height of the steps in which a load slips, over their standard deviation about a line."""


@dataclass(frozen=True)
class Carried:
    """Lift and set-down of a trial, corrected to x = 0: pressures [Pa]; NaN where a search found nothing."""

    lift: float
    set_down: float
    half: float
    """Half width that the correction adds to their sum [Pa]."""
    place: float
    """Contraction at the break-away of set-down [m]; NaN where it could not be corrected."""


def along_ways(trial: TrialData, found: Mapping[str, float]) -> Carried | None:
    """Lift and set-down of a trial by a line through the load's way up and one through its way down.

    `found`: phase -> pressure [Pa] of its search. None where a way is too short.
    """
    times = times_of(trial)
    if not {"pressure", "displacement"} <= set(trial.channels) or not np.isfinite(list(times.values())).all():
        return None
    good = trial.usable
    t, P, x = trial.t[good], trial.channels["pressure"][good], raised(trial, times)[good]
    if len(t) < 2 * FEWEST:
        return None
    width = max(1, round(SMOOTH / float(np.median(np.diff(t)))))
    hanging = (t >= times["lift"]) & (t <= times["set-down"])
    top = int(np.argmax(np.where(hanging, np.convolve(x, np.ones(width) / width, mode="same"), -np.inf)))
    if min(top, len(t) - top) < 2 * width:
        return None
    least = max(CLEAR, 5 * noise_of(x))
    up, down = (
        _at_0(moving_mean(P[way], width), moving_mean(x[way], width), least) for way in (slice(top), slice(top, None))
    )
    if up is None or down is None:
        return None
    place = (found["set-down"] - down[0]) / down[1]
    return Carried(up[0], down[0], float(np.hypot(up[2], down[2])), max(0.0, place))


def _at_0(P: Array, x: Array, least: float) -> tuple[float, float, float] | None:
    """Pressure at x = 0 [Pa], dP/dx [Pa/m], half width of the first, from the way near 0; None where it is too short.

    Uses contractions above `least` [m]. A load moves in small slips, which are few over 2 mm, so the residual about the
    line is not independent between samples.
    """
    rows = (x > least) & (x <= NEAR[1])
    if np.count_nonzero(rows) < FEWEST or np.ptp(x[rows]) < NEAR[0] or np.ptp(P[rows]) <= 0:
        return None
    P, x = P[rows], x[rows]
    b, a = np.polyfit(P, x, 1)
    if b <= 0:
        return None
    left, span, at_0, steep = float(np.std(x - a - b * P)), float(np.ptp(x)), float(-a / b), float(1 / b)
    c, slope, start = np.polyfit(x, P, 2)
    bent = float(np.std(P - start - slope * x - c * x**2)) / steep
    curved = float(np.sqrt(5 * max(0.0, left**2 - bent**2)))  # of a parabola: its distance from the line at the end
    if bent < BENT * left and slope > 0:
        left, at_0, steep, curved = 2 * bent, float(start), float(slope), 0.0  # the end of a parabola is less certain
    slips = max(1.0, span / (SLIP * left)) if left > 0 else 1.0
    return at_0, steep, float(np.hypot(4 * left / np.sqrt(slips), curved)) * steep


def by_stiffness(trial: TrialData, found: Mapping[str, float], slope: float, stiffness: Stiffness) -> Carried:
    """Lift and set-down of a trial with K of another test; `slope` is dF_ce/dP [N/Pa], the rest as in `along_ways`."""
    times = times_of(trial)
    lift, set_down, half, place = found["lift"], found["set-down"], 0.0, float("nan")
    for phase, up in (("lift", True), ("set-down", False)):
        if not np.isfinite(found[phase]):
            continue
        K, of_K = stiffness.at(found[phase])
        rows = _way(trial, phase, times)
        P, x = found[phase], float((trial.found.get(phase) or {}).get("displacement", 0.0))
        if rows is not None:
            at_0 = rows[0] - K / slope * rows[1]
            at = int(np.argmax(at_0) if up else np.argmin(at_0))
            P, x = float(rows[0][at]), float(rows[1][at])
        if up:
            lift = P - K / slope * x
        else:
            set_down, half, place = P - K / slope * x, of_K / slope * abs(x), x
    return Carried(lift, set_down, half, place)


def _way(trial: TrialData, phase: str, times: Mapping[str, float]) -> tuple[Array, Array] | None:
    """Smoothed pressure and displacement along the slow ramp that ended at the crossing; None where not recorded."""
    ramps = [c.t for c in trial.commands if c.kind == "ramp" and c.phase == phase and c.t < times[phase]]
    begin = max(ramps, default=-np.inf if phase == "lift" else times["lift"])
    return smoothed(trial, times, begin, times[phase])
