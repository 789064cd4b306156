"""A relay between driver and emulator, on TCP or a pseudo-terminal, that can damage the bytes of the device."""

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
"""What arrives instead: delay [s] and bytes of each piece."""
Damage = Callable[[bytes], Pieces]
SELDOM = {"late", "nothing"}
"""Rarely chosen kinds of damage, as each costs a time-out."""
PIECE = 4096
WAIT = 0.05
"""Longest wait for bytes on a serial line [s]."""


def silence(_data: bytes) -> Pieces:
    """Nothing arrives."""
    return ()


def late(seconds: float) -> Damage:
    """Everything arrives `seconds` later."""
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
"""Kind of damage -> function of (data, random numbers, previous data) that returns what arrives instead."""


class Hostile:
    """Damages every piece in the way `kind`; keeps the previous piece."""

    def __init__(self, chance: Random) -> None:
        self._chance = chance
        self._before = b""
        self.kind = "cut"
        self.done = 0
        """Number of damaged pieces."""

    def another(self) -> str:
        """Choose the kind of damage for the next pieces; returns its name."""
        names = [name for name in KINDS if name not in SELDOM or self._chance.random() < 0.3]
        self.kind = self._chance.choice(names)
        return self.kind

    def __call__(self, data: bytes) -> Pieces:
        """What arrives instead of `data`."""
        before, self._before = self._before, data
        self.done += 1
        return KINDS[self.kind](data, self._chance, before) if data else ()


class Relay(ABC):
    """Passes everything on; `damage` is applied only to what the device sends."""

    def __init__(self) -> None:
        self.damage: Damage | None = None
        self.heard: list[tuple[bool, bytes]] = []
        """All pieces in order: whether the device sent it, and its bytes."""
        self.address = ""
        """Address for the driver."""

    @abstractmethod
    def hang_up(self) -> None:
        """Cut all connections."""

    @abstractmethod
    def close(self) -> None:
        """Stop the relay."""

    def asked(self, data: bytes) -> list[bytes]:
        """What the driver sends, unchanged."""
        self.heard.append((False, data))
        return [data]

    def arriving(self, data: bytes) -> list[bytes]:
        """What arrives of a piece from the device, after the delays of its damage."""
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
    """Listens on a free port of 127.0.0.1 and connects to `far`, HOST:PORT, for each connection."""

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
        """Stop listening and cut all connections."""
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
        """Serve both directions of a connection; close it when both have ended."""
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
        """Serve one direction; when it ends, the other one ends too."""
        with suppress(OSError):
            while data := source.recv(PIECE):
                for piece in passed_on(data):
                    target.sendall(piece)
        for end in (source, target):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


class SerialRelay(Relay):
    """A pseudo-terminal with the symbolic link `path`, in front of the port `far`."""

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
        """As if the plug were pulled: the port is gone."""
        self.close()

    def close(self) -> None:
        """Stop the relay and remove the link; may be called again."""
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
                    if piece and select.select([], [target], [], 0)[1]:  # what does not fit into the buffer is lost
                        os.write(target, piece)
