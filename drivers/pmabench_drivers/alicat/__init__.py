"""Alicat PC and PCD pressure controllers, over ASCII or Modbus RTU on a serial line.

Here: options in the bench file, readings, the device interface; `ascii_link` (its data line: `layout`), `modbus_link`:
the two protocols with the same methods; `emulator`: the device for `pmabench emulate`.

Sources: Alicat, manual of standard flow and pressure devices, 02/2023 (Modbus registers, special commands, status bits;
ASCII commands); Apex/Alicat PC manual, page 22 (set-points, data frame). The list of columns is parsed in the format
that firmware 6v21 to 10v20 is known to send.
It has no watchdog: without communication a controller keeps its last set-point. One thread polls and sends the steps of
ramps and sines; calls and polls take turns on the line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from time import monotonic
from typing import TYPE_CHECKING, TypeAlias

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import DeviceRecord, Identity, OutputRecord
from pmabench_drivers.shared.device import Controlled
from pmabench_drivers.shared.link import JOIN, Still, always
from pmabench_drivers.shared.options import Reader, option

if TYPE_CHECKING:
    from pmabench_drivers.alicat.ascii_link import AsciiLink
    from pmabench_drivers.alicat.modbus_link import ModbusLink

    Link: TypeAlias = AsciiLink | ModbusLink

ASCII, MODBUS = "ascii", "modbus"
BAUDS = (19200, 38400, 57600, 115200)
"""Supported baud rates; slower lines cannot list the columns within the time limit of opening."""
INPUTS = ("pressure", "set_point")
OUTPUT = "pressure"
OTHER_SET_POINT = "is its set-point source the serial line, or does it limit set-points?"
"""What to look at where it answered, and holds another set-point."""
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
"""Unit in the bench file -> code of the device, and size [Pa]."""
OFF_UNIT = 0.02
"""Largest relative deviation of a calibration's slope from its unit [1]; other units differ by far more."""
OVER, HELD, FAILED, EXHAUST, LIMIT, ABORTED = "POV", "HLD", "ADC", "EXH", "OPL", "aborted"
BITS = {6: OVER, 8: HELD, 9: FAILED, 10: EXHAUST, 11: LIMIT, 13: ABORTED}
"""Bits of the Modbus status flags that concern a pressure controller."""
HARMLESS = frozenset({"LCK", "MOV", "OVR", "TMF", "TOV", "VOV"})
"""Status codes without effect here: a locked display, and those on flow and temperature."""
CODES = frozenset({*HARMLESS, OVER, HELD, FAILED, EXHAUST, LIMIT})
NO_VALUE = frozenset({FAILED, ABORTED})
"""Status codes with which the number is not a measurement."""
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

    protocol: str = option(Reader.choice, (ASCII, MODBUS), ASCII)
    letter: str = "A"
    """Unit ID over ASCII."""
    number: int = 1
    """Unit ID over Modbus."""
    baud: int = option(Reader.one_of, BAUDS, 19200)
    unit: str = "kPa"
    """Unit of every number on the line."""
    valves: int = option(Reader.whole, 1, 2, 2)
    """2: it fills and vents by itself (PCD); 1: it only fills, and vents through a bleed (PC)."""
    rate: float = option(Reader.quantity, "frequency", 50.0, 0.1, 500.0)
    """Highest polling rate."""
    timeout: float = option(Reader.quantity, "time", 0.06, 0.01, 0.1)
    """Longest wait for an answer."""
    slowest: float = option(Reader.quantity, "time", 0.5, 0.0, 10.0)
    """How long after a request the device may still answer it."""


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """Options of a device; also checks that its channels and output exist on an Alicat."""
    place = ("options",)
    options, given = reader.options(Options, device.options, place, ("unit_id", "unit"), ("protocol",))
    if not device.address.startswith("/"):
        wanted = 'the path of a serial port is expected, for instance "/dev/ttyUSB0"'
        reader.fault(("address",), f'{wanted}, not "{device.address}"')
    if options.protocol == ASCII:
        letter = reader.text(given, "unit_id", place, options.letter).upper()
        if len(letter) != 1 or not "A" <= letter <= "Z":
            reader.fault((*place, "unit_id"), "one letter from A to Z is expected")
        options = replace(options, letter=letter)
    else:
        options = replace(options, number=reader.whole(given, "unit_id", place, 1, 247, 1))
    return replace(options, unit=_unit(device, given.get("unit"), options.protocol, reader))


def _unit(device: DeviceRecord, given: object, protocol: str, reader: Reader) -> str:
    """Unit of the line: that of every channel, of the output's slope, and of the option `unit` if given."""
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
    """One answer: pressure and set-point in the device's unit, status, and times of request and answer.

    `asked` and `answered` are bench time [s].
    """

    pressure: float
    set_point: float
    status: frozenset[str]
    asked: float
    answered: float


def trouble(status: frozenset[str], *, exhausting: bool) -> str:
    """What is wrong according to a status; empty if nothing is. `exhausting`: this program has opened the exhaust."""
    for code in (FAILED, ABORTED, LIMIT, HELD, EXHAUST):
        if code in status and not (code in {EXHAUST, HELD} and exhausting):
            return MEANING[code]
    unknown = sorted(status - CODES - {ABORTED})
    return f'it says "{unknown[0]}", which is not known here' if unknown else ""


def from_bits(flags: int) -> frozenset[str]:
    """Status codes of Modbus status flags; bits on flow and temperature are left out."""
    return frozenset(code for bit, code in BITS.items() if flags >> bit & 1)


CALL = 0.18
"""Time limit of a call [s]; the guard gives up at 0.2 s."""
OPEN = 1.9
LARGEST = 1e6
"""Larger set-points are not sent, in any unit."""


class AlicatController(Controlled["Link"]):
    """A pressure controller with the inputs `pressure` and `set_point` and the output `pressure`.

    A set-point at or below the output's safe value vents: over Modbus with the exhaust of a dual-valve controller.
    """

    emulator = "pmabench_drivers.alicat.emulator"
    read_options = staticmethod(read_options)
    _options: Options

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._inputs = [channel.input for channel in device.channels]
        self._compared = False
        self._reading: Reading | None = None
        """Reading in the answer to a step, in this turn of the thread; else None."""

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Connect and identify; refuse another unit or source of set-points than the bench's."""
        until = monotonic() + OPEN
        identity = self._connect(until)
        with self._closed_on_error():
            self._compare(until)
        return identity

    def open_to_vent(self) -> Identity:
        """Connect and identify only: 0 is 0 in every unit, and the units are compared before sampling."""
        return self._connect(monotonic() + OPEN)

    def _connect(self, until: float) -> Identity:
        from pmabench_drivers.alicat.ascii_link import AsciiLink
        from pmabench_drivers.alicat.modbus_link import ModbusLink

        self.close()
        kind = AsciiLink if self._options.protocol == ASCII else ModbusLink
        link = self._link = kind(self._device.name, self._device.address, self._options, self._clock)
        with self._closed_on_error():
            return link.open(until)

    def _compare(self, until: float) -> None:
        self._opened().compare(until)
        self._compared = True

    def start(self, rate: float) -> float:
        """Poll at `rate` [Hz], or as fast as options and line allow if that is less."""
        if not self._compared:
            self._compare(monotonic() + CALL)
        return super().start(rate)

    def close(self) -> None:
        """Stop polling and close the port; the device keeps its set-point."""
        self._following.clear()
        self._streaming = False
        link, self._link, self._compared = self._link, None, False
        self._cycle.stop(JOIN)
        if link is not None:
            link.close()

    # -- samples --------------------------------------------------------------------------------------------------

    def _fastest(self) -> float:
        return min(self._options.rate, self._opened().fastest)

    def _tick(self) -> None:
        """One turn of the thread: the next step of a segment, whose answer may contain a reading, or a poll."""
        if (link := self._link) is None:
            return
        self._reading = None
        failure = self._step()
        reading = self._reading
        try:
            if self._streaming and reading is None and failure is None:
                reading = link.poll(monotonic() + self._options.timeout)
        except DeviceError as error:
            failure = error
        if reading is not None:
            if wrong := trouble(reading.status, exhausting=link.exhausting):
                failure = self._error(wrong)
            if self._streaming and not reading.status & NO_VALUE:
                self._take(reading)
        elif failure is None:
            return  # nothing new
        self._cycle.note(failure)

    def _take(self, reading: Reading) -> None:
        values = {"pressure": math.nan if OVER in reading.status else reading.pressure, "set_point": reading.set_point}
        self._keep([values[name] for name in self._inputs], reading.asked, reading.answered)

    # -- commands -------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Command a set-point once; succeeds if the device then holds it. Vents at or below the safe value."""
        record = self._output(output)
        self._following.pop(output, None)
        self._send(record, value, vents=self._vents(record, value))

    def read_back(self, output: str) -> float:
        """Set-point that the device holds."""
        self._output(output)
        return self._opened().held(monotonic() + CALL)

    def held(self) -> Mapping[str, float | str]:
        """Unit and source of its set-point, reported over ASCII from firmware 10v05; before, the unit only.

        It has no watchdog and reports no uptime: a restart shows in its set-point, which is read by `read_back`.
        """
        return self._opened().reported(monotonic() + CALL)

    def _refuse_value(self, output: str, value: float) -> None:
        """Accept every value; the device and the guard have their limits."""

    def _send_step(self, output: str, value: float, still: Still, *, last: bool) -> None:
        """Send the set-point of this step; the last one vents if it is low enough."""
        record = self._outputs[output]
        self._reading = self._send(record, value, vents=last and self._vents(record, value), still=still, step=True)

    def _send(
        self, record: OutputRecord, value: float, *, vents: bool, still: Still = always, step: bool = False
    ) -> Reading | None:
        """Send a set-point; a `step` of a ramp has less time, unless it vents."""
        if not abs(value) < LARGEST:
            raise self._error(f"{value} cannot be commanded", OUTPUT)
        link = self._opened()
        send = link.vent if vents else link.command
        deadline = monotonic() + (self._options.timeout if step and not vents else CALL)
        return send(value, deadline, record.resolution / 2, still)

    def _vents(self, record: OutputRecord, value: float) -> bool:
        """Whether a set-point is at or below that of the safe state."""
        return value <= float(record.scale.to_raw(record.safe)) + 1e-9
