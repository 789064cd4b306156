"""Common parts of all kinds of protocol: head of the file, loads, preparation, checks against the mounted bench.

The `accept` section has limits that results must meet; `process` applies them, and ends with exit code 6 where one is
not met.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema

from pmabench.base.errors import Problem
from pmabench.base.quantities import OF_A_MUSCLE, show
from pmabench.bench.compile import Mounted
from pmabench.bench.session import Stack
from pmabench.files.document import Document, Location, Strict, among, schema_of
from pmabench.files.quantity import Frequency, Pressure, Ratio, Time
from pmabench.protocol.plan import Ask, Hold, Plan, Set, Step, TrialRecord

if TYPE_CHECKING:
    from pmabench.protocol.sweep import Point

Coefficient = Literal["F_ce", "K", "B_c", "B_r", "B", "F_c", "K_u", "T_u"]
CheckName = Literal["repeat_spread", "first_repeat", "drift", "free_run", "held_out", "other_direction"]
COEFFICIENTS, CHECKS = get_args(Coefficient), get_args(CheckName)
OF_TRIALS = ("repeat_spread", "first_repeat", "drift")
"""Checks for kinds of test with one value per trial."""
OF_FIT = ("free_run", "held_out", "other_direction")
"""Checks of the fit to contraction and relaxation."""
IN_EXPECTED = ("F_ce", "K", "B_c", "B_r", "F_c")
"""Coefficients whose expected values a specimen file can give."""


def _above_zero(expected: str) -> AfterValidator:
    """Validator: a share must be above 0; `expected` ends the message."""

    def check(limit: float) -> float:
        if not limit > 0:
            raise ValueError(f"{show(limit, 'ratio')}: {expected}")
        return limit

    return AfterValidator(check)


Limit = Annotated[Ratio, _above_zero('a limit is above 0 %, for instance "5 %"')]


class Accept(Strict):
    """Limits of one coefficient, or of one check."""

    relative_interval: Annotated[Ratio, _above_zero('an interval must be > 0 %, for instance "5 %"')] | None = None
    """Largest half width of a coefficient's 95 % interval, as a share of its value."""
    of_specimen: Limit | None = None
    """Largest deviation of a coefficient from the specimen file's expected value, as a share of that."""
    at_most: Limit | None = None
    """Largest size of a check."""


Acceptance = dict[Coefficient | CheckName, Accept]


def measures_of(name: str) -> tuple[str, ...]:
    """Limits that an entry of the section can have."""
    return ("relative_interval", "of_specimen") if name in COEFFICIENTS else ("at_most",)


def check_acceptance(c: Compilation, accept: Acceptance, gives: tuple[str, ...], checks: tuple[str, ...]) -> None:
    """Note limits that cannot be applied: results that the kind of test does not give, and unsuitable limits."""
    kind = c.document.data.get("kind")
    for name, limits in accept.items():
        able = gives if name in COEFFICIENTS else checks
        if name not in able:
            nothing = f"gives nothing of the kind; it gives {', '.join(gives) or ', '.join(checks)}"
            wrong = f"does not give {name}; it gives {', '.join(able)}" if able else nothing
            c.fault(("accept", name), f'"{kind}" {wrong}', key=True)
            continue
        fitting = measures_of(name)
        expected = f"expected {' or '.join(fitting)}"
        measures = [measure for measure in Accept.model_fields if getattr(limits, measure) is not None]
        if not measures:
            c.fault(("accept", name), f"says no limit; {expected}", key=True)
        for measure in measures:
            if measure not in fitting:
                c.fault(("accept", name, measure), f"{name} has no {measure}; {expected}", key=True)
        if "of_specimen" in measures and name in COEFFICIENTS:
            _needs_expected(c, name)


def _needs_expected(c: Compilation, name: str) -> None:
    place: Location = ("accept", name, "of_specimen")
    if name not in IN_EXPECTED:
        c.fault(place, f"a specimen file does not give {name}; it can give {', '.join(IN_EXPECTED)}")
    elif c.mounted.specimen_file.expected is None:
        c.fault(place, 'the specimen file has no "expected" section to compare with')


def acceptance_for_plan(c: Compilation, accept: Acceptance) -> dict[str, Any]:
    """The section for the plan: largest relative interval by coefficient, and all `limits`; empty without a section."""
    if not accept:
        return {}
    widest = {str(name): limits.relative_interval for name, limits in accept.items()}
    widest = {name: interval for name, interval in widest.items() if interval is not None}
    return {**widest, "limits": list(_limits(c, accept))}


def _limits(c: Compilation, accept: Acceptance) -> Iterator[dict[str, Any]]:
    """Every limit: `what`, `measure`, `limit`, its `place` in the protocol, for `of_specimen` also `expected`.

    `expected` is a list of (pressure [Pa], value [SI]), or a single value without a pressure.
    """
    for name, limits in accept.items():
        for measure in Accept.model_fields:
            limit = getattr(limits, measure)
            if limit is None:
                continue
            where = c.document.problem(("accept", name, measure), "", key=True)
            place = f"{Path(where.path).name}:{where.line}" if where.line else Path(where.path).name
            entry = {"what": name, "measure": measure, "limit": limit, "place": place}
            expected = c.mounted.specimen_file.expected
            if measure == "of_specimen" and expected is not None and name in IN_EXPECTED:
                points = [(point.pressure, getattr(point, name)) for point in expected.points if name != "F_c"]
                entry["expected"] = sorted(points) or expected.F_c
            yield entry


OF_A_PLATFORM = ("acceleration_x", "acceleration_y", "acceleration_z", "turn_x", "turn_y")
RECORDED = (*OF_A_MUSCLE, "angle", "angle_command", "torque", "flow", *OF_A_PLATFORM)
"""Channels that a protocol can record."""
ChannelName = Annotated[
    str, BeforeValidator(among(RECORDED, OF_A_MUSCLE)), WithJsonSchema(schema_of(RECORDED, OF_A_MUSCLE))
]


class Needs(Strict):
    """Requirements on the bench."""

    free_end: Literal["weights", "actuator", "joint", "platform"]


class Precondition(Strict):
    """Unrecorded cycles before the first trial, so that the first repeat is like the others."""

    cycles: Annotated[int, Field(ge=0, le=1000)]
    pressure: Pressure
    hold: Time


class Prepare(Strict):
    """Preparation before the first trial."""

    precondition: Precondition | None = None
    rest: Time = 0.0
    """Rest without pressure between preconditioning and first trial; it increases the hysteresis at first."""


class ProtocolHead(Strict):
    """The part of a protocol that does not depend on its kind."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ()
    """Channels that the reduction of this kind needs."""
    gives: ClassVar[tuple[str, ...]] = ()
    """Coefficients that the reduction of this kind can give."""
    checks: ClassVar[tuple[str, ...]] = ()
    """Checks that the reduction of this kind makes in addition."""
    schema_: Annotated[Literal["pmabench.protocol/1"], Field(alias="schema")]
    name: Annotated[str, Field(max_length=120)]
    source: Annotated[str, Field(max_length=400)]
    needs: Needs
    sample_rate: Annotated[Frequency, Field(ge=10, le=1e6)]
    record: Annotated[list[ChannelName], Field(min_length=1)]
    prepare: Prepare = Prepare()
    accept: Acceptance = {}


@dataclass
class Compilation:
    """State of a compilation: its inputs, and the steps, trials and problems so far."""

    document: Document
    mounted: Mounted
    head: ProtocolHead
    steps: list[Step] = field(default_factory=list)
    trials: list[TrialRecord] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    hazards: list[str] = field(default_factory=list)
    _on: tuple[float, float] | None = None
    _beyond: dict[tuple[Location, str], tuple[set[float], Problem | None]] = field(default_factory=dict)
    """(Place in the file, limit) -> values beyond that limit, and the problem that lists them."""

    def fault(self, location: Location, message: str, *, key: bool = False) -> None:
        """Note a problem at a place of the protocol."""
        problem = self.document.problem(location, message, key=key)
        if problem not in self.problems:
            self.problems.append(problem)

    @contextmanager
    def noting(self, location: Location) -> Iterator[None]:
        """Turn a `ValueError` into a problem at a place of the protocol."""
        try:
            yield
        except ValueError as error:
            self.fault(location, str(error))

    def within(self, output: str, value: float, location: Location) -> None:
        """Check a value to be commanded against the active limits."""
        record = self.mounted.bench.commanded.get(output)
        if record is None:
            self.fault(location, f'needs the output "{output}", which the bench does not have')
            return
        beyond = {
            "above": (value > record.high * (1 + 1e-9) + 1e-12, record.high, record.high_from),
            "below": (value < record.low - 1e-12 - 1e-9 * abs(record.low), record.low, record.low_from),
        }
        for side, (wrong, end, source) in beyond.items():
            if wrong:
                limit = f"{side} the limit for commanded {output}, {show(end, record.quantity)} ({source})"
                self._outside(value, record.quantity, location, limit)

    def _outside(self, value: float, quantity: str, location: Location, limit: str) -> None:
        """Note a value beyond a limit; all values of one place, such as a range, make one problem."""
        values, before = self._beyond.get((location, limit), (set(), None))
        values.add(value)
        shown = f"{show(min(values), quantity)} is"
        if len(values) > 1:
            shown = f"{len(values)} values, {show(min(values), quantity)} to {show(max(values), quantity)}, are"
        problem = self.document.problem(location, f"{shown} {limit}")
        if before is not None:
            self.problems[self.problems.index(before)] = problem
        elif problem not in self.problems:
            self.problems.append(problem)
        self._beyond[location, limit] = values, problem

    def positive(self, value: float, location: Location) -> None:
        """Check a duration, rate or count that must be above zero."""
        if not value > 0:
            self.fault(location, "must be above zero")

    def positives(self, of: Strict, location: Location, *names: str) -> None:
        """Check the entries of a section that must be above zero."""
        for name in names:
            self.positive(getattr(of, name), (*location, name))

    def swept(self, point: Point, *names: str) -> tuple[float, ...]:
        """Values of a swept point [SI] that are commanded as they are, each checked against the active limits."""
        for name in names:
            self.within(name, point.values[name], point.places[name])
        return tuple(point.values[name] for name in names)

    def inside_hold(self, window: tuple[float, float], hold: float) -> None:
        """Check the evaluated time window of a trial's hold."""
        if not 0 <= window[0] < window[1] <= hold:
            self.fault(("trial", "window"), "must rise and lie inside the hold")

    def controls(self, outputs: Iterable[str], ends: tuple[float, float]) -> None:
        """Check the range that a controller's commands cannot leave."""
        for name in outputs:
            for number, end in enumerate(ends):
                self.within(name, end, ("controller", "output", number))
        if not ends[0] < ends[1]:
            self.fault(("controller", "output"), "must rise")

    def load(self, written: tuple[str, float], location: Location) -> dict[str, float]:
        """F_L [N] and moving mass [kg] of a load written as mass or force."""
        kind, value = written
        bench = self.mounted.bench
        self._can_be_made(value / bench.gravity if kind == "force" else value, kind, location)
        if kind == "mass":
            hanging = bench.hanging
            return {"load": value * bench.gravity, "mass": value + bench.carriage if hanging else FORCE_MASS}
        return {"load": value, "mass": FORCE_MASS}

    def _can_be_made(self, mass: float, kind: str, location: Location) -> None:
        """Check that the bench's weights can make up the load, and that its weight alone trips no limit."""
        bench, weight = self.mounted.bench, mass * self.mounted.bench.gravity
        if mass < 0:
            self.fault(location, "a load is not below zero")
            return

        def shown(load: float) -> str:
            return f"{load:g} kg" if kind == "mass" else f"{load * bench.gravity:.6g} N ({load:g} kg)"

        trips = [t for t in bench.trips if t.channel == "force" and t.kind == "range" and t.action != "warn"]
        trip, source = min(((t.high, t.source) for t in trips if t.high is not None), default=(inf, ""))
        if weight >= trip:
            self.fault(
                location,
                f"{shown(mass)} weighs {weight:.6g} N, not below the trip limit for measured force, "
                f"{show(trip, 'force')} ({source}); take a smaller load",
            )
        elif self._stack is not None and (why := self._stack.why_not(mass, shown)):
            self.fault(location, why)

    @cached_property
    def _stack(self) -> Stack | None:
        weights = self.mounted.bench_file.weights
        return None if weights is None else Stack(weights.hanger, weights.plates)

    def put_on(self, point: dict[str, float], demands: str = "vented", own: float = 0.0, also: str = "") -> None:
        """Add a request to put on the load of a point, unless it is on already; `also` is a further request.

        `own` [N] of the load is the muscle's own weight.
        """
        load = (point["load"], point["mass"])
        if self._on == load:
            return
        self._on = load
        text = self.load_text((load[0] - own, load[1]))
        self.steps.append(Ask("load", f"{text} {also}".strip(), demands, load))

    def load_text(self, load: tuple[float, float]) -> str:
        """Text of the request to the operator for a load."""
        weights = self.mounted.bench_file.weights
        if weights is None:
            return f"Put {load[0]:.2f} N on the free end."
        if load[0] == 0:
            return "Take every weight off the free end."
        mass = load[0] / weights.g
        made_of = self._stack.text(mass) if self._stack is not None else ""
        return f"Put {made_of or f'{mass:g} kg, hanger included,'} on the free end: {load[0]:.2f} N."

    def too_long(self) -> bool:
        """Whether the plan has too many steps; notes that as a problem."""
        if len(self.steps) > MOST_STEPS:
            self.fault(("sweep",), f"makes more than {MOST_STEPS} steps")
        return len(self.steps) > MOST_STEPS

    def needs_channel(self, name: str) -> None:
        """Check that the bench has a channel that a search needs."""
        if all(channel.name != name for channel in self.mounted.bench.channels):
            self.fault(("kind",), f'needs the channel "{name}", which the bench does not have')

    def precondition(self) -> None:
        """Add the unrecorded cycles, and the rest after them."""
        cycles, rest = self.head.prepare.precondition, self.head.prepare.rest
        if cycles is not None:
            at: Location = ("prepare", "precondition")
            names = [output.name for output in self.mounted.bench.pressures] or ["pressure"]
            for name in names:
                self.within(name, cycles.pressure, (*at, "pressure"))
            for _ in range(cycles.cycles):
                for pressure in (cycles.pressure, 0.0):
                    self.steps += [Set("precondition", name, pressure) for name in names]
                    self.steps.append(Hold("precondition", cycles.hold))
        if rest:
            self.steps.append(Hold("precondition", rest))

    def add_trial(self, values: dict[str, float], repeat: int) -> int:
        """Add a trial at an operating point [SI], before the first one also the preparation; returns its index."""
        index = len(self.trials)
        if index == 0:
            self.precondition()
        self.trials.append(TrialRecord(index, values, repeat))
        return index

    def needs_bench(self) -> None:
        """Check free end and channels."""
        bench = self.mounted.bench
        if self.head.needs.free_end != bench.free_end:
            self.fault(
                ("needs", "free_end"),
                f'needs a bench whose free end is "{self.head.needs.free_end}"; "{bench.name}" has "{bench.free_end}"',
            )
        names = [channel.name for channel in bench.channels]
        for index, name in enumerate(self.head.record):
            if name not in names:
                self.fault(("record", index), f'the bench has no channel "{name}"; it has {", ".join(names)}')
            if name in self.head.record[:index]:
                self.fault(("record", index), f'"{name}" is given twice')
        for needed in self.head.cannot_do_without:
            if needed not in self.head.record:
                self.fault(("record",), f'lacks "{needed}", without which nothing can be fitted; add it')

    def needs_coefficients(self) -> None:
        """Check that the kind of test gives the coefficients that have acceptance limits."""
        check_acceptance(self, self.head.accept, self.head.gives, self.head.checks)

    def plan(self, kind: str, settings: dict[str, Any]) -> Plan:
        """The finished plan."""
        return Plan(
            kind=kind,
            name=self.head.name,
            source=self.head.source,
            free_end=self.head.needs.free_end,
            rate=self.head.sample_rate,
            record=tuple(self.head.record),
            trials=tuple(self.trials),
            steps=tuple(self.steps),
            settings=settings,
            accept=acceptance_for_plan(self, self.head.accept),
            hazards=tuple(self.hazards),
        )


MOST_STEPS = 200_000
"""Largest number of steps of a plan."""

FORCE_MASS = 0.5
"""Moving mass of a load that acts as a pure force [kg] (papers digest 5.1)."""
