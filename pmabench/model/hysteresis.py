"""Rate-independent hysteresis along a path given in closed form.

`Memory` finds the reversals of the path; subclasses define the memory between them: `Branch` here, stops in
`pmabench.model.real.plants`.

`Branch` is the model of Dahl (1968) with exponent 1: after a reversal at (x_0, F_0) the force goes to -height while x
grows and to +height while it falls, and the difference fades to 1/e over `width`. Between two reversals it is a
function of x alone, so the results do not depend on how the time is divided into calls.

Also creep after a path, in closed form: of a length after a contraction, or of a pressure after a pressure.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.real.muscle import Creep
from pmabench.model.regulator import FADED, Regulated, Trace, answer

PERIODS = 8
"""Number of periods of a sine in which reversals are searched at once [1]."""
PER_PERIOD = 32
"""Number of times per period at which the rate is evaluated [1]."""
CLOSE = 1e-15
"""Relative tolerance for the time of a reversal [1]."""


def branch(
    x: Array, x_turn: Array | float, F_turn: Array | float, height: Array | float, width: Array | float
) -> Array:
    """F_h [N] at x, same shape, after a reversal at `x_turn` with F_h = `F_turn` [N]; x and `width` in one unit."""
    end = -np.sign(x - x_turn) * height
    return np.asarray(end + (F_turn - end) * np.exp(-np.abs(x - x_turn) / width))


@dataclass(frozen=True)
class Hysteresis:
    """`height`: half width of a large loop [N]; `width`: travel over which a reversal fades to 1/e [m]."""

    height: float
    width: float

    def __post_init__(self) -> None:
        if not self.height >= 0 or not self.width > 0:
            raise ValueError(f"a hysteresis needs a height of at least 0 and a width above 0, not {self}")


class Memory(ABC):
    """Memory of a path: between two of its reversals a function of the position alone.

    `x`: value of the path at `start` [s]. Time can only advance. A copy by `copy.copy` is independent if the subclass
    replaces its state at a reversal and never changes it in place.
    """

    def __init__(self, x: float, start: float) -> None:
        self._time = start
        self._trace = Trace(start, x)
        self._turns = np.empty(0)
        self._known = start

    @abstractmethod
    def at(self, x: Array) -> Array:
        """The value at positions x between the last reversal and the next."""

    @abstractmethod
    def turn(self, x: float) -> None:
        """Note that the path reverses at position x."""

    def along(self, path: Regulated, t: Array, x: Array) -> Array:
        """Values at increasing times t [s] at positions x of `path`; all pieces of `path` since the last call count."""
        result = np.empty(t.shape)
        for trace, until, rows in path.pieces(self._time, t):
            if trace != self._trace:
                self.turn(self._trace.value(trace.start))
                self._trace, self._known = trace, trace.start
                self._turns = np.empty(0)
                self.turn(trace.value(trace.start))  # a regulator without lag jumps here
            done = rows.start
            for moment in self._turns_before(until):
                count = max(done, int(np.searchsorted(t, moment)))
                result[done:count] = self.at(x[done:count])
                done = count
                self.turn(trace.value(moment))
            result[done : rows.stop] = self.at(x[done : rows.stop])
            self._time = until
        return result

    def _turns_before(self, until: float) -> list[float]:
        """Times of the reversals of the piece before `until` [s], each returned once."""
        while self._known < until:
            window = PERIODS * 2 * math.pi / self._trace.omega if self._trace.omega else math.inf
            begin, self._known = self._known, self._known + window
            self._turns = np.concatenate((self._turns, turns(self._trace, begin, self._known)))
        count = int(np.searchsorted(self._turns, until))
        due, self._turns = self._turns[:count], self._turns[count:]
        return [float(turn) for turn in due]


class Branch(Memory):
    """F_h [N] along a path; at `start` [s] it is 0 at x [m], in the middle of the loop."""

    def __init__(self, hysteresis: Hysteresis, x: float, start: float) -> None:
        super().__init__(x, start)
        self.hysteresis = hysteresis
        self._x, self._force = x, 0.0

    def at(self, x: Array) -> Array:
        """F_h [N] at x [m]."""
        return branch(x, self._x, self._force, self.hysteresis.height, self.hysteresis.width)

    def turn(self, x: float) -> None:
        """Begin a new branch at x [m]."""
        self._x, self._force = x, float(self.at(np.array(x)))


def turns(trace: Trace, begin: float, end: float) -> Array:
    """Times between `begin` and `end` [s] at which the rate of a piece changes sign.

    Without a sine `end` may be infinite. The rate is first evaluated on a grid; after the fading parts only a sine can
    reverse.
    """
    if trace.lag or not trace.modes:
        return np.empty(0)
    grid, fading = np.empty(0), [mode for mode in trace.modes if mode[0]]
    if fading:
        slowest, fastest = min(-mode[0] for mode in fading), max(mode[1] for mode in fading)
        spacing = min(0.25 / slowest, 2 * math.pi / (PER_PERIOD * max(fastest, 1e-9)))
        early = min(end, trace.start + FADED / slowest)
        grid = np.linspace(begin, early, int((early - begin) / spacing) + 2) if begin < early else grid
    if trace.omega:
        periods = np.linspace(begin, end, PERIODS * PER_PERIOD + 1)
        grid = np.union1d(grid, periods) if grid.size else periods
    rates = trace.rates(grid)
    change = np.flatnonzero((rates[1:] > 0) != (rates[:-1] > 0))
    return _zeros(trace, grid[change], grid[change + 1], rates[change], rates[change + 1])


def _zeros(trace: Trace, low: Array, high: Array, before: Array, after: Array) -> Array:
    """Times between `low` and `high` [s], with the rates `before` and `after`, of zero rate (Illinois method)."""
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


def rubber(per_decade: float) -> Creep:
    """Relaxation of rubber as a loss of effective pressure: the share `per_decade` [1] in each decade, 0.1 s to 1e5 s.

    Two exponentials per decade: their sum is linear in the logarithm of time within 1 % of a decade.
    """
    return Creep(per_decade / 2, tuple(10.0 ** (0.5 * k) for k in range(-2, 11)))


class CreepAlong:
    """Creep after a path x: the sum of x_j with T_j x_j' = share x - x_j, all 0 at `start` [s].

    Time can only advance. A copy by `copy.copy` is independent.
    """

    def __init__(self, creep: Creep, start: float) -> None:
        self._creep, self._time = creep, start
        self._path: Trace | None = None
        self._lengths = tuple(Trace(start, 0.0) for _ in creep.times)

    def along(self, path: Regulated, t: Array) -> Array:
        """The sum [unit of the path] at increasing times t [s]; all pieces of `path` since the last call count."""
        result = np.empty(t.shape)
        for trace, until, rows in path.pieces(self._time, t):
            if trace != self._path:
                self._path = trace
                self._lengths = tuple(
                    answer(trace, self._time, length.value(self._time), lag, self._creep.share)
                    for length, lag in zip(self._lengths, self._creep.times, strict=True)
                )
            part = t[rows]
            result[rows] = sum((length.values(part) for length in self._lengths), np.zeros(part.shape))
            self._time = until
        return result
