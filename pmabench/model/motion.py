"""What plants share: moments that can be gone back to, and what a plant did, sample by sample, with noise of sensors.

Each sample has its own noise, found by its number, so that samples that are taken again come out the same.
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
    """A muscle at `time` [s] whose pressure comes from `supply`; a snapshot holds copies of `parts`."""

    time: float
    supply: Regulated
    parts: tuple[str, ...] = ("supply",)

    @property
    def pressure(self) -> float:
        """Gauge pressure in the muscle at this moment [Pa]."""
        return self.supply.value(self.time)

    def command(self, waves: tuple[Wave, ...]) -> None:
        """Command pressure [Pa] along `waves`, the first of which starts now or later."""
        self.supply.command(waves)

    def shut(self, *, shut: bool) -> None:
        """From now on a valve keeps the regulator from the muscle's air, or no longer; without a chamber no matter."""

    def snapshot(self) -> dict[str, Any]:
        """Everything that `restore` needs to come back to this moment."""
        return {**self.__dict__, **self._copies()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go back to the moment of a snapshot; it can be used again."""
        self.__dict__.update(snapshot)
        self.__dict__.update(self._copies())

    def _copies(self) -> dict[str, Any]:
        return {name: copy.copy(getattr(self, name)) for name in self.parts}


class Loaded(Supplied):
    """A muscle whose free end carries F_L = `force` [N] and moves with `mass` [kg]."""

    force: float
    mass: float

    def load(self, force: float, mass: float) -> None:
        """From now on the free end carries F_L = `force` [N >= 0] and moves with `mass` [kg > 0]."""
        if not force >= 0 or not mass > 0:
            raise ValueError(f"a load needs a force of at least 0 and a mass above 0, not {force} N and {mass} kg")
        self.force, self.mass = force, mass


GAP = 0.004
"""Longest time that is not looked at for a turn of motion [s]."""
INSTANT = 0.5e-9
"""Samples that are nearer to now than half a nanosecond are of this moment [s]: LSODA takes no shorter stretch."""


@dataclass(frozen=True)
class Motion:
    """What the plant did at times `t` [s]: all arrays of the same length, SI."""

    t: Array
    x: Array
    """Contraction [m]."""
    v: Array
    """Its rate [m/s]."""
    P: Array
    """Gauge pressure in the muscle [Pa]."""
    F: Array
    """Force at the fixed end [N]."""
    P_set: Array
    """Pressure commanded, before the dead time [Pa]."""
    x_set: Array
    """Position commanded to the free end [m]; 0 where it is free."""


NOTHING = Motion(*(np.empty(0) for _ in range(7)))


class Stepped(Supplied, ABC):
    """A muscle with a free end that goes on in steps; `v` [m/s] is the speed of the end."""

    v: float

    @abstractmethod
    def _steps(self, until: float) -> Iterator[None]:
        """Go on to `until` [s], and yield wherever the way, its rate or the force begins another straight line."""

    @abstractmethod
    def _state(self) -> tuple[float, float, float]:
        """Contraction [m], gauge pressure [Pa] and force at the fixed end [N], before a jump that begins now."""

    def reading(self) -> tuple[float, float, float]:
        """Contraction [m], gauge pressure [Pa] and force at the fixed end [N] at this moment."""
        return self._state()

    def reach(self, until: float) -> None:
        """Go on to `until` [s]."""
        for _ in self._steps(until):
            pass

    def advance(self, until: float, times: Sequence[float] | Array = ()) -> Motion:
        """Go on to `until` [s] and return what happened at `times` [s], rising, between now and `until`.

        Samples do not shorten the steps; they lie on straight lines between the ends of these.
        """
        if len(times) == 0:
            self.reach(until)
            return NOTHING
        t = np.asarray(times, dtype=np.float64)
        P_set, (P, _) = self.supply.setpoints(t), copy.copy(self.supply).values(t)
        P = np.where(t <= self.time, self.reading()[1], P)  # at a jump that begins now, what is after it
        rows = [self._row()]
        rows += [self._row() for _ in self._steps(until)]
        passed, *values = np.array(rows).T
        right = np.clip(np.searchsorted(passed, t), 1, len(passed) - 1)  # where it jumps, what was before, as in P
        long = passed[right] - passed[right - 1]
        share = np.where(long > 0, (t - passed[right - 1]) / np.where(long > 0, long, 1.0), 1.0)
        x, v, F = ((1 - share) * value[right - 1] + share * value[right] for value in values)
        return Motion(t, x, v, P, F, P_set, np.zeros(t.shape))

    def _row(self) -> tuple[float, float, float, float]:
        place, _, force = self._state()
        return self.time, place, self.v, force


SERIES = 0.01
"""Below it the shares of a step are taken from their power series: their closed forms lose digits there [1]."""


def shares(z: float) -> tuple[float, float, float]:
    """What a speed and a force that goes on a straight line do within a step, z = B h / M >= 0.

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
    """How a pressure goes [Pa]: a `Trace`, or what was found by integration."""

    def value(self, t: float) -> float:
        """Pressure at time t [s]."""

    def values(self, t: Array) -> Array:
        """Pressures at rising times t [s]."""


class Record:
    """Samples asked for, and how many are done."""

    def __init__(self, t: Array, P_set: Array) -> None:
        self.t, self.P_set = t, P_set
        self.x, self.v, self.P, self.F = (np.empty(t.shape) for _ in range(4))
        self.done = 0

    def count(self, end: float) -> int:
        """How many samples are due before `end`."""
        return int(self.t.searchsorted(end)) - self.done

    def grid(self, now: float, end: float) -> tuple[Array, NDArray[np.intp]]:
        """Times from `now` to `end` with all samples before `end`, filled up where these are far apart; their rows."""
        samples = self.due(self.count(end))
        times = np.concatenate(([now], samples[samples > now + INSTANT], [end]))
        if np.diff(times).max() > GAP:
            times = np.union1d(times, np.linspace(now, end, int((end - now) / GAP) + 2))
        return times, np.searchsorted(times, samples - INSTANT)

    def due(self, count: int) -> Array:
        """When the next samples are due."""
        return self.t[self.done : self.done + count]

    def fill(self, x: Array, v: Array | float, P: Array, F: Array | float) -> None:
        """The next len(x) samples."""
        rows = slice(self.done, self.done + len(x))
        self.x[rows], self.v[rows], self.P[rows], self.F[rows] = x, v, P, F
        self.done += len(x)

    def motion(self) -> Motion:
        """All samples."""
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
        """All of it times `factor`."""
        if not factor >= 0:
            raise ValueError("the factor on noise cannot be negative")
        return Noise(**{item.name: factor * getattr(self, item.name) for item in fields(self)})


class NoiseSource:
    """Standard normal numbers of one sensor, addressed by sample number."""

    def __init__(self, seed: int, sensor: int) -> None:
        self._seed, self._sensor = seed, sensor
        self._chunk, self._values = -1, np.empty(0)

    def samples(self, first: int, count: int) -> Array:
        """The numbers of samples `first` (>= 0) to `first + count - 1`; shape (count,)."""
        result = np.empty(count)
        done = 0
        while done < count:
            offset = self._find(first + done)
            part = min(count - done, CHUNK - offset)
            result[done : done + part] = self._values[offset : offset + part]
            done += part
        return result

    def one(self, number: int) -> float:
        """The number of one sample."""
        offset = self._find(number)
        return float(self._values[offset])

    def _find(self, number: int) -> int:
        """Make the chunk with a sample, if it is not there yet; the sample's place in it."""
        chunk, offset = divmod(number, CHUNK)
        if chunk != self._chunk:
            generator = np.random.default_rng((self._seed, self._sensor, chunk))
            self._chunk, self._values = chunk, generator.standard_normal(CHUNK)
        return offset
