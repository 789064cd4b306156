"""Limits of a bench from what the muscle bears, the relief valve, the supply and the sensors; each to be confirmed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pmabench.bench.lab.answers import Answers
from pmabench.bench.lab.daqs import NONE_YET
from pmabench.bench.lab.reading import Scale, sensors

OVERSHOOT = 0.02
"""Of the regulator, as a share of the highest pressure."""
UNCERTAINTY = 0.005
"""Of a sensor without calibration, as a share of its range."""
SUPPLY_MARGIN = 50e3
"""What a regulator needs above its set-point [Pa]."""


@dataclass(frozen=True)
class Limits:
    """All in SI."""

    command: float
    trip: float
    overshoot: float
    specimen: float
    """Command limit of the muscle itself."""
    force: float
    contraction: float
    scales: dict[str, Scale]
    """Channel -> range of its sensor."""

    @property
    def setup(self) -> float:
        """Pressure of the proof of the vent path [Pa]."""
        return min(50e3, 0.2 * self.command)


def limits_of(answers: Answers) -> Limits:
    """Limits that are consistent with the answers: below the relief valve and `never_above`, the trip in between."""
    never = answers.value("never_above")
    pressure, relief = answers.value("supply")
    ceiling = min(never, relief if relief is not None else never)
    scales = scales_of(answers)
    overshoot = _down(OVERSHOOT * ceiling)
    margin = overshoot + UNCERTAINTY * scales["pressure"].span
    command = min(0.88 * ceiling, ceiling - 2.5 * margin, pressure - SUPPLY_MARGIN)
    if answers.text("daq") != NONE_YET:
        command = min(command, answers.value("regulator")[1].values[1])
    command = _down(command)
    trip = _down(min((command + ceiling) / 2, 0.98 * scales["pressure"].values[1]))
    return Limits(
        command, trip, overshoot, _down(0.95 * never), 0.95 * scales["force"].values[1], answers.value("contraction"),
        scales,
    )  # fmt: skip


def scales_of(answers: Answers) -> dict[str, Scale]:
    """Ranges of the sensors; of a simulated bench those that would be proposed."""
    if answers.text("daq") != NONE_YET:
        found: dict[str, Scale] = answers.value("sensors")
        return found
    simulated = Answers({**answers.given, "daq": "labjack", "sensors": None}, answers.asked)
    return sensors(simulated.text("sensors"))


def _down(pressure: float) -> float:
    """The next whole kPa below."""
    return math.floor(pressure / 1e3 + 1e-9) * 1e3
