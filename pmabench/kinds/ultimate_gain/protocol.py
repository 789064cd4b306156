"""Ultimate gain and period of the position loop: by a rising gain (paper 0), by a relay, or by open-loop steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Force, Gain, Length, Load, Pressure, Ratio, Time
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.plan import Hold, Plan, Ramp, Record, Seek, Set, Step
from pmabench.protocol.sweep import LengthAxis, Sweep, expand

Point = Mapping[str, float]
"""Values of an operating point [SI]."""
Span = tuple[float, float]
"""Lowest and highest command [Pa]."""


class UltimateAxes(Strict):
    """What is swept: set-points with the pressure expected to hold each, and the load."""

    setpoint: LengthAxis
    bias: Annotated[list[Pressure], Field(min_length=1)]
    load: Annotated[list[Load], Field(min_length=1)]


class GainSteps(Strict):
    """At each level a small kick, after which half periods are counted; the gain rises until the swings grow."""

    consent: ClassVar[str] = "the loop is taken to the limit of stability"
    """What the operator agrees to."""
    start: Gain
    step: Ratio
    levels: Annotated[int, Field(ge=1, le=200)]
    half_periods: Annotated[int, Field(ge=8, le=200)]
    kick: Length
    noise: Length
    window: Length
    level_time: Time
    settle: Time

    def check(self, c: Compilation) -> None:
        """Checks that apply to every trial."""
        c.positives(self, ("trial", "gain_steps"), "start", "step", "kick", "window", "level_time")
        if self.step > 0.08 + 1e-12:
            c.fault(("trial", "gain_steps", "step"), "at most 8 % from level to level")
        if self.window <= self.kick:
            c.fault(("trial", "gain_steps", "window"), "must be larger than the kick")

    def steps(self, c: Compilation, point: Point, span: Span, place: Location) -> list[Step]:
        """Steps while a trial is recorded; commands stay in `span`, `place` is that of the bias in the file."""
        parameters = {"factor": 1.0 + self.step, **self.model_dump(exclude={"step"})}
        return _seek("gain-steps", parameters, self.settle + self.levels * self.level_time, point, span)


class RelayTest(Strict):
    """The command switches between two values about the bias, at each amplitude in turn."""

    consent: ClassVar[str] = "a relay makes the loop swing"
    amplitudes: Annotated[list[Pressure], Field(min_length=2, max_length=4)]
    """Half of the command's switching height."""
    hysteresis: Annotated[list[Length], Field(min_length=2, max_length=4)]
    """One for each amplitude, with a constant ratio, so that friction differs from a linear loop."""
    periods: Annotated[int, Field(ge=8, le=100)]
    level_time: Time
    settle: Time
    window: Length
    """Largest distance from the set-point."""
    measured: tuple[Pressure, Pressure]
    """Window of the measured pressure."""
    force: tuple[Force, Force] | None = None
    """Window of the measured force."""

    def check(self, c: Compilation) -> None:
        """Checks that apply to every trial."""
        c.needs_channel("pressure")
        if self.force is not None:
            c.needs_channel("force")
        at: Location = ("trial", "relay")
        c.positives(self, at, "level_time", "settle", "window")
        for name, values in (("amplitudes", self.amplitudes), ("hysteresis", self.hysteresis)):
            for index, value in enumerate(values):
                c.positive(value, (*at, name, index))
        if len(self.amplitudes) != len(self.hysteresis):
            c.fault((*at, "hysteresis"), 'needs as many values as "amplitudes"')
            return
        if min(*self.amplitudes, *self.hysteresis) <= 0:
            return
        ratios = [h / d for d, h in zip(self.amplitudes, self.hysteresis, strict=True)]
        if max(ratios) > 1.01 * min(ratios):
            c.fault((*at, "hysteresis"), "must be in one ratio to the amplitudes, so that friction is seen")
        if max(self.amplitudes) < 1.5 * min(self.amplitudes):
            c.fault((*at, "amplitudes"), "the largest must be at least 1.5 times the smallest")
        if self.window <= 2 * max(self.hysteresis):
            c.fault((*at, "window"), "must be larger than twice the largest hysteresis")
        for name, ends in (("measured", self.measured), ("force", self.force)):
            if ends is not None and not ends[0] < ends[1]:
                c.fault((*at, name), "the first value must be below the second")

    def steps(self, c: Compilation, point: Point, span: Span, place: Location) -> list[Step]:
        """Steps while a trial is recorded; commands must lie in `span`, the bias in the window of the measured
        pressure.
        """
        d, bias, (low, high) = max(self.amplitudes), point["bias"], span
        if not low <= bias - d < bias + d <= high:
            c.fault(place, 'with the largest amplitude lies outside the range "pressure" of the trial')
        if not self.measured[0] < bias < self.measured[1]:
            c.fault(place, 'lies outside the window "measured" of the relay')
        watched = {"pressure": list(self.measured)} | ({} if self.force is None else {"force": list(self.force)})
        parameters = {**self.model_dump(exclude={"measured", "force"}), "watched": watched}
        return _seek("relay", parameters, self.settle + len(self.amplitudes) * self.level_time, point, span)


class OpenLoop(Strict):
    """Open-loop steps of the command, up, back, down and back, to which a model of the loop is fitted."""

    consent: ClassVar[str] = ""
    amplitude: Pressure
    """Height of a step, to both sides of the bias."""
    hold: Time
    """Hold after each step, long enough to come to rest."""
    cycles: Annotated[int, Field(ge=3, le=100)]
    """Cycles of four steps; the scatter between cycles gives the interval."""
    settle: Time

    def check(self, c: Compilation) -> None:
        """Checks that apply to every trial."""
        c.needs_channel("pressure")
        c.positives(self, ("trial", "open_loop"), "amplitude", "hold", "settle")

    def steps(self, c: Compilation, point: Point, span: Span, place: Location) -> list[Step]:
        """Steps while a trial is recorded; commands stay in `span`, `place` is that of the bias in the file."""
        bias, (low, high) = point["bias"], span
        if not low <= bias - self.amplitude < bias + self.amplitude <= high:
            c.fault(place, 'with the amplitude of the steps lies outside the range "pressure" of the trial')
        found: list[Step] = [Hold("settle", self.settle)]
        for value in (bias + self.amplitude, bias, bias - self.amplitude, bias) * self.cycles:
            found += [Set("open-loop", "pressure", value), Hold("open-loop", self.hold)]
        return found


def _seek(law: str, parameters: dict[str, Any], limit: float, point: Point, span: Span) -> list[Step]:
    """A search by a law with time limit `limit` [s]; its commands stay in `span`."""
    low, high = span
    fixed = {"setpoint": point["setpoint"], "bias": point["bias"], "low": low, "high": high}
    return [Seek("ultimate-gain", law, "pressure", low, high, limit + 5.0, {**parameters, **fixed}, at_limit="flag")]


class UltimateTrial(Strict):
    """One trial: by `gain_steps`, by `relay` or by `open_loop`."""

    approach: Time
    """Time of the ramp to the bias pressure."""
    pressure: tuple[Pressure, Pressure]
    """Range that the command cannot leave."""
    gain_steps: GainSteps | None = None
    relay: RelayTest | None = None
    open_loop: OpenLoop | None = None


class UltimateGain(ProtocolHead):
    """Protocol of kind ultimate-gain."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement")
    gives: ClassVar[tuple[str, ...]] = ("K_u", "T_u")
    kind: Literal["ultimate-gain"]
    sweep: Sweep[UltimateAxes]
    trial: UltimateTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per set-point a ramp to the bias and one search."""
        trial = self.trial
        c.needs_channel("displacement")
        ways = [way for way in (trial.gain_steps, trial.relay, trial.open_loop) if way is not None]
        if len(ways) != 1:
            c.fault(("trial",), 'needs one of "gain_steps", "relay" and "open_loop"')
            return c.plan("ultimate-gain", {})
        way = ways[0]
        way.check(c)
        c.positive(trial.approach, ("trial", "approach"))
        low, high = trial.pressure
        for place, end in enumerate(trial.pressure):
            c.within("pressure", end, ("trial", "pressure", place))
        for point in expand(self.sweep, c.document):
            bias = point.values["bias"]
            if not low <= bias <= high:
                c.fault(point.places["bias"], 'lies outside the range "pressure" of the trial')
                continue
            setpoint = point.values["setpoint"]
            values = {**c.load(point.values["load"], point.places["load"]), "setpoint": setpoint, "bias": bias}
            c.put_on(values)
            index = c.add_trial(values, point.repeat)
            c.steps += [
                Ramp("approach", "pressure", 0.0, bias, max(bias, 1.0) / max(trial.approach, 1e-3)),
                Hold("approach", 2.0),
                Record("ultimate-gain", True, index),
                *way.steps(c, values, trial.pressure, point.places["bias"]),
                Record("ultimate-gain", False, index),
                Set("vent", "pressure", 0.0),
                Hold("vent", 3.0),
            ]
        return c.plan("ultimate-gain", {"consent": way.consent} if way.consent else {})
