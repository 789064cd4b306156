"""Pressure and mean force of driven sines: error of the pressure by direction, force modelled with it, F_ce.

Paper 3's validation: a model with an ideal pressure source has the error of the regulator, one with the measured
pressure does not. The model is fitted to the slowest sines: at each contraction F = f(x) + s(x) P, from their branches
at all pressures (the form of paper 3 eq. 6, and of the three-element model), with B and F_c from the harmonics. Also
the figure of both.

Over a whole cycle, friction and damping that are equal in both directions cancel, so the mean force is F_ce - K x at
the mean contraction x; half of a difference between directions remains, as in the middle of both branches. If B_c and
B_r differ, it increases by (B_r - B_c)/pi per unit of the speed amplitude omega A; extrapolation to speed 0 gives F_ce.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, isfinite, nan, pi

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import cut_off, force_from_cycle_to_cycle, half_steps, weighed
from pmabench.analysis.shared.lines import Line, mean_half, weighted_line
from pmabench.analysis.shared.ramp_loop import on_grid
from pmabench.analysis.shared.samples import lags_of, noise_of
from pmabench.analysis.shared.sine_loop import Sine, without_lag
from pmabench.analysis.shared.trials import Point, grouped, point_by, thinned
from pmabench.base.quantities import show
from pmabench.kinds.sinusoidal_displacement.fit import (
    CYCLES,
    CYCLES_OF_EACH,
    NO_REPEATS,
    Fitted,
    Member,
    Muscle,
    of_cycles,
    of_like_motion,
)
from pmabench.kinds.sinusoidal_displacement.form import REMAINS, Form, rows_of_cycles
from pmabench.plotting import pictures
from pmabench.plotting.chart import BLUE, BROWN, FAINT, INK, ZERO, Chart, closed, small_multiples
from pmabench.plotting.wording import shown
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import Array

ERROR, SET, MEASURED = "pressure error", "modelled with set pressure", "modelled with measured pressure"
SIDES = ("contracting", "expanding")
PULLS = ("pressure", "force")
POINTS = 41
APART = 0.05
"""Smallest relative difference of two pressures of the slowest sines for a slope over pressure."""
SLOW = 1.5
"""Sines up to this multiple of the lowest frequency at their pressure count as slow."""
EXTREME = 3.0
"""Standard deviations of noise by which the largest of many samples exceeds the signal."""
WORSE = 1.2
"""Ratio of both rms errors from which on the set pressure is reported as the worse input."""
LONGEST_TRACE = 1200


@dataclass(frozen=True, eq=False)
class Along:
    """A trial's kept cycles: contraction [m], its rate [m/s], force [N], pressure and set pressure [Pa]."""

    member: Member
    x: Array
    v: Array
    F: Array
    P: Array
    wanted: float

    @classmethod
    def of(cls, member: Member) -> Along | None:
        """From a trial; None where the pressure is not recorded, or the set pressure unknown."""
        sine, trial, wanted = member.sine, member.trial, member.trial.point.get("pressure")
        if "pressure" not in trial.channels or wanted is None:
            return None
        x, v = sine.motion.value(), sine.motion.slope()
        rows, lags = np.searchsorted(trial.t, sine.t), lags_of(member.run, trial)
        # the sine's own force may be corrected for the ripple
        P, F = (without_lag(sine.t, trial.channels[name][rows], sine.frequency, lags[name]) for name in PULLS)
        return cls(member, x, v, F, P, float(wanted))

    def side(self, name: str) -> NDArray[np.bool_]:
        """Rows that move in a direction, shape (n,)."""
        return np.asarray(self.v > 0 if name == "contracting" else self.v < 0)

    def by_cycle(self, values: Array, rows: NDArray[np.bool_]) -> list[Array]:
        """`values` of these rows, cycle by cycle."""
        return [values[rows & one] for one in rows_of_cycles(self.member.sine) if (rows & one).any()]


@dataclass(frozen=True, eq=False)
class Static:
    """F = f + s P on a grid of contractions, shapes (n,)."""

    x: Array
    f: Array
    s: Array
    trials: tuple[str, ...]

    @classmethod
    def of(cls, alongs: Sequence[Along]) -> Static | None:
        """From the slowest sines at each pressure; None with fewer than two pressures."""
        chosen: list[Along] = []
        for wanted in sorted({along.wanted for along in alongs}):
            mine = [along for along in alongs if along.wanted == wanted]
            lowest = min(along.member.sine.frequency for along in mine)
            slow = [along for along in mine if along.member.sine.frequency <= SLOW * lowest]
            widest = max(along.member.sine.amplitude for along in slow)
            chosen += [along for along in slow if along.member.sine.amplitude > 0.95 * widest]
        pressures = [along.wanted for along in chosen]
        if not chosen or max(pressures) - min(pressures) < APART * max(pressures):
            return None
        low = max(float(along.x.min()) for along in chosen)
        high = min(float(along.x.max()) for along in chosen)
        if not high > low:
            return None
        room = 0.01 * (high - low)
        grid = np.linspace(low + room, high - room, POINTS)
        P, F = [], []
        for along in chosen:
            for name in SIDES:
                rows = along.side(name)
                P.append(on_grid(grid, along.x[rows], along.P[rows]))
                F.append(on_grid(grid, along.x[rows], along.F[rows]))
        pressure, force = np.array(P), np.array(F)
        mean_P, mean_F = pressure.mean(axis=0), force.mean(axis=0)
        s = np.sum((pressure - mean_P) * (force - mean_F), axis=0) / np.sum((pressure - mean_P) ** 2, axis=0)
        if not np.isfinite(s).all():
            return None
        return cls(grid, mean_F - s * mean_P, s, tuple(along.member.name for along in chosen))

    def force(self, along: Along, P: Array | float, muscle: Muscle) -> Array:
        """Force along a trial's motion with a pressure [N]; NaN outside the slow sines' stroke, shape (n,)."""
        f = np.interp(along.x, self.x, self.f, left=nan, right=nan)
        s = np.interp(along.x, self.x, self.s, left=nan, right=nan)
        return np.asarray(f + s * P - muscle.B * along.v - muscle.F_c * np.sign(along.v))


def pressure_and_force(
    members: Sequence[Member], muscles: Mapping[str, Muscle | None], scales: Scales
) -> tuple[list[Estimate], list[Finding], list[Trace]]:
    """Pressure error, and rms error of the modelled force, of each cell by direction.

    `muscles`: name of a trial -> K, B and F_c from its harmonics; None where not all are known.
    """
    alongs = [along for member in members if (along := Along.of(member)) is not None]
    estimates, traces = list[Estimate](), list[Trace]()
    cells = grouped(alongs, lambda one: point_by(one.member.trial, ("pressure", "mean", "amplitude", "frequency")))
    statics = {mean: Static.of(group) for mean, group in grouped(alongs, _mean).items()}
    ratios: list[tuple[str, float, float, str]] = []
    for key, group in sorted(cells.items()):
        at = dict(key)
        for side in SIDES:
            estimates.append(_error(at, group, side, scales))
        static = statics[_mean(group[0])]
        if static is None:
            continue
        known = muscles.get(group[0].member.name) or Muscle(0.0, 0.0, 0.0)
        off: dict[tuple[str, str], float] = {}
        for method, measured in ((SET, False), (MEASURED, True)):
            models = [static.force(along, along.P if measured else along.wanted, known) for along in group]
            for side in SIDES:
                one = _rms(at, group, models, side, method, static.trials)
                estimates.append(one)
                off[method, side] = one.value or 0.0
        where = f"{at.get('frequency', 0.0):g} Hz and {show(at['pressure'], 'pressure')}"
        ratios += [(where, off[SET, side], off[MEASURED, side], side) for side in SIDES]
        traces.append(_trace(at, group[0], static, known))
    return estimates, _sentences(ratios, any(statics.values()), estimates), traces


def _mean(along: Along) -> float:
    return round(along.member.trial.point.get("mean", along.member.sine.mean), 6)


def _error(at: Mapping[str, float], group: Sequence[Along], side: str, scales: Scales) -> Estimate:
    """Largest pressure error during motion in one direction, mean of the cycles; noise increases it."""
    errors = [along.by_cycle(along.P - along.wanted, along.side(side)) for along in group]
    cycles = [np.array([float(one[np.argmax(np.abs(one))]) for one in of_trial]) for of_trial in errors]
    means = np.array([float(values.mean()) for values in cycles])
    coordinates = {"pressure": at["pressure"]}, {"pressure": 1.0}
    parts = Parts(None, EXTREME * max(noise_of(along.P) for along in group), scales.part(*coordinates))
    names, lack = [along.member.name for along in group], scales.lack(*coordinates)
    return of_cycles("P_err", ("Pa", "pressure"), ERROR, at, names, means, cycles, parts, lack, side)


def _rms(
    at: Mapping[str, float], group: Sequence[Along], models: Sequence[Array], side: str, method: str,
    parents: tuple[str, ...],
) -> Estimate:  # fmt: skip
    """Root mean square of measured minus modelled force while moving in a direction."""
    cycles = []
    for along, model in zip(group, models, strict=True):
        rows = along.side(side) & np.isfinite(model)
        squares = along.by_cycle((along.F - model) ** 2, rows)
        cycles.append(np.array([float(np.sqrt(one.mean())) for one in squares]) if squares else np.zeros(1))
    means = np.array([float(np.sqrt(np.mean(values**2))) for values in cycles])
    names = tuple(along.member.name for along in group)
    parented = f"static model of {', '.join(parents[:3])}{' and others' if len(parents) > 3 else ''}"
    note = f"{parented}; no calibration part: the model is made with the same channels"
    return Estimate(
        "F_rms", float(means.mean()), "N", "force", method, dict(at), Parts(mean_half(means, cycles), 0.0), len(group),
        note=note, trials=names, coordinate=side,
    )  # fmt: skip


def _trace(at: Mapping[str, float], along: Along, static: Static, muscle: Muscle) -> Trace:
    """The last cycle: force measured and modelled, and the pressure's error."""
    t = along.member.sine.t
    last = t >= t[-1] - 1 / along.member.sine.frequency
    columns = {
        "displacement": along.x,
        "force": along.F,
        "set": static.force(along, along.wanted, muscle),
        "measured": static.force(along, along.P, muscle),
        "error": along.P - along.wanted,
    }
    name = "-".join(f"{value:g}" for value in at.values())
    return Trace(
        f"sine-pressure-{name}",
        "sine-pressure",
        f"{show(at['pressure'], 'pressure')}, {at.get('frequency', 0.0):g} Hz: force and pressure along a sine",
        thinned({key: values[last] for key, values in columns.items()}, LONGEST_TRACE),
        {"displacement": "length", "force": "force", "set": "force", "measured": "force", "error": "pressure"},
        {key: value for key, value in at.items() if key in ("frequency", "pressure")},
    )


def _sentences(
    ratios: Sequence[tuple[str, float, float, str]], modelled: bool, estimates: Sequence[Estimate]
) -> list[Finding]:
    """Cells where the set pressure is a worse input than the measured one, with the worst case."""
    worse = [one for one in ratios if one[1] > WORSE * one[2]]
    if worse:
        where, by_set, by_measured, side = max(worse, key=lambda one: one[1] - one[2])
        text = (
            f"the modelled force is worse with the set pressure than with the measured one: while {side} at {where} "
            f"{show(by_set, 'force', 3)} rms against {show(by_measured, 'force', 3)}; the regulator is no ideal source"
        )
        return [Finding("note", text)]
    error = max((abs(e.value or 0.0) / e.at["pressure"] for e in estimates if e.symbol == "P_err"), default=0.0)
    if not modelled and error > 0.02:
        text = f"the pressure is off by up to {error:.0%} along the sines"
        text += "; run them at two pressures to see what of the force that is"
        return [Finding("note", text)]
    return []


SINES = 4
"""Most panels."""


def sine_pressure(traces: Sequence[Trace], analysis: Analysis) -> list[pictures.Picture]:
    """Force along sines, measured and modelled with set and measured pressure, above the error of the pressure."""
    able = [t for t in traces if pictures.has(t, "displacement", "force", "set", "measured", "error")]
    able = [t for t in able if "frequency" in t.marks]
    chosen = pictures.spread(sorted(able, key=lambda t: (t.marks.get("pressure", 0.0), t.marks["frequency"])), SINES)
    if not chosen:
        return []
    worst = [float(np.nanmax(np.abs(pictures.column(t, "error")))) for t in chosen]
    caption = (
        "Above: the last cycle, and the static model of the slowest sines with the set pressure as input and with the "
        "measured one, damping and friction of the harmonics added. Below: error of the pressure, at most "
        f"{pictures.reach(worst)} {shown('pressure').unit}."
    )
    rows = small_multiples([_charts(trace) for trace in chosen], 4)
    return [pictures.of_traces(rows, "Force with set and with measured pressure", caption, analysis, chosen, able)]


LOOPS = (
    ("force", "measured", FAINT, 3.0, False),
    ("set", "set pressure", BLUE, 1.0, False),
    ("measured", "measured pressure", BROWN, 1.0, True),
)
"""Column, name, colour, width and whether it is dashed."""


def _charts(trace: Trace) -> tuple[Chart, Chart]:
    """Loops over x of the force and of both models, and of the error below."""
    x, y = pictures.label(trace, "displacement"), pictures.label(trace, "force")
    lines = [
        closed(pictures.curve(trace, "displacement", name, word, color, width=width, dashed=dashed))
        for name, word, color, width, dashed in LOOPS
    ]
    error = closed(pictures.curve(trace, "displacement", "error", "", INK, width=1.0))
    apart = shown("pressure").label("P − set P")
    upper = Chart(x, y, lines, height=142.0, title=pictures.head(trace), legend=True)
    return upper, Chart(x, apart, (error,), height=100.0, y_ticks=4, levels=(ZERO,))


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
