"""K and B of recorded steps without ringing: from two or more known loads, or from a force channel.

At rest F_ce(P) = W + K x, so two loads W at one pressure give K = -(W2 - W1)/(x2 - x1), the stiffness between both
positions, not the tangent at one.

A cell above a hanging weight reads that weight and M x'', which is independent of the muscle's K. Where a spring or
other loads change the force independently of the contraction, F = c + s P - K x - B x' is one least-squares fit over
all steps. It assumes the same K and B at all pressures, which is tested.
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
"""Relative difference of a force cell's reading to the load that is tolerated."""
Pair = tuple[float, float]
"""Pressures before and after a step [Pa]."""


@dataclass(frozen=True)
class Rest:
    """Rest position after the steps of one pair of pressures and one load."""

    load: float
    """[N]."""
    x: float
    """[m]."""
    half: float | None
    """Half width of its 95 % interval from repeats [m]; None with one step."""
    noise: float
    """Half width due to scatter of the samples [m]."""
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
    """Force at rest [N]: the load, or the cell's reading if it differs, as with a spring."""
    read = [
        float(np.mean(step.trial.channels["force"][step.trial.usable][step.t > max(AFTER, step.t[-1] - 1.0)]))
        for step in steps
        if "force" in step.trial.channels
    ]
    return float(np.mean(read)) if read and abs(np.mean(read) / load - 1) > SAME else load


def secant(pair: Pair, rests: Sequence[Rest], scales: Scales) -> Estimate | None:
    """K [N/m] between the lightest and the heaviest load; None for fewer than two, or if x changes within noise only.

    The deviation of loads in between from a straight line is in the method part.
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
    """K and B at each pair of pressures with two or more known loads; `estimates` contain B/K.

    F_ce and dF_ce/dP are not given, since the rest positions contain friction of one direction.
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
    """Whether two steps end at the same pressure, one from below and one from above."""
    return pair[1] == other[1] and (pair[0] - pair[1]) * (other[0] - other[1]) < 0


def _by_friction(K: Estimate, others: Sequence[Estimate | None]) -> Estimate:
    """K with its difference to steps that reach the same pressure from the other side as method part, since friction is
    in both; without repeats part where there are none.
    """
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
"""Smallest motion of the force independent of the contraction, in standard deviations of its noise."""
CONDITION = 30.0
"""Largest condition of the columns 1, x, x' and P, each over its standard deviation."""
MISFIT = 1.5
"""Ratio of the residual to the expected noise of a row from which on the straight form does not hold."""
RANGE = 0.15
"""K and B are given if they change by at most this share over the possible delays of the pressure."""
SLOWER = (0.01, 0.015, 0.02, 0.03)
"""Delays of the force that are tried [s]."""
CLEARLY = 5.0
"""Improvement of the fit by a later force, in standard deviations, from which on the delay is accepted."""
FILTER = "filter of the force cell"
SMOOTH = 0.04
"""Rows are means over this time [s]."""
INSTEAD = "a map of `kind: contraction-relaxation` takes K at each pressure from steps with a column of force"


def by_cell(steps: Sequence[tuple[RunData, Step]], late: Sequence[float]) -> tuple[list[Estimate], list[Finding]]:
    """K [N/m] and B [N.s/m] from all steps with a force channel, and findings that say why there is none; both empty
    without such a channel.

    `late` [s] are possible delays of the pressure behind its stamps.
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
    """Error of the force between two rests because the channels are read in steps [N]."""
    weights = {"force": 1.0, "displacement": terms[1], "pressure": terms[3]}
    return OF_TWO * max(hypot(*(w * step.unresolved[name] for name, w in weights.items())) for _, step in steps)


def _filtered(steps: Sequence[tuple[RunData, Step]], late: float, noise: float) -> Array:
    """Terms for a delayed force, as by a filter of its cell, which has one sign.

    By the delay of an undeclared filter, or a longer one if the rows then fit much better; residuals are compared
    relative to the noise of rows, which grows with the damping. `noise` is that of the force [N].
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
    """Noise variance of x', shape (n,), subtracted from its sum of squares, since it would reduce the damping."""
    lengths: Sequence[int]
    """Number of rows of each step."""

    @classmethod
    def of(cls, steps: Sequence[tuple[RunData, Step]], late: float, force: float = 0.0) -> Rows:
        """The rows with pressure `late` [s] and force `force` [s] shifted earlier."""
        F, design = zip(*(_of_step(step, late, force) for _, step in steps), strict=True)
        lengths = [len(one) for one in F]
        noisy = np.repeat([_noise_of_speed(step) ** 2 for _, step in steps], lengths)
        return cls(np.concatenate(F), np.concatenate(design), noisy, lengths)

    def solved(self, rows: NDArray[np.bool_] | slice = slice(None)) -> Array:
        """Coefficients of the columns, by least squares."""
        design, size = self.design[rows], np.linalg.norm(self.design, axis=0)
        normal = (design / size).T @ (design / size)
        normal[2, 2] -= float(self.noisy[rows].sum()) / float(size[2]) ** 2
        return np.asarray(np.linalg.solve(normal, (design / size).T @ self.F[rows]) / size, dtype=np.float64)

    def left(self, terms: Array) -> float:
        """Rms residual [N]."""
        return float(np.sqrt(np.mean((self.F - self.design @ terms) ** 2)))

    def fitted(self) -> tuple[Array, Array]:
        """Terms of the columns and their half widths, by leaving out one step after another."""
        of, count = np.repeat(np.arange(len(self.lengths)), self.lengths), len(self.lengths)
        without = np.array([self.solved(of != n) for n in range(count)])
        spread = np.sqrt((count - 1) / count * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
        return self.solved(), np.asarray(2 * spread)


def _of_step(step: Step, late: float, force: float) -> tuple[Array, Array]:
    """Force [N], shape (n,), and columns 1, x, x', P, shape (n, 4), as means over consecutive time intervals.

    Means are integrals between the first and last sample of an interval, because the mean of x' is the change of x
    between exactly these.
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
    """Noise of a row [N]: of the force, and of pressure and contraction with the given coefficients."""
    of_means = hypot(noise, terms[3] * noise_of(step.P), terms[1] * step.noise) / sqrt(_width(step.t))
    return hypot(of_means, terms[2] * _noise_of_speed(step))


def _noise_of_speed(step: Step) -> float:
    """Noise of x' of a row [m/s]."""
    return step.noise * sqrt(2) / (_width(step.t) * float(np.median(np.diff(step.t))))


def _why_not(F: Array, design: Array, noise: float) -> str:
    """Reason why force and contraction do not give K; else empty."""
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
