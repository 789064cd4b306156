"""Listening ports of emulated devices: TCP ports of this machine and pseudo-terminals, a thread each (POSIX)."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import tty
from abc import ABC, abstractmethod
from collections.abc import Iterator
from ipaddress import ip_address
from pathlib import Path
from time import monotonic

from pmabench.base.errors import UsageError
from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.faults import GARBAGE, LINK, SKEW, STUCK, CommandLog, Fault, Faults, Kind, Outgoing, Tap

IDLE = 0.05
"""Longest wait for bytes [s]."""
TICK = 0.004
"""Data due within this time are sent together [s]."""
LONGEST_COMMAND = 200
"""Longest unfinished line that is kept [bytes]."""


def host_of(address: str) -> str:
    """Host of `HOST:PORT` or `HOST`; empty if it is no IP address, as in a path."""
    host = address if address.count(":") != 1 and "]:" not in address else address.rpartition(":")[0]
    try:
        return str(ip_address("127.0.0.1" if host == "localhost" else host.strip("[]")))
    except ValueError:
        return ""


def bracketed(host: str) -> str:
    """A host as written before a port."""
    return f"[{host}]" if ":" in host else host


def listen(device: str, host: str, port: int) -> socket.socket:
    """A listening TCP socket; UsageError if that is not possible."""
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise UsageError(f"cannot serve {device} at {bracketed(host)}:{port}: {error.strerror}") from None


def accepted(listener: socket.socket) -> Iterator[socket.socket]:
    """Each new connection, until the listener is closed."""
    with contextlib.suppress(OSError):
        while True:
            connection, _peer = listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            yield connection


def hang_up(*ends: socket.socket | None) -> None:
    """Shut down and close sockets, also while another thread waits for them; may be called again."""
    for end in filter(None, ends):
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
        end.close()


def refuse_others(device: str, address: str) -> None:
    """Raise UsageError if `address` names a host other than this machine."""
    host = host_of(address)
    if host and not ip_address(host).is_loopback:
        where = f"{device} is at {address}, where other machines could reach what is emulated"
        raise UsageError(f'{where}; give it an address of this machine, as "127.0.0.1:0", or say --expose')


class Terminal:
    """A pseudo-terminal with the symbolic link `path`; `tap` is called with its data."""

    def __init__(self, path: str, tap: Tap) -> None:
        self._link, self._tap = Path(path), tap
        if self._link.exists() and not self._link.is_symlink():
            raise UsageError(f"{path} is there and is no link of an emulator; give the device another address")
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        try:
            self._link.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(os.ttyname(self._far))
        except OSError as error:
            self._hang_up()
            raise UsageError(f"cannot make the link {path}: {error.strerror}") from None

    def read(self, wait: float) -> bytes | None:
        """Bytes received within `wait` [s]; None once it is closed."""
        try:
            if not select.select([self._near], [], [], wait)[0]:
                return b""
            data = os.read(self._near, 4096)
        except (OSError, ValueError):
            return None
        self._tap("received", data)
        return data

    def write(self, data: bytes) -> None:
        """Send as far as possible: what does not fit into the buffer is lost, as on a wire without a receiver."""
        if self._near >= 0 and select.select([], [self._near], [], 0)[1]:
            self._tap("sent", data[: os.write(self._near, data)])

    def close(self) -> None:
        """Close it and remove the link; may be called again."""
        with contextlib.suppress(OSError):
            if self._link.is_symlink():
                self._link.unlink()
        self._hang_up()

    def _hang_up(self) -> None:
        near, far, self._near, self._far = self._near, self._far, -1, -1
        for end in (far, near):
            if end >= 0:
                with contextlib.suppress(OSError):
                    os.close(end)


class OnTerminal(ABC):
    """A device at the end of a pseudo-terminal. Subclasses define the reaction to bytes."""

    def __init__(self, device: DeviceRecord, log: CommandLog, faults: Faults, garbage: bytes = GARBAGE) -> None:
        self.address, self.faults = device.address, faults
        self.terminal, self._outgoing = Terminal(device.address, log.tap(device.name)), Outgoing(garbage)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"emulated {device.name}", daemon=True)

    def start(self) -> None:
        """Start serving."""
        self._thread.start()

    def close(self) -> None:
        """Stop serving and close the terminal."""
        self._ended.set()
        self.terminal.close()

    @abstractmethod
    def take(self, data: bytes) -> None:
        """Process bytes, or none after `wait`; raises ConnectionAbortedError to close the terminal."""

    def wait(self) -> float:
        """Longest wait for bytes [s]."""
        return IDLE

    def next_fault(self) -> Fault:
        """The present fault; raises ConnectionAbortedError if it closes the line."""
        fault = self.faults.next()
        if fault.kind in {"hang-up", "reset"}:
            raise ConnectionAbortedError
        return fault

    def outgoing(self, data: bytes, fault: Fault) -> bytes:
        """One answer or measurement as delivered by the line."""
        return self._outgoing.of(data, fault)

    def _serve(self) -> None:
        while not self._ended.is_set():
            if (data := self.terminal.read(self.wait())) is None:
                return
            try:
                self.take(data)
            except ConnectionAbortedError:
                self.terminal.close()
                return
            except OSError:
                return


class Streaming(OnTerminal):
    """A device on a pseudo-terminal that sends by itself. Subclasses define `command` and `send_what_is_due`."""

    def __init__(self, device: DeviceRecord, log: CommandLog, *kinds: dict[str, Kind], garbage: bytes) -> None:
        super().__init__(device, log, Faults(LINK, STUCK, SKEW, *kinds), garbage)
        self.streaming = False
        self.due = 0.0
        """When the next measurement is due [s, monotonic]."""
        self._asked = b""

    @abstractmethod
    def command(self, line: str) -> None:
        """Process a received line; raises ConnectionAbortedError to close the terminal."""

    @abstractmethod
    def send_what_is_due(self) -> None:
        """Send every measurement that is due while `streaming`; raises ConnectionAbortedError to close the terminal."""

    def seconds(self, shown: float) -> float:
        """Duration by this machine's clock of a time by the device's own clock [s]."""
        fault = self.faults.peek()
        return shown / (1.0 + fault.value) if fault.kind == "skew" else shown

    def wait(self) -> float:
        """Time until the next measurement is due [s]."""
        return min(max(TICK, self.due - monotonic()), IDLE) if self.streaming else IDLE

    def take(self, data: bytes) -> None:
        """Carry out each complete line, and send what is due."""
        *lines, rest = (self._asked + data).replace(b"\r", b"\n").split(b"\n")
        self._asked = rest[-LONGEST_COMMAND:]
        for line in lines:
            if line.strip():
                self.command(line.decode("ascii", "replace").strip())
        if self.streaming:
            self.send_what_is_due()
