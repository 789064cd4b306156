"""The options of an Alicat controller, and what a reading of it says; knows no port. Standard library only."""

from __future__ import annotations

from dataclasses import dataclass

from pmabench.base.errors import did_you_mean
from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.shared.options import Reader

ASCII, MODBUS = "ascii", "modbus"
PCD, MCD = "PCD", "MCD"
KEYS = ("protocol", "unit_id", "baud", "unit", "valves", "rate", "timeout", "slowest", "emulate")
BAUDS = (19200, 38400, 57600, 115200)
"""Slower lines cannot list the columns within the time that opening may take."""
INPUTS = ("pressure", "set_point")
OUTPUT = "pressure"
UNITS = {
    "Pa": (2, 1.0),
    "hPa": (3, 1e2),
    "kPa": (4, 1e3),
    "MPa": (5, 1e6),
    "mbar": (6, 1e2),
    "bar": (7, 1e5),
    "psi": (10, 6894.757293168),
    "atm": (22, 101325.0),
}
"""Unit of the bench file -> the number by which the device calls it, and pascal."""
OFF_UNIT = 0.02
"""How far the slope of a calibration may be from its unit [1]; other units differ by far more."""
OVER, HELD, FAILED, EXHAUST, LIMIT, ABORTED = "POV", "HLD", "ADC", "EXH", "OPL", "aborted"
BITS = {6: OVER, 8: HELD, 9: FAILED, 10: EXHAUST, 11: LIMIT, 13: ABORTED}
"""Bits of the Modbus status flags that a pressure controller has."""
HARMLESS = frozenset({"LCK", "MOV", "OVR", "TMF", "TOV", "VOV"})
"""A locked display, and what is about flow and temperature."""
CODES = frozenset({*HARMLESS, OVER, HELD, FAILED, EXHAUST, LIMIT})
NO_VALUE = frozenset({FAILED, ABORTED})
"""With these the number is no measurement."""
MEANING = {
    FAILED: "its pressure sensor cannot be read (ADC)",
    ABORTED: "its measurement was aborted",
    LIMIT: "it is over its own pressure limit (OPL)",
    HELD: "its valves are held (HLD): it traps the pressure and follows no set-point",
    EXHAUST: "its exhaust is held open (EXH), and not by this program",
}


@dataclass(frozen=True)
class Options:
    """Options of the driver `alicat` for a controller; times in s, rates in Hz."""

    protocol: str = ASCII
    letter: str = "A"
    """The unit ID over ASCII."""
    number: int = 1
    """The unit ID over Modbus."""
    baud: int = 19200
    unit: str = "kPa"
    """The unit of every number that goes over the line."""
    valves: int = 2
    """2: it fills and vents by itself (PCD); 1: it only fills, and a bleed vents (PC)."""
    rate: float = 50.0
    """Highest rate at which it is polled."""
    timeout: float = 0.06
    """Longest wait for an answer."""
    slowest: float = 0.5
    """How long after a question the device may still answer it."""
    emulate: str = PCD
    """What `pmabench emulate` serves over ASCII: a pressure controller, or a mass flow controller."""


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """The options of a device, and whether its channels and its output are what an Alicat has."""
    place, base = ("options",), Options()
    given = reader.keys(device.options, place, KEYS, ("protocol",))
    if not device.address.startswith("/"):
        wanted = 'the path of a serial port is expected, for instance "/dev/ttyUSB0"'
        reader.fault(("address",), f'{wanted}, not "{device.address}"')
    protocol = reader.choice(given, "protocol", place, (ASCII, MODBUS), ASCII)
    letter, number = base.letter, base.number
    if protocol == ASCII:
        letter = reader.text(given, "unit_id", place, base.letter).upper()
        if len(letter) != 1 or not "A" <= letter <= "Z":
            reader.fault((*place, "unit_id"), "one letter from A to Z is expected")
            letter = base.letter
    else:
        number = reader.whole(given, "unit_id", place, 1, 247, base.number)
    return Options(
        protocol=protocol,
        letter=letter,
        number=number,
        baud=reader.one_of(given, "baud", place, BAUDS, base.baud),
        unit=_unit(device, given.get("unit"), protocol, reader),
        valves=reader.whole(given, "valves", place, 1, 2, base.valves),
        rate=reader.quantity(given, "rate", place, "frequency", base.rate, 0.1, 500.0),
        timeout=reader.quantity(given, "timeout", place, "time", base.timeout, 0.01, 0.1),
        slowest=reader.quantity(given, "slowest", place, "time", base.slowest, 0.0, 10.0),
        emulate=reader.choice(given, "emulate", place, (PCD, MCD), PCD),
    )


def _unit(device: DeviceRecord, given: object, protocol: str, reader: Reader) -> str:
    """The one unit of the line: that of every channel, of the output's slope, and of the option where it is."""
    place = ("options", "unit")
    units = [channel.raw_unit for channel in device.channels]
    unit = str(given) if given is not None else units[0] if units else ""
    if given is None and protocol == MODBUS:
        message = '"unit" is missing: over Modbus the device cannot say its unit; look at its display'
        reader.fault(("options",), message)
    elif unit not in UNITS:
        message = f'"{unit}" is no unit of pressure that is known here{did_you_mean(unit, UNITS)}'
        reader.fault(place if given is not None else ("options",), message)
    for channel in device.channels:
        at = "channels", channel.name, "input"
        if channel.input not in INPUTS:
            reader.fault(at, f'no input "{channel.input}"; it has {" and ".join(INPUTS)}')
        elif channel.raw_unit != unit:
            reader.fault(at, f'the channel reads {channel.raw_unit} and the device speaks "{unit}"')
        elif channel.reference != "gauge":
            reader.fault(at, f"only gauge pressure is read, and the channel is {channel.reference}")
    if len(device.outputs) > 1:
        reader.fault(("outputs", device.outputs[1].name, "output"), "it has one set-point")
    for output in device.outputs:
        at = "outputs", output.name, "output"
        if output.output != OUTPUT:
            reader.fault(at, f'no output "{output.output}"; it has "{OUTPUT}"')
        elif unit in UNITS and abs(output.scale.slope / UNITS[unit][1] - 1.0) > OFF_UNIT:
            reader.fault(at, f"the scale is {output.scale.slope:g} Pa a step, and the device speaks {unit}")
    return unit if unit in UNITS else "kPa"


@dataclass(frozen=True)
class Reading:
    """One answer: pressure and set-point in the device's unit, its status, and when it was asked and answered.

    `asked` and `answered` are bench time [s].
    """

    pressure: float
    set_point: float
    status: frozenset[str]
    asked: float
    answered: float


def trouble(status: frozenset[str], *, exhausting: bool) -> str:
    """What in a status is wrong; empty where nothing is. `exhausting`: this program has opened the exhaust."""
    for code in (FAILED, ABORTED, LIMIT, HELD, EXHAUST):
        if code in status and not (code in {EXHAUST, HELD} and exhausting):
            return MEANING[code]
    unknown = sorted(status - CODES - {ABORTED})
    return f'it says "{unknown[0]}", which is not known here' if unknown else ""


def from_bits(flags: int) -> frozenset[str]:
    """The codes of Modbus status flags; bits about flow and temperature are left out."""
    return frozenset(code for bit, code in BITS.items() if flags >> bit & 1)
