"""Pressure steps without load, to compare a model with the muscle (paper 0, validation)."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from pmabench.files.document import Strict
from pmabench.files.quantity import Load, Time
from pmabench.protocol.common import OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.plan import Hold, Plan, Record, Set
from pmabench.protocol.reference_model import ReferenceModel, described
from pmabench.protocol.sweep import PressureAxis, Sweep, expand


class ValidationAxes(Strict):
    """What is swept: loads, and target pressures of the steps."""

    load: Annotated[list[Load], Field(min_length=1)]
    pressure: PressureAxis


class ValidationTrial(Strict):
    """One step from rest, and a hold."""

    baseline: Time = 0.2
    hold: Time
    window: tuple[Time, Time]
    """Part of the hold, from the step on, over which measured and simulated contraction are averaged."""
    rest: Time = 3.0
    """Time without pressure between two steps."""


class Validation(ProtocolHead):
    """Protocol of kind validation."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement")
    checks: ClassVar[tuple[str, ...]] = OF_TRIALS
    kind: Literal["validation"]
    sweep: Sweep[ValidationAxes]
    trial: ValidationTrial
    model: ReferenceModel

    def compile(self, c: Compilation) -> Plan:
        """The plan: per trial a rest, one step of pressure, and a vent."""
        trial = self.trial
        c.positive(trial.hold, ("trial", "hold"))
        c.inside_hold(trial.window, trial.hold)
        for point in expand(self.sweep, c.document):
            (pressure,) = c.swept(point, "pressure")
            c.positive(pressure, point.places["pressure"])
            values = {**c.load(point.values["load"], point.places["load"]), "pressure": pressure}
            c.put_on(values)
            if c.too_long():
                break
            index = c.add_trial(values, point.repeat)
            c.steps += [
                Record("rest", True, index),
                Hold("rest", trial.baseline),
                Set("step", "pressure", pressure),
                Hold("step", trial.hold),
                Record("step", False, index),
                Set("vent", "pressure", 0.0),
                Hold("vent", trial.rest),
            ]
        settings: dict[str, Any] = {"window": list(trial.window)}
        model = described(c, self.model, ("model",))
        return c.plan("validation", settings | ({"model": model} if model is not None else {}))
