"""What a bench file says about a CMMT, read strictly; knows no connection. Standard library only."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import ip_address

from pmabench.base.errors import did_you_mean
from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.festo_cmmt.telegram import LONGEST, SHORTEST
from pmabench_drivers.options import Reader

HERE = ("options",)
POSITION, SET_POINT = "position", "set_point"
"""What can be recorded: where the drive is, and where it is wanted at that moment. `POSITION` is also the output."""
WHOLE = 2**31


@dataclass(frozen=True)
class CmmtOptions:
    """What the driver `festo-cmmt` is told about a drive."""

    rate: float
    """Cycles of process data [Hz]."""
    speed: float
    """Of motions to a set-point that are no ramps [m/s]."""
    acknowledge_faults: bool


def read_options(device: DeviceRecord, reader: Reader) -> CmmtOptions:
    """The options of a device, and the names that its channels and outputs use."""
    given = reader.keys(device.options, HERE, ("rate", "speed", "acknowledge_faults"))
    host, colon, port = device.address.rpartition(":")
    try:
        ip_address(host.strip("[]") if host != "localhost" else "127.0.0.1")
        if not colon or not port.isdecimal() or not int(port) <= 65535:
            raise ValueError
    except ValueError:
        reader.fault(
            ("address",), f'an IP address with its port ("192.168.1.2:502") is expected, not "{device.address}"'
        )
    for channel in device.channels:
        place = ("channels", channel.name, "input")
        if channel.input not in {POSITION, SET_POINT}:
            hint = did_you_mean(channel.input, [POSITION, SET_POINT])
            reader.fault(place, f'a CMMT has no "{channel.input}"{hint}; it has {POSITION} and {SET_POINT}')
        elif channel.raw_type != "int32":
            reader.fault(place, "gives counts: its calibration goes from count to the quantity")
    for output in device.outputs:
        at = ("outputs", output.name, "output")
        if output.output != POSITION:
            reader.fault(at, f'a CMMT has no output "{output.output}"; it has {POSITION}')
        if output.quantity != "length":
            reader.fault(at, f"a CMMT moves, and {output.quantity} is no length")
        elif any(abs(float(output.scale.to_raw(value))) >= WHOLE for value in (output.low, output.high)):
            reader.fault(at, "cannot be commanded over its whole range: positions have 32 bits")
    if device.outputs and not device.watchdog:
        reader.fault((), f'a drive that moves needs "watchdog", {SHORTEST:g} s to {LONGEST:g} s')
    if device.watchdog and not SHORTEST <= device.watchdog <= LONGEST:
        reader.fault(("watchdog",), f"a CMMT waits {SHORTEST:g} to {LONGEST:g} s, not {device.watchdog:g} s")
    return CmmtOptions(
        reader.quantity(given, "rate", HERE, "frequency", 100.0, 1.0, 200.0),
        reader.quantity(given, "speed", HERE, "speed", 0.02, 1e-4, 1.0),
        reader.flag(given, "acknowledge_faults", HERE, default=False),
    )
