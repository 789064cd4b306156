"""The pooled fit: one least squares over all segments of a campaign; knows no trial, interval or protocol.

    F_L = F_ce(P) - K(P) x - B(P) x' - F_c sign(x'),   B = B_c contracting, B_r relaxing

(paper 0, with Coulomb friction), every coefficient piecewise linear over pressure: unknowns are its values at knots.
Linear in all unknowns.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.samples import Noise
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.store.records import Array

SYMBOLS = ("F_ce", "K", "B_c", "B_r")
BEND = 0.2
"""Standard deviation of a weak prior: distance of a knot from the line between its neighbours, as a share of the
coefficient's size. It matters only where samples say next to nothing.
"""
EXCESS = 1.5
"""A stretch between knots gets one more knot where its mean square residual is this many times that of the noise."""
GAIN = 0.03
"""Least relative fall of the sum of squares for which an added knot is kept."""
CHANCE = 8.0
"""The same fall in multiples of that expected by chance. It decides where segments are few: the best of several places
for a knot is taken.
"""
FEWEST_KNOTS = 3
"""Fewest knots without those that only halve a stretch."""
MOST_KNOTS = 8
"""Most knots that are added."""
PLACES = 5
"""Places tried for a knot in a stretch, twice: the second time between the neighbours of the best."""
FLOOR = 1e-4
"""Smallest noise, as a share of the typical force."""
ROUNDED, RESOLVED = 1e12, 1e-12
"""Condition of a normal matrix from which on rounding matters, and the smallest eigenvalue then kept, relative to the
largest: it changes forces by less than `FLOOR`.
"""


NONE = np.empty(0)
ON_TIME = Noise()
"""For samples with time stamps of the device's own clock: an error of that clock is no noise."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Solution of the least squares over segments.

    `theta` (p,) holds the unknowns of F_ce [N], K [N/m], B_c, B_r [N.s/m], then F_c [N]: of each coefficient its values
    at the `knots`.
    """

    theta: Array
    inverse: Array
    """Inverse of the normal matrix, shape (p, p); times the squared noise it is the covariance."""
    design: Array
    residual: Array
    """Residual of each segment [N]."""
    friction: bool
    """False where all segments go in one direction, so that F_c cannot be separated from F_ce."""
    knots: Array
    """[Pa]"""
    halves: Array = field(default_factory=lambda: NONE)
    """The knots [Pa] that only halve a stretch."""
    added: Array = field(default_factory=lambda: NONE)
    """The knots [Pa] that were added because of the residual."""

    def columns(self, symbol: str) -> slice:
        """Slice of `theta` with the unknowns of one of `SYMBOLS` or F_c."""
        k = len(self.knots)
        start = (*SYMBOLS, symbol).index(symbol) * k
        return slice(start, start + (k if symbol in SYMBOLS else 1))

    def row(self, symbol: str, P: float) -> Array:
        """Row (p,) whose product with theta is a coefficient at P [Pa]."""
        found, mine = np.zeros(len(self.theta)), self.columns(symbol)
        if symbol in SYMBOLS:
            left, share = place(np.array([P]), self.knots)
            found[mine][left[0] : left[0] + 2] = 1 - share[0], share[0]
        else:
            found[mine] = 1.0
        return found

    def at(self, P: float) -> int:
        """Number of the knot at pressure P [Pa]."""
        return int(np.argmin(np.abs(self.knots - P)))

    def values(self, symbol: str, P: Array) -> Array:
        """A coefficient [SI] at pressures P [Pa] of any shape."""
        return between(self.theta[self.columns(symbol)], place(P, self.knots))

    def coefficients(self, P: Array) -> Array:
        """All of `SYMBOLS` [SI] at pressures P [Pa] of any shape; shape (4, *P.shape)."""
        at = place(P, self.knots)
        return np.array([between(values, at) for values in self.theta[:-1].reshape(len(SYMBOLS), -1)])

    def damping(self, segments: Segments) -> Array:
        """B for the direction of each segment [N.s/m], shape (n,)."""
        P = segments.pressure
        return np.where(segments.way > 0, self.values("B_c", P), self.values("B_r", P))

    def prior(self, segments: Segments, noise: float) -> Array:
        """See `prior_of`."""
        return prior_of(segments, self.knots, noise)

    def pulled(self, by: Array) -> Fit:
        """The fit to the same segments with `by` (n,) [N] added to F_L."""
        change = self.change(by[:, None])[:, 0]
        return replace(self, theta=self.theta + change, residual=self.residual + by - self.design @ change)

    def again(self, segments: Segments, noise: float, design: Array | None = None) -> Fit:
        """The same fit to other segments, with expected noise [N], and their design where it is known."""
        return replace(solve(segments, self.knots, noise, design), halves=self.halves, added=self.added)

    def shifted(self, channel: str, gain: float, offset: float | Array) -> Array | None:
        """The design of the same segments if `channel` read (1 + gain) times as much, plus `offset` [SI], one or (n,);
        None for the pressure, to which it is not in proportion.
        """
        if channel == "pressure":
            return None
        design, k = self.design.copy(), len(self.knots)
        if channel == "displacement":
            design[:, k : 4 * k] *= 1 + gain
            design[:, k : 2 * k] -= np.asarray(offset)[..., None] * design[:, :k]
        return design

    def followed(self, gain: float, offset: float) -> Fit:
        """The same for a pressure that reads (1 + gain) times as much plus `offset` [Pa]: added knots move, since the
        bend they describe is then read elsewhere; knots at tested pressures do not.
        """
        followed = [at * (1 + gain) + offset for at in (self.knots, self.added)]
        knots = np.where(np.isin(self.knots, self.added), followed[0], self.knots)
        return replace(self, knots=knots if (np.diff(knots) > 0).all() else self.knots, added=followed[1])

    def bends(self, segments: Segments, noise: float) -> Array:
        """Error of each unknown because coefficients are curved between knots, shape (p,): a third of the change by
        leaving out the halving knots (Richardson), since the error is proportional to length^2.
        """
        kept = np.setdiff1d(self.knots, self.halves)
        if len(kept) < FEWEST_KNOTS or len(kept) == len(self.knots):
            return np.zeros(len(self.theta))
        coarse = solve(segments, kept, noise)
        return np.asarray((coarse.at_knots(self.knots) - self.theta) / 3.0)

    def at_knots(self, knots: Array) -> Array:
        """The unknowns of the same polygons at other knots [Pa]."""
        return np.concatenate((*(self.values(symbol, knots) for symbol in SYMBOLS), [self.theta[-1]]))

    def change(self, columns: Array) -> Array:
        """Change of theta by additional forces [N] at the segments; (n, m) gives (p, m)."""
        return np.asarray(self.inverse @ (self.design.T @ columns))

    def scatter(self, segments: Segments, noise: Noise) -> Array:
        """Covariance of theta by this noise of the channels of the segments that were fitted, shape (p, p)."""
        own, after = noise_covariance(segments, self, noise)
        alone = self.inverse @ ((self.design * own[:, None]).T @ self.design) @ self.inverse
        return np.asarray(alone + self.shared(after))

    def shared(self, after: Array) -> Array:
        """Part of `scatter` from samples that neighbouring segments share, by the covariance of each with the next (n -
        1,) [N^2]; shape (p, p).
        """
        cross = (self.design[1:] * after[:, None]).T @ self.design[:-1]
        return np.asarray(self.inverse @ (cross + cross.T) @ self.inverse)

    @property
    def coulomb(self) -> float:
        """Coulomb friction [N], 0 where it cannot be determined."""
        return float(self.theta[self.columns("F_c")][0]) if self.friction else 0.0

    @cached_property
    def rms(self) -> float:
        """Root mean square residual [N], corrected for the degrees of freedom of the fit."""
        free = max(1.0, len(self.residual) - float(np.sum(levers(self.design, self.inverse))))
        return float(np.sqrt(self.residual @ self.residual / free))


def levers(design: Array, inverse: Array) -> Array:
    """Leverage: variance of the prediction of each row by a fit, relative to that of one row; shape (n,)."""
    return np.asarray(np.sum(design @ inverse * design, axis=1))


def place(P: Array, knots: Array) -> tuple[NDArray[np.intp], Array]:
    """Index of the knot to the left, and fraction of the way to the next; the end lines continue beyond the knots."""
    left = np.searchsorted(knots[1:-1], P, side="right")
    return left, (P - knots[left]) / np.diff(knots)[left]


def between(values: Array, at: tuple[NDArray[np.intp], Array]) -> Array:
    """A polygon with these values at the knots, `at` from `place`."""
    left, share = at
    return np.asarray(values.take(left) + np.diff(values).take(left) * share)


def spread(at: tuple[NDArray[np.intp], Array], by: Array, k: int) -> Array:
    """Sums over the second axis of by (n, w) times the hat functions of k knots, `at` from `place`; shape (n, k)."""
    left, share = at
    rows = (np.arange(len(left))[:, None] * k + left).ravel()
    whole, further = (np.bincount(rows, each.ravel(), len(left) * k) for each in (by, by * share))
    whole[:] -= further
    whole[1:] += further[:-1]
    return whole.reshape(-1, k).astype(np.float64)


def design_of(segments: Segments, knots: Array) -> Array:
    """Regressors, shape (n, p), in the order of `Fit.theta`."""
    weights, k = np.broadcast_to(segments.weights, segments.P.shape), len(knots)
    left, share = at = place(segments.P, knots)
    first, s = segments.reach, segments.v.shape[1]  # of the pressures in the middle, `P_mid`
    damping = spread((left[:, first : first + s], share[:, first : first + s]), segments.v / s, k)
    force, stiffness, way = spread(at, weights, k), spread(at, weights * segments.x, k), segments.way[:, None]
    up = way > 0
    return np.hstack([force, -stiffness, -np.where(up, damping, 0.0), -np.where(up, 0.0, damping), -way])


def solve(segments: Segments, knots: Array, noise: float, design: Array | None = None) -> Fit:
    """Least squares with the weak prior; `noise` [N] is the expected noise of a segment."""
    design = design_of(segments, knots) if design is None else design
    friction = bool((segments.way > 0).any() and (segments.way < 0).any())
    if not friction:
        design[:, -1] = 0.0
    prior = prior_of(segments, knots, noise)
    inverse = inverse_of(design.T @ design + prior.T @ prior)
    theta = inverse @ (design.T @ segments.force)
    return Fit(theta, inverse, design, segments.force - design @ theta, friction, knots)


def least_squares(design: Array, force: Array, prior: Array) -> Array:
    """Theta of least squares with rows of a prior, without forming the normal matrix."""
    both = np.vstack([design, prior])
    return np.asarray(np.linalg.lstsq(both, np.concatenate((force, np.zeros(len(prior)))), rcond=None)[0])


def without_each(
    design: Array, force: Array, prior: Array, groups: Iterable[NDArray[np.bool_]]
) -> Iterator[tuple[Array, Array]]:
    """Inverse and theta of least squares with a prior, leaving out each group of rows in turn."""
    normal, right = design.T @ design + prior.T @ prior, design.T @ force
    for rows in groups:
        mine = design[rows]
        inverse = inverse_of(normal - mine.T @ mine)
        yield inverse, inverse @ (right - mine.T @ force[rows])


def inverse_of(normal: Array) -> Array:
    """Inverse of a normal matrix, scaled to its diagonal first.

    Combinations of unknowns that samples and prior determine less than rounding errors do are drawn to 0 by `RESOLVED`:
    a few trials at one pressure leave a combination free, and rounding would then affect all unknowns.
    """
    scale = np.sqrt(np.diag(normal))
    scaled = normal / np.outer(scale, scale)
    inverse = np.linalg.inv(scaled)
    if np.linalg.norm(scaled, 1) * np.linalg.norm(inverse, 1) > ROUNDED:
        sizes, ways = np.linalg.eigh(scaled)
        inverse = ways / np.maximum(sizes, RESOLVED * sizes[-1]) @ ways.T
    return np.asarray(inverse / np.outer(scale, scale))


def prior_of(segments: Segments, knots: Array, noise: float) -> Array:
    """Prior rows: each knot weakly to the line between its neighbours, and every unknown very weakly to 0."""
    sizes, bends, k = sizes_of(segments), bent(knots), len(knots)
    noise = max(noise, FLOOR * sizes[0])
    rows = [np.diag(noise / (1e3 * np.array([*np.repeat(sizes, k), sizes[0]])))]
    for number, size in enumerate(sizes):
        bend = np.zeros((k - 2, len(rows[0])))
        bend[:, number * k : (number + 1) * k] = bends * (noise / (BEND * size))
        rows.append(bend)
    return np.vstack(rows)


def bent(knots: Array) -> Array:
    """Rows for the distance of each inner knot from the line between its neighbours, shape (k - 2, k)."""
    k = len(knots)
    rows, j = np.zeros((k - 2, k)), np.arange(k - 2)
    share = (knots[1:-1] - knots[:-2]) / (knots[2:] - knots[:-2])
    rows[j, j], rows[j, j + 1], rows[j, j + 2] = share - 1, 1, -share
    return rows


def sizes_of(segments: Segments) -> tuple[float, float, float, float]:
    """Typical sizes of F_ce [N], K [N/m], B_c and B_r [N.s/m]: of the forces, by displacement and by speed."""
    force = rms_of(segments.force) or 1.0
    x, v = rms_of(segments.x), rms_of(segments.v)
    return force, force / x, force / v, force / v


def expected_noise(segments: Segments, fit: Fit, noise: Noise) -> Array:
    """Standard deviation of the residual of each segment from the noise of the channels alone [N], shape (n,)."""
    return np.asarray(np.sqrt(noise_covariance(segments, fit, noise)[0]))


def noise_covariance(segments: Segments, fit: Fit, noise: Noise, late: Noise = ON_TIME) -> tuple[Array, Array]:
    """Variance of the residual of each segment [N^2], shape (n,), and covariance of each with the next, shape (n - 1,).

    A residual is that of F_L + M x'' + K x + B x' - F_ce: noise of the cell, or of M x'' without a cell; of the
    pressure, by the slope of F_ce - K x; of the displacement, by K, and by B in the velocity. `late` is the standard
    deviation of the time of single samples of each channel [s], which acts as noise while it changes.
    """
    K, B = fit.values("K", segments.pressure), fit.damping(segments)
    s, m, dt = segments.v.shape[1], segments.reach, segments.dt
    # weights of the samples from start - m - 1 on; the next segment starts s later
    mean, speed, gained = (np.zeros(2 * s) for _ in range(3))
    mean[1 : s + 2 * m + 1] = segments.weights
    speed[2 * m + 1 : s + 2 * m + 1] += 1 / (2 * m * s * dt)
    speed[1 : s + 1] -= 1 / (2 * m * s * dt)
    for place, sign in ((s + 2 * m + 1, 1), (s + 1, -1), (2 * m, -1), (0, 1)):
        gained[place] += sign / (2 * m * dt * (s + 1) * dt)
    x = K[:, None] * mean + B[:, None] * speed + segments.mass[:, None] * gained
    moving = np.hypot(noise.displacement, segments.v.mean(axis=1) * late.displacement)
    pressing = force_by_pressure(segments, fit) * np.hypot(noise.pressure, _rate(segments.P, dt) * late.pressure)
    pulling = np.hypot(noise.force, _rate(segments.F_mid, dt) * late.force)
    force = np.where(segments.mass > 0, 0.0, pulling)
    own = moving**2 * np.sum(x**2, axis=1)
    own += (pressing**2 + force**2) * (mean @ mean)
    shared = float(mean[s:] @ mean[:s])
    after = moving[:-1] * moving[1:] * np.sum(x[:-1, s:] * x[1:, :s], axis=1)
    after += (pressing[:-1] * pressing[1:] + force[:-1] * force[1:]) * shared
    return np.asarray(own), np.where(segments.followed, after, 0.0)


def _rate(values: Array, dt: float) -> Array:
    """Mean rate of a channel over each segment [1/s], shape (n,), from `values` (n, w)."""
    return np.asarray((values[:, -1] - values[:, 0]) / (max(1, values.shape[1] - 1) * dt))


def force_by_pressure(segments: Segments, fit: Fit) -> Array:
    """Change of F_ce - K x with the pressure at each segment [N/Pa], shape (n,)."""
    P, step = segments.pressure, 1e3
    x = segments.contraction
    slope = fit.values("F_ce", P + step) - fit.values("F_ce", P - step)
    return np.asarray((slope - (fit.values("K", P + step) - fit.values("K", P - step)) * x) / (2 * step))


def first_knots(tested: Array, commanded: Array) -> Array:
    """Tested and commanded pressures [Pa], the middles between them, and two below the lowest tested one.

    Commanded pressures below the tested ones count as far down as the smallest distance of tested ones; below a single
    tested pressure, down to half of it.
    """
    tested = np.unique(tested)
    gap = float(np.min(np.diff(tested))) if len(tested) > 1 else 0.5 * float(tested[0])
    low = max(0.0, float(tested[0]) - gap)
    within = commanded[(commanded >= low) & (commanded <= tested[-1])]
    near = 0.2 * gap
    chosen = [float(P) for P in tested]
    for P in np.unique(np.concatenate((within, [low]))):
        if min(abs(P - other) for other in chosen) > near:
            chosen.append(float(P))
    chosen.sort()
    return np.unique(np.concatenate((chosen, 0.5 * (np.array(chosen[1:]) + np.array(chosen[:-1])))))


def fit(segments: Segments, knots: Array, noise: Noise) -> tuple[Fit, Array]:
    """The pooled fit with knots added where the residual needs them, and the noise of each segment [N], shape (n,).

    `knots` [Pa] as from `first_knots`, every other one half way between its neighbours.

    A coefficient that bends sharply between two knots leaves a residual there. One knot is added in the worst such
    stretch where the sum of squares becomes least, and kept if that falls by more than `GAIN` and far more than by
    chance.
    """
    floor = FLOOR * float(np.sqrt(np.mean(segments.force**2)))
    solved = solve(segments, knots, floor)
    for _ in range(MOST_KNOTS):
        expected = rms_of(np.maximum(floor, expected_noise(segments, solved, noise)))
        stretch = _worst_stretch(segments, solved, expected)
        if stretch is None:
            break
        finer = _with_knot(segments, solved, stretch, expected)
        gain = max(GAIN, CHANCE * len(SYMBOLS) / max(1, len(segments) - len(finer.theta)))
        if finer.residual @ finer.residual > (1 - gain) * (solved.residual @ solved.residual):
            break
        solved = finer
    each = np.maximum(floor, expected_noise(segments, solved, noise))
    found = solve(segments, solved.knots, rms_of(each))
    return replace(found, halves=knots[1::2], added=np.setdiff1d(solved.knots, knots)), each


def rms_of(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _with_knot(segments: Segments, solved: Fit, stretch: tuple[float, float], expected: float) -> Fit:
    """The fit with one more knot in the stretch [Pa]: the best of some places, then the best near that one.

    The places are compared by what each takes off the sum of squares of the residual. Only rows with a pressure in the
    stretch have another design with it.
    """
    low, high = stretch
    number = int(np.searchsorted(solved.knots, low))
    rows = (place(segments.P, solved.knots)[0] == number).any(axis=1)
    near, left, rest = segments.where(rows), solved.residual[rows], solved.design[~rows]
    before = len(solved.knots) * np.arange(len(SYMBOLS)) + number + 1  # where each coefficient gets one more unknown
    others = np.insert(np.insert(rest.T @ rest, before, 0.0, axis=0), before, 0.0, axis=1)
    pull_of_others = np.insert(rest.T @ solved.residual[~rows], before, 0.0)

    def finer(P: float) -> Array:
        return np.insert(solved.knots, number + 1, P)

    def change(P: float) -> float:
        """Of the sum of squares by a knot at P [Pa]."""
        design, prior = design_of(near, finer(P)), prior_of(segments, finer(P), expected)
        design[:, -1] *= solved.friction
        normal, pull, weak = others + design.T @ design, pull_of_others + design.T @ left, prior.T @ prior
        now = np.insert(solved.theta, before, solved.coefficients(np.array(P)))
        by = inverse_of(normal + weak) @ (pull - weak @ now)
        return float(by @ normal @ by - 2 * pull @ by)

    found: dict[float, float] = {}
    for _ in range(2):
        apart = (high - low) / (PLACES + 1)
        found |= {float(P): change(P) for P in low + apart * np.arange(1, PLACES + 1)}
        best = min(found, key=found.__getitem__)
        low, high = best - apart, best + apart
    return solve(segments, finer(best), expected)


def _worst_stretch(segments: Segments, solved: Fit, expected: float) -> tuple[float, float] | None:
    """The stretch between knots [Pa] with the largest sum of squares in excess of the noise; None for none."""
    k = len(solved.knots)
    left, _ = place(segments.pressure, solved.knots)
    count = np.bincount(left, minlength=k - 1)
    power = np.bincount(left, solved.residual**2, k - 1)
    excess = np.where((count >= 20) & (power > EXCESS * expected**2 * count), power - expected**2 * count, 0.0)
    worst = int(np.argmax(excess))
    return (float(solved.knots[worst]), float(solved.knots[worst + 1])) if excess[worst] > 0 else None
