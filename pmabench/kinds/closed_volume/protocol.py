"""The muscle as a closed volume: filled, shut off, contracted slowly; its pressure gives its volume (paper 3)."""

from __future__ import annotations

from math import pi
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from pmabench.base.quantities import show
from pmabench.files.document import Strict
from pmabench.files.quantity import Length, Pressure, Speed, Time, Volume
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.driven import Held, Tube, not_too_fast
from pmabench.protocol.plan import Hold, Plan, Record, Seek
from pmabench.protocol.sweep import Point, PressureAxis, Sweep, expand

ROOM = (50e3, 110e3)
"""Range of the room's absolute pressure [Pa]: from 5.5 km above sea level to a high at sea level."""
ENDS = ("hold", "stop", "vent")
"""Actions of `following` that do not let a pressure that is shut in differ from its command."""
SLACK_TIME = 5.0
"""Margin of the time limit beyond the strokes [s]."""
MOST = 20.0
"""Longest duration of one stroke [min]."""


class Diameters(Strict):
    """Outer diameters at three stations, and the lengths of the cylinders around them (paper 3)."""

    diameters: tuple[Length, Length, Length]
    heights: tuple[Length, Length, Length]
    thickness: Length
    """Thickness of the wall."""
    uncertainty: Length
    """Uncertainty of each diameter (95 %); all three may be off in the same direction."""

    def _inner(self) -> list[tuple[float, float]]:
        """Inner diameter and height of each cylinder [m]."""
        return [(d - 2 * self.thickness, h) for d, h in zip(self.diameters, self.heights, strict=True)]

    def volume(self) -> float:
        """Sum of (pi/4)(d_j - 2 t)^2 h_j [m3]."""
        return sum(pi / 4 * d**2 * h for d, h in self._inner())

    def half(self) -> float:
        """Half width of the volume if all diameters are off by their uncertainty in the same direction [m3]."""
        return self.uncertainty * sum(pi / 2 * d * h for d, h in self._inner())


class Reference(Strict):
    """Volume inside the pressurised muscle at `start`: measured directly, or from three diameters."""

    volume: Volume | None = None
    uncertainty: Volume | None = None
    """Of `volume` (95 %)."""
    three_diameters: Diameters | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Reference:
        if (self.volume is None) == (self.three_diameters is None):
            raise ValueError('give either "volume" with its "uncertainty", or "three_diameters"')
        if (self.volume is None) != (self.uncertainty is None):
            raise ValueError('"uncertainty" belongs to "volume": give both, or with "three_diameters" none')
        return self


class Dead(Strict):
    """Volume between the valve and the muscle: line, fittings, sensor."""

    volume: Volume
    uncertainty: Volume


class Room(Strict):
    """The room's absolute pressure by a barometer, instead of the bench's `air: {atmosphere}`."""

    pressure: Pressure
    uncertainty: Pressure


class ClosedAxes(Strict):
    """What is swept: the gauge pressure at which the valve shuts."""

    pressure: PressureAxis


class ClosedTrial(Strict):
    """Strokes from `start` to `to` and back with the valve shut."""

    start: Length
    to: Length
    speed: Speed
    rest: Time
    """After the valve has shut and at both ends of each stroke, so that the air reaches room temperature."""
    cycles: Annotated[int, Field(ge=1, le=100)] = 2
    settle: Time
    """Time at pressure before the motion to the start."""
    approach: Speed
    every: Length
    """Spacing of the contractions at which the volume is computed."""
    reference: Reference
    dead: Dead
    exponent: Annotated[float, Field(ge=1.0, le=1.4)] = 1.0
    """k of P V^k: 1 isothermal, as in paper 3."""
    room: Room | None = None
    """If missing, the bench's value +- `room_uncertainty`."""
    room_uncertainty: Pressure = 3e3
    """Uncertainty of the bench's room pressure (95 %), because of the weather."""


class ClosedVolume(ProtocolHead):
    """Protocol of kind closed-volume."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement")
    kind: Literal["closed-volume"]
    sweep: Sweep[ClosedAxes]
    trial: ClosedTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per pressure fill at the start, then one search that shuts the valve, moves and opens it."""
        trial = self.trial
        good = self._sound(c)
        valve = self._valve(c)
        volume, half = self._reference(c)
        room, room_half = self._room(c)
        held = Held(c, trial.settle, trial.approach)
        for point in expand(self.sweep, c.document):
            (pressure,) = c.swept(point, "pressure")
            c.positive(pressure, point.places["pressure"])
            if not good or not valve or pressure <= 0 or c.too_long():
                continue
            self._stays_above(c, point, volume, room)
            values = {"pressure": pressure, "lower": trial.start, "upper": trial.to, "speed": trial.speed}
            index = c.add_trial(values, point.repeat)
            held.go(pressure, trial.start)
            stroke = (trial.to - trial.start) / trial.speed + trial.rest
            parameters = {"valve": valve, "start": trial.start, "to": trial.to, "rate": trial.speed,
                          "rest": trial.rest, "cycles": trial.cycles}  # fmt: skip
            c.steps += [
                Record("open", True, index),
                Hold("open", trial.rest),
                Seek("closed", "closed-strokes", "displacement", trial.start, trial.to,
                     trial.rest + 2 * trial.cycles * stroke + SLACK_TIME, parameters),
                Hold("open again", trial.rest),
                Record("open again", False, index),
            ]  # fmt: skip
        held.leave()
        given = {"reference_volume": volume, "reference_half": half, "dead_volume": trial.dead.volume}
        given |= {"dead_half": trial.dead.uncertainty, "atmosphere": room, "atmosphere_half": room_half}
        given |= {name: getattr(trial, name) for name in ("exponent", "every", "rest")}
        by = "volume" if trial.reference.volume is not None else "three diameters"
        return c.plan("closed-volume", {**given, "length": c.mounted.specimen_file.nominal_length, "by": by})

    def _sound(self, c: Compilation) -> bool:
        """Check the strokes by themselves."""
        trial = self.trial
        before = len(c.problems)
        c.positives(trial, ("trial",), "speed", "rest", "settle", "approach", "every")
        for name in ("start", "to"):
            c.within("displacement", getattr(trial, name), ("trial", name))
        for name in ("speed", "approach"):
            not_too_fast(c, getattr(trial, name), ("trial", name), "it moves")
        if not trial.to > trial.start:
            c.fault(("trial", "to"), "must be above start: shut in, the air may only expand, never be pushed together")
        elif trial.every > 0 and not 2 <= (trial.to - trial.start) / trial.every <= 1000:
            c.fault(("trial", "every"), "two to a thousand of it from start to end are expected")
        if trial.dead.volume < 0 or trial.dead.uncertainty < 0:
            c.fault(("trial", "dead"), "a volume is not below zero")
        if trial.speed > 0 and (trial.to - trial.start) / trial.speed > 60 * MOST:
            c.fault(("trial", "speed"), f"a stroke takes longer than {MOST:g} min: what leaks would be all one sees")
        return len(c.problems) == before

    def _valve(self, c: Compilation) -> str:
        """Name of the isolation valve to shut; empty where the bench has no suitable one."""
        name = c.mounted.bench_file.air.isolation_valve
        valves = c.mounted.bench.valves
        if not any(valve.name == name and valve.safe == "closed" for valve in valves):
            text = 'needs a bench with an isolation valve that is switched: "air: {isolation_valve: NAME}" and NAME '
            c.fault(("kind",), f'{text}among its outputs with "energised: open"')
            return ""
        if not any(valve.safe == "open" for valve in valves):
            c.fault(("kind",), f'with "{name}" shut nothing lets the air out: a dump valve at the muscle is needed')
            return ""
        for trip in c.mounted.bench.trips:
            if trip.channel == "pressure" and trip.kind == "following" and trip.action in ENDS:
                text = "shut in, the pressure leaves what is commanded, and the bench ends the run then "
                c.fault(("kind",), f"{text}({trip.source}): take a bench without that limit")
        return name

    def _reference(self, c: Compilation) -> tuple[float, float]:
        """The volume at the start and its half width [m3]."""
        reference = self.trial.reference
        if reference.three_diameters is not None:
            three = reference.three_diameters
            at = ("trial", "reference", "three_diameters")
            if min(three.diameters) <= 2 * three.thickness or min(three.heights) <= 0 or three.thickness < 0:
                c.fault(at, "diameters above twice the wall and heights above zero are expected")
            if three.uncertainty < 0:
                c.fault((*at, "uncertainty"), "is not below zero")
            return three.volume(), three.half()
        volume, half = reference.volume or 0.0, reference.uncertainty or 0.0
        if not volume > 0 or not 0 <= half < volume:
            c.fault(("trial", "reference"), "a volume above zero, with an uncertainty below it, is expected")
        return volume, half

    def _room(self, c: Compilation) -> tuple[float, float]:
        """The room's absolute pressure and its half width [Pa]."""
        room = self.trial.room
        pressure = c.mounted.bench_file.air.atmosphere if room is None else room.pressure
        half = self.trial.room_uncertainty if room is None else room.uncertainty
        at = ("trial",) if room is None else ("trial", "room")
        if not ROOM[0] <= pressure <= ROOM[1]:
            text = f"{show(pressure, 'pressure')} is no absolute pressure of a room, {show(ROOM[0], 'pressure')} to "
            text += f"{show(ROOM[1], 'pressure')}: P V is constant with absolute pressure only"
            c.fault(at, f"{text}, never with gauge pressure")
        if not 0 <= half < 0.2 * ROOM[0]:
            c.fault(at, "an uncertainty of the room's pressure from 0 to 10 kPa is expected")
        return pressure, half

    def _stays_above(self, c: Compilation, point: Point, volume: float, room: float) -> None:
        """Check that the predicted pressure at the end of the stroke stays above the bench's lower limit."""
        specimen, trial = c.mounted.specimen_file, self.trial
        if specimen.braid_angle is None or volume <= 0:
            return
        tube = Tube(specimen.inner_diameter, specimen.nominal_length, specimen.braid_angle)
        dead = trial.dead.volume
        grown = volume + tube.volume(trial.to) - tube.volume(trial.start)
        P = (point.values["pressure"] + room) * ((volume + dead) / (grown + dead)) ** trial.exponent - room
        if P < 0:
            text = f"shut in at {show(point.values['pressure'], 'pressure')}, the pressure is predicted to fall to "
            text += f"{show(P, 'pressure', 3)}, below that of the room: the muscle would be sucked flat"
            c.fault(point.places["pressure"], f"{text} (raise the pressure, or lower trial.to)")
