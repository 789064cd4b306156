"""An identified muscle as plain numbers, and its static force at an operating point.

    F = F_s(P, x) - sum w_k(P) S_k[x] - sum q_m(x) S_m[P] - B(P, sign x') x' + K(P, x) c[x] + d(x)[P]

F_s is a product of cubic B-splines over P and x, K = -dF_s/dx. S are stops between -1 and 1 (`plant`), c and d sums of
first-order lags. w, B are linear over the tested pressures, q, d over the tested contractions, and constant beyond; F_s
is extrapolated linearly. SI throughout, P gauge.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.muscle import Friction

SCHEMA = "pmabench.identified-muscle/1"
DEGREE = 3
BEYOND = 2.0
"""End stop of a free end, as a multiple of the largest tested contraction."""


@dataclass(frozen=True, eq=False)
class Splines:
    """Cubic B-splines over a range, as cubic polynomials in each interval; one constant if there is no range."""

    knots: tuple[float, ...]
    """Ends of the intervals, ascending, in the unit of the axis; a single one for no range."""

    @property
    def low(self) -> float:
        """Lowest value."""
        return self.knots[0]

    @property
    def high(self) -> float:
        """Highest value."""
        return self.knots[-1]

    @property
    def size(self) -> int:
        """Number of functions."""
        return len(self.knots) + DEGREE - 1 if len(self.knots) > 1 else 1

    @cached_property
    def pieces(self) -> Array:
        """Coefficients of each function in each interval, shape (intervals, 4, functions).

        Highest power first, of the distance from the interval's lower end.
        """
        if len(self.knots) == 1:
            return np.array([[[0.0], [0.0], [0.0], [1.0]]])
        from scipy.interpolate import BSpline

        every = np.concatenate([[self.low] * DEGREE, self.knots, [self.high] * DEGREE])
        spline = BSpline(every, np.eye(self.size), DEGREE)
        ends = np.array(self.knots[:-1])
        powers = [spline.derivative(n)(ends) / math.factorial(n) for n in range(DEGREE, 0, -1)]
        return np.stack([*powers, spline(ends)], axis=1)

    def share(self, at: float) -> float:
        """Relative position of a value in the range, limited to 0 to 1; 0 if there is no range."""
        return min(max((at - self.low) / (self.high - self.low), 0.0), 1.0) if len(self.knots) > 1 else 0.0

    def functions(self, at: float) -> Array:
        """The functions at a value, shape (functions,); linearly extrapolated beyond the range."""
        left, interval = self.place(at)
        a, b, c, d = self.pieces[interval]
        inside = min(max(at, self.low), self.high) - left
        value = ((a * inside + b) * inside + c) * inside + d
        if len(self.knots) > 1 and not self.low <= at <= self.high:
            value = value + (at - left - inside) * ((3 * a * inside + 2 * b) * inside + c)
        return np.asarray(value)

    def place(self, at: float) -> tuple[float, int]:
        """Lower end and number of the interval that contains a value; beyond the range the first or last one."""
        last = max(len(self.knots) - 2, 0)
        interval = min(max(bisect_right(self.knots, at) - 1, 0), last)
        return self.knots[interval], interval


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights of stops or lags, linear between the ends of a range; each of shape (n,)."""

    sizes: Array
    """Half widths [m] or [Pa] of stops, time constants [s] of lags; each above 0."""
    low: Array
    high: Array

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Weights:
        """From plain data; ValueError where they are invalid."""
        sizes, low, high = (np.array(data[name], dtype=np.float64) for name in ("sizes", "low", "high"))
        if not len(sizes) == len(low) == len(high) or not (np.isfinite([sizes, low, high]).all() and (sizes > 0).all()):
            raise ValueError("stops and lags need sizes above 0 and as many weights at both ends of the range")
        return cls(sizes, low, high)

    def at(self, share: float) -> Array:
        """Weights at a share of the range, 0 to 1."""
        return np.asarray(self.low + share * (self.high - self.low))

    def to_dict(self) -> dict[str, list[float]]:
        """Plain data for `of`."""
        return {"sizes": self.sizes.tolist(), "low": self.low.tolist(), "high": self.high.tolist()}


@dataclass(frozen=True, eq=False)
class IdentifiedMuscle:
    """The muscle of an analysis of kind surface."""

    name: str
    over_P: Splines
    over_x: Splines
    heights: Array
    """Weights of the products of the splines [N], shape (functions over P, functions over x)."""
    stops_x: Weights
    """Stops on contraction: sizes [m], weights [N] over the range of pressure."""
    stops_P: Weights
    """Stops on pressure: sizes [Pa], weights [N] over the range of contraction."""
    B_c: tuple[float, float]
    """Damping in contraction at the lowest and highest pressure [N.s/m]."""
    B_r: tuple[float, float]
    """Damping in relaxation, likewise."""
    creep_x: Weights
    """Lags of contraction: time constants [s], shares of the lagged contraction [1], the same at both ends."""
    creep_P: Weights
    """Lags of pressure: time constants [s], weights [N/Pa] of the lagged pressure over the range of contraction."""
    fast: float
    """Lags with a shorter time constant [s] count relative to their final value."""
    settled: float
    """Time [s] that the muscle has rested at the begin of a path."""
    friction: Friction = field(default_factory=Friction)
    """No Coulomb friction: the stops describe it."""

    @classmethod
    def of(cls, data: Mapping[str, Any], name: str = "") -> IdentifiedMuscle:
        """From plain data of `to_dict`; ValueError where they are invalid or of another version."""
        if data.get("schema") != SCHEMA:
            raise ValueError(f"the muscle is described as {data.get('schema')}; this version reads {SCHEMA}")
        over_P, over_x = (Splines(_rising(data[axis])) for axis in ("pressure_knots", "contraction_knots"))
        heights = np.array(data["heights"], dtype=np.float64)
        if heights.shape != (over_P.size, over_x.size) or not np.isfinite(heights).all():
            raise ValueError(f"the surface has {over_P.size} x {over_x.size} splines, and not as many finite heights")
        stops_x, stops_P, creep_x, creep_P = (
            Weights.of(data[part]) for part in ("stops_x", "stops_P", "creep_x", "creep_P")
        )
        (c_low, c_high), (r_low, r_high) = data["B_c"], data["B_r"]
        return cls(
            name or str(data["name"]), over_P, over_x, heights, stops_x, stops_P, (float(c_low), float(c_high)),
            (float(r_low), float(r_high)), creep_x, creep_P, float(data["fast"]), float(data["settled"]),
        )  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI."""
        return {
            "schema": SCHEMA,
            "name": self.name,
            "pressure_knots": list(self.over_P.knots),
            "contraction_knots": list(self.over_x.knots),
            "heights": self.heights.tolist(),
            **{part: getattr(self, part).to_dict() for part in ("stops_x", "stops_P", "creep_x", "creep_P")},
            "B_c": list(self.B_c),
            "B_r": list(self.B_r),
            "fast": self.fast,
            "settled": self.settled,
        }

    @property
    def stop(self) -> float:
        """End stop of a free end [m], far beyond the tested contractions."""
        return BEYOND * self.over_x.high

    @property
    def reach(self) -> tuple[float, float]:
        """Lowest and highest tested contraction [m]."""
        return self.over_x.low, self.over_x.high

    def static(self, P: float, x: float) -> float:
        """Force of the surface alone [N]: the mean of both directions."""
        return float(self.over_P.functions(P) @ self.heights @ self.over_x.functions(x))

    def stiffness(self, P: float, x: float) -> float:
        """Minus the slope of the surface over contraction [N/m]."""
        return -Inflated(self, P).surface(x)[1]

    def damping(self, P: float, contracting: bool) -> float:
        """Damping at a pressure for one direction [N.s/m]."""
        low, high = self.B_c if contracting else self.B_r
        return low + self.over_P.share(P) * (high - low)

    def gap(self, P: float, amplitude: float) -> float:
        """Width of the quasi-static loop of force over contraction at its centre [N], for +- `amplitude` [m]."""
        reach = np.minimum(1.0, np.maximum(amplitude / self.stops_x.sizes - 1.0, 0.0))
        return float(2.0 * self.stops_x.at(self.over_P.share(P)) @ reach)


class Inflated:
    """An identified muscle at one pressure P [Pa]: its surface as cubics over the contraction."""

    def __init__(self, muscle: IdentifiedMuscle, P: float) -> None:
        self.P, self._axis = P, muscle.over_x
        self._cubics = (muscle.over_x.pieces @ (muscle.over_P.functions(P) @ muscle.heights)).tolist()
        self.share = muscle.over_P.share(P)
        self.stops_x = muscle.stops_x.at(self.share)

    def surface(self, x: float) -> tuple[float, float]:
        """Force [N] and its slope over contraction [N/m] at x [m]."""
        left, interval = self._axis.place(x)
        a, b, c, d = self._cubics[interval]
        inside = min(max(x, self._axis.low), self._axis.high) - left
        slope = (3 * a * inside + 2 * b) * inside + c
        return ((a * inside + b) * inside + c) * inside + d + (x - left - inside) * slope, slope


def _rising(knots: Sequence[float]) -> tuple[float, ...]:
    """The knots as numbers; ValueError unless they increase."""
    found = tuple(float(one) for one in knots)
    if not found or not all(map(math.isfinite, found)) or any(a >= b for a, b in pairwise(found)):
        raise ValueError("the knots of a surface must rise")
    return found
