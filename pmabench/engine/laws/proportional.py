"""The law `p`: a proportional controller holds a channel at a set-point for a time; knows no device, no plan.

Standard library only: it runs once per sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any


class Proportional:
    """u = bias + gain (setpoint - y), clamped to `low`..`high`.

    Parameters
    ----------
    setpoint : value of `channel` to hold [SI of the channel, m for displacement]
    bias : command at which the error is expected to be 0 [SI of the output, Pa for pressure]
    gain : K_p [output per channel, Pa/m]
    duration : how long to control [s]
    low, high : range of the command [SI of the output]
    channel : measured channel, `displacement`
    """

    def __init__(
        self,
        *,
        setpoint: float,
        bias: float,
        gain: float,
        duration: float,
        low: float,
        high: float,
        channel: str = "displacement",
    ) -> None:
        if not low <= bias <= high:
            raise ValueError(f"bias {bias:g} is outside the range of the command, {low:g} to {high:g}")
        if not duration > 0:
            raise ValueError(f"duration must be above 0 s, not {duration:g}")
        self.setpoint, self.bias, self.gain = setpoint, bias, gain
        self.duration, self.low, self.high, self.channel = duration, low, high, channel
        self.done = False
        self._ended = "limit"
        self._start: float | None = None
        self._t = 0.0
        self._command = bias
        self._error = 0.0
        self._samples = self._saturated = 0

    def update(self, t: float, values: Mapping[str, float]) -> float:
        """The command [SI of the output] for the sample `values` taken at `t` [s]."""
        if self._start is None:
            self._start = t
        if self.done:
            return self._command
        self._t = t
        measured = values.get(self.channel)
        if measured is None or not isfinite(measured):
            self.done, self._ended, self._command = True, "no signal", self.bias
            return self.bias
        self._error = error = self.setpoint - measured
        command = self.bias + self.gain * error
        self._samples += 1
        if not self.low <= command <= self.high:
            self._saturated += 1
            command = self.low if command < self.low else self.high
        self._command = command
        if t - self._start >= self.duration:
            self.done, self._ended = True, "time"
        return command

    def result(self) -> dict[str, Any]:
        """What happened, as plain data: last error and command, share of clamped samples, `ended`.

        `ended` is `time` (as planned), `no signal`, or `limit` where the caller stopped it.
        """
        return {
            "setpoint": self.setpoint,
            "bias": self.bias,
            "gain": self.gain,
            "t0": self._start,
            "t1": self._t,
            "error": self._error,
            "command": self._command,
            "saturated": self._saturated / self._samples if self._samples else 0.0,
            "ended": self._ended,
        }
