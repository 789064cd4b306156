"""The fitted muscle: force, stiffness, loops and creep from the weights of its terms; SI throughout.

Also the basis functions of the terms: splines, stops, lags.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline

from pmabench.analysis.surface.trials import Record, Rows
from pmabench.model.identified.muscle import IdentifiedMuscle, Splines, Weights
from pmabench.store.records import Array

DEGREE = 3
SECANT_PLACES = 41
"""Number of contractions for the fit of a straight line."""
SLIDES = 0.0003
"""Half width of the stop for friction that reverses at once, over the range of x."""
WIDTHS_X = (0.003, 0.01, 0.03, 0.08, 0.23)
"""Half widths of the stops on contraction, over its range: 0.15 to 12 mm of 52 mm."""
WIDTHS_P = (1 / 60, 1 / 20, 1 / 6, 0.3)
"""Half widths of the stops on pressure, over the highest pressure: 10 to 180 kPa of 600 kPa.

One of half the range would never slip and be a spring, which is in the surface already.
"""
TIMES = (0.3, 0.95, 3.0, 9.5, 30.0, 95.0, 300.0)
"""Time constants of creep [s], two per decade, so that sums can follow straight lines over the logarithm of time."""
SETTLED = 5.0
"""Time for which the muscle has been at its first position before a record begins [s]."""
FAST = 5.0
"""Lags with shorter time constants [s] are counted from their final value.

So the surface is the muscle this long after a motion: slow tests do not separate faster creep from stiffness.
"""
LAW = np.maximum(0.0, 1.0 - np.abs(np.arange(len(TIMES))[:, None] - np.array([0.0, 3.0, 6.0])) / 3.0)
"""Weights of the lags in each column of creep: linear in the logarithm of time between three of them."""
STEP = 50e3
"""Distance of the pressures between which the straight form is interpolated [Pa]."""
INTERVALS_P = (0.0, 1 / 3, 2 / 3, 1.0)
INTERVALS_X = (0.0, 1 / 13, 5 / 26, 5 / 13, 8 / 13, 1.0)
"""Knots over the range of x, closer near the longest muscle, where the force falls fastest."""


@dataclass(frozen=True)
class Axis:
    """Cubic B-splines over a range, extrapolated linearly; a single constant where the range is empty."""

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
        """Position of values in the range, limited to 0 to 1; 0 where the range is empty."""
        return np.clip((at - self.low) / self.span, 0.0, 1.0) if self.span > 0 else np.zeros_like(at)

    def functions(self, at: Array, slope: bool = False) -> Array:
        """Values of the functions, or their slopes, at `at` (n,); shape (n, size)."""
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
        """Third derivative in each interval times the cube of its width, shape (intervals, size), which is penalised.

        It is 0 for a parabola, so without rows the functions continue as parabolas.
        """
        if self.span <= 0:
            return np.zeros((0, 1))
        knots = np.array(self.shares)
        third = BSpline((self._knots() - self.low) / self.span, np.eye(self.size), DEGREE).derivative(3)
        return np.asarray(third(0.5 * (knots[1:] + knots[:-1])) * np.diff(knots)[:, None] ** 3)

    def _knots(self) -> Array:
        inner = self.low + self.span * np.array(self.shares[1:-1])  # not the ends, which rounding would put beside them
        return np.concatenate([[self.low] * (DEGREE + 1), inner, [self.high] * (DEGREE + 1)])


@dataclass(frozen=True)
class Frame:
    """Ranges of pressure [Pa] and contraction [m] of a fit, from which the widths of the stops follow."""

    P: Axis
    x: Axis

    @classmethod
    def over(cls, P: Sequence[float], x: Sequence[float]) -> Frame:
        """The frame for lowest and highest pressure [Pa] and contraction [m]."""
        return cls(Axis(P[0], P[1], INTERVALS_P), Axis(x[0], x[1], INTERVALS_X))

    @property
    def radii(self) -> Array:
        """Half widths of the stops on contraction [m], first that of friction which reverses at once."""
        return np.array([SLIDES, *WIDTHS_X]) * max(self.x.span, 1e-9)

    @property
    def pressure_radii(self) -> Array:
        """Half widths of the stops on pressure [Pa]."""
        return np.array(WIDTHS_P) * max(self.P.high, 1.0)

    def surface(self, P: Array, x: Array) -> Array:
        """Products of the splines of both axes, shape (n, P.size * x.size)."""
        return _products(self.P.functions(P), self.x.functions(x))

    def slope(self, P: Array, x: Array) -> Array:
        """Derivative of `surface` by x [1/m], same shape."""
        return _products(self.P.functions(P), self.x.functions(x, slope=True))

    @property
    def pressures(self) -> Array:
        """Pressures of the nodes of the straight form [Pa], about `STEP` apart."""
        return np.linspace(self.P.low, self.P.high, max(2, round(self.P.span / STEP) + 1))

    def straight(self, P: Array, x: Array) -> Array:
        """Columns of a line over contraction, with intercept and slope linear between `pressures`, shape (n, 2 k)."""
        hats = np.column_stack([np.interp(P, self.pressures, one) for one in np.eye(len(self.pressures))])
        return np.hstack([hats, -hats * x[:, None]])

    def bends(self) -> Array:
        """Matrix of the sum of squares of `Axis.bends` along both axes, for the coefficients of the surface."""
        along_P, along_x = self.P.bends(), self.x.bends()
        return np.kron(along_P.T @ along_P, np.eye(self.x.size)) + np.kron(np.eye(self.P.size), along_x.T @ along_x)


def _products(one: Array, other: Array) -> Array:
    return np.asarray((one[:, :, None] * other[:, None, :]).reshape(len(one), -1))


def between(share: Array, columns: Array) -> Array:
    """Columns (n, m) times 1 - share and times share, for weights linear over the range; shape (n, 2 m)."""
    return np.hstack([columns * (1.0 - share)[:, None], columns * share[:, None]])


@dataclass(frozen=True, eq=False)
class Memory:
    """Internal states of a muscle along the rows of successive records; shapes (n, number)."""

    stops_x: Array
    """State of each stop over its half width, -1 to 1."""
    stops_P: Array
    lag_x: Array
    """Contraction after a lag of each of `TIMES` [m]; for those below `FAST` minus the contraction."""
    lag_P: Array
    """Pressure after a lag of each of `TIMES` [Pa]; for those below `FAST` minus the pressure."""


def memory(records: Sequence[Record], frame: Frame) -> Memory:
    """Stops and lags along records of a muscle that was rested, vented and at nominal length before.

    It reached the first position of a record that does not go on `SETTLED` before; a length set by hand, long before.

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
    """Records split into sequences in which each goes on from the one before."""
    begins = [i for i, record in enumerate(records) if not (i and record.goes_on)]
    return [list(records[first:last]) for first, last in pairwise([*begins, len(records)])]


def stops(u: Array, radii: Array, start: Array) -> Array:
    """Stop operators over their half widths `radii` (m,), along u (n,) from the state `start` (m,); shape (n, m)."""
    found = np.empty((len(u), len(radii)))
    found[0] = state = np.array(start, dtype=np.float64)
    for row, change in enumerate(np.diff(u)[:, None] / radii, start=1):
        found[row] = state = np.minimum(1.0, np.maximum(-1.0, state + change))
    return found


def lags(t: Array, u: Array, start: Array | float = 0.0) -> Array:
    """First-order lags of u (n,) at t (n,) [s] for each of `TIMES`, from the state `start`; shape (n, number)."""
    T = np.array(TIMES)
    found = np.empty((len(u), len(T)))
    found[0] = state = np.zeros(len(T)) + start
    steps = np.maximum(np.diff(t), 1e-9)[:, None]
    keep = np.exp(-steps / T)
    rise = 1.0 - (T / steps) * (1.0 - keep)
    add = u[:-1, None] * (1.0 - keep - rise) + u[1:, None] * rise
    for row in range(len(u) - 1):
        found[row + 1] = state = keep[row] * state + add[row]
    return found


SURFACE, VISCOUS, SLIDING, STOPS_X, STOPS_P, CREEP_X, CREEP_P = TERMS = (
    "static surface",
    "viscous",
    "sliding friction",
    "hysteresis of contraction",
    "hysteresis of pressure",
    "creep of contraction",
    "creep under pressure",
)
STRAIGHT = "straight lines"
"""The term F_ce(P) - K(P) x in place of the surface, for comparison only."""
FREE = (SURFACE, STRAIGHT)
"""Terms whose weights may have either sign."""
ALWAYS = (SURFACE, VISCOUS)
"""Terms that every muscle has; the others are chosen by the data."""
OVER_X = (STOPS_P, CREEP_P)
"""Terms whose weights are linear over the range of contraction; those of friction and damping are over pressure."""


@dataclass(frozen=True, eq=False)
class Muscle:
    """F = surface(P, x) - friction and hysteresis - damping + creep, with the weights of each term."""

    frame: Frame
    weights: Mapping[str, Array]
    """Term -> its weights; terms that are missing do not act."""

    def static(self, P: Array, x: Array) -> Array:
        """Force of the surface alone [N] at pressures [Pa] and contractions [m], shape (n,)."""
        return np.asarray(self.frame.surface(P, x) @ self.weights[SURFACE])

    def stiffness(self, P: Array, x: Array) -> Array:
        """Negative slope of the surface over contraction [N/m], shape (n,)."""
        return np.asarray(-self.frame.slope(P, x) @ self.weights[SURFACE])

    def secant(self, P: float, first: float, last: float) -> float:
        """Negative slope of the least-squares line through the surface between two contractions [m], in N/m."""
        x = np.linspace(first, last, SECANT_PLACES)
        return float(-np.polyfit(x - x.mean(), self.static(np.full(SECANT_PLACES, P), x), 1)[0])

    def force(self, records: Sequence[Record]) -> Array:
        """Force along the rows of successive records [N], shape (n,)."""
        rows, past = Rows.of_records(records), memory(records, self.frame)
        found = np.zeros(len(rows.P))
        for term, weights in self.weights.items():
            found += columns_of(term, self.frame, rows, past, self.stiffness) @ weights
        return found

    def gap(self, P: float, amplitude: float) -> float:
        """Width of the static loop of force over contraction at its centre [N], for a stroke of +- amplitude [m]."""
        reach = np.minimum(self.frame.radii, np.maximum(amplitude - self.frame.radii, 0.0)) / self.frame.radii
        return float(2.0 * self._stops_x(P) @ reach)

    def area(self, P: float, amplitude: float) -> float:
        """Work lost in a slow cycle of contraction of +- amplitude [m] at constant pressure [J]."""
        return float(4.0 * self._stops_x(P) @ np.maximum(amplitude - self.frame.radii, 0.0))

    def pressure_gap(self, x: float, amplitude: float) -> float:
        """Width of the static loop of force over pressure at its centre [N], for a stroke of +- amplitude [Pa]."""
        radii = self.frame.pressure_radii
        reach = np.minimum(radii, np.maximum(amplitude - radii, 0.0)) / radii
        return float(2.0 * self._weighed(STOPS_P, x, reach[None, :])[0])

    def creep_per_decade(self, first: float, last: float) -> float:
        """Contraction by creep per decade between two times [s] after a step, over the step [1]; 0 without creep."""
        weights = self.weights.get(CREEP_X)
        return 0.0 if weights is None else float((LAW @ weights) @ _risen(first, last) / np.log10(last / first))

    def pressure_creep_per_decade(self, x: float, first: float, last: float) -> float:
        """Force by creep per decade between two times [s] after a step, over the step of pressure [N/Pa]."""
        risen = _risen(first, last) @ LAW / np.log10(last / first)
        return float(self._weighed(CREEP_P, x, risen[None, :])[0]) / max(self.frame.P.span, 1.0)

    def damping(self, P: float) -> tuple[float, float]:
        """Damping while contracting and while expanding at a pressure [Pa], in N.s/m."""
        contracting, expanding = self._weighed(VISCOUS, P, np.eye(2))
        return float(contracting), float(expanding)

    def friction(self, P: float) -> float:
        """Friction that reverses at once [N], at a pressure [Pa]; 0 without that term."""
        return float(self._weighed(SLIDING, P, np.ones((1, 1)))[0])

    def straight_form(self) -> dict[str, list[float]]:
        """Pressures [Pa] and F_ce [N], K [N/m], B_c, B_r [N.s/m] and F_c [N] there; only for the straight form."""
        pressures = self.frame.pressures.tolist()
        F_ce, K = self.weights[STRAIGHT].reshape(2, -1).tolist()
        B_c, B_r = (list(each) for each in zip(*(self.damping(P) for P in pressures), strict=True))
        F_c = [self.friction(P) for P in pressures]
        return {"pressure": pressures, "F_ce": F_ce, "K": K, "B_c": B_c, "B_r": B_r, "F_c": F_c}

    def identified(self, name: str) -> IdentifiedMuscle:
        """The muscle as a model for simulation."""
        frame, weights, times = self.frame, self.weights, np.array(TIMES)
        low, high = frame.P.low, frame.P.high

        def of(term: str, number: int) -> Array:
            return weights.get(term, np.zeros(2 * number)).reshape(2, -1)

        def splines(axis: Axis) -> Splines:
            whole = tuple(axis.low + axis.span * share for share in axis.shares)
            return Splines(whole if axis.span > 0 else (axis.low,))

        creep = LAW @ weights.get(CREEP_X, np.zeros(LAW.shape[1]))
        under = of(CREEP_P, LAW.shape[1]) @ LAW.T / max(frame.P.span, 1.0)
        B_c, B_r = zip(self.damping(low), self.damping(high), strict=True)
        return IdentifiedMuscle(
            name, splines(frame.P), splines(frame.x), weights[SURFACE].reshape(frame.P.size, frame.x.size),
            Weights(frame.radii, self._stops_x(low), self._stops_x(high)),
            Weights(frame.pressure_radii, *of(STOPS_P, len(frame.pressure_radii))),
            B_c, B_r, Weights(times, creep, creep), Weights(times, *under), FAST, SETTLED,
        )  # fmt: skip

    def _stops_x(self, P: float) -> Array:
        """Weight of each stop on contraction at a pressure [N], shape (stops,)."""
        return np.array([self.friction(P), *self._weighed(STOPS_X, P, np.eye(len(WIDTHS_X)))])

    def _weighed(self, term: str, at: float, columns: Array) -> Array:
        """Columns (n, m) of a term times its weights at a pressure [Pa] or contraction [m], (n,); 0 without it."""
        axis = self.frame.x if term in OVER_X else self.frame.P
        weights = self.weights.get(term)
        return np.zeros(len(columns)) if weights is None else between(axis.share(np.array([at])), columns) @ weights


def _risen(first: float, last: float) -> Array:
    """Rise of each lag of `TIMES` between two times [s] after a unit step [1]."""
    return np.asarray(np.exp(-first / np.array(TIMES)) - np.exp(-last / np.array(TIMES)))


Stiffness = Callable[[Array, Array], Array]
"""Stiffness [N/m] at pressures [Pa] and contractions [m]."""


def columns_of(term: str, frame: Frame, record: Rows, past: Memory, stiffness: Stiffness) -> Array:
    """Columns of a term: force along rows for unit weights, shape (n, number of weights); ValueError for no term.

    All weights but those of the surface are at least 0: friction and damping dissipate, and creep yields. Those of
    hysteresis and damping are linear over the range of pressure or contraction.
    """
    if term == SURFACE:
        return frame.surface(record.P, record.x)
    if term == STRAIGHT:
        return frame.straight(record.P, record.x)
    if term == CREEP_X:
        return np.asarray(np.maximum(stiffness(record.P, record.x), 0.0)[:, None] * (past.lag_x @ LAW))
    if term not in TERMS:
        raise ValueError(f'unknown term "{term}"; known are {", ".join(TERMS)}')
    columns = {
        VISCOUS: -np.column_stack([np.maximum(record.v, 0.0), np.minimum(record.v, 0.0)]),
        SLIDING: -past.stops_x[:, :1],
        STOPS_X: -past.stops_x[:, 1:],
        STOPS_P: -past.stops_P,
        CREEP_P: past.lag_P @ LAW / max(frame.P.span, 1.0),
    }
    share = frame.x.share(record.x) if term in OVER_X else frame.P.share(record.P)
    return between(share, columns[term])
