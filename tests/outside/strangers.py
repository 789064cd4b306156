"""Those who have no business on a guard's port: floods, idle connections, slow bytes, and a false guard."""

from __future__ import annotations

import json
import resource
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

BIG = 64_000_000
IDLE = 1000


def framed(data: bytes) -> bytes:
    """With the length in front that a guard's message has had so far."""
    return struct.pack("!II", len(data), 0) + data


def enough_files(count: int) -> None:
    """Let this process open `count` files."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < count:
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(count, hard), hard))


def _connect(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), timeout=1.0)


def flood(port: int, seconds: float) -> None:
    """64 MB of JSON without a token, in a frame and without one; as often as time allows."""
    document = b'{"do":"status","x":[' + b"1," * (BIG // 2 - 100) + b"1]}"
    until, turn = time.monotonic() + seconds, 0
    while time.monotonic() < until:
        turn += 1
        with suppress(OSError), _connect(port) as link:
            link.settimeout(max(until - time.monotonic(), 0.1))
            link.sendall(framed(document) if turn % 2 else document)
            link.recv(4096)


def nested(port: int, seconds: float) -> None:
    """JSON that is very deep."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        with suppress(OSError), _connect(port) as link:
            link.settimeout(0.5)
            link.sendall(framed(b"[" * 1_000_000 + b"]" * 1_000_000))
            link.recv(4096)


def idle(port: int, seconds: float) -> None:
    """1,000 connections that say nothing, for a while."""
    enough_files(IDLE + 500)
    links: list[socket.socket] = []
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if len(links) < IDLE:
            with suppress(OSError):
                links.append(_connect(port))
        else:
            time.sleep(0.05)
    for link in links:
        link.close()


def slow(port: int, seconds: float) -> None:
    """50 connections that send one byte of a frame at a time."""
    enough_files(200)
    links = [_connect(port) for _ in range(50)]
    data, until = framed(b'{"do":"vent","who":"nobody"}'), time.monotonic() + seconds
    for n in range(len(data) - 1):
        for link in links:
            with suppress(OSError):
                link.sendall(data[n : n + 1])
        time.sleep(max(0.0, min(0.06, until - time.monotonic())))
    for link in links:
        link.close()


def storm(port: int, seconds: float) -> None:
    """Connections that are closed at once, one after the other."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        with suppress(OSError), _connect(port) as link:
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def commands(port: int, seconds: float) -> None:
    """What a guard is asked for, without a token and with a wrong one."""
    until = time.monotonic() + seconds
    asked = [
        {"do": "vent", "who": "me"},
        {"do": "set", "name": "pressure", "value": 5e5},
        {"do": "bye"},
        {"do": "safe"},
    ]
    while time.monotonic() < until:
        for message in asked:
            for token in ({}, {"token": ""}, {"token": "0" * 32}, {"token": None}, {"token": [1]}):
                data = json.dumps({**message, **token, "at": time.monotonic()}).encode()
                with suppress(OSError), _connect(port) as link:
                    link.settimeout(0.05)
                    link.sendall(framed(data))
                    link.recv(4096)


STRANGERS: dict[str, Callable[[int, float], None]] = {
    "64 MB of JSON": flood, "deep JSON": nested, "1,000 idle connections": idle, "slow bytes": slow,
    "connections closed at once": storm, "commands without a token": commands,
}  # fmt: skip


def _answers(way: str, heard: bytes) -> bytes:
    """What a false guard answers to the bytes that it has got."""
    said = {"state": "safe", "ended": {"how": "vent", "why": "vent by me"}, "commanded": True, "ok": True,
            "vent": {"result": "confirmed", "actions": ["confirm pressure: 0 kPa, below 20 kPa"]}}  # fmt: skip
    text = json.dumps(said).encode()
    if way == "framed":
        return framed(text) * 2
    if way == "lines":
        return text + b"\n" + text + b"\n"
    if way == "short length":
        return struct.pack("!I", len(text)) + text
    return heard  # what was said, sent back: a secret that both know must not be proven with its owner's own words


WAYS = ("framed", "lines", "short length", "echo")


@contextmanager
def false_guard(port: int, way: str) -> Iterator[list[bytes]]:
    """Listens where a guard was, and says that everything is well; gives what it has heard."""
    heard: list[bytes] = []
    listener = socket.create_server(("127.0.0.1", port))
    selector = selectors.DefaultSelector()
    selector.register(listener, selectors.EVENT_READ)
    over = threading.Event()

    def serve() -> None:
        while not over.is_set():
            for key, _ in selector.select(0.02):
                if key.fileobj is listener:
                    link = listener.accept()[0]
                    selector.register(link, selectors.EVENT_READ)
                    if way != "echo":
                        link.sendall(_answers(way, b""))
                    continue
                link = key.fileobj  # type: ignore[assignment]
                with suppress(OSError):
                    piece = link.recv(1 << 16)
                    heard.append(piece)
                    if piece:
                        link.sendall(_answers(way, piece))
                        continue
                selector.unregister(link)
                link.close()
        for key in list(selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]
        selector.close()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield heard
    finally:
        over.set()
        thread.join()
