"""Steps of pressure from other programs: dead time, rise, stroke and B/K, and K and B from ringing.

Uses trials with one command each and measured pressure and displacement, from any source. The mass that
rings is taken as exact.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import hypot, sqrt
from typing import Any

import numpy as np

from pmabench.analysis.imported import UNTOLD, UNTOLD_TIME, apart_is_known, flagged_counts, import_findings
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.samples import OF_TWO, STEPS, UNDECLARED, Held, left
from pmabench.analysis.shared.student import mean_over, mean_with_half
from pmabench.analysis.shared.trials import grouped, measured_trials
from pmabench.analysis.verdict.agreement import Offer, everywhere, values_of
from pmabench.base.quantities import show
from pmabench.kinds.recorded_step import RESULTS, motion
from pmabench.kinds.recorded_step.motion import Delayed, fit_delayed, fit_swings
from pmabench.kinds.recorded_step.step import AFTER, SEEN, Step, measure
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import Array, RunData

KIND = "recorded-step"
STEP = "recorded-step"
SWUNG = 7.0
"""Decay times after which an oscillation counts as over: a thousandth is left."""
OVERSHOOT = 0.05
DRIVEN = "driven-delay"
TO_MOTION = "command-to-motion"
WIDEST = 0.5
"""B/K is given if it lies within this share of its value for all motions that fit equally well."""
LONGEST = 0.02
"""A dead time with a wider interval than +- this [s] is withheld."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """t_d [s], tau_P [s], X [m], dP/dx [Pa/m] and, if possible, K [N/m] and B [N.s/m] of recorded steps.

    Pressure and displacement at one load give only the ratios B/K and (dF_ce/dP)/K, never K itself. If the moving
    `mass` of the point is known and the motion rings, M x'' + B x' + K x = (dF_ce/dP) P + const with the measured
    pressure gives K = M w^2 and B = 2 D w M. It rings if its damping ratio is below a half and two or more extremes
    show; otherwise the mass has an effect in the fast pole B/M only, which a few ms between the channels hide. The time
    between pressure and motion, up to 40 ms, is fitted with them. Along the step K changes with the pressure, and B may
    change, or dry friction act, each to first order: K and B at the end of the step are the range of all forms that fit
    equally well, and are withheld where it is wider than +-15 %. Lags of sensors (`sensor_lag`, first order) are
    corrected, with an uncertainty of a fifth.

    Repeats are trials with the same load and commanded pressures before and after.
    """
    steps, dropped = measured_trials(runs, lambda run, trial: (run, measure(run, trial)))
    read_off = apart_is_known(runs)
    loads = len({_load(step) for _, step in steps}) > 1
    groups = grouped(steps, lambda one: (*_pair(one[1]), *(_load(one[1]) if loads else ())))
    commanded = [step for _, step in steps if not step.found]
    late = 0.0 if read_off else UNTOLD
    estimates: list[Estimate] = [_dead_time(commanded, late)] if commanded else []
    findings: list[Finding] = []
    for key, group in sorted(groups.items()):
        at = dict(zip(("from", "pressure", "load", "mass"), key, strict=False))
        estimates += _at(at, group, late)
        findings += _sentences(at, [step for _, step in group])
    findings += _of_all(steps, estimates, read_off=read_off)
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates,
        dropped=dropped,
        findings=(*import_findings(runs), *findings),
        traces=(_trace(group[0][1], by_load=loads) for _, group in sorted(groups.items())),
        facts={
            "trials": len(steps),
            "cells": len(groups),
            "flagged": flagged_counts(runs),
            "steps": [_facts(step) for _, step in steps],
        },
    )


def _of_all(steps: Sequence[tuple[RunData, Step]], estimates: Sequence[Estimate], *, read_off: bool) -> list[Finding]:
    """Findings on all steps; `read_off`: whether the time between the channels is known."""
    findings = []
    found = sum(step.found for _, step in steps)
    if found:
        findings.append(Finding("note", f"{found} steps were found in the measured pressure: they tell no dead time"))
    if steps and not read_off:
        findings.append(Finding("doubt", f"{UNTOLD_TIME}: the dead times assume at most {show(UNTOLD, 'time')}"))
    if any(e.method == RINGING and e.value is not None for e in estimates):
        text = "K and B rest on the moving mass alone, taken as exact; the load hangs and F_ce(P) is not known here"
        findings.append(Finding("doubt", text))
    return findings


def _pair(step: Step) -> tuple[float, float]:
    """Commanded pressures before and after [Pa]."""
    return round(step.trial.point["from"], -2), round(step.trial.point["pressure"], -2)


def _load(step: Step) -> tuple[float, float]:
    """Load [N] and moving mass [kg]; 0 where they are not known."""
    return round(step.trial.point.get("load", 0.0), 2), round(step.trial.point.get("mass", 0.0), 3)


def _dead_time(steps: Sequence[Step], late: float) -> Estimate:
    """Dead time of the regulator and its line: one value for all steps; different pairs of pressures may differ in it.

    `late` [s]: assumed delay of the pressure where the record gives none.
    """
    pairs = [_pair(step) for step in steps]
    mean, half, _ = mean_over([step.dead for step in steps], [sorted(set(pairs)).index(pair) for pair in pairs])
    method = late + max(step.dead_half for step in steps)
    parts = Parts(repeats=half, method=method, calibration=0.0)
    parents = tuple(step.name for step in steps)
    resolved = "command to pressure, all steps; the log resolves no less than the method part"
    note = sentences(resolved, "no repeats part: no step was repeated" if half is None else "")
    return Estimate("t_d", mean, "s", "time", STEP, {}, parts, len(steps), note=note, trials=parents)


def _at(at: Mapping[str, float], group: Sequence[tuple[RunData, Step]], late: float) -> list[Estimate]:
    """All estimates at one pair of commanded pressures.

    `late` [s]: assumed delay of the pressure where the record gives none.
    """
    steps = [step for _, step in group]
    parents = tuple(step.name for step in steps)
    scales = Scales.of([run for run, _ in group])

    def estimate(
        symbol: str, kind: tuple[str, str], values: Sequence[float], method: float | None, scaled: tuple[str, ...] = (),
        note: str = "", doubts: Sequence[Doubt] = (),
    ) -> Estimate:  # fmt: skip
        mean, half = mean_with_half(values)
        parts = Parts(half, method, scales.part(dict.fromkeys(scaled, mean)))
        note = sentences(note, ONCE if half is None else "", scales.lack(scaled))
        e = Estimate(symbol, mean, *kind, STEP, at, parts, len(values), note=note, trials=parents)
        return weighed(e, [replace(one, half=one.half * abs(mean)) for one in doubts])

    seconds = ("s", "time")
    found: list[Estimate] = []
    if not any(step.found for step in steps):
        half = late + max(step.dead_half for step in steps)
        found.append(estimate("t_d", seconds, [step.dead for step in steps], half, note="to pressure"))
    half = max(step.rise_half for step in steps)
    found.append(estimate("tau_P", seconds, [step.rise for step in steps], half, note="63 %"))
    strokes = [step.stroke for step in steps]
    found.append(
        estimate("X", ("m", "length"), strokes, 0.0, ("displacement",), doubts=[*_unsettled(steps), _of_steps(steps)])
    )
    moved = [step for step in steps if abs(step.stroke) > 2 * SEEN * step.noise]
    if not moved:
        why = f"the displacement moves by {show(strokes[0], 'length', 2)} only: the load rests on its support"
        return [*found, Estimate("dP/dx", None, "Pa/m", "gain", STEP, at, note=why, n=len(steps), trials=parents)]
    ratios, scaled = [step.size / step.stroke for step in moved], ("pressure", "displacement")
    note = "at rest, includes friction"
    doubts = [*_unsettled(moved), _of_steps(moved, "pressure")]
    found.append(estimate("dP/dx", ("Pa/m", "gain"), ratios, 0.0, scaled, note, doubts))
    return [*_times(at, moved, late), *found, *ringing(at, moved)]


def _of_steps(steps: Sequence[Step], other: str = "") -> Doubt:
    """Relative error of the changes of displacement and of channel `other` because they are read in steps."""
    shares = [
        hypot(step.unresolved["displacement"] / step.stroke, step.unresolved.get(other, 0.0) / step.size)
        for step in steps
        if step.stroke
    ]
    return Doubt(STEPS, "method", OF_TWO * max(shares, default=0.0), seen=False)


def _unsettled(steps: Sequence[Step]) -> list[Doubt]:
    """Motion of the contraction still to come before the step and after it, as a share of the stroke."""
    stroke = abs(float(np.mean([step.stroke for step in steps])))
    found = []
    for name, side in (("before the step", -1), ("after the step", 1)):
        holds = []
        for step in steps:
            swung = SWUNG / step.best.decay
            rows = step.t < 0 if side < 0 else step.t > min(max(AFTER, swung), step.t[-1] - 1.0)
            t, x = step.t[rows], step.x[rows] * np.sign(step.stroke)
            holds.append(Held.of(t, x, max(float(t[0]), float(t[-1]) - 1.0)))
        further = left(holds)
        text = f"{name} the contraction is not at rest, it may change by {show(further.most, 'length', 2)} more"
        reason = f"{text}: creep, or a drift. Record longer before and after the step"
        share = further.most / stroke if stroke else 0.0
        found.append(Doubt(f"motion {name}", "method", share, further.seen, reason))
    return found


def _times(at: Mapping[str, float], steps: Sequence[Step], late: float) -> list[Estimate]:
    """B/K [s] at the pressure at the end of the steps, and the time from command to motion [s].

    `late` [s]: assumed time between pressure and position where the record gives none. The delay behind the measured
    pressure is free, so B/K does not depend on the pressure's stamps; the time from command to motion includes the
    error of the position's stamps, as far as it is known.
    """
    names = tuple(step.name for step in steps)
    rises = at["pressure"] > at["from"]
    symbol = "tau_c" if rises else "tau_r"
    B_K = Estimate(symbol, None, "s", "time", DRIVEN, at, n=len(steps), trials=names)
    if why := _of_another_kind(steps):
        return [replace(B_K, note=why)]
    found = [fit_delayed(*step.driven, step.best) for step in steps]
    if why := _no_time(steps, found):
        return [replace(B_K, note=why)]
    tau, of_tau = mean_with_half([one.tau for one in found])
    where = f"B/K at {show(at['pressure'], 'pressure', 3)}, {'contracting' if rises else 'relaxing'}"
    half = max(one.half_tau for one in found)
    note = sentences(where, ONCE if of_tau is None else "")
    undeclared = max(0.0 if step.declared else UNDECLARED for step in steps)
    B_K = replace(B_K, value=tau, parts=Parts(of_tau, hypot(half, undeclared), 0.0), note=note)
    if half > WIDEST * tau:
        spread = f"+-{half / tau:.0%} for the motions that fit alike, accepted is +-{WIDEST:.0%}"
        B_K = withhold(B_K, f"{where}, lies within {spread}: {INSTEAD}")
    t_d = _to_motion(at, steps, found, late)
    return [B_K] if t_d is None else [B_K, t_d]


def _to_motion(
    at: Mapping[str, float], steps: Sequence[Step], found: Sequence[Delayed], late: float
) -> Estimate | None:
    """The time from command to motion [s]; None where no step has a command."""
    commanded = [(step, one) for step, one in zip(steps, found, strict=True) if not step.found]
    if not commanded:
        return None
    dead, of_dead = mean_with_half([step.stamped + one.delay for step, one in commanded])
    half = hypot(max(one.half_delay for _, one in commanded), max(step.onset_half for step, _ in commanded)) + late
    names, parts = tuple(step.name for step, _ in commanded), Parts(of_dead, half, 0.0)
    note = sentences(
        "the time that the pressure takes to overcome friction is in it", "" if of_dead is not None else ONCE
    )
    value: float | None = dead
    if half > LONGEST:
        note = f"a delay of {show(dead, 'time', 2)} and the lag of the mass cannot be distinguished"
        note = f"{note} (+- {show(half, 'time', 2)}): step under a lighter load, whose lag is shorter"
        value, parts = None, Parts()
    n = len(names)
    return Estimate("t_d", value, "s", "time", DRIVEN, at, parts, n, note=note, trials=names, coordinate=TO_MOTION)


def _of_another_kind(steps: Sequence[Step]) -> str:
    """The reason why these motions have no B/K of their own; empty where they may have one."""
    if min(step.best.D for step in steps) < RINGS:
        return "the motion rings, and friction would be taken for damping: a known mass gives K and B of it"
    if pulled := [step.name for step in steps if step.sprung]:
        return f"a spring pulls, too (trial {pulled[0]}): the time constant is B over K and the spring together"
    return ""


def _no_time(steps: Sequence[Step], found: Sequence[Delayed]) -> str:
    """Reason why the driven motion gives no B/K; empty if it does."""
    for step, one in zip(steps, found, strict=True):
        if one.rms > ILL_FITTED * abs(step.stroke):
            share = one.rms / abs(step.stroke)
            return f"the driven motion misses {share:.0%} of the stroke (trial {step.name}): friction, or a stop"
        if not one.bounded:
            return (
                f"the motion is {show(one.delay, 'time', 2)} +- {show(one.half_delay, 'time', 2)} behind the measured "
                f"pressure (trial {step.name}), as far as was looked: see to the clocks of both channels"
            )
    return ""


def _sentences(at: Mapping[str, float], steps: Sequence[Step]) -> list[Finding]:
    where = f"{show(round(at['from']), 'pressure')} to {show(round(at['pressure']), 'pressure')}"
    overshoot = [
        float(np.max(np.sign(s.size) * (s.P[s.t > 0] - np.median(s.P[s.t > AFTER])))) / abs(s.size) for s in steps
    ]
    best = [step.best.late for step in steps]
    lines = []
    if np.mean(overshoot) > OVERSHOOT:
        text = f"{where}: the pressure overshoots by {float(np.mean(overshoot)):.0%}: no first-order lag describes it"
        lines.append(Finding("note", text))
    if max(best) > 0:
        text = f"{where}: the motion fits best with the pressure {show(float(np.mean(best)), 'time', 2)} late: position"
        lines.append(Finding("note", f"{text} seems to move before the pressure that drives it"))
    return lines


def _facts(step: Step) -> dict[str, Any]:
    return {
        "trial": step.name,
        "from": step.trial.point["from"],
        "pressure": step.trial.point["pressure"],
        "size": step.size,
        "stroke": step.stroke,
        "motions": [
            {"late": m.late, "natural_frequency": m.w, "damping_ratio": m.D, "gain": m.g, "rms": m.rms}
            for m in step.motions
        ],
    }


def _trace(step: Step, *, by_load: bool) -> Trace:
    """The first trial of a pair of pressures, measured and with the best motion."""
    near = step.near
    point = step.trial.point
    before, after = point["from"], point["pressure"]
    return Trace(
        name=f"step-{before / 1e3:.0f}-{after / 1e3:.0f}kPa" + (f"-{_load(step)[0]:.0f}N" if by_load else ""),
        figure="overlay",
        title=f"{show(round(before), 'pressure')} to {show(round(after), 'pressure')}: measured and fitted motion",
        columns={"t": step.t[near], "pressure": step.P[near], "displacement": step.x[near], "model": step.best.model},
        quantities={"t": "time", "pressure": "pressure", "displacement": "length", "model": "length"},
        marks={"pressure": after, "load": point.get("load", 0.0)},
    )


def offers(analysis: Analysis) -> Iterator[Offer]:
    """K and B from ringing, at the pressure at the end of the step; each step separately."""
    for symbol in ("K", "B"):
        yield from (everywhere(symbol, {e.at["pressure"]: e}) for e in values_of(analysis, symbol, RINGING))


RINGING = "ringing-of-known-mass"
RINGS = 0.5
"""Damping ratio from which on a motion does not ring: its mass then shows in a fast pole only, which a few ms hide."""
RANGE = 0.15
"""K and B are given if they lie within this share of their value for all possible times and lags."""
ILL_FITTED = 0.1
"""Rms of the misfit as a share of the stroke, above which K and B are withheld."""
INSTEAD = "with a column of force or the load, a map of `kind: contraction-relaxation` gives K from such steps"
ONCE = "no repeats part: one step only"
OF_SWINGS = {
    "K": "of small, fast swings: what creeps, and hysteresis, stiffen them",
    "B": "of contracting and relaxing together",
}
STOPPED = 0.3
"""Ratio of observed to expected amplitude below which friction has stopped the oscillation."""


def ringing(at: Mapping[str, float], steps: Sequence[Step]) -> list[Estimate]:
    """K and B where the motion rings, or the reason why not; they follow from times and a mass, without any scale."""
    parents = tuple(step.name for step in steps)
    masses = [step.trial.point.get("mass", 0.0) for step in steps]
    known = all(masses)
    unknown = "pressure and displacement at one load give ratios only; `point: {mass: ...}` gives the moving mass"
    why = "" if known else unknown
    possible: list[list[Delayed]] = []
    for step in steps if known else ():
        if why := _why_not(step):
            break
        possible.append(possible_motions(step.driven, step.best, step.others))
        if why := _unlike(step, possible[-1]):
            break
    found: list[Estimate] = []
    for symbol, unit, quantity in (("K", "N/m", "stiffness"), ("B", "N.s/m", "damping")):
        empty = Estimate(symbol, None, unit, quantity, RINGING, at, n=len(steps), trials=parents)
        if why:
            reason = f"{why}; {INSTEAD}"
            found.append(withhold(empty, reason) if known else replace(empty, note=reason))
            continue
        ranges = [_range(symbol, mass, forms) for mass, forms in zip(masses, possible, strict=True)]
        value, half = mean_with_half([(low + high) / 2 for low, high in ranges])
        wide = max((high - low) / 2 for low, high in ranges)
        if wide > RANGE * value:
            spread = f"+-{wide / value:.0%} for the motions that fit alike"
            found.append(withhold(empty, f"it lies within {spread}, accepted is +-{RANGE:.0%}; {INSTEAD}"))
            continue
        parts = Parts(repeats=half, method=wide, calibration=0.0)
        note = sentences(OF_SWINGS[symbol], ONCE if half is None else "")
        given = replace(empty, value=value, parts=parts, note=note)
        found.append(weighed(given, _free_doubts(symbol, value, wide, steps, masses)))
    K, B = found
    if K.withheld and not B.withheld:
        found[1] = withhold(B, f"{K.note}. So the same motion gives no B")
    return found


def possible_motions(
    driven: tuple[Array, Array, Array], best: motion.Motion, others: Sequence[tuple[Array, Array]] = ()
) -> list[Delayed]:
    """The motions of a step that fit equally well, with longer and shorter lags of its sensors, and with an undeclared
    one.

    `driven`: time [s], pressure [Pa], contraction [m], shapes (n,); `others`: the last two for other lags.
    """
    t, P, x = driven
    nominal = fit_swings(t, P, x, motion.place_of(best))
    first = nominal[0].place
    found = motion.alike(nominal)
    for pressure, contraction in others:
        found += motion.alike(fit_swings(t, pressure, contraction, first))
    least = min(one.rms for one in found)
    for lag in motion.LAGS:
        lagging = fit_swings(t, motion.behind(t, P, lag), x, first, nominal[0].rms)
        found += [one for one in lagging if one.rms <= least and one.bounded]
    return found


def _range(symbol: str, mass: float, forms: Sequence[Delayed]) -> tuple[float, float]:
    """Smallest and largest K or B of a moving mass over all forms, including their intervals."""
    values = [(mass * getattr(one, symbol), mass * getattr(one, f"half_{symbol}")) for one in forms]
    return min(value - half for value, half in values), max(value + half for value, half in values)


def _free_doubts(symbol: str, value: float, wide: float, steps: Sequence[Step], masses: Sequence[float]) -> list[Doubt]:
    """Contradiction of K or B by the free oscillation after the step, beyond the range `wide`; it does not depend on
    delays.
    """
    others, stopped = [], False
    for step, mass in zip(steps, masses, strict=True):
        swings = motion.free_swings(step.t, step.P, step.x, step.best, step.noise)[:2]
        sizes = [(one.size, one.expected) for one in swings if one.expected > motion.CLEAR * step.noise]
        stopped = stopped or any(size < STOPPED * more for size, more in sizes)
        if symbol == "K":
            others += [mass * one.w**2 for one in swings[:1] if one.size > motion.CLEAR * step.noise]
        elif len(sizes) > 1:
            others.append(_without_friction(swings[0], swings[1], mass))
    unit = "stiffness" if symbol == "K" else "damping"
    apart = abs(float(np.mean(others)) - value) - wide if others else 0.0
    text = f"the free swinging after the step gives a {symbol} that is {show(apart, unit, 2)} outside of its range"
    why = "the curve is bent, or the pressure is later than was said"
    if symbol == "B":
        why = "friction does not grow with the speed, for small swings die faster"
    if stopped:
        apart, text = abs(value), "the swinging after the step ends early"
        why = "dry friction holds it, longer than this form takes"
    return [Doubt("free swinging", "method", apart, seen=True, reason=f"{text}: {why}; {INSTEAD}")] if apart > 0 else []


def _without_friction(first: motion.Swing, second: motion.Swing, mass: float) -> float:
    """B [N s/m] from two stretches of free oscillation: dry friction adds c/size, so B is a line extrapolated to 1/size
    = 0.
    """
    big, small = first.size, second.size
    one, other = (2 * mass * swing.D * swing.w for swing in (first, second))
    return (one * big - other * small) / (big - small) if big > small else one


HIDDEN = "its mass shows in a fast pole only, which a few ms between pressure and position hide"


def _why_not(step: Step) -> str:
    """Reason why the motion of a step does not ring; empty if it may."""
    if step.sprung:
        return "a spring pulls, too, and swings with the mass"
    if step.best.D >= RINGS:
        return _damped(step.best.D)
    if not 1.02 * motion.FREQUENCY[0] < step.best.w < motion.FREQUENCY[1] / 1.02:
        low, high = motion.FREQUENCY
        return f"the motion does not ring (no natural frequency from {low:g} to {high:g} rad/s fits it): {HIDDEN}"
    end = float(np.median(step.x[step.t > step.t[-1] - 1.0]))
    seen = motion.extremes(step.x[step.t > 0], end, step.noise)
    if seen < 2:
        few = f"{seen} extremes beyond {motion.SHOWN:g} times its noise, 2 are needed"
        return f"the motion does not ring ({few}): {HIDDEN}"
    return ""


def _damped(ratio: float) -> str:
    most = f"{ratio:.1f}" if ratio < motion.DAMPING[1] / 1.02 else f"{motion.DAMPING[1]:g} or more"
    return f"the motion does not ring (damping ratio {most}, less than {RINGS:g} is needed): {HIDDEN}"


def _unlike(step: Step, possible: Sequence[Delayed]) -> str:
    """Reason why motions that fit equally well do not determine K; empty if they do."""
    damped = max(one.B / (2 * sqrt(one.K)) for one in possible)
    if damped >= RINGS:
        return _damped(damped)
    share = max(one.rms for one in possible) / abs(step.stroke)
    if share > ILL_FITTED:
        return f"the misfit is {share:.0%} of the stroke (trial {step.name})"
    if not all(one.bounded for one in possible):
        return f"the motion is more than {show(motion.FREE, 'time')} off the pressure (trial {step.name})"
    return ""
