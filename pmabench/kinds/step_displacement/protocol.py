"""Steps of displacement at constant pressure: force before, at its peak and relaxed (paper 3, steps)."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pmabench.files.document import Strict
from pmabench.files.quantity import Length, Speed, Time
from pmabench.protocol.common import OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.driven import Held, bearable, check_motion, not_pushed_together, not_too_fast
from pmabench.protocol.plan import Hold, Plan, Ramp, Record, Step
from pmabench.protocol.sweep import LengthAxis, Point, PressureAxis, SpeedAxis, Sweep, expand

POINTS = 90
"""Points of each ramp on which the pressure is predicted."""


class StepAxes(Strict):
    """What is swept: pressure, size of the step (negative: stretch first), and its speed."""

    pressure: PressureAxis
    step: LengthAxis
    speed: SpeedAxis


class StepTrial(Strict):
    """Steps there and back, each with a rest after it."""

    start: Length
    """Contraction from which the steps start."""
    hold: Time
    """Rest before the first step and after each one, in which the force relaxes."""
    cycles: Annotated[int, Field(ge=2, le=1000)] = 4
    discard: Annotated[int, Field(ge=0)] = 1
    """Cycles at the start that are left out: they begin on another branch of the hysteresis."""
    settle: Time
    """Time at pressure before the first motion."""
    approach: Speed
    """Speed from 0 to the start and back."""


class StepDisplacement(ProtocolHead):
    """Protocol of kind step-displacement."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement", "force")
    gives: ClassVar[tuple[str, ...]] = ("K",)
    checks: ClassVar[tuple[str, ...]] = OF_TRIALS
    kind: Literal["step-displacement"]
    sweep: Sweep[StepAxes]
    trial: StepTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per pressure, pressurise and move to the start; per step and speed one recorded trial."""
        trial = self.trial
        check_motion(c, trial, "hold", "settle")
        c.within("displacement", trial.start, ("trial", "start"))
        held = Held(c, trial.settle, trial.approach)
        for point in expand(self.sweep, c.document):
            (pressure,), step, speed = c.swept(point, "pressure"), point.values["step"], point.values["speed"]
            c.within("displacement", trial.start + step, point.places["step"])
            c.positive(speed, point.places["speed"])
            if step == 0:
                c.fault(point.places["step"], "a step goes somewhere: above 0 it contracts first, below 0 it stretches")
            if step == 0 or speed <= 0 or trial.approach <= 0 or trial.hold <= 0 or c.too_long():
                continue
            self._possible(c, point)
            values = {"pressure": pressure, "step": step, "speed": speed, "start": trial.start}
            index = c.add_trial({**values, "cycles": float(trial.cycles)}, point.repeat)
            held.go(pressure, trial.start)
            c.steps += [
                Record("before", True, index),
                Hold("before", trial.hold),
                *self._cycle(step, speed) * trial.cycles,
                Record("back", False, index),
            ]
        held.leave()
        return c.plan("step-displacement", {"discard": trial.discard})

    def _cycle(self, step: float, speed: float) -> list[Step]:
        start, end = self.trial.start, self.trial.start + step
        return [
            Ramp("step", "displacement", start, end, speed),
            Hold("step", self.trial.hold),
            Ramp("back", "displacement", end, start, speed),
            Hold("back", self.trial.hold),
        ]

    def _possible(self, c: Compilation, point: Point) -> None:
        """Check the actuator's speed, the predicted force, and the pressure change due to the motion."""
        pressure, step, speed = (point.values[name] for name in ("pressure", "step", "speed"))
        not_too_fast(c, speed, point.places["speed"], "the step moves")
        start, end = self.trial.start, self.trial.start + step
        bearable(c, pressure, [(x, v) for x in (start, end) for v in (speed, -speed, 0.0)], point.places["step"],
                 "the start or the step")  # fmt: skip

        def motion(share: float) -> tuple[list[float], float]:
            """From the larger contraction: a stretch, an equally long rest, and the way back."""
            high, low = max(start, start + share * step), min(start, start + share * step)
            down = [high - (high - low) * i / POINTS for i in range(POINTS + 1)]
            return [*down, *[low] * POINTS, *reversed(down), *[high] * POINTS], 4 * (high - low) / speed

        pace = (speed, "speed", "speed")
        not_pushed_together(c, pressure, motion, (abs(step), "length", "step"), pace, point.places["step"])
