"""The executor: runs the steps of a plan in order, whatever the clock; knows no device and no file format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pmabench.base.clock import Clock
from pmabench.base.errors import PmaError, VerdictFailed
from pmabench.base.quantities import show
from pmabench.bench.interface import CompiledBench, Load
from pmabench.engine.acquire import Acquisition, Recorder, Samples
from pmabench.engine.operator import Operator
from pmabench.engine.seek import run_seek
from pmabench.guard.guard import Guard
from pmabench.protocol.plan import (
    HANDS_OUT,
    VENTED_WITHIN,
    Ask,
    Follow,
    Hold,
    Plan,
    Ramp,
    Record,
    Seek,
    Set,
    Step,
    WaitUntil,
)


@dataclass(frozen=True)
class Progress:
    """Where the run is: all one needs to draw a line of progress."""

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
    """A step reached its limit and the plan says that the trial has failed then."""


@dataclass
class Executor:
    """Runs one plan once."""

    plan: Plan
    bench: CompiledBench
    guard: Guard
    acquisition: Acquisition
    recorder: Recorder
    operator: Operator
    clock: Clock
    progress: Callable[[Progress], None] = lambda _progress: None
    failed: list[int] = field(default_factory=list)
    """Trials that failed."""

    def __post_init__(self) -> None:
        self._trial: int | None = None
        self._trial_status = "finished"
        self._value: dict[str, float] = {}
        self._act: dict[type[Step], Callable[[Any], None]] = {
            Set: self._set,
            Ramp: self._ramp,
            Follow: self._follow,
            Hold: self._hold,
            Record: self._record,
            WaitUntil: self._wait_until,
            Ask: self._ask,
            Seek: self._seek,
        }

    def run(self) -> None:
        """All steps in order; raises whatever ends the run before its time."""
        left = sum(step.longest() for step in self.plan.steps)
        for number, step in enumerate(self.plan.steps):
            self.progress(
                Progress(
                    number, len(self.plan.steps), self._trial, len(self.plan.trials), self.clock.now(), left, step.phase
                )
            )
            self._act[type(step)](step)
            left -= step.longest()

    def _event(self, kind: str, **data: Any) -> None:
        self.recorder.event(kind, self.clock.now(), **data)

    def _command(self, step: Step, output: str, how: str, value: float, before: float, **data: Any) -> None:
        self._event(
            "command", output=output, type=how, value=value, before=before, phase=step.phase, trial=self._trial, **data
        )
        self._value[output] = value

    def _set(self, step: Set) -> None:
        before = self._value.get(step.output, 0.0)
        sent = self.guard.value_sent(step.output, step.value)
        self._command(step, step.output, "set", step.value, before, sent=sent)
        self.guard.set(step.output, step.value)

    def _ramp(self, step: Ramp) -> None:
        self._command(step, step.output, "ramp", step.to, step.origin, rate=step.rate)
        self.guard.ramp(step.output, step.origin, step.to, step.rate)
        self.acquisition.pass_time(step.longest())

    def _follow(self, step: Follow) -> None:
        self._command(
            step,
            step.output,
            "sine",
            step.mean,
            self._value.get(step.output, step.mean),
            amplitude=step.amplitude,
            frequency=step.frequency,
            cycles=step.cycles,
        )
        self.guard.sine(step.output, step.mean, step.amplitude, step.frequency, step.cycles)
        self.acquisition.pass_time(step.longest())

    def _hold(self, step: Hold) -> None:
        self.acquisition.pass_time(step.duration)

    def _record(self, step: Record) -> None:
        if step.on:
            self._trial, self._trial_status = step.trial, "finished"
            if step.trial is not None:
                trial = self.plan.trials[step.trial]
                self._event(
                    "trial-begin",
                    trial=trial.index,
                    point=dict(trial.point),
                    repeat=trial.repeat,
                    reference=trial.reference,
                )
            self.acquisition.record(on=True)
            return
        self.acquisition.record(on=False)
        if self._trial is not None:
            self._event("trial-end", trial=self._trial, status=self._trial_status)
        self._trial = None

    def end_trial(self, status: str) -> None:
        """Close the trial that is under way when a run ends early."""
        if self._trial is not None:
            self._event("trial-end", trial=self._trial, status=status)
            self._trial = None

    def _wait_until(self, step: WaitUntil) -> None:
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
                if (
                    (step.comparison == "below" and span.max() < step.value)
                    or (step.comparison == "above" and span.min() > step.value)
                    or (step.comparison == "steady" and span.max() - span.min() <= step.value)
                ):
                    return end - start - 1
            kept = kept[-window:]
            return None

        if self.acquisition.pass_time(step.limit, reached) is None:
            quantity = next(c.quantity for c in self.bench.channels if c.name == step.channel)
            value = self.acquisition.latest.get(step.channel, float("nan"))
            self._at_limit(
                step,
                step.at_limit,
                f"waited {step.limit:g} s for {step.channel} {step.comparison} {show(step.value, quantity)}; "
                f"it is at {show(value, quantity)}",
            )

    def _at_limit(self, step: Step, at_limit: str, reason: str) -> None:
        self._event("limit-reached", phase=step.phase, trial=self._trial, reason=reason, then=at_limit)
        if at_limit == "flag":
            return
        if self._trial is None:
            raise TrialFailed(reason)
        self._trial_status = "failed"
        if self._trial not in self.failed:
            self.failed.append(self._trial)

    def _ask(self, step: Ask) -> None:
        if step.demands == "vented":
            below = self.bench.hands_below
            wait = WaitUntil(step.phase, "pressure", "below", below, 0.1, VENTED_WITHIN, "flag")
            before = self.clock.now()
            self._wait_until(wait)
            if self.acquisition.latest.get("pressure", float("inf")) >= below:
                raise PmaError(
                    f"hands are not let in: the measured pressure stayed above {show(below, 'pressure')} "
                    f"for {self.clock.now() - before:.1f} s"
                )
        elif self.acquisition.latest.get("pressure", float("inf")) > self.bench.hands_at_pressure:
            most = show(self.bench.hands_at_pressure, "pressure")
            raise PmaError(f"hands are not let in: the measured pressure is above this bench's {most} for hands")
        self._event("prompt", text=step.text, phase=step.phase, demands=step.demands)
        answer = self.operator.ask(step.text, self.acquisition.latest)
        self._event("answer", text=step.text, answer=answer, pressure=self.acquisition.latest.get("pressure"))
        if step.load is not None:
            self.guard.place(Load(*step.load))
            self._event("load", force=step.load[0], mass=step.load[1])
        self.acquisition.pass_time(HANDS_OUT)

    def _seek(self, step: Seek) -> None:
        def log(how: str, value: float, before: float, **data: Any) -> None:
            self._command(step, step.output, how, value, before, **data)

        result = run_seek(step, self.guard, self.acquisition, self.clock, log)
        self._value[step.output] = result.get("command", self._value.get(step.output, 0.0))
        self._event("found", phase=step.phase, law=step.law, trial=self._trial, result=result)
        if not result.get("found", False):
            self._at_limit(step, step.at_limit, f"{step.phase}: {result.get('reason', 'nothing found')}")
