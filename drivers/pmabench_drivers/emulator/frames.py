"""Modbus requests and answers as bytes, server side, by the specification; knows no registers and no socket.

Written apart from the driver's library, so that each is a check of the other. Layouts: Modbus Application Protocol
1.1b3, section 6; MBAP header: Modbus Messaging on TCP/IP 1.0b, section 3.1.3; CRC-16: Modbus over Serial Line 1.02,
section 6.2.2.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

READS = {1: "coil", 2: "discrete", 3: "holding", 4: "input"}
WRITES = {5: "coil", 6: "holding", 15: "coil", 16: "holding"}
FUNCTION, ADDRESS, VALUE = 1, 2, 3
"""Exception codes: no such function, no such address, a value or count that cannot be."""


@dataclass(frozen=True)
class Request:
    """A question: `values` is empty where it reads. `count` is the number of registers or bits."""

    function: int
    address: int
    count: int
    values: tuple[int, ...] = ()

    @property
    def table(self) -> str:
        """The table that it is about."""
        return READS.get(self.function) or WRITES[self.function]


class Refused(Exception):
    """The answer is an exception with this code."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"exception {code}")


def parse(pdu: bytes) -> Request:
    """A request without its header; `Refused` where the specification says so."""
    function = pdu[0]
    try:
        if function in READS:
            address, count = struct.unpack(">HH", pdu[1:])
            if not 1 <= count <= (2000 if function < 3 else 125):
                raise Refused(VALUE)
            return Request(function, address, count)
        if function == 5:
            address, value = struct.unpack(">HH", pdu[1:])
            if value not in {0, 0xFF00}:
                raise Refused(VALUE)
            return Request(function, address, 1, (int(value == 0xFF00),))
        if function == 6:
            address, value = struct.unpack(">HH", pdu[1:])
            return Request(function, address, 1, (value,))
        if function in {15, 16}:
            address, count, size = struct.unpack(">HHB", pdu[1:6])
            data = pdu[6:]
            needed = (count + 7) // 8 if function == 15 else 2 * count
            if not 1 <= count <= (1968 if function == 15 else 123) or size != needed or len(data) != size:
                raise Refused(VALUE)
            if function == 16:
                return Request(function, address, count, struct.unpack(f">{count}H", data))
            bits = tuple(data[i // 8] >> i % 8 & 1 for i in range(count))
            return Request(function, address, count, bits)
    except struct.error:
        raise Refused(VALUE) from None
    raise Refused(FUNCTION)


def answer(request: Request, values: Sequence[int]) -> bytes:
    """The answer to a request: what was read, or the echo of what was written."""
    head = bytes([request.function])
    if request.function in {3, 4}:
        return head + bytes([2 * len(values)]) + struct.pack(f">{len(values)}H", *values)
    if request.function in {1, 2}:
        data = bytearray((len(values) + 7) // 8)
        for i, value in enumerate(values):
            data[i // 8] |= (value & 1) << i % 8
        return head + bytes([len(data)]) + bytes(data)
    if request.function == 5:
        return head + struct.pack(">HH", request.address, 0xFF00 if request.values[0] else 0)
    if request.function == 6:
        return head + struct.pack(">HH", request.address, request.values[0])
    return head + struct.pack(">HH", request.address, request.count)


def read_cells(cells: Mapping[int, int], request: Request) -> list[int]:
    """The registers that are asked for; `Refused` where one is not there."""
    wanted = range(request.address, request.address + request.count)
    if any(address not in cells for address in wanted):
        raise Refused(ADDRESS)
    return [cells[address] & 0xFFFF for address in wanted]


def refusal(function: int, code: int) -> bytes:
    """An exception answer."""
    return bytes([function | 0x80, code])


# -- frames around them ---------------------------------------------------------------------------------------------


def mbap(transaction: int, unit: int, pdu: bytes) -> bytes:
    """A frame of Modbus TCP."""
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


def split_mbap(data: bytes) -> tuple[int, int, bytes, bytes] | None:
    """Transaction, unit and PDU of the first whole frame in `data`, and the rest; None while it is not whole.

    ValueError where this is no Modbus TCP.
    """
    if len(data) < 8:
        return None
    transaction, protocol, length, unit = struct.unpack(">HHHB", data[:7])
    if protocol != 0 or not 2 <= length <= 254:
        raise ValueError(f"no Modbus TCP: protocol {protocol}, length {length}")
    if len(data) < 6 + length:
        return None
    return transaction, unit, data[7 : 6 + length], data[6 + length :]


def crc16(data: bytes) -> bytes:
    """The check of a serial frame, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return struct.pack("<H", crc)


def rtu(unit: int, pdu: bytes) -> bytes:
    """A frame of Modbus RTU."""
    body = bytes([unit]) + pdu
    return body + crc16(body)


def split_rtu(data: bytes) -> tuple[int, bytes, bytes] | None:
    """Unit and PDU of the first whole request in `data`, and the rest; None while it is not whole.

    Bytes in front that begin no request with a right check are dropped.
    """
    for start in range(max(0, len(data) - 7)):
        part = data[start:]
        length = 9 + part[6] if part[1] in {15, 16} and len(part) > 6 else 8
        if len(part) >= length and crc16(part[: length - 2]) == part[length - 2 : length]:
            return part[0], part[1 : length - 2], part[length:]
    return None
