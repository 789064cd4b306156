"""Lines of text in a stream of bytes; knows no port and no protocol. Standard library only."""

from __future__ import annotations

LONGEST_LINE = 120


class Wrong(Exception):
    """A line that must never be taken for a measurement: another unit, a fault that the device reports."""


class Unreadable(Exception):
    """A line that is not what is expected: cut off, disturbed, something else."""


class Splitter:
    """Cuts a stream of bytes into lines; what comes before the first terminator is not a whole line and is dropped."""

    def __init__(self, terminator: bytes, *, whole: bool = False) -> None:
        self._terminator, self._whole = terminator, whole
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The whole lines that end in `data`; one that is too long is dropped up to its end."""
        *lines, self._rest = (self._rest + data).split(self._terminator)
        found = []
        for line in lines:
            if self._whole and len(line) <= LONGEST_LINE:
                found.append(line)
            self._whole = True
        if len(self._rest) > LONGEST_LINE + len(self._terminator):
            self._rest, self._whole = self._rest[-len(self._terminator) :], False
        return found


def readable(line: bytes) -> str:
    """The start of a line with only what can be printed, for messages."""
    return "".join(chr(byte) if 32 <= byte < 127 else "." for byte in line[:40])


def text_of(line: bytes) -> str:
    """A line as text; raises `Unreadable` where it is too long, or no ASCII."""
    if len(line) > LONGEST_LINE:
        raise Unreadable("a line longer than any that is expected")
    try:
        return line.decode("ascii")
    except UnicodeDecodeError:
        raise Unreadable(f'"{readable(line)}"') from None
