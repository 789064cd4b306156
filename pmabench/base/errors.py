"""The kinds of failure of the program, each with its exit code; independent of the code that raises them.

Exit codes: 0 done, 1 error in the program, 2 wrong usage, 3 a file is invalid, 4 device, communication or wiring,
5 limit, interlock or watchdog tripped, 6 done but a verdict failed, 7 the record could not be written,
130 interrupted by the operator, 143 by SIGTERM, 129 by SIGHUP.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass


class PmaError(Exception):
    """Any failure that pmabench explains in a sentence; its `exit_code` ends the command."""

    exit_code = 1


@dataclass(frozen=True, order=True)
class Problem:
    """One mistake at one place of a file; line and column count from 1, 0 = the whole file."""

    path: str
    line: int
    column: int
    message: str

    def __str__(self) -> str:
        """`path:line:column  message`, as editors understand it."""
        place = self.path if self.line == 0 else f"{self.path}:{self.line}:{self.column}"
        return f"{place}  {self.message}"


class UsageError(PmaError):
    """The command was called in a way that cannot work."""

    exit_code = 2


class InvalidFile(PmaError):
    """One or more files cannot be used; carries every problem found, not only the first.

    For instance a protocol with an unknown key, a CSV with a missing column, a truncated run.
    """

    exit_code = 3

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(sorted(problems))
        super().__init__("\n".join(str(problem) for problem in self.problems))


def invalid(path: object, message: str, line: int = 0, column: int = 0) -> InvalidFile:
    """An `InvalidFile` with a single problem."""
    return InvalidFile([Problem(str(path), line, column, message)])


@contextmanager
def reading(path: object) -> Iterator[None]:
    """Turns an OSError into an `InvalidFile` for the file at `path`, with the reason of the operating system."""
    try:
        yield
    except OSError as error:
        raise invalid(path, f"cannot be read: {error.strerror or error}") from error


class DeviceError(PmaError):
    """A device did not answer, answered wrongly or refused; with names of the device and the channel or output."""

    exit_code = 4

    def __init__(self, device: str, message: str, channel: str = "") -> None:
        self.device = device
        self.channel = channel
        self.message = message
        where = f"{device}.{channel}" if channel else device
        super().__init__(f"{where}: {message}")


class NotSent(DeviceError):
    """A command that is not carried out later: the driver refused to send it, or the device answered otherwise."""


class Busy(DeviceError):
    """The device answers that it does something else first; it may carry a command out later."""


class LimitRefused(PmaError):
    """A command outside a limit was requested; nothing was sent."""

    exit_code = 5


class LimitTripped(PmaError):
    """A measured value crossed its trip limit; the bench was driven to its safe state."""

    exit_code = 5


class VerdictFailed(PmaError):
    """The work was done, but a verdict on it failed, for instance a search that found nothing."""

    exit_code = 6


class RecordError(PmaError):
    """The record could not be written: full disk, no permission, input/output error."""

    exit_code = 7


class Interrupted(PmaError):
    """The operator or the operating system ended the run; `exit_code` is 128 + the signal's number."""

    def __init__(self, who: str, exit_code: int) -> None:
        self.who = who
        self.exit_code = exit_code
        super().__init__(f"ended by {who}")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """`; did you mean "..."?` with the most similar known name, or a list of them if none is similar."""
    names = sorted(known)
    return nearest(name, names) or (f"; known here: {', '.join(names)}" if names else "")


def nearest(name: str, known: Sequence[str]) -> str:
    """`; did you mean "..."?` with the nearest of the known names, nothing where none is near."""
    from difflib import get_close_matches  # 2 ms that only a mistake needs

    near = get_close_matches(name, known, n=1, cutoff=0.6)
    return f'; did you mean "{near[0]}"?' if near else ""
