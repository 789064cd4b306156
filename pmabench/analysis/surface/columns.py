"""What each term of the muscle makes of the past of a trial: splines, stops, lags; functions of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from pmabench.analysis.surface.record import Record
from pmabench.store.records import Array

DEGREE = 3
SLIDES = 0.0003
"""Half the way over which friction turns round that counts as turning at once, as a share of the range of x."""
STOPS_X = (0.003, 0.01, 0.03, 0.08, 0.23)
"""Half widths of the stops on contraction over its range: 0.15 to 12 mm of 52 mm."""
STOPS_P = (1 / 60, 1 / 20, 1 / 6, 0.3)
"""Half widths of the stops on pressure over the highest pressure: 10 to 180 kPa of 600 kPa. One of half the range never
slips: it is a spring, which the surface has already.
"""
TIMES = (0.3, 0.95, 3.0, 9.5, 30.0, 95.0, 300.0)
"""Time constants of creep [s], two in a decade: their sum can follow a straight line over the logarithm of time."""
SETTLED = 5.0
"""Time [s] before a record since which the muscle has been where it begins."""
FAST = 5.0
"""Lags of less time [s] are counted from where they end, so that the surface is the muscle this long after a move:
slow tests do not tell faster creep from stiffness.
"""
LAW = np.maximum(0.0, 1.0 - np.abs(np.arange(len(TIMES))[:, None] - np.array([0.0, 3.0, 6.0])) / 3.0)
"""Weights of the lags in each column of creep: straight lines over the logarithm of time between three of them."""
STEP = 50e3
"""Distance of the pressures between which the straight form has straight lines [Pa]."""
INTERVALS_P = (0.0, 1 / 3, 2 / 3, 1.0)
INTERVALS_X = (0.0, 1 / 13, 5 / 26, 5 / 13, 8 / 13, 1.0)
"""Knots over the range of x, closer near the longest muscle, where the force falls fastest."""


@dataclass(frozen=True)
class Axis:
    """Cubic B-splines over a range; beyond it they go on as straight lines. One constant where there is no range."""

    low: float
    high: float
    shares: tuple[float, ...]
    """Knots as shares of the range, from 0 to 1."""

    @property
    def span(self) -> float:
        """Width of the range."""
        return self.high - self.low

    @property
    def size(self) -> int:
        """Number of functions."""
        return len(self.shares) + DEGREE - 1 if self.span > 0 else 1

    def share(self, at: Array) -> Array:
        """Where values lie in the range, 0 to 1 and cut there; 0 where there is no range."""
        return np.clip((at - self.low) / self.span, 0.0, 1.0) if self.span > 0 else np.zeros_like(at)

    def functions(self, at: Array, slope: bool = False) -> Array:
        """Values of the functions, or their slopes, at places of shape (n,); shape (n, size)."""
        if self.span <= 0:
            return np.full((len(at), 1), 0.0 if slope else 1.0)
        knots = self._knots()
        inside = np.clip(at, self.low, self.high)
        steep = BSpline(knots, np.eye(self.size), DEGREE).derivative()(inside)
        if slope:
            return np.asarray(steep)
        values = BSpline.design_matrix(inside, knots, DEGREE).toarray()
        return np.asarray(values + (at - inside)[:, None] * steep)

    def bends(self) -> Array:
        """Third derivative within each interval times the cube of its width, (intervals, size): what it bends there.

        A parabola has none: where no rows are, the functions go on as one.
        """
        if self.span <= 0:
            return np.zeros((0, 1))
        knots = np.array(self.shares)
        third = BSpline((self._knots() - self.low) / self.span, np.eye(self.size), DEGREE).derivative(3)
        return np.asarray(third(0.5 * (knots[1:] + knots[:-1])) * np.diff(knots)[:, None] ** 3)

    def _knots(self) -> Array:
        inner = self.low + self.span * np.array(self.shares)
        return np.concatenate([[self.low] * DEGREE, inner, [self.high] * DEGREE])


@dataclass(frozen=True)
class Frame:
    """Ranges of pressure [Pa] and contraction [m] over which a muscle is fitted; sizes of stops follow from them."""

    P: Axis
    x: Axis

    @classmethod
    def over(cls, P: Sequence[float], x: Sequence[float]) -> Frame:
        """The frame of lowest and highest pressure [Pa] and contraction [m]."""
        return cls(Axis(P[0], P[1], INTERVALS_P), Axis(x[0], x[1], INTERVALS_X))

    @property
    def radii(self) -> Array:
        """Half widths of the stops on contraction [m]: first the one that slides at once."""
        return np.array([SLIDES, *STOPS_X]) * max(self.x.span, 1e-9)

    @property
    def pressure_radii(self) -> Array:
        """Half widths of the stops on pressure [Pa]."""
        return np.array(STOPS_P) * max(self.P.high, 1.0)

    def surface(self, P: Array, x: Array) -> Array:
        """Products of the splines of both axes, shape (n, size of P times size of x)."""
        return _products(self.P.functions(P), self.x.functions(x))

    def slope(self, P: Array, x: Array) -> Array:
        """Derivative of the products over x [1/m]."""
        return _products(self.P.functions(P), self.x.functions(x, slope=True))

    @property
    def pressures(self) -> Array:
        """Where the straight lines between pressures of the straight form meet [Pa], `STEP` apart."""
        return np.linspace(self.P.low, self.P.high, max(2, round(self.P.span / STEP) + 1))

    def straight(self, P: Array, x: Array) -> Array:
        """A straight line over contraction whose height and slope are straight lines between `pressures`."""
        hats = np.column_stack([np.interp(P, self.pressures, one) for one in np.eye(len(self.pressures))])
        return np.hstack([hats, -hats * x[:, None]])

    def bends(self) -> Array:
        """Sum of squared bends along both axes, as a matrix of the surface's coefficients."""
        along_P, along_x = self.P.bends(), self.x.bends()
        return np.kron(along_P.T @ along_P, np.eye(self.x.size)) + np.kron(np.eye(self.P.size), along_x.T @ along_x)


def _products(one: Array, other: Array) -> Array:
    return np.asarray((one[:, :, None] * other[:, None, :]).reshape(len(one), -1))


def between(share: Array, columns: Array) -> Array:
    """Columns (n, m) times 1 - share and times share: weights that are a line over the range; shape (n, 2 m)."""
    return np.hstack([columns * (1.0 - share)[:, None], columns * share[:, None]])


@dataclass(frozen=True, eq=False)
class Memory:
    """What a muscle remembers along the rows of records one after the other; shapes (n, number)."""

    stops_x: Array
    """Each stop over its half width, -1 to 1."""
    stops_P: Array
    lag_x: Array
    """Contraction behind each of `TIMES` [m], from the nominal length on; for those below `FAST` less contraction."""
    lag_P: Array
    """Pressure behind each of `TIMES` [Pa], in the same way."""


def memory(records: Sequence[Record], frame: Frame) -> Memory:
    """Stops and lags along records, of a muscle that was rested, vented and at nominal length before.

    It came to the first place of a record that does not go on `SETTLED` before; a length that is set by hand, long ago.

    A stop of half width r: S <- min(r, max(-r, S + change of u)). A lag: T y' = u - y, exact for u straight between
    rows.
    """
    parts: list[tuple[Array, ...]] = []
    for chain in chains(records):
        t, P, x = (np.concatenate([getattr(r, name) for r in chain]) for name in ("t", "P", "x"))
        settled = 1.0 - np.exp(-SETTLED / np.array(TIMES))
        settled_x = x[0] * (np.ones_like(settled) if chain[0].by_hand else settled)
        start_P = np.maximum(-1.0, np.minimum(1.0, P[0] / frame.pressure_radii - 1.0))
        start_x = np.clip(x[0] / frame.radii, -1.0, 1.0)
        stopped = stops(x, frame.radii, start_x), stops(P, frame.pressure_radii, start_P)
        fast = np.array(TIMES) < FAST
        behind = [lags(t, u, start) - np.outer(u, fast) for u, start in ((x, settled_x), (P, P[0] * settled))]
        parts.append((*stopped, *behind))
    return Memory(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def chains(records: Sequence[Record]) -> list[list[Record]]:
    """Records that go on one after the other, together."""
    found: list[list[Record]] = []
    for record in records:
        if record.goes_on and found:
            found[-1].append(record)
        else:
            found.append([record])
    return found


def stops(u: Array, radii: Array, start: Array) -> Array:
    """Stop operators of half widths `radii` (m,) along u (n,), over their half widths, from `start` (m,) on; (n, m)."""
    found = np.empty((len(u), len(radii)))
    state = np.array(start, dtype=np.float64)
    found[0] = state
    for row, change in enumerate(np.diff(u)[:, None] / radii, start=1):
        state = np.minimum(1.0, np.maximum(-1.0, state + change))
        found[row] = state
    return found


def lags(t: Array, u: Array, start: Array | float = 0.0) -> Array:
    """First-order lags of u (n,) at t (n,) [s] for each of `TIMES`, from `start` on; shape (n, number)."""
    T = np.array(TIMES)
    found = np.empty((len(u), len(T)))
    state = np.zeros(len(T)) + start
    found[0] = state
    steps = np.maximum(np.diff(t), 1e-9)[:, None]
    keep = np.exp(-steps / T)
    rise = 1.0 - (T / steps) * (1.0 - keep)
    add = u[:-1, None] * (1.0 - keep - rise) + u[1:, None] * rise
    for row in range(len(u) - 1):
        state = keep[row] * state + add[row]
        found[row + 1] = state
    return found
