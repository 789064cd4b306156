"""F_ce from the mean force of driven sines, and the work along them.

Over a whole cycle friction and a damping that is the same both ways cancel, so that the mean force is F_ce - K x at the
mean contraction x. Where B_c and B_r differ it rises by (B_r - B_c)/pi for each unit of the speed amplitude omega A,
so that F_ce is where a line over that speed begins.

    W_c = integral of F dx while x rises,  W_c + W = -integral of F dx while x falls,  eta = W_c / (W_c + W)

with W the area of the loop. The pressure is held, so the air takes part in both; what it carries in and out is not
measured, and eta is no efficiency of the drive. Knows measured trials of one pressure, mean and amplitude.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot, isfinite, nan, pi

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.lines import Line, mean_half, weighted_line
from pmabench.analysis.shared.sine_loop import RECOVERED, Sine, moving
from pmabench.analysis.shared.skew import settled
from pmabench.kinds.sinusoidal_displacement.fit import BETWEEN, CYCLES, CYCLES_OF_EACH, NO_REPEATS, Fitted, Member
from pmabench.kinds.sinusoidal_displacement.form import REMAINS, Form
from pmabench.store.analyses.results import Estimate, Parts, withhold
from pmabench.store.records import Array

SINE_MEAN = "sine-mean"
ALONE = "one frequency only: that B_c and B_r may differ is in the method part"
AT_MEAN = "at the mean contraction, at speed 0"
NO_SLOPE = "as at the measured pressure: with one pressure nothing tells what F_ce there is at the set one"


def force_slopes(fits: Mapping[tuple[tuple[str, float], ...], Fitted]) -> dict[tuple[tuple[str, float], ...], float]:
    """dF_ce/dP [N/Pa] at each cell, from the cells of like motion; absent without two pressures."""
    alike: dict[tuple[tuple[str, float], ...], list[tuple[tuple[str, float], ...]]] = {}
    for key in fits:
        if "pressure" in dict(key):
            alike.setdefault(tuple(item for item in key if item[0] != "pressure"), []).append(key)
    found = {}
    for keys in alike.values():
        P = np.array([np.mean([m.sine.pressure for m in fits[key].group]) for key in keys])
        if len(keys) < 2 or np.isnan(P).any() or np.ptp(P) < 1e-3 * P.max():
            continue
        order = np.argsort(P)
        F = np.array([_line(fits[keys[i]], 0.0, nan).start for i in order])
        for place, slope in zip(order, np.gradient(F, P[order]), strict=True):
            found[keys[place]] = float(slope)
    return found


def mean_force_estimates(
    at: Mapping[str, float], fitted: Fitted, form: Form, scales: Scales, slope: float | None
) -> tuple[Estimate, Estimate]:
    """F_ce, and F at the mean contraction [N], at the set pressure of `at`; `slope` is dF_ce/dP [N/Pa], where known.

    F is the mean force less the second harmonic, F_ce what a cubic with the same harmonics has at x = 0, where that
    lies in the stroke. Both are withheld where the harmonics are too large for that (`form`). Calibration, to first
    order: the force scales both; an offset of the displacement is worth K times that.
    """
    wanted = at.get("pressure", nan)
    line = _line(fitted, slope or 0.0, wanted)
    members = fitted.group
    mean = float(np.mean([member.sine.mean for member in members]))
    speed = float(np.mean([member.sine.speed for member in members]))
    K_half, K_bias = fitted.half_stiffness, fitted.bias["K"]
    doubt = abs(fitted.muscle.B or members[0].sine.loss / speed) * speed / pi if fitted.alone else 0.0
    scatter = line.half_start if line.half_start is not None else _half_by_cycles(fitted)
    half = None if scatter is None or K_half is None else hypot(scatter, K_half * mean)
    gains, offsets = {"force": line.start}, {"force": 1.0, "displacement": fitted.K.start}
    if slope is not None:
        gains["pressure"], offsets["pressure"] = slope * wanted, slope
    one_each = len(members) == len({member.sine.frequency for member in members})
    repeats = CYCLES if len(members) == 1 else CYCLES_OF_EACH if one_each else ""
    note = sentences(ALONE if fitted.alone else "", NO_SLOPE if slope is None else "", repeats)
    off, off_half = form.carried
    open_half = hypot(min(off_half, abs(line.start)), REMAINS * off)
    parts = Parts(
        half, hypot(K_bias * mean, doubt, open_half), scales.part(gains, offsets), fitted.skewed_stiffness * abs(mean)
    )
    names = tuple(member.name for member in members)
    n = len(members)
    F_ce = Estimate("F_ce", line.start + off, "N", "force", SINE_MEAN, dict(at), parts, n, note=note, trials=names)
    F = line.start - (fitted.K.start - K_bias) * mean - form.h2
    there = Parts(
        scatter,
        hypot(doubt, form.half[0] if isfinite(form.half[0]) else abs(F), REMAINS * form.h2),
        scales.part(gains | {"force": F}, offsets),
    )
    mean_force = replace(F_ce, symbol="F", value=F, parts=there, note=sentences(AT_MEAN, note))
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


def _line(fitted: Fitted, slope: float, wanted: float) -> Line:
    """F_ce [N] over the speed amplitude [m/s]; with one frequency its mean."""
    members = fitted.group
    K = fitted.K.start - fitted.bias["K"]
    rest = np.array([_at_rest(member, K, slope, wanted) for member in members])
    frequency = np.array([member.sine.frequency for member in members])
    speed = None if fitted.alone else np.array([member.sine.speed for member in members])
    return weighted_line(frequency, speed, rest, _sizes(members))


def _half_by_cycles(fitted: Fitted) -> float | None:
    """Half width of the line's begin [N] by the scatter of cycles, where each trial is needed for the line; None for
    trials of one cycle.
    """
    K, cycles = fitted.K.start - fitted.bias["K"], []
    for member in fitted.group:
        sine = member.sine
        number = _cycle_of(sine)
        count = np.bincount(number)
        cycles.append((np.bincount(number, sine.F + K * sine.x) / np.maximum(1, count))[count > 0])
    if fitted.alone:
        return mean_half(np.array([each.mean() for each in cycles]), cycles)
    of_each = [(one.frequency, one.speed, abs(one.force)) for one in (member.sine for member in fitted.group)]
    frequency, speed, size = np.repeat(of_each, [len(each) for each in cycles], axis=0).T
    return weighted_line(frequency, speed, np.concatenate(cycles), size).half_start


def _at_rest(member: Member, K: float, slope: float, wanted: float) -> float:
    off = slope * (wanted - member.sine.pressure) if slope else 0.0
    return member.sine.force + K * member.sine.mean + off


def _sizes(members: Sequence[Member]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """What an error of the mean force is a share of [N]."""
    return np.array([abs(member.sine.force) for member in members])


LOOP_WORK = "loop-work"


def work(sine: Sine) -> tuple[Array, Array]:
    """Work given while contracting and taken up while expanding [J] in each cycle, shapes (cycles,).

    The rate is that of the displacement's first five harmonics, so that noise is not counted as motion.
    """
    _, v = moving(sine)
    cycle = _cycle_of(sine)
    rows = [cycle == c for c in range(int(cycle.max()) + 1)]
    period = 1 / sine.frequency
    given = [float(np.mean(sine.F[one] * np.maximum(v[one], 0.0))) * period for one in rows if one.any()]
    taken = [float(np.mean(sine.F[one] * np.maximum(-v[one], 0.0))) * period for one in rows if one.any()]
    return np.array(given), np.array(taken)


def _cycle_of(sine: Sine) -> NDArray[np.intp]:
    """Number of the cycle of each sample."""
    return np.asarray(np.floor((sine.t - sine.t[0]) * sine.frequency + 1e-6), dtype=np.intp)


def work_estimates(at: Mapping[str, float], members: Sequence[Member], scales: Scales, skew: float) -> list[Estimate]:
    """W_c [J] and eta [1] at each frequency.

    Calibration, to first order: W_c ~ F x; the gains of both cancel in eta. An offset of the force is worth the stroke
    times that in W_c. Method: what W_c leaves of the loop's area by samples.
    """
    found = []
    for frequency in sorted({member.sine.frequency for member in members}):
        mine = [member for member in members if member.sine.frequency == frequency]
        pairs = [work(member.sine) for member in mine]
        given = [pair[0] for pair in pairs]
        share = [pair[0] / pair[1] for pair in pairs]
        area = float(np.mean([member.sine.area for member in mine]))
        W_c, taken = (float(np.mean([pair[i].mean() for pair in pairs])) for i in (0, 1))
        off = abs(taken - W_c - area)
        stroke = 2 * float(np.mean([member.sine.amplitude for member in mine]))
        sine = mine[0].sine
        late = pi * sine.amplitude**2 * abs(sine.stiffness) * sine.omega * skew
        eta = W_c / taken
        one_each = CYCLES if len(mine) == 1 else ""
        for symbol, unit, quantity, values, parts, note in (
            (
                "W_c", "J", "work", given,
                Parts(None, off, scales.part({"force": W_c, "displacement": W_c}, {"force": stroke}), late / 2), "",
            ),
            (
                "eta", "1", "ratio", share,
                Parts(None, off / taken, scales.part({}, {"force": stroke * (1 - eta) / taken}), late / taken),
                RECOVERED,
            ),
        ):  # fmt: skip
            means = np.array([float(one.mean()) for one in values])
            half = mean_half(means, values)
            one = Estimate(
                symbol,
                float(means.mean()),
                unit,
                quantity,
                LOOP_WORK,
                {**at, "frequency": frequency},
                Parts(half, parts.method, parts.calibration, parts.skew),
                len(mine),
                note=sentences(NO_REPEATS if half is None else one_each, note),
                trials=tuple(member.name for member in mine),
            )
            found.append(settled(one, BETWEEN, skew))
    return found
