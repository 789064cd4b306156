"""From the counts of a T7's stream to volts, by the constants in its own flash; knows no connection.

Constants and formula: LabJack, T-series datasheet, low-level streaming. 41 single-precision numbers: for the
high-speed converter (which streams) four gains of positive slope, negative slope, centre and offset; the same for the
high-resolution converter; then DACs, temperature, current sources and bias, which are not used here.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass

FLASH = 0x3C4000
"""Where the constants begin in the device's flash."""
COUNT = 41
"""How many there are."""
NOMINAL_SLOPE, NOMINAL_CENTER = 3.158058e-4, 33523.0
"""Of the range of 10 V [V], [1]; each next gain has a tenth of the slope."""
CODES = 65536


@dataclass(frozen=True)
class Gain:
    """Constants of one range: volts a count above and below the centre, and the count at 0 V."""

    positive: float
    negative: float
    center: float

    def volts(self, raw: int) -> float:
        """The voltage of a count [V]."""
        if raw < self.center:
            return (self.center - raw) * self.negative
        return (raw - self.center) * self.positive

    def table(self) -> array[float]:
        """The voltage of every count [V], shape (65536,)."""
        return array("d", [self.volts(raw) for raw in range(CODES)])


def gains(constants: Sequence[float]) -> tuple[Gain, ...]:
    """The high-speed converter's gains for 10, 1, 0.1 and 0.01 V; ValueError where one cannot be that of a T7."""
    if len(constants) != COUNT:
        raise ValueError(f"{len(constants)} calibration constants instead of {COUNT}")
    found = []
    for index in range(4):
        positive, negative, center, _offset = constants[4 * index : 4 * index + 4]
        slope = NOMINAL_SLOPE / 10**index
        near = all(math.isfinite(value) for value in (positive, negative, center)) and (
            abs(positive / slope - 1) < 0.1 and abs(negative / slope + 1) < 0.1 and abs(center - NOMINAL_CENTER) < 3000
        )
        if not near:
            raise ValueError(
                f"calibration constants of gain {index} that no T7 has: slopes {positive:g} and {negative:g} V, "
                f"centre {center:g}"
            )
        found.append(Gain(positive, negative, center))
    return tuple(found)
