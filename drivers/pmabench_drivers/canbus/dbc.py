"""Messages and signals of a DBC file, and their values out of a frame; knows no bus. Standard library only.

Read are messages (`BO_`), signals (`SG_`), value types (`SIG_VALTYPE_`) and cycle times (`GenMsgCycleTime`). Signals
that are multiplexed are left out, and so not known here.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

MOST = 2_000_000
"""Longest text that is read [characters]."""
EXTENDED = 1 << 31
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_MESSAGE = re.compile(r"^BO_ (\d+) (\w+) *: *(\d+) ")
_SIGNAL = re.compile(
    rf'^\s+SG_ (\w+) *(M|m\d+M?)? *: *(\d+)\|(\d+)@([01])([+-]) *\(({_NUMBER}),({_NUMBER})\) *\[[^\]]*\] *"([^"]*)"'
)
_KIND = re.compile(r"^SIG_VALTYPE_ (\d+) (\w+) *: *([0-3]) *;")
_CYCLE = re.compile(r'^BA_ "GenMsgCycleTime" BO_ (\d+) (\d+) *;')


class NoDatabase(ValueError):
    """The text cannot be used; says why."""


@dataclass(frozen=True)
class Signal:
    """One signal: where its bits are, and the value that they mean."""

    name: str
    start: int
    """Number of its least significant bit, or with `big` of its most significant one, as the file counts them."""
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
        places = range(first + self.length - 1, first - 1, -1)
        return tuple(8 * (place // 8) + 7 - place % 8 for place in places)

    def value(self, data: bytes) -> float:
        """The physical value; IndexError where the frame is too short."""
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
        """The frame with this value in it, as near as the bits can say it."""
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
    """One message and its signals that are not multiplexed."""

    name: str
    identifier: int
    length: int
    extended: bool = False
    cycle: float = 0.0
    """How often it is sent [s]; 0: not said."""
    signals: Mapping[str, Signal] = field(default_factory=dict)


def read_dbc(text: str) -> dict[str, Message]:
    """The messages of a DBC file by their names; raises NoDatabase."""
    if len(text) > MOST:
        raise NoDatabase(f"has {len(text)} characters, and at most {MOST} are read")
    messages: dict[int, Message] = {}
    current = -1
    for number, line in enumerate(text.splitlines(), 1):
        if found := _MESSAGE.match(line):
            current = _whole(found[1], number)
            if current in messages:
                raise NoDatabase(f"line {number}: the message {current} is there twice")
            extended, length = bool(current & EXTENDED), _whole(found[3], number)
            if length > 8 or (current & ~EXTENDED) >= 1 << (29 if extended else 11):
                current = -1  # CAN FD, or a place for signals of no message
                continue
            messages[current] = Message(found[2], current & ~EXTENDED, length, extended)
        elif line.lstrip().startswith("SG_ ") and current in messages:
            message = messages[current]
            signal = _signal(line, message, number)
            if signal is not None:
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
    found = _SIGNAL.match(line)
    if found is None:
        raise NoDatabase(f"line {number}: no signal can be read: {line.strip()[:60]!r}")
    start, length = _whole(found[3], number), _whole(found[4], number)
    if found[2] not in {None, "M"}:
        return None
    signal = Signal(
        found[1], start, length, found[5] == "0", found[6] == "-", float(found[7]), float(found[8]), found[9]
    )
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
