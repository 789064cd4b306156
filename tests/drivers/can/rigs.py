"""A bus with a drive and a transducer as a record, emulated and opened."""

from pmabench.bench.interface import ChannelRecord, DeviceRecord, InterlockRecord, OutputRecord, Scale
from tests.drivers.common import in_front

DRIVER = "pmabench_drivers.canbus:CanBus"
COUNT = 1e-6
"""A count of the drive and of the transducer [m]."""
SCALE = Scale(COUNT)
NODES = {
    "drive": {"profile": 402, "node": 5, "approach": "50 mm/s"},
    "transducer": {"profile": 406, "node": 12},
}


def channel(name, quantity, source, scale=SCALE, unit="count"):
    return ChannelRecord(name, quantity, "bus", source, "float64", unit, scale, -1e9, 1e9)


CHANNELS = (
    channel("displacement", "length", "transducer.position"),
    channel("drive_position", "length", "drive.position"),
    channel("displacement_command", "length", "drive.demand"),
)


def bus(address="slcan:socket://127.0.0.1:0", channels=CHANNELS, watchdog=0.5, **options):
    """A drive of 1 um a count and 200 mm/s, a transducer; the drive can be asked whether it is ready."""
    drive = OutputRecord(
        "displacement", "length", "bus", "drive.position", Scale(COUNT), 1.0, 0.0, -0.002, 0.05, rate=0.2
    )
    given = {"nodes": NODES, **options}
    moves = "drive" in given["nodes"]
    return DeviceRecord(
        "bus",
        DRIVER,
        address,
        given,
        tuple(channels),
        (drive,) if moves else (),
        (),
        (InterlockRecord("drive", "bus", "drive.ready"),) if moves else (),
        watchdog if moves else 0.0,
    )


def rig(record=None, **options):
    """An emulated bus and its driver: emulator, emulated bus, driver."""
    return in_front(record or bus(), **options)
