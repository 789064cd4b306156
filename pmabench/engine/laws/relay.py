"""The law `relay`: switch the command between two values so that the loop oscillates, with several amplitudes.

It ends by itself when a signal leaves its window. Standard library only: it runs once per sample. The oscillation is
analysed later, from the samples. Knows no device.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any, ClassVar

from pmabench.engine.laws import Timed, refuse_wrong

FOUND = "levels"
REASONS = {
    "window": "the position left its window",
    "pressure": "the measured pressure left its window",
    "force": "the measured force left its window",
    "slow": "the loop did not switch often enough: the amplitude is too small, or friction holds the muscle",
    "no signal": "a watched channel gave no number",
    "limit": "the search was stopped from outside",
}


@dataclass(kw_only=True, eq=False)
class Relay(Timed):
    """Relay with hysteresis about the position at which the bias holds the muscle (Astrom and Hagglund 1984).

    First the command stays at the bias until the muscle rests; the mean over the second half of that time is the
    centre. Then, level by level, the command is bias + d until y is above centre + h, and bias - d until y is below
    centre - h. Each level has its own d and h.

    Parameters
    ----------
    setpoint : where the channel is expected to rest [m]; `window` counts from here
    bias : command that is expected to hold it [Pa]
    amplitudes : d of each level [Pa]
    hysteresis : h of each level [m]
    low, high : range of the command [Pa]
    periods : whole periods of a level
    level_time : longest time of a level [s]
    settle : time at the bias before the first level [s]
    channel : measured channel
    window : distance from the set-point that ends the search [m]
    watched : channel -> lowest and highest value [SI]; leaving it ends the search
    """

    rarely: ClassVar[bool] = True

    setpoint: float
    bias: float
    amplitudes: Sequence[float]
    hysteresis: Sequence[float]
    low: float
    high: float
    periods: int
    level_time: float
    settle: float
    window: float
    channel: str = "displacement"
    watched: Mapping[str, Sequence[float]] | None = None

    def __post_init__(self) -> None:
        bias, low, high = self.bias, self.low, self.high
        sizes = (*self.amplitudes, *self.hysteresis)
        refuse_wrong(
            (
                len(self.amplitudes) == len(self.hysteresis) >= 1 and min(sizes) > 0,
                "amplitudes and hysteresis must be as many, at least one each, and above 0",
            ),
            (
                all(low <= bias - d and bias + d <= high for d in self.amplitudes),
                f"bias {bias:g} with an amplitude leaves the range of the command, {low:g} to {high:g}",
            ),
            (all(self.window > h for h in self.hysteresis), "window must be larger than every hysteresis"),
            (
                self.periods >= 2 and self.level_time > 0 and self.settle > 0,
                "periods (2), level_time and settle are too small",
            ),
        )
        self._watched = {name: (float(ends[0]), float(ends[1])) for name, ends in (self.watched or {}).items()}
        self.centre = self.setpoint
        self._command = bias
        self._sum, self._count = 0.0, 0
        self._levels: list[dict[str, Any]] = []
        self._up = True

    def update(self, t: float, values: Mapping[str, float]) -> float:
        """The command [Pa] for the sample `values` taken at `t` [s]."""
        if self.done:
            return self._command
        y = values.get(self.channel, inf)
        if not isfinite(y) or any(not isfinite(values.get(name, inf)) for name in self._watched):
            return self._stop("no signal")
        _, since = self._step(t)
        if abs(y - self.setpoint) > self.window:
            return self._stop("window")
        for name, (low, high) in self._watched.items():
            if not low <= values[name] <= high:
                return self._stop(name)
        if not self._levels:
            if since < self.settle:
                if since >= self.settle / 2:
                    self._sum, self._count = self._sum + y, self._count + 1
                return self._command
            self.centre = self._sum / self._count if self._count else y
            self._open(t)
        self._switch(t, y)
        return self._command

    def _open(self, t: float) -> None:
        at = len(self._levels)
        self._levels.append(
            {"amplitude": self.amplitudes[at], "hysteresis": self.hysteresis[at], "t0": t, "t1": t, "switches": []}
        )
        self._set(t)

    def _set(self, t: float) -> None:
        """Command the value of the relay's state, and note the time."""
        level = self._levels[-1]
        self._command = min(max(self.bias + level["amplitude"] * (1 if self._up else -1), self.low), self.high)
        level["switches"].append([t, self._command])

    def _switch(self, t: float, y: float) -> None:
        level = self._levels[-1]
        off = y - self.centre
        if off > level["hysteresis"] if self._up else off < -level["hysteresis"]:
            self._up = not self._up
            if self._up and len(level["switches"]) > 2 * self.periods:
                level["t1"] = t
                if len(self._levels) == len(self.amplitudes):
                    self._stop(FOUND)
                else:
                    self._open(t)
                return
            self._set(t)
        elif t - level["t0"] > self.level_time:
            self._stop("slow")

    def _stop(self, why: str) -> float:
        """Stop, and hold the bias from now on."""
        if self._levels and why != FOUND:
            self._levels[-1]["t1"] = self._t
        self._end(why)
        self._command = self.bias
        return self._command

    def result(self) -> dict[str, Any]:
        """What happened, as plain data: the levels, each with its switches [[s, Pa], ...], and why it ended.

        `ended` is `levels` (all done), `window`, `slow`, `no signal`, `limit` or the name of the channel that left its
        window; `centre` [m] is what the relay switched about.
        """
        found = self._ended == FOUND
        went = self._search(
            found, "" if found else REASONS.get(self._ended, f"{self._ended} left its window"),
            setpoint=self.setpoint, centre=self.centre, bias=self.bias, low=self.low, high=self.high,
            command=self._command,
        )  # fmt: skip
        return {"relay": [dict(level) for level in self._levels], **went}
