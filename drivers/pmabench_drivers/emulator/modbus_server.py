"""An emulated Modbus device on 127.0.0.1, or on a pseudo-terminal: connections, frames and faults of the link."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable
from itertools import count
from typing import Protocol

from pmabench.base.errors import UsageError
from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator import frames
from pmabench_drivers.emulator.faults import Faults
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import Terminal
from pmabench_drivers.emulator.registers import Registers
from pmabench_drivers.modbus.map_file import read_options
from pmabench_drivers.options import Reader

GARBAGE = b"\x00\xff\x13"
WATCH = 0.005
"""How often the watchdog is looked at [s]."""


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> TcpDevice | RtuDevice:
    """What a device of the driver `modbus` talks to: TCP on this machine, or RTU on a pseudo-terminal."""
    reader = Reader()
    options = read_options(device, reader)
    reader.refuse(device.name)
    registers = Registers(device, options, plant, log)
    host, _, port = device.address.rpartition(":")
    if not port.isdecimal():
        return RtuDevice(registers, options.map.unit_id, log, device.address)
    if host not in {"127.0.0.1", "localhost"}:
        raise UsageError(f'{device.name} is at {device.address}; an emulator serves only "127.0.0.1:PORT"')
    try:
        return TcpDevice(registers, options.map.unit_id, log, int(port))
    except OSError as error:
        raise UsageError(f"cannot serve {device.name} at {device.address}: {error.strerror}") from None


class Answering(Protocol):
    """What stands behind a wire: the registers of one device."""

    device: DeviceRecord

    def carry_out(self, request: frames.Request, connection: int, *, ignore: bool = False) -> list[int]:
        """What is read, or nothing; `Refused` where the device says no."""

    def look_at_watchdog(self) -> None:
        """Vent by itself where its watchdog has run out."""


class _Device:
    """What both kinds of wire share: a request goes in, an answer comes out, or none, or the connection ends."""

    def __init__(self, registers: Answering, unit_id: int, log: CommandLog) -> None:
        self.registers, self.faults, self.log, self.unit_id = registers, Faults(), log, unit_id
        self._connections = count(1)
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=self._watch, name="emulated watchdog", daemon=True)]

    def start(self) -> None:
        """Begin to serve."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End."""
        self._ended.set()

    def answer(self, pdu: bytes, connection: int, send: Callable[[bytes, str], None]) -> None:
        """Carry out a request and send its answer as the fault of the moment lets it."""
        fault = self.faults.next()
        if fault.kind in {"hang-up", "reset"}:
            raise ConnectionAbortedError(fault.kind)
        if fault.kind == "silence":
            return
        try:
            request = frames.parse(pdu)
            if fault.kind == "exception":
                raise frames.Refused(int(fault.value))
            values = self.registers.carry_out(request, connection, ignore=fault.kind == "ignore")
            if fault.kind == "wrong":
                values = [(value + int(fault.value)) & 0xFFFF for value in values]
            reply = frames.answer(request, values)
        except frames.Refused as refused:
            reply = frames.refusal(pdu[0], refused.code)
        if fault.kind == "delay":
            time.sleep(fault.value)
        if fault.kind != "lost":
            send(reply, fault.kind if fault.kind != "truncated" else f"truncated {int(fault.value)}")

    def _watch(self) -> None:
        while not self._ended.wait(WATCH):
            self.registers.look_at_watchdog()


class TcpDevice(_Device):
    """Modbus TCP on 127.0.0.1; port 0 takes a free one. `address` says which."""

    def __init__(self, registers: Answering, unit_id: int, log: CommandLog, port: int) -> None:
        super().__init__(registers, unit_id, log)
        self._listener = socket.create_server(("127.0.0.1", port))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._open: set[socket.socket] = set()
        self._threads.append(threading.Thread(target=self._accept, name="emulated Modbus", daemon=True))

    def close(self) -> None:
        """Close every connection."""
        super().close()
        for end in (self._listener, *self._open):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()

    def _accept(self) -> None:
        while not self._ended.is_set():
            try:
                connection, _peer = self._listener.accept()
            except OSError:
                return
            number = next(self._connections)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._open.add(connection)
            self.log.note("connect", self.registers.device.name, connection=number)
            threading.Thread(target=self._serve, args=(connection, number), daemon=True).start()

    def _serve(self, connection: socket.socket, number: int) -> None:
        data, before = b"", 0
        try:
            while received := connection.recv(4096):
                data += received
                while (parts := frames.split_mbap(data)) is not None:
                    transaction, unit, pdu, data = parts
                    if unit not in {self.unit_id, 0, 255}:
                        continue

                    def send(
                        reply: bytes, fault: str, now: int = transaction, then: int = before, unit: int = unit
                    ) -> None:
                        frame = frames.mbap(then if fault == "stale" else now, unit, reply)
                        connection.sendall(_damaged(frame, fault))

                    self.answer(pdu, number, send)
                    before = transaction
        except ConnectionAbortedError as error:
            if str(error) == "reset":
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        except (OSError, ValueError) as error:  # the other end is gone, or speaks no Modbus
            self.log.note("lost", self.registers.device.name, connection=number, why=str(error))
        finally:
            self._open.discard(connection)
            connection.close()
            self.log.note("disconnect", self.registers.device.name, connection=number)


class RtuDevice(_Device):
    """Modbus RTU on a pseudo-terminal that is reached by the link `path`; answers in the order of the questions."""

    def __init__(self, registers: Answering, unit_id: int, log: CommandLog, path: str) -> None:
        super().__init__(registers, unit_id, log)
        self._terminal = Terminal(path)
        self.address = path
        self._threads.append(threading.Thread(target=self._serve, name="emulated Modbus RTU", daemon=True))

    def close(self) -> None:
        """Hang up."""
        super().close()
        self._terminal.close()

    def _serve(self) -> None:
        data = b""
        while not self._ended.is_set():
            received = self._terminal.read(0.05)
            if received is None:
                return
            data = (data + received)[-600:]
            while (parts := frames.split_rtu(data)) is not None:
                unit, pdu, data = parts
                if unit != self.unit_id:
                    continue

                def send(reply: bytes, fault: str, unit: int = unit) -> None:
                    self._terminal.write(_damaged(frames.rtu(unit, reply), fault))

                try:
                    self.answer(pdu, 1, send)
                except ConnectionAbortedError:
                    self._terminal.close()
                    return
                except OSError:
                    return


def _damaged(frame: bytes, fault: str) -> bytes:
    if fault == "garbage":
        return GARBAGE + frame
    if fault.startswith("truncated "):
        return frame[: max(0, len(frame) - int(fault[10:]))]
    return frame
