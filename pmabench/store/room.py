"""Room on the disk that a run keeps for its end, from before the first command on. Standard library only.

A disk that is full when a run ends would leave it without a seal, so without the cause and the result of the vent. Two
hidden files hold the room: `.seal.json.part` is overwritten in place and becomes the seal, so that nobody can take its
room away; `.events.jsonl.part` is deleted when the last events do not fit otherwise.
"""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path

from pmabench.store import folder as files
from pmabench.store.folder import part_of, sync_folder, write_whole
from pmabench.store.regular import is_regular

FOR_SEAL = 64 * 1024
"""Bytes; a seal is one hash a file, the cause, the counts and the result of each action of the vent: a tenth of it."""
FOR_EVENTS = 64 * 1024
"""Bytes; some hundred events."""


def keep_room(folder: Path) -> None:
    """Reserve the room for the end of a run in its folder. Raises OSError where there is not so much."""
    _reserve(part_of(folder / files.SEAL), FOR_SEAL)
    _reserve(part_of(folder / files.EVENTS), FOR_EVENTS)


def free_for_events(folder: Path) -> None:
    """Give the room for the last events back to the disk, for them. Harmless when repeated."""
    with suppress(OSError):
        part_of(folder / files.EVENTS).unlink()


def write_into_room(path: Path, content: bytes) -> None:
    """As `write_whole`, in the room that was kept for `path`, where there is some. Raises OSError."""
    part = part_of(path)
    if not is_regular(part):
        write_whole(path, content)
        return
    fd = os.open(part, os.O_WRONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0))
    try:
        _write_all(fd, content)
        os.ftruncate(fd, len(content))
        os.fsync(fd)
    finally:
        os.close(fd)
    part.replace(path)
    sync_folder(path.parent)


def _reserve(path: Path, size: int) -> None:
    """A file that has `size` bytes of the disk for itself."""
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
    try:
        if not _allocated(fd, size):
            _write_all(fd, os.urandom(size))  # zeros take no room where the file system compresses
        os.fsync(fd)
    finally:
        os.close(fd)


def _allocated(fd: int, size: int) -> bool:
    """Whether the system could reserve the room by itself; raises OSError where there is not so much."""
    if not hasattr(os, "posix_fallocate"):
        return False
    try:
        os.posix_fallocate(fd, 0, size)
    except OSError as error:
        if error.errno in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS, errno.ENODEV):
            return False
        raise
    return True


def _write_all(fd: int, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[os.write(fd, rest) :]
