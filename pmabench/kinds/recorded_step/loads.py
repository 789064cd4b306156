"""K and B of recorded steps without a mass that rings: from two known loads or more, or from a column of force.

At rest F_ce(P) = W + K x, so that two loads W at one pressure give K = -(W2 - W1)/(x2 - x1). It is the stiffness
between the two places, not the tangent at one of them.

A cell above a hanging weight reads that weight and M x'': it does not move with the muscle's K. Where a spring or other
loads move the force independently of the contraction, F = c + s P - K x - B x' is one least-squares fit over all steps.
K and B are taken as the same at all their pressures, and that is tested.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.samples import OF_TWO, STEPS, UNDECLARED, lags_of, noise_of
from pmabench.analysis.shared.student import mean_with_half
from pmabench.base.quantities import show
from pmabench.kinds.recorded_step.step import AFTER, SEEN, Step
from pmabench.store.analyses.results import Estimate, Finding, Parts
from pmabench.store.records import Array, RunData

SECANT = "secant-of-loads"
SAME = 0.02
"""Share of a load that a force cell may be off it."""
Pair = tuple[float, float]
"""Pressures before and after a step [Pa]."""


@dataclass(frozen=True)
class Rest:
    """Where the steps of one pair of pressures and one load came to rest."""

    load: float
    """[N]."""
    x: float
    """[m]."""
    half: float | None
    """Of its 95 % interval by repeats [m]; None with one."""
    noise: float
    """Half width that the samples leave [m]."""
    names: tuple[str, ...]


def rests_of(steps: Sequence[Step]) -> list[Rest]:
    """One entry for each known load of steps between the same pressures, the lightest first."""
    found = []
    for load in sorted({round(step.trial.point.get("load", 0.0), 2) for step in steps} - {0.0}):
        mine = [step for step in steps if round(step.trial.point.get("load", 0.0), 2) == load]
        ends = [step.t > max(AFTER, step.t[-1] - 1.0) for step in mine]
        x, half = mean_with_half([float(np.mean(step.x[end])) for step, end in zip(mine, ends, strict=True)])
        parts = [np.array_split(step.x[end], 5) for step, end in zip(mine, ends, strict=True)]
        noise = 2 * max(float(np.std([part.mean() for part in one])) for one in parts)
        noise = hypot(noise, max(step.unresolved["displacement"] for step in mine))
        found.append(Rest(_pull(load, mine), x, half, noise, tuple(step.name for step in mine)))
    return found


def _pull(load: float, steps: Sequence[Step]) -> float:
    """The force at rest [N]: the load, but where a cell reads another one, as with a spring, that of the cell."""
    read = [
        float(np.mean(step.trial.channels["force"][step.trial.usable][step.t > max(AFTER, step.t[-1] - 1.0)]))
        for step in steps
        if "force" in step.trial.channels
    ]
    return float(np.mean(read)) if read and abs(np.mean(read) / load - 1) > SAME else load


def secant(pair: Pair, rests: Sequence[Rest], scales: Scales) -> Estimate | None:
    """K [N/m] between the lightest and the heaviest load; None with fewer than two, or where x moves by noise only.

    Loads between them show how far from one straight line the places lie: that is in the method part.
    """
    if len(rests) < 2:
        return None
    light, heavy = rests[0], rests[-1]
    way, weight = light.x - heavy.x, heavy.load - light.load
    noise = hypot(light.noise, heavy.noise)
    if way <= SEEN * noise:
        return None
    K = weight / way
    halves = [one.half for one in (light, heavy)]
    repeats = None if None in halves else K / way * hypot(*(half or 0.0 for half in halves))
    between = [(b.load - a.load) / (a.x - b.x) for a, b in pairwise(rests) if a.x > b.x]
    bent = max((abs(one - K) for one in between), default=0.0)
    note = f"secant between {show(light.load, 'force', 3)} at {show(light.x, 'length', 3)} and"
    note += f" {show(heavy.load, 'force', 3)} at {show(heavy.x, 'length', 3)}, loads taken as exact; includes friction"
    note = sentences(note, "no repeats part: a load was stepped once" if repeats is None else "")
    parts = Parts(repeats, hypot(K / way * noise, bent), scales.part({"displacement": -K}))
    names = tuple(name for one in rests for name in one.names)
    at = {"from": pair[0], "pressure": pair[1]}
    return Estimate("K", K, "N/m", "stiffness", SECANT, at, parts, len(names), note=note, trials=names)


def of_loads(groups: Mapping[Pair, Sequence[tuple[RunData, Step]]], estimates: Sequence[Estimate]) -> list[Estimate]:
    """K and B at each pair of pressures that was stepped under two known loads or more; `estimates` hold B/K.

    F_ce and dF_ce/dP are not given: steps come to rest with friction in them, to one side at one pressure.
    """
    found: list[Estimate] = []
    secants = {
        pair: secant(pair, rests_of([step for _, step in group]), Scales.of([run for run, _ in group]))
        for pair, group in groups.items()
    }
    for pair in sorted(groups):
        K = secants[pair]
        if K is not None:
            K = _by_friction(K, [other for at, other in secants.items() if _opposite(pair, at)])
            found += [K, *_damping(K, estimates)]
    return found


def _opposite(pair: Pair, other: Pair) -> bool:
    """Whether two steps come to the same pressure, one from below and one from above."""
    return pair[1] == other[1] and (pair[0] - pair[1]) * (other[0] - other[1]) < 0


def _by_friction(K: Estimate, others: Sequence[Estimate | None]) -> Estimate:
    """K with what it differs by from that of steps to the same pressure from the other side: friction is in both."""
    apart = [abs((K.value or 0.0) - (other.value or 0.0)) for other in others if other is not None]
    if not apart:
        note = "no repeats part: no step came to this pressure from the other side, what friction does is not seen"
        return replace(K, note=sentences(K.note, note), parts=replace(K.parts, repeats=None))
    return replace(K, parts=replace(K.parts, method=hypot(K.parts.method or 0.0, max(apart))))


def _damping(K: Estimate, estimates: Sequence[Estimate]) -> list[Estimate]:
    """B [N.s/m] of the direction of the steps: B/K times K."""
    at = dict(K.at)
    taus = [e for e in estimates if e.symbol in ("tau_c", "tau_r") and e.value and at.items() <= e.at.items()]
    if not taus or K.value is None:
        return []
    values = [e.value or 0.0 for e in taus]
    tau = float(np.mean(values))
    widest = max(taus, key=lambda e: e.parts.combined or 0.0).parts
    of_K, of_tau = K.parts.times(tau), widest.times(K.value)
    known = of_K.repeats is not None and of_tau.repeats is not None
    repeats = hypot(of_K.repeats or 0.0, of_tau.repeats or 0.0) if known else None
    apart = K.value * max(abs(value - tau) for value in values)
    method = float(np.linalg.norm([of_K.method or 0.0, of_tau.method or 0.0, apart]))
    symbol = taus[0].symbol.replace("tau", "B")
    names = tuple(name for e in taus for name in e.trials)
    parts = Parts(repeats, method, of_K.calibration)
    note = "B/K of the driven motion times the secant K"
    return [Estimate(symbol, tau * K.value, "N.s/m", "damping", SECANT, at, parts, len(names), note=note, trials=names)]


CELL = "cell-and-spring"
MOVES = 20.0
"""Standard deviations of its noise by which the force must move independently of the contraction."""
CONDITION = 30.0
"""Largest condition of the columns 1, x, x' and P, each over its standard deviation."""
MISFIT = 1.5
"""What is left, over the noise that a row must have, from which on the straight form does not hold."""
RANGE = 0.15
"""K and B are given where they lie within so much of their value for all that is possible of the times of pressure."""
SLOWER = (0.01, 0.015, 0.02, 0.03)
"""Times [s] by which the force may be late where the rows show it."""
CLEARLY = 5.0
"""Standard deviations by which rows fit better with a later force that is taken for late."""
FILTER = "filter of the force cell"
SMOOTH = 0.04
"""Rows are means over this time [s]."""
INSTEAD = "a map of `kind: contraction-relaxation` takes K at each pressure from steps with a column of force"


def by_cell(steps: Sequence[tuple[RunData, Step]], late: Sequence[float]) -> tuple[list[Estimate], list[Finding]]:
    """K [N/m] and B [N.s/m] of all steps with a force, and the sentence why not; nothing without such a column.

    `late` [s] are the times by which the pressure may be later than its stamps.
    """
    mine = [(run, step) for run, step in steps if "force" in step.trial.channels]
    if not mine:
        return [], []
    if any(lag for run, step in mine for lag in lags_of(run, step.trial).values()):
        return [], [Finding("note", f"the sensors have lags, which K by the cell does not take off; {INSTEAD}")]
    middle = 0.5 * (late[0] + late[-1])
    rows = Rows.of(mine, middle)
    noise = float(np.median([noise_of(_good(step, "force")) for _, step in mine]))
    if why := _why_not(rows.F, rows.design, noise):
        return [], [Finding("note", f"the force cell tells nothing of K here: {why}; {INSTEAD}")]
    terms, halves = rows.fitted()
    left = rows.left(terms)
    expected = _noise_of_rows(mine[0][1], terms, noise)
    if left > MISFIT * expected:
        text = f"{show(left, 'force', 2)} are left where noise makes {show(expected, 'force', 2)}: K changes with"
        return [], [Finding("note", f"K is not one number in these steps: {text} pressure or contraction; {INSTEAD}")]
    ends = [Rows.of(mine, shift).solved() for shift in (late[0], late[-1])]
    slower = _filtered(mine, middle, noise)
    read = _read(mine, terms) / float(np.ptp(rows.design[:, 1]))
    scales = Scales.of([run for run, _ in mine])
    names = tuple(step.name for _, step in mine)
    found, findings = [], []
    for symbol, unit, quantity, place in (("K", "N/m", "stiffness", 1), ("B", "N.s/m", "damping", 2)):
        value, spread = -float(terms[place]), max(abs(end[place] - terms[place]) for end in ends)
        if value <= 0 or spread > RANGE * value:
            text = f"{symbol} by the cell lies within +-{abs(spread / value):.0%} for what is known of the times"
            findings.append(Finding("note", f"{text}, accepted is +-{RANGE:.0%}; {INSTEAD}"))
            continue
        parts = Parts(float(halves[place]), float(spread), scales.part({"force": value, "displacement": -value}))
        e = Estimate(symbol, value, unit, quantity, CELL, {}, parts, len(names), trials=names)
        doubts = [Doubt(FILTER, "method", abs(float(slower[place] - terms[place])), seen=True)]
        found.append(weighed(e, [*doubts, *([Doubt(STEPS, "method", read, seen=False)] if symbol == "K" else [])]))
    return found, findings


def _read(steps: Sequence[tuple[RunData, Step]], terms: Array) -> float:
    """What the steps in which the channels are read may make of the force between two rests [N]."""
    weights = {"force": 1.0, "displacement": terms[1], "pressure": terms[3]}
    return OF_TWO * max(hypot(*(w * step.unresolved[name] for name, w in weights.items())) for _, step in steps)


def _filtered(steps: Sequence[tuple[RunData, Step]], late: float, noise: float) -> Array:
    """Terms were the force later, as a filter of its cell makes it, which is to one side.

    By as much as a filter may be slow that nobody declared, and by more where the rows fit far better then: what is
    left is compared over the noise of rows, which grows with the damping. `noise` is that of the force [N].
    """
    found = []
    for lag in (UNDECLARED, *SLOWER):
        rows = Rows.of(steps, late, lag)
        terms = rows.solved()
        found.append((terms, len(rows.F) * (rows.left(terms) / _noise_of_rows(steps[0][1], terms, noise)) ** 2))
    best = int(np.argmin([power for _, power in found]))
    return found[best if found[0][1] - found[best][1] > CLEARLY**2 else 0][0]


def _good(step: Step, channel: str) -> Array:
    return np.asarray(step.trial.channels[channel][step.trial.usable])


def _width(t: Array) -> int:
    return max(1, round(SMOOTH / float(np.median(np.diff(t)))))


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of all steps, one after another."""

    F: Array
    """[N], shape (n,)."""
    design: Array
    """Columns 1, x, x', P, shape (n, 4)."""
    noisy: Array
    """Variance of the noise of x', shape (n,): it would make the damping smaller, and is taken off its square."""
    lengths: Sequence[int]
    """How many rows each step has."""

    @classmethod
    def of(cls, steps: Sequence[tuple[RunData, Step]], late: float, force: float = 0.0) -> Rows:
        """Pressure and force are so much late [s]."""
        F, design = zip(*(_of_step(step, late, force) for _, step in steps), strict=True)
        lengths = [len(one) for one in F]
        noisy = np.repeat([_noise_of_speed(step) ** 2 for _, step in steps], lengths)
        return cls(np.concatenate(F), np.concatenate(design), noisy, lengths)

    def solved(self, rows: NDArray[np.bool_] | slice = slice(None)) -> Array:
        """Terms of the columns, by least squares."""
        design, size = self.design[rows], np.linalg.norm(self.design, axis=0)
        normal = (design / size).T @ (design / size)
        normal[2, 2] -= float(self.noisy[rows].sum()) / float(size[2]) ** 2
        return np.asarray(np.linalg.solve(normal, (design / size).T @ self.F[rows]) / size, dtype=np.float64)

    def left(self, terms: Array) -> float:
        """Root mean square of what is left [N]."""
        return float(np.sqrt(np.mean((self.F - self.design @ terms) ** 2)))

    def fitted(self) -> tuple[Array, Array]:
        """Terms of the columns and their half widths, by leaving out one step after another."""
        of, count = np.repeat(np.arange(len(self.lengths)), self.lengths), len(self.lengths)
        without = np.array([self.solved(of != n) for n in range(count)])
        spread = np.sqrt((count - 1) / count * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
        return self.solved(), np.asarray(2 * spread)


def _of_step(step: Step, late: float, force: float) -> tuple[Array, Array]:
    """Force [N], shape (n,), and columns 1, x, x', P, shape (n, 4), as means over times that follow one another.

    Means are integrals between the samples at both ends, for the mean of x' is the change of x between just these.
    """
    t, width = step.t, _width(step.t)
    edges = np.arange(0, len(t), width)
    x = _good(step, "displacement")
    F, P = np.interp(t + force, t, _good(step, "force")), np.interp(t + late, t, _good(step, "pressure"))
    length = np.diff(t[edges])
    areas = (np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))]) for y in (F, x, P))
    F, middle, P = (np.diff(area[edges]) / length for area in areas)
    return F, np.column_stack([np.ones(len(F)), middle, np.diff(x[edges]) / length, P])


def _noise_of_rows(step: Step, terms: Array, noise: float) -> float:
    """Noise of a row [N]: that of the force, and of pressure and contraction by the terms found."""
    of_means = hypot(noise, terms[3] * noise_of(step.P), terms[1] * step.noise) / sqrt(_width(step.t))
    return hypot(of_means, terms[2] * _noise_of_speed(step))


def _noise_of_speed(step: Step) -> float:
    """Noise of x' of a row [m/s]."""
    return step.noise * sqrt(2) / (_width(step.t) * float(np.median(np.diff(step.t))))


def _why_not(F: Array, design: Array, noise: float) -> str:
    """Why force and contraction do not give K; empty where they do."""
    on_x = design[:, :2]
    rest = F - on_x @ np.linalg.lstsq(on_x, F, rcond=None)[0]
    moves = float(np.std(rest))
    if moves <= MOVES * noise:
        text = f"independently of the contraction it moves by {show(moves, 'force', 2)}"
        return f"{text} only, {MOVES:g} times its noise are needed: hang it against a spring, and under other loads"
    scaled = (design[:, 1:] - design[:, 1:].mean(axis=0)) / design[:, 1:].std(axis=0)
    condition = float(np.linalg.cond(np.column_stack([design[:, 0], scaled])))
    if condition >= CONDITION:
        text = f"condition {condition:.0f}, below {CONDITION:g} is needed"
        return f"contraction, its rate and pressure go together ({text}): other loads or other steps separate them"
    return ""
