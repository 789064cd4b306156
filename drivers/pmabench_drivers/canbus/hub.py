"""An emulated CAN bus: any number of slcan adapters behind one TCP port of this machine, and nodes in this process."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
from collections.abc import Callable
from time import monotonic

from pmabench.base.errors import UsageError
from pmabench_drivers.canbus.frames import Frame
from pmabench_drivers.canbus.slcan import TCP, line_of, read_line
from pmabench_drivers.emulator.faults import Faults, Outgoing
from pmabench_drivers.emulator.log import Tap
from pmabench_drivers.emulator.ports import listen

TICK = 0.002
"""The nodes are given a turn so often [s]."""
LONGEST = 64
"""More of an unfinished line is forgotten [bytes]."""
SERIAL = b"NSIM0\r"
"""Serial number of the emulated adapters."""
GARBAGE = b"t1zz8\x00\xff\r\x07T0000\r"
"""What is no frame, in the form of some."""
COMMANDS = (b"C", b"L", b"O", b"S", b"s", b"F", b"X", b"Z", b"V", b"N")
PREFIX = f"slcan:{TCP}"


class Hub:
    """Frames from one adapter reach all others and `take`; `turn` is called with the time [s, monotonic]."""

    def __init__(
        self,
        name: str,
        address: str,
        take: Callable[[Frame], None],
        turn: Callable[[float], None],
        faults: Faults,
        tap: Tap,
    ) -> None:
        host, _, port = address.removeprefix(PREFIX).rpartition(":")
        if not address.startswith(PREFIX) or not host or not port.isdecimal():
            raise UsageError(f'{name} is at {address}; an emulator serves a bus at "{PREFIX}127.0.0.1:PORT" only')
        self._listener = listen(name, "127.0.0.1" if host == "localhost" else host, int(port))
        self.address = f"{PREFIX}{host}:{self._listener.getsockname()[1]}"
        self._take, self._turn, self._faults, self._tap = take, turn, faults, tap
        self._outgoing = Outgoing(GARBAGE)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._rests: dict[socket.socket, bytes] = {}
        self._late: list[tuple[float, bytes]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"emulated {name}", daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def close(self) -> None:
        """Hang up."""
        self._ended.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(1.0)
        for link in [self._listener, *self._rests]:
            with contextlib.suppress(OSError):
                link.close()
        self._rests.clear()

    def send(self, frame: Frame) -> None:
        """A frame of a node in this process, as the fault of the moment lets it through."""
        fault, line = self._faults.next(), line_of(frame)
        if fault.kind in {"hang-up", "reset"}:
            self.hang_up()
        elif fault.kind == "delay":
            self._late.append((monotonic() + fault.value, line))
        else:
            self._out(self._outgoing.of(line, fault))

    def hang_up(self) -> None:
        """Close every connection."""
        for link in list(self._rests):
            self._forget(link)

    # -- adapters -----------------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        due = monotonic()
        while not self._ended.is_set():
            for key, _ in self._selector.select(max(0.0, due - monotonic())):
                if key.fileobj is self._listener:
                    self._accept()
                elif isinstance(key.fileobj, socket.socket):
                    self._hear(key.fileobj)
            now = monotonic()
            if now >= due:
                due = max(due + TICK, now)
                self._turn(now)
            while self._late and self._late[0][0] <= now:
                self._out(self._late.pop(0)[1])

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            link, _peer = self._listener.accept()
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            link.settimeout(0.2)
            self._rests[link] = b""
            self._selector.register(link, selectors.EVENT_READ)

    def _hear(self, link: socket.socket) -> None:
        try:
            piece = link.recv(4096)
        except OSError:
            piece = b""
        if not piece:
            self._forget(link)
            return
        self._tap("received", piece)
        *lines, rest = (self._rests[link] + piece).split(b"\r")
        self._rests[link] = rest[-LONGEST:]
        for line in lines:
            self._obey(link, line)

    def _obey(self, link: socket.socket, line: bytes) -> None:
        if line[:1] in COMMANDS:
            self._write(link, SERIAL if line[:1] == b"N" else b"V1010\r" if line[:1] == b"V" else b"\r")
            return
        frame = read_line(line) or _asked(line)
        if frame is None:
            if line:
                self._write(link, b"\x07")
            return
        self._write(link, b"Z\r" if frame.extended else b"z\r")
        for other in [other for other in self._rests if other is not link]:
            self._write(other, line + b"\r" if frame.remote else line_of(frame))
        if self._faults.peek().kind != "silence":
            self._take(frame)

    def _out(self, data: bytes) -> None:
        if not data:
            return
        self._tap("sent", data)
        for link in list(self._rests):
            self._write(link, data)

    def _write(self, link: socket.socket, data: bytes) -> None:
        try:
            link.sendall(data)
        except OSError:
            self._forget(link)

    def _forget(self, link: socket.socket) -> None:
        if self._rests.pop(link, None) is not None:
            self._selector.unregister(link)
            link.close()


def _asked(line: bytes) -> Frame | None:
    """The identifier that a remote frame asks for; None for anything else."""
    if line[:1] != b"r" or not line[1:5].isalnum():
        return None
    try:
        return Frame(int(line[1:4], 16), remote=True)
    except ValueError:
        return None
