"""Ultimate gain and period of the position loop: by a rising gain (paper 0), by a relay, or by steps without a loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Force, Gain, Length, Load, Pressure, Ratio, Time
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.plan import Hold, Plan, Ramp, Record, Seek, Set, Step, TrialRecord
from pmabench.protocol.sweep import LengthAxis, Sweep, expand


class UltimateAxes(Strict):
    """What is swept: set-points with the pressure that is expected to hold each, and the load."""

    setpoint: LengthAxis
    bias: Annotated[list[Pressure], Field(min_length=1)]
    load: Annotated[list[Load], Field(min_length=1)]


class GainSteps(Strict):
    """The law: at each level a small kick, then half periods are counted; the gain rises until swings grow."""

    start: Gain
    step: Ratio
    levels: Annotated[int, Field(ge=1, le=200)]
    half_periods: Annotated[int, Field(ge=8, le=200)]
    kick: Length
    noise: Length
    window: Length
    level_time: Time
    settle: Time


class RelayTest(Strict):
    """The law: the command switches between two values about the bias, at each amplitude in turn."""

    amplitudes: Annotated[list[Pressure], Field(min_length=2, max_length=4)]
    """Half of the switching of the command."""
    hysteresis: Annotated[list[Length], Field(min_length=2, max_length=4)]
    """Of each amplitude, in one ratio to it: so friction can be distinguished from a linear loop."""
    asymmetry: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    """Above 0 the command goes further up than down; the means then give the static gain."""
    periods: Annotated[int, Field(ge=8, le=100)]
    level_time: Time
    settle: Time
    window: Length
    """Largest distance from the set-point."""
    measured: tuple[Pressure, Pressure]
    """Window of the measured pressure."""
    force: tuple[Force, Force] | None = None
    """Window of the measured force."""


class OpenLoop(Strict):
    """No loop: steps of the command, up, back, down and back, from which a model of the loop is fitted."""

    amplitude: Pressure
    """Height of a step, to both sides of the bias."""
    hold: Time
    """After each step; long enough to come to rest."""
    cycles: Annotated[int, Field(ge=3, le=100)]
    """Of four steps; the scatter between cycles makes the interval."""
    settle: Time


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
        ways = (trial.gain_steps, trial.relay, trial.open_loop)
        if sum(way is not None for way in ways) != 1:
            c.fault(("trial",), 'needs one of "gain_steps", "relay" and "open_loop"')
            return c.plan("ultimate-gain", {})
        if trial.gain_steps is not None:
            _check_steps(c, trial.gain_steps)
        if trial.relay is not None:
            _check_relay(c, trial.relay)
        if trial.open_loop is not None:
            c.needs_channel("pressure")
            for name in ("amplitude", "hold", "settle"):
                c.positive(getattr(trial.open_loop, name), ("trial", "open_loop", name))
        c.positive(trial.approach, ("trial", "approach"))
        low, high = trial.pressure
        c.within("pressure", low, ("trial", "pressure", 0))
        c.within("pressure", high, ("trial", "pressure", 1))
        for index, point in enumerate(expand(self.sweep, c.document)):
            bias = point.values["bias"]
            if not low <= bias <= high:
                c.fault(point.places["bias"], 'lies outside the range "pressure" of the trial')
                continue
            setpoint = point.values["setpoint"]
            values = {**c.load(point.values["load"], point.places["load"]), "setpoint": setpoint, "bias": bias}
            c.put_on(values)
            if index == 0:
                c.precondition()
            c.trials.append(TrialRecord(index, values, point.repeat))
            c.steps += [
                Ramp("approach", "pressure", 0.0, bias, max(bias, 1.0) / max(trial.approach, 1e-3)),
                Hold("approach", 2.0),
                Record("ultimate-gain", True, index),
                *_steps_of(c, trial, values, point.places["bias"]),
                Record("ultimate-gain", False, index),
                Set("vent", "pressure", 0.0),
                Hold("vent", 3.0),
            ]
        consent = {}
        if trial.gain_steps is not None:
            consent = {"consent": "the loop is taken to the limit of stability"}
        elif trial.relay is not None:
            consent = {"consent": "a relay makes the loop swing"}
        return c.plan("ultimate-gain", consent)


def _steps_of(c: Compilation, trial: UltimateTrial, point: Mapping[str, float], place: Location) -> list[Step]:
    """What happens while a trial is recorded; `place` is that of its bias."""
    bias, (low, high) = point["bias"], trial.pressure
    if trial.open_loop is not None:
        steps = trial.open_loop
        if not low <= bias - steps.amplitude < bias + steps.amplitude <= high:
            c.fault(place, 'with the amplitude of the steps lies outside the range "pressure" of the trial')
        found: list[Step] = [Hold("settle", steps.settle)]
        for value in (bias + steps.amplitude, bias, bias - steps.amplitude, bias) * steps.cycles:
            found += [Set("open-loop", "pressure", value), Hold("open-loop", steps.hold)]
        return found
    if trial.relay is not None:
        _inside(c, trial.relay, trial.pressure, bias, place)
    searches = [_relay(trial.relay)] if trial.relay is not None else []
    searches += [_steps(trial.gain_steps)] if trial.gain_steps is not None else []
    fixed = {"setpoint": point["setpoint"], "bias": bias, "low": low, "high": high}
    return [
        Seek("ultimate-gain", law, "pressure", low, high, limit, {**parameters, **fixed}, at_limit="flag")
        for law, parameters, limit in searches
    ]


def _check_steps(c: Compilation, law: GainSteps) -> None:
    for name in ("start", "step", "kick", "window", "level_time"):
        c.positive(getattr(law, name), ("trial", "gain_steps", name))
    if law.step > 0.08 + 1e-12:
        c.fault(("trial", "gain_steps", "step"), "at most 8 % from level to level")
    if law.window <= law.kick:
        c.fault(("trial", "gain_steps", "window"), "must be larger than the kick")


def _check_relay(c: Compilation, law: RelayTest) -> None:
    c.needs_channel("pressure")
    if law.force is not None:
        c.needs_channel("force")
    for name in ("level_time", "settle", "window"):
        c.positive(getattr(law, name), ("trial", "relay", name))
    for name, values in (("amplitudes", law.amplitudes), ("hysteresis", law.hysteresis)):
        for index, value in enumerate(values):
            c.positive(value, ("trial", "relay", name, index))
    if len(law.amplitudes) != len(law.hysteresis):
        c.fault(("trial", "relay", "hysteresis"), 'needs as many values as "amplitudes"')
        return
    if min(*law.amplitudes, *law.hysteresis) <= 0:
        return
    ratios = [h / d for d, h in zip(law.amplitudes, law.hysteresis, strict=True)]
    if max(ratios) > 1.01 * min(ratios):
        c.fault(("trial", "relay", "hysteresis"), "must be in one ratio to the amplitudes, so that friction is seen")
    if max(law.amplitudes) < 1.5 * min(law.amplitudes):
        c.fault(("trial", "relay", "amplitudes"), "the largest must be at least 1.5 times the smallest")
    if law.window <= 2 * max(law.hysteresis):
        c.fault(("trial", "relay", "window"), "must be larger than twice the largest hysteresis")
    for name, ends in (("measured", law.measured), ("force", law.force)):
        if ends is not None and not ends[0] < ends[1]:
            c.fault(("trial", "relay", name), "the first value must be below the second")


def _inside(c: Compilation, relay: RelayTest, span: tuple[float, float], bias: float, place: Location) -> None:
    """The relay's commands must lie in the range `span`, the bias in the window of the measured pressure."""
    d, (low, high) = max(relay.amplitudes), span
    if not (low <= bias - d * (1 - relay.asymmetry) and bias + d * (1 + relay.asymmetry) <= high):
        c.fault(place, 'with the largest amplitude lies outside the range "pressure" of the trial')
    if not relay.measured[0] < bias < relay.measured[1]:
        c.fault(place, 'lies outside the window "measured" of the relay')


def _steps(law: GainSteps) -> tuple[str, dict[str, Any], float]:
    """Law, its parameters, and its longest time [s]."""
    parameters = {"factor": 1.0 + law.step, **law.model_dump(exclude={"step"})}
    return "gain-steps", parameters, law.settle + law.levels * law.level_time + 5.0


def _relay(law: RelayTest) -> tuple[str, dict[str, Any], float]:
    """Law, its parameters, and its longest time [s]."""
    watched = {"pressure": list(law.measured)} | ({} if law.force is None else {"force": list(law.force)})
    parameters = {**law.model_dump(exclude={"measured", "force"}), "watched": watched}
    return "relay", parameters, law.settle + len(law.amplitudes) * law.level_time + 5.0
