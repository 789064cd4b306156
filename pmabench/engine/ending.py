"""How a run ended, in the words of the record and as an exit code. Pure functions of the cause and of the vent."""

from __future__ import annotations

import traceback

from pmabench.base.errors import Interrupted, LimitTripped, PmaError, RecordError, VerdictFailed
from pmabench.guard.safe import Vent


def sentence(cause: BaseException) -> str:
    """What happened; a traceback where it is an error in the program."""
    if isinstance(cause, PmaError):
        return str(cause)
    return "".join(traceback.format_exception(cause))


def status_of(cause: BaseException | None) -> tuple[str, str]:
    """The run's status and why."""
    if cause is None:
        return "finished", ""
    if isinstance(cause, Interrupted):
        return "aborted", str(cause)
    if isinstance(cause, LimitTripped):
        return "tripped", str(cause)
    if isinstance(cause, VerdictFailed):
        return "failed", str(cause)
    if isinstance(cause, PmaError):
        return "error", str(cause)
    return "error", f"{type(cause).__name__}: {cause}"


def exit_code(cause: BaseException | None, lost: RecordError | None, vent: Vent) -> int:
    """When causes meet the worst wins: vent not confirmed, record lost, device, interrupted, verdict."""
    if not vent.confirmed or isinstance(cause, LimitTripped):
        return 5
    if lost is not None:
        return 7
    if cause is None:
        return 0
    return cause.exit_code if isinstance(cause, PmaError) else 1
