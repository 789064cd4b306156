"""Slow sweeps of a joint's angle both ways, with both muscles held at constant pressure by regulators."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pmabench.files.document import Strict
from pmabench.files.quantity import Angle, AngularSpeed, Time
from pmabench.protocol.common import OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.driven import MUSCLES, at_pressures, not_faster, vented
from pmabench.protocol.plan import Plan, Ramp
from pmabench.protocol.sweep import AngularSpeedAxis, PressureAxis, Sweep, expand


class SweepAxes(Strict):
    """What is swept."""

    pressure_1: PressureAxis
    pressure_2: PressureAxis
    speed: AngularSpeedAxis


class SweepTrial(Strict):
    """One loop: cycles of a ramp of the angle from `lower` to `upper` and back."""

    lower: Angle
    upper: Angle
    cycles: Annotated[int, Field(ge=2, le=1000)]
    discard: Annotated[int, Field(ge=0)] = 1
    """Cycles at the start that the reduction leaves out."""
    settle: Time
    """Time at pressure before the first motion."""
    approach: AngularSpeed
    """Speed from 0 to the lower end and back."""


class JointSweep(ProtocolHead):
    """Protocol of kind joint-sweep."""

    cannot_do_without: ClassVar[tuple[str, ...]] = (*MUSCLES, "angle", "torque")
    checks: ClassVar[tuple[str, ...]] = OF_TRIALS
    kind: Literal["joint-sweep"]
    sweep: Sweep[SweepAxes]
    trial: SweepTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: both muscles to pressure at angle 0, to the lower end, one recorded loop, back to 0."""
        trial = self.trial
        c.positive(trial.settle, ("trial", "settle"))
        not_faster(c, trial.approach, ("trial", "approach"))
        if trial.discard >= trial.cycles:
            c.fault(("trial", "discard"), f"leaves nothing of {trial.cycles} cycles")
        if not trial.upper > trial.lower:
            c.fault(("trial", "upper"), "must lie above the lower end")
        for name in ("lower", "upper"):
            c.within("angle", getattr(trial, name), ("trial", name))
        for point in expand(self.sweep, c.document):
            pressures, speed = c.swept(point, *MUSCLES), point.values["speed"]
            not_faster(c, speed, point.places["speed"])
            if speed <= 0 or trial.approach <= 0 or c.too_long():
                continue
            held = {**dict(zip(MUSCLES, pressures, strict=True)), "angular_speed": speed}
            ends = {"lowest_angle": trial.lower, "highest_angle": trial.upper, "cycles": float(trial.cycles)}
            index = c.add_trial(held | ends, point.repeat)
            cycle = (
                Ramp("rise", "angle", trial.lower, trial.upper, speed),
                Ramp("fall", "angle", trial.upper, trial.lower, speed),
            )
            c.steps += at_pressures(held, trial.settle, trial.lower, trial.approach, index, cycle * trial.cycles)
        c.steps += vented()
        return c.plan("joint-sweep", {"discard": trial.discard})
