"""Isometric pressurisation: the driven end is fixed, the pressure goes slowly up and down (papers 2, 3, 4).

Paper 3's fixed-position test gives S(eps) and the rubber's force, papers 2 and 4 the pressure at which force begins.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, TypeAlias

from pydantic import BeforeValidator, Field, WithJsonSchema

from pmabench.base.quantities import show
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Length, Pressure, PressureRate, Speed, Temperature, Time, Volume, parse_quantity
from pmabench.protocol.common import OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.driven import VENT_HOLD, minor_loop, not_too_fast, predicted_force
from pmabench.protocol.plan import Hold, Plan, Ramp, Record, Set, Step
from pmabench.protocol.sweep import Point, Sweep, expand

FEWEST_SAMPLES = 200
"""Samples that one slow ramp must have."""
REST = 1.0
"""Rest before and after the ramps, which gives the level from which the force begins [s]."""
SHORTEST_TOP = 2.0
"""Shortest rest at the top for a measurement of mass: the air reaches the wall's temperature [s]."""
ROOM = (250.0, 350.0)
"""Temperatures of a room [K]."""
SIDES = {"straight": (0,), "from-both-sides": (-1, 1)}
"""Approach -> the sides from which each contraction is reached: -1 from below, 1 from above."""


def _length_or_share(value: object) -> tuple[str, float]:
    """`("length", m)` for `"10 mm"`, `("ratio", share)` for `"5 %"` of the nominal length."""
    try:
        return "ratio", parse_quantity(value, "ratio")
    except ValueError:
        try:
            return "length", parse_quantity(value, "length")
        except ValueError as error:
            raise ValueError(f'{error}; or a share of the nominal length, for instance "5 %"') from None


if TYPE_CHECKING:
    Contraction: TypeAlias = tuple[str, float]
else:
    Contraction = Annotated[
        tuple[str, float],
        BeforeValidator(_length_or_share),
        WithJsonSchema(
            {
                "type": "string",
                "description": "a length, or a share of the nominal length; below zero it is stretched",
                "examples": ["10 mm", "5 %"],
            }
        ),
    ]


class Dead(Strict):
    """Volume between the meter and the muscle: line, fittings, sensor."""

    volume: Volume
    uncertainty: Volume


class IsometricAxes(Strict):
    """What is swept."""

    contraction: Annotated[list[Contraction], Field(min_length=1)]


class Move(Strict):
    """Motion of the driven end from the nominal length to a contraction and back."""

    pressure: Pressure
    """Pressure during the motion, so that the muscle does not buckle."""
    speed: Speed
    approach: Literal["straight", "from-both-sides"] = "straight"
    """From both sides: each contraction is tested twice, from below and from above, so that friction cancels."""
    beyond: Length = 0.0
    """Overtravel beyond the contraction before it is reached, from both sides."""


class MinorLoop(Strict):
    """A small loop of pressure within the range of the ramp, after it; it shows how the hysteresis reverses."""

    lower: Pressure
    upper: Pressure
    cycles: Annotated[int, Field(ge=1, le=1000)] = 1


class Pressurise(Strict):
    """The slow ramp of pressure, up and down."""

    start: Pressure
    stop: Pressure
    rate: PressureRate
    hold: Time
    """Time at the top."""
    minor: MinorLoop | None = None
    """For a surface model with hysteresis; the reduction of this kind of test leaves it out."""


class Flow(Strict):
    """A mass flow meter in front of the muscle, for its volume."""

    dead: Dead
    zero: Time = 5.0
    """Rest before and after the ramps, for the zero of the meter."""
    temperature: Temperature = 293.15
    """Temperature of the air in the muscle, equal to that of the room."""
    temperature_uncertainty: Temperature = 3.0


class IsometricTrial(Strict):
    """One trial at one contraction."""

    move: Move
    settle: Time
    """Rest at the contraction, in addition to one second before and after the ramp."""
    pressurise: Pressurise
    flow: Flow | None = None


class IsometricPressurisation(ProtocolHead):
    """Protocol of kind isometric-pressurisation."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement", "force")
    gives: ClassVar[tuple[str, ...]] = ("F_ce", "K")
    checks: ClassVar[tuple[str, ...]] = OF_TRIALS
    kind: Literal["isometric-pressurisation"]
    sweep: Sweep[IsometricAxes]
    trial: IsometricTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per contraction move there, and ramp the pressure up and down."""
        self._checked(c)
        points = expand(self.sweep, c.document)
        sides = SIDES[self.trial.move.approach]
        able = self.trial.move.speed > 0 and self.trial.pressurise.rate > 0
        for point in points if able and not c.problems else ():
            x = self._contraction(c, point)
            self._bearable(c, x, point.places["contraction"])
            for side in sides:
                if c.too_long():
                    return c.plan(self.kind, {})
                index = c.add_trial({"contraction": x} | ({"side": float(side)} if side else {}), point.repeat)
                if index == 0:
                    c.steps += [Set("move", "pressure", self.trial.move.pressure), Hold("move", self.trial.settle)]
                c.steps += _steps(self.trial, x, side, index)
        c.steps += [Set("vent", "pressure", 0.0), Hold("vent", VENT_HOLD)]
        pressurise = self.trial.pressurise
        settings = {name: getattr(pressurise, name) for name in ("start", "stop", "rate")} | self._flow(c)
        return c.plan(self.kind, settings)

    def _flow(self, c: Compilation) -> dict[str, object]:
        """Settings for the volume by flow in the reduction; empty without a meter."""
        flow, where = self.trial.flow, ("trial", "flow")
        if flow is None:
            return {}
        if "flow" not in self.record:
            c.fault(where, 'needs the channel "flow" among those recorded')
        c.positive(flow.zero, (*where, "zero"))
        if self.trial.pressurise.hold < SHORTEST_TOP:
            shortest = show(SHORTEST_TOP, "time")
            c.fault(("trial", "pressurise", "hold"), f"the air settles at the top: {shortest} or more")
        if min(flow.dead.volume, flow.dead.uncertainty) < 0:
            c.fault((*where, "dead"), "a volume is not below zero")
        if not ROOM[0] <= flow.temperature <= ROOM[1] or not 0 <= flow.temperature_uncertainty < 50:
            c.fault((*where, "temperature"), f"a temperature from {ROOM[0]:g} to {ROOM[1]:g} K is expected")
        dead = {"dead": flow.dead.volume, "dead_half": flow.dead.uncertainty}
        air = {"temperature": flow.temperature, "temperature_half": flow.temperature_uncertainty}
        return {"flow": {**dead, **air}}

    def _checked(self, c: Compilation) -> None:
        """Checks that apply to every trial."""
        move, ramp = self.trial.move, self.trial.pressurise
        of_ramp = ("trial", "pressurise")
        c.positive(move.speed, ("trial", "move", "speed"))
        c.positive(self.trial.settle, ("trial", "settle"))
        c.positive(ramp.rate, (*of_ramp, "rate"))
        c.within("pressure", move.pressure, ("trial", "move", "pressure"))
        for name in ("start", "stop"):
            c.within("pressure", getattr(ramp, name), (*of_ramp, name))
        if ramp.stop <= ramp.start:
            c.fault((*of_ramp, "stop"), f"must lie above the start, {show(ramp.start, 'pressure')}")
        elif ramp.rate > 0 and (ramp.stop - ramp.start) / ramp.rate * self.sample_rate < FEWEST_SAMPLES:
            slowest = show((ramp.stop - ramp.start) * self.sample_rate / FEWEST_SAMPLES, "pressure rate", 3)
            text = f"too fast: the ramp has fewer than {FEWEST_SAMPLES} samples; at most {slowest} at this sample_rate"
            c.fault((*of_ramp, "rate"), text)
        minor = ramp.minor
        if minor is not None and not ramp.start < minor.lower < minor.upper < ramp.stop:
            text = "its lower and upper end must rise, and lie between start and stop of the ramp"
            c.fault((*of_ramp, "minor"), text)
        if move.approach == "from-both-sides":
            c.positive(move.beyond, ("trial", "move", "beyond"))
        elif move.beyond:
            c.fault(("trial", "move", "beyond"), 'is for "approach: from-both-sides" only')
        not_too_fast(c, move.speed, ("trial", "move", "speed"), "it moves")

    def _contraction(self, c: Compilation, point: Point) -> float:
        """Position of the driven end [m], checked against the stroke including the overtravel."""
        kind, value = point.values["contraction"]
        x = value * c.mounted.specimen_file.nominal_length if kind == "ratio" else value
        beyond = abs(self.trial.move.beyond)
        for place in {x - beyond, x + beyond}:
            c.within("displacement", place, point.places["contraction"])
        return float(x)

    def _bearable(self, c: Compilation, x: float, where: Location) -> None:
        """Check the force predicted at the highest pressure against actuator and trip."""
        expected, actuator = c.mounted.specimen_file.expected, c.mounted.bench_file.actuator
        if expected is None:
            return
        top = self.trial.pressurise.stop
        _, force = predicted_force(expected, top, x, 0.0, 0.0)
        trips = [t for t in c.mounted.bench.trips if t.channel == "force" and t.kind == "range" and t.action != "warn"]
        limits = [(t.high, f"the trip limit is {show(t.high, 'force')} ({t.source})") for t in trips if t.high]
        if actuator is not None:
            limits.append((actuator.force, f"the actuator bears {show(actuator.force, 'force')}"))
        most, reason = min(limits, default=(inf, ""))
        if force >= most:
            text = f"at {show(top, 'pressure')} the force is predicted to reach {force:.0f} N; {reason} "
            c.fault(where, f"{text}(take a larger contraction, or a lower pressurise.stop)")


def _steps(of: IsometricTrial, x: float, side: int, index: int) -> list[Step]:
    """One trial: from the nominal length to x [m], from `side`; one slow ramp up and down; and back.

    All of it is recorded, so that each trial begins and ends in the same state, whatever was done before.
    """
    ramp, move = of.pressurise, of.move
    places = [0.0, x + side * move.beyond, x] if side else [0.0, x]
    phases = ["move", "approach"] if side else ["approach"]
    there: list[Step] = [
        Ramp(phase, "displacement", begin, end, move.speed)
        for phase, begin, end in zip(phases, places, places[1:], strict=False)
        if abs(end - begin) > 1e-9
    ]
    apart = abs(ramp.start - move.pressure) > 1e-6
    zero = 0.0 if of.flow is None else of.flow.zero
    return [
        Record("move", True, index),
        *there,
        *([Ramp("rest", "pressure", move.pressure, ramp.start, ramp.rate)] if apart else []),
        Hold("rest", of.settle + REST + zero),
        Ramp("fill", "pressure", ramp.start, ramp.stop, ramp.rate),
        Hold("top", ramp.hold),
        Ramp("empty", "pressure", ramp.stop, ramp.start, ramp.rate),
        Hold("end", REST + zero),
        *minor_loop(ramp.minor, "pressure", ramp.start, ramp.rate),
        *([Ramp("return", "pressure", ramp.start, move.pressure, ramp.rate)] if apart else []),
        *([Ramp("return", "displacement", x, 0.0, move.speed)] if abs(x) > 1e-9 else []),
        Record("return", False, index),
    ]
