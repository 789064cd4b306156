"""Torque of a joint at locked angles, from both sides, for pairs of regulated pressures."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pmabench.files.document import Strict
from pmabench.files.quantity import Angle, AngularSpeed, Time
from pmabench.protocol.common import OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.driven import MUSCLES, at_pressures, not_faster, vented
from pmabench.protocol.plan import Hold, Plan, Ramp, Step
from pmabench.protocol.sweep import PressureAxis, Sweep, expand


class TorqueAxes(Strict):
    """What is swept."""

    pressure_1: PressureAxis
    pressure_2: PressureAxis


class TorqueTrial(Strict):
    """One pair of pressures: the angles in rising and then in falling order."""

    angles: Annotated[list[Angle], Field(min_length=2, max_length=200)]
    """Angles at which the joint is locked, rising."""
    overrun: Angle
    """Overtravel beyond the first and last angle, so that turns have decayed at every angle."""
    cycles: Annotated[int, Field(ge=2, le=1000)] = 2
    settle: Time
    """Time at pressure before the first motion."""
    rest: Time
    """Time at each angle; its second half is averaged."""
    speed: AngularSpeed
    """Speed between angles."""


class JointTorque(ProtocolHead):
    """Protocol of kind joint-torque."""

    cannot_do_without: ClassVar[tuple[str, ...]] = (*MUSCLES, "angle", "torque")
    checks: ClassVar[tuple[str, ...]] = OF_TRIALS
    kind: Literal["joint-torque"]
    sweep: Sweep[TorqueAxes]
    trial: TorqueTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: both muscles to pressure at angle 0, then the angles up and down, and back to 0."""
        trial = self.trial
        c.positives(trial, ("trial",), "settle", "rest", "overrun")
        not_faster(c, trial.speed, ("trial", "speed"))
        if any(b <= a for a, b in pairwise(trial.angles)):
            c.fault(("trial", "angles"), "must rise")
        lowest, highest = trial.angles[0] - trial.overrun, trial.angles[-1] + trial.overrun
        c.within("angle", lowest, ("trial", "overrun"))
        c.within("angle", highest, ("trial", "overrun"))
        for point in expand(self.sweep, c.document):
            held = dict(zip(MUSCLES, c.swept(point, *MUSCLES), strict=True))
            if c.problems or c.too_long():
                continue
            ends = {"lowest_angle": lowest, "highest_angle": highest, "cycles": float(trial.cycles)}
            index = c.add_trial(held | ends, point.repeat)
            there = self._branch("rise", [lowest, *trial.angles, highest])
            back = self._branch("fall", [highest, *reversed(trial.angles), lowest])
            c.steps += at_pressures(held, trial.settle, lowest, trial.speed, index, [*there, *back] * trial.cycles)
        c.steps += vented()
        return c.plan("joint-torque", {"angles": list(trial.angles)})

    def _branch(self, phase: str, places: Sequence[float]) -> list[Step]:
        """From the first place to the last, with a rest at each in between."""
        steps: list[Step] = []
        for here, there in pairwise(places):
            steps += [Ramp(phase, "angle", here, there, self.trial.speed), Hold(phase, self.trial.rest)]
        return steps[:-1]
