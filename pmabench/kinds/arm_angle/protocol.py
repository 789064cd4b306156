"""Arm angle: position of the end of an arm of muscles over the pressure of the muscle that bends it (paper 2).

All muscles of the arm start at the preload; the bending one goes up in steps and down again, with a load at the arm's
end. The other muscles have a separate regulator, set by hand.
"""

from __future__ import annotations

from itertools import pairwise
from math import isclose
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pmabench.base.quantities import show
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Length, Load, Pressure, PressureRate, Time
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.plan import Hold, Plan, Ramp, Record, Step
from pmabench.protocol.sweep import PressureAxis, PressureRange, Sweep, expand

LEAST = 0.5
"""Shortest hold that can count as rest [s]."""
NOTHING = 1.0
"""Pressures closer than this count as equal [Pa]."""
HAZARD = (
    "the other muscles of the arm hang on a regulator that hands set: the dump valve must empty them together with the "
    "one that bends"
)


class ArmAxes(Strict):
    """What is swept: the load at the arm's end."""

    load: Annotated[list[Load], Field(min_length=1)]


class ArmTrial(Strict):
    """One trial: with one load from the preload up through the pressures, and down again."""

    preload: Pressure
    """Of all muscles; the bending one starts and ends there."""
    pressures: PressureAxis
    """Pressures of the bending muscle, rising."""
    rate: PressureRate
    """Rate of the ramps between pressures."""
    hold: Time
    """Hold at each pressure; the angle is the mean over the last fifth."""
    branches: Literal["up", "up-and-down"] = "up-and-down"
    angle: Literal["measured", "from-displacement"] = "measured"
    """From the channel `angle`; or displacement along the bending muscle divided by `radius` (constant curvature)."""
    radius: Length | None = None
    """Distance from the arm's middle to the bending muscle."""


class ArmAngle(ProtocolHead):
    """Protocol of kind arm-angle."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure",)
    gives: ClassVar[tuple[str, ...]] = ()
    kind: Literal["arm-angle"]
    sweep: Sweep[ArmAxes]
    trial: ArmTrial
    compare: Literal["paper-2", "nothing"] = "paper-2"
    """Paper 2's formula and table; valid for 0 to 0.5 kg, a preload of 0.45 bar, pressures up to 5 bar."""

    def compile(self, c: Compilation) -> Plan:
        """The plan: per load and repeat one staircase of pressure, all of it recorded."""
        trial = self.trial
        c.positive(trial.rate, ("trial", "rate"))
        if trial.hold < LEAST:
            c.fault(("trial", "hold"), f"must be at least {show(LEAST, 'time')}: the angle is taken at rest")
        self._angle(c)
        pressures = self._pressures(c)
        g = c.mounted.bench.gravity
        others = f"The regulator of the other muscles is at {show(trial.preload, 'pressure')}."
        for point in expand(self.sweep, c.document):
            kind, value = point.values["load"]
            mass = value if kind == "mass" else value / g
            load = c.load(point.values["load"], point.places["load"])
            if self.compare == "paper-2":
                self._within_the_formula(c, mass, point.places["load"], pressures)
            if c.problems or c.too_long():
                continue
            c.put_on(load, also=others)
            c.steps += _steps(trial, pressures, c.add_trial({"tip_mass": mass}, point.repeat))
        c.hazards.append(HAZARD)
        settings = {"preload": trial.preload, "angle": trial.angle, "radius": trial.radius, "compare": self.compare}
        return c.plan("arm-angle", settings)

    def _angle(self, c: Compilation) -> None:
        """Check that the bench can give the angle."""
        trial = self.trial
        if trial.radius is not None:
            c.positive(trial.radius, ("trial", "radius"))
        if trial.angle == "measured" and "angle" not in self.record:
            way = 'add it, or "trial.angle: from-displacement" with a "radius"'
            c.fault(("record",), f'lacks "angle", without which nothing can be found; {way}')
        if trial.angle == "from-displacement":
            if "displacement" not in self.record:
                c.fault(("record",), 'lacks "displacement", of which the angle is to be made; add it')
            if trial.radius is None:
                way = 'add "radius", from the arm\'s middle to where the displacement is measured'
                c.fault(("trial", "angle"), f"an angle from the displacement needs the arm: {way}")

    def _pressures(self, c: Compilation) -> list[float]:
        """The pressures [Pa], from the preload up."""
        axis, at = self.trial.pressures, ("trial", "pressures")
        try:
            found = axis.values() if isinstance(axis, PressureRange) else list(axis)
        except ValueError as error:
            c.fault(at, str(error))
            return []
        c.within("pressure", self.trial.preload, ("trial", "preload"))
        for pressure in found:
            c.within("pressure", pressure, at)
        rising = [self.trial.preload, *(P for P in found if abs(P - self.trial.preload) > NOTHING)]
        if any(high - low <= NOTHING for low, high in pairwise(rising)):
            c.fault(at, f"must rise, from above the preload, {show(self.trial.preload, 'pressure')}: it bends up first")
        elif len(rising) < 2:
            c.fault(at, "one pressure above the preload at least is needed")
        return rising

    def _within_the_formula(self, c: Compilation, mass: float, place: Location, pressures: list[float]) -> None:
        """Check that load, preload and pressures are in the range of paper 2's formula and would trip no limit."""
        from pmabench.model.library import MODELS  # slow to import

        model = MODELS["arm-angle"]
        known = {p.name: p for p in model.parameters}
        other = 'or "compare: nothing", which measures and fits without it'
        load, pressure = known["load"], known["pressure"]
        if not load.low <= mass <= load.high * (1 + 1e-9):
            message = f"{mass:.4g} kg at the arm's end: paper 2's angle holds from {load.low:g} to {load.high:g} kg"
            c.fault(place, f"{message} ({load.reason}): take less, {other}")
            return
        if not isclose(self.trial.preload, pressure.low, rel_tol=0.01):
            message = f"paper 2's angle holds for {show(pressure.low, 'pressure')} in the other muscles"
            c.fault(("trial", "preload"), f"{message}: take that, {other}")
        if not pressures or max(pressures) > pressure.high * (1 + 1e-9):
            message = f"paper 2's angle holds up to {show(pressure.high, 'pressure')}"
            c.fault(("trial", "pressures"), f"{message}: take less, {other}")
            return
        top = min(max(pressures), pressure.high)
        inside = {"pressure": max(top, pressure.low), "load": min(mass, load.high)}
        angle = float(model.evaluate(inside)["angle"])
        radius = self.trial.radius
        reached = {"angle": angle} | ({} if radius is None else {"displacement": radius * angle})
        for trip in c.mounted.bench.trips:
            value, ends = reached.get(trip.channel), trip.kind == "range" and trip.action != "warn"
            if ends and trip.high is not None and value is not None and value >= trip.high:
                quantity = "angle" if trip.channel == "angle" else "length"
                message = f"with {mass:g} kg it is predicted to reach {show(value, quantity, 3)} of {trip.channel}"
                limit = f"the trip limit is {show(trip.high, quantity, 3)} ({trip.source})"
                c.fault(("trial", "pressures"), f"{message} at {show(top, 'pressure')}; {limit}")


def _steps(of: ArmTrial, pressures: list[float], index: int) -> list[Step]:
    """One trial: from 0 through `pressures` [Pa], the first of which is the preload, and back to 0.

    All of it is recorded, so that each trial begins and ends in the same state, whatever was done before.
    """
    steps: list[Step] = [Record("preload", True, index)]
    before = 0.0
    stairs = [("preload" if n == 0 else "up", P) for n, P in enumerate(pressures)]
    if of.branches == "up-and-down":
        stairs += [("down", P) for P in pressures[-2::-1]]
    for phase, P in stairs:
        if abs(P - before) > NOTHING:
            steps.append(Ramp(phase, "pressure", before, P, of.rate))
        steps.append(Hold(phase, of.hold))
        before = P
    return [*steps, Ramp("vent", "pressure", before, 0.0, of.rate), Hold("vent", LEAST), Record("vent", False, index)]
