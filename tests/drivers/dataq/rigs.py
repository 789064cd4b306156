"""A DATAQ device as a record, and with its emulator."""

import contextlib

from pmabench.bench.interface import ChannelRecord, DeviceRecord, Scale
from tests.drivers.common import in_front

DRIVER = "pmabench_drivers.dataq:Dataq"


def daq(address, inputs=("a0", "a3"), unit="V", **options):
    """A DI-2108 with pressure (1 V = 100 kPa) and force (1 V = 200 N) on two inputs."""
    channels = (
        ChannelRecord("pressure", "pressure", "daq", inputs[0], "float64", unit, Scale(1e5), -50e3, 1e6),
        ChannelRecord("force", "force", "daq", inputs[1], "float64", "V", Scale(200.0), -50.0, 1950.0),
    )
    return DeviceRecord("daq", DRIVER, str(address), {"model": "DI-2108", **options}, channels)


@contextlib.contextmanager
def rig(record, **options):
    """The emulator of a device and its open driver."""
    with in_front(record, **options) as (emulator, _served, driver):
        yield emulator, driver
