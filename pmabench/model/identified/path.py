"""An identified muscle along a path of pressure and contraction: what it remembers, and the force that follows.

Between two moments pressure and contraction go on straight lines. A stop of half width r: S <- min(1, max(-1, S +
change / r)). A lag: T y' = u - y, exact for straight lines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.identified.muscle import IdentifiedMuscle, Inflated, Weights


class Path:
    """A muscle that was rested, vented and at nominal length, and then came to `P` [Pa] and `x` [m].

    Examples
    --------
    >>> from pmabench.model.identified.muscle import IdentifiedMuscle
    >>> rod = {"sizes": [1e-3], "low": [0.0], "high": [0.0]}
    >>> muscle = IdentifiedMuscle.of({
    ...     "schema": "pmabench.identified-muscle/1", "name": "constant pull with 5 N of friction",
    ...     "pressure_knots": [0.0], "contraction_knots": [0.0], "heights": [[100.0]],
    ...     "stops_x": {"sizes": [1e-3], "low": [5.0], "high": [5.0]}, "stops_P": rod, "creep_x": rod, "creep_P": rod,
    ...     "B_c": [0.0, 0.0], "B_r": [0.0, 0.0], "fast": 5.0, "settled": 5.0})
    >>> path = Path(muscle)
    >>> [round(path.go(1.0, 0.0, x), 1) for x in (5e-3, 4.5e-3, 3e-3)]
    [95.0, 97.5, 105.0]
    """

    def __init__(self, muscle: IdentifiedMuscle, P: float = 0.0, x: float = 0.0) -> None:
        self.muscle, self.P, self.x = muscle, P, x
        self.stops_x = np.clip(x / muscle.stops_x.sizes, -1.0, 1.0)
        self.stops_P = np.clip(P / muscle.stops_P.sizes - 1.0, -1.0, 1.0)
        self.lag_x = x * (1.0 - np.exp(-muscle.settled / muscle.creep_x.sizes))
        self.lag_P = P * (1.0 - np.exp(-muscle.settled / muscle.creep_P.sizes))

    def step(self, h: float, P: float) -> Ahead:
        """What the muscle does in the next `h` [s], in which the pressure goes to `P` [Pa], for any contraction."""
        return Ahead.of(self, h, P)

    def go(self, h: float, P: float, x: float) -> float:
        """Go on for `h` [s] to `P` [Pa] and `x` [m]; the force there, without damping [N]."""
        ahead = self.step(h, P)
        self.arrive(ahead, x)
        return ahead.pull(x)[0]

    def arrive(self, ahead: Ahead, x: float) -> None:
        """The step has come to `x` [m]."""
        self.stops_x = ahead.stops_x(x)
        self.stops_P, self.lag_P = ahead.stops_P, ahead.lag_P
        self.lag_x = ahead.lag_x + ahead.rise_x * x
        self.P, self.x = ahead.inflated.P, x

    def copy(self) -> Path:
        """An independent path from here on."""
        made = object.__new__(Path)
        made.__dict__.update(self.__dict__)  # its arrays are replaced, never changed
        return made


@dataclass(frozen=True, eq=False)
class Ahead:
    """One step of a path at the pressure of its end, open in contraction."""

    path: Path
    inflated: Inflated
    stops_P: Array
    lag_P: Array
    lag_x: Array
    """Lags of contraction at the end of the step, without what the contraction there adds to them [m]."""
    rise_x: Array
    """What each takes of the contraction at the end [1]."""
    ends: tuple[float, float]
    """Hysteresis and creep of pressure at the lowest and highest contraction [N]."""
    crept: float
    """Contraction that has crept, without what the contraction at the end adds [m]."""
    follows: float
    """What creep takes of the contraction at the end [1]."""

    @classmethod
    def of(cls, path: Path, h: float, P: float) -> Ahead:
        """The step of `h` [s] to `P` [Pa]."""
        muscle = path.muscle
        stops_P = np.clip(path.stops_P + (P - path.P) / muscle.stops_P.sizes, -1.0, 1.0)
        keep_P, begin_P, rise_P, fast_P = lag_shares(muscle.creep_P, h, muscle.fast)
        lag_P = keep_P * path.lag_P + begin_P * path.P + rise_P * P
        behind = lag_P - fast_P * P
        low, high = (
            float(creep @ behind - held @ stops_P)
            for creep, held in (
                (muscle.creep_P.low, muscle.stops_P.low),
                (muscle.creep_P.high, muscle.stops_P.high),
            )
        )
        keep, begin, rise, fast = lag_shares(muscle.creep_x, h, muscle.fast)
        lag_x = keep * path.lag_x + begin * path.x
        shares = muscle.creep_x.low
        return cls(
            path, Inflated(muscle, P), stops_P, lag_P, lag_x, rise, (low, high),
            float(shares @ lag_x), float(shares @ (rise - fast)),
        )  # fmt: skip

    def stops_x(self, x: float) -> Array:
        """Stops on contraction where the step ends at `x` [m]."""
        path = self.path
        return np.clip(path.stops_x + (x - path.x) / path.muscle.stops_x.sizes, -1.0, 1.0)

    def pull(self, x: float) -> tuple[float, float]:
        """Force without damping [N] where the step ends at `x` [m], and about minus its slope there [N/m]."""
        muscle, weights = self.path.muscle, self.inflated.stops_x
        force, slope = self.inflated.surface(x)
        stiffness = max(-slope, 0.0)
        stops = self.stops_x(x)
        low, high = self.ends
        held = low + muscle.over_x.share(x) * (high - low)
        force += stiffness * (self.crept + self.follows * x) - float(weights @ stops) + held
        sliding = float((weights / muscle.stops_x.sizes)[np.abs(stops) < 1.0].sum())
        return force, stiffness * (1.0 - self.follows) + sliding


def lag_shares(lags: Weights, h: float, fast: float) -> tuple[Array, Array, Array, Array]:
    """What is left of each lag after `h` [s], what it takes of the values at begin and end, and which are fast [1]."""
    return _lag_shares(tuple(lags.sizes.tolist()), h, fast)


@lru_cache(maxsize=64)
def _lag_shares(times: tuple[float, ...], h: float, fast: float) -> tuple[Array, Array, Array, Array]:
    T = np.array(times)
    keep = np.exp(-h / T)
    rise = 1.0 + np.expm1(-h / T) * T / h
    return keep, 1.0 - keep - rise, rise, (fast > T).astype(np.float64)


def force_along(muscle: IdentifiedMuscle, t: Array, P: Array, x: Array, v: Array) -> Array:
    """Force of a driven muscle [N], shape (n,), at rising times t [s], with P [Pa], x [m] and its rate v [m/s].

    It came to the first place from rest; a muscle does not push.
    """
    path = Path(muscle, float(P[0]), float(x[0]))
    found = np.empty(len(t))
    before = float(t[0]) - 1e-3
    for row, (now, pressure, place, speed) in enumerate(zip(*(one.tolist() for one in (t, P, x, v)), strict=True)):
        force = path.go(max(now - before, 1e-9), pressure, place)
        found[row] = force - muscle.damping(pressure, speed > 0) * speed
        before = now
    return np.maximum(found, 0.0)
