"""What a bench file says about a CMMT, read strictly; knows no connection. Standard library only."""

from __future__ import annotations

from dataclasses import dataclass

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.festo_cmmt.telegram import LONGEST, SHORTEST
from pmabench_drivers.shared.options import Reader

HERE = ("options",)
POSITION, SET_POINT = "position", "set_point"
"""What can be recorded: where the drive is, and where it is wanted at that moment. `POSITION` is also the output."""
WHOLE = 2**31


@dataclass(frozen=True)
class CmmtOptions:
    """Options of the driver `festo-cmmt` for a drive."""

    rate: float
    """Cycles of process data [Hz]."""
    speed: float
    """Of motions to a set-point that are no ramps [m/s]."""
    acknowledge_faults: bool


def read_options(device: DeviceRecord, reader: Reader) -> CmmtOptions:
    """The options of a device, and the names that its channels and outputs use."""
    given = reader.keys(device.options, HERE, ("rate", "speed", "acknowledge_faults"))
    reader.host(device, "192.168.1.2:502")
    for channel in device.channels:
        place = ("channels", channel.name, "input")
        has = f"; it has {POSITION} and {SET_POINT}"
        if (
            reader.known(place, "a CMMT has no", channel.input, [POSITION, SET_POINT], has)
            and channel.raw_type != "int32"
        ):
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
    reader.watchdog(device, "a CMMT", SHORTEST, LONGEST)
    return CmmtOptions(
        reader.quantity(given, "rate", HERE, "frequency", 100.0, 1.0, 200.0),
        reader.quantity(given, "speed", HERE, "speed", 0.02, 1e-4, 1.0),
        reader.flag(given, "acknowledge_faults", HERE, default=False),
    )
