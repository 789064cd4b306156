"""The papers' way (method `step-exponential`): exponentials through steps of displacement, then K, F_ce and B = K tau.

It takes the pressure for a step, which biases B where the regulator is slow; kept for comparison.
Knows samples and commands; no interval but the scatter over loads.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from pmabench.analysis.shared.samples import Samples
from pmabench.store.records import Array, TrialData

LEAST_STEP = 0.2e-3
"""Steps that move less are not fitted [m]."""
MOST_SAMPLES = 1000
ITERATIONS = 60


@dataclass(frozen=True)
class Exponential:
    """x(t) = start, then start + (end - start)(1 - exp(-(t - t_d) / tau)) from t_d on (paper 0)."""

    start: float
    end: float
    t_d: float
    """From the command [s]."""
    tau: float
    rms: float
    """Of the misfit [m]."""


@dataclass(frozen=True)
class Step:
    """One step of one trial, fitted."""

    trial: int
    phase: str
    load: float
    pressure: float
    """Commanded target [Pa]."""
    fit: Exponential


@dataclass(frozen=True)
class Regression:
    """K and F_ce at one pressure from final contractions over loads, with standard errors; None where unknown."""

    K: float
    F_ce: float
    se_K: float | None
    se_F_ce: float | None
    n: int


def exponential(t: Array, x: Array, start: float) -> Exponential | None:
    """Least squares for end, t_d and tau by damped Gauss-Newton; t [s] counts from the command; None if it fails."""
    stride = -(-len(t) // MOST_SAMPLES)
    t, x = t[::stride], x[::stride]
    end = float(np.mean(x[-max(3, len(x) // 20) :]))
    share = (x - start) / (end - start)
    t28, t63 = (float(t[int(np.argmax(share > level))]) for level in (0.283, 0.632))
    tau = max(1.5 * (t63 - t28), 2 * float(t[1] - t[0]))
    theta = np.array([end, max(0.0, t63 - tau), tau])

    def residual(at: Array) -> tuple[Array, Array]:
        since = t - at[1]
        fade = np.where(since > 0, np.exp(-np.maximum(since, 0.0) / at[2]), 1.0)
        return x - start - (at[0] - start) * (1 - fade), fade

    r, fade = residual(theta)
    damping = 1e-3
    for _ in range(ITERATIONS):
        since = np.maximum(t - theta[1], 0.0)
        grown = (theta[0] - start) * fade / theta[2]
        moving = t > theta[1]
        jacobian = np.column_stack([1 - fade, -grown * moving, -grown * since / theta[2]])
        normal = jacobian.T @ jacobian
        move = np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-30 * np.eye(3), jacobian.T @ r)
        tried = theta + move
        if tried[2] <= 0 or tried[2] > 10 * (t[-1] - t[0]):
            damping *= 10
            continue
        new, new_fade = residual(tried)
        if new @ new <= r @ r:
            small = bool(np.all(np.abs(move) < 1e-7 * np.abs(tried) + 1e-9))
            theta, r, fade, damping = tried, new, new_fade, max(1e-9, damping / 5)
            if small:
                break
        else:
            damping *= 10
            if damping > 1e9:
                break
    if not np.all(np.isfinite(theta)):
        return None
    rms = sqrt(float(np.mean(r**2)))
    return Exponential(start, float(theta[0]), float(theta[1]), float(theta[2]), rms)


def steps_of(samples: Samples, trial: TrialData, lift: float) -> list[Step]:
    """Contraction and relaxation steps of a trial, as far as they move and end off the support."""
    result = []
    commands = [c for c in trial.commands if c.output == "pressure" and c.phase in ("contract", "relax", "vent")]
    ends = [*(c.t for c in commands[1:]), float(samples.t[-1]) + 1e-9]
    for command, end in zip(commands, ends, strict=False):
        rows = np.flatnonzero((samples.t >= command.t - 1e-9) & (samples.t < end - 1e-9) & samples.ok)
        before = (samples.t < command.t + 1e-9) & (samples.t > command.t - 0.2) & samples.ok
        if len(rows) < 50 or not before.any() or command.phase == "vent":
            continue
        x = samples.x[rows]
        start, last = float(np.mean(samples.x[before])), float(np.mean(x[-len(x) // 20 :]))
        if abs(last - start) < LEAST_STEP or last < lift:
            continue
        found = exponential(samples.t[rows] - command.t, x, start)
        if found is not None:
            result.append(Step(samples.trial, command.phase, samples.load, command.value, found))
    return result


def regress(load: Array, x: Array) -> Regression | None:
    """Two parameters: x = (F_ce - F_L) / K by least squares of x on F_L (noise is in x); None below 2 loads."""
    if len(np.unique(load)) < 2:
        return None
    off = load - load.mean()
    power = float(off @ off)
    slope = float(off @ x) / power
    if slope >= 0:
        return None
    K = -1.0 / slope
    F_ce = K * float(x.mean()) + float(load.mean())
    left = len(load) - 2
    if left < 1:
        return Regression(K, F_ce, None, None, len(load))
    residual = x - x.mean() - slope * off
    variance = float(residual @ residual) / left
    se_K = K**2 * sqrt(variance / power)
    se_F = K * sqrt(variance * (1 / len(load) + (F_ce - float(load.mean())) ** 2 / power))
    return Regression(K, F_ce, se_K, se_F, len(load))


def stiffness(load: Array, x: Array, F_ce: float) -> Regression:
    """One parameter: K = sum x (F_ce - F_L) / sum x^2 for a known F_ce [N]."""
    power = float(x @ x)
    K = float(x @ (F_ce - load)) / power
    left = len(x) - 1
    residual = F_ce - load - K * x
    se = sqrt(float(residual @ residual) / left / power) if left > 0 else None
    return Regression(K, F_ce, se, None, len(x))
