"""What the files of a bench and a specimen say that is possible and likely a mistake; each a line with its place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from pmabench.base.quantities import show
from pmabench.bench.compilation import Compilation
from pmabench.bench.interface import ChannelRecord, DeviceRecord

LENGTH_OFF = 0.05
"""Relative difference of mounted and simulated length that makes another muscle of it."""
DIAMETER_OFF = 0.2
"""The same for the inner diameter, which files often give as the nominal one."""
FORCE_OFF = 0.3
"""The same for the force at the mounted length."""
LOOKED_AT = 300e3
"""Pressure at which forces are compared [Pa]."""


class Simulated(NamedTuple):
    """What distinguishes a simulated muscle from others."""

    length: float
    """Mounted length [m]."""
    diameter: float
    """Inner diameter [m]; of muscles whose model has none, that of the type."""
    serial: str
    """Of the specimen file that is shipped for it."""
    pull: float | None = None
    """F_ce at 300 kPa [N] where muscles of one size differ in it."""


SIMULATED: dict[str, Simulated] = {
    "paper0": Simulated(0.25, 0.02, "MOCK-P0", 275.0),
    "paper0-air": Simulated(0.25, 0.02, "MOCK-P0", 275.0),
    "serres2009": Simulated(0.25, 0.02, "MOCK-SERRES", 917.6),
    "dmsp-40-305": Simulated(0.305, 0.04, "MOCK-DMSP"),
    "daerden": Simulated(0.2, 0.02, "MOCK-DAERDEN"),
    "contractor-15": Simulated(0.15, 0.02, "MOCK-CONTRACTOR-15"),
    "contractor-20": Simulated(0.2, 0.02, "MOCK-CONTRACTOR-20"),
    "contractor-25": Simulated(0.25, 0.02, "MOCK-CONTRACTOR-25"),
    "contractor-30": Simulated(0.3, 0.02, "MOCK-CONTRACTOR"),
    "contractor-40": Simulated(0.4, 0.02, "MOCK-CONTRACTOR-40"),
    "arm-30": Simulated(0.3, 0.02, "MOCK-ARM"),
}
"""The muscles that a bench file can name.

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
    """The first thing in which the simulated muscle is not the specimen."""
    name = str(plant.get("name") if isinstance(plant, dict) else plant)
    known = SIMULATED.get(name) if isinstance(plant, str) else None
    muscle = plant if isinstance(plant, dict) else known._asdict() if known is not None else {}
    place = f"{c.place('devices', device, 'options', 'plant')}  the simulated muscle {name}"
    then = "results are those of the simulated one; take the bench and the specimen that belong together"
    for differs in (*_by_size(c, muscle), *(_by_name(c, known) if known is not None else ())):
        yield f"{place} {differs}: {then}"
        return


def _by_size(c: Compilation, muscle: Mapping[str, Any]) -> Iterator[str]:
    length, there = muscle.get("length"), c.specimen.mounted.length
    if length and abs(there - length) > LENGTH_OFF * length:
        place = c.specimen_place("mounted", "length")
        yield f"is {show(length, 'length')} long, the specimen {show(there, 'length')} ({place})"
    wide, theirs = muscle.get("diameter"), c.specimen.inner_diameter
    if wide and abs(theirs - wide) > DIAMETER_OFF * wide:
        place = c.specimen_place("inner_diameter")
        yield f"is {show(wide, 'length')} wide inside, the specimen {show(theirs, 'length')} ({place})"


def _by_name(c: Compilation, known: Simulated) -> Iterator[str]:
    """By the force that the specimen file expects, else by the serial number of another simulated muscle."""
    points = c.specimen.expected.points if c.specimen.expected is not None and known.pull is not None else ()
    for index, point in enumerate(points):
        if point.pressure == LOOKED_AT and known.pull and abs(known.pull - point.F_ce) > FORCE_OFF * known.pull:
            force, there = show(known.pull, "force"), show(point.F_ce, "force")
            place = c.specimen_place("expected", "points", index)
            yield f"has F_ce {force} at {show(LOOKED_AT, 'pressure')}, the specimen {there} ({place})"
    serial = c.specimen.serial
    if serial != known.serial and serial in {each.serial for each in SIMULATED.values()}:
        yield f"is {known.serial}, the specimen {serial} ({c.specimen_place('serial')})"


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
