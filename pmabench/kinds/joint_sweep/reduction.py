"""Reduction of sweeps of a joint: torque, stiffness, gap and loop area, each with an interval.

One sweep: its loop, the stiffness of its cycles, and what its record shows against them; then all of a point. Also the
figure.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pmabench.analysis.shared import joint
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.joint import AXES, BY_PRESSURE, CUT, MUSCLES, STIFFNESS, TORQUE, Kept, flank, why_no_turns
from pmabench.analysis.shared.lines import left_by
from pmabench.analysis.shared.ramp_loop import Loop, Turns, fading, measure
from pmabench.analysis.shared.samples import NotUsable, ends, on_time, settings_of
from pmabench.analysis.shared.saturated import Ceiling, saturated
from pmabench.analysis.shared.trials import Reduction, grouped
from pmabench.base.quantities import show
from pmabench.kinds.joint_sweep import RESULTS
from pmabench.plotting.chart import BLUE, INK, Chart, small_multiples
from pmabench.plotting.pictures import Drawn, crosses, curve, has, head, label, of_some, reach
from pmabench.store.analyses.results import Analysis, Dropped, Estimate, Finding, Trace
from pmabench.store.records import Array, RunData, TrialData

TURN = 0.02
"""Share of the sweep that is left out at each end in the first evaluation."""
PARTS = 10
"""Parts of a sweep without turns in which a gap is looked for."""
HALF_SWEEP = 4.0
"""Smallest half sweep, in w: after a shorter one the turn has not decayed at mid sweep."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """One usable trial: its loop, the stiffness of its cycles [N m/rad], and the effect of the turns on it."""

    run: RunData
    trial: TrialData
    loop: Loop
    stiffness: Array
    taken_off: float
    """Change of the stiffness by the correction for the rest of the turns [N m/rad]."""
    second: Turns | None
    """Slower transition of the torque after a turn; None if not significant."""
    kept: Kept
    flank: float
    """Step of the torque at its change of sign, because of backlash [N m]; 0 if not significant."""
    apart: Array
    """Pressures while the angle falls minus while it rises [Pa], shape (cycles, 2)."""
    along: Array
    """Pressures along each ramp, cubics over the commanded angle from mid sweep on [Pa, rad], shape (ramps, 2, 4)."""


class OffForm(NotUsable):
    """A sweep whose loop has another form than the reduction needs: something is wrong at its operating point."""


def sweep_of(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Sweep:
    """Evaluation of one trial; raises `NotUsable`, with the sufficient size for a sweep that is too small."""
    low, high = (trial.point.get(name) for name in ("lowest_angle", "highest_angle"))
    if low is None or high is None:
        raise NotUsable("its plan names no lowest and highest angle, so its turns are not known")
    loop = measure(run, trial, int(settings_of(run, options).get("discard", 1)), TURN * (high - low), AXES)
    half, gap = 0.5 * (high - low), float(loop.middle_gap.mean())
    noise = float(np.sqrt(0.5 * np.mean(np.diff(loop.gap, axis=1) ** 2)))  # of one point, by its neighbours
    kept, apart, along = _by_commands(run, trial, len(loop.gap))
    elsewhere = kept.turns_elsewhere(half)
    if loop.turns is None:  # none at mid sweep, but at another place, is no joint without hysteresis
        gap = max(gap, *(float(part.mean()) for part in np.array_split(loop.gap.mean(axis=0), PARTS)))
    if why := why_no_turns(loop.turns, half, gap, noise):
        raise OffForm(elsewhere or why)
    if loop.turns is not None and half < HALF_SWEEP * loop.turns.w:
        least, w = show(HALF_SWEEP * loop.turns.w, "angle", 3), show(loop.turns.w, "angle", 3)
        raise OffForm(
            elsewhere
            or f"the sweep of +-{show(half, 'angle', 3)} is too small for the hysteresis: a turn fades on {w}, 3 of "
            f"which are cut after each turn, and mid sweep must lie one more beyond them; sweep at least +-{least}"
        )
    stiffness, plain = _slopes(loop), _slopes(loop, keep=True)
    taken_off = abs(float(stiffness.mean() - plain.mean()))
    step = flank(loop.x, loop.contracting.mean(axis=0), loop.expanding.mean(axis=0), loop.ends, loop.turns)
    return Sweep(run, trial, loop, stiffness, taken_off, second_of(loop), kept, step, apart, along)


def flatter_by(one: Sweep) -> float:
    """Decrease of the stiffness at mid sweep by a step of the torque at its change of sign [N m/rad]."""
    x = one.loop.x - one.loop.x.mean()
    return abs(one.flank * float(np.polyfit(x, np.sign(one.loop.mean.mean(axis=0)), 3)[2]))


def _by_commands(run: RunData, trial: TrialData, cycles: int) -> tuple[Kept, Array, Array]:
    """Deviation of pressures and angle from their commands; `apart` and `along` of `Sweep`.

    Over the last `cycles`. A lag of the drive cancels between both directions.
    """
    moves = [c for c in trial.commands if c.output == AXES.moved and c.phase in (AXES.rises, AXES.falls)]
    angle, *pressures = (on_time(run, trial, name) for name in (AXES.moved, *MUSCLES))
    means, lines, cubics = [], [], []
    for ramp in moves[-2 * cycles :]:
        rows = (trial.t >= ramp.t) & (trial.t < ends(ramp)) & trial.usable
        way = (trial.t[rows] - ramp.t) / (ends(ramp) - ramp.t)
        wanted = ramp.before + (ramp.value - ramp.before) * way
        means.append([float(P[rows].mean()) for P in pressures])
        lines.append(np.polyfit(wanted, angle[rows] - wanted, 1))
        middle = wanted - 0.5 * (ramp.before + ramp.value)
        cubics.append([np.polyfit(middle, P[rows] - P[rows].mean(), 3) for P in pressures])
    each, (scale, zero) = np.array(means), np.mean(lines, axis=0)
    off = each.mean(axis=0) - [trial.point[name] for name in MUSCLES]
    return Kept(off, float(zero), float(scale)), each[1::2] - each[::2], np.array(cubics)


SHORTER, LONGER = 0.4, 1.3
"""Widths of the first turn that are tried together with a second one, relative to that found without it."""
SLOWER = 1.5
"""Smallest ratio of the second width to the first."""
TRIED = 24
BETTER = 4.0
"""Standard deviations by which a second turn must describe the gap better than a parabola."""


def second_of(loop: Loop) -> Turns | None:
    """A slower transition in the gap after turns: a second hysteresis, or creep; None if not significant.

    A gap that depends on the angle, or on pressures that depend on it, has another form: a parabola and a slope.
    """
    if loop.turns is None:
        return None
    x, gap, (lower, upper) = loop.x, loop.gap.mean(axis=0), loop.ends
    z, one = (2 * x - lower - upper) / (upper - lower), np.ones_like(x)
    first = loop.turns.w * np.geomspace(SHORTER, LONGER, TRIED)
    longer = np.geomspace(SLOWER * loop.turns.w, upper - lower, TRIED)
    fades = {w: np.sum(fading(x, lower, upper, w), axis=0) for w in (*first, *longer)}
    pairs = [(w, v) for w in first for v in longer if v >= SLOWER * w]
    curved = left_by(np.stack([one, z, z**2]), np.array([[fades[w]] for w in first]), gap).min()
    left = left_by(np.stack([one, z]), np.array([[fades[w], fades[v]] for w, v in pairs]), gap)
    variance = float(left.min()) / (len(x) - 6)
    w, v = pairs[int(np.argmin(left))]
    terms, *_ = np.linalg.lstsq(np.column_stack([one, z, fades[w], fades[v]]), gap, rcond=None)
    h = -float(terms[3])
    if h <= 0 or curved - left.min() <= BETTER**2 * variance:
        return None
    return Turns(h, v, lower, upper, float(np.sqrt(variance)))


def steeper_by(second: Turns) -> float:
    """Increase of the stiffness at mid sweep by a second turn [N m/rad]."""
    half = 0.5 * (second.upper - second.lower)
    return 2 * second.h / second.w * float(np.exp(-half / second.w) / (1 + np.exp(-2 * half / second.w)))


def _slopes(loop: Loop, *, keep: bool = False) -> Array:
    """Stiffness of each cycle [N m/rad], mean of its branches; with `keep` without correction for the rest of the
    turns.
    """
    x, turns, (lower, upper) = loop.x, loop.turns, loop.ends
    cut, rising, falling = 0.0 if turns is None else CUT * turns.w, np.zeros_like(x), np.zeros_like(x)
    if turns is not None and not keep:
        first, second = fading(x, lower, upper, turns.w)
        rising, falling = turns.h * first, -turns.h * second
    found = []
    for branches, way, rest in ((loop.contracting, x - lower, rising), (loop.expanding, upper - x, falling)):
        kept = way >= cut
        found.append(-np.polyfit(x[kept] - 0.5 * (x[0] + x[-1]), (branches - rest)[:, kept].T, 3)[2])
    return np.asarray(np.mean(found, axis=0))


KIND = "joint-sweep"
BRANCHES, LOOP, MEAN = "branches, 3 w cut", "loop", "mean curve"
NEAR = 0.02
"""Range around a place, as a share of the sweep, in which the steepest slope of the mean curve is taken for it."""
SURE = 4.0
"""Standard errors from which on a difference of the pressures between the directions is significant."""
PLAY = "play under the torque"
ALONG = "pressures along the sweep"
LOSES = 2.0
"""Angle on which a muscle loses its force [rad]: 0.2 to 0.25 of its length on a pulley of an eighth of that."""
PLACES = 5
"""Number of places along the sweep at which the mean curve is given."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Stiffness K_th [N m/rad], gap H_tau [N m], loop area W [J] and torque tau [N m] of sweeps at constant pressures.

    The stiffness is minus the slope of the torque at mid sweep (joints-endurance, antagonistic muscles: a small sweep
    gives the slope of the hysteresis instead, three times as much). A sweep that is too small is refused with the
    reason. `options`: `discard` (cycles at the start; else the plan's setting, else 1).
    """
    result = _sweeps(runs, options)
    for at, members in _cells(result.measured).items():
        result.estimates += _estimates(dict(at), members, result.scales)
        result.traces.append(_trace(dict(at), members[-1]))
    result.doubt_dropped()
    for one, turns in ((one, one.loop.turns) for one in result.measured):
        if turns is not None:
            text = f"{one.trial.name}: a turn fades on w = {show(turns.w, 'angle', 3)}; 3 w are cut after each"
            result.findings.append(Finding("note", text))
    kept = [(one.trial.point, one.kept) for one in result.measured]
    result.findings += joint.findings(runs, kept, result.scales, result.estimates)
    return result.analysis()


def stiffness_of(run: RunData, trial: TrialData) -> float:
    """Stiffness of one trial [N m/rad]; raises `NotUsable`."""
    return float(sweep_of(run, trial, {}).stiffness.mean())


def _sweeps(runs: Sequence[RunData], options: Mapping[str, Any] | None) -> Reduction[Sweep]:
    """The usable trials, without those of a point where at least as many loops have another form."""
    off: dict[tuple[float, ...], list[str]] = {}
    ceilings: dict[str, list[Ceiling]] = {}

    def measured(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Sweep:
        try:
            return sweep_of(run, trial, options)
        except OffForm as reason:
            if run.id not in ceilings:
                ceilings[run.id] = [one for one in saturated(run) if one.channel == AXES.pulls]
            cut = (one.text.removeprefix(f"{run.id}: ") for one in ceilings[run.id] if one.cut(trial).any())
            text = next(cut, str(reason))
            off.setdefault(_place(trial.point), []).append(text)
            raise OffForm(text) from None

    result = Reduction.of(KIND, RESULTS, runs, options, measured)
    alike = [_place(one.trial.point) for one in result.measured]
    spoiled = {place for place, reasons in off.items() if len(reasons) >= alike.count(place)}
    for one, place in zip(result.measured, alike, strict=True):
        if place in spoiled:
            text = f"half of the sweeps at this point, or more, have another form, so it tells nothing: {off[place][0]}"
            result.dropped.append(Dropped(one.trial.name, one.trial.point, text))
    result.measured = [one for one, place in zip(result.measured, alike, strict=True) if place not in spoiled]
    return result


COORDINATES = (*MUSCLES, "angular_speed", "lowest_angle", "highest_angle")


def _place(point: Mapping[str, float]) -> tuple[float, ...]:
    """Pressures, speed and ends of a sweep."""
    return tuple(round(point.get(name, 0.0), 9) for name in COORDINATES)


def _cells(sweeps: Sequence[Sweep]) -> dict[tuple[tuple[str, float], ...], list[Sweep]]:
    """The trials of one operating point together."""
    varied = [name for name in COORDINATES[3:] if len({one.trial.point[name] for one in sweeps}) > 1]
    names = (*COORDINATES[:3], *varied)
    cells = grouped(sweeps, lambda one: tuple((name, round(one.trial.point[name], 9)) for name in names))
    return dict(sorted(cells.items()))


def _estimates(at: Mapping[str, float], members: Sequence[Sweep], scales: Scales) -> Iterator[Estimate]:
    """All estimates of one operating point; a wrong pressure changes the stiffness."""
    kept, seconds = [one.kept for one in members], [one.second for one in members]
    made = partial(joint.estimate, trials=tuple(one.trial.name for one in members), kept=kept, scales=scales)
    K = float(np.mean([one.stiffness.mean() for one in members]))
    sweep, x = max(one.loop.ends[1] - one.loop.ends[0] for one in members), members[0].loop.x
    total = sum(at[name] for name in MUSCLES)
    share = 1 / total if total > 0 else 0.0
    pulls = K * float(np.ptp(x)) * share * total
    of_gap = _of_gap(members, K, pulls * share)
    stiffness, taken_off = [one.stiffness for one in members], max(one.taken_off for one in members)
    found = made("K_th", STIFFNESS, BRANCHES, stiffness, taken_off, at, by_pressure=BY_PRESSURE * K * share, by_gain=-K)
    steeper = [steeper_by(s) if s else 0.0 for s in seconds]
    flat = Doubt(PLAY, "method", max(flatter_by(one) for one in members), False)
    # torque of one muscle by its pressure [N m/Pa]: its share of the difference at mid sweep, and what it would lose
    middles = [abs(float(one.loop.mean[:, one.loop.x.size // 2].mean())) for one in members]
    per_pressure = share * (max(middles) + abs(K) * LOSES)
    yield weighed(found, [joint.way(kept, K), _second(members, steeper), flat, _along(members, per_pressure)])
    # difference of the fitted open gap to that at mid sweep, and remainder of the turns in the mean curve [N.m]
    fits = [(one.loop, one.loop.turns) for one in members]
    unclosed = max(abs(2 * t.h - float(loop.middle_gap.mean())) if t else 0.0 for loop, t in fits)
    unclosed = max(unclosed, *(2 * s.w * more if s else 0.0 for s, more in zip(seconds, steeper, strict=True)))
    of_turns = [np.abs(t.of_mean(loop.x)) if t else np.zeros_like(loop.x) for loop, t in fits]
    yield weighed(made("H_tau", TORQUE, LOOP, [one.loop.middle_gap for one in members], unclosed, at), of_gap)
    corners = max(2 * abs(float(m.loop.middle_gap.mean())) * m.loop.speed / m.run.rate for m in members)
    lost = [one.loop.lost for one in members]
    W = float(np.mean([one.mean() for one in lost]))
    of_work = [replace(one, half=sweep * one.half) for one in of_gap]
    yield weighed(made("W", ("J", "work"), LOOP, lost, corners, at, by_gain=W), [*of_work, joint.way(kept, W)])
    steep = np.abs(np.gradient(members[0].loop.mean.mean(axis=0), x))
    fades = min((one.loop.turns.w for one in members if one.loop.turns is not None), default=np.inf)
    for place in np.linspace(x[0], x[-1], PLACES):
        curves = [np.array([np.interp(place, one.loop.x, cycle) for cycle in one.loop.mean]) for one in members]
        where = {**at, "angle": round(float(place), 7)}
        off = max(float(np.interp(place, m.loop.x, left)) for m, left in zip(members, of_turns, strict=True))
        # bound of the torque of both muscles, of which a pressure error changes a share
        whole = max(abs(float(np.mean(curve))) for curve in curves) + pulls
        steepest = float(steep[np.abs(x - place) <= NEAR * np.ptp(x)].max()) + off / fades
        found = made("tau", TORQUE, MEAN, curves, 0.1 * off, where, by_pressure=whole * share,
                     by_angle=steepest, by_gain=steepest * where["angle"])  # fmt: skip
        left = _second(members, [float(s.of_mean(np.array([place]))[0]) if s else 0.0 for s in seconds])
        drawn = _along(members, per_pressure, float(place))
        yield weighed(found, [joint.place(kept, float(place), steepest), left, drawn], whole)


def _of_gap(members: Sequence[Sweep], K: float, per_pressure: float) -> list[Doubt]:
    """Effects of a late torque, backlash, drift and pressures on a gap [N m]; `per_pressure` [N m/Pa]."""
    late = max((one.loop.late for one in members), key=lambda doubt: (doubt.seen, doubt.half))
    gap = 2 * abs(K) * max(one.loop.speed for one in members) * late.half
    apart = np.concatenate([one.apart for one in members])
    size, seen = _of_both(apart)
    text = f"the pressures differ by {show(size, 'pressure', 2)}, both muscles together, between the directions"
    reason = f"{text}: the regulators cannot follow. Sweep more slowly"
    return [
        replace(late, half=gap),
        Doubt("drift", "drift", 0.5 * max(one.loop.uneven_drift for one in members), False),
        Doubt(PLAY, "method", 2 * max(one.flank for one in members), False),
        Doubt("pressures of both directions", "method", per_pressure * size, seen, reason),
    ]


def _of_both(each: Array) -> tuple[float, bool]:
    """Mean of a difference of the pressures of both muscles together, and whether the rows of `each` (n, 2) agree."""
    size = float(np.abs(each.mean(axis=0)).sum())
    scatter = float(np.linalg.norm(each.std(axis=0, ddof=1))) / np.sqrt(len(each)) if len(each) > 1 else size
    return size, size > SURE * scatter


def _along(members: Sequence[Sweep], per_pressure: float, angle: float | None = None) -> Doubt:
    """Effect of pressures that change along the sweep on the stiffness at its middle, or on the torque at an `angle`.

    `per_pressure` is the change of the torque by either pressure [N m/Pa]. It is significant where the ramps agree.
    """
    ramps = np.concatenate([one.along for one in members])
    lower, upper = members[0].loop.ends
    powers = np.vander(np.append(np.linspace(lower, upper, 9), angle or 0.0) - 0.5 * (lower + upper), 4)
    each = ramps @ (powers[-1] if angle is not None else np.array([0.0, 0.0, 1.0, 0.0]))
    size, seen = _of_both(each)
    span = float(np.ptp(ramps.mean(axis=0) @ powers[:-1].T, axis=1).sum())
    reason = (
        f"along the sweep the pressures change by {show(span, 'pressure', 2)}, both muscles together: the regulators "
        "give way to the motion. Sweep more slowly, or look at the regulators"
    )
    return Doubt(ALONG, "method", per_pressure * size, seen, reason)


def _second(members: Sequence[Sweep], each: Sequence[float]) -> Doubt:
    """Effect of a second turn on a value, from its effect in `each` member."""
    half = abs(float(np.mean(each)))
    ways = [one.second.w for one in members if one.second is not None]
    way = show(float(np.mean(ways)), "angle", 2) if ways else ""
    reason = (
        f"a part of the hysteresis, or of what creeps, fades on {way} only, and is not over at mid sweep, where it "
        "counts as stiffness. Sweep farther"
    )
    return Doubt("a second turn", "method", half, bool(ways), reason)


def _trace(at: Mapping[str, float], one: Sweep) -> Trace:
    """The last loop of an operating point, and its mean curve on the loop's own samples."""
    angle, torque = one.loop.last
    mean = np.interp(angle, one.loop.x, one.loop.mean.mean(axis=0), left=np.nan, right=np.nan)
    title = f"Torque over angle at {' and '.join(show(at[name], 'pressure') for name in MUSCLES)}"
    name = "joint-loop-" + "-".join(f"{at[name] / 1e3:g}" for name in MUSCLES) + f"-{one.trial.number}"
    marks = {**at, "K_th": float(one.stiffness.mean()), "H_tau": float(one.loop.middle_gap.mean())}
    columns = {"angle": angle, "torque": torque, "mean": mean}
    return Trace(name, "joint-loop", title, columns, {"angle": "angle", "torque": "torque", "mean": "torque"}, marks)


PANELS = 6
"""Most panels."""


@of_some("Torque over angle", PANELS, "angle", "torque")
def loops(traces: Sequence[Trace]) -> Drawn:
    """The last loop of each operating point, and the mean of its branches."""
    labels = label(traces[0], "angle"), label(traces[0], "torque")
    charts = []
    for trace, theirs in zip(traces, crosses(traces, "angle", "torque"), strict=True):
        lines = [curve(trace, "angle", "torque", "loop", BLUE, width=1.0)]
        lines += [curve(trace, "angle", "mean", "mean", INK, width=1.0, dashed=True)] if has(trace, "mean") else []
        charts.append(Chart(*labels, (*lines, *theirs), title=head(trace), legend=True))
    gaps, slopes = (reach([trace.marks[name] for trace in traces]) for name in ("H_tau", "K_th"))
    caption = (
        "The last cycle, and the mean of its branches without what the turns leave in it: what a model without "
        f"hysteresis is to give. Gap at mid sweep, falling minus rising angle: {gaps} N·m; stiffness there: {slopes} "
        f"N·m/rad."
    )
    return small_multiples(charts, 3), caption
