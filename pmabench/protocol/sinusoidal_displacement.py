"""Sinusoidal displacement at constant pressure with a driven end (paper 3, sinusoidal tests)."""

from __future__ import annotations

from math import ceil, isclose, pi
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Length, Speed, Time
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.driven import along_sine, arrive, bearable, leave, not_too_fast
from pmabench.protocol.plan import Follow, Hold, Plan, Record, TrialRecord
from pmabench.protocol.sweep import FrequencyAxis, Point, PressureAxis, Sweep, expand

MOST_CYCLES = 1e9
"""More are not counted: such a plan is refused for its length."""


class SineAxes(Strict):
    """What is swept."""

    pressure: PressureAxis
    frequency: FrequencyAxis


class SineTrial(Strict):
    """One sine: whole cycles, at least `cycles` and at least `at_least` long."""

    mean: Length
    amplitude: Length
    cycles: Annotated[int, Field(ge=3, le=10_000)]
    at_least: Time = 0.0
    discard: Annotated[int, Field(ge=0)] = 1
    """Cycles at the start that do not enter the fit."""
    settle: Time
    """Time at pressure before the first motion."""
    approach: Speed
    """Speed from 0 to the mean and back."""
    time_skew: Time = 0.0
    """Bound on the time between a displacement and its force sample (promise R11)."""


class SinusoidalDisplacement(ProtocolHead):
    """Protocol of kind sinusoidal-displacement."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement", "force")
    gives: ClassVar[tuple[str, ...]] = ("K", "B", "F_c")
    kind: Literal["sinusoidal-displacement"]
    sweep: Sweep[SineAxes]
    trial: SineTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per pressure pressurise and go to the mean; per frequency one recorded sine."""
        trial = self.trial
        for name in ("amplitude", "settle", "approach"):
            c.positive(getattr(trial, name), ("trial", name))
        not_too_fast(c, trial.approach, ("trial", "approach"), "it approaches")
        if trial.discard >= trial.cycles:
            c.fault(("trial", "discard"), f"leaves nothing of {trial.cycles} cycles")
        c.within("displacement", trial.mean - abs(trial.amplitude), ("trial", "amplitude"))
        c.within("displacement", trial.mean + abs(trial.amplitude), ("trial", "amplitude"))
        at: float | None = None
        for index, point in enumerate(expand(self.sweep, c.document)):
            pressure, frequency = point.values["pressure"], point.values["frequency"]
            c.within("pressure", pressure, point.places["pressure"])
            c.positive(frequency, point.places["frequency"])
            if frequency <= 0 or trial.approach <= 0:
                continue
            self._possible(c, point)
            if index == 0:
                c.precondition()
            if at is None or not isclose(at, pressure):
                back_from = None if at is None else trial.mean
                c.steps += arrive(pressure, trial.mean, trial.settle, trial.approach, back_from)
                at = pressure
            cycles = max(trial.cycles, ceil(min(trial.at_least * frequency, MOST_CYCLES) - 1e-9) + trial.discard)
            values = {
                "pressure": pressure,
                "frequency": frequency,
                "mean": trial.mean,
                "amplitude": trial.amplitude,
                "cycles": float(cycles),
            }
            c.trials.append(TrialRecord(index, values, point.repeat))
            c.steps += [
                Record("sine", True, index),
                Follow("sine", "displacement", trial.mean, trial.amplitude, frequency, cycles),
                Record("sine", False, index),
                Hold("rest", 1.0),
            ]
        c.steps += leave(trial.mean, trial.approach)
        return c.plan("sinusoidal-displacement", {"discard": trial.discard, "time_skew": trial.time_skew})

    def _possible(self, c: Compilation, point: Point) -> None:
        """Check the actuator's speed, and the force predicted from what is believed of the specimen."""
        trial, frequency = self.trial, point.values["frequency"]
        where: Location = point.places["frequency"]
        not_too_fast(c, 2 * pi * frequency * trial.amplitude, where, "the sine moves")
        path = along_sine(trial.mean, trial.amplitude, frequency)
        bearable(c, point.values["pressure"], path, where, "mean, amplitude or frequency")
