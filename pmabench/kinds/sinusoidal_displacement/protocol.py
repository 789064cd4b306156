"""Sinusoidal displacement at constant pressure with a driven end (paper 3, sinusoidal tests)."""

from __future__ import annotations

from math import ceil, pi
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Length, Speed, Time
from pmabench.protocol.common import OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.driven import Held, along_sine, bearable, check_motion, not_pushed_together, not_too_fast
from pmabench.protocol.plan import Follow, Hold, Plan, Record
from pmabench.protocol.sweep import FrequencyAxis, LengthAxis, Point, PressureAxis, Sweep, expand

MOST_CYCLES = 1e9
"""Upper bound for counting cycles; a plan with more is refused because of its length."""


class SineAxes(Strict):
    """What is swept; the amplitude only if it differs between frequencies."""

    pressure: PressureAxis
    frequency: FrequencyAxis
    amplitude: LengthAxis | None = None


class SineTrial(Strict):
    """One sine: whole cycles, at least `cycles` and at least `at_least` long."""

    mean: Length
    amplitude: Length | None = None
    cycles: Annotated[int, Field(ge=3, le=10_000)]
    at_least: Time = 0.0
    discard: Annotated[int, Field(ge=0)] = 1
    """Cycles at the start that the fit leaves out."""
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
    checks: ClassVar[tuple[str, ...]] = OF_TRIALS
    kind: Literal["sinusoidal-displacement"]
    sweep: Sweep[SineAxes]
    trial: SineTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per pressure, pressurise and move to the mean; per frequency one recorded sine."""
        trial = self.trial
        check_motion(c, trial, "settle")
        held = Held(c, trial.settle, trial.approach)
        for point in expand(self.sweep, c.document):
            (pressure,), frequency = c.swept(point, "pressure"), point.values["frequency"]
            c.positive(frequency, point.places["frequency"])
            amplitude = self._amplitude(c, point)
            if frequency <= 0 or trial.approach <= 0 or amplitude is None:
                continue
            self._possible(c, point, amplitude)
            cycles = max(trial.cycles, ceil(min(trial.at_least * frequency, MOST_CYCLES) - 1e-9) + trial.discard)
            values = {"pressure": pressure, "frequency": frequency, "mean": trial.mean, "amplitude": amplitude}
            index = c.add_trial({**values, "cycles": float(cycles)}, point.repeat)
            held.go(pressure, trial.mean)
            c.steps += [
                Record("sine", True, index),
                Follow("sine", "displacement", trial.mean, amplitude, frequency, cycles),
                Record("sine", False, index),
                Hold("rest", 1.0),
            ]
        held.leave()
        return c.plan("sinusoidal-displacement", {"discard": trial.discard, "time_skew": trial.time_skew})

    def _amplitude(self, c: Compilation, point: Point) -> float | None:
        """Amplitude of a point [m], checked; None where it has none."""
        amplitude = point.values.get("amplitude", self.trial.amplitude)
        where: Location = point.places.get("amplitude", ("trial", "amplitude"))
        if amplitude is None:
            c.fault(("trial",), 'lacks "amplitude", which the sweep does not give either')
            return None
        c.positive(amplitude, where)
        c.within("displacement", self.trial.mean - abs(amplitude), where)
        c.within("displacement", self.trial.mean + abs(amplitude), where)
        return float(amplitude) if amplitude > 0 else None

    def _possible(self, c: Compilation, point: Point, amplitude: float) -> None:
        """Check the actuator's speed, the predicted force, and the pressure change due to the motion."""
        mean, frequency, pressure = self.trial.mean, point.values["frequency"], point.values["pressure"]
        where: Location = point.places["frequency"]
        not_too_fast(c, 2 * pi * frequency * amplitude, where, "the sine moves")
        bearable(c, pressure, along_sine(mean, amplitude, frequency), where, "mean, amplitude or frequency")

        def motion(share: float) -> tuple[list[float], float]:
            return [x for x, _ in along_sine(mean, share * amplitude, frequency)], 1 / frequency

        pace = (frequency, "frequency", "frequency")
        not_pushed_together(c, pressure, motion, (amplitude, "length", "amplitude"), pace, where)
