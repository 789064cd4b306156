"""Reduction of steps of a platform's attitude: time, overshoot, end error and valve openings, each with an interval.

The attitude is corrected for the accelerometer's height. Errors of the accelerometer show in its own readings: at rest
their magnitude is g at every attitude, and nearly so in motion. Also the figure: attitude with its reference, and the
three pressures.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from pmabench.analysis.shared.calibration import Scales, changes
from pmabench.analysis.shared.form import MOST_HIDDEN, Doubt, weighed
from pmabench.analysis.shared.samples import NotUsable, count_of, lag_open, noise_of, on_time, settings_of
from pmabench.analysis.shared.skew import off
from pmabench.analysis.shared.trials import Reduction, grouped, mean_of_trials
from pmabench.base.errors import UsageError
from pmabench.base.quantities import show
from pmabench.kinds.platform_step import ACCELERATIONS, MUSCLES, RESULTS, VALVES
from pmabench.model.many.platform import Lags
from pmabench.plotting.chart import BLUE, BROWN, INK, PAGE, PALETTE, Chart, small_multiples
from pmabench.plotting.pictures import Drawn, curve, head, label, of_some
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Trace, withhold
from pmabench.store.records import Array, RunData, TrialData

GRAVITY = 0.003
"""Share by which gravity departs from 9.81 m/s2 between the equator and the poles."""
SURE = 5.0
MOVES = 1.0
"""Time after the step in which the motion is evaluated [s]."""
LATE = 15e-3
"""Delays between axes below this [s] only widen the interval: a sound accelerometer may show up to 12 ms."""
KNOWN, UNSEEN = 0.2, 2e-3
"""Uncertainty of the accelerometer's height, relative and absolute [m]; its effects are in the intervals."""


def _wobble(one: Course) -> float:
    """Amplitude of motion beyond noise in the last second at level, without drift, plus half a count [rad]."""
    level, _ = _rests(one)
    t, power = one.t[level], 0.0
    for angle in (one.phi[level], one.psi[level]):
        power += float(np.var(angle - np.polyval(np.polyfit(t, angle, 1), t)))
    count = 0.5 * max(count_of(one.run, one.trial, name) for name in ACCELERATIONS) / G
    return math.hypot(math.sqrt(2 * max(0.0, power - 2 * one.noise**2)), count)


def _norm(one: Course) -> Array:
    return np.asarray(np.sqrt(sum(np.asarray(one.trial.channels[name]) ** 2 for name in ACCELERATIONS)))


def _rests(one: Course) -> tuple[Array, Array]:
    """Which samples belong to the last second at level, and of the hold."""
    return np.asarray((one.t > -LAST) & (one.t <= 0)), np.asarray((one.t > one.hold - LAST) & (one.t <= one.hold))


def _attitude(courses: Sequence[Course]) -> Doubt:
    """Effect of an offset or a wrong scale of one axis: |f| differs between level and tilted, or is not g."""
    rows = []
    for one in courses:
        norm, (level, held) = _norm(one), _rests(one)
        more = abs(float(norm[held].mean() - norm[level].mean()) / math.sin(one.size))
        error = noise_of(norm) * math.sqrt(1 / level.sum() + 1 / held.sum()) / math.sin(one.size)
        rows.append((more, error, float(norm[level].mean()) / G - 1))
    more, error, _ = rows[int(np.argmax([row[0] for row in rows]))]  # argmax treats NaN as the largest
    off_level = float(np.mean([row[2] for row in rows]))
    scale = max(abs(off_level) - GRAVITY, 0.0)
    half = (more + 2 * error) / G + scale * max(one.size for one in courses)
    seen = more > SURE * error or scale > 0
    size, whole = show(more, "acceleration", 2), show(G * (1 + off_level), "acceleration", 4)
    reason = (
        f"the accelerometer shows {whole} at level, and tilted as if an axis were off by {size}: an axis has an offset "
        "or another scale. Calibrate it, each axis upwards and downwards"
    )
    return Doubt("offset of the accelerometer", "method", half, seen, reason)


def _motion(courses: Sequence[Course]) -> tuple[Array, Array]:
    """Delay of an axis [s] and height of the accelerometer [m], from |f| during the motion, and their standard errors.

    f is g sin(q) across and g cos(q) - h q'^2 along, and h q'' across: regressors of a least squares for delay and
    height.
    """
    rows, columns = [], []
    for one in courses:
        way, norm = one.way, _norm(one)
        rate = np.gradient(way, one.t)
        turning = (one.t > 0) & (one.t <= MOVES)
        behind = -G * np.sin(way) * np.cos(way) * rate
        above = -np.sin(way) * np.gradient(rate, one.t) - rate**2
        rows.append(norm[turning] - norm[_rests(one)[0]].mean())
        columns.append(np.column_stack([behind, above, np.sin(way) ** 2])[turning])
    design, target = np.concatenate(columns), np.concatenate(rows)
    inverse = np.linalg.pinv(design.T @ design)
    terms = inverse @ design.T @ target
    errors = np.sqrt(np.mean((target - design @ terms) ** 2) * np.diag(inverse))
    return terms[:2], errors[:2]


def _between_axes(courses: Sequence[Course]) -> Doubt:
    """Effect of a filter on one axis: while it tilts, |f| departs from g by the delay of the horizontal axis."""
    terms, errors = _motion(courses)
    run = courses[0].run
    open_ = max(lag_open(run, name) for name in ACCELERATIONS) + max(off([run], name) for name in ACCELERATIONS)
    late = abs(float(terms[0]))
    seen = late > SURE * errors[0] and late > LATE
    reason = f"while it tilts, one axis of the accelerometer is {1e3 * late:.2g} ms behind another: look for a filter"
    return Doubt("time between the axes", "method", max(open_, 1.5 * late), seen, reason)


def _elsewhere(courses: Sequence[Course]) -> str:
    """Why the accelerometer is not where it is declared, by |f| during the motion; empty where it may be there."""
    terms, errors = _motion(courses)
    declared, shown, error = _height(courses[0].run), max(0.0, float(terms[1])), SURE * float(errors[1])
    wide = KNOWN * declared + UNSEEN
    if not 0 < error <= wide or abs(shown - declared) <= 0.5 * wide + error:  # noise, or no motion
        return ""
    return (
        f"while it tilts, it does not read as an accelerometer {show(declared, 'length', 2)} above the joint does: "
        "measure where it sits (platform.accelerometer in the bench file), and look whether the frame shakes"
    )


G = 9.81
BAND = math.radians(1.0)
LAST = 1.0
"""Time at the end of the hold over which the end error is averaged [s]."""
LEAST_LAG = 0.01
"""Smallest lag of the smoothing filter, in both directions [s]."""
SAME = 1.5e-3
"""Pulses closer than this count as one opening [s]."""


@dataclass(frozen=True, eq=False)
class Course:
    """A step: times from its start [s], attitude phi and psi [rad], pulses."""

    run: RunData
    trial: TrialData
    t: Array
    phi: Array
    psi: Array
    goal: tuple[float, float]
    hold: float
    noise: float
    """Standard deviation of the smoothed attitude [rad]."""
    pulses: tuple[tuple[float, str, float], ...]
    """Start from the step on [s], valve, duration [s]."""
    law: Mapping[str, Any]

    @property
    def size(self) -> float:
        """Size of the step [rad]."""
        return math.hypot(*self.goal)

    @property
    def held(self) -> Array:
        """Which samples belong to the hold."""
        return np.asarray((self.t > 0) & (self.t <= self.hold + 1e-9))

    @property
    def way(self) -> Array:
        """Attitude in the direction of the step [rad]."""
        return np.asarray((self.phi * self.goal[0] + self.psi * self.goal[1]) / self.size)

    @property
    def away(self) -> Array:
        """Distance from the goal at each sample [rad]."""
        return np.hypot(self.phi - self.goal[0], self.psi - self.goal[1])

    def settled(self, band: float = BAND) -> float | None:
        """Time after which it stays within `band` [rad]; None if it is outside in the second half of the hold."""
        t, outside = self.t[self.held], self.away[self.held] > band
        last = float(t[outside][-1]) if outside.any() else 0.0
        return last if last < 0.5 * self.hold else None

    @property
    def overshoot(self) -> float:
        """Largest overshoot beyond the goal in its direction [rad]; 0 where it does not reach the goal."""
        return max(0.0, float(self.way[self.held].max()) - self.size)

    def ends(self, since: float = LAST, until: float = 0.0) -> tuple[float, float]:
        """Mean attitude minus the goal [rad], from `since` to `until` before the end of the hold [s]."""
        late = (self.t > self.hold - since) & (self.t <= self.hold - until)
        return float(self.phi[late].mean()) - self.goal[0], float(self.psi[late].mean()) - self.goal[1]

    def openings(self) -> dict[str, float]:
        """Valve -> openings per second during the hold [Hz]."""
        ends, found = dict.fromkeys(VALVES, -math.inf), dict.fromkeys(VALVES, 0)
        for begin, valve, seconds in self.pulses:
            if 0 < begin <= self.hold and begin > ends[valve] + SAME:
                found[valve] += 1
            ends[valve] = max(ends[valve], begin + seconds)
        return {valve: count / self.hold for valve, count in found.items()}


def _height(run: RunData) -> float:
    """Declared height of the accelerometer [m]."""
    return max(0.0, float(settings_of(run).get("height", 0.0)))


def course_of(run: RunData, trial: TrialData, higher: float = 0.0) -> Course:
    """The course of a trial, of an accelerometer that is `higher` [m] than declared. Raises `NotUsable`."""
    law, settings = trial.found.get("step") or {}, settings_of(run)
    if law.get("ended") != "time":
        raise NotUsable(f"the loop did not reach its end: {law.get('reason') or law.get('ended') or 'it was cut off'}")
    if not trial.usable.all():
        raise NotUsable("samples are missing or off range, and an attitude cannot be followed over them")
    begin = float(law["t0"]) + float(settings["level"])
    if len(trial.t) < 2 or trial.t[-1] < begin + 0.98 * float(settings["hold"]):
        raise NotUsable("its samples end before the hold does")
    x, y, z = (on_time(run, trial, name) for name in ACCELERATIONS)
    angles = np.arctan2(y, np.hypot(x, z)), np.arctan2(-x, z)
    lag = max(LEAST_LAG, math.sqrt(max(0.0, _height(run) + higher) / G))
    noise = max(noise_of(angle) for angle in angles) * math.sqrt(1 / run.rate / (4 * lag))
    phi, psi = (both_ways(angle, lag, run.rate) for angle in angles)
    goal = trial.point["phi"], trial.point["psi"]
    if not any(goal):
        raise NotUsable("its point names no attitude to go to: phi and psi are 0")
    steered = [pulse for data in _steered(run, trial) for pulse in data["pulses"]]
    pulses = tuple((float(t) - begin, str(valve), float(seconds)) for t, valve, seconds in steered)
    return Course(run, trial, trial.t - begin, phi, psi, goal, float(settings["hold"]), noise, pulses, law)


def both_ways(values: Array, lag: float, rate: float) -> Array:
    """Values through a first-order lag [s] forwards and backwards: 1 / (1 - lag^2 s^2), without delay.

    An accelerometer at height h shows the angle minus h/g times its second derivative: 1 - (h/g) s^2. With lag^2 = h/g
    the filter corrects that.
    """
    keep = math.exp(-1 / (rate * lag))

    def once(one: Array) -> Array:
        return np.asarray(lfilter([1 - keep], [1, -keep], one, zi=[keep * one[0]])[0])

    return once(once(values)[::-1])[::-1]


def _steered(run: RunData, trial: TrialData) -> Iterator[Mapping[str, Any]]:
    for event in run.events:
        if event.kind == "steered" and trial.t[0] - 1e-6 <= event.t <= trial.t[-1] + 1e-2:
            yield event.data


def _wanted(one: Course) -> dict[str, Array]:
    """Pressures that the law wanted at each sample [Pa], as `wanted_1` and so on; NaN before the first."""
    rows = [row[:4] for data in _steered(one.run, one.trial) for row in data["aims"]]
    aims = np.array([[-np.inf, *(np.nan for _ in MUSCLES)], *rows], dtype=np.float64)
    place = np.searchsorted(aims[:, 0], one.trial.t + 1e-9, side="right") - 1
    return {f"wanted_{i}": aims[place, i] for i in (1, 2, 3)}


KIND = "platform-step"
PEAK = 3.0
"""Standard deviations by which the maximum of many smoothed samples may be too high."""
THINNED = 100.0
"""Samples a second of a figure [Hz]."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """t_1 [s], OS_q [rad], e_q [rad] and n_v [Hz] of each attitude and chain.

    t_1 is withheld where a trial did not settle in the first half of its hold.
    """
    chains = sorted({str(settings_of(run).get("chain", "")) for run in runs})
    if len(chains) > 1:
        raise UsageError(
            f"runs with the chains {' and '.join(chains)} are no repeats of each other: process each by itself, then "
            "compare the two analyses"
        )
    result = Reduction.of(KIND, RESULTS, runs, options, lambda run, trial, _: course_of(run, trial))
    cells = grouped(result.measured, lambda one: (str(one.law["chain"]), round(one.goal[0], 9), round(one.goal[1], 9)))
    for (chain, phi, psi), members in cells.items():
        at = {"phi": phi, "psi": psi}
        result.estimates += _estimates(f"chain {chain}", at, members, result.measured, result.scales)
        result.traces.append(_trace(chain, members[-1]))
    result.doubt_dropped()
    for one in (one for one in result.measured if one.law["saturated"] > 0):
        share = show(float(one.law["saturated"]), "ratio", 2)
        text = f"{one.trial.name}: in {share} of the periods limits of pressures forbade the wanted moment"
        result.findings.append(Finding("note", text))
    result.note_lack((), ACCELERATIONS[:2])
    return result.analysis()


def _estimates(
    method: str, at: Mapping[str, float], members: Sequence[Course], courses: Sequence[Course], scales: Scales
) -> Iterator[Estimate]:
    """All estimates of one cell; errors of the accelerometer come from all `courses`, which share it."""
    others = [[course_of(one.run, one.trial, way * KNOWN * _height(one.run)) for one in members] for way in (-1, 1)]
    elsewhere = _elsewhere(courses)
    offset, gain = (max(of.get(name, 0.0) for name in ACCELERATIONS) for of in (scales.offsets, scales.gains))
    noise, size, offset = max(one.noise for one in members), math.hypot(*at.values()), offset / G
    # what is declared for the accelerometer is no reason to withhold
    attitude = replace(_attitude(courses), most=MOST_HIDDEN + math.hypot(offset, gain * size) / size)
    wobble = max(map(_wobble, courses))
    names = tuple(one.trial.name for one in members)

    def made(
        symbol: str, kind: tuple[str, str], values: Sequence[float], extra: float, known: float | None
    ) -> Estimate:
        once = "one trial: how far another one would be off is not known"
        return mean_of_trials(symbol, kind, method, at, names, values, extra, known, once)

    times, by_height, by_band, why = _time(members, others, math.hypot(offset, attitude.half, wobble))
    t_1 = made("t_1", ("s", "time"), times, by_height, by_band)
    why = elsewhere or why
    if not why and t_1.value is not None and attitude.seen and attitude.half > attitude.most * size:
        why = attitude.reason
    yield withhold(t_1, why) if why else weighed(t_1, [_between_axes(courses)])
    pairs = [(one, other) for several in others for one, other in zip(members, several, strict=True)]
    shape = math.hypot(max(abs(other.overshoot - one.overshoot) for one, other in pairs), PEAK * noise, wobble)
    OS_q = made("OS_q", ("rad", "angle"), [one.overshoot for one in members], shape, offset or None)
    yield withhold(OS_q, elsewhere) if elsewhere else weighed(OS_q, [attitude], size)
    misses = [math.hypot(*one.ends()) for one in members]
    drifts = max(math.dist(one.ends(LAST, 0.5 * LAST), one.ends(0.5 * LAST)) / 2 for one in members)
    e_q = made("e_q", ("rad", "angle"), misses, math.hypot(drifts, noise, wobble), offset or None)
    yield weighed(e_q, [attitude], size)
    busiest = [max(one.openings().values()) for one in members]
    yield made("n_v", ("Hz", "frequency"), busiest, max(1 / one.hold for one in members), 0.0)


def _time(
    members: Sequence[Course], others: Sequence[Sequence[Course]], offset: float
) -> tuple[list[float], float, float | None, str]:
    """Times to stay within 1 deg, their method and calibration part, and the reason if there is none.

    The interval includes the times for a band that is narrower and wider by the attitude's uncertainty.
    """

    def times(courses: Sequence[Course], sign: int = 0) -> dict[str, float | None]:
        return {one.trial.name: one.settled(BAND + sign * math.hypot(offset, 2 * one.noise)) for one in courses}

    now, bands, heights = times(members), [times(members, sign) for sign in (-1, 1)], [*map(times, others)]
    known = [time for time in now.values() if time is not None]
    if len(known) < len(members):
        many = f"{len(members) - len(known)} of {len(members)} trials"
        return known or [math.inf], 0.0, None, f"{many} did not stay within 1 deg in the second half of the hold"
    if any(time is None for ends in (*bands, *heights) for time in ends.values()):
        why = "whether it settles depends on how well the attitude is known: it ends near 1 deg off"
        return known, 0.0, None, why
    by_band, by_height = (max(changes(now, *ends).values()) for ends in (bands, heights))
    return known, by_height + 0.5 / members[0].run.rate, by_band, ""


def _trace(chain: str, one: Course) -> Trace:
    """The whole of one trial, thinned."""
    stride = max(1, round(one.run.rate / THINNED))
    reference = _reference(one)
    angles = {"phi": one.phi, "psi": one.psi, "reference_phi": reference[0], "reference_psi": reference[1]}
    pressures = {name: np.asarray(one.trial.channels[name]) for name in MUSCLES} | _wanted(one)
    thin = {name: values[::stride] for name, values in ({"t": one.t} | angles | pressures).items()}
    quantities = {"t": "time", **dict.fromkeys(angles, "angle"), **dict.fromkeys(pressures, "pressure")}
    phi, psi = (show(angle, "angle", 4) for angle in one.goal)
    marks = {"phi": one.goal[0], "psi": one.goal[1], "hold": one.hold}
    name = f"attitude-{chain}-{one.trial.number}"
    return Trace(name, "attitude", f"To phi {phi}, psi {psi}, chain {chain}", thin, quantities, marks)


def _reference(one: Course) -> Array:
    """Reference of the attitude at each sample: the goals after the law's two lags; shape (2, n) [rad]."""
    lags = Lags(float(one.law["reference_lag"]), (float(one.phi[0]), float(one.psi[0])))
    goals = [(float(begin), (float(phi), float(psi))) for begin, phi, psi in one.law["goals"]]
    start = float(one.law["t0"])
    rows = []
    for t, h in zip(one.trial.t, np.diff(one.trial.t, prepend=one.trial.t[0]), strict=True):
        goal = next((at for begin, at in reversed(goals) if t - start >= begin - 1e-9), goals[0][1])
        rows.append(lags.update(float(h), goal))
    return np.array(rows).T


COLUMNS, MOST = 3, 6
UPPER, LOWER = 120.0, 90.0
SHOWN = ("t", "phi", "psi", "reference_phi", "reference_psi", *MUSCLES, "wanted_1", "wanted_2", "wanted_3")


@of_some("Attitude of the platform", MOST, *SHOWN, columns=SHOWN[:8])
def attitudes(traces: Sequence[Trace]) -> Drawn:
    """One trial of each attitude and chain."""
    caption = (
        "Above: attitude from the accelerometer without what its height adds, and the reference that it is to follow "
        "(dashed). Below: pressures of muscles 1 to 3, and what was wanted (dashed). The step is at 0 s."
    )
    return small_multiples(list(map(_charts, traces)), COLUMNS, width=PAGE), caption


def _charts(trace: Trace) -> list[Chart]:
    """Attitude, and pressures below, of one trial."""
    t = label(trace, "t")
    angles = [(axis, axis, color, False) for axis, color in (("phi", BLUE), ("psi", BROWN))]
    angles += [("reference" if axis == "phi" else "", f"reference_{axis}", INK, True) for axis in ("phi", "psi")]
    pressures = []
    for n, (name, color) in enumerate(zip(MUSCLES, PALETTE[2:], strict=False), start=1):
        pressures += [(f"muscle {n}", name, color, False), ("", f"wanted_{n}", color, True)]
    upper, lower = (
        [curve(trace, "t", name, word, color, width=0.8, dashed=dashed) for word, name, color, dashed in lines]
        for lines in (angles, pressures)
    )
    return [
        Chart(t, "phi, psi [deg]", upper, height=UPPER, title=head(trace), legend=True),
        Chart(t, "pressure [kPa]", lower, height=LOWER, legend=True, y_ticks=4),
    ]
