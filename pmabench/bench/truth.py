"""Truth file of an emulated bench, and the truth of a rig as plain numbers.

A truth file states what is really wired to which terminal, with scales from the data sheets: they do not come from the
bench file under test.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, ParamSpec, TypeVar

from pydantic import Field

from pmabench.base.errors import InvalidFile, Problem
from pmabench.base.quantities import CHANNEL_QUANTITY
from pmabench.bench import interface as b
from pmabench.bench.channels import fit_line
from pmabench.bench.driver_options import DBC, MAP, driver_class, loaded, read_named_file
from pmabench.bench.files.specimen import Name, Reading, Text
from pmabench.files.document import Document, Location, Strict, read_document, validate
from pmabench.files.quantity import unit_factor
from pmabench.files.shipped import shipped_folder

T = TypeVar("T")
P = ParamSpec("P")
Line = tuple[tuple[Reading, Reading], tuple[Reading, Reading]]
"""Two points of a straight line."""
Terminal = Annotated[str, Field(min_length=1, max_length=80)]
Source = Annotated[str, Field(min_length=1, max_length=400)]
"""Data sheet or page with the numbers."""


class SensorFile(Strict):
    """What is measured at one terminal: the sensor from signal to quantity, the device from digits to signal."""

    measures: Literal[
        "pressure", "displacement", "force", "supply", "angle", "pressure_command", "displacement_command"
    ]
    sensor: Line
    device: Line | None = None
    """Scale of the device, if it does not give the signal itself but for instance counts for volts."""
    source: Source


class ActuatorFile(Strict):
    """What a set-point moves: the actuator from its signal to the quantity, the device from digits to signal."""

    drives: Literal["pressure", "displacement"]
    actuator: Line
    device: Line | None = None
    step: Reading | None = None
    """Smallest step of the device."""
    range: tuple[Reading, Reading] | None = None
    """Ends of the travel of a drive."""
    source: Source


class ValveTruth(Strict):
    """A valve on a digital output."""

    valve: Literal["dump_valve"]
    energised: Literal["closed", "open"]
    """Position while energised."""
    source: Source


class ContactTruth(Strict):
    """A contact on a digital input."""

    contact: Name
    """A contact whose name has "stop" in it is the emergency stop."""
    released: Literal["high", "low"]
    """Level while it is not pressed."""
    source: Source


class DeviceTruth(Strict):
    """One device: which it is, how it is set up, and what is wired to it by terminal."""

    driver: str
    """Name of its driver."""
    options: dict[str, Any] = {}
    """Settings of the device, as options of its driver; its address is in the bench file."""
    inputs: dict[Terminal, SensorFile] = {}
    outputs: dict[Terminal, ActuatorFile] = {}
    valves: dict[Terminal, ValveTruth] = {}
    contacts: dict[Terminal, ContactTruth] = {}


class TruthFile(Strict):
    """What a rig really is, written from data sheets and not from the bench file that is to be proven."""

    schema_: Annotated[Literal["pmabench.truth/1"], Field(alias="schema")]
    name: Annotated[str, Field(min_length=1, max_length=80)]
    note: Text = ""
    devices: Annotated[dict[Name, DeviceTruth], Field(min_length=1)]
    """Devices by their names in the bench file."""


ENDLESS = 1e9
NOWHERE = "127.0.0.1:0"
OF_THE_BENCH = ("address", "watchdog")
"""Fields of a device record that a truth file does not have."""


def truth_of(bench: Path) -> Path | None:
    """The truth file of a shipped bench; None for any other file."""
    found = shipped_folder("truth") / bench.name
    shipped = bench.resolve().parent == shipped_folder("bench").resolve()
    return found if shipped and found.is_file() else None


def read_truth(path: Path) -> b.Truth:
    """Read the rig in a truth file; raises `InvalidFile` with every problem."""
    document = read_document(path)
    file = validate(TruthFile, document)
    problems: list[Problem] = []
    devices = {}
    for name, said in file.devices.items():
        device = _Device(document, name, said, path.parent)
        devices[name] = device.record()
        problems += device.problems or _refused_by_driver(device, devices[name])
    if problems:
        raise InvalidFile(problems)
    return b.Truth(str(path), devices)


class _Device:
    """One device of the file; collects every problem."""

    def __init__(self, document: Document, name: str, file: DeviceTruth, folder: Path) -> None:
        self.document, self.name, self.file, self._folder = document, name, file, folder
        self.at: Location = ("devices", name)
        self.problems: list[Problem] = []

    def fault(self, location: Location, message: str) -> None:
        """Add a problem at a value of this device."""
        self.problems.append(self.document.problem((*self.at, *location), message))

    def record(self) -> b.DeviceRecord:
        """The wired device, with a placeholder as address."""
        file, name = self.file, self.name
        driver = self._tried(("driver",), "", driver_class, file.driver)
        channels, outputs = [], []
        for terminal, sensor in file.inputs.items():
            what, at = sensor.measures, ("inputs", terminal)
            scale, unit = self._plug(at, "sensor", what, sensor.sensor, sensor.device)
            kind, quantity = "int32" if unit == "count" else "float64", CHANNEL_QUANTITY[what]
            channels.append(b.ChannelRecord(what, quantity, name, terminal, kind, unit, scale, -ENDLESS, ENDLESS))
        for terminal, actuator in file.outputs.items():
            what, at = actuator.drives, ("outputs", terminal)
            scale, unit = self._plug(at, "actuator", what, actuator.actuator, actuator.device)
            quantity = CHANNEL_QUANTITY[what]
            ends = [self._si(end, quantity, (*at, "range", i)) for i, end in enumerate(actuator.range or ())]
            low, high = min(ends, default=0.0), max(ends, default=0.0)
            step = self._step(actuator, unit, at)
            outputs.append(b.OutputRecord(what, quantity, name, terminal, scale, step, 0.0, low, high, rate=ENDLESS))
        valves = tuple(b.ValveRecord(valve.valve, name, at, valve.energised) for at, valve in file.valves.items())
        locks = tuple(b.InterlockRecord(item.contact, name, at, item.released) for at, item in file.contacts.items())
        return b.DeviceRecord(name, driver, NOWHERE, self._options(), tuple(channels), tuple(outputs), valves, locks)

    def _step(self, actuator: ActuatorFile, unit: str, at: Location) -> float:
        step, given = actuator.step or (0.0, unit)
        if given != unit or step < 0:
            self.fault((*at, "step"), f"a step in {unit} is expected")
        return step

    def _plug(self, at: Location, key: str, what: str, signal: Line, device: Line | None) -> tuple[b.Scale, str]:
        """The scale from device units to SI, and the device's own unit."""
        quantity = CHANNEL_QUANTITY[what]
        unit = self._one_unit(signal, 0, (*at, key))
        ends = [self._si(point[1], quantity, (*at, key, i, 1)) for i, point in enumerate(signal)]
        sensor = self._line([point[0][0] for point in signal], ends, (*at, key))
        if device is None:
            return sensor, unit
        if self._one_unit(device, 1, (*at, "device")) != unit:
            self.fault((*at, "device", 0, 1), f"what the device makes of its digits is in {unit}, as the {key} is")
        digits = self._line([p[0][0] for p in device], [p[1][0] for p in device], (*at, "device"))
        scale = b.Scale(sensor.slope * digits.slope, float(sensor.to_si(digits.offset)))
        return scale, self._one_unit(device, 0, (*at, "device"))

    def _one_unit(self, line: Line, side: int, at: Location) -> str:
        first, second = line[0][side][1], line[1][side][1]
        if first != second:
            self.fault((*at, 1, side), f"both in one unit, here {first}")
        return first

    def _si(self, reading: tuple[float, str], quantity: str, at: Location) -> float:
        return reading[0] * self._tried(at, 0.0, unit_factor, reading[1], quantity)

    def _line(self, raw: list[float], value: list[float], at: Location) -> b.Scale:
        return self._tried(at, b.Scale(), fit_line, raw, value)

    def _tried(self, at: Location, otherwise: T, act: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The result of `act`; its ValueError is a problem, and gives `otherwise`."""
        try:
            return act(*args, **kwargs)
        except ValueError as error:
            self.fault(at, str(error))
            return otherwise

    def _options(self) -> dict[str, Any]:
        """Options, with the names of a register map or DBC file next to this file replaced by its content."""
        options = dict(self.file.options)
        for key in (MAP, DBC):
            if isinstance(name := options.get(key), str):
                try:
                    found = read_named_file(self._folder, name, key)
                    options[key] = found.data if isinstance(found, Document) else found
                except InvalidFile as error:
                    self.problems += error.problems
                except ValueError as error:
                    self.fault(("options", key), str(error))
        return options


def _refused_by_driver(device: _Device, record: b.DeviceRecord) -> Iterator[Problem]:
    """Problems that the driver reports on options and terminals."""
    try:
        check = getattr(loaded(record.driver), "check", None)
    except (ImportError, AttributeError) as error:
        yield device.document.problem((*device.at, "driver"), f"the driver cannot be loaded: {error}")
        return
    terminals = {("channels", item.name): ("inputs", item.input) for item in record.channels}
    terminals |= {("outputs", item.name): ("outputs", item.output) for item in record.outputs}
    terminals |= {("outputs", item.name): ("valves", item.output) for item in record.valves}
    terminals |= {("interlocks", item.name): ("contacts", item.input) for item in record.interlocks}
    for place, message in check(record) if check is not None else ():
        if place and place[0] not in OF_THE_BENCH:
            location: Location = place if place[0] == "options" else terminals[place[0], place[1]]
            yield device.document.problem((*device.at, *location), message)
