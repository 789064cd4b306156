"""A CMMT as a record, open in front of its emulator."""

import contextlib

from pmabench.bench.interface import ChannelRecord, DeviceRecord, OutputRecord, Scale
from tests.drivers.common import in_front

DRIVER = "pmabench_drivers.festo_cmmt:FestoCmmt"
UM = Scale(1e-6)


def drive(address="127.0.0.1:0", watchdog=0.5, **options):
    """A drive in micrometres with both its channels."""
    return DeviceRecord(
        "drive",
        DRIVER,
        address,
        {"rate": "100 Hz", **options},
        (
            ChannelRecord("displacement", "length", "drive", "position", "int32", "count", UM, -0.01, 0.09),
            ChannelRecord("displacement_command", "length", "drive", "set_point", "int32", "count", UM, -0.01, 0.09),
        ),
        (OutputRecord("displacement", "length", "drive", "position", UM, 1.0, 0.0, 0.0, 0.05, rate=0.5),),
        (),
        (),
        watchdog,
    )


class Rig:
    """Emulator and driver of one drive."""

    def __init__(self, emulator, server, device):
        self.emulator, self.server, self.device = emulator, server, device
        self.inside = server.registers

    def log(self, kind):
        return self.emulator.log.of(kind, "drive")

    def armed(self):
        """Open, under power, at zero."""
        self.device.open()
        self.device.arm_watchdog(0.5)
        self.device.write("position", 0.0)


@contextlib.contextmanager
def served(record=None, **options):
    """A rig whose driver is not open."""
    with in_front(record or drive(), opened=False, **options) as parts:
        yield Rig(*parts)
