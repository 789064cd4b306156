"""Which registers an emulated T7, T8 or T4 has, which of them belong together as one value, and function 76.

Source of addresses, types, access and defaults: LabJack's public register table (LabJack/ljm_constants, 2025.12.18). Of
the test register that table says that it, unlike others, can be read by single words: every other value is read and
written as a whole. Function 76: LabJack, Protocol Details (Direct Modbus TCP), Modbus Feedback.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from pmabench_drivers.emulator.modbus_server import VALUE, Refused, Request
from pmabench_drivers.labjack import registers as r

U16, U32, I32, F32 = "H", "I", "i", "f"
WORDS = {U16: 1, U32: 2, I32: 2, F32: 2}
FEEDBACK = 76
"""Function code: several reads and writes in one packet."""
MOST_BYTES = 1040
"""Largest packet over Ethernet."""


@dataclass(frozen=True)
class Value:
    """One value of the register table."""

    type: str
    access: str = "RW"
    default: float = 0.0

    @property
    def words(self) -> list[int]:
        """Its registers after power-on."""
        data = struct.pack(f">{self.type}", self.default if self.type == F32 else int(self.default))
        return list(struct.unpack(f">{WORDS[self.type]}H", data))


ROWS: tuple[tuple[int, int, Value], ...] = (
    (r.DAC, 2, Value(F32)),
    (r.DIO, len(r.LINES), Value(U16)),
    (r.STATES, 4, Value(U16)),
    (r.STATES_OF_TWO, 3, Value(U16)),
    (r.DIRECTIONS, 4, Value(U16)),
    (r.DIO_STATE, 1, Value(U32)),
    (r.DIO_DIRECTION, 1, Value(U32)),
    (r.DIO_INHIBIT, 1, Value(U32)),
    (r.STREAM_SCANRATE, 14, Value(U32)),
    (r.STREAM_SCANLIST, 128, Value(U32)),
    (r.STREAM_ENABLE, 1, Value(U32)),
    (r.LAST_ERR_DETAIL, 4, Value(U16, "R")),
    (r.TEST, 1, Value(U32, "R", r.TEST_VALUE)),
    (55110, 1, Value(U16, default=17)),
    (55120, 1, Value(U32, default=r.TEST_VALUE)),
    (55122, 1, Value(I32, default=-2003195205)),
    (r.TEST_FLOAT, 1, Value(F32, default=-9999.0)),
    (60000, 5, Value(F32, "R")),
    (60010, 1, Value(U32, "R")),
    (r.RESET_CAUSE, 1, Value(U32, "R")),
    (r.SERIAL_NUMBER, 1, Value(U32, "R")),
    (r.RTC_TIME, 1, Value(U32, "R")),
    (r.COUNTER_10KHZ, 1, Value(U32, "R")),
    (r.CORE_TIMER, 1, Value(U32, "R")),
    (r.WATCHDOG_ENABLE, 4, Value(U32)),
    (r.WATCHDOG_STRICT, 2, Value(U32)),
    (r.WATCHDOG_CLEAR, 1, Value(U32, "W")),
    (r.WATCHDOG_RESET, 1, Value(U32)),
    (r.WATCHDOG_DIO_ENABLE, 4, Value(U32)),
    *((first, 2, Value(U32)) for first in r.WATCHDOG_DAC_ENABLE),
    (r.FLASH_POINTER, 1, Value(U32)),
    (r.FLASH_READ, 13, Value(U32, "R")),
    (r.REBOOT, 1, Value(U32, "W")),
)
"""First address, how many of them, one after another, and what each is."""


def values_of(model: r.Model) -> dict[int, Value]:
    """First address -> value, of one model."""
    count = len(model.inputs)
    inputs = [
        (0, count, Value(F32, "R")),
        (r.AIN_RANGE, count, Value(F32)),
        (r.AIN_NEGATIVE, count, Value(U16, default=r.SINGLE_ENDED)),
        (r.AIN_RESOLUTION, count, Value(U16)),
        (r.AIN_SETTLING, count, Value(F32)),
        *([(r.CAPTURE, count, Value(F32, "R"))] if model.captures else []),
    ]
    return {
        first + index * WORDS[value.type]: value for first, many, value in (*inputs, *ROWS) for index in range(many)
    }


class Unknown(Exception):
    """There is no such register, or it does not allow this access."""


class Cut(Exception):
    """The request covers only a part of a value."""


def whole(values: dict[int, Value], address: int, count: int, access: str) -> Iterator[tuple[int, Value]]:
    """The values that the registers from an address on are; `Unknown`, or `Cut` for a part of one."""
    if access == "R" and (address, count) in {(r.TEST, 1), (r.TEST + 1, 1)}:
        return
    at, end = address, address + count
    while at < end:
        value = values.get(at)
        if value is None:
            before = values.get(at - 1)
            raise Cut if before is not None and WORDS[before.type] > 1 else Unknown
        if access not in value.access:
            raise Unknown
        if at + WORDS[value.type] > end:
            raise Cut
        yield at, value
        at += WORDS[value.type]


def feedback(pdu: bytes) -> list[Request]:
    """The reads and writes of a request of function 76, in their order; `Refused` where it is none."""
    found: list[Request] = []
    rest = pdu[1:]
    while rest:
        if len(rest) < 4 or rest[0] > 1 or not rest[3]:
            raise Refused(VALUE)
        kind, address, count = struct.unpack(">BHB", rest[:4])
        data, rest = (rest[4 : 4 + 2 * count], rest[4 + 2 * count :]) if kind else (b"", rest[4:])
        if len(data) != 2 * count * kind:
            raise Refused(VALUE)
        words = struct.unpack(f">{len(data) // 2}H", data)
        found.append(Request(16 if kind else 3, address, count, words))
    if not found:
        raise Refused(VALUE)
    return found
