"""A laser as a record, and with its emulator."""

import contextlib

from pmabench.bench.interface import ChannelRecord, DeviceRecord, Scale
from tests.drivers.common import in_front

DRIVER = "pmabench_drivers.ild1420:Ild1420"


def laser(address, **changes):
    """A laser of 100 mm that stands 5 mm from its begin at rest; `changes` to its options, input and unit."""
    source, unit = changes.pop("input", "distance"), changes.pop("unit", "mm")
    scale = Scale(1e-3, -5e-3)
    channel = ChannelRecord("displacement", "length", "laser", source, "float64", unit, scale, -5e-3, 0.09)
    return DeviceRecord("laser", DRIVER, str(address), {"range": "100 mm", "rate": "1 kHz", **changes}, (channel,))


@contextlib.contextmanager
def rig(record, **options):
    """The emulator of a laser and its open driver."""
    with in_front(record, **options) as (emulator, _served, driver):
        yield emulator, driver
