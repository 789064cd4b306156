"""K_u and T_u by a rising gain: the levels of each trial, the line through them, and reasons against it.

For each level of gain the mean ln of the ratio of successive swings; K_u is the zero of a line through the last levels.
Conditions of a sustained oscillation: ratio 0.95 to 1.05, swings above six times the noise, command inside its range,
periods within 5 %, a sine and not a triangle, and growth independent of the size of the swings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, log, nan, sqrt
from typing import Any

import numpy as np

from pmabench.analysis.shared import student
from pmabench.analysis.shared.samples import noise_of
from pmabench.analysis.shared.signals import SKIPPED, Swinging, describe, mode_amplitudes
from pmabench.base.quantities import show
from pmabench.kinds.ultimate_gain.ways import Examined, GainCell, Pair
from pmabench.store.analyses.results import Estimate, Parts, Trace
from pmabench.store.records import Array, TrialData

STEEPEST = 0.3
"""Levels that lose or gain more than this per half period [ln] stay out of the line: too far from K_u."""
MOST_LEVELS = 6
FEWEST_LEVELS = 3
REACHED = -log(0.95)
"""ln of the largest ratio that counts as sustained; the last level must come at least this close."""
FEWEST_SWINGS = 6
PERIOD_VARIATION = 0.05
THIRD = {"doubt": 0.006, "fault": 0.012}
"""Third harmonic over first: 0 for a sine, 0.11 for a triangle; a real loop without friction stays below 0.003."""
FRICTION = {"doubt": 0.02, "fault": 0.05}
"""Relative shift of K_u by the part of the growth that is proportional to 1/swing, as with Coulomb friction."""


@dataclass(frozen=True, eq=False)
class Level:
    """One level of gain, measured."""

    gain: float
    """K_p [Pa/m]."""
    t0: float
    t1: float
    swinging: Swinging | None
    """None with fewer than four visible swings."""
    saturated: bool
    third: float = 0.0
    """Third harmonic of the displacement over the first [1]."""
    third_noise: float = 0.0
    """Its standard deviation by noise alone [1]."""
    mean: float = nan
    """Mean of the displacement [m]."""

    @property
    def log_ratio(self) -> float:
        """Natural logarithm of the ratio of successive swings [1]; nan where unknown."""
        return self.swinging.log_ratio if self.swinging else nan

    @property
    def period(self) -> float:
        """Period [s]; nan where unknown."""
        return self.swinging.period if self.swinging else nan


@dataclass(frozen=True)
class Zero(Pair):
    """Gain at which swings neither grow nor die out, and its period; half widths from the scatter about the line."""

    line: tuple[float, float] = (nan, nan)
    """Slope [m/Pa] and value at gain 0 of ln ratio, at the set-point."""


@dataclass(frozen=True, eq=False)
class TrialFound(Examined):
    """Result of one trial."""

    levels: tuple[Level, ...]
    used: tuple[Level, ...]
    nearest: Level | None
    """The level with the smallest |ln ratio|."""
    zero: Zero = Zero()
    friction: float = 0.0
    """Relative shift of K_u by growth that depends on the swing [1]."""

    @property
    def pair(self) -> Pair:
        """K_u and T_u; NaN if refused."""
        return Pair() if self.refused else self.zero


def examine(trial: TrialData, search: Mapping[str, Any]) -> TrialFound:
    """K_u and T_u of one trial, or why there are none. `search` is the record of the law `gain-steps`."""
    levels = tuple(_measure(trial, level, search) for level in search["levels"])
    seen = [level for level in levels if level.swinging is not None and abs(level.log_ratio) < STEEPEST]
    nearest = min(seen, key=lambda level: abs(level.log_ratio)) if seen else None
    ended = str(search.get("ended", ""))
    if nearest is None or len(seen) < FEWEST_LEVELS:
        return TrialFound(levels, tuple(seen), nearest, refused=(_too_few(levels, seen, nearest, ended),))
    used = seen[-MOST_LEVELS:]
    measured = [(level.gain, level.log_ratio, level.period, level.mean) for level in used]
    gains, ratios, periods, places = np.array(measured).T
    off = places - float(search.get("setpoint", 0.0))
    zero = _zero(gains, ratios, periods, off)
    friction = _friction(used, zero.line[0] * zero.value[0])
    refused = _against(levels, nearest, used, ended, friction)
    if not (zero.line[0] > 0 and 0.5 * gains.min() < zero.value[0] < 1.2 * gains.max()):
        refused.append("growth does not rise with gain, so that no gain can be named at which it is 0")
    if refused:
        return TrialFound(levels, tuple(used), nearest, zero, friction=friction, refused=tuple(refused))
    doubts = _doubts(nearest, ratios, friction)
    return TrialFound(levels, tuple(used), nearest, zero, abs(friction), doubts=tuple(doubts))


def _measure(trial: TrialData, level: Mapping[str, Any], search: Mapping[str, Any]) -> Level:
    """One level from its samples; flagged ones are left out."""
    mask = (trial.t >= level["t0"]) & (trial.t <= level["t1"]) & trial.usable
    t, x = trial.t[mask], trial.channels["displacement"][mask]
    noise = noise_of(x)
    gain, aim = float(level["gain"]), float(level.get("aim", search.get("setpoint", 0.0)))
    saturated = False
    if "low" in search and "high" in search:
        command = float(search.get("bias", 0.0)) + gain * (aim - x)
        saturated = bool(np.any((command < search["low"]) | (command > search["high"])))
    swinging = describe(t, x, noise) if len(t) > 20 else None
    third, third_noise, mean = 0.0, 0.0, nan
    if swinging is not None:
        late = t >= swinging.times[0]
        centre, found = mode_amplitudes(t[late] - t[late][0], x[late], swinging.root)
        size = abs(complex(found[0]))
        third = abs(complex(found[2])) / size
        third_noise = noise * sqrt(2.0 / late.sum()) / size
        mean = float(centre)
    t0, t1 = float(level["t0"]), float(level["t1"])
    return Level(gain, t0, t1, swinging, saturated, third, third_noise, mean)


def _zero(gains: Array, ratios: Array, periods: Array, off: Array) -> Zero:
    """Zero of the line of ln ratio over gain, the period there, and half widths of their 95 % intervals.

    From five levels on, both lines also depend on `off`, the distance [m] of a level's mean from the set-point: kicks
    shift it, and K_u changes with it. Intervals from the scatter about the line, Student's t.
    """
    centre = float(gains.mean())
    columns = [np.ones_like(gains), gains - centre]
    if len(gains) >= FEWEST_LEVELS + 2 and np.ptp(off) > 0.1 * np.max(np.abs(off)) > 0:
        columns.append(off / np.max(np.abs(off)))
    design = np.column_stack(columns)
    inverse = np.linalg.inv(design.T @ design)
    freedom = len(gains) - len(columns)
    quantile = float(student.ppf(0.975, freedom))
    growth, clock = inverse @ design.T @ ratios, inverse @ design.T @ periods

    def error(values: Array, fitted: Array, at: Array) -> float:
        residual = values - design @ fitted
        return quantile * sqrt(float(residual @ residual) / freedom * float(at @ inverse @ at))

    beyond = -float(growth[0] / growth[1])
    at = np.zeros(len(columns))
    at[:2] = 1.0, beyond
    half_K = error(ratios, growth, at) / abs(float(growth[1]))
    half_T = sqrt(error(periods, clock, at) ** 2 + (float(clock[1]) * half_K) ** 2)
    line = (float(growth[1]), float(growth[0] - growth[1] * centre))
    return Zero((centre + beyond, float(clock @ at)), (half_K, half_T), line)


def _friction(used: Sequence[Level], slope: float) -> float:
    """Relative shift of K_u by growth proportional to 1/swing: 0 for a linear loop.

    Coulomb friction reduces each swing by a fixed step: ln ratio = (linear part of the level) - c / swing. c is fitted
    to all single ratios, with one constant per level and an alternating term; `slope` is d ln ratio / d ln K_p.
    """
    rows, single, inverse = [], [], []
    for k, level in enumerate(used):
        if level.swinging is None:
            continue
        sizes = level.swinging.sizes
        for i, ratio in enumerate(np.log(sizes[1:] / sizes[:-1])):
            row = np.zeros(2 * len(used))
            row[k], row[len(used) + k] = 1.0, (-1.0) ** i
            rows.append(row)
            single.append(float(ratio))
            inverse.append(1.0 / sqrt(sizes[i] * sizes[i + 1]))
    weight = 1.0 / np.array(inverse)
    design = np.column_stack([np.array(rows), np.array(inverse)]) * weight[:, None]
    fitted, *_ = np.linalg.lstsq(design, np.array(single) * weight, rcond=None)
    last = used[-1].swinging
    typical = float(np.median(last.sizes)) if last is not None else float("inf")
    return float(-fitted[-1] / typical / slope)


def _too_few(levels: Sequence[Level], seen: Sequence[Level], nearest: Level | None, ended: str) -> str:
    """Why there are not enough levels that swing: the gain was too low, or the muscle sticks."""
    last = next((level for level in reversed(levels) if level.swinging is not None), None)
    stop = f"; the search ended by {ended}" if ended else ""
    sticks = any(level.swinging is None for level in levels) and nearest is not None and nearest.third > THIRD["fault"]
    if not sticks and last is not None and last.log_ratio < -REACHED:
        return _too_low(levels, last) + stop
    reason = f"the loop swings at {len(seen)} of {len(levels)} levels only, {FEWEST_LEVELS} are needed"
    if sticks:
        reason += "; in between it comes to rest: a limit cycle with stiction, not an ultimate oscillation"
    return reason + stop


def _too_low(levels: Sequence[Level], last: Level) -> str:
    return (
        f"the gain was never high enough: up to {show(levels[-1].gain, 'gain', 3)} the swings die out, at the last to "
        f"{np.exp(last.log_ratio):.2f} per half period"
    )


def _against(levels: Sequence[Level], nearest: Level, used: Sequence[Level], ended: str, friction: float) -> list[str]:
    """Reasons why the trial's oscillation is not an ultimate one."""
    reasons, variation = [], 0.0 if nearest.swinging is None else nearest.swinging.period_variation
    if max(level.log_ratio for level in used) < -REACHED:
        reasons.append(_too_low(levels, used[-1]) + (f"; the search ended by {ended}" if ended else ""))
    if nearest.saturated:
        reasons.append("the command was saturated at the level nearest to sustained oscillation")
    if variation > PERIOD_VARIATION:
        reasons.append(f"the periods vary by {variation:.0%}, at most {PERIOD_VARIATION:.0%} are allowed")
    shape = min(level.third - 3 * level.third_noise for level in used[-2:])
    if shape > THIRD["fault"]:
        text = f"third harmonic {shape:.1%} of the first (sine 0, triangle 11 %)"
        reasons.append(f"limit cycle with stiction, or a muscle that relaxes much slower than it contracts: {text}")
    bent = nearest.third - 3 * nearest.third_noise
    if abs(friction) > FRICTION["doubt"] and bent > THIRD["fault"]:
        reasons.append(
            f"limit cycle with stiction: growth depends on the swing, worth {abs(friction):.1%} of K_u, and the third "
            f"harmonic is {bent:.1%} of the first; together they are worth several times that"
        )
    elif abs(friction) > FRICTION["fault"]:
        reasons.append(
            f"limit cycle with stiction: growth depends on the swing, which shifts K_u by {abs(friction):.0%}"
        )
    return reasons


def _doubts(nearest: Level, ratios: Array, friction: float) -> list[str]:
    """Weaknesses of the result that do not refuse it."""
    doubts = []
    if ratios.max() < 0:
        doubts.append("the swings never grew: K_u lies beyond the last level")
    if nearest.swinging is not None and len(nearest.swinging.sizes) < FEWEST_SWINGS - SKIPPED + 1:
        doubts.append(f"fewer than {FEWEST_SWINGS} half periods near K_u")
    if abs(nearest.log_ratio) > REACHED:
        doubts.append(f"no level held the swings within 5 %: nearest ratio {np.exp(nearest.log_ratio):.3f}")
    if nearest.third - 3 * nearest.third_noise > THIRD["doubt"]:
        doubts.append(f"not quite a sine: third harmonic {nearest.third:.1%}")
    if abs(friction) > FRICTION["doubt"]:
        doubts.append(f"growth depends on the swing, as with friction: worth {abs(friction):.1%} of K_u")
    return doubts


METHOD = "gain-steps"
CURVED = (0.008, 0.0015)
"""Relative error of K_u and of T_u because growth and period over the gain are no lines: up to 0.7 and 0.1 % in 45
loops.
"""


@dataclass(frozen=True)
class LevelsCell(GainCell[TrialFound]):
    """All trials with a rising gain at one operating point."""

    method = METHOD
    alone = "one trial: the repeats part is the scatter about its own line, and repeated tests may scatter more"

    def _estimate(self, place: int) -> Estimate:
        friction = 0.0 if place else max(one.found.friction for one in self.good)
        return self.estimate(place, Parts(method=hypot(CURVED[place], friction) * self.mean(place)))

    def traces(self) -> list[Trace]:
        """The oscillation nearest to K_u, and the growth plot."""
        trial, found, K_u = self.shown.trial, self.shown.found, self.estimates[0].value
        if not found.levels:
            return []
        at = next((i for i, level in enumerate(found.levels) if level is found.nearest), len(found.levels) - 1)
        near = found.levels[max(0, at - 1) : at + 2]
        mask = (trial.t >= near[0].t0) & (trial.t <= near[-1].t1)
        if not mask.any():
            return []
        columns: dict[str, Array] = {
            "t": trial.t[mask] - trial.t[mask][0],
            "displacement": trial.channels["displacement"][mask],
        }
        marks = {} if K_u is None else {"K_u": K_u}
        setpoint = {"setpoint": self.at.get("setpoint", 0.0)}
        traces = [self.trace("oscillation", "Oscillation nearest to the ultimate gain", columns, setpoint | marks)]
        measured = [level for level in found.levels if level.swinging is not None]
        if measured:
            gains = np.array([level.gain for level in measured])
            slope, start = found.zero.line
            columns = {
                "gain": gains,
                "log_ratio": np.array([level.log_ratio for level in measured]),
                "fit": start + slope * gains,
                "period": np.array([level.period for level in measured]),
                "used": np.array([float(level in found.used) for level in measured]),
            }
            traces.append(self.trace("growth", "Growth per half period", columns, marks))
        return traces
