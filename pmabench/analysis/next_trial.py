"""Choice of the cell of the next trial, so that few trials bring all intervals to their goals.

`fewest` finds the trials that are still needed, and `choose` takes the one of them with the largest gain per time in
the smooth maximum of U_k / goal_k. To reveal drift and models that do not fit, every eighth trial is a reference trial
and every fourteenth in a random cell, and each load and pressure of the sweep is tested once before cells are repeated.

The predicted covariance of the coefficients is that of least squares with trials as clusters. A trial in cell c has
rows X of the fit and N_c = X'X. Coefficients scatter from trial to trial with the covariance T, samples with the noise
sigma. Least squares weighs all rows alike, so that (Liang and Zeger 1986, Biometrika 73, 13: working independence)

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
"""Relative scatter of each coefficient between trials before anything is fitted; muscles show 0.3 to 2 %."""
FEWEST_FREEDOM = 10
"""Degrees of freedom among repeats from which on scatter can be distinguished from a wrong form."""
NORMAL = 1.96
"""Half width of a 95 % interval over the standard deviation."""
LEAST, MOST = 1e-5, 0.2
"""Bounds of the scatter between trials that `scatter_like` finds."""
BISECTIONS = 20


@dataclass(frozen=True, eq=False)
class Design:
    """Information that a trial in each cell adds to a fit with p unknowns, of which m combinations are wanted."""

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
        """Variances after one more trial in each cell in turn, shape (cells, m)."""
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
        """Variances after one trial less in each of `cells` in turn, shape (len(cells), m).

        Each of these cells needs at least one trial. Infinite where a combination is no longer determined.
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
    """Scatter between trials at which the design has the half widths `halves` (m,) that an analysis found.

    `design.between` is for a scatter of 1. At the result the median of the design's half widths over `halves` is 1; it
    is limited to `LEAST` and `MOST`. `prior` where `halves` is empty.
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
"""Exponent of the smooth maximum of U / goal."""
REFERENCE_EVERY = 8
RANDOM_EVERY = 14
"""With those that confirm a goal, which are drawn at random too, a tenth of about eighty trials."""
MOST_IN_CELL = 6
LOOKED_AT = 8
"""Number of cells, the best by the derivatives, that are evaluated exactly first."""

REFERENCE, RANDOM, SPREAD, NARROW = "reference", "random", "spread", "narrow"
CONFIRM, REPEAT = "confirm", "repeat"
"""Reasons for which a cell is chosen."""
SWEEP = "sweep"
"""Stands for a symbol in a goal for all coefficients."""


@dataclass(frozen=True)
class Goal:
    """Wanted half width of a coefficient, at all pressures or at one."""

    symbol: str
    """`SWEEP` for all coefficients, relative to the half widths predicted for the whole sweep."""
    size: float
    """Half width of the 95 % interval: a share of the value, or SI; of `SWEEP`, a multiple."""
    relative: bool
    pressure: float | None = None
    """[Pa]"""

    def of(self, name: tuple[str, float], value: float, whole: float) -> float | None:
        """Wanted half width [SI] of the value with this symbol and pressure; None where the goal does not apply to it.

        `whole` is the half width predicted for all trials of the sweep together.
        """
        symbol, pressure = name
        if self.symbol == SWEEP:
            return self.size * whole
        if symbol != self.symbol or (self.pressure is not None and abs(pressure - self.pressure) > 1.0):
            return None
        return self.size * abs(value) if self.relative else self.size


@dataclass(frozen=True, eq=False)
class Aim:
    """Goal of each wanted value, and how its half width follows from its variance; shape (m,) each."""

    goal: Array
    """Wanted half width."""
    factor: Array
    """Half width of the part that more trials reduce, over the root of the design's variance."""
    rest: Array
    """Half width of the part that more trials do not reduce."""

    def halves(self, variances: Array) -> Array:
        """Half widths for variances of shape (..., m)."""
        return np.asarray(np.hypot(self.rest, self.factor * np.sqrt(variances)))

    def reached(self, variances: Array) -> NDArray[np.bool_]:
        """Whether each goal is reached with variances of shape (..., m); same shape."""
        return np.asarray(self.halves(variances) <= self.goal)

    def worst(self, variances: Array) -> Array:
        """The smooth maximum of half width over goal, shape (...)."""
        ratio = self.halves(variances) / self.goal
        top = ratio.max(axis=-1)
        return np.asarray(top * np.sum((ratio / top[..., None]) ** POWER, axis=-1) ** (1 / POWER))


@dataclass(frozen=True, eq=False)
class Field:
    """Cells of a sweep: their operating points, and the duration of a trial in each."""

    places: tuple[tuple[float, float], ...]
    """Load and pressure of each cell."""
    seconds: Array
    """Duration of a trial in each cell [s], shape (cells,)."""
    change: float
    """Time to change the load [s]."""
    reference: int | None
    """Index of the cell of reference trials; None where these are not chosen here."""
    seed: str
    """Seed of the random choices."""

    def cost(self, here: float | None) -> Array:
        """Duration of the next trial in each cell [s], with the load `here` mounted, shape (cells,)."""
        change = np.array([0.0 if load == here else self.change for load, _ in self.places])
        return np.asarray(self.seconds + change)


@dataclass(frozen=True)
class Choice:
    """The next trial."""

    cell: int
    role: str
    worst: int
    """Index of the value whose interval the trial is meant to reduce, usually the farthest from its goal."""
    before: float
    after: float
    """Predicted half width of that value after the trial; `before` is that of now."""


def choose(
    design: Design, aim: Aim, field: Field, counts: Array, target: Array, number: int, here: float | None,
    only: str = "",
) -> Choice:  # fmt: skip
    """The next trial after `number` trials, `counts` (cells,) in each cell, with the load `here` mounted.

    `target` (cells,) is the result of `fewest`; cells with fewer trials than that go first.
    `only`: `CONFIRM` for one of the cells with fewest trials, `REPEAT` for a cell that has trials.
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
    """Index of the cell, and the reason for which it is chosen."""
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
    """Cells at a load or pressure without a trial."""
    done = [place for place, count in zip(field.places, counts, strict=True) if count > 0]
    loads, pressures = {load for load, _ in done}, {pressure for _, pressure in done}
    return np.array([n for n, (load, P) in enumerate(field.places) if load not in loads or P not in pressures], int)


def out_of_reach(design: Design, aim: Aim, counts: Array) -> list[int]:
    """Indices of values whose goals are not reached with `MOST_IN_CELL` trials in every cell."""
    most = np.maximum(counts, MOST_IN_CELL)
    return np.flatnonzero(aim.halves(design.variances(most)) > aim.goal).tolist()


def fewest(design: Design, aim: Aim, counts: Array, reference: int | None) -> Array:
    """Trials in each cell, shape (cells,), that reach all goals with few trials in addition to `counts` (cells,).

    Backward elimination: of as many full sweeps as are needed, the trial that matters least for the smooth maximum is
    removed again and again while goals are reached; forward selection took a fifth more. Trials in the cell `reference`
    are done anyway, and are removed only as the others become fewer. Where `MOST_IN_CELL` trials in every cell do not
    reach the goals, these are the start.
    """
    level = 1
    while level < MOST_IN_CELL and not aim.reached(design.variances(np.maximum(counts, level))).all():
        level += 1
    target = np.maximum(counts, level)
    if reference is not None:
        target[reference] = counts[reference] + ceil((target - counts).sum() / (REFERENCE_EVERY - 1))
    least = counts.copy()
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


@dataclass(frozen=True)
class Step:
    """A proposed trial, and the state of the goals after it."""

    choice: Choice
    seconds: float
    worst: float
    """Largest half width over goal after this trial."""


def propose(
    design: Design, aim: Aim, field: Field, counts: Array, number: int, here: float | None, *, most: int,
    seconds: float = np.inf,
) -> list[Step]:  # fmt: skip
    """At most `most` successive trials within `seconds` [s]; fewer where all goals are reached, each load and pressure
    tested once.
    """
    target = fewest(design, aim, counts, field.reference)
    counts, steps, spent = counts.copy(), list[Step](), 0.0
    while len(steps) < most and (len(_uncovered(field, counts)) or not aim.reached(design.variances(counts)).all()):
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
    """Index of the cell for reference trials: the middle load at its highest pressure."""
    loads = sorted({load for load, _ in places})
    load = loads[len(loads) // 2]
    return max((n for n, place in enumerate(places) if place[0] == load), key=lambda n: places[n][1])
