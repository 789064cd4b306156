"""Sinusoidal displacement at constant pressure with a driven end (paper 3, sinusoidal tests)."""

from __future__ import annotations

from math import ceil, cos, isclose, pi, sin
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pmabench.base.quantities import show
from pmabench.bench.files import ExpectedFile
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Length, Speed, Time
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.plan import Follow, Hold, Plan, Ramp, Record, Set, TrialRecord
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
        actuator = c.mounted.bench_file.actuator
        if actuator is not None and trial.approach > actuator.speed:
            c.fault(("trial", "approach"), f"the actuator moves at most at {show(actuator.speed, 'speed')}")
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
                c.steps += self._arrive(pressure, first=at is None)
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
        if trial.approach > 0:
            c.steps.append(Ramp("return", "displacement", trial.mean, 0.0, trial.approach))
        c.steps += [Set("vent", "pressure", 0.0), Hold("vent", 3.0)]
        return c.plan("sinusoidal-displacement", {"discard": trial.discard, "time_skew": trial.time_skew})

    def _arrive(self, pressure: float, *, first: bool) -> list[Set | Hold | Ramp]:
        trial = self.trial
        back = [] if first else [Ramp("return", "displacement", trial.mean, 0.0, trial.approach)]
        return [
            *back,
            Set("pressurise", "pressure", pressure),
            Hold("pressurise", trial.settle),
            Ramp("approach", "displacement", 0.0, trial.mean, trial.approach),
            Hold("approach", 1.0),
        ]

    def _possible(self, c: Compilation, point: Point) -> None:
        """Check the actuator's speed, and the force predicted from what is believed of the specimen."""
        trial, frequency, pressure = self.trial, point.values["frequency"], point.values["pressure"]
        where: Location = point.places["frequency"]
        actuator = c.mounted.bench_file.actuator
        if actuator is None:
            return
        speed = 2 * pi * frequency * trial.amplitude
        if speed > actuator.speed:
            c.fault(
                where,
                f"the sine moves at {show(speed, 'speed')}; the actuator at most at {show(actuator.speed, 'speed')}",
            )
        expected = c.mounted.specimen_file.expected
        if expected is None:
            return
        low, high = predicted_force(expected, pressure, trial.mean, trial.amplitude, frequency)
        slack = c.mounted.bench.slack_below
        if low < slack:
            c.fault(
                where,
                f"at {show(pressure, 'pressure')} the force is predicted to fall to {low:.0f} N: the specimen goes "
                "slack (raise the pressure, or lower mean, amplitude or frequency)",
            )
        if high > actuator.force:
            c.fault(where, f"the force is predicted to reach {high:.0f} N; the actuator bears {actuator.force:.0f} N")


def predicted_force(
    expected: ExpectedFile, pressure: float, mean: float, amplitude: float, frequency: float
) -> tuple[float, float]:
    """Lowest and highest force [N] of F_ce - K x - B x' - F_c sign(x') over one period (paper 0)."""
    points = sorted(expected.points, key=lambda point: point.pressure)
    below = max((p for p in points if p.pressure <= pressure), key=lambda p: p.pressure, default=points[0])
    above = min((p for p in points if p.pressure >= pressure), key=lambda p: p.pressure, default=points[-1])
    span = above.pressure - below.pressure
    share = (pressure - below.pressure) / span if span > 0 else 0.0
    f_ce, k, b_c, b_r = (
        getattr(below, name) + share * (getattr(above, name) - getattr(below, name))
        for name in ("F_ce", "K", "B_c", "B_r")
    )
    forces = []
    for step in range(720):
        phase = 2 * pi * step / 720
        x = mean + amplitude * sin(phase)
        v = 2 * pi * frequency * amplitude * cos(phase)
        forces.append(f_ce - k * x - (b_c if v > 0 else b_r) * v - (expected.F_c if v > 0 else -expected.F_c))
    return min(forces), max(forces)
