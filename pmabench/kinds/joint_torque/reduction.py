"""From torques at locked angles to maps of torque and stiffness, each value with an interval."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import skew, student
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.lines import mean_of_cycles
from pmabench.analysis.shared.ramp_loop import AXES, BY_PRESSURE, CUT, MUSCLES, Turns, on_grid, refuse_turns, turns_of
from pmabench.analysis.shared.samples import (
    Held,
    Left,
    NotUsable,
    ends,
    left,
    noise_of,
    on_time,
    refuse_unusable,
    settings_of,
)
from pmabench.analysis.shared.trials import grouped, measured_trials
from pmabench.base.quantities import show
from pmabench.kinds.joint_torque import RESULTS
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import Array, Command, RunData, TrialData

POINTS = 81
"""Points of the gap that show how a turn fades."""
FEWEST_ANGLES = 7
"""Angles that a stiffness needs: its slope is that of a polynomial of order 5."""
ORDERS = 5, 3
"""Of the polynomial of torque over angle, and of the one that shows what the choice of an order changes."""
UNEVEN = 0.25
"""A gap that changes by a larger share over the angles is not that of two taut muscles at all of them."""
LEAST_SAMPLES = 10
ELSEWHERE, ASIDE = 0.25, 0.02
"""Shares of the way between angles by which the joint may be off its place, and from which on that is said."""
SKIPPED = 0.25
"""Share of a rest after which the torque is to be still: before it regulators and muscles come to rest."""


@dataclass(frozen=True, eq=False)
class Rests:
    """The later half of each rest; arrays of shape (cycles, 2, n), rising first."""

    angles: Array
    """[rad]."""
    torques: Array
    """[N m]."""
    pressures: Array
    """[Pa], shape (2, cycles, 2, n)."""
    holds: tuple[list[Held], list[Held]]
    """Torque along each rest, rising and falling [N m]."""
    noise: float
    """Of a torque [N m]."""


@dataclass(frozen=True, eq=False)
class Staircase:
    """One usable trial; angles [rad] of shape (n,), torques [N m] of shape (cycles, n)."""

    run: RunData
    trial: TrialData
    angles: Array
    """Where the joint was, as measured: means of all cycles."""
    nominal: Array
    """Where it was to be."""
    rising: Array
    falling: Array
    turns: Turns | None
    open: NDArray[np.bool_]
    """True where both turns are far enough away."""
    pressures: Array
    """Mean pressures of both muscles as measured [Pa], shape (2,)."""
    noise: float
    """Of the torque [N m]."""
    rests: Rests

    @cached_property
    def gap(self) -> Array:
        """Torque while falling minus torque while rising [N m], shape (cycles, n)."""
        return np.asarray(self.falling - self.rising)

    @cached_property
    def left(self) -> Array:
        """What the turns leave in the mean of both sides [N m], shape (n,)."""
        return np.zeros_like(self.angles) if self.turns is None else self.turns.of_mean(self.angles)

    @property
    def apart(self) -> Array:
        """Angle when it was reached from above minus that from below [rad], shape (n,)."""
        return np.asarray(np.diff(self.rests.angles.mean(axis=0), axis=0)[0])

    @property
    def scale(self) -> float:
        """Angle measured over angle commanded, less 1."""
        off = self.nominal - self.nominal.mean()
        return float(off @ (self.angles - self.nominal) / (off @ off))

    @cached_property
    def mean(self) -> Array:
        """Torque without hysteresis [N m], shape (cycles, n)."""
        return np.asarray(0.5 * (self.falling + self.rising) - self.left)

    @cached_property
    def why_no_stiffness(self) -> str:
        """Why there is no slope of torque over angle; empty where there is one."""
        if self.open.sum() < FEWEST_ANGLES:
            return f"{self.open.sum()} angles are far enough from the turns, and a slope needs {FEWEST_ANGLES}"
        return self.slack

    @cached_property
    def slack(self) -> str:
        """What the gap says of a slack muscle; empty where it says nothing.

        A muscle that pulls on one of the two ways only makes a smaller gap, and the mean is not free of hysteresis.
        """
        gap = self.gap.mean(axis=0)[self.open]
        if np.ptp(gap) > UNEVEN * np.median(gap) + 4 * self.noise:
            ends = " to ".join(show(float(end), "torque", 3) for end in (gap.min(), gap.max()))
            return f"the gap between both sides is {ends}: a muscle is slack at some of the angles"
        return ""

    def stiffness(self, order: int = ORDERS[0]) -> Array:
        """Minus the slope of a polynomial of torque over angle [N m/rad], at open angles; shape (cycles, open)."""
        x = self.angles[self.open]
        terms = np.polyfit(x - x.mean(), self.mean[:, self.open].T, order)
        powers = np.arange(order, 0, -1)
        return np.asarray([-np.polyval(column[:-1] * powers, x - x.mean()) for column in terms.T])


def staircase_of(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Staircase:
    """One trial measured; raises `NotUsable` with the reason, for angles near the turns with what would be enough."""
    refuse_unusable(trial, "angle", "torque", *MUSCLES)
    nominal = np.array(settings_of(run, options)["angles"], dtype=np.float64)
    angle, torque = on_time(run, trial, "angle"), on_time(run, trial, "torque")
    rests = _rests(trial, nominal, angle, torque)
    elsewhere = _elsewhere(rests.angles, nominal)
    lowest, highest = trial.point["lowest_angle"], trial.point["highest_angle"]
    turns = _turns(trial, angle, torque, lowest, highest)
    way = CUT * turns.w * (1 - 1e-9) if turns is not None else -np.inf
    far = np.asarray((nominal - lowest >= way) & (highest - nominal >= way))
    pressures = np.array([float(np.mean(trial.channels[name][trial.usable])) for name in MUSCLES])
    mean, (rising, falling) = rests.angles.mean(axis=(0, 1)), rests.torques.swapaxes(0, 1)
    found = Staircase(run, trial, mean, nominal, rising, falling, turns, far, pressures, rests.noise, rests)
    try:
        refuse_turns(turns, 0.5 * (highest - lowest), float(np.median(found.gap)), rests.noise)
    except NotUsable as reason:
        raise NotUsable(f"{elsewhere}; {reason}" if elsewhere else str(reason)) from None
    if turns is not None and not found.open.any():
        least = show(CUT * turns.w, "angle", 3)
        raise NotUsable(
            f"a turn fades on {show(turns.w, 'angle', 3)}, and no angle is 3 times that away from both turns: the "
            f"torque there is that of the turns; give an overrun of at least {least}"
        )
    return found


def _rests(trial: TrialData, nominal: Array, angle: Array, torque: Array) -> Rests:
    """Mean angles, torques and pressures of the later half of each rest, and what else the rests say."""
    ramps = _ramps(trial)
    cycles = int(trial.point["cycles"])
    channels = [angle, torque, *(trial.channels[name] for name in MUSCLES)]
    means = np.full((len(channels), cycles, 2, len(nominal)), np.nan)
    holds: tuple[list[Held], list[Held]] = ([], [])
    counts = {"rise": [0] * len(nominal), "fall": [0] * len(nominal)}
    noise = 0.0
    for ramp, after in pairwise(ramps):
        at = np.flatnonzero(np.abs(nominal - ramp.value) < 1e-9)
        if not len(at):
            continue
        begin = ends(ramp)
        late = 0.5 * (begin + after.t)
        rows = (trial.t >= late) & (trial.t < after.t) & trial.usable
        if rows.sum() < LEAST_SAMPLES:
            raise NotUsable(f"fewer than {LEAST_SAMPLES} samples in the later half of a rest")
        cycle, n = counts[ramp.phase][at[0]], int(at[0])
        counts[ramp.phase][n] += 1
        side = 0 if ramp.phase == "rise" else 1
        means[:, cycle, side, n] = [values[rows].mean() for values in channels]
        whole = (trial.t >= begin + SKIPPED * (after.t - begin)) & (trial.t < after.t) & trial.usable
        holds[side].append(Held.of(trial.t[whole], torque[whole], late))
        noise = max(noise, noise_of(torque[rows]) / float(np.sqrt(rows.sum())))
    if not np.isfinite(means).all():
        raise NotUsable("not every angle was reached from both sides in every cycle")
    return Rests(means[0], means[1], means[2:], holds, noise)


def _elsewhere(places: Array, nominal: Array) -> str:
    """Where the joint was not where it was sent, empty where it nearly was; raises `NotUsable` where it was far off."""
    off = np.abs(places - nominal).max(axis=(0, 1))
    worst = int(np.argmax(off))
    share = off[worst] / float(np.diff(nominal).min())
    said = (
        f"the joint was {show(float(off[worst]), 'angle', 3)} off where it was to be at "
        f"{show(float(nominal[worst]), 'angle', 3)}: look at the encoder's zero and sign, and at the drive"
    )
    if share > ELSEWHERE:
        raise NotUsable(said)
    return said if share > ASIDE else ""


def _ramps(trial: TrialData) -> list[Command]:
    return [c for c in trial.commands if c.output == "angle" and c.kind == "ramp" and c.phase in ("rise", "fall")]


def _turns(trial: TrialData, angle: Array, torque: Array, lowest: float, highest: float) -> Turns | None:
    """How a turn fades, from the torque while the joint moves; None where no turns show."""
    moving = {phase: np.zeros(trial.t.shape, bool) for phase in (AXES.rises, AXES.falls)}
    for ramp in _ramps(trial):
        moving[ramp.phase] |= (trial.t >= ramp.t) & (trial.t < ends(ramp)) & trial.usable
    grid = np.linspace(lowest, highest, POINTS)[1:-1]
    up, down = (on_grid(grid, angle[rows], torque[rows]) for rows in moving.values())
    known = np.isfinite(up + down)
    return turns_of(grid[known], (down - up)[known], lowest, highest) if known.sum() > LEAST_SAMPLES else None


LEVELS = 3
"""Of each pressure: with two of them a muscle that is slack at one is not seen, for a plane fits whatever it does."""
FEWEST = 5
"""Pairs of pressures, so that two are left to contradict the plane."""
OFF = 2.0
"""A torque may be off the plane by so many half widths of its interval."""
COEFFICIENTS = (
    ("tau_0", "N.m", "torque", 1.0),
    ("s_1", "N.m/Pa", "torque per pressure", 1.0),
    ("s_2", "N.m/Pa", "torque per pressure", -1.0),
)


def plane_estimates(torques: Sequence[Estimate], scales: Scales) -> Iterator[Estimate]:
    """tau_0 [N m], s_1 and s_2 [N m/Pa] of tau = tau_0 + s_1 P_1 - s_2 P_2 at each angle with pairs enough.

    With muscles whose force is S P + F_e these are R S_1, R S_2 and R (F_e1 - F_e2). Intervals: the wider of the
    scatter about the plane and of the torques' own intervals, and the gains of the scales.
    """
    planes = []
    for angle in sorted({e.at["angle"] for e in torques}):
        rows = [e for e in torques if e.at["angle"] == angle and e.value is not None]
        design = np.array([[1.0, e.at["pressure_1"], e.at["pressure_2"]] for e in rows]).reshape(-1, 3)
        levels = [len({e.at[name] for e in rows}) for name in ("pressure_1", "pressure_2")]
        if len(rows) < FEWEST or min(levels) < LEVELS or np.linalg.matrix_rank(design / [1.0, 1e5, 1e5]) < 3:
            continue
        inverse = np.linalg.pinv(design / np.array([1.0, 1e5, 1e5])) / np.array([[1.0], [1e5], [1e5]])
        planes.append((angle, rows, design, inverse))
    terms = np.array([inverse @ [e.value for e in rows] for _, rows, _, inverse in planes])
    over = np.gradient(terms, [angle for angle, *_ in planes], axis=0) if len(planes) > 1 else np.zeros_like(terms)
    for (angle, rows, design, inverse), by_angle in zip(planes, over, strict=True):
        yield from _plane(angle, rows, design, inverse, by_angle, scales)


def _plane(
    angle: float, rows: Sequence[Estimate], design: Array, inverse: Array, by_angle: Array, scales: Scales
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
        where = " and ".join(show(rows[worst].at[name], "pressure") for name in ("pressure_1", "pressure_2"))
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
        offsets = {name: float(terms[n]) for n, name in ((1, "pressure_1"), (2, "pressure_2")) if symbol == "tau_0"}
        offsets |= {"torque": 1.0 if symbol == "tau_0" else 0.0, "angle": float(over)}
        gains["angle"] = float(over) * angle
        parts = Parts(repeats, None, scales.part(gains, offsets))
        one = Estimate(symbol, value, unit, quantity, "plane", {"angle": angle}, parts, len(rows), trials=trials)
        yield withhold(one, why) if why else one


KIND = "joint-torque"
SIDES, GAP, SLOPE = "both sides", "gap", "polynomial"
SCALE = 2e-3
"""Share by which encoder and drive may disagree unseen [1]."""
LIKELY = 0.2
"""Share of the largest change that is possible, which the likeliest is where the torque counts as moving."""
ON = 3.0
"""What creeps in a rest goes on with the logarithm of time: by so many times as much in the length of a trial."""
LOOSE = 0.01
"""Share of the way between angles by which both sides may be apart unseen."""
Cells = dict[tuple[float, ...], list[Staircase]]


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Torque tau [N m] at each angle and pair of pressures, stiffness K_th [N m/rad], gap H_tau [N m].

    Where there are three pairs of pressures or more, also torque by pressure s_1, s_2 [N m/Pa] and tau_0 [N m] at each
    angle. `options`: `angles` [rad], else the plan's.
    """
    staircases, dropped = measured_trials(runs, lambda run, trial: staircase_of(run, trial, options or {}))
    scales = Scales.of(runs)
    cells: Cells = grouped(staircases, lambda one: tuple(round(one.trial.point[name], 3) for name in MUSCLES))
    estimates = list[Estimate]()
    # change of the torque after the mean of a rest [N.m], rising and falling: the mean of all rests of all trials
    rests = [[held for one in staircases for held in one.rests.holds[side]] for side in (0, 1)]
    rising, falling = (left(holds) if rests[0] else Left(0.0, 0.0, False) for holds in rests)
    for pressures, members in sorted(cells.items()):
        estimates += _estimates(dict(zip(MUSCLES, pressures, strict=True)), members, scales, (rising, falling))
    estimates = _pooled(estimates, min((len(one.rising) for one in staircases), default=1))
    estimates += plane_estimates([e for e in estimates if e.symbol == "tau"], scales)
    findings = [Finding("doubt", f"{one.trial}: {one.reason}") for one in dropped]
    if estimates and (lack := scales.lack(("torque", "angle", *MUSCLES))):
        findings.append(Finding("note", lack))
    apart = skew.apart(runs, ("angle", "torque")) if runs else 0.0
    findings += skew.findings(runs, ("angle", "torque"), apart, estimates)
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates,
        dropped=dropped,
        findings=findings,
        traces=list(_map(cells, estimates)),
        facts={"options": dict(options or {}), "trials": len(staircases)},
    )


def gap_of(run: RunData, trial: TrialData) -> float:
    """Gap of one trial [N m]; raises `NotUsable`."""
    return float(_gap(staircase_of(run, trial, {})).mean())


def _gap(one: Staircase) -> Array:
    """The gap at the angle that is farthest from both turns [N m], shape (cycles,)."""
    middle = 0.5 * (one.trial.point["lowest_angle"] + one.trial.point["highest_angle"])
    return np.asarray(one.gap[:, int(np.argmin(np.abs(one.nominal - middle)))])


def _near_a_turn(members: Sequence[Staircase]) -> str:
    """Why there is no torque at an angle where a turn has not faded."""
    w = max(one.turns.w for one in members if one.turns is not None)
    near = f"a turn fades on {show(w, 'angle', 3)}, and this angle is within 3 times that of one"
    return f"{near}: give an overrun of at least {show(CUT * w, 'angle', 3)}"


def _estimates(
    at: Mapping[str, float], members: Sequence[Staircase], scales: Scales, moving: tuple[Left, Left]
) -> Iterator[Estimate]:
    """Everything at one pair of pressures; calibration to first order, a pressure that is off changes the torque."""
    trials = tuple(one.trial.name for one in members)
    total = max(sum(at.values()), 1.0)
    likely = max(float(np.max(np.abs(np.diff(m.mean.mean(axis=0)) / np.diff(m.angles)))) for m in members)
    per_pressure = BY_PRESSURE * likely / total
    """Change of the stiffness by that of one pressure [N m/rad/Pa]."""
    whole = max(float(np.abs(m.mean).max()) for m in members) + likely * float(np.ptp(members[0].nominal))
    off = max(float(np.abs(m.pressures - [at[name] for name in MUSCLES]).max()) for m in members)
    """How far a measured pressure is from the one that the trial is for [Pa]."""

    def made(
        symbol: str, kind: tuple[str, str], method: str, values: Sequence[Array], extra: float,
        angles: float, by_pressure: float = 0.0, where: Mapping[str, float] | None = None, by_angle: float = 0.0,
    ) -> Estimate:  # fmt: skip
        value, half = mean_of_cycles(values)
        gains = {"torque": value} | ({"angle": angles} if angles else {})
        gains |= {name: by_pressure * at[name] for name in MUSCLES if by_pressure}
        offsets = dict.fromkeys(MUSCLES, by_pressure) if by_pressure else {}
        offsets |= {"torque": 1.0 if symbol == "tau" else 0.0, "angle": by_angle}
        part = scales.part(gains, {name: change for name, change in offsets.items() if change})
        parts = Parts(half, float(np.hypot(extra, by_pressure * off)), part)
        note = "one trial: the repeats part is the scatter of its cycles" if len(members) == 1 else ""
        return Estimate(symbol, value, *kind, method, where or at, parts, len(members), note=note, trials=trials)

    torque = ("N.m", "torque")
    opened = np.all([one.open for one in members], axis=0)
    of_gap, of_torque, of_slope = _doubts(members, likely, whole / total, moving)
    # half the change of the gap over the angles [N.m]
    uneven = max(0.5 * float(np.ptp(one.gap.mean(axis=0)[opened])) for one in members)
    H = made("H_tau", torque, GAP, [_gap(one) for one in members], uneven, 0.0)
    yield weighed(H, of_gap)
    slack = next((one.slack for one in members if one.slack), "")
    why = next((one.why_no_stiffness for one in members if one.why_no_stiffness), "")
    slopes = [] if why else [(one.stiffness(), one.stiffness(ORDERS[1]).mean(axis=0)) for one in members]
    for n, angle in enumerate(members[0].nominal):
        where = {**at, "angle": round(float(angle), 9)}
        left = max(abs(float(one.left[n])) for one in members)
        misplaced = likely * max(abs(float(one.angles[n] - angle)) for one in members)
        one = made("tau", torque, SIDES, [m.mean[:, n] for m in members], float(np.hypot(left, misplaced)),
                   likely * abs(float(angle)), whole / total, where, likely)  # fmt: skip
        lacks = slack if opened[n] else _near_a_turn(members)
        yield withhold(one, lacks) if lacks else weighed(one, of_torque, whole)
        if not why and opened[n]:
            place = int(opened[:n].sum())
            other = max(abs(float(K[:, place].mean() - K3[place])) for K, K3 in slopes)
            values = [K[:, place] for K, _ in slopes]
            # largest change of the stiffness with the angle [N.m/rad2]
            steps = np.diff(slopes[0][0].mean(axis=0)) / np.diff(members[0].nominal[opened])
            bend = float(np.max(np.abs(steps), initial=0.0))
            K = made("K_th", ("N.m/rad", "torsional stiffness"), SLOPE, values, other,
                     float(values[0].mean()), per_pressure, where, bend)  # fmt: skip
            yield weighed(K, [replace(of_slope, half=of_slope.half * abs(K.value or 0.0)), _scaled(K, members)])
    if why:
        middle = {**at, "angle": round(float(np.median(members[0].nominal)), 9)}
        K = made("K_th", ("N.m/rad", "torsional stiffness"), SLOPE, [np.zeros(2)], 0.0, 0.0, 0.0, middle)
        yield withhold(K, why)


def _scaled(K: Estimate, members: Sequence[Staircase]) -> Doubt:
    """What it does to the stiffness that the encoder and the drive disagree on how far the joint went."""
    scale = max((one.scale for one in members), key=abs)
    reason = f"the encoder reads {scale:+.1%} of the way that the drive was sent: one of them has a wrong scale"
    return Doubt("scale of the angle", "method", abs(scale * (K.value or 0.0)), abs(scale) > SCALE, reason)


def _doubts(
    members: Sequence[Staircase], likely: float, per_torque: float, moving: tuple[Left, Left]
) -> tuple[list[Doubt], list[Doubt], Doubt]:
    """What departs from rest and from the place that was asked for: of the gap, a torque [N m], the stiffness [1].

    `likely` is the stiffness [N m/rad], `per_torque` the torque by a pressure [N m/Pa], `moving` what the torque still
    moves by after a rest, rising and falling.
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
    gap = [
        Doubt("torque at rest", "method", ON * (rising.most + falling.most), moves, still),
        Doubt("pressures of both sides", "method", given, given > scatter * per_torque, f"{pressures}. Rest longer"),
        Doubt("angle of both sides", "method", likely * loose, shown, places),
    ]
    torque = [
        Doubt("torque at rest", "method", 0.5 * (rising.most + falling.most), moves, still),
        Doubt("angle of both sides", "method", 0.5 * likely * loose, shown),  # which side had the zero is not known
    ]
    return gap, torque, Doubt("torque at rest", "method", ON * max(rising.most, falling.most) / step, moves, still)


def _pooled(estimates: Sequence[Estimate], cycles: int) -> list[Estimate]:
    """The same, with repeats no closer to each other than those of all pairs of pressures and angles together.

    The scatter of two trials is small by chance once in a while; that of all is not. Where no pair was repeated, it is
    that of the `cycles`.
    """
    found = list(estimates)
    for symbol in {e.symbol for e in estimates}:
        known = [e for e in estimates if e.symbol == symbol and e.value is not None and e.parts.repeats is not None]
        several = [e for e in known if e.n > 1] or known
        freedom = [e.n - 1 if e.n > 1 else cycles - 1 for e in several]
        if sum(freedom) == 0:
            continue
        halves = np.array([e.parts.repeats for e in several])
        deviations = halves * np.sqrt([e.n for e in several]) / student.ppf(0.975, np.array(freedom))
        together = np.sqrt(np.average(np.square(deviations), weights=freedom)) * student.ppf(0.975, sum(freedom))
        for place, e in enumerate(found):
            if e.symbol == symbol and e.parts.repeats is not None:
                repeats = max(e.parts.repeats, float(together / np.sqrt(e.n)))
                found[place] = replace(e, parts=replace(e.parts, repeats=repeats))
    return found


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
