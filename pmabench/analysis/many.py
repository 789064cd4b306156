"""Work on many runs or cells: in this process, by an executor of `concurrent.futures`, or on a Dask cluster.

Results do not depend on the number of workers: each item is processed alone, and its number is returned with it.
Standard library only; `distributed` is imported where a cluster is used.

Workers of a cluster read the runs and write the analyses themselves: they must see the same folders under the same
names, and have the same pmabench.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import suppress
from importlib import import_module
from typing import Any, Protocol, TypeVar

from pmabench.base.errors import UsageError
from pmabench.store.since import program

PATIENCE = 10.0
"""Time to wait for the scheduler, and for its first worker [s]."""


class Cluster:
    """The workers of a Dask scheduler at `address`, for instance `tcp://10.0.0.5:8786`."""

    def __init__(self, address: str) -> None:
        """Connect; raise UsageError without a scheduler or worker, or where a worker has another pmabench."""
        try:
            distributed: Any = import_module("distributed")
        except ImportError as error:
            raise UsageError("--cluster needs dask.distributed: pip install 'pmabench[cluster]'") from error
        try:
            self._client: Any = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            what = f"no Dask scheduler answers there within {PATIENCE:g} s"
            raise UsageError(f"--cluster {address}: {what} ({str(error).splitlines()[0]})") from error
        try:
            self.width = self._workers(address)
        except BaseException:
            self._client.close()
            raise
        self._executor: Executor = self._client.get_executor()

    def _workers(self, address: str) -> int:
        """Number of threads of all workers; raises UsageError where one cannot be used."""
        try:
            self._client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise UsageError(f"--cluster {address}: the scheduler has no worker") from error
        try:
            programs = self._client.run(program)
        except Exception as error:
            what = f"a worker cannot run pmabench ({str(error).splitlines()[0]})"
            raise UsageError(f"--cluster {address}: {what}; install the same version there") from error
        others = [worker for worker, found in programs.items() if found != program()]
        if others:
            what = f"has another pmabench or other libraries ({len(others)} of {len(programs)} workers)"
            raise UsageError(f"--cluster {address}: {others[0]} {what}; install the same versions there")
        return sum(self._client.nthreads().values())

    def executor(self) -> Executor:
        """The executor of the cluster, which replaces dead workers itself."""
        return self._executor

    def close(self) -> None:
        """Cancel what has not begun, and leave the cluster running."""
        self._executor.shutdown(wait=False)
        self._client.close()


BATCH = 50
"""Largest number of items submitted together."""
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
Thing = TypeVar("Thing")
Result = TypeVar("Result")


class Pool(Protocol):
    """Workers for `share`."""

    width: int
    """Number of parallel workers."""

    def executor(self) -> Executor:
        """A working executor; a new one where the last one broke."""

    def close(self) -> None:
        """Cancel what has not begun, and release the workers."""


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
        """Stop the workers after the item that each is working on."""
        self._stop.set()
        if self._executor is not None:
            self._executor.shutdown(wait=True, cancel_futures=True)


_stop: Any = None


def _begin(stop: Any) -> None:
    """Initialise a worker: it ignores Ctrl-C and stops when `stop` is set by its parent."""
    global _stop
    _stop = stop
    with suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def stopped() -> bool:
    """Whether this worker should skip the rest of its batch."""
    return _stop is not None and bool(_stop.is_set())


def share(
    things: Sequence[Thing],
    work: Callable[[Sequence[Thing]], list[Result]],
    lost: Callable[[Thing, str], Result],
    pool: Pool | None = None,
) -> Iterator[tuple[int, Result]]:
    """Yield number and result of each item as they are done; without a pool in order, in this process.

    `work` must be a function of a module, items and results plain data. The batches of a worker that fails are tried
    once more, item by item; `lost(item, reason)` gives the result of an item that fails again.
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
