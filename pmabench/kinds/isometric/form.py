"""Departures of isometric samples from one line: late sensors, a drifting cell, unevenly sampled branches.

Each is estimated without the line, as a force that it adds to the samples; gives no estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import copysign, sqrt

import numpy as np

from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.isometric_lines import Mask, Test, Used, line_of
from pmabench.analysis.shared.samples import lag_open, noise_of
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Estimate, Finding
from pmabench.store.records import Array, RunData

BLOCKS = 200
"""Number of means that describe the course of the pressure in a test."""
TURN = 0.05
"""Share of the pressure range near its turns that belongs to neither branch: there the pressure is held, or the loop
has not opened yet.
"""
LEAST_LEG = 0.2
"""Smallest change of the pressure, as a share of that range, that counts as rising or falling."""
FEWEST = 10
"""Fewest samples of a branch or a rest."""
WITHOUT = 0.02
"""Share of the highest pressure below which the muscle counts as vented."""
SETTLING = 0.3
"""Share of the rest after the ramps in which a muscle may still settle."""
BEYOND = 1.1
"""Factor on the change of the line by the branches, since turns extend further than the part left out."""
STRETCHED = 1e-4
"""Length above the nominal one from which on a muscle has tension without pressure [m]."""
LATE, DRIFT = "time between force and pressure", "drift of the force cell"
Terms = tuple[float, float]
"""Slope m [N/Pa] and intercept c [N]."""


@dataclass(frozen=True)
class Departures:
    """Possible errors in the tests of one contraction, apart from its line."""

    late: Terms
    """Change of the line by the uncertainty of the sensors' lags."""
    drift: Terms
    """Change of the line by the drift of the cell between the rests."""
    gone: float
    """Change of the cell's reading at rest from before to after the ramps [N], mean of the tests."""
    noise: float
    """Noise of the force [N]."""

    @property
    def seen(self) -> bool:
        """Whether the cell drifts by more than the noise of one sample; at rest it is a mean of many."""
        return abs(self.gone) > self.noise

    def doubts(self, e: Estimate) -> list[Doubt]:
        """Effects on m or c."""
        of = "mc".index(e.symbol)
        return [
            Doubt(LATE, "method", abs(self.late[of]), seen=False),
            Doubt(DRIFT, "drift", abs(self.drift[of]), self.seen),
        ]

    def lines(self, line: Terms) -> list[Terms]:
        """Alternative lines, one per departure."""
        m, c = line
        return [(m + more, c + higher) for more, higher in (self.late, self.drift)]

    def findings(self, where: str) -> list[Finding]:
        """A significant drift."""
        if not self.seen:
            return []
        text = (
            f"{where}: the force cell drifts: at rest it reads {show(abs(self.gone), 'force', 2)} "
            f"{'more' if self.gone > 0 else 'less'} after the ramps than before; the intervals of slope and "
            "intercept hold it. Let the cell warm up, and measure again"
        )
        return [Finding("doubt", text)]


def departures(tests: Sequence[Test], used: Used, line: Terms) -> Departures:
    """The departures of tests at one contraction, with the line through their `used` samples."""
    parts = [(test, used(test)) for test in tests]
    gone = [gone_since(test) for test in tests]
    drift = [
        np.zeros(len(test.t)) if one is None else one[0] * np.interp(test.t, one[1:], (0.0, 1.0))
        for test, one in zip(tests, gone, strict=True)
    ]
    late = [line[0] * _open(test.run) * _rate(test) for test in tests]
    return Departures(
        _change(parts, late),
        _change(parts, drift),
        float(np.mean([one[0] for one in gone if one is not None] or [0.0])),
        max(noise_of(test.F) for test in tests),
    )


def _open(run: RunData) -> float:
    """Largest uncertainty of the lag between force and pressure [s], from the record."""
    return max(lag_open(run, name) for name in ("force", "pressure"))


def _change(parts: Sequence[tuple[Test, Mask]], forces: Sequence[Array]) -> Terms:
    """Line through `forces` [N] (one array per test): least squares is linear in F, so it is the change of the line."""
    P = np.concatenate([test.P[mask] for test, mask in parts])
    line = line_of(P, np.concatenate([F[mask] for (_, mask), F in zip(parts, forces, strict=True)]))
    return (line.m, line.c) if line is not None else (0.0, 0.0)


def _blocks(t: Array, P: Array) -> tuple[Array, Array]:
    """Means of times [s] and pressures [Pa] along a test."""
    parts = np.array_split(np.arange(len(t)), max(1, min(BLOCKS, len(t) // 3)))
    return np.array([t[part].mean() for part in parts]), np.array([P[part].mean() for part in parts])


def _rate(test: Test) -> Array:
    """Rate of the pressure [Pa/s] at each sample of a test."""
    t, P = _blocks(test.t, test.P)
    return np.interp(test.t, t, np.gradient(P, t)) if len(t) > 1 else np.zeros(len(test.t))


def legs(test: Test) -> Array:
    """1 for samples of a rising branch, -1 of a falling one, 0 near the turns between them; shape (n,)."""
    t, P = _blocks(test.t, test.P)
    span = float(np.ptp(P))
    turns, way = [0], 0
    for i in range(1, len(P)):
        gone = P[i] - P[turns[-1]]
        if gone * way > 0:
            turns[-1] = i  # further in the same direction
        elif abs(gone) > LEAST_LEG * span:
            turns, way = [*turns, i], int(np.sign(gone))
    found = np.zeros(len(test.t))
    for a, b in pairwise(turns):
        low, high = sorted((P[a], P[b]))
        inside = (test.t >= t[a]) & (test.t <= t[b]) & (test.P > low + TURN * span) & (test.P < high - TURN * span)
        found[inside] = np.sign(P[b] - P[a])
    return found


def even(tests: Sequence[Test], used: Used, line: Terms) -> Terms:
    """Mean of the lines through all rising and all falling samples; `line` where there is one branch only.

    This weights both branches equally. The line through all samples leans towards the branch with more of them.
    """
    P, F, way = (
        np.concatenate([of(test)[used(test)] for test in tests]) for of in (lambda one: one.P, lambda one: one.F, legs)
    )
    sides = [way > 0, way < 0]
    if any(rows.sum() < FEWEST or np.ptp(P[rows]) == 0 for rows in sides):
        return line
    mean = np.mean([np.polyfit(P[rows], F[rows], 1) for rows in sides], axis=0)
    m, c = (line + BEYOND * (mean - line)).tolist()
    return m, c


def gone_since(test: Test) -> tuple[float, float, float] | None:
    """Change of the cell's reading at rest from before to after the ramps [N], enlarged by two standard errors, and the
    middle times of these rests [s].

    At rest there is no pressure and no muscle force. None where a rest is missing or the muscle is stretched.
    """
    trial, F = test.trial, test.trial.channels["force"]
    good = trial.usable & np.isfinite(trial.channels["pressure"]) & np.isfinite(F)
    t, F = trial.t[good], F[good]
    at, P = _blocks(t, trial.channels["pressure"][good])
    under = np.flatnonzero(P > WITHOUT * P.max())
    if trial.point["contraction"] <= -STRETCHED or not len(under) or under[0] == 0 or under[-1] == len(P) - 1:
        return None
    begin, over = at[under[0] - 1], at[under[-1] + 1]
    before, after = t < begin, t > over + SETTLING * (t[-1] - over)
    if min(before.sum(), after.sum()) < FEWEST:
        return None
    gone = float(F[after].mean() - F[before].mean())
    error = noise_of(F) * sqrt(1 / before.sum() + 1 / after.sum())
    return gone + copysign(2 * error, gone), float(t[before].mean()), float(t[after].mean())
