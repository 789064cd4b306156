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
"""The same for the forces at constant length."""
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
    from pmabench.model.presets import LENGTHS, MUSCLES

    name = str(plant.get("name") if isinstance(plant, dict) else plant)
    length = plant.get("length") if isinstance(plant, dict) else LENGTHS.get(name)
    place = f"{c.place('devices', device, 'options', 'plant')}  the simulated muscle {name}"
    then = "results are those of the simulated one; take the bench and the specimen that belong together"
    there = c.specimen.mounted.length
    if length and abs(there - length) > LENGTH_OFF * length:
        yield (
            f"{place} is {show(length, 'length')} long, the specimen {show(there, 'length')} "
            f"({c.specimen_place('mounted', 'length')}): {then}"
        )
        return
    expected = c.specimen.expected
    muscle = MUSCLES[name]() if name in MUSCLES and not isinstance(plant, dict) else None
    for index, point in enumerate(expected.points if expected is not None and muscle is not None else ()):
        pulls = float(muscle.F_ce(point.pressure)) if muscle is not None else 0.0
        if abs(pulls - point.F_ce) > FORCE_OFF * max(pulls, point.F_ce):
            yield (
                f"{place} has F_ce {show(pulls, 'force')} at {show(point.pressure, 'pressure')}, the specimen "
                f"{show(point.F_ce, 'force')} ({c.specimen_place('expected', 'points', index)}): {then}"
            )
            return


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
