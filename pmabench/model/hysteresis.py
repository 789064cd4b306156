"""Hysteresis that knows no rate, along a path whose turns are found in closed form; knows no muscle.

Dahl 1968 with exponent 1: after a turn at (x_0, F_0) the force goes to -height while x grows and to +height while it
falls, and the difference fades to 1/e over `width`. Between two turns it is a function of x alone, so the samples are
the same however the time is cut into stretches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.regulator import FADED, Regulated, Trace

PERIODS = 8
"""Turns of a sine are looked for in so many periods at once [1]."""
PER_PERIOD = 32
"""At how many moments of a period the way is looked at [1]."""
CLOSE = 1e-15
"""A turn that is found again so near, as a share of its time, is found [1]."""


def branch(
    x: Array, x_turn: Array | float, F_turn: Array | float, height: Array | float, width: Array | float
) -> Array:
    """F_h [N] at x, of one shape, after a turn at `x_turn` with F_h = `F_turn` [N]; x and `width` in one unit."""
    end = -np.sign(x - x_turn) * height
    return np.asarray(end + (F_turn - end) * np.exp(-np.abs(x - x_turn) / width))


@dataclass(frozen=True)
class Hysteresis:
    """Half the gap of a wide loop `height` [N], and the way over which a turn fades to 1/e `width` [m]."""

    height: float
    width: float

    def __post_init__(self) -> None:
        if not self.height >= 0 or not self.width > 0:
            raise ValueError(f"a hysteresis needs a height of at least 0 and a width above 0, not {self}")


class Branch:
    """The branch that a muscle is on, from `start` [s] on at x [m] in the middle of the loop.

    Time only goes forward. A copy made with `copy.copy` is independent.
    """

    def __init__(self, hysteresis: Hysteresis, x: float, start: float) -> None:
        self.hysteresis = hysteresis
        self._time = start
        self._x, self._force = x, 0.0
        self._trace = Trace(start, x)
        self._turns = np.empty(0)
        self._known = start

    def __copy__(self) -> Branch:
        made = object.__new__(Branch)
        made.__dict__.update(self.__dict__)
        return made

    def forces(self, path: Regulated, t: Array, x: Array) -> Array:
        """F_h [N] at rising times t [s], where `path` is at x [m]; every piece of `path` since the last call counts."""
        F = np.empty(t.shape)
        last, done = float(t[-1]), 0
        while True:
            trace, end = path.piece(self._time)
            if trace != self._trace:
                self._trace, self._known = trace, trace.start
                self._turns = np.empty(0)
                self._turn(trace.start)
            until = min(end, last)
            for turn in self._turns_before(until):
                count = int(np.searchsorted(t, turn))
                F[done:count] = self._at(x[done:count])
                done = max(done, count)
                self._turn(turn)
            self._time = until
            if end > last:
                F[done:] = self._at(x[done:])
                return F
            count = int(np.searchsorted(t, end))
            F[done:count] = self._at(x[done:count])
            done = max(done, count)

    def _at(self, x: Array) -> Array:
        return branch(x, self._x, self._force, self.hysteresis.height, self.hysteresis.width)

    def _turn(self, t: float) -> None:
        """From t [s] on the piece goes the other way."""
        x = self._trace.value(t)
        self._x, self._force = x, float(self._at(np.array(x)))

    def _turns_before(self, until: float) -> list[float]:
        """The turns of the piece that are due before `until` [s], each returned once."""
        while self._known < until:
            window = PERIODS * 2 * math.pi / self._trace.omega if self._trace.omega else math.inf
            begin, self._known = self._known, self._known + window
            self._turns = np.concatenate((self._turns, turns(self._trace, begin, self._known)))
        count = int(np.searchsorted(self._turns, until))
        due, self._turns = self._turns[:count], self._turns[count:]
        return [float(turn) for turn in due]


def turns(trace: Trace, begin: float, end: float) -> Array:
    """When, between `begin` and `end` [s], the rate of a piece changes its sign; `end` may be infinite without sine."""
    if trace.omega == 0:
        share = trace.decay / (trace.lag * trace.slope) if trace.slope else 0.0
        moment = trace.start + trace.lag * math.log(share) if share > 1 else -math.inf
        return np.array([moment]) if begin < moment < end else np.empty(0)
    grid = np.linspace(begin, end, PERIODS * PER_PERIOD + 1)
    faded = trace.start + FADED * trace.lag
    if trace.decay and begin < faded:
        early = min(end, faded)
        grid = np.union1d(grid, np.linspace(begin, early, int(4 * (early - begin) / trace.lag) + 2))
    rates = trace.rates(grid)
    change = np.flatnonzero((rates[1:] > 0) != (rates[:-1] > 0))
    return _zeros(trace, grid[change], grid[change + 1], rates[change], rates[change + 1])


def _zeros(trace: Trace, low: Array, high: Array, before: Array, after: Array) -> Array:
    """Where, between `low` and `high` [s], the rates `before` and `after` go through 0 (false position, Illinois)."""
    found, side = high, np.zeros(high.shape)
    for _ in range(100):
        last = found
        found = np.clip(high - after * (high - low) / (after - before), low, high)
        if (np.abs(found - last) <= CLOSE * np.abs(found)).all():
            break
        rate = trace.rates(found)
        now = np.where((rate > 0) == (before > 0), -1.0, 1.0)
        kept, side = np.where(now == side, 0.5, 1.0), now
        low, before = np.where(now < 0, (found, rate), (low, kept * before))
        high, after = np.where(now > 0, (found, rate), (high, kept * after))
    return found
