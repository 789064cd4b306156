"""The next trial of a contraction test, or why there is none; used by `pmabench run --until` after each trial.

A decision depends on the record alone (trials and earlier decisions), so it is the same when repeated, also in a run
that continues another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pmabench.analysis.next_trial import (
    CONFIRM,
    FEWEST_FREEDOM,
    RANDOM,
    REFERENCE,
    REPEAT,
    SPREAD,
    SWEEP,
    Choice,
    Field,
    Goal,
    Step,
    choose,
    fewest,
    middle,
    out_of_reach,
    propose,
)
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.known import (
    Cell,
    Known,
    cell_key,
    cells_of,
    finished,
    known_after,
    missed_by,
    of_trials,
)
from pmabench.kinds.contraction_relaxation.values import name_of
from pmabench.store.records import Array, RunData, TrialData

FIRST_FIT = 8
"""Trials before the first fit."""
FIT_EVERY = 4
"""Trials from one fit to the next, or a fifth of those done, if that is more; in between their effect is predicted."""
REPEATS_FROM = 16
"""Number of trials after which cells are repeated until scatter can be distinguished from misfit."""
CONFIRMING = 3
"""Trials that had no part in the fit and must confirm it before a goal counts as reached."""
MISSED = 4.0
"""Limit of their mean square prediction error relative to noise and scatter; chance exceeds it in 1 of 150."""
CHANGE = 60.0
"""Time to change the load at the bench [s]."""
CHANGED = "plan-change"
"""Kind of the event that records a decision."""


@dataclass(frozen=True)
class Next:
    """A trial to be done."""

    trial: int
    """Its index."""
    like: int
    """Index of a trial of the plan in the same cell, whose steps are used."""
    role: str
    why: str
    """Reason in words: the value it improves, its interval now and as predicted."""
    predicted: Mapping[str, Any]
    """Symbol, pressure [Pa], half widths [SI] before and after."""
    point: Mapping[str, float] = field(default_factory=dict)
    repeat: int = 0
    reference: bool = False


@dataclass(frozen=True)
class Stop:
    """No more trials."""

    reached: bool
    why: str


@dataclass(frozen=True, eq=False)
class Proposal:
    """Trials worth adding after a run."""

    why: str
    """Why there are none: `reached`, `out of reach`, or a sentence; empty where there are some."""
    beyond: tuple[str, ...] = ()
    """Values whose goals cannot be reached, in words."""
    steps: tuple[Step, ...] = ()
    lines: tuple[tuple[str, Mapping[str, Any]], ...] = ()
    """Reason for each step, in words and as data."""
    cells: tuple[Cell, ...] = ()
    """Cells to which the steps refer."""

    def trials(self) -> list[int]:
        """Index of a trial of the plan in the cell of each step."""
        return [self.cells[step.choice.cell].trials[0] for step in self.steps]


@dataclass(frozen=True)
class Chooser:
    """Decisions about the trials of one plan."""

    plan: Mapping[str, Any]
    """As stored with the run."""
    expected: Mapping[str, Any] | None
    """`expected` of the specimen file as plain data [SI]."""
    goals: tuple[Goal, ...]
    seconds: float | None = None
    """Time limit for all trials together, including changes of load [s]."""
    fits: dict[tuple[str, ...], Known | Stop] = field(default_factory=dict, compare=False)
    """Cache of results by trial names: a fit takes a second."""
    targets: dict[tuple[object, ...], Array] = field(default_factory=dict, compare=False)
    """Cache of the trials needed in each cell, by wanted values and fitted trials."""

    @property
    def refusal(self) -> str:
        """Why trials of this plan cannot be chosen; empty where they can."""
        if (self.plan.get("settings") or {}).get("reduction"):
            return "trials of a protocol with the reduction of paper 1 cannot be chosen one by one"
        return ""

    def decide(self, runs: Sequence[RunData]) -> Next | Stop:
        """The decision after the trials of `runs`, each of which continues the one before."""
        course = Course.of(self, runs)
        if course.pending is not None:
            return course.pending
        fitted = self._fitted(course)
        known = self._known(runs, fitted)
        if not isinstance(known, Stop) and not course.held and len(fitted) < len(course.done):
            counts = self._confirmed_counts(known, course, fitted)
            if (known.halves(counts) <= known.aim.goal).all():
                fitted = course.done  # the goal should be reached: see
                known = self._known(runs, fitted)
        if isinstance(known, Stop):
            return known
        stop = self._misfit(known, runs, course, len(fitted)) or self._over(known, course)
        if stop is not None:
            return stop
        held = len(course.held)
        if held == CONFIRMING:
            after = self._confirmed(known, runs, course)
            if isinstance(after, Stop):
                return after
            return self._next(self._within_reach(after, course), course, course.done, "")
        if held:
            return self._next(known, course, fitted, CONFIRM)
        if known.freedom < FEWEST_FREEDOM:
            return self._next(known, course, fitted, REPEAT if len(course.done) >= REPEATS_FROM else "")
        near = self._within_reach(known, course)
        if len(fitted) == len(course.done) and near.reached(self._confirmed_counts(near, course, fitted)):
            return self._next(near, course, fitted, CONFIRM)
        return self._next(near, course, fitted, "")

    def propose(self, runs: Sequence[RunData], most: int) -> Proposal:
        """At most `most` further trials; those of the runs need not have been chosen one by one."""
        done = finished(runs)
        known = self._known(runs, done)
        if isinstance(known, Stop):
            return Proposal(known.why)
        counts = known.counts(done)
        if known.misfit and known.sure:
            return Proposal(f"nothing is promised: {known.misfit}")
        beyond = out_of_reach(known.outlook.design, known.aim, counts)
        if known.freedom < FEWEST_FREEDOM:  # until the scatter is known, trials may reach what calibration allows
            beyond = [n for n in beyond if known.aim.rest[n] > known.aim.goal[n]]
        far = (*(self._of(known, n, counts) for n in beyond), *self._unidentified(known))
        near = known.without(beyond)
        if near.freedom >= FEWEST_FREEDOM and near.reached(counts):
            return Proposal("reached", far)
        if not near.outlook.names:
            return Proposal("out of reach", far)
        cells, load = near.outlook.cells, done[-1].point.get("load") if done else None
        field = replace(self.field(cells), reference=None)
        seconds = np.inf if self.seconds is None else self.seconds
        steps = propose(near.outlook.design, near.aim, field, counts, len(done), load, most=most, seconds=seconds)
        lines = tuple(described(near, step.choice) for step in steps)
        return Proposal("", far, tuple(steps), lines, cells)

    def _fitted(self, course: Course) -> list[TrialData]:
        """The trials used in the fit."""
        if course.held:
            held = {trial.index for trial in course.held}
            return [trial for trial in course.done if trial.index not in held]
        return course.done[: _last_fit(len(course.done))]

    def _known(self, runs: Sequence[RunData], trials: Sequence[TrialData]) -> Known | Stop:
        """Knowledge of the coefficients from these trials, or why nothing can be chosen."""
        key = tuple(trial.name for trial in trials)
        if key not in self.fits:
            self.fits[key] = self._fit(runs, trials)
        return self.fits[key]

    def _fit(self, runs: Sequence[RunData], trials: Sequence[TrialData]) -> Known | Stop:
        known = known_after(cells_of(self.plan), self.goals, of_trials(runs, trials), self.expected)
        if known is None:
            return Stop(False, "nothing is known of this specimen: its file says nothing of what is expected")
        if not known.outlook.cells:
            return Stop(False, "no trial of this plan is expected to move its load")
        if not known.outlook.names:
            wanted = ", ".join(goal.symbol for goal in self.goals)
            return Stop(False, f"all trials of this plan together do not tell {wanted}")
        return known

    def _misfit(self, known: Known, runs: Sequence[RunData], course: Course, fitted: int) -> Stop | None:
        """Stop where the data contradict the form: with certainty in two fits, or still after as many trials as the
        sweep has.
        """
        if not known.misfit:
            return None
        lasting = len(course.done) >= sum(len(cell.trials) for cell in known.outlook.cells)
        if known.sure and not lasting:
            before = self._known(runs, course.done[: _last_fit(fitted - 1)])
            lasting = not isinstance(before, Stop) and bool(before.misfit) and before.sure
        return Stop(False, f"nothing is promised: {known.misfit}") if lasting else None

    def _over(self, known: Known, course: Course) -> Stop | None:
        """Stop for a reason other than a reached goal; else None."""
        counts = known.counts(course.done)
        if len(course.held) == CONFIRMING:
            return None
        if len(course.changes) >= len(self.plan["trials"]):
            return Stop(False, f"as many trials are done as the plan has; {self._far(known, counts)}")
        if self.seconds is not None and course.spent + min(cell.seconds for cell in known.outlook.cells) > self.seconds:
            return Stop(False, f"the time is over; {self._far(known, counts)}")
        judged = known.freedom >= FEWEST_FREEDOM and not course.held
        if judged and not self._within_reach(known, course).outlook.names:
            return Stop(False, f"out of reach: {self._far(known, counts)}")
        return None

    def _within_reach(self, known: Known, course: Course) -> Known:
        """`known` for the values whose goals further trials can reach; for all values during a misfit, since its
        correction widens intervals until it is certain or gone.
        """
        if known.misfit:
            return known
        return known.without(out_of_reach(known.outlook.design, known.aim, known.counts(course.done)))

    def _of(self, known: Known, number: int, counts: Array) -> str:
        """A value, its interval and its goal, in words."""
        goal, rest = float(known.aim.goal[number]), float(known.aim.rest[number])
        half = float(known.halves(counts)[number])
        size, wanted, by_rest = (_size(one, float(known.outlook.values[number])) for one in (half, goal, rest))
        fixed = f", {by_rest} of it by calibration, the sensors or their clocks" if rest > goal else ""
        symbol, P = known.outlook.names[number]
        has = "has" if known.parts((symbol, P)).combined else "is expected to have"
        return f"{name_of(symbol, P or None)} {has} {size} where {wanted} is wanted{fixed}"

    def _unidentified(self, known: Known) -> list[str]:
        """Wanted values that no number of these trials determines, in words."""
        goals = [goal for goal in self.goals if goal.symbol != SWEEP]
        return [
            f"{name_of(symbol, P or None)}: {e.note}"
            for (symbol, P), e in known.reported.items()
            if e.value is None
            and (symbol, P) not in known.outlook.names
            and any(goal.of((symbol, P), 1.0, 0.0) is not None for goal in goals)
        ]

    def _far(self, known: Known, counts: Array) -> str:
        """The value farthest from its goal, in words."""
        return self._of(known, int(np.argmax(known.halves(counts) / known.aim.goal)), counts)

    def _confirmed(self, before: Known, runs: Sequence[RunData], course: Course) -> Known | Stop:
        """Stop if the held-out trials confirm the goal or contradict the form; else the knowledge from all trials."""
        fitted = self._fitted(course)
        missed = missed_by(before, fitted, of_trials(runs, course.held))
        if missed > MISSED:
            text = f"trials that had no part in the fit are missed by {missed**0.5:.1f} times what noise and scatter"
            return Stop(False, f"nothing is promised: {text} explain")
        known = self._known(runs, course.done)
        if isinstance(known, Stop):
            return known
        near = self._within_reach(known, course)
        if known.misfit and known.sure:
            return Stop(False, f"nothing is promised: {known.misfit}")
        if not near.reached(known.counts(course.done)):
            return known
        trials = f"after {len(course.done)} trials, {CONFIRMING} of them to confirm it"
        beyond = self._unidentified(known)
        if len(near.outlook.names) < len(known.outlook.names):
            beyond.insert(0, self._far(known, known.counts(course.done)))
        if beyond:
            return Stop(False, f"reached as far as it can be, {trials}; out of reach: {beyond[0]}")
        return Stop(True, f"the goal is reached {trials}")

    def _confirmed_counts(self, known: Known, course: Course, fitted: Sequence[TrialData]) -> Array:
        """Trials in each cell with those that will confirm a goal, shape (cells,): they narrow intervals as well."""
        counts, field, load = known.counts(course.done), self.field(known.outlook.cells), course.load
        target = self._target(known, fitted)
        for number in range(len(course.changes), len(course.changes) + CONFIRMING):
            choice = choose(known.outlook.design, known.aim, field, counts, target, number, load, CONFIRM)
            counts[choice.cell] += 1
            load = field.places[choice.cell][0]
        return counts

    def _target(self, known: Known, fitted: Sequence[TrialData]) -> Array:
        key = (*known.outlook.names, *(trial.name for trial in fitted))
        if key not in self.targets:
            reference = self.field(known.outlook.cells).reference
            self.targets[key] = fewest(known.outlook.design, known.aim, known.counts(fitted), reference)
        return self.targets[key]

    def _next(self, known: Known, course: Course, fitted: Sequence[TrialData], only: str) -> Next:
        cells, counts = known.outlook.cells, known.counts(course.done)
        design, aim, field = known.outlook.design, known.aim, self.field(cells)
        target = self._target(known, fitted)
        choice = choose(design, aim, field, counts, target, len(course.changes), course.load, only)
        cell = cells[choice.cell]
        free = [index for index in cell.trials if index not in course.used]
        index = free[0] if free else max([len(self.plan["trials"]) - 1, *course.used]) + 1
        record = next(t for t in self.plan["trials"] if t["index"] == (index if free else cell.trials[0]))
        return Next(
            index,
            cell.trials[0],
            choice.role,
            *described(known, choice),
            dict(record["point"]),
            record["repeat"] if free else int(counts[choice.cell]),
            choice.role == REFERENCE or bool(free and record["reference"]),
        )

    def field(self, cells: Sequence[Cell]) -> Field:
        """The cells in the form that `choose` needs."""
        places = tuple((cell.load, cell.pressure) for cell in cells)
        wanted = {cell_key(t["point"]) for t in self.plan["trials"] if t["reference"]}
        reference = next((n for n, cell in enumerate(cells) if cell.key in wanted), None)
        return Field(
            places,
            np.array([cell.seconds for cell in cells]),
            CHANGE,
            middle(places) if reference is None else reference,
            str(self.plan["name"]),
        )


@dataclass(frozen=True)
class Course:
    """Decisions and trials so far."""

    changes: tuple[Mapping[str, Any], ...]
    """The decisions whose trials came to an end, in their order."""
    done: list[TrialData]
    """Trials that are finished."""
    pending: Next | None
    """The last decision, if its trial did not come to an end."""
    held: list[TrialData]
    """The last trials, held out to confirm that a goal is reached."""
    used: frozenset[int]
    """Trial indices in use."""
    load: float | None
    """Load of the last trial [N]."""
    spent: float
    """Time used [s]."""

    @classmethod
    def of(cls, chooser: Chooser, runs: Sequence[RunData]) -> Course:
        """From the records of runs that continue one another."""
        changes: dict[int, Mapping[str, Any]] = {}
        for run in runs:
            for event in run.events:
                if event.kind == CHANGED:
                    changes.setdefault(int(event.data["trial"]), event.data)
        ended = {t.index for run in runs for t in run.trials if t.status in ("finished", "failed", "excluded")}
        through = [change for index, change in changes.items() if index in ended]
        waiting = [change for index, change in changes.items() if index not in ended]
        cells = {cell.key: cell for cell in cells_of(chooser.plan)}
        spent, load = 0.0, None
        held: list[int] = []
        for change in through:
            cell = cells[cell_key(change["point"])]
            spent += cell.seconds + (CHANGE if cell.load != load else 0.0)
            load = cell.load
            if change["role"] == CONFIRM:
                held.append(int(change["trial"]))
            elif change["role"] != REFERENCE:
                held.clear()
        done = finished(runs)
        return cls(
            tuple(through),
            done,
            Next(**{name: waiting[-1][name] for name in FIELDS}) if waiting else None,
            [trial for trial in done if trial.index in held],
            frozenset(t.index for run in runs for t in run.trials),
            load,
            spent,
        )


def _last_fit(done: int) -> int:
    """Number of trials in the last fit when `done` trials are finished; 0 before the first."""
    number, after = 0, FIRST_FIT
    while after <= done:
        number, after = after, after + max(FIT_EVERY, after // 5)
    return number


FIELDS = ("trial", "like", "role", "why", "predicted", "point", "repeat", "reference")


ROLES = {
    REFERENCE: "reference trial, for drift",
    RANDOM: "drawn by lot, to show a misfit",
    REPEAT: "once more, to know how trials scatter",
    SPREAD: "the first trial at this load or pressure",
    CONFIRM: "not in the fit, to confirm the goal",
}


def described(known: Known, choice: Choice) -> tuple[str, Mapping[str, Any]]:
    """Reason for a trial, in words and as data."""
    name, value = known.outlook.names[choice.worst], float(known.outlook.values[choice.worst])
    cell = known.outlook.cells[choice.cell]
    change = f"{name_of(name[0], name[1] or None)}, {_size(choice.before, value)} to {_size(choice.after, value)}"
    where = f"{show(cell.load, 'force', 3)}, {show(cell.pressure, 'pressure', 4)}"
    data = {"symbol": name[0], "pressure": name[1], "before": choice.before, "after": choice.after, "value": value}
    return f"{where}: {ROLES.get(choice.role, change)}", data


def _size(half: float, value: float) -> str:
    """A half width, as a share of its value."""
    share = 100 * half / abs(value) if value else np.inf
    return f"{share:.2g} %" if share < 99.5 else "more than 100 %"
