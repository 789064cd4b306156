"""A guard's service in the process of the test, one turn at a time, with an engine's end of the link."""

from __future__ import annotations

import socket
import time
from collections.abc import Mapping
from typing import Any

from pmabench.base.clock import RealClock
from pmabench.bench.interface import CompiledBench
from pmabench.guard import process
from pmabench.guard.guard import Guard, State
from pmabench.guard.process import Service
from pmabench.guard.wire import Messages, encode, keys
from tests.guard.rig import BENCH, Rig

TOKEN = bytes(range(32)).hex()
ASKS, ANSWERS = keys(TOKEN)


class Notes:
    """A station that keeps what is noted in memory."""

    folder = "nowhere"

    def __init__(self, latch: str = "") -> None:
        self.noted: list[tuple[str, dict[str, Any]]] = []
        self.latch = latch

    def write(self, file: str, data: Mapping[str, Any]) -> None:
        pass

    def note(self, what: str, **data: Any) -> None:
        self.noted.append((what, data))

    def take_device(self, where: str) -> None:
        self.noted.append(("device", {"where": where}))

    def latched(self) -> str:
        return self.latch


class Serving:
    """The service, and links to it.

    Unless a test is about pauses (`pauses=True`), those that a busy machine makes are no silence of the engine and no
    time that the guard lost: both are this process.
    """

    def __init__(self, made: CompiledBench = BENCH, latch: str = "", *, pauses: bool = False, **options: Any) -> None:
        self.guard = Guard(made, RealClock(), **options)
        self.station = Notes(latch)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.service = Service(self.guard, self.station, self.listener, TOKEN)
        self._links: list[socket.socket] = []
        self._pauses = pauses
        if not pauses:
            self.service._pulse.look = lambda: None  # type: ignore[method-assign]

    def __enter__(self) -> Serving:
        self._silence = process.SILENCE
        if not self._pauses:
            process.SILENCE = 60.0
        return self

    def __exit__(self, *_: object) -> None:
        process.SILENCE = self._silence
        for link in [*self._links, *(peer.link for peer in self.service._peers), self.listener]:
            link.close()
        self.service._selector.close()
        self.service._pulse.over = True
        self.guard.close()

    @property
    def rig(self) -> Rig:
        return Rig.made["dac"]

    def link(self) -> socket.socket:
        """Another link to it."""
        link = socket.create_connection(self.listener.getsockname())
        link.settimeout(5.0)
        self._links.append(link)
        while link.getsockname() not in {peer.link.getpeername() for peer in self.service._peers}:
            self.service.turn()
        return link

    def say(self, link: socket.socket, raw: bytes) -> dict[str, Any] | None:
        """Send bytes, let it take its turn; its answer, or None where it hung up."""
        messages = Messages(ANSWERS)
        link.sendall(raw)
        link.settimeout(0.01)
        until = time.monotonic() + 5.0
        while True:
            self.service.turn()
            try:
                piece = link.recv(1 << 20)
            except TimeoutError:
                assert time.monotonic() < until, "neither an answer nor a closed link"
                continue
            except ConnectionResetError:
                return None
            if not piece:
                return None
            for answer, payload in messages.feed(piece):
                return {**answer, "payload": payload}

    def ask(self, link: socket.socket, do: str, **data: Any) -> dict[str, Any] | None:
        """A request as an engine makes it."""
        return self.say(link, encode({"do": do, "at": time.monotonic(), **data}, ASKS))

    def armed(self) -> socket.socket:
        """An engine's link to the bench that it has armed."""
        link = self.link()
        assert "error" not in self.ask(link, "open")
        assert "error" not in self.ask(link, "arm", run="")
        assert self.guard.state is State.RUNNING
        self.rig.reported.clear()
        return link

    def until_over(self, within: float = 5.0) -> None:
        """Let it take its turns until the safe state is over."""
        until = time.monotonic() + within
        while self.guard.state not in {State.SAFE, State.TRIPPED}:
            self.service.turn()
            assert time.monotonic() < until
