"""The law `platform`: three muscles with two valves each turn a platform to attitudes and hold it there.

Paper 3's chain: angle error, moment, inverse kinematics, forces, inverse muscle, valves. The paper takes kinematics and
contraction from the measured attitude; this cancels the muscles' own stiffness with a delayed sensor and overshoots. So
they come from the reference here unless `chain` selects the paper's way. Independent of devices and plans.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pmabench.engine.laws import Orders, Pulse, Timed
from pmabench.model.many.platform import Inverse, Lags, Pair, described, on_time, tilt

CHAINS = ("reference", "measured")
PRESSURES = tuple(f"pressure_{i}" for i in (1, 2, 3))
ACCELERATIONS = ("acceleration_x", "acceleration_y", "acceleration_z")
TURNS = ("turn_x", "turn_y", "turn_z")
"""Angular speeds about the platform's own axes [rad/s], where there is a gyroscope."""
APART = 1e-3
"""Dead time between closing one valve of a muscle and opening its other valve [s]."""
STEEPEST = math.radians(20)
"""Largest tilt of Paper 3's platform [rad]."""


@dataclass(kw_only=True, eq=False)
class PlatformLoop(Timed):
    """Moment M = K_p e + K_i (integral of e), the pressures for it, and valve on-times that reach these pressures.

    Parameters
    ----------
    goals : attitudes as (begin [s], phi [rad], psi [rad]), in order; begin counts from the first sample
    duration : how long to control [s]
    K_p, K_i : proportional [N.m/rad] and integral gain [N.m/(rad s)]
    most : largest moment of the integral [N.m]
    reference_lag : time constant of each of the two lags of the reference [s]
    attitude_lag : of each of the two lags of the measured attitude [s]
    period, least : period of the pulses, and the shortest pulse that is sent [s]
    mean, low, high : mean of the three pressures, their least and greatest [Pa]
    chain : where kinematics and contraction come from, `reference` or `measured`
    gyro_time : time constant of the complementary filter where `turn_x` and `turn_y` are measured [s]
    platform : geometry and muscles, as in `model.many.platform.described`
    """

    goals: Sequence[Sequence[float]]
    duration: float
    K_p: float = 10.0
    K_i: float = 180.0
    most: float = 10.0
    reference_lag: float = 1 / 20
    attitude_lag: float = 1 / (2 * math.pi * 10)
    period: float = 0.02
    least: float = 0.002
    mean: float = 2.5e5
    low: float = 0.2e5
    high: float = 5.5e5
    chain: str = CHAINS[0]
    gyro_time: float = 0.5
    platform: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        if self.chain not in CHAINS:
            raise ValueError(f'chain "{self.chain}" is neither {CHAINS[0]} nor {CHAINS[1]}')
        if not self.goals or not self.duration > 0:
            raise ValueError("a platform needs an attitude to go to, and a duration above 0 s")
        steep = max(math.acos(math.cos(phi) * math.cos(psi)) for _, phi, psi in self.goals)
        if not steep <= STEEPEST * (1 + 1e-9):
            raise ValueError(f"a tilt of {math.degrees(steep):.3g} deg is beyond {math.degrees(STEEPEST):.3g} deg")
        self._platform = described(self.platform or {})
        self._inverse = Inverse(self._platform, self.low, self.high, self.mean)
        self._goals = [(float(begin), (float(phi), float(psi))) for begin, phi, psi in self.goals]
        self._reference: Lags | None = None
        self._filtered: Lags | None = None
        self._turned: Pair | None = None
        """Attitude (phi, psi) from the complementary filter [rad]."""
        self._integral: Pair = (0.0, 0.0)
        self._next = 0.0
        self._shuts: dict[str, float] = {}
        """When the last pulse of each valve ends [s]."""

    def update(self, t: float, values: Mapping[str, float]) -> Orders:
        """Set-points and pulses for the sample `values` [SI] taken at `t` [s].

        Without a number on one of its channels it ends and sends nothing.
        """
        if self.done:
            return Orders()
        if not all(math.isfinite(values.get(name, math.nan)) for name in (*PRESSURES, *ACCELERATIONS)):
            self._end("no signal")
            return Orders()
        if self._first is None:
            self._next = t + self.period + APART  # a pulse of an earlier loop may still last as long
        h, since = self._step(t)
        reference, attitude = self._follow(h, since, values)
        error = (reference[0] - attitude[0], reference[1] - attitude[1])
        self._integral = (
            self._clamped(self._integral[0] + self.K_i * h * error[0]),
            self._clamped(self._integral[1] + self.K_i * h * error[1]),
        )
        if since >= self.duration:
            self._end("time")
            return Orders()
        if t < self._next - 1e-9:
            return Orders()
        self._next += self.period
        goal = self._goal(since) or reference
        moment = self.K_p * error[0] + self._integral[0], self.K_p * error[1] + self._integral[1]
        return self._orders(t, goal, reference if self.chain == "reference" else attitude, moment, values)

    def _follow(self, h: float, since: float, values: Mapping[str, float]) -> tuple[Pair, Pair]:
        """Reference and filtered measured attitude [rad], `h` [s] after the previous sample."""
        measured = tilt(*(values[name] for name in ACCELERATIONS))
        if self._reference is None or self._filtered is None:
            self._reference, self._filtered = Lags(self.reference_lag, measured), Lags(self.attitude_lag, measured)
        reference = self._reference.update(h, self._goal(since) or measured)
        if not all(math.isfinite(values.get(name, math.nan)) for name in TURNS[:2]):
            return reference, self._filtered.update(h, measured)
        return reference, self._complementary(h, measured, values)

    def _goal(self, since: float) -> Pair | None:
        """Goal attitude [rad] at `since` [s] after the first sample; None before the first goal."""
        return next((at for begin, at in reversed(self._goals) if since >= begin - 1e-9), None)

    def _complementary(self, h: float, measured: Pair, values: Mapping[str, float]) -> Pair:
        """Attitude [rad]: fast changes from the gyroscope, slow ones from the accelerometer."""
        before = measured if self._turned is None else self._turned
        turned = before[0] + h * values["turn_x"] / math.cos(before[1]), before[1] + h * values["turn_y"]
        keep = math.exp(-h / self.gyro_time)
        self._turned = (measured[0] + (turned[0] - measured[0]) * keep, measured[1] + (turned[1] - measured[1]) * keep)
        return self._turned

    def _clamped(self, moment: float) -> float:
        return max(-self.most, min(self.most, moment))

    def _orders(self, t: float, goal: Pair, attitude: Pair, moment: Pair, values: Mapping[str, float]) -> Orders:
        """Pressures that make `moment` [N.m] at `attitude` [rad], and the pulses that bring the muscles there."""
        wanted = self._inverse.wanted(attitude, moment)
        self._samples += 1
        self._clipped += wanted.clipped
        pulses = []
        for i, aim in enumerate(wanted.pressures):
            P = values[PRESSURES[i]]
            seconds = min(on_time(self._platform, P, aim, wanted.contractions[i]), self.period)
            seconds = max(seconds, -self.period)
            valve, other = ("fill", "exhaust") if seconds > 0 else ("exhaust", "fill")
            if abs(seconds) >= self.least and self._shuts.get(f"{other}_{i + 1}", -math.inf) <= t - APART:
                pulses.append(Pulse(f"{valve}_{i + 1}", abs(seconds)))
                self._shuts[f"{valve}_{i + 1}"] = t + abs(seconds)
        aims = dict(zip(PRESSURES, wanted.pressures, strict=True))
        return Orders(aims | {"tilt": math.acos(math.cos(goal[0]) * math.cos(goal[1]))}, tuple(pulses))

    def result(self) -> dict[str, Any]:
        """What happened, as plain data, with the share of clipped periods and why it ended."""
        return {
            "goals": [[begin, *at] for begin, at in self._goals],
            "chain": self.chain,
            "reference_lag": self.reference_lag,
            **self._how_it_went("an accelerometer or a pressure gave no number"),
        }
