"""What a check found; plain data."""

from __future__ import annotations

from dataclasses import dataclass

PASSED, FAILED, NOT_APPLICABLE = "pass", "fail", "does not apply"


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
    """A call took too long; a computer that has much else to do can be the reason, so it must happen again to count."""


class NotApplicable(Exception):
    """The device has nothing of the kind; the text says what is missing."""
