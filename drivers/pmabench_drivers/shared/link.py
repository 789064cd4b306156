"""What links share: samples in a buffer, a thread with absolute deadlines, turns on one line, answers that did not
come.

Knows no wire. Standard library only.
"""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import floor
from time import monotonic
from typing import Any, TypeVar

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import EMULATED, Block, Identity

JOIN = 0.15
"""How long a thread is given to end, where that is waited for [s]."""
PATIENCE = 0.25
"""So long [s] ticks may fail before `collect` says so; what is lost till then is a gap in the samples."""
BEHIND = 0.02
"""Deadlines are made up that passed within so long [s], and always the last one: a busy computer's stalls are short."""
DRIFT = 2e-4
"""Largest drift between the clocks of device and computer [1]."""
AHEAD = 0.3
"""A sample may arrive at most so long before its own time stamp [s]."""
WINDOW = 1.0
"""Everything must be late for so long before it counts [s]: a busy computer is late now and then."""
ENOUGH = 20
"""And at least so many pieces must have arrived in that time."""


class Samples:
    """Samples of one stream between the thread that takes them and the caller who collects them."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._lock = threading.Lock()
        self._last = -1
        self._clear()

    def _clear(self) -> None:
        self._time, self._host = array("q"), -1
        self._columns = [array("d") for _ in self._names]

    def append(self, time: int, values: Sequence[float], host: int) -> None:
        """One sample of all channels: `time` and `host` [ns, bench time], values in the order of the names."""
        with self._lock:
            self._last = max(time, self._last + 1)
            self._time.append(self._last)
            self._host = host
            for column, value in zip(self._columns, values, strict=True):
                column.append(value)

    def extend(self, first: int, columns: Sequence[array[float]], start: float, rate: float, host: float) -> None:
        """Samples of a device that numbers them, from number `first` on.

        Number 0 was taken at `start`, the next ones at `rate` [Hz]; they came at `host` (both [s, bench time]).
        """
        origin, end = round(start * 1e9), first + len(columns[0])
        times = array("q", [origin + round(number * 1e9 / rate) for number in range(first, end)])
        with self._lock:
            self._time += times
            self._host = round(host * 1e9)
            for column, values in zip(self._columns, columns, strict=True):
                column += values

    def take(self) -> Block:
        """All samples since the last call."""
        with self._lock:
            block = Block(self._time, dict(zip(self._names, self._columns, strict=True)), self._host)
            self._clear()
        return block


class Cycle:
    """Calls `tick` in a thread at start + k / rate.

    Deadlines that passed while the computer did something else are made up as far as `BEHIND`; those that passed
    in a `tick` that took longer than a period are not: a slow device rests, so that others get their turn at it.
    What is not made up is counted.
    """

    def __init__(self, name: str, tick: Callable[[], None], clock: Clock) -> None:
        self._name, self._tick, self._clock = name, tick, clock
        self._halt = threading.Event()
        self._thread: threading.Thread | None = None
        self.missed = 0
        """Deadlines at which nothing was done, because what was before took too long."""
        self.broken: Exception | None = None
        """What ended the thread against its will."""
        self._failing: tuple[float, DeviceError] | None = None
        """Since when ticks fail [s, bench time], and the last reason."""

    def note(self, failure: DeviceError | None) -> None:
        """What went wrong in this tick; None where it went well."""
        failing = self._failing
        self._failing = None if failure is None else (failing[0] if failing else self._clock.now(), failure)

    def refuse(self, device: str, doing: str = "polling", *, once: bool = False) -> None:
        """Raise DeviceError where the thread has ended, or its ticks have failed for longer than `PATIENCE`.

        `once`: what was said counts as over, until it has lasted as long again.
        """
        if self.broken is not None:
            raise DeviceError(device, f"{doing} broke off: {self.broken}")
        failing = self._failing
        if failing is not None and self._clock.now() - failing[0] > PATIENCE:
            if once:
                self._failing = None
            raise failing[1]

    def start(self, rate: float) -> None:
        """Start the thread at `rate` [Hz]; an earlier one is ended, and may still be in its last `tick`."""
        self.stop()
        self.missed = 0
        self._halt = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(rate, self._halt), name=self._name, daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the thread lives."""
        return self._thread is not None and self._thread.is_alive()

    def stop(self, wait: float = 0.0) -> None:
        """Begin nothing more, and wait so long [s] for a `tick` under way; harmless when repeated."""
        thread, self._thread = self._thread, None
        self._halt.set()
        if thread is not None and wait:
            thread.join(wait)

    def _run(self, rate: float, halt: threading.Event) -> None:
        start, due, most = self._clock.now(), 0, max(1, floor(BEHIND * rate))
        while not halt.is_set():
            began = self._clock.now()
            try:
                self._tick()
            except Exception as error:  # the caller learns it at the next collect
                self.broken = error
                return
            due += 1
            ended = self._clock.now()
            made_up = most if (ended - began) * rate < 1.0 else 0
            lost = max(0, floor((ended - start) * rate) + 1 - due - made_up)
            self.missed += lost
            due += lost
            halt.wait(max(0.0, start + due / rate - self._clock.now()))


class Pace:
    """Detects samples that fall behind their clock: for a second all come later than the quickest, by `slip` [s]."""

    def __init__(self, slip: float) -> None:
        self._slip = slip
        self._least, self._seen, self._begun = math.inf, -math.inf, -math.inf
        self._window: list[float] = []

    def behind(self, taken: float, now: float) -> float:
        """How far samples are behind [s], 0 while all is well; the newest, `taken` by its clock [s], came `now` [s].

        Negative where samples come before their time.
        """
        late = now - taken
        self._least = min(self._least + DRIFT * max(0.0, min(now - self._seen, WINDOW)), late)
        self._seen = now
        if late < -AHEAD:
            return late
        if not self._window:
            self._begun = now
        self._window.append(late)
        if now - self._begun < WINDOW or len(self._window) < ENOUGH:
            return 0.0
        behind = min(self._window) - self._least
        self._window = []
        return behind if behind > self._slip else 0.0


LEARNS, SETTLES = 3.0, 1.0
"""How often lines come is learnt from the first seconds, without the very first [s]: a buffer may be emptied then."""
FEWER = 0.02
"""Lines may come so much more seldom than at first, or be lost, and it is forgotten as fast [1]."""


class Flow:
    """Detects lines that have no clock and come later and later: fewer come than at first, by `slip` [s] of them."""

    def __init__(self, slip: float) -> None:
        self._slip = slip
        self._arrived: list[float] = []
        self._period = self._behind = 0.0
        self._window: list[float] = []
        self._begun = self._before = -math.inf

    def behind(self, now: float) -> float:
        """How far lines are behind [s] when one comes at `now` [s]; 0 while all is well."""
        if not self._period:
            self._arrived.append(now)
            if now - self._arrived[0] < LEARNS:
                return 0.0
            settled = [t for t in self._arrived if t >= self._arrived[0] + SETTLES]
            if len(settled) > ENOUGH:
                self._period = (1 + FEWER) * (now - settled[0]) / (len(settled) - 1)
                self._arrived, self._before = [], now
            return 0.0
        self._behind = max(0.0, self._behind + now - self._before - self._period)
        self._before = now
        if not self._window:
            self._begun = now
        self._window.append(self._behind)
        if now - self._begun < WINDOW:
            return 0.0
        least, self._window = min(self._window), []
        return least if least > self._slip else 0.0


T = TypeVar("T")
Still = Callable[[], bool]
"""Whether what is about to be sent is still wanted."""
BUSY = "the line was busy with another call until the deadline"


class Unanswered(DeviceError):
    """No answer came to a question that was sent: whether it was carried out is not known."""


def always() -> bool:
    """Whether it is still wanted: yes."""
    return True


def opened(link: T | None, device: str) -> T:
    """The link, or an error where there is none."""
    if link is None:
        raise DeviceError(device, "is not open")
    return link


@contextmanager
def turn(lock: threading.Lock, deadline: float, device: str, what: str = "", busy: str = BUSY) -> Iterator[None]:
    """Hold the lock of a line; DeviceError if it is not free by `deadline` [s, monotonic]."""
    if not lock.acquire(timeout=max(0.0, deadline - monotonic())):
        raise DeviceError(device, busy, what)
    try:
        yield
    finally:
        lock.release()


def who(
    maker: str, model: str, serial: str = "", firmware: str = "", *, clock: str = "own", answers: float = 0.0
) -> Identity:
    """Who answered: simulated where its model says so."""
    return Identity(maker, model, serial, firmware, model.startswith(EMULATED), clock, answers)


def reason(error: Exception) -> str:
    """Why a port or a connection failed, in the words of the operating system where it has any."""
    return getattr(error, "strerror", None) or str(error)


class Listening(ABC):
    """A link with a thread that passes on every piece that arrives, with its time [s, bench time]."""

    def __init__(self, device: str, address: str, clock: Clock) -> None:
        self._device, self._address, self._clock = device, address, clock
        self._halt = threading.Event()
        self._thread: threading.Thread | None = None
        self.gone = ""
        """Why the link was lost while it was listened to."""

    @abstractmethod
    def _receive(self) -> Any:
        """What came within a short time, nothing in vain; OSError where the link is lost."""

    def listen(self, take: Callable[[Any, float], None]) -> None:
        """From now on a thread hands each piece to `take`."""
        self.hush()
        self.gone, self._halt = "", threading.Event()
        self._thread = threading.Thread(
            target=self._hand_on, args=(take, self._halt), name=f"reads {self._device}", daemon=True
        )
        self._thread.start()

    @property
    def listening(self) -> bool:
        """Whether somebody listens."""
        return self._thread is not None

    def hush(self) -> None:
        """Listen no more; harmless when repeated."""
        self._halt.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join(JOIN)

    def _hand_on(self, take: Callable[[Any, float], None], halt: threading.Event) -> None:
        while not halt.is_set():
            try:
                piece = self._receive()
            except (OSError, ValueError, TypeError) as error:  # ValueError, TypeError: it was closed meanwhile
                if not halt.is_set():
                    self.gone = f"lost {self._address}: {reason(error)}"
                return
            if not piece or halt.is_set():
                continue
            try:
                take(piece, self._clock.now())
            except Exception as error:  # the owner learns it at the next call
                self.gone = f"reading {self._address} broke off: {error}"
                return
