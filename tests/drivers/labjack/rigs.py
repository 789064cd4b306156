"""A T7 as a record, emulated and opened; and stream packets written byte by byte."""

from pmabench.bench.interface import ChannelRecord, DeviceRecord, InterlockRecord, OutputRecord, Scale, ValveRecord
from tests.drivers.common import in_front
from tests.ports import free_port

DRIVER = "pmabench_drivers.labjack:LabJack"
CHANNELS = (
    ("pressure", "pressure", Scale(1e5)),
    ("displacement", "length", Scale(0.01, -0.005)),
    ("force", "force", Scale(200.0, -50.0)),
    ("pressure_command", "pressure", Scale(2e5)),
)


def channel(name, quantity, number, scale):
    return ChannelRecord(name, quantity, "t7", f"AIN{number}", "float64", "V", scale, -1e9, 1e9)


def t7(channels=4, watchdog=1.0, address="127.0.0.1:0", **options):
    """A T7 with the rig's channels (and more, up to `channels`), a regulator, a dump valve and an emergency stop."""
    known = [channel(name, quantity, i, scale) for i, (name, quantity, scale) in enumerate(CHANNELS)]
    more = [channel(f"spare{i}", "pressure", i, Scale()) for i in range(len(known), channels)]
    return DeviceRecord(
        "t7",
        DRIVER,
        address,
        {"stream_port": free_port(), **options},
        tuple([*known, *more][:channels]),
        (OutputRecord("pressure", "pressure", "t7", "DAC0", Scale(2e5), 0.00122, 0.0, 0.0, 6e5),),
        (ValveRecord("dump_valve", "t7", "FIO0"),),
        (InterlockRecord("e-stop", "t7", "FIO1"),),
        watchdog,
    )


def rig(record=None, **options):
    """An emulated T7 and its driver: emulator, emulated device, driver."""
    return in_front(record or t7(), **options)


def packet(transaction, samples, status=0, info=0, backlog=0):
    """A packet of the stream, by the table in the maker's datasheet, each field by itself."""
    body = [1, 76, 16, 0, *two(backlog), *two(status), *two(info)]
    body += [byte for sample in samples for byte in two(sample)]
    return bytes([*two(transaction), 0, 0, *two(len(body)), *body])


def two(value):
    return [value >> 8 & 255, value & 255]
