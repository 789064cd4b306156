"""A Dask cluster as an executor of `concurrent.futures`; the extra `cluster` brings dask.distributed.

Workers read the runs and write the analyses themselves: they see the same folders under the same names, and have the
same pmabench. Its start-up script usually gives each worker `MALLOC_TRIM_THRESHOLD_=65536`, which hands memory back so
often that numpy takes twice as long.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import Executor
from importlib import import_module
from typing import Any

from pmabench.base.errors import UsageError
from pmabench.store.since import program

TRIM = "MALLOC_TRIM_THRESHOLD_"
SMALL_TRIM = 1_000_000
"""Bytes below which the allocator hands memory back all the time."""
PATIENCE = 10.0
"""Seconds to wait for the scheduler and for its first worker."""


class Cluster:
    """The workers of a Dask scheduler at `address`, for instance `tcp://10.0.0.5:8786`."""

    def __init__(self, address: str) -> None:
        """Raise UsageError where nobody answers, no worker is there, or one has another pmabench."""
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
        """Threads of all workers together."""
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

    def doubts(self) -> Iterator[str]:
        """What makes the workers slow, in words."""
        trims = [str(value) for value in self._client.run(os.environ.get, TRIM, "").values()]
        slow = sum(value.isdigit() and int(value) < SMALL_TRIM for value in trims)
        if slow:
            yield (
                f"{slow} of {len(trims)} workers run with {TRIM}={next(v for v in trims if v)}, which can halve the "
                "speed: start them with distributed.nanny.pre-spawn-environ set to another value (docs/many-runs.md)"
            )

    def executor(self) -> Executor:
        """The cluster, which replaces workers that die by itself."""
        return self._executor

    def close(self) -> None:
        """Take back what was not begun, and leave the cluster running."""
        self._executor.shutdown(wait=False)
        self._client.close()
