"""Work on many things at once, in this process or by an executor of `concurrent.futures`; knows no runs.

The order of results, and what they are, never depend on how many work at once: each thing is worked on alone, and its
number goes with it. Standard library only.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import suppress
from typing import Any, Protocol, TypeVar

BATCH = 50
"""Most things that are handed over together: handing over costs less than work, and a batch is soon done."""
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
Thing = TypeVar("Thing")
Result = TypeVar("Result")


class Pool(Protocol):
    """Who does the work."""

    width: int
    """How many work at once."""

    def executor(self) -> Executor:
        """An executor that takes work; a new one where the last one broke."""

    def close(self) -> None:
        """Take back what was not begun, and let go."""


class Processes:
    """Worker processes of this machine, each with one thread for linear algebra."""

    def __init__(self, width: int) -> None:
        self.width = width
        self._executor: ProcessPoolExecutor | None = None
        self._context = multiprocessing.get_context("spawn")  # a fork would copy locks that other threads hold
        self._stop = self._context.Event()

    def executor(self) -> Executor:
        """The pool; a new one where a worker died."""
        if self._executor is not None:
            try:
                self._executor.submit(os.getpid).result()
                return self._executor
            except BrokenExecutor:
                self._executor.shutdown(wait=True, cancel_futures=True)
        os.environ.update(dict.fromkeys(THREADS, "1"))
        self._executor = ProcessPoolExecutor(self.width, self._context, _begin, (self._stop,))
        return self._executor

    def close(self) -> None:
        """Let the workers end what each has in hand."""
        self._stop.set()
        if self._executor is not None:
            self._executor.shutdown(wait=True, cancel_futures=True)


_stop: Any = None


def _begin(stop: Any) -> None:
    """In a worker: Ctrl-C is for the process that it works for, which says when to stop."""
    global _stop
    _stop = stop
    with suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def stopped() -> bool:
    """Whether a worker should leave the rest of its batch."""
    return _stop is not None and bool(_stop.is_set())


def share(
    things: Sequence[Thing],
    work: Callable[[Sequence[Thing]], list[Result]],
    lost: Callable[[Thing, str], Result],
    pool: Pool | None = None,
) -> Iterator[tuple[int, Result]]:
    """Number and result of each thing as they come; `work` is a function of a module, things and results plain data.

    Without a pool each is worked on here, in order. Where a worker dies, what it had in hand is tried once more, one
    by one; `lost` makes the result of a thing that ends its worker again, and of the reason.
    """
    if pool is None:
        for number, thing in enumerate(things):
            yield number, work([thing])[0]
        return
    size = max(1, min(BATCH, -(-len(things) // (4 * pool.width))))
    waiting = deque(range(start, min(start + size, len(things))) for start in range(0, len(things), size))
    suspects: list[int] = []
    while waiting:
        executor, running = pool.executor(), dict[Future[list[Result]], range]()
        broken = False
        while running or (waiting and not broken):
            while waiting and not broken and len(running) < 2 * pool.width:
                batch = waiting.popleft()
                try:
                    running[executor.submit(work, [things[number] for number in batch])] = batch
                except BrokenExecutor:
                    waiting.appendleft(batch)
                    broken = True
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                batch = running.pop(future)
                try:
                    yield from zip(batch, future.result(), strict=True)
                except Exception as error:
                    broken = broken or isinstance(error, BrokenExecutor)
                    suspects += batch
    for number in suspects:
        try:
            yield number, pool.executor().submit(work, [things[number]]).result()[0]
        except Exception as error:
            yield number, lost(things[number], str(error).splitlines()[0] if str(error) else type(error).__name__)
