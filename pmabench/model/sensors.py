"""Noise of the simulated sensors; knows no channel.

Each sample has its own noise, found by its number, so that samples that are taken again come out the same.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from pmabench.model.curve import Array

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
