"""The start check of a bench, before the first pressure of a session: a table of checks; a failed one ends it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pmabench.base.errors import UsageError
from pmabench.base.quantities import show
from pmabench.bench.compile import Mounted
from pmabench.engine.acquire import Tripped
from pmabench.engine.executor import Executor, Progress
from pmabench.engine.operator import Operator
from pmabench.engine.run import Outcome
from pmabench.protocol.plan import Hold, Set
from pmabench.session.checks import NOT_MEASURED, Check, SelfTestFailed, at_rest, refuse, table, unchecked
from pmabench.session.guided import guided_run, put_on
from pmabench.session.several import EachMuscle
from pmabench.session.stepping import NO_LEAK, PHASE, Stepping, isolation, leaks
from pmabench.session.wiring import MOVED, Stage, Wiring

VALUES = ("range", "rate", "off-range")
"""Limits that are crossed by a wrong value; the others are about silence or time."""


class SelfTesting:
    """Every check of a session's self-test, in two parts: before the proof of the vent path, and after it.

    `report` gets the table so far, also after a failed check. Raises SelfTestFailed with the wire to look at.
    """

    def __init__(self, mounted: Mounted, report: Callable[[Sequence[Check]], None]) -> None:
        test = mounted.session.self_test if mounted.session is not None else None
        if test is None:
            name = mounted.bench.name
            raise UsageError(f'"{name}" declares no self-test; add "session: {{self_test: {{}}}}" to its file')
        self._mounted, self._test, self._report = mounted, test, report
        self._before = [_interlocks(mounted), _relief(mounted)]
        self._others: list[Check] = []
        self._leaks: dict[str, float] | None = None
        self._stepping: Stepping | None = None
        self._each = EachMuscle(mounted, test) if mounted.bench_file.muscles else None
        self._pressurises = any(output.name == "pressure" for output in mounted.bench.outputs)

    @property
    def checks(self) -> list[Check]:
        """The table so far; checks without a reference are added at the end."""
        claims = self._stepping.table() if self._stepping is not None else []
        each = self._each.checks if self._each is not None else []
        return [*self._before, *claims, *each, *self._others]

    def before_proof(self, executor: Executor) -> None:
        """First part, with any load: channels at rest, and the first small pressure, on which the proof relies."""
        with self._ending(executor, last=False):
            if self._each is not None:
                self._each.first(executor)
                return
            stepping = self._stepping = Stepping(executor, self._mounted, self._test)
            self._others = at_rest(self._mounted, stepping.rest(None), self._test.noise)
            refuse(self._others)
            broken = [claim for claim in stepping.wiring.claims(stepping.stages) if not claim.good]
            if any(name.startswith("pressure") for claim in broken for name in claim.wires):
                refuse(self.checks)
            if self._pressurises:
                stepping.first()

    def run(self, executor: Executor) -> None:
        """Second part: at rest without load, then under pressure, then with a hanging weight."""
        with self._ending(executor, last=True):
            if self._each is not None:
                self._each.run(executor)
                return
            stepping = self._stepping = self._stepping or Stepping(executor, self._mounted, self._test)
            self._run(executor, stepping)
            refuse(self.checks)
            self._others += unchecked(stepping.wiring, stepping.stages)

    @contextmanager
    def _ending(self, executor: Executor, *, last: bool) -> Iterator[None]:
        """Report the table after the last part, or after any part that failed, also by a limit."""
        try:
            yield
        except BaseException as error:
            if isinstance(error, Tripped) and error.trip.limit.kind in VALUES and self._stepping is not None:
                name = error.trip.limit.channel
                self._stepping.ended({name: executor.acquisition.latest[name]}, name)
            self._record(executor)
            raise
        if last:
            self._record(executor)

    def ended(self, outcome: Outcome) -> None:
        """Report what the channels read, if a limit ended the run before the first check."""
        if outcome.exit_code and self._each is None and self._stepping is None and outcome.extremes:
            means = {name: sum(ends) / 2 for name, ends in outcome.extremes.items()}
            limit = outcome.tripped
            tripped = limit.channel if limit is not None and limit.kind in VALUES else ""
            self._others = table(Wiring(self._mounted), [Stage(means, tripped=tripped)])
            self._report(self.checks)

    def _record(self, executor: Executor) -> None:
        checks = [asdict(check) for check in self.checks]
        leaks = {"leaks": self._each.leaks} if self._each is not None else {}
        executor.event("self-test", checks=checks, leak=self._leaks, **leaks)
        self._report(self.checks)

    def _run(self, executor: Executor, stepping: Stepping) -> None:
        mounted, test = self._mounted, self._test
        weights = mounted.bench_file.weights
        if weights is not None:
            put_on(executor, mounted, PHASE, 0.0)
            stepping.rest(0.0)
        if not self._pressurises:
            return
        if weights is not None and test.load is not None:
            put_on(executor, mounted, PHASE, test.load)
            stepping.rest(test.load * mounted.bench.gravity)
        stepping.drive()
        stepping.run(self._others)
        refuse(self._others)
        hung = stepping.hanging()
        self._others += [] if hung is None else [hung]
        refuse(self.checks)
        self._others.append(self._leak(executor))

    def _leak(self, executor: Executor) -> Check:
        """Rate of pressure fall with the isolation valve shut, if the safe state shuts that valve."""
        if not isolation(self._mounted):
            return NO_LEAK
        executor.do(Set(PHASE, "pressure", self._test.points[-1]))
        executor.do(Hold(PHASE, self._test.settle))
        hint = "look at hoses, fittings and the muscle between the isolation valve and its end"
        [(check, self._leaks)] = leaks(executor, self._mounted, self._test, {"pressure": ("leak", hint)})
        return check


def run_self_test(
    mounted: Mounted,
    operator: Operator,
    out: Path | None,
    *,
    operator_name: str = "",
    report: Callable[[Sequence[Check]], None],
    progress: Callable[[Progress], None] = lambda _progress: None,
) -> Outcome:
    """Run only the self-test, as a run of kind `self-test`; raises UsageError if the bench file declares none."""
    test = SelfTesting(mounted, report)

    def procedure(executor: Executor) -> None:
        executor.acquisition.record(on=True)
        test.run(executor)

    more: dict[str, Any] = {"out": out, "operator_name": operator_name, "progress": progress}
    name = f"self-test of {mounted.bench.name}"
    outcome = guided_run(mounted, operator, "self-test", name, procedure, before_proof=test.before_proof, **more)
    test.ended(outcome)
    return outcome


def refuse_backwards(executor: Executor, rest: float) -> None:
    """Raise SelfTestFailed if the displacement has fallen under pressure from `rest` [m], its value without."""
    change = executor.acquisition.latest["displacement"] - rest
    if change < -MOVED:
        channel = next(c for c in executor.bench.channels if c.name == "displacement")
        raise SelfTestFailed(
            f"the displacement falls by {show(-change, 'length', 3)} under the pressure of the warm-up: the sign of "
            "the contraction is wrong: swap the wires of "
            f"{channel.device}.{channel.input}, or the ends of its calibration"
        )


def _interlocks(mounted: Mounted) -> Check:
    """A line for the interlocks: all are closed, since arming refuses a bench with an open one."""
    names = [interlock.name for device in mounted.bench.devices for interlock in device.interlocks]
    if not names:
        return Check("interlocks", "", "", NOT_MEASURED, "none on this bench")
    return Check("interlocks", f"{', '.join(names)} closed", "all closed")


def _relief(mounted: Mounted) -> Check:
    """Line for the relief valve: not tested here; a bench file with one that opens too late is refused."""
    opens, never = mounted.bench_file.air.relief_valve, mounted.specimen_file.limits.pressure.never_above
    if opens == "none":
        return Check("relief valve", "", "", NOT_MEASURED, "none on this bench")
    value = f"opens at {show(float(opens), 'pressure')} (bench file)"
    return Check("relief valve", value, f"below {show(never, 'pressure')}")
