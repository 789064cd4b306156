"""Register maps in their file and as records, and conversion between 16-bit words and numbers; uses no connection.

The specification (Modbus Application Protocol 1.1b3) fixes the order of the two bytes of a register and leaves the
order of the registers of a 32-bit value to the maker, hence `low_word_first`.

Standard library only.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.resources import files
from typing import Any

from pmabench.bench.interface import DeviceRecord, OutputRecord
from pmabench_drivers.shared.options import BAUDS, PARITIES, Place, Reader, names_in, option

TABLES = ("holding", "input", "coil", "discrete")
BIT_TABLES = ("coil", "discrete")
TYPES = {"int16": ("h", 1), "uint16": ("H", 1), "int32": ("i", 2), "uint32": ("I", 2), "float32": ("f", 2)}
"""Type -> its format for `struct`, and its number of registers."""
READ = {"holding": 3, "input": 4, "coil": 1, "discrete": 2}
"""Table -> the function code that reads it."""
MOST_WORDS = 125
"""Largest number of registers read in one transaction."""
MOST_BITS = 2000


@dataclass(frozen=True)
class Register:
    """One value of the device: its address and format. `type` is `bit` in coils and discrete inputs."""

    name: str
    table: str
    address: int
    """Address on the line, counted from 0."""
    type: str = "uint16"
    low_word_first: bool = False
    bit: int = -1
    """Bit of a register (0: the lowest); -1: the whole register."""
    length: int = 0
    """Number of registers of a text."""
    expect: float | None = None
    """Required value when the device is opened."""

    @property
    def is_bit(self) -> bool:
        """Whether it is in a table of single bits."""
        return self.table in BIT_TABLES

    @property
    def count(self) -> int:
        """Number of its registers (or bits)."""
        return 1 if self.is_bit else self.length if self.type == "text" else TYPES[self.type][1]


@dataclass(frozen=True)
class WatchdogRegisters:
    """Registers of the device's own watchdog: a time, a trigger or none, and a heartbeat or none."""

    timeout: Register = Register("timeout", "holding", 0)
    resolution: float = option(Reader.quantity, "time", 1e-3, 1e-6, 60.0)
    """Time of one count [s]."""
    trigger: Register | None = None
    on: float = 1.0
    off: float = 0.0
    heartbeat: Register | None = None
    """Written with a new number at each feeding; None: any communication feeds it."""


@dataclass(frozen=True)
class RegisterMap:
    """Description of one kind of device."""

    unit_id: int = option(Reader.whole, 0, 255, 1)
    timeout: float = option(Reader.quantity, "time", 0.1, 0.002, 0.2)
    """Longest wait for an answer [s]."""
    slowest: float = option(Reader.quantity, "time", 1.0, 0.0, 10.0)
    """Longest time after which the device may still answer an old request [s]; matters on serial lines."""
    rate: float = option(Reader.quantity, "frequency", 100.0, 0.1, 1000.0)
    """Highest rate at which the device is polled [Hz]."""
    write_single: bool = option(Reader.flag, default=True)
    """Whether the device has the functions that write a single register or coil, 5 and 6."""
    identity: Mapping[str, Register | str] = field(default_factory=dict)
    inputs: Mapping[str, Register] = field(default_factory=dict)
    outputs: Mapping[str, Register] = field(default_factory=dict)
    watchdog: WatchdogRegisters | None = None
    uptime: Register | None = None
    """A number that only increases until the device restarts."""


def decode(register: Register, words: Sequence[int]) -> float:
    """The number in `words` (each 0..65535), or the selected bit; for texts see `decode_text`."""
    if not register.is_bit and len(words) != register.count:
        raise ValueError(f"{register.type} takes {register.count} registers, not {len(words)}")
    return decoder(register)(words)


def decoder(register: Register) -> Callable[[Sequence[int]], float]:
    """Decoding function for the words of one register, for repeated reading."""
    if register.is_bit:
        return lambda words: float(bool(words[0]))
    code, count = TYPES[register.type]
    pack = struct.Struct(f">{count}H").pack
    unpack, turned, bit = struct.Struct(f">{code}").unpack, register.low_word_first, register.bit

    def number(words: Sequence[int]) -> float:
        value = unpack(pack(*(words[::-1] if turned else words)))[0]
        return float((value >> bit) & 1) if bit >= 0 else float(value)

    return number


def decode_text(words: Iterable[int]) -> str:
    """Two characters a register, up to the first zero; printable ones only."""
    data = b"".join(word.to_bytes(2, "big") for word in words).split(b"\0", 1)[0]
    return "".join(chr(byte) for byte in data if 32 <= byte < 127).strip()


def encode(register: Register, value: float) -> list[int]:
    """The words of a number, rounded for integer types; raises ValueError if it does not fit or is not finite."""
    if not math.isfinite(value):
        raise ValueError(f"{value} cannot be commanded")
    if register.is_bit:
        if value not in {0.0, 1.0}:
            raise ValueError(f"{value:g} is neither 0 nor 1")
        return [int(value)]
    code, _count = TYPES[register.type]
    try:
        data = struct.pack(f">{code}", value if code == "f" else round(value))
    except (struct.error, OverflowError):
        raise ValueError(f"{value:g} does not fit {register.type}") from None
    words = [int.from_bytes(data[i : i + 2], "big") for i in range(0, len(data), 2)]
    return words[::-1] if register.low_word_first else words


@dataclass(frozen=True)
class Span:
    """Neighbouring registers of one table, read in one transaction."""

    table: str
    address: int
    count: int
    registers: tuple[Register, ...]

    def values(self, words: Sequence[int]) -> list[float]:
        """The number of each register."""
        return [number(words[first:last]) for first, last, number in self._decoders]

    @cached_property
    def _decoders(self) -> list[tuple[int, int, Callable[[Sequence[int]], float]]]:
        places = [(register, register.address - self.address) for register in self.registers]
        return [(first, first + register.count, decoder(register)) for register, first in places]


def spans(registers: Iterable[Register]) -> list[Span]:
    """The fewest transactions that read the registers without any address outside the map."""
    found: list[Span] = []
    for register in sorted(set(registers), key=lambda r: (r.table, r.address, r.count)):
        last = found[-1] if found else None
        end = register.address + register.count
        most = MOST_BITS if register.is_bit else MOST_WORDS
        if (
            last is not None
            and last.table == register.table
            and register.address <= last.address + last.count
            and end - last.address <= most
        ):
            found[-1] = Span(last.table, last.address, max(last.count, end - last.address), (*last.registers, register))
        else:
            found.append(Span(register.table, register.address, register.count, (register,)))
    return found


IDENTITY = ("maker", "model", "serial", "firmware", "constant")
REGISTER_KEYS = ("table", "address", "type", "words", "bit", "length", "expect")
MAP_KEYS = ("schema", "name", "source", "words", "identity", "inputs", "outputs", "watchdog", "uptime")
UPTIMES = ("uint32", "int32")
"""Types of a number that only increases until a restart."""
HIGH, LOW = "high-first", "low-first"


@dataclass(frozen=True)
class Mapped:
    """Options of a device that has a map."""

    map: RegisterMap = field(default_factory=RegisterMap)
    rate: float = 100.0
    """Highest rate at which the device is polled [Hz]."""


@dataclass(frozen=True)
class Options(Mapped):
    """Options of the driver `modbus` for a device."""

    baud: int = option(Reader.one_of, BAUDS, 19200)
    parity: str = option(Reader.mapped, PARITIES, "none")
    stop_bits: int = option(Reader.whole, 1, 2, 1)


def read_options(device: DeviceRecord, reader: Reader) -> Mapped:
    """Options of a device; also checks the names that its channels, outputs, valves and interlocks use."""
    options, given = reader.options(Options, device.options, ("options",), ("map",), ("map",))
    if not device.address.startswith("/"):
        reader.host(device, "192.168.0.10:502", other=' or the path of a serial port ("/dev/ttyUSB0")')
    map_ = _read_map(given.get("map", {}), ("options", "map"), reader)
    if map_.inputs or map_.outputs:
        _names(device, map_, reader)
    return replace(options, map=map_, rate=map_.rate)


def _read_map(data: Any, place: Place, reader: Reader) -> RegisterMap:
    needed = ("inputs",) if "outputs" not in (data or {}) else ()
    plain, given = reader.options(RegisterMap, data, place, MAP_KEYS, needed)
    reader.choice(given, "schema", place, ("pmabench.registers/1",), "pmabench.registers/1")
    for key in ("name", "source"):
        reader.text(given, key, place, longest=400)
    words = reader.choice(given, "words", place, (HIGH, LOW), HIGH)

    def registers(key: str, items: Mapping[str, Any]) -> dict[str, Any]:
        return {name: _register(name, item, (*place, key, name), reader, words, key) for name, item in items.items()}

    def named(key: str) -> dict[str, Register]:
        return registers(key, reader.named(given.get(key, {}), (*place, key)))

    said = reader.keys(given.get("identity", {}), (*place, "identity"), IDENTITY)
    asked = registers("identity", {name: item for name, item in said.items() if not isinstance(item, str)})
    watchdog, uptime = given.get("watchdog"), None
    if "uptime" in given:
        uptime = _register("uptime", given["uptime"], (*place, "uptime"), reader, words, "uptime")
    return replace(
        plain,
        identity={**said, **asked},
        inputs=named("inputs"),
        outputs=named("outputs"),
        watchdog=None if watchdog is None else _watchdog(watchdog, (*place, "watchdog"), reader, words),
        uptime=uptime,
    )


def _register(name: str, data: Any, place: Place, reader: Reader, usual: str, use: str) -> Register:
    """One register; `usual`: its order of words; `use` is `inputs`, `outputs`, `identity` or `uptime`."""
    given = reader.keys(data, place, REGISTER_KEYS, ("address",))
    writes = use == "outputs"
    tables = ("holding", "coil") if writes else TABLES
    table = reader.choice(given, "table", place, tables, "holding")
    single = table in BIT_TABLES
    types = ("bit",) if single else (*TYPES, "text") if use == "identity" else tuple(TYPES)
    kind = reader.choice(given, "type", place, types, "bit" if single else "uint16")
    words = reader.choice(given, "words", place, (HIGH, LOW), usual) == LOW
    bit = reader.whole(given, "bit", place, 0, 31, 0) if "bit" in given else -1
    if bit >= 0 and (single or writes or kind not in {"uint16", "uint32"} or bit >= 16 * TYPES[kind][1]):
        reader.fault((*place, "bit"), "only an input register of type uint16 or uint32 has bits that are read")
        bit = -1
    length = reader.whole(given, "length", place, 1, 60, 1) if kind == "text" else 0
    if kind != "text" and "length" in given:
        reader.fault((*place, "length"), "only a text has a length; numbers have that of their type")
    address, expect = reader.whole(given, "address", place, 0, 65535), reader.number(given, "expect", place)
    register = Register(name, table, address, kind, words, bit, length, expect)
    if use == "uptime" and register.type not in UPTIMES:
        why = "one of 16 bits soon begins again at 0, which would be taken for a restart"
        reader.fault((*place, "type"), f"a number that only grows needs 32 bits ({', '.join(UPTIMES)}): {why}")
    if register.expect is not None and use != "identity":
        reader.fault((*place, "expect"), 'belongs to a register of "identity"')
    if register.address + register.count > 65536:
        reader.fault((*place, "address"), "the value would reach beyond address 65535")
    return register


def _watchdog(data: Any, place: Place, reader: Reader, usual: str) -> WatchdogRegisters:
    more = ("timeout", "trigger", "on", "off", "heartbeat")
    plain, given = reader.options(WatchdogRegisters, data, place, more, ("timeout",))

    def register(key: str) -> Register:
        return _register(key, given.get(key, {}), (*place, key), reader, usual, "outputs")

    on, off = reader.number(given, "on", place), reader.number(given, "off", place)
    trigger = register("trigger") if "trigger" in given else None
    for key, value in (("on", on), ("off", off)):
        if value is None:
            continue
        if trigger is None:
            reader.fault((*place, key), 'is what is written to "trigger", and there is none')
            continue
        try:
            encode(trigger, value)
        except ValueError as error:
            reader.fault((*place, key), str(error))
    return replace(
        plain,
        timeout=register("timeout"),
        trigger=trigger,
        on=1.0 if on is None else on,
        off=0.0 if off is None else off,
        heartbeat=register("heartbeat") if "heartbeat" in given else None,
    )


def _names(device: DeviceRecord, map_: RegisterMap, reader: Reader) -> None:
    """Check that everything the bench uses is in the map, and fits.

    No two channels or outputs share a register, whatever its names in the map: that would be a copied line.
    """
    used: dict[tuple[Any, ...], str] = {}
    for kind, place, at in names_in(device):
        group, known = place[0], map_.inputs if place[-1] == "input" else map_.outputs
        if not reader.known(place, f"the map has no {place[-1]}", at, known) or kind == "digital input":
            continue
        register = known[at]
        first = used.setdefault((group, register.table, register.address, register.bit), at)
        if first != at:
            reader.fault(place, f'is the register of "{first}" in the map, too')
    for channel in device.channels:
        if channel.raw_type == "int32" and channel.input in map_.inputs:
            place = ("channels", channel.name, "input")
            if map_.inputs[channel.input].type == "float32":
                reader.fault(place, "gives numbers with a fraction, not counts; name the unit that the device gives")
            elif max(map(abs, _ends(channel.scale, channel))) >= 2**31:
                reader.fault(place, "counts from 2147483648 on cannot be recorded")
    for output in device.outputs:
        if output.output in map_.outputs:
            _fits(output, map_.outputs[output.output], ("outputs", output.name, "output"), reader)
    if device.watchdog and map_.watchdog is None:
        reader.fault(("watchdog",), 'the bench wants a watchdog, and the map has no "watchdog"')


def _fits(output: OutputRecord, register: Register, place: Place, reader: Reader) -> None:
    """Check that a register can hold every value that may be commanded."""
    if register.is_bit:
        reader.fault(place, "is a coil, which takes no values")
        return
    try:
        for value in (output.low, output.high, output.safe):
            encode(register, float(output.scale.to_raw(value)))
    except ValueError as error:
        reader.fault(place, f"cannot be commanded over its whole range: {error}")


def _ends(scale: Any, channel: Any) -> tuple[float, float]:
    ends = float(scale.to_raw(channel.low)), float(scale.to_raw(channel.high))
    return ends if all(map(math.isfinite, ends)) else (0.0, 0.0)


def map_schema() -> dict[str, Any]:
    """The JSON Schema of a register map; a test compares it with the keys read here."""
    schema: dict[str, Any] = json.loads(files(__package__).joinpath("registers.schema.json").read_text("utf-8"))
    return schema
