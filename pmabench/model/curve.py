"""A coefficient over pressure: polynomials joined at breaks; must not know which coefficient."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
MANY = 6
"""Above this number of pieces `values` looks up the piece of each value; below it evaluates all pieces for all."""


@dataclass(frozen=True)
class Curve:
    """A piecewise polynomial of the gauge pressure P.

    `pieces[i]` holds polynomial coefficients, highest power first (as `numpy.polyval`), valid for
    `breaks[i - 1] <= P < breaks[i]` [Pa]; the first and the last piece extend to infinity.
    """

    pieces: tuple[tuple[float, ...], ...]
    breaks: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.pieces) != len(self.breaks) + 1 or list(self.breaks) != sorted(self.breaks):
            raise ValueError("a curve needs rising breaks and one piece more than breaks")

    def __call__(self, P: float) -> float:
        """Value at one pressure P [Pa]."""
        value = 0.0
        for coefficient in self.pieces[bisect_right(self.breaks, P)] if self.breaks else self.pieces[0]:
            value = value * P + coefficient
        return value

    def function(self) -> Callable[[float], float]:
        """A function equivalent to calling the curve, about three times faster, for thousands of calls."""
        pieces = [_closure(piece) for piece in self.pieces]
        if not self.breaks:
            return pieces[0]
        if len(self.breaks) == 1:
            edge, (below, above) = self.breaks[0], pieces
            if len(self.pieces[0]) == 1 and len(self.pieces[1]) == 2:
                ((low,), (a, b)) = self.pieces
                return lambda P: a * P + b if edge <= P else low
            return lambda P: above(P) if edge <= P else below(P)
        if len(self.breaks) == 2:
            (low, high), (below, between, above) = self.breaks, pieces
            return lambda P: between(P) if low <= P < high else below(P) if P < low else above(P)
        return lambda P: pieces[bisect_right(self.breaks, P)](P)

    def values(self, P: Array) -> Array:
        """Values at pressures P [Pa], any shape."""
        if len(self.pieces) > MANY:
            first, *rest = self._columns[:, np.searchsorted(self.breaks, P, side="right")]
            value: Array = first
            for column in rest:
                value = value * P + column
            return value
        if self.breaks and P.size:
            low, high = float(P.min()), float(P.max())
            first = bisect_right(self.breaks, low)
            if low <= high and first == bisect_right(self.breaks, high):  # false for NaN
                return _polynomial(self.pieces[first], P)
        value = _polynomial(self.pieces[0], P)
        for edge, piece in zip(self.breaks, self.pieces[1:], strict=True):
            value = np.where(edge <= P, _polynomial(piece, P), value)
        return value

    @cached_property
    def _columns(self) -> Array:
        """Coefficients of all pieces, highest power first; shape (powers, pieces)."""
        powers = max(map(len, self.pieces))
        padded = [(0.0,) * (powers - len(piece)) + tuple(piece) for piece in self.pieces]
        return np.array(padded, dtype=np.float64).T

    def times(self, factor: float) -> Curve:
        """The curve multiplied by `factor`."""
        return Curve(tuple(tuple(factor * c for c in piece) for piece in self.pieces), self.breaks)

    @classmethod
    def printed(
        cls,
        *pieces: Sequence[float],
        breaks: Sequence[float] = (),
        unit: float = 1.0,
        pressure: float = 1e3,
    ) -> Curve:
        """A curve from printed coefficients, lowest power first.

        Parameters
        ----------
        *pieces
            Coefficients of each piece, lowest power first, in `unit` per `pressure`**power.
        breaks
            Where the pieces join, in `pressure`.
        unit
            SI value of the printed unit, for instance 1e3 for N/mm.
        pressure
            Pascals in the printed unit of pressure, for instance 1e3 for kPa.
        """
        scaled = tuple(tuple(c * unit / pressure**n for n, c in enumerate(piece))[::-1] for piece in pieces)
        return cls(scaled, tuple(edge * pressure for edge in breaks))

    @classmethod
    def through(cls, P: Sequence[float], values: Sequence[float]) -> Curve:
        """Straight lines between points at increasing pressures P [Pa], constant outside them."""
        lines: list[tuple[float, ...]] = [(values[0],)]
        for i in range(len(P) - 1):
            slope = (values[i + 1] - values[i]) / (P[i + 1] - P[i])
            lines.append((slope, values[i] - slope * P[i]))
        return cls((*lines, (values[-1],)), tuple(P))


def _closure(coefficients: tuple[float, ...]) -> Callable[[float], float]:
    if len(coefficients) == 1:
        (a,) = coefficients
        return lambda P: a
    if len(coefficients) == 2:
        a, b = coefficients
        return lambda P: a * P + b
    if len(coefficients) == 3:
        a, b, c = coefficients
        return lambda P: (a * P + b) * P + c

    def horner(P: float) -> float:
        value = coefficients[0]
        for coefficient in coefficients[1:]:
            value = value * P + coefficient
        return value

    return horner


def _polynomial(coefficients: tuple[float, ...], P: Array) -> Array:
    """Horner's rule; `numpy.polyval` without its checks."""
    first, *rest = coefficients
    if not rest:
        return np.full(P.shape, first)
    value: Array = first * P
    value += rest[0]
    for coefficient in rest[1:]:
        value *= P
        value += coefficient
    return value
