"""Objects of an emulated CANopen node, and the codes with which it refuses a transfer (CiA 301); knows no bus."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

TOGGLE, COMMAND = 0x05030000, 0x05040001
READ_ONLY, NO_OBJECT, NO_SUB = 0x06010002, 0x06020000, 0x06090011
UNMAPPABLE, TOO_MUCH = 0x06040041, 0x06040042
LONG, SHORT, VALUE = 0x06070012, 0x06070013, 0x06090030
STATE, NO_DATA = 0x08000022, 0x08000024
"""SDO abort codes."""


class Abort(Exception):
    """The node refuses a transfer, with this code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:08X}")
        self.code = code


@dataclass
class Entry:
    """One object: its `kind` is that of `struct`, or `s` for text."""

    kind: str
    value: int | bytes = 0
    writable: bool = False
    read: Callable[[], int] | None = None
    """Where its value comes from at each look, if it is no stored one."""
    written: Callable[[int], None] | None = None
    """Called with a new value before it is stored; raises Abort."""

    def __post_init__(self) -> None:
        self.power_on = self.value
        """Its value after a start."""

    def bytes(self) -> bytes:
        """The value as it goes over the wire."""
        value = self.read() if self.read is not None else self.value
        if isinstance(value, bytes):
            return value
        return struct.pack(f"<{self.kind}", value)
