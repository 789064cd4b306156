"""Output error: the pooled coefficients refined by comparing simulated and measured contraction (option `polish`).

Each stretch of consecutive segments in which the muscle moves in one direction is simulated from a free start, with the
measured pressure and force as inputs. Rows are the means of segments. Their errors are correlated, since the muscle
filters the noise of pressure and force; so rows are whitened by their covariance. Gauss-Newton from the pooled fit:
maximum likelihood if noise is the only difference (Ljung, System Identification, 7.4). Works on segments; knows no
trial point, interval or protocol.

Over a stretch the motion

    M x'' + B(P) x' + K(P) x = f,   f = F_ce(P) - F_c sign(x') - F_L

at the measured pressure is linear in the force f and in the start. Between samples the coefficients are constant, at
their value for the mean pressure, and the step is exact for them (matrix exponential). Many stretches are computed in
parallel, as columns.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from pmabench.analysis.shared.samples import Noise
from pmabench.analysis.shared.simulated import LEAST, Coefficients
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.intervals import Pooled
from pmabench.kinds.contraction_relaxation.pooled import (
    FLOOR,
    NONE,
    Fit,
    design_of,
    inverse_of,
    levers,
    place,
    rms_of,
    sizes_of,
)
from pmabench.kinds.contraction_relaxation.segments import Campaign, Segments
from pmabench.kinds.contraction_relaxation.values import Further, Solution, name_of, values
from pmabench.store.analyses.results import Estimate, Finding
from pmabench.store.records import Array

ROOM = 4_000_000
"""Most numbers in the response arrays of stretches that are computed together, to bound the memory."""
SHORTEST = 2
"""Fewest segments of a stretch."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """One stretch of n segments with w samples in all; steps lie between samples, shape (w - 1,)."""

    rows: slice
    """Its rows in the segments."""
    way: float
    mean: Array
    """Simulated contraction [m], mean over each segment, from the measured start; shape (n,)."""
    answer: Array
    """Change of those means by the force on each step [m/N], shape (n, w - 1)."""
    start: Array
    """Change of those means by the contraction at the start, and with a mass by the speed; shape (n, 1 or 2)."""
    P: Array
    """Pressure [Pa] of each step."""
    x: Array
    """Simulated contraction [m] of each step."""
    v: Array
    """Simulated speed [m/s] of each step."""
    slope: Array
    """Change of the force by the pressure at each sample [N/Pa], shape (w,)."""
    cell: bool
    """The force was measured."""
    samples: int
    """Samples per segment."""

    def covariance(self, noise: Noise, least: float = 0.0) -> Array:
        """Covariance of the means [m^2], shape (n, n), from white noise of the channels; noise of the force is at least
        `least` [N].
        """
        pressure = np.abs(self.slope) * noise.pressure
        force = noise.force if self.cell else 0.0
        shaken = np.zeros((len(self.mean), len(self.slope)))
        shaken[:, 1:] += 0.5 * self.answer  # a step is driven by the mean of both its ends
        shaken[:, :-1] += 0.5 * self.answer
        shaken *= np.sqrt(np.maximum(pressure**2 + force**2, least**2))
        own = noise.displacement**2 / self.samples * np.eye(len(self.mean))
        return np.asarray(shaken @ shaken.T + own)


def answers(segments: Segments, fit: Coefficients) -> Iterator[Stretch]:
    """All stretches of at least `SHORTEST` segments, the longest first."""
    pieces = sorted(_pieces(segments), key=lambda piece: piece.stop - piece.start, reverse=True)
    s = segments.v.shape[1]
    while pieces:
        most = pieces[0].stop - pieces[0].start
        count = max(1, ROOM // (most * most * s))
        yield from _together(segments, fit, pieces[:count])
        pieces = pieces[count:]


def _pieces(segments: Segments) -> Iterator[slice]:
    """Rows of consecutive segments of one trial in one direction without a gap."""
    if not len(segments):
        return
    apart = ~segments.followed | (np.diff(segments.way) != 0)
    edges = [0, *(np.flatnonzero(apart) + 1).tolist(), len(segments)]
    for first, last in pairwise(edges):
        if last - first >= SHORTEST:
            yield slice(first, last)


def _together(segments: Segments, fit: Coefficients, pieces: list[slice]) -> Iterator[Stretch]:
    """Stretches as columns; shorter ones are padded with their last segment, and the result is cut to length."""
    s, m = segments.v.shape[1], len(pieces)
    most = pieces[0].stop - pieces[0].start
    index = np.stack([np.minimum(np.arange(p.start, p.start + most), p.stop - 1) for p in pieces], axis=1)

    def samples(field: Array) -> Array:
        return np.asarray(field[index].transpose(0, 2, 1).reshape(most * s, m))

    first = index[0]
    P, F = samples(segments.P_mid), samples(segments.F_mid)
    way, mass = segments.way[first], segments.mass[first]
    F_ce, K, B = _coefficients(fit, P, way)
    middle = [0.5 * (values[1:] + values[:-1]) for values in (P, F, F_ce, K, B)]
    P_step, drive = middle[0], middle[2] - middle[1] - way * fit.coulomb
    A, g = _steps(middle[3], middle[4], mass, segments.dt)
    begin = np.stack((segments.x[first, segments.reach], segments.v[first, 0]))[: g.shape[1]]
    x = _run(A, g, drive, begin)
    answer, start = _answer(A, g, most, s)
    x_step = 0.5 * (x[1:] + x[:-1])
    v_step = np.diff(x, axis=0) / segments.dt
    slope = _slope(fit, P, x, way, v_step)
    means = x.reshape(most, s, m).mean(axis=1)
    for column, piece in enumerate(pieces):
        n, w = piece.stop - piece.start, (piece.stop - piece.start) * s
        P_own, x_own, v_own = (of[: w - 1, column] for of in (P_step, x_step, v_step))
        yield Stretch(
            piece, float(way[column]), means[:n, column], answer[: w - 1, :n, column].T, start[:, :n, column].T, P_own,
            x_own, v_own, slope[:w, column], mass[column] <= 0, s,
        )  # fmt: skip


def _coefficients(fit: Coefficients, P: Array, way: Array) -> tuple[Array, Array, Array]:
    """F_ce [N], K [N/m] and B [N.s/m] for the direction of each column."""
    B = np.where(way > 0, fit.values("B_c", P), fit.values("B_r", P))
    return fit.values("F_ce", P), np.maximum(fit.values("K", P), LEAST), np.maximum(B, LEAST)


def _slope(fit: Coefficients, P: Array, x: Array, way: Array, v_step: Array) -> Array:
    """d(F_ce - K x - B v)/dP [N/Pa] along the motion."""
    by = 1e3
    v = np.vstack([v_step, v_step[-1:]])
    high, low = (_coefficients(fit, P + sign * by, way) for sign in (1, -1))
    return np.asarray(((high[0] - low[0]) - (high[1] - low[1]) * x - (high[2] - low[2]) * v) / (2 * by))


def _steps(K: Array, B: Array, mass: Array, dt: float) -> tuple[Array, Array]:
    """Exact state transition from sample to sample, state -> A @ state + g f, for a constant force f; state: x, and v
    with a mass.

    K, B have shape (steps, stretches), A (steps, k, k, stretches) and g (steps, k, stretches), with k = 1 or 2.
    """
    if not (mass > 0).any():
        fade = -np.expm1(-K / B * dt)
        return (1 - fade)[:, None, None], (fade / K)[:, None]
    # eigenvalues -s +- w: exp(A dt) = e^(-s dt) [cosh + s sinh/w, sinh/w; -K/M sinh/w, cosh - s sinh/w]
    s = 0.5 * B / mass
    w = np.sqrt((s * s - K / mass).astype(np.complex128))
    w = np.where(np.abs(w) * dt < 1e-6, 1e-6 / dt, w)
    slow, fast = np.exp(-(K / mass) / (s + w) * dt), np.exp(-(s + w) * dt)
    cosh, sinh = (0.5 * (slow + fast)).real, (0.5 * (slow - fast) / w).real
    A = np.array([[cosh + s * sinh, sinh], [-K / mass * sinh, cosh - s * sinh]])
    return A.transpose(2, 0, 1, 3), np.stack(((1 - A[0, 0]) / K, sinh / mass), axis=1)


def _run(A: Array, g: Array, drive: Array, state: Array) -> Array:
    """Contraction [m] at the samples from an initial state (k, stretches) under the force of each step [N]."""
    found = np.empty((len(drive) + 1, drive.shape[1]))
    found[0] = state[0]
    for i, push in enumerate(g * drive[:, None]):
        state = np.einsum("jkm,km->jm", A[i], state) + push
        found[i + 1] = state[0]
    return found


def _answer(A: Array, g: Array, n: int, s: int) -> tuple[Array, Array]:
    """Derivative of the mean contraction of n segments of s samples by the force on each step, and by the start.

    Shapes (steps, n, stretches) [m/N] and (k, n, stretches). Computed backwards in time (adjoint): `worth` is the
    derivative of each mean by the state at a sample.
    """
    steps, k, m = g.shape
    worth, found = np.zeros((k, n, m)), np.empty((steps, n, m))
    worth[0, n - 1] += 1 / s
    for i in range(steps - 1, -1, -1):
        np.einsum("km,knm->nm", g[i], worth, out=found[i])
        worth = np.einsum("jkm,jnm->knm", A[i], worth)
        worth[0, i // s] += 1 / s
    return found, worth


MOST_STEPS = 25
"""Most Gauss-Newton steps before the fit counts as not converged."""
WHOLE = 6
"""Number of steps after which they are halved: since the weights follow the fit, it may oscillate about its end."""
SETTLED = 1e-4
"""Mean square of a step, relative to the covariance, at which it has converged: 1 % of a standard deviation."""
HALVINGS = 4
"""How often a step that increases the cost is halved."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Polished(Fit):
    """A fit by output error; `design` and `residual` are whitened and scaled so that noise alone gives rms `unit`."""

    unit: float
    """Noise of a segment in the pooled fit [N]."""
    noise: Noise
    """Noise of the channels, for the whitening."""
    starts: int
    """Number of free start values, subtracted from the degrees of freedom."""
    misses: Array
    """Mean measured minus simulated contraction of each segment [m], shape (n,); nan for a segment in no stretch."""
    expected: Array
    """Standard deviation of `misses` by noise alone [m], shape (n,)."""
    begun: Fit
    """The pooled fit."""
    steps: int = 0
    converged: bool = False

    @property
    def cost(self) -> float:
        """Sum of squared rows, relative to noise."""
        return float(self.residual @ self.residual) / self.unit**2

    @property
    def rms(self) -> float:
        """See `Fit.rms`; equals `unit` if noise explains the residual."""
        count = int(np.isfinite(self.misses).sum())
        free = max(1.0, count - self.starts - float(np.sum(levers(self.design, self.inverse))))
        return float(np.sqrt(self.residual @ self.residual / free))

    def again(self, segments: Segments, noise: float) -> Polished:
        """See `Fit.again`: one Gauss-Newton step, enough for small changes; rows are those before the step."""
        there = linear(segments, self)
        return there.moved(there.newton(segments))

    def coarser(self, segments: Segments, knots: Array, noise: float) -> Fit:
        """See `Fit.coarser`."""
        coarse = replace(self, theta=self.at_knots(knots), knots=knots, halves=NONE)
        return coarse.again(segments, noise).again(segments, noise)

    def scatter(self, segments: Segments, noise: Noise) -> Array:
        """See `Fit.scatter`."""
        found = np.zeros((len(self.theta), len(self.theta)))
        for one in answers(segments, self):
            white = np.linalg.inv(_root(one, self, segments))
            scores = self.unit * self.design[one.rows].T @ white
            found += scores @ one.covariance(noise) @ scores.T
        return np.asarray(self.inverse @ found @ self.inverse)

    def shared(self, segments: Segments, noise: Noise) -> Array:
        """See `Fit.shared`: 0, since whitened rows are independent."""
        return np.zeros((len(self.theta), len(self.theta)))

    def change(self, columns: Array) -> Array:
        """See `Fit.change`: that of the pooled fit, which has the same equation of motion."""
        return self.begun.change(columns)

    def newton(self, segments: Segments) -> Array:
        """Gauss-Newton step from here, shape (p,)."""
        prior = self.prior(segments, self.unit)
        return np.asarray(self.inverse @ (self.design.T @ self.residual - prior.T @ (prior @ self.theta)))

    def moved(self, by: Array) -> Polished:
        """The same with `by` (p,) added to theta; rows are not recomputed."""
        return replace(self, theta=self.theta + by)


def polish(segments: Segments, fit: Fit, noise: Noise, unit: float) -> Polished:
    """The output-error fit starting from `fit`; `noise` of the channels, `unit` [N] as in `Polished`."""
    begun = Polished(
        fit.theta, fit.inverse, fit.design, fit.residual, fit.friction, fit.knots, fit.halves,
        fit.added,
        unit=unit, noise=noise, starts=0, misses=NONE, expected=NONE, begun=fit,
    )  # fmt: skip
    now = linear(segments, begun)
    for number in range(1, MOST_STEPS + 1):
        step = now.newton(segments) * (1.0 if number <= WHOLE else 0.5)
        size = float(np.mean(step**2 / np.diag(now.inverse))) / max(unit, now.rms) ** 2
        for _ in range(HALVINGS):
            then = linear(segments, now.moved(step))
            if then.cost <= 1.05 * now.cost:
                break
            step = 0.5 * step
        now = replace(then, steps=number)
        if size < SETTLED:
            return replace(now, converged=bool(np.isfinite(now.theta).all()))
    return now


def linear(segments: Segments, fit: Polished) -> Polished:
    """`fit` linearised at its theta for these segments: whitened rows and what depends on them."""
    n, p = len(segments), len(fit.theta)
    design, residual = np.zeros((n, p)), np.zeros(n)
    misses, expected = np.full(n, np.nan), np.full(n, np.nan)
    measured = segments.x[:, segments.reach : segments.x.shape[1] - segments.reach].mean(axis=1)
    starts = 0
    for one in answers(segments, fit):
        root = _root(one, fit, segments)
        miss = measured[one.rows] - one.mean
        white = np.linalg.inv(root) @ np.column_stack((_regressors(one, fit), miss, one.start))
        free, triangle = np.linalg.qr(white[:, p + 1 :])
        begin = np.linalg.solve(triangle, free.T @ white[:, p])
        white = white[:, : p + 1] - free @ (free.T @ white[:, : p + 1])
        design[one.rows], residual[one.rows] = fit.unit * white[:, :p], fit.unit * white[:, p]
        misses[one.rows] = miss - one.start @ begin
        taken = np.linalg.solve(triangle.T, one.start.T)
        expected[one.rows] = np.sqrt(np.maximum(0.0, np.sum(root**2, axis=1) - np.sum(taken**2, axis=0)))
        starts += one.start.shape[1]
    if not fit.friction:
        design[:, -1] = 0.0
    prior = fit.prior(segments, fit.unit)
    inverse = inverse_of(design.T @ design + prior.T @ prior)
    return replace(
        fit, design=design, residual=residual, inverse=inverse, starts=starts, misses=misses, expected=expected
    )


def _root(one: Stretch, fit: Polished, segments: Segments) -> Array:
    """Cholesky factor of the covariance of a stretch's means [m], shape (n, n)."""
    least = FLOOR * sizes_of(segments)[0] * np.sqrt(one.samples)
    covariance = one.covariance(fit.noise, least)
    covariance += 1e-9 * np.mean(np.diag(covariance)) * np.eye(len(one.mean))
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _regressors(one: Stretch, fit: Polished) -> Array:
    """Change of the means of a stretch by theta [m per unit], shape (n, p)."""
    k = len(fit.knots)
    left, share = place(one.P, fit.knots)
    hats = np.zeros((len(one.P), k))
    rows = np.arange(len(one.P))
    hats[rows, left], hats[rows, left + 1] = 1 - share, share
    found = np.zeros((len(one.mean), 4 * k + 1))
    found[:, :k] = one.answer @ hats
    found[:, k : 2 * k] = -(one.answer * one.x) @ hats
    damping = 2 * k if one.way > 0 else 3 * k
    found[:, damping : damping + k] = -(one.answer * one.v) @ hats
    found[:, -1] = -one.way * one.answer.sum(axis=1)
    return found


METHOD = "output-error"
MISFIT = 2.0
"""Ratio of the whitened rms to noise from which on the model's form is a doubt."""
FEW = 0.1
"""Share of the coefficients that may move by more than their interval before it is a doubt."""
FEWEST = 10
"""Fewest segments in stretches for a polish."""
MOST_NAMED = 4
"""Coefficients that a sentence names."""


def compare(campaign: Campaign, pooled: Pooled, estimates: Sequence[Estimate], options: Mapping[str, Any]) -> Further:
    """The pooled fit refined by output error if `options` has {"polish": True}; else an empty `Further`.

    `estimates` are those of the pooled fit. Without convergence there are no estimates, and a finding says so.
    """
    if not options.get("polish"):
        return Further()
    polished = polish(pooled.segments, pooled.fit, campaign.noise, pooled.expected)
    known = np.isfinite(polished.misses)
    if known.sum() < FEWEST:
        text = "output error: no stroke moves for long enough in one piece to be simulated; nothing was polished"
        return Further(findings=(Finding("doubt", text),))
    residual = pooled.segments.force - design_of(pooled.segments, polished.knots) @ polished.theta
    facts = {
        "converged": polished.converged,
        "steps": polished.steps,
        "segments": int(known.sum()),
        "residual_rms": rms_of(polished.misses[known]),
        "expected_rms": rms_of(polished.expected[known]),
        "whitened_rms": polished.rms / polished.unit,
        "residual_rms_force": rms_of(residual[known]),
        "expected_rms_force": rms_of(pooled.noise[known]),
    }
    if not polished.converged:
        text = (
            f"output error: not converged after {polished.steps} steps, so it gives no value: the coefficients of"
            " measured-pressure stand; trials of too few loads, or a muscle that is not of the model's form, leave"
            " it open"
        )
        return Further(findings=(Finding("doubt", text),), facts=facts)
    every = np.ones(len(pooled.segments), bool)
    trust = pooled.trust_of(polished, every, np.full(len(every), polished.unit))
    stiffness_is = pooled.diagnosis.stiffness_is
    found = values(Solution(campaign, pooled.segments, polished, polished.knots, trust, METHOD, "", stiffness_is))
    return Further(
        estimates=tuple(found),
        findings=(_residual(facts), *_compared(estimates, found)),
        facts=facts,
    )


def _residual(facts: Mapping[str, Any]) -> Finding:
    """The residual in m and in N, and whether noise explains it."""
    left, noise = show(facts["residual_rms"], "length", 2), show(facts["expected_rms"], "length", 2)
    force, shaken = show(facts["residual_rms_force"], "force", 2), show(facts["expected_rms_force"], "force", 2)
    size = (
        f"output error, {facts['steps']} steps: simulated contraction misses the measured one by {left} rms, {force} in"
        f" the equation of motion; noise of the channels explains {noise} and {shaken}"
    )
    if facts["whitened_rms"] > MISFIT:
        times = f"{facts['whitened_rms']:.2g} times what noise makes of it, serial correlation counted"
        return Finding("doubt", f"{size}: {times}; the model does not have the form of this muscle")
    return Finding("note", size)


def _compared(before: Sequence[Estimate], after: Sequence[Estimate]) -> Iterator[Finding]:
    """Coefficients that change by more than their interval, and those that output error does not determine."""
    there = {(e.symbol, tuple(e.at.items())): e for e in after}
    known, moved, lost = 0, list[tuple[float, Estimate, Estimate]](), list[str]()
    for a in before:
        b = there.get((a.symbol, tuple(a.at.items())))
        if a.value is None or b is None:
            continue
        if b.value is None:
            lost.append(name_of(b.symbol, b.at.get("pressure")))
            continue
        known, half, by = known + 1, a.parts.combined, abs(b.value - a.value)
        if half is not None and by > half:
            moved.append((by / max(half, 1e-300), a, b))
    yield from _moved(moved, known)
    if lost:
        more = f" and {len(lost) - MOST_NAMED} more" if len(lost) > MOST_NAMED else ""
        names = ", ".join(lost[:MOST_NAMED])
        yield Finding("note", f"output error leaves open what measured-pressure tells: {names}{more}")


def _moved(moved: list[tuple[float, Estimate, Estimate]], known: int) -> Iterator[Finding]:
    """Estimates that differ between both methods by more than a half width of the first; `known`: number compared."""
    if not known:
        return
    if not moved:
        yield Finding("note", f"output error moves none of {known} coefficients by more than its interval")
        return
    moved.sort(key=lambda one: -one[0])
    changes = [
        f"{name_of(a.symbol, a.at.get('pressure'))} from {show(a.value or 0.0, a.quantity, 5)} to"
        f" {show(b.value or 0.0, b.quantity, 5)} (± {show(a.parts.combined or 0.0, a.quantity, 2)})"
        for _, a, b in moved[:MOST_NAMED]
    ]
    more = f" and {len(moved) - MOST_NAMED} more" if len(moved) > MOST_NAMED else ""
    few = len(moved) <= FEW * known
    why = "" if few else "; methods that agree on a muscle of the model's form part on another: look at the residuals"
    yield Finding(
        "note" if few else "doubt",
        f"output error moves {len(moved)} of {known} coefficients by more than the interval of measured-pressure:"
        f" {', '.join(changes)}{more}{why}",
    )
