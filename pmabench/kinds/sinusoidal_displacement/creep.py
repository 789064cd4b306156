"""What creep of the muscle may do to the lines through driven sines: its loss, from the stiffness over frequency.

A contraction that creeps after x in parts c/(1 + i omega tau), as many to each decade of tau, makes K smaller at low
frequency and adds loss: F/x = -K (1 - c sum 1/(1 + i omega tau)). Where tau goes on below all periods the loss is the
same at each frequency, pi/(2 ln 10) of K for each part of c in a decade, and reads as friction; where tau ends within
them it falls with frequency, and B comes out low. So the change of K over the frequencies, with its interval, says
what the loss may be. Knows complex stiffnesses; no records.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.lines import weighted_line
from pmabench.store.records import Array

SHORTEST = tuple(10 ** np.arange(-2.0, 0.1, 0.25))
"""Time constants that creep may begin with [s]: it is seen within a second of a step."""
WORSE = 3.0
"""Only those are kept whose stiffness over frequency is uncertain by so many times that of the best."""
LONGEST = 1e3
"""Time constants end here [s]: no sine shows them."""
PER_DECADE = 2
"""Parts of creep in a decade of time constants."""
MOST = 0.02
"""Share of a contraction that no part of creep exceeds: 4 % in a decade."""


class Measured(Protocol):
    """A sine as far as creep needs it."""

    @property
    def frequency(self) -> float:
        """[Hz]."""

    @property
    def stiffness(self) -> float:
        """K [N/m]."""

    @property
    def ratio(self) -> complex:
        """Force over contraction [N/m]."""


def lost(sines: Sequence[Measured], cycles: Sequence[Measured]) -> list[tuple[Array, Array]]:
    """For each shortest time constant: what creep may have added to the loss, and taken from K, of each sine.

    Loss by the amplitude, and stiffness [N/m], shape (n,) each. `cycles` are those of all sines: where no sine is
    repeated their scatter says how sure the change of K is. Empty with one frequency, which does not tell.
    """
    frequency, K, size = _columns(sines)
    if len(np.unique(frequency)) < 2:
        return []
    every, K_each, size_each = _columns(cycles)
    found, unsure = [], []
    for shortest in SHORTEST:
        tau = shortest * 10 ** (np.arange(0.0, PER_DECADE * np.log10(LONGEST / shortest) + 1.0) / PER_DECADE)
        parts = _parts(frequency, tau)
        line = weighted_line(frequency, parts.real, K, size)
        each = weighted_line(every, _parts(every, tau).real, K_each, size_each)
        halves = [half for half in (line.half_slope, each.half_slope) if half is not None]
        if not halves or not line.start > 0:
            continue
        share = min(MOST, (max(0.0, -line.slope) + max(halves)) / line.start)
        found.append((-share * line.start * parts.imag, share * line.start * parts.real))
        unsure.append(max(halves) * float(np.ptp(parts.real)))
    return [one for one, half in zip(found, unsure, strict=True) if half <= WORSE * min(unsure)]


def _columns(points: Sequence[Measured]) -> tuple[Array, Array, Array]:
    """Frequency [Hz], stiffness and the size of the whole ratio [N/m]."""
    rows = [(point.frequency, point.stiffness, abs(point.ratio)) for point in points]
    frequency, K, size = np.array(rows, dtype=np.float64).T
    return frequency, K, size


def _parts(frequency: Array, tau: Array) -> NDArray[np.complex128]:
    return np.asarray((1 / (1 + 2j * np.pi * frequency[:, None] * tau)).sum(axis=1))
