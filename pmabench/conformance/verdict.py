"""What a check found; plain data."""

from __future__ import annotations

from dataclasses import dataclass

PASSED, FAILED, NOT_APPLICABLE, NOT_CHECKED = "pass", "fail", "does not apply", "not checked"


@dataclass(frozen=True)
class Result:
    """One line of the suite: the check, its verdict, and a sentence that says why."""

    check: str
    promise: str
    verdict: str
    why: str


class Failed(Exception):
    """The driver breaks the promise; the text says how and what to do."""


class Late(Failed):
    """Something came too late, for which a busy computer can be the reason: it must happen again to count."""


class NotApplicable(Exception):
    """The device has nothing of the kind; the text says what is missing."""


class NotChecked(Exception):
    """Something could not be compared with an independent reference; the text says what, why, and what was compared."""
