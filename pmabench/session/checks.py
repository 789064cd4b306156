"""One line of the self-test's table, and the refusal that names what is wrong; plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pmabench.base.errors import VerdictFailed

OK, FAILED, NOT_MEASURED, NOT_CHECKED = "ok", "failed", "not measured", "not checked"


@dataclass(frozen=True)
class Check:
    """What was looked at, what was found, what is allowed; `hint` says where to look when it failed."""

    name: str
    value: str
    limit: str = ""
    verdict: str = OK
    hint: str = ""


class SelfTestFailed(VerdictFailed):
    """The bench is not fit for a run."""


def judged(name: str, value: str, limit: str, *, good: bool, hint: str) -> Check:
    """A check that is good or not."""
    return Check(name, value, limit, OK if good else FAILED, "" if good else hint)


def refuse(checks: Sequence[Check]) -> None:
    """Raise SelfTestFailed where a check has failed, with every hint."""
    failed = [check for check in checks if check.verdict == FAILED]
    if failed:
        reasons = "; ".join(f"{check.name} {check.value}: {check.hint}" for check in failed)
        raise SelfTestFailed(f"the self-test failed: {reasons}")
