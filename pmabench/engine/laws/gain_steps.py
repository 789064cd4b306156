"""The law `gain-steps`: raise a proportional gain level by level until the loop keeps oscillating.

It ends by itself before the oscillation leaves its window or the command saturates. Standard library only: it runs
once per sample. What the levels say about K_u is worked out later, from the samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

from pmabench.engine.laws import Timed, outside_range, refuse_wrong

LARGEST_FACTOR = 1.08
SKIPPED = 2
"""Half periods right after a kick that are left out when growth is judged: faster modes still affect them."""
SEEN = 12.0
"""Smallest peak-to-peak size of a detected swing [standard deviations of the noise]."""
FOUND = ("growth", "amplitude")
REASONS = {
    "saturated": "the command reached the end of its range before the swings grew",
    "levels": "all levels were used and the swings never grew",
    "no signal": "the measured channel gave no number",
}


@dataclass
class _Swings:
    """Finds maxima and minima of a noisy signal: one counts once the signal has come back by `threshold`."""

    threshold: float
    rising: bool = True
    extreme: float | None = None
    before: float | None = None

    def __post_init__(self) -> None:
        self.sizes: list[float] = []

    def add(self, y: float) -> None:
        """Take one sample; a finished half period adds its peak-to-peak size to `sizes`."""
        if self.extreme is None or (y > self.extreme if self.rising else y < self.extreme):
            self.extreme = y
        elif abs(y - self.extreme) > self.threshold:
            if self.before is not None:
                self.sizes.append(abs(self.extreme - self.before))
            self.before, self.extreme, self.rising = self.extreme, y, not self.rising


@dataclass(kw_only=True, eq=False)
class GainSteps(Timed):
    """Proportional control u = bias + K_p (aim - y) with K_p raised in steps (Ziegler and Nichols 1942).

    First the loop settles at the starting gain while the bias is trimmed to the set-point. Then come the levels: at
    each the aim moves by `kick`, unless the loop already oscillates, and half periods are counted.

    Parameters
    ----------
    setpoint : value of `channel` [m]
    bias : command expected to hold it [Pa]
    start : gain of the first level [Pa/m]
    low, high : range of the command [Pa]; reaching it ends the search
    channel : measured channel
    factor : ratio of successive gains, at most 1.08
    half_periods : counted at each level before the next, at least 8
    kick : step of the aim that excites the loop [m], between setpoint - kick/2 and setpoint + kick/2
    noise : standard deviation of the channel's noise [m]; swings smaller than twelve times this are not seen
    settle : time at the starting gain before the first level [s]
    trim : time constant of the bias trim while settling [s]; 0 keeps the bias
    level_time : longest time at one level [s]; choose at least four expected periods
    levels : largest number of levels
    window : distance from the set-point that ends the search [m]
    beyond : levels with growing swings that end the search successfully
    """

    setpoint: float
    bias: float
    start: float
    low: float
    high: float
    channel: str = "displacement"
    factor: float = LARGEST_FACTOR
    half_periods: int = 8
    kick: float = 5e-4
    noise: float = 2e-6
    settle: float = 4.0
    trim: float = 1.0
    level_time: float = 4.0
    levels: int = 40
    window: float = 5e-3
    beyond: int = 1

    def __post_init__(self) -> None:
        bias, kick, factor = self.bias, self.kick, self.factor
        positive = self.level_time > 0 and self.levels >= 1 and self.beyond >= 1
        refuse_wrong(
            (1.0 < factor <= LARGEST_FACTOR, f"factor must be above 1 and at most {LARGEST_FACTOR}, not {factor:g}"),
            (self.half_periods >= 8, f"half_periods must be at least 8, not {self.half_periods}"),
            (self.start > 0, f"start must be above 0 Pa/m, not {self.start:g}"),
            (self.low <= bias <= self.high, outside_range(bias, self.low, self.high)),
            (kick > 0, f"kick must be above 0 m, not {kick:g}"),
            (self.window > kick, f"window must be larger than kick, {kick:g}, not {self.window:g}"),
            (self.noise >= 0 and self.settle >= 0 and self.trim >= 0, "noise, settle and trim must not be negative"),
            (positive, "level_time, levels and beyond must be above 0"),
        )
        self.threshold = max(SEEN * self.noise, 1e-3 * kick)
        self.gain = self.start
        self._aim = self.setpoint - kick / 2
        self._command = bias
        self._levels: list[dict[str, float]] = []
        self._swings = _Swings(self.threshold)
        self._grown = 0

    def update(self, t: float, values: Mapping[str, float]) -> float:
        """The command [Pa] for the sample `values` taken at `t` [s]."""
        if self.done:
            return self._command
        y = values.get(self.channel)
        if y is None or not isfinite(y):
            return self._stop("no signal", self.bias)
        step, since = self._step(t)
        if self._levels:
            if abs(y - self.setpoint) > self.window:
                return self._stop("amplitude", self.bias)
            self._swings.add(y)
            enough = len(self._swings.sizes) >= self.half_periods
            if enough or t - self._levels[-1]["t0"] >= self.level_time:
                self._next(t)
        elif since < self.settle:
            if self.trim > 0:
                trimmed = self.bias + self.gain * (self._aim - y) * step / self.trim
                self.bias = min(max(trimmed, self.low), self.high)
        else:
            self._begin(t)
        if self.done:
            return self._command
        command = self.bias + self.gain * (self._aim - y)
        if not self.low <= command <= self.high:
            command = min(max(command, self.low), self.high)
            if self._levels:
                return self._stop("saturated", command)
        self._command = command
        return command

    def _begin(self, t: float) -> None:
        """Start a level; kick the loop if it does not oscillate already."""
        sizes = self._swings.sizes
        kick = 0.0
        if not sizes or sizes[-1] < self.kick / 2:
            kick = self.kick if self._aim < self.setpoint else -self.kick
            self._aim += kick
        self._levels.append({"gain": self.gain, "t0": t, "t1": t, "kick": kick, "aim": self._aim, "half_periods": 0})
        self._swings = _Swings(self.threshold, rising=kick >= 0)

    def _close(self) -> None:
        """Note the end of the current level."""
        if self._levels:
            self._levels[-1].update(t1=self._t, half_periods=len(self._swings.sizes))

    def _next(self, t: float) -> None:
        """Close the level, judge its growth, and open the next one or end."""
        self._close()
        sizes = self._swings.sizes[SKIPPED:]
        if len(sizes) >= self.half_periods - SKIPPED and sizes[-1] >= sizes[0]:
            self._grown += 1
        if self._grown >= self.beyond:
            self._stop("growth", self.bias)
        elif len(self._levels) >= self.levels:
            self._stop("levels", self.bias)
        else:
            self.gain *= self.factor
            self._begin(t)

    def _stop(self, why: str, command: float) -> float:
        """Stop, and hold `command` from now on."""
        self._close()
        self._end(why)
        self._command = min(max(command, self.low), self.high)
        return self._command

    def result(self) -> dict[str, Any]:
        """What happened, as plain data: the levels and why it ended.

        A level has gain [Pa/m], t0, t1 [s], kick and aim [m] and the half periods seen.

        `ended` is `growth` (K_u lies below the last gain), `amplitude` (left the window), `saturated`, `levels` (all
        used, never grew), `no signal`, or `limit` where the caller stopped it. `bias` [Pa] is the trimmed one;
        `low` and `high` [Pa] are the range of the command.
        """
        self._close()
        went = self._search(
            self._ended in FOUND, REASONS.get(self._ended, ""),
            setpoint=self.setpoint, bias=self.bias, low=self.low, high=self.high, command=self._command,
        )  # fmt: skip
        return {"levels": [dict(level) for level in self._levels], **went}
