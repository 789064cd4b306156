"""Reduction of steps of displacement at constant pressure: static and instantaneous stiffness, recovery to rest.

For all steps of a cell: K and F at rest at its pressure, at the peak, and time constants, with their intervals. Also
the figure, and with `one_trial` the values of one trial for the display.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import hypot, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import MOST_HIDDEN, Doubt, force_from_cycle_to_cycle, weighed
from pmabench.analysis.shared.lines import mean_of_cycles
from pmabench.analysis.shared.samples import OF_TWO, STEPS, Held, NotUsable, left
from pmabench.analysis.shared.trials import Reduction, grouped, point_by, thinned
from pmabench.analysis.trial import DRIFT, Expected, Found, Measured, Quick
from pmabench.analysis.verdict.agreement import Offer, exactly, values_of, weighted
from pmabench.base.quantities import show
from pmabench.kinds.step_displacement import RESULTS
from pmabench.kinds.step_displacement.step import Recovery, Relaxation, Steps, measure
from pmabench.plotting.chart import BLUE, BROWN, INK, QUIET, Level, Series
from pmabench.plotting.motion import courses
from pmabench.plotting.pictures import Drawn, column, has, head, label, of_some
from pmabench.plotting.wording import shown
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import RunData, TrialData


def stiffness_of(run: RunData, trial: TrialData) -> float:
    """Stiffness of one trial's steps away from the start, by relaxed forces [N/m]; raises `NotUsable`."""
    return float(np.mean([step.static for step in measure(run, trial, {}).there]))


KIND = "step-displacement"
RELAXED, PEAK, BACK = "step, relaxed", "step, peak", "step, recovery"
EXTREME = 3.0
"""Standard deviations of noise by which a peak exceeds the signal."""
TAIL = 0.1
"""Relative error of a time constant because the actuator creeps at the end of the motion."""
CELL = ("pressure", "start", "step", "speed")
STEPS_OF_ONE = "one trial: the repeats part is the scatter of its steps, and repeated tests may scatter more"
ONE_STEP = "no repeats part: one step"
DRIFTS = 0.02
"""Change of the force still to come after a rest, as a share of its step, from which on it is a doubt."""
STIFFNESS, SLOPE = ("N/m", "stiffness"), {"force": 1, "displacement": -1}
"""Unit and quantity of K, and the powers with which the gains of the channels enter it."""
BLUNT = 0.25
"""Effect of a filter on a peak, as a share of its rise, above which the peak is withheld."""
FIRST = 4.0
"""What a filter takes off a peak, over what a second one takes off, which finds it round: where the first is slow, the
record does not show its size, and already a small effect withholds."""
SEVERAL = 0.4
"""Largest relative difference of the later part's time constant for a single exponential."""
UNTURNED = 0.05
"""Share of the friction between two rests that a small step may not have reversed."""
RUBS = "friction between the two rests is in it"
AT_LEAST = f"{RUBS}, as twice its size over the step: it is at least K"
RUBBED = "friction between the rests"
EITHER_REST = "counted from the pressure at rest before the step, or after it"
LIKELY = 2.0
"""Upper bound of dF/dP, as a multiple of that of a force proportional to the pressure at the rest length."""
CERTAIN = 5.0
"""Standard errors from which on two pressures differ."""
FEW = 25
"""Assumed number of independent samples in a rest, as a lower bound."""
SEEN = 3.0
"""Standard deviations of noise from which on a higher force on return to the start is significant."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """K [N/m] from relaxed forces and from the peak, forces [N] around each step, time constants [s] of the recovery.

    Static stiffness is -(F relaxed - F before)/(measured step); the instantaneous one has the peak in place of the
    relaxed force and includes damping (K + B v/step for three elements) and the pressure change by the step. Steps
    there and back differ by their sign: positive steps contract the muscle. The time constants are those of one
    exponential after the end of the motion. `options`: `discard` (cycles at the start; else the plan's setting, else
    1).
    """
    result = Reduction.of(KIND, RESULTS, runs, options, measure)
    cells = result.cells(lambda one: point_by(one.trial, CELL))
    rubbed: dict[tuple[float, float], float] = {}
    for key, group in cells:
        most = max(map(_rubbed, group))
        rubbed[_place(dict(key))] = max(most, rubbed.get(_place(dict(key)), 0.0))
    for key, group in cells:
        at = dict(key)
        for back in (False, True):
            here = {**at, "step": (-1.0 if back else 1.0) * at.get("step", 0.0)}
            each = [member.back if back else member.there for member in group]
            way = Way(here, group, each, result.scales, rubbed[_place(at)])
            result.estimates += [*way.forces(), *map(way.if_not_missed, way.peaks()), *way.times()]
        result.findings += _findings(group)
        result.traces.append(_trace(at, group[0]))
    result.estimates.sort(key=lambda e: (RELAXED, PEAK, BACK).index(e.method))
    result.note_lack(("force", "displacement"))
    return result.analysis(cells=len(cells))


def _start(e: Estimate) -> tuple[float, float, float]:
    """Pressure [Pa], start [m] and speed [m/s] of steps."""
    return *_place(e.at), e.at.get("speed", 0.0)


def _place(at: Mapping[str, float]) -> tuple[float, float]:
    """Pressure [Pa] and start [m] of a cell."""
    return at.get("pressure", 0.0), at.get("start", 0.0)


def _rubbed(steps: Steps) -> float:
    """Increase of the force at the start over that before the first step [N]; 0 if not significant.

    The first rest follows a contraction and later ones a stretch, so the difference is twice the friction. It also
    contains initial creep, and what the pressure differs.
    """
    first = steps.first
    rise = steps.there[-1].before - first.before
    return rise if rise > SEEN * max(first.noise, *first.unresolved.values()) else 0.0


@dataclass(frozen=True, eq=False)
class Way:
    """The steps of one cell in one direction."""

    at: Mapping[str, float]
    group: Sequence[Steps]
    each: Sequence[tuple[Relaxation, ...]]
    """The steps of each trial."""
    scales: Scales
    rubbed: float
    """Twice the friction between two rests, as far as it is significant [N]."""

    @cached_property
    def every(self) -> list[Relaxation]:
        """The steps of all trials."""
        return [one for steps in self.each for one in steps]

    @property
    def moved(self) -> float:
        """Measured size of the step [m]."""
        return abs(float(np.mean([one.moved for one in self.every])))

    def estimate(
        self, symbol: str, kind: tuple[str, str], method: str, every: Sequence[float], powers: Mapping[str, int],
        extra: float = 0.0, coordinate: str = "", doubts: Sequence[Doubt] = (), note: str = "",
    ) -> Estimate:  # fmt: skip
        """The mean of a value of `every` step."""
        values = np.split(np.array(every), np.cumsum([len(steps) for steps in self.each])[:-1])
        mean, half = mean_of_cycles(values)
        gains = {name: mean * power for name, power in powers.items()}
        # a sensor with backlash has opposite errors at both ends of the step
        offsets = {"displacement": 2 * mean / self.moved} if symbol == "K" else {}
        if symbol == "F":  # like a force that is proportional to the pressure, along the stiffness
            P, K = self.at.get("pressure", 0.0), float(np.mean([one.static for one in self.every]))
            gains |= {"pressure": mean} if P > 0 else {}
            offsets = {"force": 1.0, "displacement": K} | ({"pressure": mean / P} if P > 0 else {})
        part = self.scales.part(gains, offsets)
        note = sentences(note, ONE_STEP if half is None else STEPS_OF_ONE if len(self.group) == 1 else "")
        if part is None and set(powers) - {"force", "displacement"}:
            note = sentences(note, self.scales.lack(powers))
        names = tuple(member.trial.name for member in self.group)
        e = Estimate(symbol, mean, *kind, method, dict(self.at), Parts(half, extra, part), len(self.group), note=note,
                     trials=names, coordinate=coordinate)  # fmt: skip
        return weighed(e, [*doubts, *(force_from_cycle_to_cycle(values) if symbol == "F" else ())])

    def over_way(self, *doubts: Doubt) -> list[Doubt]:
        """Doubts about a force [N] as ones about a stiffness [N/m]."""
        return [replace(one, half=one.half / self.moved) for one in doubts]

    def forces(self) -> Iterator[Estimate]:
        """K and forces at rest."""
        every, kind = self.every, ("N", "force")
        before, after = (_still_moving([getattr(one, name) for one in every]) for name in ("earlier", "later"))
        rub, static = Doubt(RUBBED, "method", self.rubbed, seen=True), [one.static for one in every]
        at_rest = (before, after, self.off_pressure((-1, 1)), rub, self.of_steps(float(np.mean(static))))
        yield self.estimate("K", STIFFNESS, RELAXED, static, SLOPE, note=AT_LEAST, doubts=self.over_way(*at_rest))
        once, half_rub = self.of_steps(0.0, 1.0), replace(rub, half=rub.half / 2)
        for name, rests, doubt in (("before", (1, 0), before), ("relaxed", (0, 1), after)):
            values = [getattr(one, name) for one in every]
            doubts = (doubt, self.off_pressure(rests), half_rub, once)
            yield self.estimate("F", kind, RELAXED, values, {"force": 1}, 0.0, name, doubts, "friction is in it")

    def peaks(self) -> Iterator[Estimate]:
        """K and force at the peak, and the pressure's largest error."""
        every, instant = self.every, [one.instant for one in self.every]
        extreme = hypot(EXTREME * max(one.noise for one in every), max(one.sampled for one in every))
        before, hidden = _still_moving([one.earlier for one in every]), _hidden(every, "force")
        doubts = self.over_way(before, *hidden, self.of_steps(float(np.mean(instant))))
        yield self.estimate("K", STIFFNESS, PEAK, instant, SLOPE, extreme / self.moved, note=RUBS, doubts=doubts)
        forces = [one.peak for one in every]
        share = abs(float(np.mean(instant))) * self.moved / max(abs(float(np.mean(forces))), 1e-9)
        doubts = [*(replace(one, most=share * one.most) for one in hidden), self.of_steps(0.0, 1.0)]
        yield self.estimate("F", ("N", "force"), PEAK, forces, {"force": 1}, extreme, "peak", doubts)
        if all(np.isfinite(one.pressure_peak) for one in every):
            errors, others = [one.pressure_peak for one in every], [one.pressure_after for one in every]
            apart = abs(float(np.mean(errors) - np.mean(others)))
            doubts = [*_hidden(every, "pressure"), Doubt(EITHER_REST, "method", apart, seen=True)]
            leap = hypot(EXTREME * max(one.pressure_noise for one in every), self.read("pressure"))
            note = f"{EITHER_REST}: {show(apart, 'pressure', 2)} apart" if apart > leap else ""
            yield self.estimate("P_err", ("Pa", "pressure"), PEAK, errors, {"pressure": 1}, leap, "", doubts, note)

    def if_not_missed(self, e: Estimate) -> Estimate:
        """The estimate of a peak, withheld if its channel is updated too seldom to show one."""
        channel = "pressure" if e.symbol == "P_err" else "force"
        time = max(one.missed.get(channel, 0.0) for one in self.every)
        if not time:
            return e
        often = f"the {channel} is new every {show(time, 'time', 2)}, which is longer than the step takes, and held in"
        return withhold(e, f"{often} between: its peak may lie there. Read it more often, or step more slowly")

    @property
    def steep(self) -> float:
        """Upper bound of dF/dP [N/Pa]; 0 without a pressure."""
        start, size, pressure = (abs(self.at.get(name, 0.0)) for name in ("start", "step", "pressure"))
        each = [max(abs(one.before), abs(one.relaxed)) + abs(one.static) * (start + size) for one in self.every]
        return LIKELY * float(np.mean(each)) / pressure if pressure > 0 else 0.0

    def off_pressure(self, rests: tuple[int, int]) -> Doubt:
        """Effect of pressures at rest that are not that of the operating point, on a force [N] that is the one before
        times `rests[0]` plus the one after times `rests[1]`.
        """
        off = np.array([one.pressures for one in self.every]) - self.at.get("pressure", 0.0)
        known = bool(np.isfinite(off).all())
        each = off @ rests if known else np.zeros(len(off))
        apart = abs(float(each.mean()))
        noise = max(one.pressure_noise for one in self.every) / sqrt(FEW)
        error = hypot(noise, float(each.std())) / sqrt(len(each))
        where = "rests at other pressures before and after the steps" if all(rests) else "rests off its set-point"
        text = f"the regulator {where}, by {show(apart, 'pressure', 2)}, which may be worth"
        reason = f"{text} {show(self.steep * apart, 'force', 2)}: hold longer, or use a finer regulator"
        half, seen = self.steep * apart, apart > CERTAIN * error
        if all(rests):
            return Doubt("pressure at rest", "method", half, seen, reason)
        # what is declared for the gauge is no reason to withhold
        offset, gain = (of.get("pressure", 0.0) for of in (self.scales.offsets, self.scales.gains))
        force = abs(float(np.mean([rests[0] * one.before + rests[1] * one.relaxed for one in self.every])))
        more = self.steep * hypot(offset, gain * self.at.get("pressure", 0.0)) / max(force, 1e-9)
        return Doubt("pressure at rest", "method", half, seen, reason, MOST_HIDDEN + more)

    def read(self, channel: str) -> float:
        """Error of the mean of a rest because the channel is read in steps [SI]."""
        return max(one.unresolved.get(channel, 0.0) for one in self.every)

    def of_steps(self, K: float, rests: float = OF_TWO) -> Doubt:
        """Error of a rest's force, or of the force between two rests with a stiffness, because the channels are read in
        steps [N].
        """
        each = (self.read("force"), K * self.read("displacement"), self.steep * self.read("pressure"))
        return Doubt(STEPS, "method", rests * float(np.linalg.norm(each)), seen=False)

    def times(self) -> Iterator[Estimate]:
        """Time constants of the recovery of force and pressure."""
        names = tuple(member.trial.name for member in self.group)
        for symbol, name in (("tau_F", "force_back"), ("tau_p", "pressure_back")):
            back = [one for each in self.every if (one := getattr(each, name)) is not None]
            if len(back) < len(self.every):
                empty = Estimate(symbol, None, "s", "time", BACK, dict(self.at), n=len(self.group), trials=names)
                yield replace(empty, note="no recovery shows above the noise, or it is over within a few samples")
                continue
            tau = self.estimate(symbol, ("s", "time"), BACK, [one.tau for one in back], {})
            tau = _one_time(tau, max(one.apart for one in back))
            yield tau if name == "pressure_back" else self._of_force(tau, back)

    def _of_force(self, tau: Estimate, back: Sequence[Recovery]) -> Estimate:
        """The time constant of the force; withheld if it may not be of the muscle."""
        after = _still_moving([one.later for one in self.every])
        size = float(np.mean([abs(one.size) for one in back]))
        if after.seen and after.half > MOST_HIDDEN * size:
            return withhold(tau, after.reason)
        if np.median([one.fast for one in self.every]) > 0 and tau.value is not None:
            text = f"the force comes back within {show(tau.value, 'time', 2)} and the pressure does not show it"
            why = f"{text}: a filter of the force cell or the end of the motion does that, too. Declare `sensor_lag`"
            return withhold(tau, f"{why} of the channel, or use a faster cell")
        return tau


def _one_time(tau: Estimate, apart: float) -> Estimate:
    """A time constant with the difference of its later part in the interval; withheld if it is not a single
    exponential.
    """
    value = abs(tau.value or 0.0)
    if apart > SEVERAL * value:
        later = f"the later part of the way back has a time constant that differs by {apart / value:.0%}"
        return withhold(tau, f"{later} (below {SEVERAL:.0%} is accepted): it is not one exponential")
    note = sentences(tau.note, "no calibration part: a time has no scale")
    return replace(tau, parts=Parts(tau.parts.repeats, hypot(TAIL * value, apart)), note=note)


SENSOR = {"force": "force cell", "pressure": "gauge"}


def _hidden(every: Sequence[Relaxation], channel: str) -> list[Doubt]:
    """Possible reduction of the peaks of a channel by a filter that no channel shows, and by missing samples [SI]."""
    half, unseen = (max(getattr(one, name)[channel] for one in every) for name in ("blunted", "unseen"))
    goes_on, constant = max(one.after[channel] for one in every), max(one.constant(channel) for one in every)
    most, filter_ = BLUNT, f"filter of the {SENSOR[channel]}"
    text = f"a {filter_} of {show(constant, 'time', 2)}"
    if goes_on:
        half, most = FIRST * half, MOST_HIDDEN
        text = f"the {channel} goes on for {show(goes_on, 'time', 2)} after the motion, as behind a {filter_}, which"
    text = f"{text} would take {show(half, channel, 2)} off the peak: declare the `sensor_lag` of the channel, use a"
    missing = f"samples of the {channel} are missing at the end of a step, where its peak is: measure again, without"
    return [
        Doubt(filter_, "method", half, True, f"{text} faster sensor, or step more slowly", most),
        Doubt("missing samples", "method", unseen, True, f"{missing} gaps", BLUNT),
    ]


def _still_moving(rests: Sequence[Held]) -> Doubt:
    """Effect of motion of the force at the end of the rests [N]."""
    further = left(rests)
    text = f"the force is not at rest: after the hold it may still change by {show(further.most, 'force', 2)}"
    return Doubt("motion of the force after the rest", "method", further.most, further.seen, f"{text}. Hold longer")


def _findings(group: Sequence[Steps]) -> Iterator[Finding]:
    """Forces not at rest, drift and similar observations."""
    for member in group:
        where = f"trial {member.trial.name}"
        for steps in (member.there, member.back):
            further, size = left([one.later for one in steps]), abs(steps[0].relaxed - steps[0].before)
            if further.seen and abs(further.size) > DRIFTS * size:
                text = f"{where}: after a rest the force would still change by {show(further.size, 'force', 2)}"
                yield Finding("doubt", f"{text}; K is not static yet, hold longer")
        if any(one.static <= 0 for one in (*member.there, *member.back)):
            text = f"{where}: the force rises with contraction: a sign is wrong, or the step is lost"
            yield Finding("fault", text)


def _trace(at: Mapping[str, float], member: Steps) -> Trace:
    """Course around the last step away from the start."""
    step, kinds = member.there[-1], {"pressure": "pressure", "step": "length", "speed": "speed"}
    places = ", ".join(show(at[name], quantity) for name, quantity in kinds.items() if name in at)
    return Trace(
        "step-" + "-".join(f"{value:g}" for value in at.values()),
        "displacement-step",
        f"{places}: step of displacement",
        thinned(member.last),
        {"t": "time", "force": "force", "displacement": "length", "pressure": "pressure"},
        {"before": step.before, "peak": step.peak, "relaxed": step.relaxed},
    )


def offers(analysis: Analysis) -> Iterator[Offer]:
    """K and F from forces at rest; friction increases one, and has one sign in the other.

    At rest the force is above the mean of both directions after stretching and below it after contracting, by a
    friction f. A step s changes it by -K s - 2 f, so two steps of different size from one start give K between their
    ends.
    """
    K = [_without_friction(e) for e in values_of(analysis, "K", RELAXED) if e.at.get("step", 0.0) > 0]
    for e in K:
        P, start = _place(e.at)
        yield replace(exactly("K", {(P, start + e.at["step"] / 2): e}, "at rest"), side=1, why=RUBS)
    for (P, start, _), steps in grouped(K, _start).items():
        for one, two in pairwise(sorted(steps, key=lambda e: e.at["step"])):
            s_1, s_2 = one.at["step"], two.at["step"]
            found = weighted([(two, s_2 / (s_2 - s_1)), (one, -s_1 / (s_2 - s_1))], "K")
            rubbed = abs((one.value or 0.0) - (found.value or 0.0)) * s_1 / (s_2 - s_1)
            parts = replace(found.parts, method=hypot(found.parts.method or 0.0, UNTURNED * rubbed))
            yield exactly("K", {(P, start + (s_1 + s_2) / 2): replace(found, parts=parts)}, "steps of two sizes")
    for e in analysis.estimates:
        if (e.symbol, e.method) == ("F", RELAXED) and e.value is not None and e.at.get("step", 0.0) > 0:
            before = e.coordinate == "before"
            x = e.at.get("start", 0.0) + (0.0 if before else e.at["step"])
            words = f"after {'stretching' if before else 'contracting'}"
            e = _without_friction(e)
            yield replace(exactly("F", {(e.at["pressure"], x): e}, words), side=1 if before else -1, why=RUBS)


def _without_friction(e: Estimate) -> Estimate:
    """The estimate without friction in its interval: a one-sided comparison includes it, and two steps cancel it."""
    rubbed = sum((line.half or 0.0) ** 2 for line in e.budget if line.name == RUBBED)
    method = max(0.0, (e.parts.method or 0.0) ** 2 - rubbed) ** 0.5
    return replace(e, parts=replace(e.parts, method=method)) if rubbed else e


PANELS = 4
"""Most panels."""
LEVELS = ("before", "peak", "relaxed")
"""Marks of forces in a panel."""


@of_some("Steps of displacement", PANELS, "t", "force", "displacement")
def steps(traces: Sequence[Trace]) -> Drawn:
    """Displacement, force and pressure over time around steps of displacement."""
    scale, stacks = shown("force").scale, []
    for trace in traces:
        near = _around(trace)
        lines = [
            Series("", column(trace, "t")[near], column(trace, name)[near], color, width=1.0)
            for name, color in (("displacement", QUIET), ("force", BLUE), ("pressure", BROWN))
            if all(has(t, name) for t in traces)
        ]
        levels = [Level(trace.marks[name] / scale, color=INK) for name in LEVELS if name in trace.marks]
        stacks.append((head(trace), lines, levels))
    labels = [label(traces[0], name) for name in ("t", "displacement", "force")] + [shown("pressure").label("pressure")]
    caption = (
        "Around the last step of a trial. Dashed: force before the step, at its peak and relaxed; the rest after the "
        "step is longer than what is drawn."
    )
    return courses(stacks, labels), caption


def _around(trace: Trace) -> NDArray[np.bool_]:
    """Rows from shortly before the step to well after its motion, six times its duration."""
    x, t = column(trace, "displacement"), column(trace, "t")
    moving = np.flatnonzero(np.abs(x - x[-1]) > 0.05 * np.ptp(x))
    end = float(t[moving[-1]]) if len(moving) else float(t[-1])
    return np.asarray((t >= -end) & (t <= max(6 * end, end + 0.1)))


def one_trial(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K from relaxed forces, and the peak of the force beyond them, of the steps away from the start."""
    P = trial.point.get("pressure")
    try:
        steps = measure(run, trial, {}).there
    except NotUsable as reason:
        return [Measured("K", "stiffness", None)], [str(reason)]
    K = float(np.mean([step.static for step in steps]))
    beyond = float(np.mean([abs(step.peak - step.relaxed) for step in steps]))
    further = left([step.later for step in steps])
    moves = further.seen and abs(further.size) > DRIFT * beyond > 0
    doubts = [f"the force would still change by {show(further.size, 'force', 2)}"] if moves else []
    return [
        Measured("K", "stiffness", K, expected.at("K", P) if expected is not None and P is not None else None),
        Measured("overshoot", "force", beyond, noise=3 * steps[0].noise),
    ], doubts
