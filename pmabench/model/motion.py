"""Common parts of plants: snapshots, the motion sample by sample, and noise of sensors.

The noise of a sample is determined by its number, so that repeated samples are equal.
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pmabench.model.curve import Array
from pmabench.model.regulator import Regulated, Wave


class Supplied:
    """A muscle at `time` [s] with its pressure from `supply`; a snapshot contains copies of `parts`."""

    time: float
    supply: Regulated
    parts: tuple[str, ...] = ("supply",)

    @property
    def pressure(self) -> float:
        """Present gauge pressure in the muscle [Pa]."""
        return self.supply.value(self.time)

    def command(self, waves: tuple[Wave, ...]) -> None:
        """Command pressures [Pa] by `waves`, the first of which starts now or later."""
        self.supply.command(waves)

    def shut(self, *, shut: bool) -> None:
        """Shut or open the valve between regulator and muscle; no effect without a chamber."""

    def snapshot(self) -> dict[str, Any]:
        """The complete state, for `restore`."""
        return {**self.__dict__, **self._copies()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to the state of a snapshot, which can be used again."""
        self.__dict__.update(snapshot)
        self.__dict__.update(self._copies())

    def _copies(self) -> dict[str, Any]:
        return {name: copy.copy(getattr(self, name)) for name in self.parts}


class Loaded(Supplied):
    """A muscle whose free end carries the load F_L = `force` [N] with the moving mass `mass` [kg]."""

    force: float
    mass: float

    def load(self, force: float, mass: float) -> None:
        """Change the load of the free end: F_L = `force` [N >= 0] and moving `mass` [kg > 0]."""
        if not force >= 0 or not mass > 0:
            raise ValueError(f"a load needs a force of at least 0 and a mass above 0, not {force} N and {mass} kg")
        self.force, self.mass = force, mass


GAP = 0.004
"""Longest interval between checks for a reversal of motion [s]."""
INSTANT = 0.5e-9
"""Samples closer to the present than this [s] count as simultaneous: LSODA accepts no shorter intervals."""


@dataclass(frozen=True)
class Motion:
    """Motion of a plant at times `t` [s]; arrays of equal length, SI."""

    t: Array
    x: Array
    """Contraction [m]."""
    v: Array
    """Rate of contraction [m/s]."""
    P: Array
    """Gauge pressure in the muscle [Pa]."""
    F: Array
    """Force at the fixed end [N]."""
    P_set: Array
    """Commanded pressure, before the dead time [Pa]."""
    x_set: Array
    """Commanded position of a driven end [m]; 0 for a free end."""


NOTHING = Motion(*(np.empty(0) for _ in range(7)))


class Stepped(Supplied, ABC):
    """A muscle with a free end that is simulated in steps; `v` [m/s] is the speed of the end."""

    v: float

    @abstractmethod
    def _steps(self, until: float) -> Iterator[None]:
        """Simulate to `until` [s], and yield at the ends of intervals in which position, speed and force are linear."""

    @abstractmethod
    def _state(self) -> tuple[float, float, float]:
        """Contraction [m], gauge pressure [Pa] and force at the fixed end [N], before a jump at the present time."""

    def reading(self) -> tuple[float, float, float]:
        """Present contraction [m], gauge pressure [Pa] and force at the fixed end [N]."""
        return self._state()

    def reach(self, until: float) -> None:
        """Simulate to `until` [s]."""
        for _ in self._steps(until):
            pass

    def advance(self, until: float, times: Sequence[float] | Array = ()) -> Motion:
        """Simulate to `until` [s]; returns the motion at increasing `times` [s] between now and `until`.

        Samples do not shorten the steps; they are interpolated linearly between the ends of steps.
        """
        if len(times) == 0:
            self.reach(until)
            return NOTHING
        t = np.asarray(times, dtype=np.float64)
        P_set, (P, _) = self.supply.setpoints(t), copy.copy(self.supply).values(t)
        P = np.where(t <= self.time, self.reading()[1], P)  # at a jump now: the value after it
        rows = [self._row()]
        rows += [self._row() for _ in self._steps(until)]
        passed, *values = np.array(rows).T
        right = np.clip(np.searchsorted(passed, t), 1, len(passed) - 1)  # at a jump: the value before it, as in P
        long = passed[right] - passed[right - 1]
        share = np.where(long > 0, (t - passed[right - 1]) / np.where(long > 0, long, 1.0), 1.0)
        x, v, F = ((1 - share) * value[right - 1] + share * value[right] for value in values)
        return Motion(t, x, v, P, F, P_set, np.zeros(t.shape))

    def _row(self) -> tuple[float, float, float, float]:
        place, _, force = self._state()
        return self.time, place, self.v, force


SERIES = 0.01
"""Below this the functions of `shares` use power series, because the closed forms lose digits [1]."""


def shares(z: float) -> tuple[float, float, float]:
    """Weights of the initial speed and of a linear force for the motion within a step, z = B h / M >= 0.

    phi_1 = (1 - exp(-z)) / z, phi_2 = (1 - phi_1) / z, phi_3 = (1 / 2 - phi_2) / z [1]: the functions of exponential
    integrators (Hochbruck and Ostermann 2010) at -z.
    """
    if z < SERIES:
        third = 1 / 6 - z * (1 / 24 - z * (1 / 120 - z / 720))
        second = 0.5 - z * third
        return 1 - z * second, second, third
    first = -math.expm1(-z) / z
    second = (1 - first) / z
    return first, second, (0.5 - second) / z


class Course(Protocol):
    """Pressure over time [Pa]: a `Trace`, or the result of an integration."""

    def value(self, t: float) -> float:
        """Pressure at time t [s]."""

    def values(self, t: Array) -> Array:
        """Pressures at increasing times t [s]."""


class Record:
    """Requested samples, filled one after another; `done` is the number of filled ones."""

    def __init__(self, t: Array, P_set: Array) -> None:
        self.t, self.P_set = t, P_set
        self.x, self.v, self.P, self.F = (np.empty(t.shape) for _ in range(4))
        self.done = 0

    def count(self, end: float) -> int:
        """Number of samples due before `end` [s]."""
        return int(self.t.searchsorted(end)) - self.done

    def grid(self, now: float, end: float) -> tuple[Array, NDArray[np.intp]]:
        """Times from `now` to `end` with all samples due, at most `GAP` apart [s], and the indices of the samples."""
        samples = self.due(self.count(end))
        times = np.concatenate(([now], samples[samples > now + INSTANT], [end]))
        if np.diff(times).max() > GAP:
            times = np.union1d(times, np.linspace(now, end, int((end - now) / GAP) + 2))
        return times, np.searchsorted(times, samples - INSTANT)

    def due(self, count: int) -> Array:
        """Times of the next `count` samples [s]."""
        return self.t[self.done : self.done + count]

    def fill(self, x: Array, v: Array | float, P: Array, F: Array | float) -> None:
        """Fill the next len(x) samples."""
        rows = slice(self.done, self.done + len(x))
        self.x[rows], self.v[rows], self.P[rows], self.F[rows] = x, v, P, F
        self.done += len(x)

    def motion(self) -> Motion:
        """All samples as a motion."""
        return Motion(self.t, self.x, self.v, self.P, self.F, self.P_set, np.zeros(self.t.shape))


CHUNK = 1024


@dataclass(frozen=True)
class Noise:
    """Standard deviation of the white Gaussian noise of each sensor."""

    pressure: float = 0.0
    """[Pa]"""
    displacement: float = 0.0
    """[m]"""
    force: float = 0.0
    """[N]"""

    def scaled(self, factor: float) -> Noise:
        """The noise multiplied by `factor`."""
        if not factor >= 0:
            raise ValueError("the factor on noise cannot be negative")
        return Noise(**{item.name: factor * getattr(self, item.name) for item in fields(self)})


class NoiseSource:
    """Standard normal numbers of one sensor, addressed by sample number."""

    def __init__(self, seed: int, sensor: int) -> None:
        self._seed, self._sensor = seed, sensor
        self._chunk, self._values = -1, np.empty(0)

    def samples(self, first: int, count: int) -> Array:
        """Random numbers of the samples `first` (>= 0) to `first + count - 1`; shape (count,)."""
        result = np.empty(count)
        done = 0
        while done < count:
            offset = self._find(first + done)
            part = min(count - done, CHUNK - offset)
            result[done : done + part] = self._values[offset : offset + part]
            done += part
        return result

    def one(self, number: int) -> float:
        """Random number of one sample."""
        offset = self._find(number)
        return float(self._values[offset])

    def _find(self, number: int) -> int:
        """Load the chunk that contains a sample; returns the sample's index in it."""
        chunk, offset = divmod(number, CHUNK)
        if chunk != self._chunk:
            key: Any = (self._seed, self._sensor, chunk)
            if 0 <= self._seed < 2**32:  # an array gives the same seed as the tuple in three quarters of the time
                key = np.array(key, dtype=np.uint32)
            self._chunk, self._values = chunk, np.random.default_rng(key).standard_normal(CHUNK)
        return offset
