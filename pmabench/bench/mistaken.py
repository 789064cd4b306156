"""What the files of a bench and a specimen say that is possible and likely a mistake; each a line with its place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pmabench.base.quantities import show
from pmabench.bench.compilation import Compilation
from pmabench.bench.interface import ChannelRecord, DeviceRecord

LENGTH_OFF = 0.05
"""Relative difference of mounted and simulated length that makes another muscle of it."""
FORCE_OFF = 0.3
"""The same for the force at the mounted length."""
LOOKED_AT = 300e3
"""Pressure at which forces are compared [Pa]."""
SIMULATED: dict[str, tuple[float, float | None]] = {
    "paper0": (0.25, 275.0),
    "paper0-air": (0.25, 275.0),
    "serres2009": (0.25, 917.6),
    "dmsp-40-305": (0.305, None),
    "daerden": (0.2, None),
    "contractor-15": (0.15, None),
    "contractor-20": (0.2, None),
    "contractor-25": (0.25, None),
    "contractor-30": (0.3, None),
    "contractor-40": (0.4, None),
    "arm-30": (0.3, None),
}
"""Simulated muscle -> mounted length [m], F_ce at 300 kPa [N] where muscles of one size differ in it.

As data: who checks a driver compiles a bench, and must not know the models.
"""
UNCOVERED = 0.1
"""Share of a channel's range that its calibration may leave out at an end."""
TOO_WIDE = 2.0
"""A calibration over so many times the range of its channel is likely another sensor's."""


def mistaken(c: Compilation, channels: Mapping[str, ChannelRecord], devices: Sequence[DeviceRecord]) -> Iterator[str]:
    """A simulated muscle that is not the specimen, and calibrations that do not fit the range of their channel."""
    for device in devices:
        if "plant" in device.options and c.length:
            yield from _other_muscle(c, device.name, device.options["plant"])
    for name, (low, high) in c.calibrated.items():
        if name in channels and not name.endswith("_command"):
            yield from _of_another_range(c, channels[name], low, high)


def _other_muscle(c: Compilation, device: str, plant: Any) -> Iterator[str]:
    name = str(plant.get("name") if isinstance(plant, dict) else plant)
    length, pull = SIMULATED.get(name, (0.0, None)) if isinstance(plant, str) else (plant.get("length"), None)
    place = f"{c.place('devices', device, 'options', 'plant')}  the simulated muscle {name}"
    then = "results are those of the simulated one; take the bench and the specimen that belong together"
    there = c.specimen.mounted.length
    if length and abs(there - length) > LENGTH_OFF * length:
        yield (
            f"{place} is {show(length, 'length')} long, the specimen {show(there, 'length')} "
            f"({c.specimen_place('mounted', 'length')}): {then}"
        )
        return
    points = c.specimen.expected.points if c.specimen.expected is not None and pull is not None else ()
    for index, point in enumerate(points):
        if point.pressure == LOOKED_AT and pull is not None and abs(pull - point.F_ce) > FORCE_OFF * pull:
            yield (
                f"{place} has F_ce {show(pull, 'force')} at {show(LOOKED_AT, 'pressure')}, the specimen "
                f"{show(point.F_ce, 'force')} ({c.specimen_place('expected', 'points', index)}): {then}"
            )


def _of_another_range(c: Compilation, channel: ChannelRecord, low: float, high: float) -> Iterator[str]:
    """Points far outside the range are another sensor's; a range far outside the points is not covered."""
    allowed = UNCOVERED * (channel.high - channel.low)
    points = f"{show(low, channel.quantity)} to {show(high, channel.quantity)}"
    reads = f"{show(channel.low, channel.quantity)} to {show(channel.high, channel.quantity)}"
    place = f"{c.place('channels', channel.name, 'range')}  {channel.name} reads {reads}, and its calibration"
    if high - low > TOO_WIDE * (channel.high - channel.low):
        yield f"{place} {channel.calibration.id} has points from {points}: is it the calibration of this sensor?"
    elif channel.low < low - allowed or channel.high > high + allowed:
        yield (
            f"{place} {channel.calibration.id} covers {points} only: what lies beyond is not calibrated; "
            "give points up to there, or a smaller range"
        )
