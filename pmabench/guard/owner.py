"""One owner per link: all calls of a device come from one thread, and none is waited for longer than it may take."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from math import inf
from queue import SimpleQueue
from typing import Any

from pmabench.base.errors import DeviceError, PmaError

PATIENCE = 0.2
"""How long a call of a device may take [s]."""


class Call:
    """A call that was handed to an owner."""

    def __init__(self, act: Callable[[], Any]) -> None:
        self._act = act
        self.asked, self.ended = time.monotonic(), inf
        """When it was handed over, and when it was done [s, monotonic]."""
        self.done = threading.Event()
        self.behind = False
        """Whether it waits behind a call that did not come back in time."""
        self.result: Any = None
        self.error: Exception | None = None

    def run(self) -> None:
        """Make the call, and keep its result or what it raises."""
        try:
            self.result = self._act()
        except Exception as error:  # belongs to whoever asked for the call
            self.error = error
        self.ended = time.monotonic()
        self.done.set()

    def get(self, device: str) -> Any:
        """The result of the call; raises what it raised, foreign errors as a DeviceError of `device`."""
        if self.error is None:
            return self.result
        if isinstance(self.error, PmaError):
            raise self.error
        raise DeviceError(device, f"{type(self.error).__name__}: {self.error}") from self.error


class Direct:
    """Makes each call at once: virtual time, where no device can hang."""

    idle = True

    def __init__(self, name: str = "") -> None:
        self.name = name

    def submit(self, act: Callable[[], Any]) -> Call:
        """Make the call."""
        call = Call(act)
        call.run()
        return call

    def wait(self, call: Call, within: float) -> Any:
        """What came of a call."""
        return call.get(self.name)

    def call(self, act: Callable[[], Any], within: float = PATIENCE) -> Any:
        """Make the call and return its result."""
        return self.submit(act).get(self.name)


class Owner:
    """The thread that makes all calls of one device."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._late: Call | None = None
        """The last call that did not come back in time."""
        self._last = Call(lambda: None)
        self._last.run()
        self._calls: SimpleQueue[Call] = SimpleQueue()
        threading.Thread(target=self._work, name=f"link-{name}", daemon=True).start()

    @property
    def _hangs(self) -> bool:
        return self._late is not None and not self._late.done.is_set()

    @property
    def idle(self) -> bool:
        """Whether everything is done that was asked."""
        return self._last.done.is_set()

    def _work(self) -> None:
        while True:
            self._calls.get().run()

    def submit(self, act: Callable[[], Any]) -> Call:
        """Queue the call behind earlier ones."""
        call = self._last = Call(act)
        call.behind = self._hangs
        self._calls.put(call)
        return call

    def call(self, act: Callable[[], Any], within: float = PATIENCE) -> Any:
        """Have the call made and wait for it; raises DeviceError where it takes longer than `within` [s].

        What was asked before has as much time, too: a slow device may be at it.
        """
        if not self._last.done.wait(0.0 if self._hangs else within):
            self._late = self._last
            raise DeviceError(self.name, "has not answered yet what was asked before")
        return self.wait(self.submit(act), within)

    def wait(self, call: Call, within: float) -> Any:
        """What came of a call; raises DeviceError where it is not back within `within` [s] from now."""
        if not call.done.wait(within):
            self._late = call
            raise DeviceError(self.name, f"did not answer within {within:g} s")
        return call.get(self.name)
