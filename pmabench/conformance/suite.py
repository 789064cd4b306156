"""The table of checks, and the runs of them: one line each with its verdict and why."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from pmabench.base.errors import DeviceError
from pmabench.conformance import broken_wire, commands, following, life, samples, supervision, unopened
from pmabench.conformance.hostile import Battle
from pmabench.conformance.rig import Rig
from pmabench.conformance.subject import Subject
from pmabench.conformance.verdict import (
    FAILED,
    NOT_APPLICABLE,
    NOT_CHECKED,
    PASSED,
    Failed,
    Late,
    NotApplicable,
    NotChecked,
    Result,
)

CHECKS: dict[str, Callable[[Rig], str]] = {
    "interface": unopened.interfaces,
    "imports": unopened.light,
    "declares": unopened.declared,
    "options": unopened.options,
    "nobody there": unopened.nobody,
    "life": life.life,
    "samples": samples.samples,
    "values": samples.values,
    "set-points": commands.set_points,
    "valves": commands.valves,
    "inputs": commands.inputs,
    "from outside": commands.from_outside,
    "ramps": following.ramps,
    "halt": following.halts,
    "watchdog": supervision.watchdog,
    "held": supervision.held,
    "safe state": commands.safe_state,
    "second way": commands.second_way,
    "silence": broken_wire.silent,
    "late answers": broken_wire.late_answers,
    "line cut": broken_wire.hang_up,
    "exchanges": broken_wire.exchanges,
    "nothing left": broken_wire.nothing_left,
}
"""Name -> check; what it promises is the first line of its docstring."""
HOSTILE = "hostile answers"
ATTEMPTS = 3
"""A check in which a call is late is tried so often."""


def run(subject: Subject, *, hostile: int = 300, seed: int = 1, only: Collection[str] = ()) -> Iterator[Result]:
    """Every check of one device, or `only` some, each with a new emulator.

    `hostile` is how many pieces are damaged.
    """

    def battle(rig: Rig) -> str:
        """Damaged answers end in a sentence or a number, in time; no write is repeated."""
        rig.need_wire()
        return Battle(rig, hostile, seed).fight()

    checks = {**CHECKS, **({HOSTILE: battle} if hostile else {})}
    for name in only or checks:
        check = checks[name]
        promise = (check.__doc__ or "").strip().splitlines()[0]
        yield Result(name, promise, *_verdict(subject, check))


def _verdict(subject: Subject, check: Callable[[Rig], str], attempts: int = ATTEMPTS) -> tuple[str, str]:
    with tempfile.TemporaryDirectory(prefix="pmabench-conformance-") as folder:
        rig = Rig(subject.record, Path(folder), realtime=subject.realtime, wiring=subject.wiring)
        try:
            return PASSED, check(rig)
        except NotApplicable as reason:
            return NOT_APPLICABLE, str(reason)
        except NotChecked as reason:
            return NOT_CHECKED, str(reason)
        except Late as failure:
            if attempts == 1:
                return FAILED, f"{failure}, and so it was {ATTEMPTS} times"
        except Failed as failure:
            return FAILED, str(failure)
        except DeviceError as error:
            if attempts == 1:
                return NOT_CHECKED, f"the simulation that it is compared with does not answer: {error}"
        finally:
            rig.close()
    return _verdict(subject, check, attempts - 1)
