"""The curve of contraction over pressure, the trials carried along it to the commanded pressure, and its zero.

Knows points and a fitted sigmoid, no result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot

import numpy as np
from scipy.interpolate import PchipInterpolator

from pmabench.analysis.model_fit import ModelFit
from pmabench.kinds.free_contraction.rests import NOTHING, VENTED, Point, Shape
from pmabench.model.library.description import Model
from pmabench.store.records import Array

BENDS = {True: 0.2, False: 1.0}
"""What the way from the measured pressure to the commanded one may be off, as a share: along a sigmoid that fits, and
along a curve through the points only."""


@dataclass(frozen=True, eq=False)
class Level:
    """One commanded pressure: its trials at the pressure that was measured, and as they would be at the commanded."""

    point: Point
    there: Point
    shape: Shape
    fits: bool
    """Whether `shape` is a sigmoid that fits."""
    zero: float
    """By which the zero of the pressure is open [Pa]."""

    @classmethod
    def of(cls, point: Point, shape: Shape, zero: float, *, fits: bool) -> Level:
        """A point, by the curve of all."""
        return cls(point.at(point.pressure, shape), point.at(point.set, shape), shape, fits, zero)

    def rise(self, by: float) -> float:
        """Change of the contraction by the pressure, a change of which by `by` [Pa] is looked at [m/Pa]."""
        P = max(self.point.pressure, 0.0)
        x = self.shape(np.array([max(P - by, 0.0), P, P + by]))
        return float(np.abs(np.diff(x)).max()) / by

    @property
    def method(self) -> float:
        """What the way to the commanded pressure, noise and zero of the measured one may do to the contraction [m]."""
        way = BENDS[self.fits] * (self.there.x - self.point.x)
        return hypot(way, *(by * self.rise(by) for by in (2 * self.point.pressure_noise, self.zero) if by > 0))


def curve_of(points: Sequence[Point]) -> tuple[Array, Array]:
    """Measured pressure [Pa] and mean contraction [m] of each point."""
    return np.array([point.pressure for point in points]), np.array([point.x for point in points])


def highest(model: Model) -> float:
    """Pressure up to which a model holds [Pa]."""
    return next(p.high for p in model.parameters if p.name == "pressure")


def sigmoid(fit: ModelFit) -> Shape:
    """Contraction by the fitted sigmoid, but for a constant."""
    most, known = highest(fit.model), {**fit.fixed, **fit.values}

    def shape(P: Array) -> Array:
        return -np.asarray(fit.model.evaluate({**known, "pressure": np.clip(P, 0.0, most)})["length"])

    return shape


def through(points: Sequence[Point], fit: ModelFit | None) -> Shape:
    """The sigmoid, where there is one, and what the points are off it by monotone cubics over the root of the pressure.

    On a root the curve begins: without pressure it is steep.
    """
    base = np.zeros_like if fit is None else sigmoid(fit)
    P, x = curve_of([point.at(point.pressure, base) for point in points])
    root = np.sqrt(np.maximum(P, 0.0))
    if len(points) < 2 or not bool((np.diff(root) > 0).all()):
        return base
    off = PchipInterpolator(root, x - base(P))

    def shape(P: Array) -> Array:
        asked = np.sqrt(np.maximum(P, 0.0))
        within = np.clip(asked, root[0], root[-1])
        return np.asarray(base(P) + off(within) + off(within, 1) * (asked - within))

    return shape


def zero_of(points: Sequence[Point]) -> float:
    """What the zero of the pressure may be by what is read at set-point 0 [Pa]; 0 where that is noise.

    No gauge pressure is below 0: the zero is at most the least that was read.
    """
    first = points[0] if points else None
    if first is None or first.set > NOTHING:
        return 0.0
    least = min(rest.pressure for rest in first.rests)
    return least if abs(least) > VENTED * first.pressure_noise else 0.0


def zeroed(points: Sequence[Point], zero: float) -> list[Point]:
    """The points with pressures from another zero [Pa]."""
    moved = [point.changed(lambda rest: replace(rest, pressure=rest.pressure - zero)) for point in points]
    return [moved[0].without_noise(), *moved[1:]]
