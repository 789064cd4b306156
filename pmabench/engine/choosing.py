"""Trials that are chosen while a run goes on; whoever chooses is asked after each trial, and knows nothing of a bench.

The steps of a choice are those that the plan has for a trial at the same point: whatever is chosen was checked against
all limits before the run, and is checked again by the guard.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from pmabench.engine.executor import Executor
from pmabench.engine.resume import remaining
from pmabench.protocol.plan import Ask, Plan, Record, Step, TrialRecord

CHANGED, ENDED = "plan-change", "choice-end"
"""Kinds of events: a trial that was chosen; why no other is."""


@dataclass(frozen=True)
class Chosen:
    """The next trial."""

    trial: TrialRecord
    like: int
    """Index of the plan's trial at the same point, whose steps are done."""
    why: str
    data: Mapping[str, Any]
    """What the event says besides."""


@dataclass(frozen=True)
class NoMore:
    """The end of the run."""

    reached: bool
    """Whether what was asked for is reached."""
    why: str


class Chooser(Protocol):
    """Chooses one trial after the other."""

    def choose(self, wait: Callable[[], None]) -> Chosen | NoMore:
        """The next trial, after all that is recorded; calls `wait` again and again while it takes time."""
        ...


class Choosing:
    """The steps of one trial after the other, as an executor asks for them."""

    def __init__(self, executor: Executor, chooser: Chooser) -> None:
        self.executor, self.chooser = executor, chooser
        self.prepared = False
        self.load: tuple[float, float] | None = None
        self.before: int | None = None

    def __call__(self) -> Sequence[Step]:
        """The steps of the next trial; none at the end."""
        executor = self.executor
        begun = executor.steps or ()
        if not self.prepared and begun:  # a reference trial was done again before
            self.prepared = True
            self.load = next((step.load for step in begun if isinstance(step, Ask) and step.load is not None), None)
        answer = self.chooser.choose(lambda: self._wait())
        now = executor.clock.now()
        if isinstance(answer, NoMore):
            executor.recorder.event(ENDED, now, reached=answer.reached, why=answer.why)
            return ()
        trial = answer.trial
        executor.beyond[trial.index] = trial
        executor.recorder.event(
            CHANGED, now, after=self.before, trial=trial.index, like=answer.like, point=dict(trial.point),
            repeat=trial.repeat, reference=trial.reference, why=answer.why, **answer.data,
        )  # fmt: skip
        self.before = trial.index
        steps = steps_of(executor.plan, answer.like, trial.index, self.load if self.prepared else None)
        if self.prepared:
            steps = [step for step in steps if step.phase != "precondition"]
        self.prepared = True
        self.load = next((step.load for step in steps if isinstance(step, Ask) and step.load is not None), self.load)
        return steps

    def _wait(self) -> None:
        self.executor.acquisition.pass_time(0.1)


def steps_of(plan: Plan, like: int, index: int, load: tuple[float, float] | None) -> list[Step]:
    """The steps of a plan's trial as those of the trial `index`; no hands where its load is on already."""
    steps = [
        replace(step, trial=index) if isinstance(step, Record) and step.trial is not None else step
        for step in remaining(plan, {trial.index for trial in plan.trials} - {like})
    ]
    return [step for step in steps if not (isinstance(step, Ask) and step.load is not None and step.load == load)]
