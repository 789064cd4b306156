"""Reduction of steps and sines of a joint in closed loop: errors, times, gain and phase, each with an interval.

Also the figure.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import Scales, changes, of_one_channel
from pmabench.analysis.shared.joint import MUSCLES
from pmabench.analysis.shared.lines import mean_of_cycles
from pmabench.analysis.shared.samples import (
    NotUsable,
    fresh,
    lag_of,
    lag_open,
    noise_of,
    refuse_flagged,
    refuse_incomplete,
    settings_of,
    step_of,
    three_parameter,
)
from pmabench.analysis.shared.signals import Response, respond
from pmabench.analysis.shared.skew import late, off
from pmabench.analysis.shared.trials import Reduction, mean_of_trials, point_of
from pmabench.base.quantities import show
from pmabench.kinds.joint_step import RESULTS
from pmabench.plotting.chart import BLUE, BROWN, QUIET
from pmabench.plotting.motion import courses as courses_of
from pmabench.plotting.pictures import Drawn, curve, has, label, of_some
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

BEFORE = 0.3
"""Time before the step over which its origin is averaged [s]."""
FEWEST = 5
"""Samples before the step; an angle that is polled at 20 Hz has 6."""
FEWEST_CYCLES = 3
LEAP = 10.0
"""Smallest leap of the angle, in standard deviations of the noise."""


@dataclass(frozen=True, eq=False)
class Course:
    """Common part of steps and sines; `t` counts from the step, or from the start of the sine [s]."""

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

    values: Mapping[str, float | None]
    """e_th [rad], t_s and t_r [s], OS_th [rad]; None where the angle does not get there."""
    unsure: Mapping[str, float]
    """Half width of each due to sampling, noise, the filter of the angle and its clock."""
    calibration: Mapping[str, float] | None
    """Effect of the uncertainties of the angle's offset and gain on each; None where they are unknown."""
    moves: float
    """Creep or swing of the angle in the window of e_th [rad]; 0 if not significant."""


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
    settings, ok = settings_of(run, options), _rows(trial)
    t, angle = (trial.t - (float(law["t0"]) + float(settings["begin"])))[ok], trial.channels["angle"][ok]
    refuse_leaps(t, angle)
    return (_swung if "frequency" in trial.point else _stepped)(run, trial, t, angle, law, settings)


def _rows(trial: TrialData) -> NDArray[np.bool_]:
    """The usable samples, of an angle that is polled those at which it is new."""
    return np.asarray(trial.usable & fresh(trial.channels["angle"]))


def refuse_leaps(t: Array, angle: Array) -> None:
    """Raise `NotUsable` where the angle leaps from one sample to the next, which no joint with a mass can do.

    A leap is the change of a sample beyond the speed before and after it, above noise, steps of the encoder and what
    the motion shows nearby. Samples may be missing, so changes are taken over their actual time.
    """
    took, at = np.diff(t), 0.5 * (t[1:] + t[:-1])
    speed = np.diff(angle) / took
    if len(speed) < 5:
        return
    near = (0, 1, 3, 4)  # of five changes, those around the middle one
    when, fast = (np.array([one[k : len(one) - 4 + k] for k in near]) for one in (at, speed))
    middle = when.mean(axis=0)
    slope = np.sum((when - middle) * fast, axis=0) / np.sum((when - middle) ** 2, axis=0)
    off = speed[2:-2] - fast.mean(axis=0) - slope * (at[2:-2] - middle)
    leaps = np.abs(off) * took[2:-2]
    worst = int(np.argmax(leaps))
    around = speed[max(0, worst - 8) : worst + 13]
    usual = float(np.sort(np.abs(around - np.median(around)))[-2] * took[worst + 2])  # the largest change but one
    step = step_of(angle)
    if leaps[worst] > max(LEAP * noise_of(angle), 3 * step, 2 * usual):
        raise NotUsable(
            f"{show(float(t[worst + 3]), 'time', 3)} after its begin the angle leaps by "
            f"{show(float(leaps[worst]), 'angle', 2)} in one sample: the encoder or its coupling slips"
        )


def _stepped(
    run: RunData, trial: TrialData, t: Array, angle: Array, law: Mapping[str, Any], settings: Mapping[str, Any]
) -> Stepped:
    before, after = (t >= -BEFORE) & (t < 0), t >= 0
    if before.sum() < FEWEST:
        raise NotUsable(f"fewer than {FEWEST} samples in the {BEFORE:g} s before the step")
    goal, origin = trial.point["goal"], float(angle[before].mean())
    sign = 1.0 if goal > 0 else -1.0
    band, step = float(settings["band"]), step_of(angle)
    if sign * (goal - origin) <= band:
        raise NotUsable(
            f"before the step it was at {show(origin, 'angle', 3)}, which leaves no step to {show(goal, 'angle', 3)}"
        )
    window = (float(settings["window"][0]), float(settings["window"][1]))

    def measured(more: float = 0.0, gain: float = 0.0, later: float = 0.0) -> tuple[Response, dict[str, float | None]]:
        """With an angle `more` [rad] and a share `gain` larger, and an additional filter of the sensor, `later` [s]."""
        start, x = sign * (origin * (1 + gain) + more), sign * (angle[after] * (1 + gain) + more)
        size = sign * goal - start
        r = respond(
            t[after], x, sign * goal, window, band / size, origin=start, resolution=step if step < np.inf else 0.0,
            lag=lag_of(run, "angle") + later,
        )  # fmt: skip
        return r, {"e_th": -sign * r.error, "t_s": r.settling, "t_r": r.rise, "OS_th": r.overshoot * size}

    open_ = lag_open(run, "angle")
    try:
        response, values = measured()
        filtered = changes(values, measured(later=open_)[1])
        calibration = of_one_channel(lambda *end: measured(*end)[1], values, Scales.of([run]), "angle")
    except ValueError as error:
        raise NotUsable(str(error)) from error
    seen, size = response.unsure, sign * (goal - origin)
    # the filter also delays the first sample within the band
    settles = max(filtered["t_s"], open_ + 0.5 * float(np.median(np.diff(t))))
    unsure = {
        "e_th": max(seen.error, seen.creep),
        "t_s": hypot(seen.settling, settles, off([run], "angle")),
        "t_r": hypot(seen.rise, filtered["t_r"]),
        "OS_th": hypot(seen.overshoot * size, filtered["OS_th"]),
    }
    since = np.clip(t / max(float(law["reference_lag"]), 1e-9), 0.0, 700.0)  # in lags of the reference
    reference = goal * (1 - (1 + since) * np.exp(-since))
    saturated = float(law.get("saturated", 0.0))
    moves = response.wander if seen.creep or response.cycle is not None else 0.0
    return Stepped(run, trial, t, angle, reference, saturated, values, unsure, calibration, moves)


def _swung(
    run: RunData, trial: TrialData, t: Array, angle: Array, law: Mapping[str, Any], settings: Mapping[str, Any]
) -> Swung:
    frequency, lag, window = trial.point["frequency"], lag_of(run, "angle"), settings["window"]
    reference = trial.point["goal"] * np.sin(2 * pi * frequency * np.maximum(t, 0.0))
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
        answers.append(complex((1 + 2j * pi * frequency * lag) * signals[0] / signals[1]))
        left = np.interp(t[rows] + lag, t, angle) - reference[rows]
        errors.append(float(np.sqrt(np.mean(left**2))))
    saturated = float(law.get("saturated", 0.0))
    return Swung(run, trial, t, angle, reference, saturated, np.array(answers), np.array(errors))


STEP, SINE = "step in closed loop", "sine in closed loop"
SATURATED = 0.05
"""Share of the samples with a pressure at a limit above which it is reported."""
STEPPED = {"e_th": ("rad", "angle"), "t_s": ("s", "time"), "t_r": ("s", "time"), "OS_th": ("rad", "angle")}
"""Symbol of a step -> unit and quantity."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """End error e_th [rad], settling and rise time [s] and overshoot [rad] of steps; gain, phase and error of sines.

    `options`: `window` [s], `band` [rad] and `begin` [s], in place of the plan's.
    """
    result = Reduction.of("joint-step", RESULTS, runs, options, course_of)
    for key, members in result.cells(lambda one: point_of(one.trial)):
        steps = [one for one in members if isinstance(one, Stepped)]
        sines = [one for one in members if isinstance(one, Swung)]
        band = float(settings_of(members[0].run, result.options)["band"])
        result.estimates += _of_steps(dict(key), steps, band) if steps else _of_sines(dict(key), sines, result.scales)
        result.traces.append(_trace(dict(key), members[-1]))
        if moves := max((one.moves for one in steps), default=0.0):
            text = f"{members[0].trial.name}: in the window of e_th the angle moves by up to {show(moves, 'angle', 2)}"
            text += ", by creep, a drift or a cycle, and e_th is what it is there. Hold longer, with a later window"
            result.findings.append(Finding("doubt", text))
        if (most := max(one.saturated for one in members)) > SATURATED:
            text = (
                f"{members[0].trial.name}: a pressure was at its limit for {most:.0%} of the time: the joint is not as "
            )
            result.findings.append(Finding("doubt", f"{text}stiff as asked for, and the loop is slower"))
    result.doubt_dropped()
    result.note_lack(("angle",), ("angle",))
    return result.analysis()


def _of_steps(at: Mapping[str, float], steps: Sequence[Stepped], band: float) -> Iterator[Estimate]:
    trials = tuple(one.trial.name for one in steps)
    end = show(float(np.mean([one.values["e_th"] or 0.0 for one in steps])), "angle", 3)
    for symbol, kind in STEPPED.items():
        known = [value for one in steps if (value := one.values[symbol]) is not None]
        if len(known) < len(steps):
            place = f"within {show(band, 'angle')} of the goal" if symbol == "t_s" else "from 10 to 90 % of the step"
            why = f"{len(steps) - len(known)} of {len(steps)} trials do not come {place}: they end {end} off it"
            yield Estimate(symbol, None, *kind, STEP, at, n=len(known), note=why, trials=trials)
            continue
        by_scale = max((one.calibration[symbol] for one in steps if one.calibration is not None), default=None)
        unsure = max(one.unsure[symbol] for one in steps)
        yield mean_of_trials(symbol, kind, STEP, at, trials, known, unsure, by_scale, "one trial: no interval")


def _of_sines(at: Mapping[str, float], sines: Sequence[Swung], scales: Scales) -> Iterator[Estimate]:
    trials = tuple(one.trial.name for one in sines)
    # phases are compared about their common direction, since one near -180 deg may appear as +180 deg
    middle = complex(np.mean(np.concatenate([one.answers for one in sines])))
    phases = [np.angle(one.answers / middle) + np.angle(middle) for one in sines]
    turned = 2 * pi * at["frequency"] * max(late(one.run, "angle") for one in sines)
    filtered = 2 * pi * at["frequency"] * max(lag_of(one.run, "angle") for one in sines)
    in_time = {"g_th": turned * (turned + filtered), "phi_th": turned, "e_s": turned * abs(at["goal"]) / 2**0.5}
    rows: tuple[tuple[str, tuple[str, str], list[Array], dict[str, float]], ...] = (
        ("g_th", ("1", "ratio"), [np.abs(one.answers) for one in sines], {"angle": abs(middle)}),
        ("phi_th", ("rad", "angle"), phases, {}),
        ("e_s", ("rad", "angle"), [one.errors for one in sines], {"angle": at["goal"]}),
    )
    for symbol, kind, values, gains in rows:
        mean, half = mean_of_cycles(values)
        parts = Parts(half, in_time[symbol], scales.part(gains) if gains else None)
        yield Estimate(symbol, mean, *kind, SINE, at, parts, len(sines), trials=trials)


def _trace(at: Mapping[str, float], one: Course) -> Trace:
    """Angle, reference and pressures of the last trial of an operating point."""
    kind = "sine" if isinstance(one, Swung) else "step"
    columns = {"t": one.t, "angle": one.angle, "reference": one.reference}
    columns |= {n: one.trial.channels[n][_rows(one.trial)] for n in MUSCLES if n in one.trial.channels}
    quantities = dict.fromkeys(columns, "pressure") | {"t": "time", "angle": "angle", "reference": "angle"}
    title = f"{kind} of {show(at['goal'], 'angle', 3)}, integral {show(at['integral'], 'angular integral gain', 3)}"
    return Trace(f"joint-{kind}-{one.trial.number}", "joint-step", title, columns, quantities, dict(at))


MOST = 3
"""Most trials in the figure."""


@of_some("Angle in closed loop", MOST, "t", "angle", "reference")
def courses(traces: Sequence[Trace]) -> Drawn:
    """Angle with its goal, and the pressure of muscle 1, for the last trial of each operating point."""
    looks = [("reference", QUIET), ("angle", BLUE)]
    looks += [("pressure_1", BROWN)] if all(has(trace, "pressure_1") for trace in traces) else []
    labels = [label(traces[0], name) for name in ("t", *dict(looks))]
    stacks = [(one.title, [curve(one, "t", name, "", color, width=1.0) for name, color in looks], ()) for one in traces]
    caption = (
        "The reference, the angle that followed, and the pressure of muscle 1, in the last trial of each point; "
        "muscle 2 does the opposite."
    )
    return courses_of(stacks, labels), caption
