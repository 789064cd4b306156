"""A relay between driver and emulator, on TCP or a pseudo-terminal, and what it does to the bytes of the device."""

from __future__ import annotations

import os
import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from random import Random

Pieces = Sequence[tuple[float, bytes]]
"""What arrives instead: after so long [s], these bytes."""
Damage = Callable[[bytes], Pieces]
SELDOM = {"late", "nothing"}
"""They cost a time-out each."""
PIECE = 4096
WAIT = 0.05
"""Longest wait for bytes on a serial line [s]."""


def silence(_data: bytes) -> Pieces:
    """Nothing arrives."""
    return ()


def late(seconds: float) -> Damage:
    """Everything arrives, `seconds` later."""
    return lambda data: ((seconds, data),)


def _flipped(data: bytes, chance: Random, _before: bytes) -> Pieces:
    changed = bytearray(data)
    for _ in range(chance.randint(1, 3)):
        changed[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return ((0.0, bytes(changed)),)


def _in_parts(data: bytes, chance: Random, _before: bytes) -> Pieces:
    middle = chance.randrange(len(data))
    return ((0.0, data[:middle]), (chance.uniform(0.0, 0.02), data[middle:]))


KINDS: dict[str, Callable[[bytes, Random, bytes], Pieces]] = {
    "cut": lambda data, chance, _before: [(0.0, data[: chance.randrange(len(data))])],
    "bits flipped": _flipped,
    "repeated": lambda data, _chance, _before: [(0.0, data + data)],
    "garbage before": lambda data, chance, _before: [(0.0, chance.randbytes(chance.randint(1, 12)) + data)],
    "garbage behind": lambda data, chance, _before: [(0.0, data + chance.randbytes(chance.randint(1, 12)))],
    "other bytes": lambda data, chance, _before: [(0.0, chance.randbytes(len(data)))],
    "far too long": lambda data, chance, _before: [(0.0, data + chance.randbytes(chance.randint(300, 5000)))],
    "in parts": _in_parts,
    "an older answer": lambda data, _chance, before: [(0.0, before or data)],
    "late": lambda data, chance, _before: [(chance.uniform(0.02, 0.4), data)],
    "nothing": lambda _data, _chance, _before: [],
}
"""Name -> what arrives instead of `data`, where `before` came last."""


class Hostile:
    """Damages every piece in the way `kind`; remembers the piece before."""

    def __init__(self, chance: Random) -> None:
        self._chance = chance
        self._before = b""
        self.kind = "cut"
        self.done = 0
        """Pieces that were damaged."""

    def another(self) -> str:
        """Choose a kind for what comes now; its name."""
        names = [name for name in KINDS if name not in SELDOM or self._chance.random() < 0.3]
        self.kind = self._chance.choice(names)
        return self.kind

    def __call__(self, data: bytes) -> Pieces:
        """As a `Damage`."""
        before, self._before = self._before, data
        self.done += 1
        return KINDS[self.kind](data, self._chance, before) if data else ()


class Relay(ABC):
    """Passes everything on. What the driver sends is passed on as it is; `damage` is done to what the device sends."""

    def __init__(self) -> None:
        self.damage: Damage | None = None
        self.heard: list[tuple[bool, bytes]] = []
        """What went through, in its order: whether the device sent it, and the bytes."""
        self.address = ""
        """What the driver connects to."""

    @abstractmethod
    def hang_up(self) -> None:
        """End the connections that there are."""

    @abstractmethod
    def close(self) -> None:
        """End."""

    def asked(self, data: bytes) -> list[bytes]:
        """What the driver sends is passed on as it is."""
        self.heard.append((False, data))
        return [data]

    def arriving(self, data: bytes) -> list[bytes]:
        """What arrives of a piece from the device, after the waits that its damage asks for."""
        self.heard.append((True, data))
        if (damage := self.damage) is None:
            return [data]
        pieces = []
        for seconds, piece in damage(data):
            if seconds:
                time.sleep(seconds)
            pieces.append(piece)
        return pieces


class TcpRelay(Relay):
    """Listens on 127.0.0.1 (`port` 0: a free one) and connects to `far`, as HOST:PORT, for each connection."""

    def __init__(self, far: str) -> None:
        super().__init__()
        host, _, port = far.rpartition(":")
        self._far = (host.strip("[]"), int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._open: set[socket.socket] = set()
        threading.Thread(target=self._accept, name="conformance relay", daemon=True).start()

    def hang_up(self) -> None:
        """Shut every connection."""
        for end in list(self._open):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Listen no more."""
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.hang_up()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(self._far, timeout=5.0)
            except OSError:
                near.close()
                continue
            far.settimeout(None)
            for end in (near, far):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._open.add(end)
            threading.Thread(target=self._serve, args=(near, far), name="conformance relay", daemon=True).start()

    def _serve(self, near: socket.socket, far: socket.socket) -> None:
        """Both directions of a connection, whose ends are closed when both have ended."""
        pump = threading.Thread(target=self._pump, args=(near, far, self.asked), name="conformance relay", daemon=True)
        pump.start()
        self._pump(far, near, self.arriving)
        pump.join()
        for end in (near, far):
            self._open.discard(end)
            end.close()

    def _pump(
        self, source: socket.socket, target: socket.socket, passed_on: Callable[[bytes], Sequence[bytes]]
    ) -> None:
        """One direction; with it the other one ends, too."""
        with suppress(OSError):
            while data := source.recv(PIECE):
                for piece in passed_on(data):
                    target.sendall(piece)
        for end in (source, target):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


class SerialRelay(Relay):
    """A pseudo-terminal reached by the link `path`, in front of the port `far`."""

    def __init__(self, path: Path, far: str) -> None:
        super().__init__()
        import tty

        self.address, self._link = str(path), path
        self._near, self._slave = os.openpty()
        tty.setraw(self._slave)
        self._far = os.open(far, os.O_RDWR | os.O_NOCTTY)
        path.unlink(missing_ok=True)
        path.symlink_to(os.ttyname(self._slave))
        self._ended = threading.Event()
        self._threads = [
            threading.Thread(target=self._pump, args=ends, name="conformance relay", daemon=True)
            for ends in ((self._near, self._far), (self._far, self._near))
        ]
        for thread in self._threads:
            thread.start()

    def hang_up(self) -> None:
        """As when the plug is pulled: the port is gone."""
        self.close()

    def close(self) -> None:
        """End, and take the link away; harmless when repeated."""
        if self._ended.is_set():
            return
        self._ended.set()
        for thread in self._threads:
            thread.join(1.0)
        with suppress(OSError):
            self._link.unlink()
        for end in (self._slave, self._near, self._far):
            with suppress(OSError):
                os.close(end)

    def _pump(self, source: int, target: int) -> None:
        with suppress(OSError):
            while not self._ended.is_set():
                if not select.select([source], [], [], WAIT)[0]:
                    continue
                data = os.read(source, PIECE)
                for piece in self.asked(data) if source == self._near else self.arriving(data):
                    if piece and select.select([], [target], [], 0)[1]:  # what finds no room is lost
                        os.write(target, piece)
