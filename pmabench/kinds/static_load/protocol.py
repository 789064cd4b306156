"""Static load: the pressures at which a load lifts off its support and sets down (paper 0, static study).

Variant `hands-at-pressure`: paper 0's literal order, with the load put on and the support removed while the muscle is
pressurised.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from pmabench.base.quantities import show
from pmabench.files.document import Strict
from pmabench.files.quantity import Length, Load, Pressure, PressureRate, Time
from pmabench.protocol.common import FORCE_MASS, OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.plan import Ask, Hold, Plan, Record, Seek, Set, Step
from pmabench.protocol.sweep import Point, PressureAxis, Sweep, expand

VENT_HOLD = 3.0
"""Time after the vent before the next trial [s]."""


NEAR = 1e-3
"""Contraction down to which the load is lowered at the rate of the stroke [m]."""


class StaticAxes(Strict):
    """What is swept: loads, and for `hands-at-pressure` also pressures."""

    load: Annotated[list[Load], Field(min_length=1)]
    pressure: PressureAxis | None = None


class Search(Strict):
    """Search for a crossing: fast to its neighbourhood, back, then slowly."""

    up_to: Pressure
    rate: PressureRate
    approach_rate: PressureRate
    back_off: Pressure
    settle: Time
    moved: Length
    """Displacement that counts as lifted off the support."""
    window: Time
    """Time for which the displacement must stay beyond it."""
    stroke: Length = 0.0
    """Contraction to which the load is raised before it is set down, for hysteresis of the braid; 0: not raised."""
    stroke_rate: PressureRate = 5e3


class StaticTrial(Strict):
    """One trial; `order` says when the load is put on."""

    order: Literal["load-at-zero", "hands-at-pressure"] = "load-at-zero"
    hold: Time = 0.0
    """For `hands-at-pressure`: time with the load on before the support is removed."""
    search: Search


class StaticLoad(ProtocolHead):
    """Protocol of kind static-load."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement")
    gives: ClassVar[tuple[str, ...]] = ("F_ce",)
    checks: ClassVar[tuple[str, ...]] = OF_TRIALS
    kind: Literal["static-load"]
    sweep: Sweep[StaticAxes]
    trial: StaticTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per trial a search for lift and one for set-down, or for the return to zero alone."""
        search = self.trial.search
        c.needs_channel("displacement")
        c.needs_channel("pressure_command")
        at = ("trial", "search")
        c.positives(search, at, "rate", "approach_rate", "back_off", "settle", "moved", "window")
        if search.stroke:
            c.positive(search.stroke_rate, (*at, "stroke_rate"))
        c.within("pressure", search.up_to, (*at, "up_to"))
        points = expand(self.sweep, c.document)
        if self.trial.order == "hands-at-pressure":
            self._at_pressure(c, points)
        else:
            self._at_zero(c, points)
        return c.plan("static-load", {"order": self.trial.order, "rate": search.rate, "moved": search.moved})

    def _seek(self, phase: str, direction: str, highest: float, approach: float) -> Seek:
        search = self.trial.search
        limit = 5.0 + search.settle
        if approach > 0:
            limit += highest / approach + search.back_off / approach + 2.0
        return self._ramp(phase, direction, highest, search.moved, search.rate, limit, approach_rate=approach)

    def _ramp(
        self, phase: str, direction: str, highest: float, threshold: float, rate: float, limit: float, *,
        approach_rate: float = 0.0, at_limit: str = "fail",
    ) -> Seek:  # fmt: skip
        search = self.trial.search
        limit += highest / rate if rate > 0 else 0.0
        parameters: dict[str, Any] = {
            "channel": "displacement",
            "threshold": threshold,
            "direction": direction,
            "rate": rate,
            "approach_rate": approach_rate,
            "back_off": search.back_off,
            "window": search.window,
            "settle": search.settle,
        }
        return Seek(phase, "ramp-until", "pressure", 0.0, highest, limit, parameters, at_limit)

    def _stroke(self) -> list[Step]:
        """Up to the contraction of the stroke, or as far as the pressure allows, and down again to near the support."""
        search = self.trial.search
        if not search.stroke:
            return []
        highest, rate = search.up_to, search.stroke_rate
        near = min(search.stroke, max(NEAR, 2.0 * search.moved))
        return [
            self._ramp("raise", "up", highest, search.stroke, rate, 5.0, at_limit="flag"),
            Hold("raised", search.settle),
            self._ramp("lower", "down", highest, near, rate, 5.0),
        ]

    def _at_zero(self, c: Compilation, points: list[Point]) -> None:
        search = self.trial.search
        for point in points:
            if "pressure" in point.values:
                message = 'only "order: hands-at-pressure" sets pressures; here they are searched'
                c.fault(point.places["pressure"], message)
            values = c.load(point.values["load"], point.places["load"])
            c.put_on(values)
            index = c.add_trial(values, point.repeat)
            c.steps += [
                Record("rest", True, index),
                Hold("rest", 0.2),
                self._seek("lift", "up", search.up_to, search.approach_rate),
                Hold("lifted", search.settle),
                *self._stroke(),
                self._seek("set-down", "down", search.up_to, 0.0),
                Record("set-down", False, index),
                Set("vent", "pressure", 0.0),
                Hold("vent", VENT_HOLD),
            ]

    def _at_pressure(self, c: Compilation, points: list[Point]) -> None:
        most = c.mounted.bench.hands_at_pressure
        c.positive(self.trial.hold, ("trial", "hold"))
        text = "hands are at the muscle while it is under pressure: load on and support away at the set pressure"
        c.hazards.append(text)
        for point in points:
            if "pressure" not in point.values:
                c.fault(("sweep",), '"order: hands-at-pressure" needs pressures as well as loads')
                return
            (pressure,), place = c.swept(point, "pressure"), point.places["pressure"]
            if pressure > most:
                shown = show(most, "pressure")
                c.fault(place, f"hands at {show(pressure, 'pressure')}: this bench allows them up to {shown}")
            values = {**c.load(point.values["load"], point.places["load"]), "pressure": pressure}
            load = (values["load"], values["mass"])
            index = c.add_trial(values, point.repeat)
            c.steps += [
                Set("pressurise", "pressure", pressure),
                Hold("pressurise", 3.0),
                Ask("load", c.load_text(load) + " Keep its support under it.", "at-pressure", load),
                Record("loaded", True, index),
                Hold("loaded", self.trial.hold),
                Ask("support", "Take the support of the load away.", "at-pressure"),
                Hold("hanging", 1.0),
                self._seek("set-down", "down", pressure, 0.0),
                Record("set-down", False, index),
                Set("vent", "pressure", 0.0),
                Hold("vent", VENT_HOLD),
                Ask("unload", "Take every weight off the free end.", "vented", (0.0, FORCE_MASS)),
            ]
