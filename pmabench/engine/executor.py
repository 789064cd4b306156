"""The executor: runs the steps of a plan in order, with any clock; independent of devices and file formats."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import isfinite
from typing import Any

import numpy as np

from pmabench.base.clock import Clock
from pmabench.base.errors import Interrupted, LimitTripped, PmaError, VerdictFailed
from pmabench.base.quantities import highest_pressure, show, without_number
from pmabench.bench.interface import CompiledBench, Load
from pmabench.engine.acquire import Acquisition, Array, Samples
from pmabench.engine.bench_checks import LoadCheck, LoadImplausible
from pmabench.engine.commanded import Commander
from pmabench.engine.operator import Operator
from pmabench.engine.recorder import Recorder
from pmabench.engine.seek import run_control, run_seek
from pmabench.guard.remote import AnyGuard
from pmabench.protocol.plan import (
    HANDS_OUT,
    VENTED_WITHIN,
    Ask,
    Control,
    Follow,
    Hold,
    Plan,
    Ramp,
    Record,
    Seek,
    Set,
    Step,
    TrialRecord,
    WaitUntil,
)


@dataclass(frozen=True)
class Progress:
    """How far the run is; the data of a progress line."""

    step: int
    """Number of the current step, from 0."""
    steps: int
    trial: int | None
    trials: int
    t: float
    """Bench time [s]."""
    longest: float
    """Longest bench time still to come [s]."""
    phase: str


class TrialFailed(VerdictFailed):
    """A step reached its limit, and the plan demands that this counts as a failure."""


LIVE_EVERY = 1.0
"""Interval of events with the newest values while nothing is recorded in real time [s]; `watch` shows them."""
AT_ONCE = 1e-3
"""If the device takes longer than this to acknowledge a command [s], the time is recorded."""
LONGEST_HOLD = 60.0
"""Longest time that a limit may hold the bench before the run is ended [s]."""


@dataclass
class Executor:
    """Runs the steps of one plan: all of them, or those that remain after an interrupted run."""

    plan: Plan
    bench: CompiledBench
    guard: AnyGuard
    acquisition: Acquisition
    recorder: Recorder
    operator: Operator
    clock: Clock
    progress: Callable[[Progress], None] = lambda _progress: None
    steps: Sequence[Step] | None = None
    """The steps to run; None for all of the plan."""
    attempts: dict[int, int] = field(default_factory=dict)
    """Trial -> how often it was begun, including the runs that this one continues."""
    again: TrialRecord | None = None
    """The reference trial that is repeated because this run continues another one; not among the plan's trials."""
    further: Callable[[], Sequence[Step]] = tuple
    """Called after the last step for more steps; an empty answer ends the run."""
    beyond: dict[int, TrialRecord] = field(default_factory=dict)
    """Trials that were chosen during the run, by their index."""
    failed: list[int] = field(default_factory=list)
    """Trials that failed."""
    finished: set[int] = field(default_factory=set)
    """Trials that were completed, including those of the run that this one continues."""
    unloaded: bool = False
    """Whether the last request to the operator was to take off every load."""

    def __post_init__(self) -> None:
        self._trial: int | None = None
        self._trial_status = "finished"
        self._value: dict[str, float] = {}
        self._pause = self._repeat = False
        self._live = -LIVE_EVERY
        self._pressures = [c.name for c in self.bench.channels if without_number(c.name)[0] == "pressure"]
        self._pressures = self._pressures or ["pressure"]
        self._load = LoadCheck(self.bench)
        self._commander = Commander(self.guard, self.acquisition.commanded, self.clock, self._wait_while_held)
        self._act: dict[type[Step], Callable[[Any], None]] = {
            Set: self._set,
            Ramp: self._ramp,
            Follow: self._follow,
            Hold: self._hold,
            Record: self._record,
            WaitUntil: self._wait_until,
            Ask: self._ask,
            Seek: self._seek,
            Control: self._control,
        }

    def run(self) -> None:
        """Run all steps in order; raises whatever ends the run early."""
        steps = self.plan.steps if self.steps is None else self.steps
        left = sum(step.longest() for step in steps)
        number = 0
        after: int | None = None
        """Step right after the last trial; from here on a trial is repeated, without operator requests before it."""
        again: int | None = None
        """Step from which the last trial is repeated."""
        while True:
            self.acquisition.check()
            if self._trial is None and self._pause:
                self._stay_at_low_pressure()
            if self._repeat and self._trial is None and again is not None:
                self._repeat = False
                left += sum(repeated.longest() for repeated in steps[again:number])
                number = again
            if number == len(steps):
                more = self.further()
                if not more:
                    return
                steps, left = (*steps, *more), left + sum(step.longest() for step in more)
            step = steps[number]
            trial, phase = self._trial, step.phase
            if trial is not None and self._trial_of(trial) is self.again:
                trial, phase = None, "reference trial again"
            self.progress(Progress(number, len(steps), trial, len(self.plan.trials), self.clock.now(), left, phase))
            if isinstance(step, Ask) or step.phase == "precondition":
                after = None
            if isinstance(step, Record) and step.on and step.trial is not None:
                again = number if after is None else after
            self.do(step)
            left -= step.longest()
            number += 1
            if isinstance(step, Record) and not step.on:
                after = number

    def do(self, step: Step) -> None:
        """Execute one step."""
        self._act[type(step)](step)

    def handle_keys(self) -> None:
        """Handle the operator's keys: a note or a vent at once, a pause at the end of the trial.

        A repeat applies to the current trial, or between trials to the last one.
        """
        self._record_live()
        for what, text in self.operator.poll(self.acquisition.latest):
            if what == "note":
                self.event("note", text=text, trial=self._trial)
            elif text == "p":
                self._pause = not self._pause
                self.event("key", key="pause", on=self._pause)
            elif text == "r":
                self._repeat = not self._repeat and bool(self.attempts)
                self.event("key", key="repeat", on=self._repeat, trial=self._trial)
            elif text == "v":
                raise Interrupted("the operator (key v)", 130)

    def _record_live(self) -> None:
        """Record the newest values as an event while samples are not recorded; real time only."""
        if not self.bench.realtime or self.acquisition.recording:
            return
        now = self.clock.now()
        if now - self._live < LIVE_EVERY:
            return
        self._live = now
        values = {name: value for name, value in self.acquisition.latest.items() if isfinite(value)}
        if values:
            self.event("live", values=values)

    def _stay_at_low_pressure(self) -> None:
        """Keep the pressure at its safe value between trials until the operator resumes."""
        before = {o.name: self._value[o.name] for o in self.bench.pressures if o.name in self._value}
        self.event("pause", pressure=max(before.values(), default=None))
        for output in self.bench.pressures:
            if output.name in before:
                self._set(Set("pause", output.name, output.safe))
        while self._pause:
            self.acquisition.pass_time(0.1)
        self.event("goes-on")
        for name, value in before.items():
            self._set(Set("pause", name, value))

    def _wait_while_held(self) -> None:
        """Wait while a limit with action `hold` is exceeded; LimitTripped after `LONGEST_HOLD`."""
        until = self.clock.now() + LONGEST_HOLD
        while self.acquisition.holding:
            if self.clock.now() > until:
                outside = ", ".join(sorted(self.acquisition.holding))
                raise LimitTripped(f"held for {LONGEST_HOLD:g} s, and still outside: {outside}")
            self.acquisition.pass_time(0.05)

    def event(self, kind: str, **data: Any) -> None:
        """Record an event now."""
        self.recorder.event(kind, self.clock.now(), **data)

    def prompt(self, text: str, check: Callable[[], None] = lambda: None, **about: Any) -> str:
        """Ask the operator, with the question in the record; `check` may raise while bench time passes. The answer."""

        def wait() -> None:
            self.acquisition.pass_time(0.1)
            check()

        self.event("prompt", text=text, **about)
        return self.operator.ask(text, self.acquisition.latest, wait)

    def _command(self, step: Step, output: str, how: str, value: float, before: float, **data: Any) -> None:
        self.event(
            "command", output=output, type=how, value=value, before=before, phase=step.phase, trial=self._trial, **data
        )
        self._value[output] = value

    def _set(self, step: Set) -> None:
        self._wait_while_held()  # first: the record states when it was commanded, not when it was requested
        before = self._value.get(step.output, 0.0)
        sent = self.guard.value_sent(step.output, step.value)
        self._command(step, step.output, "set", step.value, before, sent=sent)
        begun = self.clock.now()
        self._commander.set(step.output, step.value)
        if (took := self.clock.now() - begun) > AT_ONCE:
            self.event("acknowledged", output=step.output, took=took, trial=self._trial)

    def _ramp(self, step: Ramp) -> None:
        self._wait_while_held()
        self._command(step, step.output, "ramp", step.to, step.origin, rate=step.rate)
        self._commander.ramp(step.output, step.origin, step.to, step.rate)
        self.acquisition.pass_time(step.longest())

    def _follow(self, step: Follow) -> None:
        self._wait_while_held()
        shape = {"amplitude": step.amplitude, "frequency": step.frequency, "cycles": step.cycles}
        self._command(step, step.output, "sine", step.mean, self._value.get(step.output, step.mean), **shape)
        self._commander.sine(step.output, step.mean, step.amplitude, step.frequency, step.cycles)
        self.acquisition.pass_time(step.longest())

    def _hold(self, step: Hold) -> None:
        self.acquisition.pass_time(step.duration, self._load.watch(), looks_only=True)
        verdict = self._load.verdict()
        if verdict is None:
            return
        numbers = {"expected": verdict.expected, "measured": verdict.measured, "tolerance": verdict.tolerance}
        self.event("load-check", **numbers, ok=verdict.ok, text=str(verdict), trial=self._trial)
        if verdict.gross or (not verdict.ok and self.bench.load_action == "stop"):
            raise LoadImplausible(str(verdict))

    def _record(self, step: Record) -> None:
        if step.on:
            self._trial, self._trial_status = step.trial, "finished"
            if step.trial is not None:
                trial = self._trial_of(step.trial)
                self.attempts[trial.index] = self.attempts.get(trial.index, 0) + 1
                self.event(
                    "trial-begin",
                    trial=trial.index,
                    point=dict(trial.point),
                    repeat=trial.repeat,
                    reference=trial.reference,
                    attempt=self.attempts[trial.index],
                    **({"again": True} if trial is self.again else {}),
                )
            self.acquisition.record(on=True)
            return
        ended = self.acquisition.catch_up()
        self.acquisition.record(on=False)
        if self._trial is not None:
            self.recorder.event("trial-end", ended, trial=self._trial, status=self._trial_status)
            if self._trial_status == "finished" and self._trial_of(self._trial) is not self.again:
                self.finished.add(self._trial)
        self._trial = None

    def _trial_of(self, index: int) -> TrialRecord:
        if self.again is not None and index == self.again.index:
            return self.again
        return self.beyond[index] if index in self.beyond else self.plan.trials[index]

    def end_trial(self, status: str) -> None:
        """Close the current trial when a run ends early."""
        if self._trial is not None:
            self.event("trial-end", trial=self._trial, status=status)
            self._trial = None

    def _wait_until(self, step: WaitUntil) -> None:
        holds: Callable[[Array], bool] = {
            "below": lambda span: span.max() < step.value,
            "above": lambda span: span.min() > step.value,
            "steady": lambda span: span.max() - span.min() <= step.value,
        }[step.comparison]
        window = max(1, round(step.window * self.acquisition.rate))
        kept = np.zeros(0)

        def reached(block: Samples) -> int | None:
            nonlocal kept
            values = block.values.get(step.channel)
            if values is None:
                return None
            start = len(kept)
            kept = np.concatenate((kept, values))
            for end in range(max(window, start + 1), len(kept) + 1):
                span = kept[end - window : end]
                if holds(span):
                    return end - start - 1
            kept = kept[-window:]
            return None

        if self.acquisition.pass_time(step.limit, reached) is None:
            quantity = next(c.quantity for c in self.bench.channels if c.name == step.channel)
            value = self.acquisition.latest.get(step.channel, float("nan"))
            waited = f"waited {step.limit:g} s for {step.channel} {step.comparison} {show(step.value, quantity)}"
            self._at_limit(step, step.at_limit, f"{waited}; it is at {show(value, quantity)}")

    def _at_limit(self, step: Step, at_limit: str, reason: str) -> None:
        self.event("limit-reached", phase=step.phase, trial=self._trial, reason=reason, then=at_limit)
        if at_limit == "flag":
            return
        if self._trial is None:
            raise TrialFailed(reason)
        self._trial_status = "failed"
        if self._trial not in self.failed:
            self.failed.append(self._trial)

    def _ask(self, step: Ask) -> None:
        if step.demands == "vented":
            below, what = self.bench.hands_below, "stayed above"
            for name in self._pressures:
                self._wait_until(WaitUntil(step.phase, name, "below", below, 0.1, VENTED_WITHIN, "flag"))
            self.guard.valves(closed=False)
        else:
            below, what = self._hands_at_pressure(), "is above this bench's"
        self._refuse_hands_above(below, what)
        refuse = partial(self._refuse_hands_above, below, "rose above")
        answer = self.prompt(step.text, refuse, phase=step.phase, demands=step.demands)
        self.event("answer", text=step.text, answer=answer, pressure=highest_pressure(self.acquisition.latest))
        if step.load is not None:
            self.guard.place(Load(*step.load))
            self.event("load", force=step.load[0], mass=step.load[1])
            self._load.put_on(step.load[0], step.text, self.acquisition.latest)
            self.unloaded = step.load[0] == 0
        self.acquisition.pass_time(HANDS_OUT)
        if step.demands == "vented":
            self.guard.valves(closed=True)

    def _hands_at_pressure(self) -> float:
        """Highest measured pressure for work by hand [Pa]: the bench's limit plus the uncertainty of the channel."""
        most = self.bench.hands_at_pressure
        known = [c.calibration for c in self.bench.channels if c.name in self._pressures]
        if not known or most == 0.0:
            return most
        return min(most * (1 + one.gain_uncertainty) + one.offset_uncertainty for one in known)

    def _refuse_hands_above(self, below: float, what: str) -> None:
        measured = max(self.acquisition.latest.get(name, float("inf")) for name in self._pressures)
        if not measured <= below:
            pressure = f"the measured pressure {show(measured, 'pressure')} {what} {show(below, 'pressure')}"
            raise PmaError(f"hands are not let in: {pressure}")

    def _seek(self, step: Seek) -> None:
        def log(how: str, value: float, before: float, **data: Any) -> None:
            self._command(step, step.output, how, value, before, **data)

        result = run_seek(step, self._commander, self.acquisition, log)
        self._value[step.output] = result.get("command", self._value.get(step.output, 0.0))
        self._found(step, result)

    def _control(self, step: Control) -> None:
        def log(**steered: Any) -> None:
            self.event("steered", phase=step.phase, trial=self._trial, **steered)

        result = run_control(step, self.bench, self._commander, self.acquisition, log)
        self._value |= result.get("commands", {})
        self._found(step, result)

    def _found(self, step: Seek | Control, result: Mapping[str, Any]) -> None:
        self.event("found", phase=step.phase, law=step.law, trial=self._trial, result=result)
        if not result.get("found", False):
            self._at_limit(step, step.at_limit, f"{step.phase}: {result.get('reason', 'nothing found')}")
