"""Opens files of a run folder for reading: regular files only, and only inside the folder. Standard library only.

A run folder may be copied from anywhere. A FIFO in it would hold a reader up for ever, a link to a device would never
end, and a link out of the folder would show what is no part of the run: none of them is opened.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from contextlib import suppress
from io import BufferedReader
from pathlib import Path

KINDS = {
    stat.S_IFREG: "a file",
    stat.S_IFDIR: "a folder",
    stat.S_IFLNK: "a link",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
_FLAGS = os.O_RDONLY
for _flag in ("O_BINARY", "O_CLOEXEC", "O_NOFOLLOW", "O_NONBLOCK", "O_NOCTTY"):  # which of them a system has differs
    _FLAGS |= getattr(os, _flag, 0)


def kind_of(mode: int) -> str:
    """What a mode of `lstat` means, in words."""
    return KINDS.get(stat.S_IFMT(mode), "something else than a file")


def is_regular(path: Path) -> bool:
    """Whether there is a regular file, not a link to one."""
    with suppress(OSError):
        return stat.S_ISREG(path.lstat().st_mode)
    return False


def open_regular(path: Path) -> BufferedReader:
    """The file, open for reading; raises OSError, at once, for whatever is no regular file."""
    _refuse(path.lstat().st_mode)  # before it is opened: opening a device may already do something
    fd = os.open(path, _FLAGS)
    try:
        _refuse(os.fstat(fd).st_mode)
        return os.fdopen(fd, "rb")
    except OSError:
        os.close(fd)
        raise


def open_inside(folder: Path, name: str) -> BufferedReader:
    """The file `name` (`/` between folders) of a run folder; raises OSError as `open_regular`, and for a way out."""
    place = folder
    parts = name.split("/")
    if not {"", ".", ".."}.isdisjoint(parts):
        raise OSError(errno.EINVAL, "its name leads out of the folder")
    for part in parts[:-1]:
        place /= part
        if place.is_symlink():
            raise OSError(errno.ELOOP, f"{part}/ is a link, and links are not followed")
    return open_regular(folder / name)


def sha256_of(path: Path) -> str:
    """Hash of a regular file's bytes; raises OSError as `open_regular`."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _refuse(mode: int) -> None:
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, f"it is {kind_of(mode)}, and only files are read")
