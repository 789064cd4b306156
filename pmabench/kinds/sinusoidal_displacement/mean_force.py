"""F_ce from the mean force of driven sines.

Over a whole cycle, friction and damping that are equal in both directions cancel, so the mean force is F_ce - K x at
the mean contraction x; half of a difference between directions remains, as in the middle of both branches. If B_c and
B_r differ, it increases by (B_r - B_c)/pi per unit of the speed amplitude omega A; extrapolation to speed 0 gives F_ce.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import hypot, isfinite, nan, pi

import numpy as np

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import cut_off, force_from_cycle_to_cycle, half_steps, weighed
from pmabench.analysis.shared.lines import Line, mean_half, weighted_line
from pmabench.analysis.shared.sine_loop import Sine
from pmabench.analysis.shared.trials import Point
from pmabench.kinds.sinusoidal_displacement.fit import (
    CYCLES,
    CYCLES_OF_EACH,
    NO_REPEATS,
    Fitted,
    of_like_motion,
)
from pmabench.kinds.sinusoidal_displacement.form import REMAINS, Form, rows_of_cycles
from pmabench.store.analyses.results import Estimate, Parts, withhold
from pmabench.store.records import Array

SINE_MEAN = "sine-mean"
ALONE = "one frequency only: that B_c and B_r may differ is in the method part"
AT_MEAN = "at the mean contraction, at speed 0, halfway between both branches"
NO_SLOPE = "as at the measured pressure: one pressure does not show F_ce at the set one"


def force_slopes(fits: Mapping[Point, Fitted]) -> dict[Point, float]:
    """dF_ce/dP [N/Pa] at each cell, from cells of equal motion; cells without a second pressure are left out."""
    found: dict[Point, float] = {}
    for keys in of_like_motion(fits):
        P = np.array([np.mean([m.sine.pressure for m in fits[key].group]) for key in keys])
        if np.isnan(P).any() or np.ptp(P) < 1e-3 * P.max():
            continue
        order = np.argsort(P)
        F = np.array([_line(fits[keys[i]], 0.0, nan).start for i in order])
        found |= {keys[i]: float(slope) for i, slope in zip(order, np.gradient(F, P[order]), strict=True)}
    return found


def mean_force_estimates(
    at: Mapping[str, float], fitted: Fitted, form: Form, scales: Scales, slope: float | None
) -> tuple[Estimate, Estimate]:
    """F_ce, and F at the mean contraction [N], at the set pressure of `at`; `slope` is dF_ce/dP [N/Pa], None where
    unknown.

    F is the mean force minus the second harmonic, F_ce the value at x = 0 of a cubic with the same harmonics, if x = 0
    is in the stroke. Both are withheld where the harmonics are too large for that (`form`). Calibration to first order:
    gain of the force for both; an offset of the displacement times K.
    """
    wanted = at.get("pressure", nan)
    line = _line(fitted, slope or 0.0, wanted)
    members = fitted.group
    mean = float(np.mean([member.sine.mean for member in members]))
    speed = float(np.mean([member.sine.speed for member in members]))
    K_half, K_bias = fitted.halves()["K"], fitted.bias["K"]
    doubt = abs(fitted.muscle.B or members[0].sine.loss / speed) * speed / pi if fitted.alone else 0.0
    scatter = line.half_start if line.half_start is not None else _half_by_cycles(fitted)
    half = None if scatter is None or K_half is None else hypot(scatter, K_half * mean)
    gains, offsets = {"force": line.start}, {"force": 1.0, "displacement": fitted.lines.K.start}
    one_each = len(members) == len({member.sine.frequency for member in members})
    repeats = CYCLES if len(members) == 1 else CYCLES_OF_EACH if one_each else ""
    note = sentences(ALONE if fitted.alone else "", NO_SLOPE if slope is None else "", repeats)
    off, off_half = form.carried
    open_half = hypot(min(off_half, abs(line.start)), REMAINS * off)
    parts = Parts(
        half,
        hypot(K_bias * mean, doubt, open_half),
        scales.part_at(wanted, slope, gains, offsets),
        fitted.skewed()["K"] * abs(mean),
    )
    names = tuple(member.name for member in members)
    n = len(members)
    F_ce = Estimate("F_ce", line.start + off, "N", "force", SINE_MEAN, dict(at), parts, n, note=note, trials=names)
    F = line.start - (fitted.lines.K.start - K_bias) * mean - form.h2
    there = Parts(
        scatter,
        hypot(doubt, form.half[0] if isfinite(form.half[0]) else abs(F), REMAINS * form.h2, form.apart),
        scales.part_at(wanted, slope, {"force": F}, offsets),
    )
    mean_force = replace(F_ce, symbol="F", value=F, parts=there, note=sentences(AT_MEAN, note))
    half_step = half_steps([(member.run, member.trial) for member in members], ("force", "displacement"))
    by_cycle = [_by_cycle(member.sine, member.sine.F) for member in members]
    cut = cut_off(half_step, {"force": 1.0, "displacement": fitted.lines.K.start})
    drifts = [*force_from_cycle_to_cycle(by_cycle), cut]
    F_ce, mean_force = weighed(F_ce, [*drifts, form.friction_at_0(fitted.muscle.F_c)]), weighed(mean_force, drifts)
    if reason := form.why_no_tangent():
        mean_force = withhold(mean_force, reason)
    if half is None:
        F_ce, mean_force = (replace(one, value=None, parts=Parts(), note=NO_REPEATS) for one in (F_ce, mean_force))
        return F_ce, mean_force
    why, contradicted = form.why_no_f_ce()
    if contradicted:
        F_ce = withhold(F_ce, why)
    elif why:
        F_ce = replace(F_ce, value=None, parts=Parts(), note=why)
    return F_ce, mean_force


def _by_cycle(sine: Sine, values: Array) -> Array:
    """Means of each cycle."""
    return np.array([float(values[rows].mean()) for rows in rows_of_cycles(sine)])


def _line(fitted: Fitted, slope: float, wanted: float) -> Line:
    """F_ce [N] over the speed amplitude [m/s]; with one frequency its mean."""
    members = fitted.group
    K = fitted.lines.K.start - fitted.bias["K"]
    off = [slope * (wanted - member.sine.pressure) if slope else 0.0 for member in members]
    rest = np.array([member.sine.force + K * member.sine.mean for member in members]) + off
    frequency = np.array([member.sine.frequency for member in members])
    speed = None if fitted.alone else np.array([member.sine.speed for member in members])
    # an error of the mean force is a share of it
    return weighted_line(frequency, speed, rest, np.array([abs(member.sine.force) for member in members]))


def _half_by_cycles(fitted: Fitted) -> float | None:
    """Half width of the line's start [N] from the scatter of cycles, where the line needs every trial; None for trials
    of one cycle.
    """
    K, cycles = fitted.lines.K.start - fitted.bias["K"], []
    for member in fitted.group:
        cycles.append(_by_cycle(member.sine, member.sine.F + K * member.sine.x))
    if fitted.alone:
        return mean_half(np.array([each.mean() for each in cycles]), cycles)
    of_each = [(one.frequency, one.speed, abs(one.force)) for one in (member.sine for member in fitted.group)]
    frequency, speed, size = np.repeat(of_each, [len(each) for each in cycles], axis=0).T
    return weighted_line(frequency, speed, np.concatenate(cycles), size).half_start
