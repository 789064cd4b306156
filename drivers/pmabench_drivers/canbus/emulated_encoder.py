"""Objects of an emulated CiA 406 linear encoder: identity, position, range and steps; knows no plant.

Indices, types, access and values at power-on: device properties according to CiA DS 406 in the operation manual of the
Temposonics E-Series CANopen (table 17); position 6004h and preset 6003h: CiA 406, class C2.
"""

from __future__ import annotations

from collections.abc import Callable

from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus.emulated_node import EmulatedNode
from pmabench_drivers.canbus.emulated_objects import Entry

LINEAR_ENCODER = 406 | 8 << 16
"""Device type: the profile, and an absolute linear encoder."""
STEP = 1000
"""Measuring step: 1 um, in units of 0.001 um."""
SPEED_STEP = 10
"""Step of the velocity: 0.1 mm/s, in units of 0.01 mm/s."""
STROKE = 300_000
"""Range that it can measure [steps]."""
CYCLE = 1
"""Time between two positions that it sends by itself [ms]."""
MISSING_MAGNET = 1
WARNINGS = 0x7000
PROFILE_VERSION = 0x0302_0001
"""Version of the profile, and of the software."""
UNKNOWN_TIME = 0xFFFF_FFFF
"""Operating time of a device that does not count it."""


def encoder_objects(node: EmulatedNode, position: Callable[[], int]) -> dict[tuple[int, int], Entry]:
    """The objects of the profile; `position` [steps] is where the magnet is now."""
    node.preset(f.DEVICE_TYPE, 0, LINEAR_ENCODER)
    timer = node.objects[f.TPDO_PARAMETER, 5]

    def cycle(period: int) -> None:
        """Cyclic timer and event timer of the first PDO are one."""
        timer.value = period

    objects = {
        (0x6000, 0): Entry("H", 0, writable=True),
        (0x6002, 0): Entry("I", STROKE, writable=True),
        (0x6004, 0): Entry("i", read=position),
        (0x6005, 1): Entry("I", STEP),
        (0x6005, 2): Entry("I", SPEED_STEP),
        (0x6020, 1): Entry("i", read=position),
        (0x6030, 1): Entry("h", 0),
        (0x6200, 0): Entry("H", CYCLE, writable=True, read=lambda: node.get(f.TPDO_PARAMETER, 5), written=cycle),
        (0x6400, 1): Entry("B", 0),
        (0x6500, 0): Entry("H", 0),
        (0x6501, 0): Entry("I", STEP),
        (0x6503, 0): Entry("H", 0),
        (0x6504, 0): Entry("H", MISSING_MAGNET),
        (0x6505, 0): Entry("H", 0),
        (0x6506, 0): Entry("H", WARNINGS),
        (0x6507, 0): Entry("I", PROFILE_VERSION),
        (0x6508, 0): Entry("I", UNKNOWN_TIME),
        (0x6509, 0): Entry("i", 0),
        (0x650A, 1): Entry("i", 0),
        (0x650A, 2): Entry("i", 0),
        (0x650A, 3): Entry("i", STROKE),
        (0x650B, 0): Entry("I", node.get(f.IDENTITY, 4)),
    }
    counts = {index: max(sub for at, sub in objects if at == index) for index, _sub in objects}
    return objects | {(index, 0): Entry("B", count) for index, count in counts.items() if count}
