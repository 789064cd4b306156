"""Emulated Modbus devices: requests and answers as bytes, and the connections or pseudo-terminal that carry them.

Written independently of the driver's library, so that each is a check of the other; uses no registers. Layouts: Modbus
Application Protocol 1.1b3, section 6; MBAP header: Modbus Messaging on TCP/IP 1.0b, section 3.1.3; CRC-16: Modbus over
Serial Line 1.02, section 6.2.2.
"""

from __future__ import annotations

import socket
import struct
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from time import monotonic
from typing import Any, Protocol

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator import faults as f
from pmabench_drivers.emulator.faults import CommandLog, Fault, Kind, Outgoing
from pmabench_drivers.emulator.ports import Terminal, accepted, bracketed, hang_up, host_of, listen

READS = {1: "coil", 2: "discrete", 3: "holding", 4: "input"}
WRITES = {5: "coil", 6: "holding", 15: "coil", 16: "holding"}
FUNCTION, ADDRESS, VALUE = 1, 2, 3
"""Exception codes: illegal function, illegal address, illegal value or count."""
WATCH = 0.005
"""Interval for checking the watchdog [s]."""
KINDS = (f.LINK, f.STUCK, f.MODBUS)
IDENTIFY = b"\x2b\x0e"


@dataclass(frozen=True)
class Request:
    """A request: `values` is empty if it reads. `count` is the number of registers or bits."""

    function: int
    address: int
    count: int
    values: tuple[int, ...] = ()

    @property
    def table(self) -> str:
        """The table that it reads or writes."""
        return READS.get(self.function) or WRITES[self.function]


class Refused(Exception):
    """The answer is an exception with this code."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"exception {code}")


def parse(pdu: bytes) -> Request:
    """A request without its header; raises `Refused` as in the specification."""
    function = pdu[0]
    try:
        if function in READS:
            address, count = struct.unpack(">HH", pdu[1:])
            if not 1 <= count <= (2000 if function < 3 else 125):
                raise Refused(VALUE)
            return Request(function, address, count)
        if function in {5, 6}:
            address, value = struct.unpack(">HH", pdu[1:])
            if function == 5 and value not in {0, 0xFF00}:
                raise Refused(VALUE)
            return Request(function, address, 1, (int(value == 0xFF00) if function == 5 else value,))
        if function in {15, 16}:
            address, count, size = struct.unpack(">HHB", pdu[1:6])
            data = pdu[6:]
            needed = (count + 7) // 8 if function == 15 else 2 * count
            if not 1 <= count <= (1968 if function == 15 else 123) or size != needed or len(data) != size:
                raise Refused(VALUE)
            if function == 16:
                return Request(function, address, count, struct.unpack(f">{count}H", data))
            return Request(function, address, count, tuple(data[i // 8] >> i % 8 & 1 for i in range(count)))
    except struct.error:
        raise Refused(VALUE) from None
    raise Refused(FUNCTION)


def answer(request: Request, values: Sequence[int]) -> bytes:
    """Answer to a request: the values read, or the echo of a write."""
    head = bytes([request.function])
    if request.function in {3, 4}:
        return head + bytes([2 * len(values)]) + struct.pack(f">{len(values)}H", *values)
    if request.function in {1, 2}:
        size, bits = (len(values) + 7) // 8, sum((value & 1) << i for i, value in enumerate(values))
        return head + bytes([size]) + bits.to_bytes(size, "little")
    echo = request.count if request.function in {15, 16} else request.values[0]
    return head + struct.pack(">HH", request.address, echo * 0xFF00 if request.function == 5 else echo)


def read_cells(cells: Mapping[int, int], request: Request) -> list[int]:
    """The requested registers; `Refused` if one does not exist."""
    wanted = range(request.address, request.address + request.count)
    if any(address not in cells for address in wanted):
        raise Refused(ADDRESS)
    return [cells[address] & 0xFFFF for address in wanted]


def refusal(function: int, code: int) -> bytes:
    """An exception answer."""
    return bytes([function | 0x80, code])


# -- frames ---------------------------------------------------------------------------------------------------------


def mbap(transaction: int, unit: int, pdu: bytes) -> bytes:
    """A frame of Modbus TCP."""
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


def split_mbap(data: bytes) -> tuple[int, int, bytes, bytes] | None:
    """Transaction, unit and PDU of the first complete frame in `data`, and the rest; None while it is incomplete.

    ValueError if it is no Modbus TCP.
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
    """CRC of a serial frame, low byte first."""
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
    """Unit and PDU of the first complete request in `data`, and the rest; None while it is incomplete.

    Bytes before it that do not begin a request with a correct CRC are dropped.
    """
    for start in range(max(0, len(data) - 7)):
        part = data[start:]
        length = 9 + part[6] if part[1] in {15, 16} and len(part) > 6 else 8
        if len(part) >= length and crc16(part[: length - 2]) == part[length - 2 : length]:
            return part[0], part[1 : length - 2], part[length:]
    return None


def events(registers: object) -> Iterator[dict[str, Kind]]:
    """The events that are possible with these registers."""
    for kinds in (f.EXPIRY, f.WATCHDOG_OFF, f.RESTART, f.SETPOINT):
        if all(hasattr(registers, f.EVENTS[name]) for name in kinds):
            yield kinds


class Answering(Protocol):
    """Interface of what is behind a wire: the registers of one device."""

    device: DeviceRecord

    def carry_out(self, request: Request, connection: int, *, ignore: bool = False) -> list[int]:
        """Registers read, or an empty list for a write; raises `Refused`."""

    def look_at_watchdog(self) -> None:
        """Vent by itself if its watchdog has expired."""


class _Device:
    """Common to both kinds of wire: a request is answered or not, or the connection ends."""

    def __init__(self, registers: Answering, unit_id: int, log: CommandLog) -> None:
        self.registers, self.log, self.unit_id = registers, log, unit_id
        self.faults = f.Faults(*KINDS, *events(registers))
        self._connections = count(1)
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=self._watch, name="emulated watchdog", daemon=True)]

    def start(self) -> None:
        """Start serving."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop serving."""
        self._ended.set()

    def __getattr__(self, event: str) -> Any:
        """Events from outside (`faults.EVENTS`) are those of the registers."""
        if event not in f.EVENTS.values():
            raise AttributeError(event)
        return getattr(self.registers, event)

    def answer(self, pdu: bytes, connection: int) -> tuple[bytes, Fault] | None:
        """Carry out a request: answer without a frame, and the fault that applies; None without an answer."""
        fault = self.faults.next()
        if fault.kind in {"hang-up", "reset"}:
            raise ConnectionAbortedError(fault.kind)
        if fault.kind == "silence":
            return None
        try:
            return self.reply(pdu, connection, fault), fault
        except Refused as refused:
            return refusal(pdu[0], refused.code), fault

    def reply(self, pdu: bytes, connection: int, fault: Fault) -> bytes:
        """Carry out a request; returns the answer without a frame, or raises `Refused`."""
        request = parse(pdu)
        return answer(request, self.values(request, connection, fault))

    def values(self, request: Request, connection: int, fault: Fault) -> list[int]:
        """Values read, with the present fault."""
        if fault.kind == "exception":
            raise Refused(int(fault.value))
        values = self.registers.carry_out(request, connection, ignore=fault.kind == "ignore")
        return [(value + int(fault.value)) & 0xFFFF for value in values] if fault.kind == "wrong" else values

    def _watch(self) -> None:
        while not self._ended.wait(WATCH):
            self.registers.look_at_watchdog()


class TcpDevice(_Device):
    """Modbus TCP at the host of the device's address; port 0 takes a free one, see `address`."""

    def __init__(self, registers: Answering, unit_id: int, log: CommandLog, port: int) -> None:
        super().__init__(registers, unit_id, log)
        host = host_of(registers.device.address)
        self._listener = listen(registers.device.name, host, port)
        self.address = f"{bracketed(host)}:{self._listener.getsockname()[1]}"
        self._open: set[socket.socket] = set()
        self._threads.append(threading.Thread(target=self._accept, name="emulated Modbus", daemon=True))

    def close(self) -> None:
        """Stop serving and close every connection."""
        super().close()
        hang_up(self._listener, *self._open)

    def _accept(self) -> None:
        for connection in accepted(self._listener):
            number = next(self._connections)
            self._open.add(connection)
            self.log.note("connect", self.registers.device.name, connection=number)
            threading.Thread(target=self._serve, args=(connection, number), daemon=True).start()

    def _serve(self, connection: socket.socket, number: int) -> None:
        data, outgoing, tap = b"", Outgoing(), self.log.tap(self.registers.device.name, connection=number)
        try:
            while received := connection.recv(4096):
                tap("received", received)
                data += received
                while (parts := split_mbap(data)) is not None:
                    transaction, unit, pdu, data = parts
                    if unit not in {self.unit_id, 0, 255}:
                        continue
                    if (answered := self.answer(pdu, number)) is not None:
                        leaving = outgoing.of(mbap(transaction, unit, answered[0]), answered[1])
                        connection.sendall(leaving)
                        tap("sent", leaving)
        except ConnectionAbortedError as error:
            if str(error) == "reset":
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        except (OSError, ValueError) as error:  # the other end has gone, or sends no Modbus
            self.log.note("lost", self.registers.device.name, connection=number, why=str(error))
        finally:
            self._open.discard(connection)
            connection.close()
            self.log.note("disconnect", self.registers.device.name, connection=number)


class RtuDevice(_Device):
    """Modbus RTU on a pseudo-terminal with the symbolic link `path`; answers in the order of requests."""

    def __init__(self, registers: Answering, unit_id: int, log: CommandLog, path: str) -> None:
        super().__init__(registers, unit_id, log)
        self._terminal = Terminal(path, log.tap(registers.device.name))
        self.address = path
        self._threads.append(threading.Thread(target=self._serve, name="emulated Modbus RTU", daemon=True))

    def close(self) -> None:
        """Stop serving and close the terminal."""
        super().close()
        self._terminal.close()

    def _serve(self) -> None:
        data, outgoing = b"", Outgoing()
        while not self._ended.is_set():
            if (received := self._terminal.read(0.05)) is None:
                return
            data = (data + received)[-600:]
            while (parts := split_rtu(data)) is not None:
                unit, pdu, data = parts
                if unit != self.unit_id:
                    continue
                try:
                    if (answered := self.answer(pdu, 1)) is not None:
                        self._terminal.write(outgoing.of(rtu(unit, answered[0]), answered[1]))
                except ConnectionAbortedError:
                    self._terminal.close()
                    return
                except OSError:
                    return


class NamedRegisters(ABC):
    """Named holding registers of a device with a time-out, which any communication restarts."""

    timeout: int
    """Time-out [ms]; 0: never."""

    def __init__(self, device: DeviceRecord, product: str, model: str) -> None:
        self.device = device
        self.names = ("emulator of pmabench", product, "1", "", model, "")
        """Objects 0 to 5 of the device identification."""
        self._lock, self._heard = threading.Lock(), monotonic()

    def hear(self) -> None:
        """Note any communication, which restarts the time-out."""
        with self._lock:
            self._heard = monotonic()

    def carry_out(self, request: Request, connection: int, *, ignore: bool = False) -> list[int]:
        """Registers read, or an empty list for a write; raises `Refused`."""
        self.hear()
        if request.table != "holding":
            raise Refused(FUNCTION)
        with self._lock:
            if request.values:
                self._write(request, connection, ignore=ignore)
                return []
            return read_cells(self._cells(), request)

    @abstractmethod
    def _cells(self) -> Mapping[int, int]:
        """All registers that can be read now."""

    @abstractmethod
    def _write(self, request: Request, connection: int, *, ignore: bool) -> None:
        """Carry out a write; raises `Refused`."""

    @abstractmethod
    def look_at_watchdog(self) -> None:
        """Act by itself if its time-out has expired."""

    def switch_off_watchdog(self) -> bool:
        """Set the time-out to never, as another program may; returns whether there was one."""
        with self._lock:
            before, self.timeout = self.timeout, 0
            return before > 0


class NamedDevice(TcpDevice):
    """Also reports its names, objects 0 to 5, which counts as communication, too."""

    registers: NamedRegisters

    def __init__(self, registers: NamedRegisters, log: CommandLog) -> None:
        super().__init__(registers, 1, log, int(registers.device.address.rpartition(":")[2]))

    def reply(self, pdu: bytes, connection: int, fault: Fault) -> bytes:
        """As in the base class, and the answer to function 43/14."""
        if pdu[:2] != IDENTIFY:
            return super().reply(pdu, connection, fault)
        self.registers.hear()
        if len(pdu) != 4 or pdu[2] not in {1, 2}:
            raise Refused(VALUE)
        objects = self.registers.names[:3] if pdu[2] == 1 else self.registers.names
        body = b"".join(bytes([i, len(text)]) + text.encode("ascii") for i, text in enumerate(objects))
        return bytes([0x2B, 0x0E, pdu[2], 0x82, 0, 0, len(objects)]) + body
