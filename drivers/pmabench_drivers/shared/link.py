"""Common part of links: a buffer of samples, a thread with absolute deadlines, turns on one line, lost answers.

Uses no connection. Standard library only.
"""

from __future__ import annotations

import errno
import math
import os
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
"""Longest wait for a thread to end [s]."""
PATIENCE = 0.25
"""Time for which ticks may fail until `collect` raises an error [s]; lost samples until then are a gap."""
BEHIND = 0.02
"""Largest delay of missed deadlines that are made up [s], at least the last one: a busy computer's stalls are short."""
DRIFT = 2e-4
"""Largest drift between the clocks of device and computer [1]."""
AHEAD = 0.3
"""Largest lead of a sample's time stamp over its arrival [s]."""
WINDOW = 1.0
"""Shortest time for which everything must be late [s]: a busy computer is late now and then."""
ENOUGH = 20
"""Smallest number of pieces that must arrive in that time."""


class Samples:
    """Samples of one stream, between the thread that takes them and the caller who collects them."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._lock = threading.Lock()
        self._last = -1
        self._clear()

    def _clear(self) -> None:
        self._time, self._host = array("q"), -1
        self._columns = [array("d") for _ in self._names]

    def append(self, time: int, values: Sequence[float], host: int) -> None:
        """Append one sample of all channels: `time` and `host` [ns, bench time], values in the order of the names."""
        with self._lock:
            self._last = max(time, self._last + 1)
            self._time.append(self._last)
            self._host = host
            for column, value in zip(self._columns, values, strict=True):
                column.append(value)

    def extend(self, first: int, columns: Sequence[array[float]], start: float, rate: float, host: float) -> None:
        """Append samples of a device that numbers them, from number `first` on.

        Number 0 was taken at `start`, the next ones at `rate` [Hz]; they arrived at `host` (both [s, bench time]).
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

    Deadlines missed because the computer was busy are made up as far as `BEHIND`; those missed in a `tick` that took
    longer than a period are not: a slow device rests, so that other calls get their turn.
    Deadlines that are not made up are counted.
    """

    def __init__(self, name: str, tick: Callable[[], None], clock: Clock) -> None:
        self._name, self._tick, self._clock = name, tick, clock
        self._halt = threading.Event()
        self._thread: threading.Thread | None = None
        self.missed = 0
        """Deadlines left out, because an earlier tick took too long."""
        self.broken: Exception | None = None
        """Exception that ended the thread."""
        self._failing: tuple[float, DeviceError] | None = None
        """Since when ticks fail [s, bench time], and the last reason."""

    def note(self, failure: DeviceError | None) -> None:
        """Error of this tick; None if it succeeded."""
        failing = self._failing
        self._failing = None if failure is None else (failing[0] if failing else self._clock.now(), failure)

    def refuse(self, device: str, doing: str = "polling", *, once: bool = False) -> None:
        """Raise DeviceError if the thread has ended, or its ticks have failed for longer than `PATIENCE`.

        `once`: a raised error is over, until it has lasted as long again.
        """
        if self.broken is not None:
            raise DeviceError(device, f"{doing} broke off: {self.broken}")
        failing = self._failing
        if failing is not None and self._clock.now() - failing[0] > PATIENCE:
            if once:
                self._failing = None
            raise failing[1]

    def start(self, rate: float) -> None:
        """Start the thread at `rate` [Hz]; an earlier one is stopped, and may still be in its last `tick`."""
        self.stop()
        self.missed = 0
        self._halt = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(rate, self._halt), name=self._name, daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the thread runs."""
        return self._thread is not None and self._thread.is_alive()

    def stop(self, wait: float = 0.0) -> None:
        """Start no further tick, and wait up to `wait` [s] for the present one; may be called again."""
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
            except Exception as error:  # raised at the next `collect`
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
    """Detects samples that lag behind their clock: for a second all arrive later than the quickest, by `slip` [s]."""

    def __init__(self, slip: float) -> None:
        self._slip = slip
        self._least, self._seen, self._begun = math.inf, -math.inf, -math.inf
        self._window: list[float] = []

    def behind(self, taken: float, now: float) -> float:
        """Lag of the samples [s], 0 if within `slip`; the newest, `taken` by its clock [s], arrived at `now` [s].

        Negative if samples arrive before their time.
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
"""First seconds in which the interval of lines is measured, and the part to leave out [s]: a buffer may be emptied."""
FEWER = 0.02
"""Allowed relative increase of the interval of lines, also by losses; a lag is forgotten as fast [1]."""


class Flow:
    """Detects lines without a clock that arrive later and later: fewer than at first, by `slip` [s] of them."""

    def __init__(self, slip: float) -> None:
        self._slip = slip
        self._arrived: list[float] = []
        self._period = self._behind = 0.0
        self._window: list[float] = []
        self._begun = self._before = -math.inf
        self.rate, self._count, self._since = 0.0, 0, 0.0
        """Lines a second, measured anew every `LEARNS` seconds after the first ones; 0 until then."""

    def behind(self, now: float) -> float:
        """Lag of the lines [s] when one arrives at `now` [s]; 0 if within `slip`."""
        if not self._period:
            self._arrived.append(now)
            if now - self._arrived[0] < LEARNS:
                return 0.0
            settled = [t for t in self._arrived if t >= self._arrived[0] + SETTLES]
            if len(settled) > ENOUGH:
                self._period = (1 + FEWER) * (now - settled[0]) / (len(settled) - 1)
                self._arrived, self._before = [], now
                self.rate, self._since = (1 + FEWER) / self._period, now
            return 0.0
        self._count += 1
        if now - self._since >= LEARNS and self._count > ENOUGH:
            self.rate, self._count, self._since = self._count / (now - self._since), 0, now
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
"""Whether the message to be sent is still wanted."""
BUSY = "the line was busy with another call until the deadline"


class Unanswered(DeviceError):
    """No answer came to a request that was sent: whether it was carried out is unknown."""


def always() -> bool:
    """Always wanted."""
    return True


def opened(link: T | None, device: str) -> T:
    """The link; raises DeviceError if there is none."""
    if link is None:
        raise DeviceError(device, "is not open")
    return link


@contextmanager
def turn(lock: threading.Lock, deadline: float, device: str, what: str = "", busy: str = BUSY) -> Iterator[None]:
    """Hold the lock of a line; raises DeviceError if it is not free by `deadline` [s, monotonic]."""
    if not lock.acquire(timeout=max(0.0, deadline - monotonic())):
        raise DeviceError(device, busy, what)
    try:
        yield
    finally:
        lock.release()


def who(
    maker: str, model: str, serial: str = "", firmware: str = "", *, clock: str = "own", answers: float = 0.0
) -> Identity:
    """An identity, simulated if its model says so."""
    return Identity(maker, model, serial, firmware, model.startswith(EMULATED), clock, answers)


GONE = (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.EIO)
"""Errors of a port that is not there, or no longer."""


def reason(error: Exception) -> str:
    """Why a port or a connection failed, in the words of the operating system if it has any.

    pyserial has the path twice in its own words, and says that of an unplugged port which returns no data.
    """
    number = getattr(error, "errno", None) or (errno.EIO if "returned no data" in str(error) else 0)
    if number in GONE:
        return f"{os.strerror(number)}: is it plugged in, and still at this address?"
    return getattr(error, "strerror", None) or str(error)


class Listening(ABC):
    """A link with a thread that passes on every received piece, with its time [s, bench time]."""

    def __init__(self, device: str, address: str, clock: Clock) -> None:
        self._device, self._address, self._clock = device, address, clock
        self._halt = threading.Event()
        self._thread: threading.Thread | None = None
        self.gone = ""
        """Why the link was lost while listening."""

    @abstractmethod
    def _receive(self) -> Any:
        """Bytes received within a short time, possibly none; raises OSError if the link is lost."""

    def listen(self, take: Callable[[Any, float], None]) -> None:
        """Start a thread that passes each piece to `take`."""
        self.hush()
        self.gone, self._halt = "", threading.Event()
        name, given = f"reads {self._device}", (take, self._halt)
        self._thread = threading.Thread(target=self._hand_on, args=given, name=name, daemon=True)
        self._thread.start()

    @property
    def listening(self) -> bool:
        """Whether a thread listens."""
        return self._thread is not None

    def hush(self) -> None:
        """Stop listening; may be called again."""
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
            except Exception as error:  # raised at the next call
                self.gone = f"reading {self._address} broke off: {error}"
                return
