"""Which cell the next trial is done in, so that few trials bring all intervals to their goals; knows no kind of test.

`fewest` finds the trials that are still needed, and `choose` takes the one of them with the largest gain per minute in
the smooth maximum of U_k / goal_k. To see drift and models that do not fit, there are also a reference trial every
eighth and a random cell every fourteenth, and each row and column of the sweep is done once before any cell is
repeated.

How well the coefficients will be known by then: covariance of a least squares whose trials are clusters. A trial in
cell c has rows X of the fit and N_c = X'X. Trials scatter: the coefficients of each lie about theirs, with the
covariance T; samples scatter by the noise sigma. Least squares weighs all rows alike, so that (Liang and Zeger 1986,
Biometrika 73, 13: working independence, clusters)

    C = N^-1 (sum S_i) N^-1,   S_c = sigma^2 N_c + N_c T N_c,   N = N_0 + sum N_i,

with N_0 the weak prior of the fit.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, exp, log

import numpy as np
from numpy.typing import NDArray

from pmabench.store.records import Array

SCATTER = 0.02
"""Scatter between trials where no repeats show it, of each coefficient; muscles show 0.3 to 2 %."""
FEWEST_FREEDOM = 10
"""Degrees of freedom among repeats from which on their scatter takes the place of that."""
NORMAL = 1.96
"""Half width of a 95 % interval by its standard deviation."""
LEAST, MOST = 1e-5, 0.2
"""Of the scatter between trials that is found."""
BISECTIONS = 20


@dataclass(frozen=True, eq=False)
class Design:
    """What one more trial in each cell adds to a fit with p unknowns, of which m combinations are wanted."""

    prior: Array
    """N_0, shape (p, p)."""
    cells: Array
    """N_c of one trial in each cell, shape (cells, p, p)."""
    noise: float
    """Standard deviation of a row's noise, sigma."""
    between: Array
    """T, covariance of the unknowns from trial to trial, shape (p, p)."""
    wanted: Array
    """Combinations of the unknowns, shape (m, p)."""

    def variances(self, counts: Array) -> Array:
        """Variance of each wanted combination after `counts` (cells,) trials, shape (m,)."""
        return np.asarray(self._variances(*self._sums(counts)))

    def after_each(self, counts: Array) -> Array:
        """The same after one more trial in each cell in turn, shape (cells, m)."""
        normal, spread = self._sums(counts)
        return np.asarray(self._variances(normal + self.cells, spread + self._spreads))

    def slopes(self, counts: Array) -> Array:
        """Derivatives of the variances by the count of each cell, shape (cells, m)."""
        normal, spread = self._sums(counts)
        solved = np.linalg.solve(normal, self.wanted.T)
        left = np.linalg.solve(normal, (self.noise**2 * normal + spread) @ solved)
        cells, between = self.cells @ solved, self._spreads @ solved
        own = np.einsum("pm,cpm->cm", solved, self.noise**2 * cells + between)
        return np.asarray(own - 2 * np.einsum("pm,cpm->cm", left, cells))

    def without_each(self, counts: Array, cells: NDArray[np.intp]) -> Array:
        """The same after one trial less in each of some cells in turn, which have at least one; shape (len(cells), m).

        Infinite where nothing is left that tells a combination.
        """
        normal, spread = self._sums(counts)
        found = self._variances(normal - self.cells[cells], spread - self._spreads[cells])
        return np.where(found > 0, found, np.inf)

    def covariance(self, counts: Array) -> Array:
        """Covariance of all unknowns after `counts` (cells,) trials, shape (p, p)."""
        normal, spread = self._sums(counts)
        inverse = np.linalg.inv(normal)
        return np.asarray(inverse @ (self.noise**2 * normal + spread) @ inverse)

    @cached_property
    def _spreads(self) -> Array:
        """N_c T N_c of each cell, shape (cells, p, p)."""
        return np.asarray(self.cells @ self.between @ self.cells)

    def _sums(self, counts: Array) -> tuple[Array, Array]:
        """N, and the sum of all N_c T N_c."""
        normal = self.prior + np.tensordot(counts, self.cells, 1)
        return normal, np.tensordot(counts, self._spreads, 1)

    def _variances(self, normal: Array, spread: Array) -> Array:
        """Diagonal of W N^-1 (sigma^2 N + spread) N^-1 W', for matrices of shape (..., p, p)."""
        scale = np.sqrt(np.einsum("...ii->...i", normal))
        even = normal / (scale[..., :, None] * scale[..., None, :])
        right = np.swapaxes(self.wanted / scale[..., None, :], -1, -2)
        solved = np.linalg.solve(even, right) / scale[..., :, None]
        total = self.noise**2 * normal + spread
        return np.asarray(np.einsum("...pm,...pm->...m", solved, total @ solved))


def scatter_like(design: Design, counts: Array, halves: Array, prior: float) -> float:
    """How much trials scatter, so that the design has the intervals that an analysis found from the repeats.

    `design.between` is for a scatter of 1. The share is that at which the median of the design's half widths over
    `halves` (m,) is 1, between `LEAST` and `MOST`; `prior` where there are none.
    """
    if not len(halves):
        return prior
    low, high = log(LEAST), log(MOST)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        known = replace(design, between=exp(2 * middle) * design.between)
        if float(np.median(NORMAL * np.sqrt(known.variances(counts)) / halves)) > 1:
            high = middle
        else:
            low = middle
    return exp(0.5 * (low + high))


POWER = 8
"""Of the smooth maximum: nearly the largest U / goal, with a share of those close to it."""
REFERENCE_EVERY = 8
RANDOM_EVERY = 14
"""With those that confirm a goal, which are drawn by lot as well, a tenth of some eighty trials."""
MOST_IN_CELL = 6
LOOKED_AT = 8
"""Cells whose trials are looked at exactly first, the best by the derivatives."""

REFERENCE, RANDOM, SPREAD, NARROW = "reference", "random", "spread", "narrow"
CONFIRM, REPEAT = "confirm", "repeat"
"""Why a cell was chosen."""
SWEEP = "sweep"
"""In place of a symbol: a goal for all coefficients."""


@dataclass(frozen=True)
class Goal:
    """How well a coefficient is wanted: at all pressures, or at one."""

    symbol: str
    """`SWEEP` for all coefficients, by what the whole sweep is predicted to give."""
    size: float
    """Half width of the 95 % interval: a share of the value, or SI; of `SWEEP`, a multiple."""
    relative: bool
    pressure: float | None = None
    """[Pa]"""

    def of(self, name: tuple[str, float], value: float, whole: float) -> float | None:
        """Half width [SI] that is wanted of a value by its symbol and pressure; None where this goal is another's.

        `whole` is the half width that all trials of the sweep together are predicted to give.
        """
        symbol, pressure = name
        if self.symbol == SWEEP:
            return self.size * whole
        if symbol != self.symbol or (self.pressure is not None and abs(pressure - self.pressure) > 1.0):
            return None
        return self.size * abs(value) if self.relative else self.size


@dataclass(frozen=True, eq=False)
class Aim:
    """How the interval of each wanted value follows from its variance, and what it should become; shape (m,) each."""

    goal: Array
    """Half width that is wanted."""
    factor: Array
    """Half width of the part that more trials narrow, by the root of the design's variance."""
    rest: Array
    """Half width of what more trials do not narrow."""

    def halves(self, variances: Array) -> Array:
        """Half widths for variances of shape (..., m)."""
        return np.asarray(np.hypot(self.rest, self.factor * np.sqrt(variances)))

    def reached(self, variances: Array) -> NDArray[np.bool_]:
        """Which goals are reached with variances of shape (..., m)."""
        return np.asarray(self.halves(variances) <= self.goal)

    def worst(self, variances: Array) -> Array:
        """The smooth maximum of half width over goal, shape (...)."""
        ratio = self.halves(variances) / self.goal
        top = ratio.max(axis=-1)
        return np.asarray(top * np.sum((ratio / top[..., None]) ** POWER, axis=-1) ** (1 / POWER))


@dataclass(frozen=True, eq=False)
class Field:
    """The cells of a sweep: where they lie and what a trial there costs."""

    places: tuple[tuple[float, float], ...]
    """Load and pressure of each cell."""
    seconds: Array
    """Duration of a trial in each, shape (cells,)."""
    change: float
    """What another load takes [s]."""
    reference: int | None
    """The cell of the reference trials; None where they are not chosen here."""
    seed: str
    """Of the random choices."""

    def cost(self, here: float | None) -> Array:
        """Seconds of the next trial in each cell, with the load `here` on."""
        change = np.array([0.0 if load == here else self.change for load, _ in self.places])
        return np.asarray(self.seconds + change)


@dataclass(frozen=True)
class Choice:
    """The next trial."""

    cell: int
    role: str
    worst: int
    """The value whose interval it is done for: the farthest from its goal."""
    before: float
    after: float
    """Half width of that one now, and as predicted after the trial."""


def choose(
    design: Design, aim: Aim, field: Field, counts: Array, target: Array, number: int, here: float | None,
    only: str = "",
) -> Choice:  # fmt: skip
    """The next trial after `number` trials, `counts` (cells,) of them in each cell, with the load `here` on.

    `target` (cells,) is what `fewest` found: cells that have fewer trials go first.
    `only`: `CONFIRM`, a cell that was done least; `REPEAT`, one that was done before.
    """
    now = design.variances(counts)
    after = design.after_each(counts)
    cell, role = _cell(aim, field, counts, target, number, here, now, after, only)
    halves = aim.halves(now)
    worst = int(np.argmax(halves / aim.goal))
    if role in (RANDOM, REFERENCE):
        worst = int(np.argmin(aim.halves(after[cell]) / halves))
    return Choice(cell, role, worst, float(halves[worst]), float(aim.halves(after[cell])[worst]))


def _cell(
    aim: Aim, field: Field, counts: Array, target: Array, number: int, here: float | None, now: Array, after: Array,
    only: str,
) -> tuple[int, str]:  # fmt: skip
    """The cell and why it is chosen."""
    open_ones = np.flatnonzero(counts < MOST_IN_CELL)
    if field.reference is not None and (number % REFERENCE_EVERY == 0 or not len(open_ones)):
        return field.reference, REFERENCE
    if not len(open_ones):  # all cells are full: the least done of them
        open_ones = np.flatnonzero(counts == counts.min())
    if only == CONFIRM:
        unseen = open_ones[counts[open_ones] == counts[open_ones].min()]
        return _drawn(unseen, field, number), CONFIRM
    if number % RANDOM_EVERY == RANDOM_EVERY // 2:
        return _drawn(open_ones, field, number), RANDOM
    rate = np.log(aim.worst(now) / aim.worst(after)) / field.cost(here)
    new = _uncovered(field, counts)
    candidates, role = (new, SPREAD) if len(new) else (open_ones, NARROW)
    if only == REPEAT and not len(new) and counts[open_ones].any():
        candidates, role = open_ones[counts[open_ones] > 0], REPEAT
    wanted = candidates[counts[candidates] < target[candidates]]
    candidates = wanted if len(wanted) else candidates
    return int(candidates[np.argmax(rate[candidates])]), role


def _drawn(cells: NDArray[np.intp], field: Field, number: int) -> int:
    return int(random.Random(f"{field.seed}/{number}").choice(cells.tolist()))


def _uncovered(field: Field, counts: Array) -> NDArray[np.intp]:
    """Cells at a load or a pressure where nothing was done yet."""
    done = [place for place, count in zip(field.places, counts, strict=True) if count > 0]
    loads, pressures = {load for load, _ in done}, {pressure for _, pressure in done}
    return np.array([n for n, (load, P) in enumerate(field.places) if load not in loads or P not in pressures], int)


def out_of_reach(design: Design, aim: Aim, counts: Array) -> list[int]:
    """The values whose goals would not be reached with the most trials in every cell."""
    most = np.maximum(counts, MOST_IN_CELL)
    return np.flatnonzero(aim.halves(design.variances(most)) > aim.goal).tolist()


def fewest(design: Design, aim: Aim, counts: Array, reference: int | None) -> Array:
    """Trials in each cell, shape (cells,), that reach all goals with few trials more than `counts` (cells,).

    From a sweep of all cells, as often as it takes, the trial that matters least is left out again and again, as long
    as the goals are reached: a backward elimination, for the smooth maximum. Choosing forward, one trial after the
    other, took a fifth more. Then one more trial is tried where it helps most, as long as two others are not needed
    with it. Trials in the cell `reference` come anyway, and are left out only as the others become fewer. Where the
    most trials in every cell do not reach the goals, all of these are returned.
    """
    level = 1
    while level < MOST_IN_CELL and not aim.reached(design.variances(np.maximum(counts, level))).all():
        level += 1
    target = np.maximum(counts, level)
    if reference is not None:
        target[reference] = counts[reference] + ceil((target - counts).sum() / (REFERENCE_EVERY - 1))
    target = _eliminated(design, aim, counts, target, reference)
    while (other := _exchanged(design, aim, counts, target, reference)) is not None:
        target = other
    return target


def _eliminated(design: Design, aim: Aim, counts: Array, target: Array, reference: int | None) -> Array:
    """The target without the trials that are not needed."""
    target, least = target.copy(), counts.copy()
    while True:
        if reference is not None:
            least[reference] = counts[reference] + (target - counts).sum() // REFERENCE_EVERY
        more = np.flatnonzero(target > least)
        expected = np.maximum(design.variances(target) - design.slopes(target)[more], 0.0)
        more = more[np.argsort(aim.worst(expected))]
        for few in (more[:LOOKED_AT], more[LOOKED_AT:]):
            without = design.without_each(target, few)
            enough = aim.reached(without).all(axis=-1)
            if enough.any():
                few, without = few[enough], without[enough]
                target[few[np.argmin(aim.worst(without))]] -= 1
                break
        else:
            return target


def _exchanged(design: Design, aim: Aim, counts: Array, target: Array, reference: int | None) -> Array | None:
    """The target with one more trial and at least two fewer; None where none of the most useful ones allows it."""
    ones = np.flatnonzero(target < MOST_IN_CELL)
    expected = np.maximum(design.variances(target) + design.slopes(target)[ones], 0.0)
    for cell in ones[np.argsort(aim.worst(expected))][:LOOKED_AT]:
        more = target.copy()
        more[cell] += 1
        fewer = _eliminated(design, aim, counts, more, reference)
        if fewer.sum() < target.sum():
            return fewer
    return None


@dataclass(frozen=True)
class Step:
    """A trial that is proposed, and how far all goals are then."""

    choice: Choice
    seconds: float
    worst: float
    """Largest half width over goal after it."""


def propose(
    design: Design, aim: Aim, field: Field, counts: Array, number: int, here: float | None, *, most: int,
    seconds: float = np.inf,
) -> list[Step]:  # fmt: skip
    """At most `most` trials, one after the other, that take at most so many seconds; fewer where goals are reached."""
    target = fewest(design, aim, counts, field.reference)
    counts, steps, spent = counts.copy(), list[Step](), 0.0
    while len(steps) < most and not aim.reached(design.variances(counts)).all():
        choice = choose(design, aim, field, counts, target, number + len(steps), here)
        spent += float(field.cost(here)[choice.cell])
        if spent > seconds:
            break
        counts[choice.cell] += 1
        here = field.places[choice.cell][0]
        ratio = aim.halves(design.variances(counts)) / aim.goal
        steps.append(Step(choice, spent, float(ratio.max())))
    return steps


def middle(places: Sequence[tuple[float, float]]) -> int:
    """A cell for reference trials: of the middle load, at the highest pressure there is for it."""
    loads = sorted({load for load, _ in places})
    load = loads[len(loads) // 2]
    return max((n for n, place in enumerate(places) if place[0] == load), key=lambda n: places[n][1])
