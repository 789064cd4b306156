"""One owner per link: all calls of a device come from one thread, and waiting for each has a time limit."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from math import inf
from queue import SimpleQueue
from typing import Any

from pmabench.base.errors import DeviceError, PmaError

PATIENCE = 0.2
"""Time limit for a call of a device [s]."""


class Call:
    """A call that was given to an owner."""

    def __init__(self, act: Callable[[], Any]) -> None:
        self._act = act
        self.asked, self.ended = time.monotonic(), inf
        """When it was queued, and when it ended [s, monotonic]; inf before."""
        self.done = threading.Event()
        self.behind = False
        """Whether it is queued behind a call that is overdue."""
        self.result: Any = None
        self.error: Exception | None = None

    def run(self) -> None:
        """Make the call; keep its result, or the exception that it raises."""
        try:
            self.result = self._act()
        except Exception as error:  # belongs to the caller
            self.error = error
        self.ended = time.monotonic()
        self.done.set()

    def get(self, device: str) -> Any:
        """Result of the call; raises its exception, foreign types as a DeviceError of `device`."""
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
        """Make the call; it has ended on return."""
        call = Call(act)
        call.run()
        return call

    def wait(self, call: Call, within: float) -> Any:
        """Result of a call; raises its exception."""
        return call.get(self.name)

    def call(self, act: Callable[[], Any], within: float = PATIENCE) -> Any:
        """Make the call and return its result."""
        return self.submit(act).get(self.name)


class Owner:
    """The thread that makes all calls of one device."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._late: Call | None = None
        """The last call that exceeded its time limit."""
        self._last = Call(lambda: None)
        self._last.run()
        self._calls: SimpleQueue[Call] = SimpleQueue()
        threading.Thread(target=self._work, name=f"link-{name}", daemon=True).start()

    @property
    def _hangs(self) -> bool:
        return self._late is not None and not self._late.done.is_set()

    @property
    def idle(self) -> bool:
        """Whether all calls have ended."""
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
        """Queue the call and wait for its result; raises DeviceError if it takes longer than `within` [s].

        Earlier calls are first waited for, also for `within` [s]: a slow device may be busy with one.
        """
        if not self._last.done.wait(0.0 if self._hangs else within):
            self._late = self._last
            raise DeviceError(self.name, "has not answered yet what was asked before")
        return self.wait(self.submit(act), within)

    def wait(self, call: Call, within: float) -> Any:
        """Result of a call; raises DeviceError if it has not ended within `within` [s] from now."""
        if not call.done.wait(within):
            self._late = call
            raise DeviceError(self.name, f"did not answer within {within:g} s")
        return call.get(self.name)
