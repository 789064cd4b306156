"""The law `joint`: two antagonistic muscles turn a joint to angles and hold it there with a given stiffness.

Feed-forward: both pressures that hold the reference angle at the wanted stiffness, from a table. Feedback: the integral
of the error is a torque, which the table turns into a difference of the pressures. Independent of devices and plans.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pmabench.engine.laws import Orders, Timed

PRESSURES = ("pressure_1", "pressure_2")


@dataclass(kw_only=True, eq=False)
class JointLoop(Timed):
    """P_i = P_i0(reference) + G_i(reference) T, with the torque T = K_i times the integral of reference minus angle.

    Parameters
    ----------
    goals : angles as (begin [s], angle [rad]), in order; begin counts from the first sample
    duration : how long to control [s]
    table : `angle` [rad], ascending; at each the pressures `pressure_1`, `pressure_2` [Pa] at zero torque, and their
    change per torque `gain_1`, `gain_2` [Pa/(N m)]
    K_i : integral gain [N.m/(rad s)]; 0 for feed-forward alone
    reference_lag : time constant of each of the two lags of the reference [s]
    sine : `begin` [s], `amplitude` [rad] and `frequency` [Hz] that are added to the goal, without the lags
    low, high : least and greatest pressure [Pa]
    called_every : time between two commands [s]; the regulators are ten times slower
    """

    goals: Sequence[Sequence[float]]
    duration: float
    table: Mapping[str, Sequence[float]]
    K_i: float
    reference_lag: float
    low: float
    high: float
    sine: Mapping[str, float] | None = None
    called_every: float = 0.01

    def __post_init__(self) -> None:
        if not self.goals or not self.duration > 0 or len(self.table["angle"]) < 2:
            raise ValueError("a joint needs an angle to go to, a duration above 0 s, and a table of two angles or more")
        self._goals = [(float(begin), float(angle)) for begin, angle in self.goals]
        self._angles = [float(angle) for angle in self.table["angle"]]
        names = (*PRESSURES, "gain_1", "gain_2")
        self._rows = [tuple(map(float, row)) for row in zip(*(self.table[name] for name in names), strict=True)]
        self._sine = dict(self.sine or {})
        self._lagged = self._reference = self._torque = 0.0
        self._sent: dict[str, float] = {}

    def update(self, t: float, values: Mapping[str, float]) -> Orders:
        """Set-points for the sample `values` [SI] taken at `t` [s]; without an angle it ends and sends nothing."""
        if self.done:
            return Orders()
        angle = values.get("angle", math.nan)
        if not math.isfinite(angle):
            self._end("no signal")
            return Orders()
        if self._first is None:
            self._lagged = self._reference = angle
        h, since = self._step(t)
        keep = math.exp(-h / self.reference_lag) if self.reference_lag > 0 else 0.0
        goal = next((at for begin, at in reversed(self._goals) if since >= begin - 1e-9), angle)
        self._lagged = goal + (self._lagged - goal) * keep
        self._reference = self._lagged + (self._reference - self._lagged) * keep
        reference = self._reference + self._swing(since)
        more = self.K_i * h * (reference - angle)
        P_1, P_2, G_1, G_2 = self._row(reference)
        wanted = [(P_1, G_1), (P_2, G_2)]
        sets = [min(max(P + G * (self._torque + more), self.low), self.high) for P, G in wanted]
        stuck = any(set_to != P + G * (self._torque + more) for set_to, (P, G) in zip(sets, wanted, strict=True))
        self._samples += 1
        self._clipped += stuck
        if not (stuck and more * self._torque > 0):  # beyond a limit the integral may only become smaller
            self._torque += more
        if since >= self.duration:
            self._end("time")
        self._sent = dict(zip(PRESSURES, sets, strict=True))
        return Orders(sets=self._sent)

    def _swing(self, since: float) -> float:
        """The sine's contribution to the reference [rad], `since` [s] after the first sample."""
        if not self._sine or since < self._sine["begin"]:
            return 0.0
        phase = 2 * math.pi * self._sine["frequency"] * (since - self._sine["begin"])
        return self._sine["amplitude"] * math.sin(phase)

    def _row(self, angle: float) -> tuple[float, ...]:
        """The table at an angle [rad], linearly interpolated; constant beyond its ends."""
        place = min(max(bisect_right(self._angles, angle), 1), len(self._angles) - 1)
        low, high = self._angles[place - 1], self._angles[place]
        share = min(max((angle - low) / (high - low), 0.0), 1.0)
        return tuple(a + share * (b - a) for a, b in zip(self._rows[place - 1], self._rows[place], strict=True))

    def result(self) -> dict[str, Any]:
        """What happened, as plain data; also the share of samples with a pressure at a limit, and why it ended."""
        return {
            "goals": [list(goal) for goal in self._goals],
            "sine": self._sine,
            "reference_lag": self.reference_lag,
            "K_i": self.K_i,
            "torque": self._torque,
            "commands": self._sent,
            **self._how_it_went("the angle gave no number"),
        }
