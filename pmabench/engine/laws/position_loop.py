"""The law `pid`: a P, PI or PID controller takes a channel to a set-point and holds it there.

Standard library only: it runs once per sample. The discrete form of the PID is in `pmabench.model.pid`.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isfinite
from typing import Any

from pmabench.engine.laws import Timed
from pmabench.model.pid import PID, ReferencePath


class PositionLoop(Timed):
    """u = PID(setpoint - y) for `duration`, starting at the current command.

    Parameters
    ----------
    setpoint : value of `channel` to hold [SI of the channel, m for displacement]
    duration : how long to control [s]
    K_p, T_i, T_d, N, low, high, anti_windup, tracking, start : see `PID`; T_i and tracking may be None
    channel : measured channel
    path : positions [m], speed [m/s] and rest [s] of a `ReferencePath`, which replaces the set-point
    feedforward : values [SI of the output] at multiples of `every` [s], added with linear interpolation
    """

    def __init__(
        self,
        *,
        setpoint: float,
        duration: float,
        K_p: float,
        low: float,
        high: float,
        T_i: float | None = None,
        channel: str = "displacement",
        path: Mapping[str, Any] | None = None,
        feedforward: Mapping[str, Any] | None = None,
        **controller: Any,
    ) -> None:
        if not isfinite(setpoint):
            raise ValueError("the set-point is no number")
        if not duration > 0:
            raise ValueError(f"duration must be above 0 s, not {duration:g}")
        pid = self.controller = PID(K_p, inf if T_i is None else T_i, low=low, high=high, **controller)
        self.setpoint, self.duration, self.channel = setpoint, duration, channel
        self.path = None if path is None else ReferencePath(**path)
        self._ahead = [] if feedforward is None else [float(value) for value in feedforward["values"]]
        self._every = 1.0 if feedforward is None else float(feedforward["every"])
        self._settings: dict[str, Any] = {
            "K_p": K_p,
            "T_i": T_i,
            "T_d": pid.T_d,
            "N": pid.N,
            "low": low,
            "high": high,
            "start": pid.output,
            "anti_windup": pid.anti_windup,
            "tracking": controller.get("tracking"),
            "channel": channel,
            **({} if path is None else {"path": dict(path), "feedforward": feedforward is not None}),
        }
        self._error = 0.0

    def update(self, t: float, values: Mapping[str, float]) -> float:
        """The command [SI of the output] for the sample `values` taken at `t` [s].

        Without a number on its channel it ends, and the last command stays.
        """
        controller = self.controller
        if self.done:
            return controller.output
        measured = values.get(self.channel)
        if measured is None or not isfinite(measured):
            self._end("no signal")
            return controller.output
        h, since = self._step(t)
        setpoint = self.setpoint if self.path is None else self.path.place(since)
        self._error = setpoint - measured
        command = controller.update(h, setpoint, measured, self._ahead_at(since))
        self._samples += 1
        self._clipped += controller.saturated
        if since >= self.duration:
            self._end("time")
        return command

    def _ahead_at(self, since: float) -> float:
        """Feed-forward [SI of the output] at `since` [s] after the first sample; the last value after its end."""
        if not self._ahead:
            return 0.0
        place = min(max(since / self._every, 0.0), len(self._ahead) - 1.0)
        left = min(int(place), len(self._ahead) - 2) if len(self._ahead) > 1 else 0
        right = min(left + 1, len(self._ahead) - 1)
        return self._ahead[left] + (place - left) * (self._ahead[right] - self._ahead[left])

    def result(self) -> dict[str, Any]:
        """What happened, as plain data: settings, last error and command, share of clamped samples, why it ended."""
        return {
            **self._settings,
            "setpoint": self.setpoint,
            "error": self._error,
            "command": self.controller.output,
            **self._how_it_went(f"{self.channel} gave no number"),
        }
