"""Registers as records, and the way between their 16-bit words and numbers; knows no connection. Standard library only.

The specification (Modbus Application Protocol 1.1b3) fixes the order of the two bytes of a register and leaves the
order of the registers of a 32-bit value to the maker, hence `low_word_first` and `low_byte_first`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

TABLES = ("holding", "input", "coil", "discrete")
BIT_TABLES = ("coil", "discrete")
TYPES = {"int16": ("h", 1), "uint16": ("H", 1), "int32": ("i", 2), "uint32": ("I", 2), "float32": ("f", 2)}
"""Type -> how `struct` writes it, and its number of registers."""
READ = {"holding": 3, "input": 4, "coil": 1, "discrete": 2}
"""Table -> the function code that reads it."""
FUNCTIONS = (1, 2, 3, 4, 5, 6, 15, 16)
MOST_WORDS = 125
"""Registers that one transaction can read."""
MOST_BITS = 2000


@dataclass(frozen=True)
class Register:
    """One value of the device: where it is and how it is written. `type` is `bit` in coils and discrete inputs."""

    name: str
    table: str
    address: int
    """As on the wire, counted from 0."""
    type: str = "uint16"
    low_word_first: bool = False
    low_byte_first: bool = False
    bit: int = -1
    """The bit of a register that is meant (0: the lowest); -1: the whole."""
    length: int = 0
    """Registers of a text."""
    read_back: bool = True
    """Whether a written value can be read again."""
    expect: float | None = None
    """What it must hold when the device is opened."""

    @property
    def is_bit(self) -> bool:
        """Whether it is in a table of single bits."""
        return self.table in BIT_TABLES

    @property
    def count(self) -> int:
        """Registers (or bits) that it takes."""
        return 1 if self.is_bit else self.length if self.type == "text" else TYPES[self.type][1]


@dataclass(frozen=True)
class WatchdogRegisters:
    """How the device's own watchdog is set: a time, a trigger or none, and what feeds it."""

    timeout: Register
    resolution: float
    """Time of one count [s]."""
    trigger: Register | None = None
    on: float = 1.0
    off: float = 0.0
    heartbeat: Register | None = None
    """Written with a new number at each feeding; None: any communication feeds it."""


@dataclass(frozen=True)
class RegisterMap:
    """Everything that is known of one kind of device."""

    unit_id: int = 1
    timeout: float = 0.1
    """Longest wait for an answer [s]."""
    slowest: float = 1.0
    """Longest time after which the device may still answer an old question [s]; matters on serial lines."""
    rate: float = 100.0
    """Highest rate at which the device is polled [Hz]."""
    functions: tuple[int, ...] = FUNCTIONS
    identity: Mapping[str, Register | str] = field(default_factory=dict)
    inputs: Mapping[str, Register] = field(default_factory=dict)
    outputs: Mapping[str, Register] = field(default_factory=dict)
    watchdog: WatchdogRegisters | None = None
    uptime: Register | None = None
    """A number that only grows until the device restarts."""


def decode(register: Register, words: Sequence[int]) -> float:
    """The number in `words` (each 0..65535), or the bit that is meant; texts by `decode_text`."""
    if not register.is_bit and len(words) != register.count:
        raise ValueError(f"{register.type} takes {register.count} registers, not {len(words)}")
    return decoder(register)(words)


def decoder(register: Register) -> Callable[[Sequence[int]], float]:
    """What decodes the words of one register, made once for a register that is read again and again."""
    if register.is_bit:
        return lambda words: float(bool(words[0]))
    code, count = TYPES[register.type]
    pack = struct.Struct(f"{'<' if register.low_byte_first else '>'}{count}H").pack
    unpack, turned, bit = struct.Struct(f">{code}").unpack, register.low_word_first, register.bit

    def number(words: Sequence[int]) -> float:
        value = unpack(pack(*(words[::-1] if turned else words)))[0]
        return float((value >> bit) & 1) if bit >= 0 else float(value)

    return number


def decode_text(words: Iterable[int]) -> str:
    """Two characters a register, up to the first zero; only what can be printed."""
    data = b"".join(word.to_bytes(2, "big") for word in words).split(b"\0", 1)[0]
    return "".join(chr(byte) for byte in data if 32 <= byte < 127).strip()


def encode(register: Register, value: float) -> list[int]:
    """The words of a number, whole where the register is; ValueError where it does not fit, or is no number."""
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
    words = [
        int.from_bytes(data[i : i + 2], "little" if register.low_byte_first else "big") for i in range(0, len(data), 2)
    ]
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
    """The fewest transactions that read the registers without touching any address that is not in the map."""
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
            count = max(last.count, end - last.address)
            found[-1] = Span(last.table, last.address, count, (*last.registers, register))
        else:
            found.append(Span(register.table, register.address, register.count, (register,)))
    return found
