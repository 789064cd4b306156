"""Reduction of torques at locked angles: maps of torque and stiffness, each value with an interval.

A torque whose zero drifts, and planes over the pressures at each angle; all trials of a pair of pressures; the figure.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import hypot, sqrt
from typing import Any

import numpy as np

from pmabench.analysis.shared import joint, student
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.joint import BY_PRESSURE, CUT, MUSCLES, STIFFNESS, TORQUE
from pmabench.analysis.shared.samples import Left, lag_open, left
from pmabench.analysis.shared.trials import Reduction, grouped
from pmabench.base.quantities import show
from pmabench.kinds.joint_torque import RESULTS
from pmabench.kinds.joint_torque.staircase import ORDERS, ROUNDED, Staircase, ramps_of, staircase_of
from pmabench.plotting.chart import PALETTE, ZERO, Chart, small_multiples
from pmabench.plotting.pictures import Picture, curve, has, label, of_traces, spread, unit_of
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import Array, RunData, TrialData

DRIFT = "drift of the torque"
SURE = 0.9995
"""Probability of Student's t beyond which a common change of the torque from cycle to cycle is significant."""
UNSEEN = 0.995
"""The same for what could hide, as all torques near the end of a run hold it alike."""
FEWEST_TRIALS = 4
JUMPS, LEAST_JUMP = 8.0, 5e-3
"""A jump between two cycles of a trial in usual differences between them, and as a share of the largest torque."""
LASTING = 0.15
"""Largest relative difference of that change between both halves of a cycle for which it counts as a drift."""


def _by_cycle(one: Staircase) -> Array:
    """Rate of change of the torque from cycle to cycle, at angles reached from below and from above [N m/s]."""
    torques = one.rests.torques
    lasts = float(np.ptp(one.trial.t)) / len(torques)
    return np.asarray(np.median((torques[-1] - torques[0]) / (len(torques) - 1), axis=1) / lasts)


@dataclass(frozen=True)
class Drift:
    """Drift of the torque's zero: the same change from cycle to cycle in all trials, which also acts between them."""

    rate: float
    """[N m/s]; 0 if not significant."""
    unseen: float
    """Drift that the cycles do not show [N m/s]."""
    since: Mapping[str, float]
    """Name of a trial -> time from the start of its run [s]."""

    @classmethod
    def of(cls, members: Sequence[Staircase]) -> Drift:
        """From all trials; creep after the move to the first angle slows down, a drift of the zero does not."""
        begins = {one.run.id: one.run.trials[0].t[0] for one in members}
        since = {one.trial.name: float(one.trial.t.mean() - begins[one.run.id]) for one in members}
        each = np.array([_by_cycle(one) for one in members]).reshape(-1, 2)
        (rising, falling), n = each.mean(axis=0) if len(each) else (0.0, 0.0), len(each)
        rate, rates = 0.5 * float(rising + falling), each.mean(axis=1)
        lasting = abs(rising - falling) < LASTING * abs(rate)
        error = float(rates.std(ddof=1)) / sqrt(n) if n > 1 else 0.0
        if n < FEWEST_TRIALS or not lasting or abs(rate) < student.ppf(SURE, n - 1) * error:
            most = abs(rate) + student.ppf(UNSEEN, n - 1) * error if n > 1 else 0.0
            return cls(0.0, float(most), since)
        return cls(rate, 0.0, since)

    def by(self, e: Estimate) -> float:
        """Its effect on a torque [N m]."""
        return (self.rate or self.unseen * (e.n == 1)) * float(np.mean([self.since[name] for name in e.trials]))

    def weigh(self, e: Estimate, half: float, scale: float | None = None) -> Estimate:
        """The estimate, widened or withheld for `half`, the effect of the drift on it.

        Where no trial at its pressures is repeated, the scatter does not hold a drift that the cycles do not show.
        """
        if self.rate == 0:
            return weighed(e, [Doubt(DRIFT, "drift", abs(half), False)], scale) if half else e
        return weighed(e, [Doubt(DRIFT, "drift", abs(half), True, self.reason)], scale)

    @property
    def reason(self) -> str:
        """The sentence about a significant drift."""
        whole = show(abs(self.rate) * max(self.since.values()), "torque", 2)
        return (
            f"from cycle to cycle the torque changes alike in all trials, by {whole} from the first to the last if it "
            "goes on: its zero drifts. Take the zero again before each trial, or let the cell warm up"
        )


@dataclass(frozen=True)
class Jump:
    """The largest change of the torque between two cycles of one trial that no other trial has, and that trial."""

    size: float
    """[N m]"""
    trial: TrialData

    @classmethod
    def of(cls, members: Sequence[Staircase]) -> Jump | None:
        """From all trials; None without one."""
        each = [np.abs(one.rests.torques[-1] - one.rests.torques[0]) for one in members]
        if len(each) < FEWEST_TRIALS:
            return None
        sizes, usual = [float(one.max()) for one in each], float(np.median(np.concatenate([e.ravel() for e in each])))
        worst, largest = int(np.argmax(sizes)), max(float(np.abs(one.mean).max()) for one in members)
        is_one = sizes[worst] > max(JUMPS * usual / 0.6745, LEAST_JUMP * largest)
        return cls(sizes[worst], members[worst].trial) if is_one else None

    @property
    def reason(self) -> str:
        """The sentence about it."""
        return (
            f"within trial {self.trial.number} the torque jumps by {show(self.size, 'torque', 2)} between two cycles: "
            "the zero of its cell, or a mount that slipped. Whether trials before or after it are right is not known. "
            "Look for the cause, and measure again"
        )

    def weigh(self, e: Estimate, largest: float, step: float) -> Estimate:
        """The estimate, widened or withheld; `largest` torque [N m], `step` of the angles [rad]."""
        here = self.trial.name in e.trials
        half = {"tau": self.size, "H_tau": self.size * here, "K_th": self.size / step * here}.get(e.symbol, 0.0)
        return weighed(e, [Doubt("jump of the torque", "drift", half, True, self.reason)], largest if half else None)


LEVELS = 3
"""Fewest levels of each pressure: with two, any torque fits a plane, even with a slack muscle."""
FEWEST = 5
"""Fewest pairs of pressures, two more than the plane has terms."""
OFF = 2.0
"""Largest distance of a torque from the plane, in half widths of its interval."""
COEFFICIENTS = (
    ("tau_0", "N.m", "torque", 1.0),
    ("s_1", "N.m/Pa", "torque per pressure", 1.0),
    ("s_2", "N.m/Pa", "torque per pressure", -1.0),
)


def plane_estimates(torques: Sequence[Estimate], scales: Scales, drift: Drift) -> Iterator[Estimate]:
    """tau_0 [N m], s_1 and s_2 [N m/Pa] of tau = tau_0 + s_1 P_1 - s_2 P_2 at each angle with pairs enough.

    With muscles whose force is S P + F_e these are R S_1, R S_2 and R (F_e1 - F_e2). Intervals: the wider of the
    scatter about the plane and of the torques' own intervals, and the gains of the scales.
    """
    planes, scale = [], np.array([1.0, 1e5, 1e5])
    for angle in sorted({e.at["angle"] for e in torques}):
        rows = [e for e in torques if e.at["angle"] == angle and e.value is not None]
        design = np.array([[1.0, *(e.at[name] for name in MUSCLES)] for e in rows]).reshape(-1, 3)
        levels = min(len({e.at[name] for e in rows}) for name in MUSCLES)
        if len(rows) >= FEWEST and levels >= LEVELS and np.linalg.matrix_rank(design / scale) == 3:
            planes.append((angle, rows, design, np.linalg.pinv(design / scale) / scale[:, None]))
    terms = np.array([inverse @ [e.value for e in rows] for _, rows, _, inverse in planes])
    over = np.gradient(terms, [angle for angle, *_ in planes], axis=0) if len(planes) > 1 else np.zeros_like(terms)
    for (angle, rows, design, inverse), by_angle in zip(planes, over, strict=True):
        yield from _plane(angle, rows, design, inverse, by_angle, scales, drift)


def _plane(
    angle: float, rows: Sequence[Estimate], design: Array, inverse: Array, by_angle: Array, scales: Scales, drift: Drift
) -> Iterator[Estimate]:
    """The terms at one angle; `by_angle`, shape (3,), is their change with it."""
    tau = np.array([e.value for e in rows])
    own = np.array([replace(e.parts, calibration=None).combined or 0.0 for e in rows])
    terms = inverse @ tau
    residual = tau - design @ terms
    freedom = len(rows) - 3
    spread = float(student.ppf(0.975, freedom)) * float(np.sqrt(residual @ residual / freedom))
    worst = int(np.argmax(np.abs(residual) - OFF * own))
    why = ""
    if abs(residual[worst]) > OFF * own[worst]:
        where = " and ".join(show(rows[worst].at[name], "pressure") for name in MUSCLES)
        off, half = (show(float(value), "torque", 2) for value in (abs(residual[worst]), own[worst]))
        why = (
            f"the torque at {where} is {off} off a plane over the pressures, "
            f"and known to {half}: a muscle is slack, or not linear in its pressure"
        )
    trials = tuple(name for e in rows for name in e.trials)
    for (symbol, unit, quantity, sign), term, row, over in zip(COEFFICIENTS, terms, inverse, by_angle, strict=True):
        repeats = max(spread * float(np.linalg.norm(row)), float(np.linalg.norm(row * own)))
        value = sign * float(term)
        gains = {"torque": value} | ({} if symbol == "tau_0" else {f"pressure_{symbol[-1]}": value})
        offsets = dict(zip(("torque", *MUSCLES), (1.0, *terms[1:].tolist()), strict=True)) if symbol == "tau_0" else {}
        offsets["angle"], gains["angle"] = float(over), float(over) * angle
        parts = Parts(repeats, None, scales.part(gains, offsets))
        one = Estimate(symbol, value, unit, quantity, "plane", {"angle": angle}, parts, len(rows), trials=trials)
        drifted = float(row @ [drift.by(e) for e in rows])
        scale = float(np.abs(tau).max()) if symbol == "tau_0" else None
        yield withhold(one, why) if why else drift.weigh(one, drifted, scale)


KIND = "joint-torque"
SIDES, GAP, SLOPE = "both sides", "gap", "polynomial"
LIKELY = 0.2
"""Share of the largest possible motion above which the likeliest motion counts as significant."""
ON = 3.0
"""Factor on the creep of a rest for the length of a trial, since creep goes with the logarithm of time."""
LOOSE = 0.01
"""Difference of the angle between both sides that is tolerated, as a share of the distance between angles."""
Cells = dict[tuple[float, ...], list[Staircase]]


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Torque tau [N m] at each angle and pair of pressures, stiffness K_th [N m/rad], gap H_tau [N m].

    With three levels of each pressure and five pairs or more, also torque by pressure s_1, s_2 [N m/Pa] and tau_0 [N m]
    at each angle. `options`: `angles` [rad], in place of the plan's.
    """
    result = Reduction.of(KIND, RESULTS, runs, options, staircase_of)
    result.measured = staircases = _with_flanks(result.measured)
    scales = result.scales
    cells: Cells = grouped(staircases, lambda one: tuple(round(one.trial.point[name], 3) for name in MUSCLES))
    estimates = list[Estimate]()
    # change of the torque after the mean of a rest [N.m], rising and falling: mean of all rests of all trials
    rests = [[held for one in staircases for held in one.rests.holds[side]] for side in (0, 1)]
    rising, falling = (left(holds) if rests[0] else Left(0.0, 0.0, False) for holds in rests)
    for pressures, members in sorted(cells.items()):
        estimates += _estimates(dict(zip(MUSCLES, pressures, strict=True)), members, scales, (rising, falling))
    estimates = _pooled(estimates, min((len(one.gap) for one in staircases), default=1))
    drift, torques = Drift.of(staircases), [e for e in estimates if e.symbol == "tau"]
    planes = list(plane_estimates(torques, scales, drift))
    largest = max((abs(e.value) for e in torques if e.value is not None), default=0.0)
    estimates = [drift.weigh(e, drift.by(e), largest) if e.symbol == "tau" else e for e in estimates] + planes
    result.findings += [Finding("doubt", drift.reason)] if drift.rate else []
    if jump := Jump.of(staircases):
        step = float(np.diff(staircases[0].nominal).min())
        estimates = [jump.weigh(e, largest, step) for e in estimates]
        result.findings.append(Finding("doubt", jump.reason))
    result.estimates, result.traces = estimates, list(_map(cells, estimates))
    result.doubt_dropped()
    result.findings += joint.findings(runs, [(one.trial.point, one.kept) for one in staircases], scales, estimates)
    return result.analysis()


SHOWN = 1 / 3
"""Share of the trials that must show a step of the torque at its change of sign, to attribute it to the bench."""


def _with_flanks(staircases: Sequence[Staircase]) -> list[Staircase]:
    """The trials with the largest step of all, if enough of them show one; in others the sign may change near an end
    only.
    """
    most = max((one.flank for one in staircases), default=0.0)
    if sum(one.flank > 0 for one in staircases) <= SHOWN * len(staircases):
        return list(staircases)
    return [replace(one, flank=most) for one in staircases]


def gap_of(run: RunData, trial: TrialData) -> float:
    """Gap of one trial [N m]; raises `NotUsable`."""
    return float(_gap(staircase_of(run, trial, {})).mean())


def _gap(one: Staircase) -> Array:
    """The gap at the angle farthest from both turns [N m], shape (cycles,)."""
    middle = 0.5 * (one.trial.point["lowest_angle"] + one.trial.point["highest_angle"])
    return np.asarray(one.gap[:, int(np.argmin(np.abs(one.nominal - middle)))])


def _near_a_turn(members: Sequence[Staircase]) -> str:
    """Reason why there is no torque at an angle near a turn."""
    w = max(one.turns.w for one in members if one.turns is not None)
    near = f"a turn fades on {show(w, 'angle', 3)}, and this angle is within 3 times that of one"
    return f"{near}: give an overrun of at least {show(CUT * w, 'angle', 3)}"


def _estimates(
    at: Mapping[str, float], members: Sequence[Staircase], scales: Scales, moving: tuple[Left, Left]
) -> Iterator[Estimate]:
    """All estimates at one pair of pressures; a wrong pressure changes the torque."""
    made = partial(
        joint.estimate, trials=tuple(one.trial.name for one in members), kept=[one.kept for one in members],
        scales=scales,
    )  # fmt: skip
    total, nominal = max(sum(at.values()), 1.0), members[0].nominal
    likely = max(float(np.max(np.abs(np.diff(m.mean.mean(axis=0)) / np.diff(m.angles)))) for m in members)
    whole = max(float(np.abs(m.mean).max()) for m in members) + likely * float(np.ptp(nominal))
    opened = np.all([one.open for one in members], axis=0)
    of_gap, of_torque, of_slope = _doubts(members, likely, whole / total, moving)
    # half the range of the gap over the angles [N.m]
    uneven = max(0.5 * float(np.ptp(one.gap.mean(axis=0)[opened])) for one in members)
    yield weighed(made("H_tau", TORQUE, GAP, [_gap(one) for one in members], uneven, at), of_gap)
    slack = next((one.slack for one in members if one.slack), "")
    why = next((one.why_no_stiffness for one in members if one.why_no_stiffness), "")
    slopes = [] if why else [(one.stiffness(), one.stiffness(ORDERS[1]).mean(axis=0)) for one in members]
    for n, angle in enumerate(nominal.tolist()):
        where = {**at, "angle": round(angle, 9)}
        left = max(abs(float(one.left[n])) for one in members)
        misplaced = likely * max(abs(float(one.angles[n]) - angle) for one in members)
        one = made("tau", TORQUE, SIDES, [m.mean[:, n] for m in members], hypot(left, misplaced), where,
                   by_pressure=whole / total, by_angle=likely, by_gain=likely * abs(angle))  # fmt: skip
        lacks = slack if opened[n] else _near_a_turn(members)
        yield withhold(one, lacks) if lacks else weighed(one, of_torque, whole)
        if not why and opened[n]:
            place = int(opened[:n].sum())
            other = max(abs(float(K[:, place].mean() - K3[place])) for K, K3 in slopes)
            values = [K[:, place] for K, _ in slopes]
            # largest change of the stiffness with the angle [N.m/rad2]
            bend = float(np.max(np.abs(np.diff(slopes[0][0].mean(axis=0)) / np.diff(nominal[opened])), initial=0.0))
            K = made("K_th", STIFFNESS, SLOPE, values, other, where, by_pressure=BY_PRESSURE * likely / total,
                     by_angle=bend, by_gain=float(values[0].mean()))  # fmt: skip
            still = replace(of_slope, half=of_slope.half * abs(K.value or 0.0))
            yield weighed(K, [still, *_of_stiffness(members, K, place, bend)])
    if why:
        middle = {**at, "angle": round(float(np.median(nominal)), 9)}
        yield withhold(made("K_th", STIFFNESS, SLOPE, [np.zeros(2)], 0.0, middle), why)


def _of_stiffness(members: Sequence[Staircase], K: Estimate, place: int, bend: float) -> list[Doubt]:
    """Effects of angles, steps and backlash on a stiffness at an open angle; `bend` is its derivative by angle [N
    m/rad2].
    """
    kept = [one.kept for one in members]
    return [
        joint.way(kept, K.value or 0.0),
        joint.place(kept, K.at["angle"], bend),
        Doubt("steps of the torque", "method", max(float(m.rounded[place]) for m in members), False),
        Doubt("play", "method", max(float(m.held_back[place]) for m in members), False),
        Doubt("play under the torque", "method", max(m.flatter for m in members), False),
    ]


def _doubts(
    members: Sequence[Staircase], likely: float, per_torque: float, moving: tuple[Left, Left]
) -> tuple[list[Doubt], list[Doubt], Doubt]:
    """Effects of motion at rest, backlash and wrong places: on the gap, on a torque [N m], on the stiffness (relative)
    [1].

    `likely` is the stiffness [N m/rad], `per_torque` the derivative of the torque by pressure [N m/Pa], `moving` the
    change of the torque still to come after a rest, rising and falling.
    """
    rising, falling = moving
    moves = any(one.seen and abs(one.size) > LIKELY * one.most for one in moving)
    worst = show(max(abs(rising.size), abs(falling.size)), "torque", 2)
    step = likely * float(np.median(np.diff(members[0].nominal)))
    still = f"the torque is not at rest: about {worst} are still to come at the end of a rest. Rest longer"
    sides = np.mean([np.diff(one.rests.pressures.mean(axis=(1, 3)), axis=1)[:, 0] for one in members], axis=0)
    scatter = max(float(one.rests.pressures.std(axis=(1, 3)).max()) for one in members)
    pressures = f"the pressures differ by {show(float(np.abs(sides).max()), 'pressure', 2)} between both sides"
    given = per_torque * float(np.abs(sides).sum())
    loose = max(float(np.abs(one.apart).max()) for one in members)
    shown = loose > LOOSE * float(np.diff(members[0].nominal).min())
    places = f"the angle differs by {show(loose, 'angle', 2)} between both sides: the encoder or a coupling is loose"
    play = max(0.0, float(np.mean([one.after.play if one.after else 0.0 for one in members])))
    filtered = max(2 * lag_open(one.run, "torque") * float(ramps_of(one.trial)[0].data["rate"]) for one in members)
    behind = (
        f"after a turn the torque does not change yet over {show(play, 'angle', 2)}: play between the encoder and the "
        "joint, which makes the gap smaller, or a filter of the torque. Look for play, and declare the `sensor_lag`"
    )
    read = ROUNDED * max(one.rests.step for one in members)
    gap = [
        Doubt("steps of the torque", "method", 2 * read, False),
        Doubt("play under the torque", "method", 2 * max(one.flank for one in members), False),
        Doubt("play", "method", likely * play, play > filtered, behind),
        Doubt("torque at rest", "method", ON * (rising.most + falling.most), moves, still),
        Doubt("pressures of both sides", "method", given, given > scatter * per_torque, f"{pressures}. Rest longer"),
        Doubt("angle of both sides", "method", likely * loose, shown, places),
    ]
    torque = [
        Doubt("steps of the torque", "method", read, False),
        Doubt("torque at rest", "method", 0.5 * (rising.most + falling.most), moves, still),
        Doubt("angle of both sides", "method", 0.5 * likely * loose, shown),  # side of the zero is unknown
    ]
    return gap, torque, Doubt("torque at rest", "method", ON * max(rising.most, falling.most) / step, moves, still)


def _pooled(estimates: Sequence[Estimate], cycles: int) -> list[Estimate]:
    """The estimates with repeats parts not smaller than by the pooled scatter of all pairs of pressures and angles.

    The scatter of two trials may be small by chance. Where no pair was repeated, the scatter of the `cycles` is pooled.
    """
    known = [e for e in estimates if e.value is not None and e.parts.repeats is not None]
    least = {}
    for symbol, group in grouped(known, lambda e: e.symbol).items():
        several = [e for e in group if e.n > 1] or group
        freedom = np.array([e.n - 1 if e.n > 1 else cycles - 1 for e in several])
        if freedom.sum() > 0:
            halves, n = (np.array(column) for column in zip(*((e.parts.repeats, e.n) for e in several), strict=True))
            deviations = halves * np.sqrt(n) / student.ppf(0.975, freedom)
            together = np.sqrt(np.average(deviations**2, weights=freedom))
            least[symbol] = float(together * student.ppf(0.975, float(freedom.sum())))

    def widened(e: Estimate) -> Estimate:
        repeats = max(e.parts.repeats or 0.0, least.get(e.symbol, 0.0) / sqrt(e.n))
        return e if e.parts.repeats is None else replace(e, parts=replace(e.parts, repeats=repeats))

    return list(map(widened, estimates))


def _map(cells: Cells, estimates: Sequence[Estimate]) -> Iterator[Trace]:
    """Torque and stiffness over the angles, columns for each pair of pressures; a map for each set of angles."""
    sets = grouped(sorted(cells), lambda pressures: tuple(cells[pressures][0].nominal))
    for number, (angles, pairs) in enumerate(sets.items(), start=1):
        columns, quantities = {"angle": np.array(angles)}, {"angle": "angle"}
        for pressures in pairs:
            held = dict(zip(MUSCLES, pressures, strict=True))
            mine = [e for e in estimates if e.value is not None and held.items() <= e.at.items()]
            for name, symbol, quantity in (("torque", "tau", "torque"), ("stiffness", "K_th", "torsional stiffness")):
                values = {e.at["angle"]: e.value for e in mine if e.symbol == symbol}
                column = f"{name} at {' and '.join(show(P, 'pressure') for P in pressures)}"
                columns[column] = np.array([values.get(round(angle, 9), np.nan) for angle in angles])
                quantities[column] = quantity
        title = "Torque and stiffness over angle, by the pressures of muscle 1 and muscle 2"
        yield Trace(f"joint-map-{number}", "joint-map", title, columns, quantities)


MOST = 6
"""Most pairs of pressures in the figure."""


def maps(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Torque above, stiffness below, a line for each pair of pressures."""
    found = []
    for trace in traces:
        names = [name.removeprefix("torque at ") for name in trace.columns if name.startswith("torque at ")]
        able = [name for name in names if has(trace, f"torque at {name}")]
        if not able:
            continue
        chosen = spread(able, MOST)
        labels = [unit_of(trace, f"{what} at {chosen[0]}").label(what) for what in ("torque", "stiffness")]
        torque, stiffness = (
            [
                curve(trace, "angle", f"{what} at {name}", said, PALETTE[n % len(PALETTE)])
                for n, name in enumerate(chosen)
                for said in [name.replace(" kPa and ", ", ") if what == "torque" else ""]
            ]
            for what in ("torque", "stiffness")
        )
        upper = Chart(label(trace, "angle"), labels[0], torque, height=150.0)
        lower = Chart(label(trace, "angle"), labels[1], stiffness, height=96.0, levels=(ZERO,), y_ticks=3)
        rows = small_multiples([(upper, lower)], 1)
        caption = (
            "Above the torque that the joint holds at each angle, the mean of both sides; below its stiffness, minus "
            "the slope of that torque. A line for each pair of pressures of muscle 1 and muscle 2."
        )
        caption += f" {len(chosen)} of {len(able)} are shown." if len(chosen) < len(able) else ""
        found.append(of_traces(rows, "Torque and stiffness over angle", caption, analysis, [trace]))
    return found
