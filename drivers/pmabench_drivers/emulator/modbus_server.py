"""An emulated Modbus device on TCP, or on a pseudo-terminal: connections, frames and faults of the link."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from itertools import count
from typing import Protocol

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator import frames
from pmabench_drivers.emulator.faults import (
    EVENTS,
    EXPIRY,
    LINK,
    MODBUS,
    RESTART,
    SETPOINT,
    STUCK,
    WATCHDOG_OFF,
    Fault,
    Faults,
    Kind,
    Outgoing,
)
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import Terminal, bracketed, host_of, listen
from pmabench_drivers.emulator.registers import Registers
from pmabench_drivers.modbus.map_file import read_options
from pmabench_drivers.shared.options import options_of

WATCH = 0.005
"""How often the watchdog is looked at [s]."""
KINDS = (LINK, STUCK, MODBUS)

Send = Callable[[bytes, Fault], None]
"""Sends an answer without its frame as a fault lets it."""


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> TcpDevice | RtuDevice:
    """What a device of the driver `modbus` talks to: TCP, or RTU on a pseudo-terminal."""
    options = options_of(device, read_options)
    registers = Registers(device, options, plant, log)
    if device.address.startswith("/"):
        return RtuDevice(registers, options.map.unit_id, log, device.address)
    return TcpDevice(registers, options.map.unit_id, log, int(device.address.rpartition(":")[2]))


def events(registers: object) -> Iterator[dict[str, Kind]]:
    """The events that can happen to what is behind a wire."""
    for kinds in (EXPIRY, WATCHDOG_OFF, RESTART, SETPOINT):
        if all(hasattr(registers, EVENTS[name]) for name in kinds):
            yield kinds


class Answering(Protocol):
    """What is behind a wire: the registers of one device."""

    device: DeviceRecord

    def carry_out(self, request: frames.Request, connection: int, *, ignore: bool = False) -> list[int]:
        """What is read, or nothing; `Refused` where the device says no."""

    def look_at_watchdog(self) -> None:
        """Vent by itself where its watchdog has run out."""


class _Device:
    """What both kinds of wire share: a request goes in, an answer comes out, or none, or the connection ends."""

    def __init__(self, registers: Answering, unit_id: int, log: CommandLog) -> None:
        self.registers, self.log, self.unit_id = registers, log, unit_id
        self.faults = Faults(*KINDS, *events(registers))
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

    def expire_watchdog(self) -> bool:
        """Let the watchdog expire; whether it was armed."""
        return bool(self._of_registers("expire_watchdog"))

    def switch_off_watchdog(self) -> bool:
        """Switch the watchdog off from outside; whether it was armed."""
        return bool(self._of_registers("switch_off_watchdog"))

    def restart(self) -> None:
        """Begin as after power-on; connections stay."""
        self._of_registers("restart")

    def change_set_point(self, value: float) -> bool:
        """Command a set-point from outside [register]; whether there is one."""
        return bool(self._of_registers("change_set_point", value))

    def _of_registers(self, event: str, *values: float) -> object:
        return getattr(self.registers, event)(*values)

    def answer(self, pdu: bytes, connection: int, send: Send) -> None:
        """Carry out a request and send its answer as the fault of the moment lets it."""
        fault = self.faults.next()
        if fault.kind in {"hang-up", "reset"}:
            raise ConnectionAbortedError(fault.kind)
        if fault.kind == "silence":
            return
        try:
            reply = self.reply(pdu, connection, fault)
        except frames.Refused as refused:
            reply = frames.refusal(pdu[0], refused.code)
        send(reply, fault)

    def reply(self, pdu: bytes, connection: int, fault: Fault) -> bytes:
        """Carry out a request and give its answer without a frame; `Refused` where the device says no."""
        request = frames.parse(pdu)
        return frames.answer(request, self.values(request, connection, fault))

    def values(self, request: frames.Request, connection: int, fault: Fault) -> list[int]:
        """What is read, with the fault of the moment."""
        if fault.kind == "exception":
            raise frames.Refused(int(fault.value))
        values = self.registers.carry_out(request, connection, ignore=fault.kind == "ignore")
        if fault.kind == "wrong":
            return [(value + int(fault.value)) & 0xFFFF for value in values]
        return values

    def _watch(self) -> None:
        while not self._ended.wait(WATCH):
            self.registers.look_at_watchdog()


class TcpDevice(_Device):
    """Modbus TCP at the host of the device's address; port 0 takes a free one. `address` says which."""

    def __init__(self, registers: Answering, unit_id: int, log: CommandLog, port: int) -> None:
        super().__init__(registers, unit_id, log)
        host = host_of(registers.device.address)
        self._listener = listen(registers.device.name, host, port)
        self.address = f"{bracketed(host)}:{self._listener.getsockname()[1]}"
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
        data, outgoing, tap = b"", Outgoing(), self.log.tap(self.registers.device.name, connection=number)
        try:
            while received := connection.recv(4096):
                tap("received", received)
                data += received
                while (parts := frames.split_mbap(data)) is not None:
                    transaction, unit, pdu, data = parts
                    if unit not in {self.unit_id, 0, 255}:
                        continue

                    def send(reply: bytes, fault: Fault, transaction: int = transaction, unit: int = unit) -> None:
                        leaving = outgoing.of(frames.mbap(transaction, unit, reply), fault)
                        connection.sendall(leaving)
                        tap("sent", leaving)

                    self.answer(pdu, number, send)
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
        self._terminal = Terminal(path, log.tap(registers.device.name))
        self.address = path
        self._threads.append(threading.Thread(target=self._serve, name="emulated Modbus RTU", daemon=True))

    def close(self) -> None:
        """Hang up."""
        super().close()
        self._terminal.close()

    def _serve(self) -> None:
        data, outgoing = b"", Outgoing()
        while not self._ended.is_set():
            received = self._terminal.read(0.05)
            if received is None:
                return
            data = (data + received)[-600:]
            while (parts := frames.split_rtu(data)) is not None:
                unit, pdu, data = parts
                if unit != self.unit_id:
                    continue

                def send(reply: bytes, fault: Fault, unit: int = unit) -> None:
                    self._terminal.write(outgoing.of(frames.rtu(unit, reply), fault))

                try:
                    self.answer(pdu, 1, send)
                except ConnectionAbortedError:
                    self._terminal.close()
                    return
                except OSError:
                    return
