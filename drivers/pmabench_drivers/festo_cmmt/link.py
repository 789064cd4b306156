"""The connection to a CMMT: process data, registers, and the mailbox of its parameters. Imported by `open`."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from time import monotonic, sleep

from pmabench.base.errors import DeviceError
from pmabench_drivers.festo_cmmt import telegram as t
from pmabench_drivers.modbus.adapter import NamedLine
from pmabench_drivers.modbus.registers import Register, decode, encode
from pmabench_drivers.shared.link import Still, Unanswered, always

ANSWER = 0.1
"""Longest wait for one answer [s]."""
LOOK = 0.003
"""Pause between two reads of the mailbox [s]."""


class DriveLink(NamedLine):
    """One connection, used by any thread; every call ends by `until` [s, monotonic]."""

    def __init__(self, device: str, address: str) -> None:
        super().__init__(device, address, ANSWER)
        self._mailbox = threading.Lock()

    def look(self, until: float) -> t.Status:
        """Present state of the drive."""
        return t.Status.of(self.read_again(t.PROCESS_IN, t.SIZE, until, "process data"))

    def look_once(self, until: float) -> t.Status:
        """Present state in a single transaction, whose time is known."""
        return t.Status.of(self.read("holding", t.PROCESS_IN, t.SIZE, until, "process data"))

    def send(self, words: Sequence[int], until: float, still: Still = always) -> None:
        """Write process data once, unless `still()` is false by the time the line is free."""
        self.write(16, t.PROCESS_OUT, words, until, "process data", still)

    def get(self, register: Register, until: float) -> float:
        """The value of a register."""
        return decode(register, self.read_again(register.address, register.count, until, register.name))

    def put(self, register: Register, value: float, until: float, *, checked: bool = True) -> None:
        """Write once and read back; the value held decides, even if the answer was lost."""
        with suppress(Unanswered):
            self.write(16, register.address, encode(register, value), until, register.name)
        held = self.get(register, until)
        if checked and held != value:
            raise DeviceError(self._device, f"was given {value:g} and holds {held:g}", register.name)

    def parameter(self, number: int, kind: str, until: float) -> float:
        """The value of a parameter; `kind` is a type of registers, or `int8`."""
        what = f"parameter {number}"
        words, size = self._fetch(number, until)
        register = Register(what, "holding", t.DATA, "uint16" if kind == "int8" else kind, low_word_first=True)
        if size == 0:
            raise DeviceError(self._device, f"does not give its value (mailbox state {t.FAILED})", what)
        if size != (1 if kind == "int8" else 2 * register.count):
            raise DeviceError(self._device, f"has {size} bytes, where {kind} was expected", what)
        value = decode(register, words)
        return float((int(value) & 0xFF ^ 0x80) - 0x80) if kind == "int8" else value

    def text(self, number: int, until: float) -> str:
        """A text parameter; empty if the drive has none."""
        words, size = self._fetch(number, until)
        data = b"".join(word.to_bytes(2, "little") for word in words)[:size]
        return "".join(chr(byte) for byte in data.split(b"\0")[0] if 32 <= byte < 127).strip()

    def _fetch(self, number: int, until: float) -> tuple[list[int], int]:
        """Registers and size [bytes] of a parameter, through the mailbox; empty if the drive refuses it."""
        what = f"parameter {number}"
        with self._mailbox:
            for address, word in ((t.NUMBER, number), (t.SUBINDEX, 0), (t.ELEMENTS, 1), (t.EXECUTE, t.READ)):
                self.write(6, address, [word], until, what)
            while (state := self.read("holding", t.EXECUTE, 1, until, what)[0]) != t.DONE:
                if state == t.FAILED:
                    return [], 0
                if monotonic() > until - LOOK:
                    raise DeviceError(self._device, f"does not give its value (mailbox state {state})", what)
                sleep(LOOK)
            [size] = self.read("holding", t.LENGTH, 1, until, what)
            if not 0 < size <= t.LONGEST_TEXT:
                raise DeviceError(self._device, f"has {size} bytes, which is no value that is read here", what)
            return self.read("holding", t.DATA, (size + 1) // 2, until, what), size
