"""Ultimate gain and period of the position loop by raising a proportional gain in steps (paper 0, tuning)."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from pmabench.files.document import Strict
from pmabench.files.quantity import Gain, Length, Load, Pressure, Ratio, Time
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.plan import Hold, Plan, Ramp, Record, Seek, Set, TrialRecord
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


class UltimateTrial(Strict):
    """One search."""

    approach: Time
    """Time of the ramp to the bias pressure."""
    pressure: tuple[Pressure, Pressure]
    """Range that the command cannot leave."""
    gain_steps: GainSteps


class UltimateGain(ProtocolHead):
    """Protocol of kind ultimate-gain."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement")
    gives: ClassVar[tuple[str, ...]] = ("K_u", "T_u")
    kind: Literal["ultimate-gain"]
    sweep: Sweep[UltimateAxes]
    trial: UltimateTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per set-point a ramp to the bias and one search."""
        trial, law = self.trial, self.trial.gain_steps
        c.needs_channel("displacement")
        for name in ("start", "step", "kick", "window", "level_time"):
            c.positive(getattr(law, name), ("trial", "gain_steps", name))
        if law.step > 0.08 + 1e-12:
            c.fault(("trial", "gain_steps", "step"), "at most 8 % from level to level")
        if law.window <= law.kick:
            c.fault(("trial", "gain_steps", "window"), "must be larger than the kick")
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
            parameters: dict[str, Any] = {
                "setpoint": setpoint,
                "bias": bias,
                "start": law.start,
                "low": low,
                "high": high,
                "factor": 1.0 + law.step,
                "half_periods": law.half_periods,
                "kick": law.kick,
                "noise": law.noise,
                "settle": law.settle,
                "level_time": law.level_time,
                "levels": law.levels,
                "window": law.window,
            }
            limit = law.settle + law.levels * law.level_time + 5.0
            c.steps += [
                Ramp("approach", "pressure", 0.0, bias, max(bias, 1.0) / max(trial.approach, 1e-3)),
                Hold("approach", 2.0),
                Record("ultimate-gain", True, index),
                Seek("ultimate-gain", "gain-steps", "pressure", low, high, limit, parameters, at_limit="flag"),
                Record("ultimate-gain", False, index),
                Set("vent", "pressure", 0.0),
                Hold("vent", 3.0),
            ]
        return c.plan("ultimate-gain", {"consent": "the loop is taken to the limit of stability"})
