"""Options of a CAN bus, read strictly; messages and signals of a DBC file. Standard library only.

Messages (`BO_`), signals (`SG_`), value types (`SIG_VALTYPE_`) and cycle times (`GenMsgCycleTime`) are read.
Multiplexed signals are left out, so they are unknown here.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from pmabench.bench.interface import DeviceRecord, OutputRecord
from pmabench_drivers.canbus.link import INTERFACES, NUMBERED, RATES
from pmabench_drivers.shared.options import Place, Reader, option

MOST = 2_000_000
"""Longest text accepted [characters]."""
EXTENDED = 1 << 31
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_MESSAGE = re.compile(r"^BO_ (\d+) (\w+) *: *(\d+) ")
_SIGNAL = re.compile(
    rf'^\s+SG_ (\w+) *(M|m\d+M?)? *: *(\d+)\|(\d+)@([01])([+-]) *\(({_NUMBER}),({_NUMBER})\) *\[[^\]]*\] *"([^"]*)"'
)
_KIND = re.compile(r"^SIG_VALTYPE_ (\d+) (\w+) *: *([0-3]) *;")
_CYCLE = re.compile(r'^BA_ "GenMsgCycleTime" BO_ (\d+) (\d+) *;')
PROFILES = (402, 406)
DRIVE, TRANSDUCER = ("position", "demand"), ("position",)
"""Inputs of a drive and of a transducer, after its name and a dot."""
READY = "ready"
"""Digital input of a drive: high while it has no fault."""


class NoDatabase(ValueError):
    """The text cannot be used; states why."""


@dataclass(frozen=True)
class Signal:
    """One signal: position of its bits, and conversion to a value."""

    name: str
    start: int
    """Number of its least significant bit, or with `big` of its most significant one, as counted in the file."""
    length: int
    big: bool = False
    """Motorola byte order."""
    signed: bool = False
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    kind: str = "int"
    """`int`, `float` or `double`."""

    @property
    def bits(self) -> tuple[int, ...]:
        """Numbers of its bits in the frame (8 * byte + bit), least significant first."""
        if not self.big:
            return tuple(range(self.start, self.start + self.length))
        first = (self.start // 8) * 8 + 7 - self.start % 8
        return tuple(8 * (place // 8) + 7 - place % 8 for place in range(first + self.length - 1, first - 1, -1))

    def value(self, data: bytes) -> float:
        """Physical value; IndexError if the frame is too short."""
        whole = int.from_bytes(data, "little")
        if max(self.bits) >= 8 * len(data):
            raise IndexError(f"{len(data)} bytes are too few for {self.name}")
        raw = sum((whole >> bit & 1) << place for place, bit in enumerate(self.bits))
        if self.kind != "int":
            raw_bytes = raw.to_bytes(self.length // 8, "little")
            [number] = struct.unpack("<f" if self.kind == "float" else "<d", raw_bytes)
            return float(number) * self.factor + self.offset
        if self.signed and raw >> (self.length - 1):
            raw -= 1 << self.length
        return raw * self.factor + self.offset

    def put(self, data: bytes, value: float) -> bytes:
        """The frame with this value in it, rounded to the signal's resolution."""
        number = (value - self.offset) / self.factor
        if self.kind != "int":
            raw = int.from_bytes(struct.pack("<f" if self.kind == "float" else "<d", number), "little")
        else:
            low, high = (
                (-(1 << self.length - 1), (1 << self.length - 1) - 1) if self.signed else (0, 2**self.length - 1)
            )
            raw = min(max(round(number), low), high) & (2**self.length - 1)
        whole = int.from_bytes(data, "little")
        for place, bit in enumerate(self.bits):
            whole = whole & ~(1 << bit) | (raw >> place & 1) << bit
        return whole.to_bytes(len(data), "little")


@dataclass(frozen=True)
class Message:
    """One message and its signals, without multiplexed ones."""

    name: str
    identifier: int
    length: int
    extended: bool = False
    cycle: float = 0.0
    """Sending interval [s]; 0: not stated."""
    signals: Mapping[str, Signal] = field(default_factory=dict)


def read_dbc(text: str) -> dict[str, Message]:
    """Messages of a DBC file by name; raises NoDatabase."""
    if len(text) > MOST:
        raise NoDatabase(f"has {len(text)} characters, and at most {MOST} are read")
    messages: dict[int, Message] = {}
    current = -1
    for number, line in enumerate(text.splitlines(), 1):
        if found := _MESSAGE.match(line):
            if (current := _whole(found[1], number)) in messages:
                raise NoDatabase(f"line {number}: the message {current} is there twice")
            extended, length = bool(current & EXTENDED), _whole(found[3], number)
            if length > 8 or (current & ~EXTENDED) >= 1 << (29 if extended else 11):
                current = -1  # CAN FD, or the placeholder for signals without a message
                continue
            messages[current] = Message(found[2], current & ~EXTENDED, length, extended)
        elif line.lstrip().startswith("SG_ ") and current in messages:
            message = messages[current]
            if (signal := _signal(line, message, number)) is not None:
                messages[current] = replace(message, signals={**message.signals, signal.name: signal})
        elif line.startswith("BO_ "):
            raise NoDatabase(f"line {number}: no message can be read: {line[:60]!r}")
        elif found := _KIND.match(line):
            _set_kind(messages, _whole(found[1], number), found[2], int(found[3]), number)
        elif (found := _CYCLE.match(line)) and (key := _whole(found[1], number)) in messages:
            messages[key] = replace(messages[key], cycle=_whole(found[2], number) * 1e-3)
    if not messages:
        raise NoDatabase('has no message ("BO_ 500 LoadCell: 8 Vector__XXX")')
    return {message.name: message for message in messages.values()}


def _whole(text: str, line: int) -> int:
    if len(text) > 10:
        raise NoDatabase(f"line {line}: the number {text[:20]} is too long")
    return int(text)


def _signal(line: str, message: Message, number: int) -> Signal | None:
    if (found := _SIGNAL.match(line)) is None:
        raise NoDatabase(f"line {number}: no signal can be read: {line.strip()[:60]!r}")
    start, length = _whole(found[3], number), _whole(found[4], number)
    if found[2] not in {None, "M"}:
        return None
    factor, offset = float(found[7]), float(found[8])
    signal = Signal(found[1], start, length, found[5] == "0", found[6] == "-", factor, offset, found[9])
    inside = 0 < length <= 64 and 0 <= start < 64
    if not inside or min(signal.bits) < 0 or max(signal.bits) >= 8 * message.length:
        raise NoDatabase(f"line {number}: the signal {signal.name} is longer than its message")
    if not 0 < abs(signal.factor) < float("inf") or abs(signal.offset) == float("inf"):
        raise NoDatabase(f"line {number}: the signal {signal.name} has a factor of {signal.factor:g}")
    return signal


def _set_kind(messages: dict[int, Message], key: int, name: str, kind: int, line: int) -> None:
    message = messages.get(key)
    if message is None or name not in message.signals or kind == 0:
        return
    signal, wanted = message.signals[name], {1: ("float", 32), 2: ("double", 64)}.get(kind)
    if wanted is None or signal.length != wanted[1]:
        raise NoDatabase(f"line {line}: the signal {name} has {signal.length} bits, which is no floating-point number")
    messages[key] = replace(message, signals={**message.signals, name: replace(signal, kind=wanted[0])})


@dataclass(frozen=True)
class NodeOptions:
    """One CANopen node."""

    profile: int
    number: int
    approach: float = 0.0
    """Speed of a drive to a plain set-point [m/s]."""


@dataclass(frozen=True)
class Options:
    """Options of one bus."""

    bitrate: int = option(Reader.one_of, tuple(RATES), 500_000)
    sync: float = option(Reader.quantity, "time", 0.01, 0.002, 0.1)
    """Time between two SYNCs [s]."""
    own_node: int = option(Reader.whole, 1, 127, 127)
    """Node number under which the program itself sends its heartbeat."""
    slowest: float = option(Reader.quantity, "time", 0.1, 0.005, 10.0)
    """Largest age of a signal [s]."""
    nodes: Mapping[str, NodeOptions] = field(default_factory=dict)
    messages: Mapping[str, Message] = field(default_factory=dict)

    def signal(self, name: str) -> tuple[Message, Signal] | None:
        """Message and signal `MESSAGE.SIGNAL`; None if unknown."""
        message_name, _, signal_name = name.partition(".")
        message = self.messages.get(message_name)
        signal = message.signals.get(signal_name) if message is not None else None
        return None if message is None or signal is None else (message, signal)

    def inputs(self) -> list[str]:
        """Names of all inputs that a channel may use."""
        known = [
            f"{name}.{what}"
            for name, node in self.nodes.items()
            for what in (DRIVE if node.profile == 402 else TRANSDUCER)
        ]
        return known + [f"{m.name}.{signal}" for m in self.messages.values() for signal in m.signals]


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """Options of a device; also checks the names that its channels, outputs and interlocks use."""
    here: Place = ("options",)
    plain, given = reader.options(Options, device.options, here, ("nodes", "dbc"))
    _address(device.address, reader)
    sync = plain.sync
    if abs(sync * 1e4 - round(sync * 1e4)) > 1e-6 or (round(sync * 1e4) > 255 and round(sync * 1e4) % 10):
        reader.fault((*here, "sync"), "whole tenths of a millisecond, and above 25.5 ms whole milliseconds, are needed")
    options = replace(plain, nodes=_nodes(given, plain.own_node, reader), messages=_messages(given, reader))
    if not options.nodes and not options.messages and not reader.problems:
        reader.fault(here, '"nodes" or "dbc" is needed: a bus without either measures nothing')
    _names(device, options, reader)
    return options


def _address(address: str, reader: Reader) -> None:
    interface, colon, channel = address.partition(":")
    wanted = 'INTERFACE:CHANNEL is expected, for instance "socketcan:can0" or "slcan:/dev/ttyACM0"'
    if interface not in INTERFACES or not colon or not channel:
        reader.fault(("address",), f'{wanted}; interfaces: {", ".join(INTERFACES)}; not "{address}"')
    elif interface in NUMBERED and not channel.isdecimal():
        reader.fault(("address",), f'{interface} needs the number of its channel, for instance "{interface}:0"')
    elif "://" in channel and not re.fullmatch(r"socket://[A-Za-z0-9.-]+:\d{1,5}", channel):
        reader.fault(("address",), f'a serial adapter behind TCP is "slcan:socket://HOST:PORT", not "{address}"')


def _nodes(given: Mapping[str, Any], own: int, reader: Reader) -> dict[str, NodeOptions]:
    place: Place = ("options", "nodes")
    found: dict[str, NodeOptions] = {}
    for name, item in reader.named(given.get("nodes", {}), place).items():
        at = (*place, name)
        data = reader.keys(item, at, ("profile", "node", "approach"), ("profile", "node"))
        if (profile := data.get("profile")) not in PROFILES:
            reader.fault((*at, "profile"), f"402 (drive) or 406 (transducer) is expected, not {profile}")
            continue
        if (number := reader.whole(data, "node", at, 1, 127, 1)) == own:
            reader.fault((*at, "node"), f"{number} is the number of the program itself: change it, or own_node")
        if any(node.number == number for node in found.values()):
            reader.fault((*at, "node"), f"{number} is the number of two nodes")
        found[str(name)] = NodeOptions(profile, number, _approach(data, at, profile, reader))
    return found


def _approach(data: Mapping[str, Any], at: Place, profile: int, reader: Reader) -> float:
    if profile != 402:
        if "approach" in data:
            reader.fault((*at, "approach"), "only a drive (profile 402) moves")
        return 0.0
    if "approach" not in data:
        reader.fault(at, '"approach" is missing: the speed at which the drive goes to a set-point, such as "20 mm/s"')
        return 0.0
    return reader.quantity(data, "approach", at, "speed", 0.0, 1e-5, 10.0)


def _messages(given: Mapping[str, Any], reader: Reader) -> dict[str, Message]:
    if "dbc" not in given:
        return {}
    text = given["dbc"]
    if not isinstance(text, str):
        reader.fault(("options", "dbc"), "the name of a .dbc file next to the bench file is expected")
        return {}
    try:
        return read_dbc(text)
    except NoDatabase as error:
        reader.fault(("options", "dbc"), f"the DBC file {error}")
        return {}


def _names(device: DeviceRecord, options: Options, reader: Reader) -> None:
    known = options.inputs()
    for channel in device.channels:
        place: Place = ("channels", channel.name, "input")
        reader.known(place, "no input", channel.input, known, f"; known: {', '.join(known[:20]) or 'none'}")
    drives = {f"{name}.position": node for name, node in options.nodes.items() if node.profile == 402}
    for output in device.outputs:
        more = f"; known: {', '.join(drives) or 'none'}"
        if reader.known(("outputs", output.name, "output"), "no output", output.output, drives, more):
            _drive_output(output, drives[output.output], reader)
    for valve in device.valves:
        reader.fault(("outputs", valve.name, "output"), "nothing on this bus switches a valve")
    ready = [f"{name}.{READY}" for name, node in options.nodes.items() if node.profile == 402]
    for lock in device.interlocks:
        place = ("interlocks", lock.name, "input")
        reader.known(place, "no digital input", lock.input, ready, f"; known: {', '.join(ready)}")
    if device.watchdog and not device.outputs:
        reader.fault(("watchdog",), "only a drive stops by itself, and no output of this bus is one")
    if device.outputs and device.watchdog and not 0.05 <= device.watchdog <= 60:
        reader.fault(("watchdog",), "50 ms to 60 s are possible")


def _drive_output(output: OutputRecord, node: NodeOptions, reader: Reader) -> None:
    if output.quantity != "length":
        reader.fault(("outputs", output.name, "output"), "a drive is sent to a length, for instance of displacement")
    if not output.rate:
        message = "a drive needs the highest speed of the bench: actuator: {speed: 200 mm/s}"
        reader.fault(("outputs", output.name, "output"), message)
    elif node.approach > output.rate:
        shown = f"{1e3 * node.approach:g} mm/s"
        reader.fault(("options", "nodes"), f"approach: {shown} is above the bench's {1e3 * output.rate:g} mm/s")
    if output.resolution < 1 or output.resolution % 1:
        reader.fault(("outputs", output.name, "resolution"), "a drive counts in whole steps: 1 count")
