"""Remaining trials of a run that ended early, and trials that are chosen one by one during a run.

To resume, bench, specimen and protocol must be unchanged. A chosen trial uses the steps of the plan's trial at the same
point: they were checked against all limits before the run, and the guard checks them again. The choosing function is
called after each trial, and knows nothing of a bench.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, Problem, invalid
from pmabench.bench.compile import Mounted
from pmabench.engine.executor import Executor
from pmabench.engine.run import Continues
from pmabench.protocol.plan import Ask, Plan, Record, Step, TrialRecord

CHANGES = ("bench", "calibration", "specimen", "protocol")
"""Inputs whose change can be accepted by name when a run is resumed."""


def continue_run(
    folder: Path, plan: Plan, mounted: Mounted, protocol_text: str, accept: Sequence[str] = ()
) -> Continues:
    """Prepare a new run of `plan` that continues the run in `folder`.

    A run whose writer died is first closed as interrupted. Raises InvalidFile where bench, calibrations, specimen or
    protocol have changed (unless accepted), where another run already continues it, or where no trial is left.
    """
    from pmabench.store.chain import continued, goes_on, open_chain
    from pmabench.store.folder import read_manifest

    manifest = read_manifest(folder)
    now = {**mounted.documents, "protocol.yaml": protocol_text, "plan.json": plan.to_json()}
    changed = sorted(set(_changes(manifest.get("snapshots", {}), now)))
    refused = [what for what in changed if what not in accept]
    if refused:
        what = "the {0} is not what it was in this run; begin a new one, or give --accept-changed {0}"
        raise InvalidFile([Problem(str(folder), 0, 0, what.format(one)) for one in refused])
    if (last := goes_on(folder)) is not None:
        what = f"{last.name} already goes on after this run, and its trials would be done twice; go on after that one"
        raise invalid(folder, f"{what}: pmabench run --resume {last}")
    link = continued(folder)
    done = set(link["trials_done"])
    chosen = bool(manifest.get("until"))
    steps = remaining(plan, done)
    if not chosen and not any(isinstance(step, Record) and step.trial is not None for step in steps):
        raise invalid(folder, "every trial of this run is finished: nothing is left to do")
    attempts: dict[int, int] = {}
    for run in open_chain(folder):
        for trial in run.trials:
            attempts[trial.index] = attempts.get(trial.index, 0) + 1
    again = max([len(plan.trials) - 1, *attempts]) + 1
    left = with_reference(plan, steps, again, alone=chosen)
    return Continues({**link, "accepted_changes": changed}, *left, attempts)


def _changes(then: Mapping[str, str], now: Mapping[str, str]) -> Iterable[str]:
    """Which inputs of a run differ, as words of `CHANGES`, one for each changed file.

    Files that the bench refers to, such as maps and plants, count as bench. bench.json is skipped: it contains the
    zeros.
    """
    for name in {*then, *now} - {"bench.json", "README.txt"}:
        digest = hashlib.sha256(now[name].encode()).hexdigest() if name in now else None
        if then.get(name) != digest:
            known = {"specimen.yaml": "specimen", "protocol.yaml": "protocol", "plan.json": "protocol"}
            yield "calibration" if name.startswith("calibrations/") else known.get(name, "bench")


def remaining(plan: Plan, done: set[int]) -> tuple[Step, ...]:
    """The plan's steps without those of finished trials.

    An operator request is kept if a trial remains before the next request, with the steps between it and the first
    trial after it (preconditioning, pressurising) and the steps right before each remaining trial. Preconditioning is
    always repeated: after a pause the specimen starts anew.
    """
    kept: list[Step] = []
    prepares = [step for step in plan.steps if step.phase == "precondition"]
    for part in _parts(plan.steps):
        trials = {step.trial for step in part if isinstance(step, Record) and step.trial is not None}
        if trials <= done and trials:
            continue
        left = _left_of(part, done)
        if not kept and not any(step.phase == "precondition" for step in left):
            asks = sum(isinstance(step, Ask) for step in left)
            left[asks:asks] = prepares
        kept += left
    return tuple(kept)


def with_reference(
    plan: Plan, steps: tuple[Step, ...], index: int, *, alone: bool = False
) -> tuple[tuple[Step, ...], TrialRecord | None]:
    """`steps` after a repeat of the plan's reference trial, with the number `index`; and that trial.

    It shows whether the specimen is still the same, and does not count as a trial of the plan. None where it is not
    needed: no trial left, no reference trial in the plan, or the first remaining trial is a reference trial. `alone`:
    without `steps`, for runs whose trials are chosen afterwards.
    """
    reference = next((trial for trial in plan.trials if trial.reference), None)
    first = next((step.trial for step in steps if isinstance(step, Record) and step.trial is not None), None)
    if alone:
        steps = ()
    elif first is None or next(trial for trial in plan.trials if trial.index == first).reference:
        return steps, None
    if reference is None:
        return steps, None
    before = steps_of(plan, reference.index, index)
    rest = [step for step in steps if step.phase != "precondition"]
    on = next((step.load for step in before if isinstance(step, Ask)), None)
    if rest and isinstance(rest[0], Ask) and rest[0].load == on:
        del rest[0]
    return (*before, *rest), replace(reference, index=index)


def steps_of(plan: Plan, like: int, index: int) -> list[Step]:
    """Steps of the plan's trial `like`, renumbered as trial `index`."""
    return [
        replace(step, trial=index) if isinstance(step, Record) and step.trial is not None else step
        for step in remaining(plan, {trial.index for trial in plan.trials} - {like})
    ]


def _left_of(part: Sequence[Step], done: set[int]) -> list[Step]:
    """The steps of one part without its finished trials."""
    kept: list[Step] = []
    gap: list[Step] = []
    inside: int | None = None
    first = True
    for step in part:
        if isinstance(step, Record) and step.on and step.trial is not None:
            inside = step.trial
            kept += gap if first or inside not in done else ()
            gap, first = [], False
        if inside is None:
            gap.append(step)
        elif inside not in done:
            kept.append(step)
        if isinstance(step, Record) and not step.on:
            inside = None
    return kept + gap


def _parts(steps: Sequence[Step]) -> list[list[Step]]:
    """The steps, split before each operator request that follows a trial."""
    parts: list[list[Step]] = [[]]
    for step in steps:
        if isinstance(step, Ask) and any(isinstance(other, Record) for other in parts[-1]):
            parts.append([])
        parts[-1].append(step)
    return parts


def sources(folder: Path) -> dict[str, Any]:
    """Source files of a run from its manifest: `protocol`, `bench`, `specimen`, `set`.

    Raises InvalidFile where it has no planned trials or does not name its sources.
    """
    from pmabench.store.folder import read_manifest

    manifest = read_manifest(folder)
    if not manifest.get("trials_planned"):
        what = f"is a run of kind {manifest.get('kind')} without trials: there is nothing to go on with"
        then = "run the protocol again, a session comes first by itself"
        raise invalid(folder, f"{what}; {then}")
    found = manifest.get("sources")
    if not isinstance(found, dict) or not {"protocol", "bench", "specimen"} <= set(found):
        raise invalid(folder, "does not say which files it was made from; name protocol, bench and specimen")
    return found


CHANGED, ENDED = "plan-change", "choice-end"
"""Kinds of events: a trial was chosen; the choice of trials ended."""


@dataclass(frozen=True)
class Chosen:
    """The next trial."""

    trial: TrialRecord
    like: int
    """Index of the plan's trial at the same point, whose steps are used."""
    why: str
    data: Mapping[str, Any]
    """Additional data of the event."""


@dataclass(frozen=True)
class NoMore:
    """The choice ends: no further trial."""

    reached: bool
    """Whether the goal of the choice was reached."""
    why: str


class Choosing:
    """Supplies an executor with the steps of one chosen trial after the other.

    `choose` returns the next trial from what is recorded; while it computes, it must call its argument repeatedly,
    which lets bench time pass.
    """

    def __init__(self, executor: Executor, choose: Callable[[Callable[[], None]], Chosen | NoMore]) -> None:
        self.executor, self.choose = executor, choose
        self.prepared = False
        self.load: tuple[float, float] | None = None
        self.before: int | None = None

    def __call__(self) -> Sequence[Step]:
        """The steps of the next trial; none at the end."""
        executor = self.executor
        if not self.prepared and executor.steps:  # a reference trial was repeated first
            self._take(executor.steps)
        answer = self.choose(self._wait)
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
        steps = steps_of(executor.plan, answer.like, trial.index)
        if self.prepared:  # no operator request if its load is already on
            steps = [s for s in steps if s.phase != "precondition" and not (_puts_on(s) and _puts_on(s) == self.load)]
        self._take(steps)
        return steps

    def _take(self, steps: Sequence[Step]) -> None:
        self.prepared = True
        self.load = next((load for step in steps if (load := _puts_on(step)) is not None), self.load)

    def _wait(self) -> None:
        self.executor.acquisition.pass_time(0.1)


def _puts_on(step: Step) -> tuple[float, float] | None:
    """The load (force [N], mass [kg]) that is put on by hand in a step; None for other steps."""
    return step.load if isinstance(step, Ask) else None
