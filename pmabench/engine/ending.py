"""How a run ends: signals, the status in the record, the exit code, and a check of the zeros after the vent.

Knows no session.
"""

from __future__ import annotations

import signal
import time
import traceback
from types import FrameType, TracebackType
from typing import Any

import numpy as np

from pmabench.base.errors import Interrupted, LimitTripped, PmaError, RecordError, VerdictFailed
from pmabench.base.quantities import without_number
from pmabench.engine.acquire import Acquisition, Samples
from pmabench.guard.safe import Vent

_NAMES = {"SIGINT": "Ctrl-C", "SIGTERM": "SIGTERM", "SIGHUP": "SIGHUP (terminal closed)"}
SPAN = 0.3
"""Averaging time of the zero check [s]."""
LONGEST = 5.0
"""Longest wait for the readings to settle [s]."""
SET = 1.0
"""Change of the time of day relative to the monotonic clock above which it was set [s]."""


class Signals:
    """While entered, SIGINT, SIGTERM and SIGHUP become an `Interrupted` at the next `check`.

    While `waiting` (for a person to type) they are raised at once. After `shut` they are only counted: the safe state
    has begun and nothing cancels it; further signals only shorten its waits (`hurry`).
    """

    def __init__(self) -> None:
        self.pending: list[int] = []
        self.waiting = False
        self._shut = False
        self._acted_on = self._before_shut = 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Signals:
        """Install the handlers; outside the main thread, where Python does not allow it, nothing is changed."""
        for name in _NAMES:
            number = getattr(signal, name, None)
            if number is None:
                continue
            try:
                self._before[number] = signal.signal(number, self._note)
            except ValueError:
                return self
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Restore the former handlers."""
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.pending.append(number)
        if self.waiting and not self._shut:
            self.check()

    def check(self) -> None:
        """Raise Interrupted for a signal that came and was not yet acted on."""
        if len(self.pending) > self._acted_on and not self._shut:
            number = self.pending[self._acted_on]  # the first is the cause
            raise Interrupted(_NAMES[signal.Signals(number).name], 128 + number)

    def news(self) -> bool:
        """Whether a signal has come since the last call; all signals so far then count as acted on."""
        before, self._acted_on = self._acted_on, len(self.pending)
        return self._acted_on > before

    @property
    def gently(self) -> bool:
        """Whether the only signal was one Ctrl-C, which asks for a controlled stop before the safe state."""
        return self.pending == [signal.SIGINT]

    def shut(self) -> None:
        """From now on only count signals."""
        self._shut, self._before_shut = True, len(self.pending)

    def hurry(self) -> int:
        """Which waits of the safe state new signals end: 0 none, 1 ramps and holds, 2 that for confirmations too.

        A first Ctrl-C (or closed terminal) in the safe state ends ramps and holds only: the operator wants it quick,
        and still wants to know how it ends. Who sends a second one, or SIGTERM, wants the program to end.
        """
        if not self.news():
            return 0
        late = self.pending[self._before_shut :]
        return 2 if len(late) > 1 or signal.SIGTERM in late else 1


def ahead() -> float:
    """Difference of the time of day from the monotonic clock [s]."""
    return time.time() - time.monotonic()


def clock_set(before: float) -> str:
    """Text that the time of day was set since its difference was `before` [s]; empty where it was not."""
    moved = ahead() - before
    if abs(moved) <= SET:
        return ""
    way = "forward (or it slept)" if moved > 0 else "back"
    return (
        f"this computer's clock was set {way} by {abs(moved):.1f} s in the run: the time of day of its begin and that "
        "of its end do not belong together; times of samples do not depend on it"
    )


def sentence(cause: BaseException) -> str:
    """The message of the error; a traceback for an error in the program."""
    if isinstance(cause, PmaError):
        return str(cause)
    return "".join(traceback.format_exception(cause))


def status_of(cause: BaseException | None) -> tuple[str, str]:
    """Status of the run, and the reason (empty if it finished)."""
    if cause is None:
        return "finished", ""
    kinds = {Interrupted: "aborted", LimitTripped: "tripped", VerdictFailed: "failed", PmaError: "error"}
    for kind, status in kinds.items():
        if isinstance(cause, kind):
            return status, str(cause)
    return "error", f"{type(cause).__name__}: {cause}"


def exit_code(cause: BaseException | None, lost: RecordError | None, vent: Vent) -> int:
    """Exit code of the run: 5 if the vent is not confirmed or a limit tripped, else 7 if the record is lost.

    Otherwise the code of the cause, 0 without one.
    """
    if not vent.confirmed or isinstance(cause, LimitTripped):
        return 5
    if lost is not None:
        return 7
    if cause is None:
        return 0
    return cause.exit_code if isinstance(cause, PmaError) else 1


def zero_check(acquisition: Acquisition, zeroed: tuple[str, ...], *, unloaded: bool) -> dict[str, dict[str, Any]]:
    """Mean `reading` of each zeroed channel [SI]; also its `drift` where the true value is zero again, else None.

    This holds for a vented pressure, and for the force if every load was taken off; for the displacement it is unknown.
    """
    deadline = acquisition.clock.now() + LONGEST
    means, noise = _means(acquisition, zeroed)
    while acquisition.clock.now() < deadline:
        before, (means, noise) = means, _means(acquisition, zeroed)
        if all(abs(mean - before[name]) <= noise[name] for name, mean in means.items() if name in before):
            break
    found: dict[str, dict[str, Any]] = {}
    for name, mean in means.items():
        at_zero = without_number(name)[0] == "pressure" or (name == "force" and unloaded)
        found[name] = {"reading": mean, "drift": mean if at_zero else None}
    return found


def _means(acquisition: Acquisition, names: tuple[str, ...]) -> tuple[dict[str, float], dict[str, float]]:
    """Mean and standard deviation of each channel over the next `SPAN` [SI]; channels without samples are left out."""
    kept: dict[str, list[float]] = {name: [] for name in names}

    def keep(block: Samples) -> None:
        for name in names:
            if name in block.values:
                kept[name].extend(float(value) for value in block.values[name])

    acquisition.pass_time(SPAN, keep)
    values = {name: column for name, column in kept.items() if column}
    means = {name: float(np.mean(column)) for name, column in values.items()}
    return means, {name: float(np.std(column)) + 1e-12 for name, column in values.items()}
