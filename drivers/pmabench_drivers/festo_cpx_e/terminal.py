"""A CPX-E terminal as its modules in order: addresses, parameter numbers, and the driver's options, read strictly.

Uses no connection; standard library only. Addresses, function numbers and range codes: Festo's own client library
festo-cpx-io 0.11.2, read as a description of the protocol; CPX-E-EP manual (the data system table).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from pmabench.base.errors import did_you_mean
from pmabench.bench.interface import DeviceRecord, OutputRecord
from pmabench_drivers.modbus.registers import Mapped, Register, RegisterMap, WatchdogRegisters
from pmabench_drivers.shared.options import Reader, option

HERE = ("options",)

CONTROL = 40001
"""Data system table: the request."""
FIRST_OUTPUT = 40003
PRESENT, FAULTS, STATUS = 45367, 45383, 45391
"""Bits of the modules present (three registers), of those with a fault (three registers), and of the terminal."""
READY, VALUE_OUT = 45392, 45393
"""Data system table: bit 15 says that the answer is ready, and the value that was read."""
FIRST_INPUT = 45395
TIMEOUT = Register("watchdog time", "holding", 46100)
"""Milliseconds without any communication after which the terminal acts by itself; 0: never."""
SHORTEST, LONGEST = 0.1, 65.535
"""Limits of the time-out [s]."""
DONE = ASK = 1 << 15
FORCED = 1 << 15
"""Bit of `STATUS`: outputs or inputs are forced by hand."""
MOST_MODULES = 25
"""Largest number of modules: their inputs are read in one transaction of at most 125 registers."""
RANGES = {"0..10 V": 1, "-10..10 V": 2, "-5..5 V": 3, "1..5 V": 4, "0..20 mA": 5, "4..20 mA": 6, "-20..20 mA": 7}
DATA_FORMAT = 6
"""Parameter whose bit 0 is clear for the format "sign + 15 bit"."""


@dataclass(frozen=True)
class Kind:
    """A type of module: prefix and number of its channels, and its registers of process data."""

    prefix: str
    channels: int
    outputs: int
    inputs: int
    status: int
    """Index of the input register with its status; a status of 0 means that all is well."""
    ranges: int = 0
    """Parameter with the ranges of channels 0 and 1; the next one has those of 2 and 3. 0: it has no ranges."""


KINDS = {
    "16di": Kind("di", 16, 0, 2, 1),
    "8do": Kind("do", 8, 1, 2, 1),
    "4ai-ui": Kind("ai", 4, 0, 5, 4, ranges=13),
    "4ao-ui": Kind("ao", 4, 4, 5, 4, ranges=11),
}


@dataclass(frozen=True)
class Module:
    """One module of the terminal."""

    position: int
    """1 for the first one after the bus module."""
    name: str
    kind: Kind
    first_output: int
    first_input: int

    @property
    def status(self) -> int:
        """Address of its status."""
        return self.first_input + self.kind.status

    def parameter(self, number: int) -> int:
        """Function number of one of its parameters."""
        return 4828 + 64 * self.position + number

    def range_of(self, channel: int) -> tuple[int, int]:
        """Function number of a channel's range, and its offset there [bits]."""
        return self.parameter(self.kind.ranges + channel // 2), 4 * (channel % 2)


@dataclass(frozen=True)
class Terminal:
    """The modules in order, and their addresses."""

    modules: tuple[Module, ...] = ()
    ranges: Mapping[str, int] = field(default_factory=dict)
    """Analogue channel -> code of its range."""

    @property
    def width(self) -> int:
        """Registers of all inputs."""
        return sum(module.kind.inputs for module in self.modules)

    def module_of(self, name: str) -> Module:
        """The module of a channel."""
        return self.modules[int(name.partition(".")[0][2:]) - 1]

    def inputs(self) -> dict[str, Register]:
        """Every channel by name; for output modules, the outputs as the module reports them."""
        return {name: register for module in self.modules for name, register in _registers(module, module.first_input)}

    def outputs(self) -> dict[str, Register]:
        """Every channel that can be written."""
        writable = [module for module in self.modules if module.kind.outputs]
        return {name: register for module in writable for name, register in _registers(module, module.first_output)}


def _registers(module: Module, first: int) -> list[tuple[str, Register]]:
    found = []
    for channel in range(module.kind.channels):
        name = f"{module.kind.prefix}{module.position}.{channel}"
        if module.kind.ranges:
            found.append((name, Register(name, "holding", first + channel, "int16")))
        else:
            found.append((name, Register(name, "holding", first, "uint16", bit=channel)))
    return found


def build(names: tuple[str, ...]) -> tuple[Module, ...]:
    """The modules with their addresses: process data follow one another without gaps."""
    modules, output, input_ = [], FIRST_OUTPUT, FIRST_INPUT
    for position, name in enumerate(names, 1):
        kind = KINDS[name]
        modules.append(Module(position, name, kind, output, input_))
        output, input_ = output + kind.outputs, input_ + kind.inputs
    return tuple(modules)


@dataclass(frozen=True)
class CpxOptions(Mapped):
    """Options of the driver `festo-cpx-e` for a terminal."""

    rate: float = option(Reader.quantity, "frequency", 100.0, 0.1, 500.0)
    terminal: Terminal = field(default_factory=Terminal)


def read_options(device: DeviceRecord, reader: Reader) -> CpxOptions:
    """Options of a device; also checks the names that its channels, outputs, valves and interlocks use."""
    options, given = reader.options(CpxOptions, device.options, HERE, ("modules", "ranges"), ("modules",))
    reader.host(device, "192.168.1.1:502")
    names = reader.texts(given, "modules", HERE)
    wrong = [name for name in names if name not in KINDS]
    for name in wrong:
        reader.known((*HERE, "modules"), "no module", name, KINDS, f"; known: {', '.join(KINDS)}")
    if not names or len(names) > MOST_MODULES:
        reader.fault((*HERE, "modules"), f"1 to {MOST_MODULES} modules are expected, in order from the bus module")
    modules = build(names) if names and not wrong else ()
    terminal = Terminal(modules, _ranges(given, modules, reader))
    if modules:
        _used(device, terminal, reader)
    reader.watchdog(device, "a CPX-E", SHORTEST, LONGEST)
    map_ = RegisterMap(inputs=terminal.inputs(), outputs=terminal.outputs(), watchdog=WatchdogRegisters(TIMEOUT))
    return replace(options, map=map_, terminal=terminal)


def _ranges(given: Mapping[str, object], modules: tuple[Module, ...], reader: Reader) -> dict[str, int]:
    place, found = (*HERE, "ranges"), {}
    analogue = [name for module in modules if module.kind.ranges for name, _ in _registers(module, 0)]
    for name, text in reader.named(given.get("ranges", {}), place).items():
        at = (*place, name)
        if reader.known(at, "no range", str(text), RANGES, f"; known: {', '.join(RANGES)}") and (
            not modules or reader.known(at, "no analogue channel", str(name), analogue)
        ):
            found[name] = RANGES[str(text)]
    return found


def _used(device: DeviceRecord, terminal: Terminal, reader: Reader) -> None:
    """Check that everything the bench uses exists on the terminal, and is of the right kind."""
    inputs, used = terminal.inputs(), set()

    def named(place: tuple[str | int, ...], name: str, prefixes: tuple[str, ...]) -> bool:
        wanted = [known for known in inputs if known.startswith(prefixes)]
        if name not in wanted:
            what = "/".join(prefixes)
            hint = did_you_mean(name, wanted) or f"; expected is {what}, the module's place, a dot, and the channel"
            reader.fault(place, f'the modules have no "{name}"{hint}')
        used.add(name)
        return name in wanted

    for channel in device.channels:
        place = ("channels", channel.name, "input")
        if named(place, channel.input, ("ai", "ao")) and channel.raw_type != "int32":
            reader.fault(place, "gives counts: its calibration goes from count to the quantity")
    for output in device.outputs:
        at = ("outputs", output.name, "output")
        if named(at, output.output, ("ao",)):
            low = -32768 if terminal.ranges.get(output.output) in {2, 3, 7} else 0
            _fits(output, low, reader, watched=bool(device.watchdog))
    for valve in device.valves:
        at = ("outputs", valve.name, "output")
        named(at, valve.output, ("do",))
        if device.watchdog and valve.energised == valve.safe:
            message = f"is {valve.safe} in the safe state only while it is energised; without communication it is not"
            reader.fault(at, message)
    for lock in device.interlocks:
        named(("interlocks", lock.name, "input"), lock.input, ("di",))
    for name in sorted(used):
        if name in inputs and name[:2] in {"ai", "ao"} and name not in terminal.ranges:
            reader.fault((*HERE, "ranges"), f'"{name}" is used and has no range here; known: {", ".join(RANGES)}')


def _fits(output: OutputRecord, low: int, reader: Reader, *, watched: bool) -> None:
    """Check that an output's range fits its module, and that its safe value is 0 if the terminal vents by itself."""
    at = ("outputs", output.name, "output")
    ends = [float(output.scale.to_raw(value)) for value in (output.low, output.high, output.safe)]
    for value in [value for value in ends if not low <= value <= 32767][:1]:
        reader.fault(at, f"cannot be commanded over its whole range: {value:g} is outside {low} to 32767")
    if watched and round(ends[2]) != 0:
        reader.fault(at, f"its safe value is {ends[2]:g} counts, and without communication the terminal puts out 0")
