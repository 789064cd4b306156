"""Resources of a process: file locks released by the kernel, limits, priority, user, installed extensions."""

from __future__ import annotations

import getpass
import os
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

GUARD, ENGINE = 20, 10
"""Real-time priorities: the guard has precedence over the engine, and both over every ordinary program."""


def real_time(priority: int) -> str:
    """Set real-time priority for this thread and those that it starts; returns why that failed, or an empty text."""
    if not hasattr(os, "sched_setscheduler"):
        return "this system has no real-time priority"
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
    except OSError as error:
        return f"real-time priority is not allowed for this user ({error.strerror})"
    return ""


def ordinary() -> None:
    """Set the priority of ordinary programs for this thread, and for what it starts from now on."""
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def keep_in_memory() -> None:
    """Prevent swapping of present memory, where allowed; memory allocated later may be swapped."""
    if sys.platform != "win32":
        import ctypes

        ctypes.CDLL(None).mlockall(1)  # MCL_CURRENT; with MCL_FUTURE a limit on locked memory would end the process


KEPT, AT_ONCE = 128 * 2**20, 32 * 2**20
"""Freed memory that a process keeps, and the smallest piece that is returned to the system when it is freed [bytes]."""


def keep_freed_memory() -> None:
    """Keep freed memory for the next array, if the C library can: each new page costs as much as the sum over it."""
    if option := _in_c("mallopt"):
        option(-1, KEPT)  # M_TRIM_THRESHOLD
        option(-3, AT_ONCE)  # M_MMAP_THRESHOLD


def give_back_memory() -> None:
    """Return freed memory to the system after much was read at once, if the C library can."""
    if trim := _in_c("malloc_trim"):
        trim(0)


def _in_c(name: str) -> Any:
    """A function of the C library of Linux; None on other systems, or where it has none."""
    if sys.platform != "linux":
        return None
    import ctypes

    return getattr(ctypes.CDLL(None), name, None)


def user_name() -> str:
    """Name of the user who runs this process."""
    with suppress(OSError, KeyError):
        return getpass.getuser()
    return "unknown"


def try_lock(path: Path) -> int | None:
    """Take the lock at `path`; returns the descriptor that holds it, or None if another process has it.

    The kernel releases it when the process ends, however it ends. It is not inherited by child processes.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o644)
    try:
        _lock(handle)
    except OSError:
        os.close(handle)
        return None
    return handle


def _lock(handle: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def limit_memory(size: int) -> None:
    """Limit the address space of this process to `size` bytes; no effect if the system has no such limit."""
    if sys.platform != "win32":
        import resource

        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        resource.setrlimit(resource.RLIMIT_AS, (size if hard < 0 else min(size, hard), hard))


def end_after_cpu(seconds: float) -> None:
    """End this process after this much more CPU time [s], in any state; 0 removes the limit."""
    if sys.platform != "win32":
        import signal

        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_PROF, seconds)


@cache
def installed() -> Any:
    """All entry points of all packages, read once per process, as that takes 15 ms."""
    from importlib.metadata import entry_points  # not in the guard, which needs none

    return entry_points()


def registered(group: str) -> EntryPoints:
    """Entry points of a group, of pmabench and of packages installed next to it."""
    found: EntryPoints = installed().select(group=group)
    return found
