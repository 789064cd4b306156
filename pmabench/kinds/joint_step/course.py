"""One trial of a joint in closed loop: its step, or its sine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np

from pmabench.analysis.shared.response import Response, respond
from pmabench.analysis.shared.samples import (
    NotUsable,
    count_of,
    lags_of,
    noise_of,
    on_time,
    refuse_flagged,
    refuse_incomplete,
    settings_of,
    three_parameter,
)
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

BEFORE = 0.3
"""So long before the step its origin is taken [s]."""
FEWEST_CYCLES = 3
LEAP = 10.0
"""So many standard deviations of the noise are no noise."""


@dataclass(frozen=True, eq=False)
class Course:
    """What both have in common; `t` counts from the step, or from the begin of the sine [s]."""

    run: RunData
    trial: TrialData
    t: Array
    angle: Array
    """[rad]."""
    reference: Array
    """[rad]."""
    saturated: float
    """Share of the samples with a pressure at a limit [1]."""


@dataclass(frozen=True, eq=False)
class Stepped(Course):
    """A step."""

    sign: float
    """Of the step."""
    size: float
    """Of the step [rad]."""
    response: Response
    """Of `sign` times the angle."""


@dataclass(frozen=True, eq=False)
class Swung(Course):
    """A sine."""

    answers: Array
    """Complex ratio of angle and reference in each cycle, shape (cycles,)."""
    errors: Array
    """Rms of angle minus reference in each cycle [rad], shape (cycles,)."""


def course_of(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Stepped | Swung:
    """One trial measured; raises `NotUsable`."""
    refuse_incomplete(trial)
    law = trial.found.get("hold")
    if "angle" not in trial.channels or law is None or law.get("t0") is None:
        raise NotUsable("the angle or what the loop did is not recorded")
    refuse_flagged(trial.usable)
    settings = settings_of(run, options)
    t = trial.t - (float(law["t0"]) + float(settings["begin"]))
    angle, ok = on_time(run, trial, "angle"), trial.usable
    refuse_leaps(t[ok], angle[ok], count_of(run, "angle"))
    window = (float(settings["window"][0]), float(settings["window"][1]))
    saturated = float(law.get("saturated", 0.0))
    if "frequency" in trial.point:
        return _swung(run, trial, t[ok], trial.channels["angle"][ok], window, saturated)
    goal, lag = trial.point["goal"], float(law["reference_lag"])
    before, after = ok & (t >= -BEFORE) & (t < 0), ok & (t >= 0)
    if before.sum() < 8:
        raise NotUsable(f"fewer than 8 samples in the {BEFORE:g} s before the step")
    origin = float(angle[before].mean())
    sign = 1.0 if goal > 0 else -1.0
    step = sign * (goal - origin)
    if step <= float(settings["band"]):
        raise NotUsable(
            f"before the step it was at {show(origin, 'angle', 3)}, which leaves no step to {show(goal, 'angle', 3)}"
        )
    late = np.maximum(t, 0.0) / lag if lag > 0 else np.where(t > 0, np.inf, 0.0)
    reference = goal * (1 - (1 + np.minimum(late, 700.0)) * np.exp(-np.minimum(late, 700.0)))
    try:
        response = respond(
            t[after], sign * angle[after], sign * goal, window, float(settings["band"]) / step, origin=sign * origin,
            resolution=count_of(run, "angle"),
        )  # fmt: skip
    except ValueError as error:
        raise NotUsable(str(error)) from error
    return Stepped(run, trial, t[ok], angle[ok], reference[ok], saturated, sign, step, response)


def refuse_leaps(t: Array, angle: Array, count: float) -> None:
    """Raise `NotUsable` where the angle leaps from one sample to the next, as no joint with a mass turns.

    A leap is what is left of a sample's change after those around it, above noise and what the motion bends elsewhere.
    """
    change = np.diff(angle)
    around = 0.25 * (change[:-4] + change[1:-3] + change[3:-1] + change[4:])
    leaps = np.abs(change[2:-2] - around)
    if not len(leaps):
        return
    worst = int(np.argmax(leaps))
    motion = np.abs(change[max(0, worst - 8) : worst + 13] - np.median(change[max(0, worst - 8) : worst + 13]))
    usual = float(np.sort(motion)[-2])  # the largest change but one
    if leaps[worst] > max(LEAP * noise_of(angle), 3 * count, 2 * usual):
        raise NotUsable(
            f"{show(float(t[worst + 3]), 'time', 3)} after its begin the angle leaps by "
            f"{show(float(leaps[worst]), 'angle', 2)} in one sample: the encoder or its coupling slips"
        )


def _swung(
    run: RunData, trial: TrialData, t: Array, angle: Array, window: tuple[float, float], saturated: float
) -> Swung:
    frequency, amplitude = trial.point["frequency"], trial.point["goal"]
    filtered = 1 + 2j * pi * frequency * lags_of(run, trial)["angle"]
    reference = amplitude * np.sin(2 * pi * frequency * np.maximum(t, 0.0))
    whole = int((window[1] - window[0]) * frequency * (1 + 1e-9))
    if whole < FEWEST_CYCLES:
        raise NotUsable(f"{whole} whole cycles in the window; an interval needs {FEWEST_CYCLES}")
    answers, errors = [], []
    for cycle in range(whole):
        begin = window[0] + cycle / frequency
        rows = (t >= begin) & (t < begin + 1 / frequency)
        if rows.sum() < 20:
            raise NotUsable("fewer than 20 samples in a cycle of the sine")
        _, signals = three_parameter(t[rows], np.column_stack([angle[rows], reference[rows]]), frequency)
        answers.append(complex(filtered * signals[0] / signals[1]))
        left = np.interp(t[rows] + lags_of(run, trial)["angle"], t, angle) - reference[rows]
        errors.append(float(np.sqrt(np.mean(left**2))))
    return Swung(run, trial, t, angle, reference, saturated, np.array(answers), np.array(errors))
