"""Slow displacement ramps both ways at constant pressure: the isobaric loop, and at 0 kPa the tension of the rubber.

Paper 3, tests at fixed pressure and traction at 0 bar gauge.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Length, Speed, Time
from pmabench.protocol.common import OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.driven import Held, bearable, check_motion, minor_loop, not_too_fast
from pmabench.protocol.plan import Hold, Plan, Ramp, Record, Step
from pmabench.protocol.sweep import LengthAxis, Point, PressureAxis, SpeedAxis, Sweep, expand

BELOW_0 = "without pressure the muscle pulls only where it is stretched: it must end at 0 mm or below"


class RampAxes(Strict):
    """What is swept; the ends of the stroke only if they differ between pressures."""

    pressure: PressureAxis
    speed: SpeedAxis
    lower: LengthAxis | None = None
    upper: LengthAxis | None = None


class MinorLoop(Strict):
    """A small loop within the stroke after the last cycle; it shows how the hysteresis reverses."""

    lower: Length
    upper: Length
    cycles: Annotated[int, Field(ge=1, le=1000)] = 1


class RampTrial(Strict):
    """One loop: cycles of a ramp from `lower` to `upper` contraction and back."""

    lower: Length | None = None
    """Contraction at which it starts; below 0 stretched."""
    upper: Length | None = None
    cycles: Annotated[int, Field(ge=2, le=1000)]
    discard: Annotated[int, Field(ge=0)] = 1
    """Cycles at the start that the reduction leaves out."""
    dwell: Time = 0.0
    """Rest at both ends of each ramp."""
    turn: Length
    """Length at both ends that is left out, where one branch turns into the other."""
    settle: Time
    """Time at pressure before the first motion."""
    approach: Speed
    """Speed from 0 to the lower end and back."""
    minor: MinorLoop | None = None
    """For a surface model with hysteresis; the reduction of this kind of test leaves it out."""


class IsobaricRamp(ProtocolHead):
    """Protocol of kind isobaric-ramp."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement", "force")
    gives: ClassVar[tuple[str, ...]] = ("F_ce", "K", "B", "F_c")
    checks: ClassVar[tuple[str, ...]] = OF_TRIALS
    kind: Literal["isobaric-ramp"]
    sweep: Sweep[RampAxes]
    trial: RampTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per pressure, pressurise and move to the lower end; then one recorded loop per speed."""
        trial = self.trial
        check_motion(c, trial, "turn", "settle")
        held = Held(c, trial.settle, trial.approach)
        for point in expand(self.sweep, c.document):
            (pressure,), speed = c.swept(point, "pressure"), point.values["speed"]
            ends = self._ends(c, point)
            c.positive(speed, point.places["speed"])
            if ends is None or speed <= 0 or trial.approach <= 0 or c.too_long():
                continue
            lower, upper = ends
            not_too_fast(c, speed, point.places["speed"], "the ramp moves")
            if pressure > 0:
                path = [(x, v) for x in ends for v in (speed, -speed)]
                bearable(c, pressure, path, point.places["pressure"], "the upper end of the stroke")
            values = {"pressure": pressure, "speed": speed, "lower": lower, "upper": upper}
            index = c.add_trial({**values, "cycles": float(trial.cycles)}, point.repeat)
            held.go(pressure, lower)
            c.steps += [
                Record("contract", True, index),
                *self._cycle(lower, upper, speed) * trial.cycles,
                *minor_loop(trial.minor, "displacement", lower, speed),
                Record("expand", False, index),
                Hold("rest", 1.0),
            ]
        held.leave()
        return c.plan("isobaric-ramp", {"discard": trial.discard, "turn": trial.turn})

    def _cycle(self, lower: float, upper: float, speed: float) -> list[Step]:
        steps: list[Step] = []
        for phase, begin, end in (("contract", lower, upper), ("expand", upper, lower)):
            steps.append(Ramp(phase, "displacement", begin, end, speed))
            steps += [Hold(phase, self.trial.dwell)] if self.trial.dwell > 0 else []
        return steps

    def _ends(self, c: Compilation, point: Point) -> tuple[float, float] | None:
        """Both ends of the stroke [m], checked; None if one is missing."""
        ends: dict[str, float] = {}
        places: dict[str, Location] = {}
        for name in ("lower", "upper"):
            value = point.values.get(name, getattr(self.trial, name))
            places[name] = point.places.get(name, ("trial", name))
            if value is None:
                c.fault(("trial",), f'lacks "{name}", an end of the stroke, which the sweep does not give either')
            else:
                ends[name] = value
                c.within("displacement", value, places[name])
        if len(ends) < 2:
            return None
        if not ends["upper"] - ends["lower"] > 4 * self.trial.turn:
            text = "the stroke is not longer than four times what is left out at each end (turn): nothing would be left"
            c.fault(places["upper"], text)
            return None
        minor = self.trial.minor
        if minor is not None and not ends["lower"] < minor.lower < minor.upper < ends["upper"]:
            c.fault(("trial", "minor"), "its lower and upper end must rise, and lie between the ends of the stroke")
            return None
        if point.values["pressure"] <= 0 and ends["upper"] > 0:
            c.fault(places["upper"], BELOW_0)
        return ends["lower"], ends["upper"]
