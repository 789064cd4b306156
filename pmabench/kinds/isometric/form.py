"""What keeps isometric samples from one line: late sensors, branches that are sampled unevenly, a cell that drifts.

Each is sized by what does not depend on the line, as a force that it adds to the samples; knows no estimate.
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
"""Means that the course of the pressure in a test is taken from."""
TURN = 0.05
"""Share of the range of the pressures about its turns that belongs to neither branch: there it is held, or a loop is
not open yet."""
LEAST_LEG = 0.2
"""Share of that range from which on the pressure rises or falls."""
FEWEST = 10
"""Samples that a branch, or a rest, needs."""
WITHOUT = 0.02
"""Share of the highest pressure below which there is none."""
SETTLING = 0.3
"""Share of the rest after the ramps in which a muscle may still settle."""
SURE = 6.0
"""Standard errors of the end of a line from which on a change of it is seen."""
UNEVEN = 0.005
"""Share of the highest force from which on it is reported that branches are not sampled alike."""
BEYOND = 1.1
"""By so much more than without its turns a loop may turn the line: they reach farther than is left out."""
STRETCHED = 1e-4
"""A muscle that is longer than its nominal length by this pulls without pressure [m]."""
LATE, DRIFT = "time between force and pressure", "drift of the force cell"
BRANCHES = "rising and falling pressure sampled unlike each other"
Terms = tuple[float, float]
"""Slope m [N/Pa] and intercept c [N]."""


@dataclass(frozen=True)
class Departures:
    """What the tests of one contraction may hold besides their line."""

    late: Terms
    """Change of the line by what the record leaves open of the sensors' lags."""
    drift: Terms
    """Change of the line by the drift of the cell that the rests show."""
    gone: float
    """What the cell reads more at rest after the ramps than before [N], the mean of the tests."""
    noise: float
    """Of the force [N]."""
    even: Terms
    """Change of the line where the rising and the falling branch count alike; none where there is one branch only."""
    uneven: float
    """Its largest size along the line as a share of the highest force; 0 where noise makes as much."""

    @property
    def seen(self) -> bool:
        """Whether the cell drifts by more than the noise of one sample; at rest it is a mean of many."""
        return abs(self.gone) > self.noise

    def doubts(self, e: Estimate) -> list[Doubt]:
        """Their effects on m or c, as far as the choices in its method part do not hold them."""
        of = "mc".index(e.symbol)
        beyond = max(0.0, BEYOND * abs(self.even[of]) - (e.parts.method or 0.0))
        return [
            Doubt(LATE, "method", abs(self.late[of]), seen=False),
            Doubt(DRIFT, "drift", abs(self.drift[of]), self.seen),
            Doubt(BRANCHES, "method", beyond, self.uneven > 0),
        ]

    def lines(self, line: Terms) -> list[Terms]:
        """Lines that each of them allows in place of `line`."""
        m, c = line
        return [(m + more, c + higher) for more, higher in (self.late, self.drift, self.even)]

    def findings(self, where: str, m: float) -> list[Finding]:
        """A drift that is seen, and branches that make another slope than `m` [N/Pa] where they count alike."""
        found = []
        if self.seen:
            text = (
                f"{where}: the force cell drifts: at rest it reads {show(abs(self.gone), 'force', 2)} "
                f"{'more' if self.gone > 0 else 'less'} after the ramps than before; the intervals of slope and "
                "intercept hold it. Let the cell warm up, and measure again"
            )
            found.append(Finding("doubt", text))
        if self.uneven > UNEVEN:
            slopes = [show(one, "force per pressure", 3) for one in (m, m + self.even[0])]
            text = (
                f"{where}: rising and falling pressure are not sampled alike: the line through all samples has "
                f"{slopes[0]}, the mean of a line through each {slopes[1]}; the intervals hold both. Ramp both ways at "
                "one rate"
            )
            found.append(Finding("note", text))
        return found


def departures(tests: Sequence[Test], used: Used, line: Terms) -> Departures:
    """Of the tests at one contraction, with the line through their `used` samples."""
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
        *_even(parts, line),
    )


def _open(run: RunData) -> float:
    """By how much the force may be late against the pressure, or early [s], as far as the record says."""
    return max(lag_open(run, name) for name in ("force", "pressure"))


def _change(parts: Sequence[tuple[Test, Mask]], forces: Sequence[Array]) -> Terms:
    """What `forces` [N], for each test of the shape of its samples, add to the line: least squares is linear in F."""
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
    """1 for samples of a rising branch, -1 of a falling one, 0 about the turns between them; shape (n,)."""
    t, P = _blocks(test.t, test.P)
    span = float(np.ptp(P))
    turns, way = [0], 0
    for i in range(1, len(P)):
        gone = P[i] - P[turns[-1]]
        if gone * way > 0:
            turns[-1] = i  # farther on the same way
        elif abs(gone) > LEAST_LEG * span:
            turns, way = [*turns, i], int(np.sign(gone))
    found = np.zeros(len(test.t))
    for a, b in pairwise(turns):
        low, high = sorted((P[a], P[b]))
        inside = (test.t >= t[a]) & (test.t <= t[b]) & (test.P > low + TURN * span) & (test.P < high - TURN * span)
        found[inside] = np.sign(P[b] - P[a])
    return found


def _even(parts: Sequence[tuple[Test, Mask]], line: Terms) -> tuple[Terms, float]:
    """The mean of the lines through all rising and through all falling samples, less `line`; its share of the force.

    There each branch counts alike. The line through all samples leans towards the branch with more of them.
    """
    P, F = (np.concatenate([getattr(test, name)[mask] for test, mask in parts]) for name in ("P", "F"))
    way = np.concatenate([legs(test)[mask] for test, mask in parts])
    sides = [way > 0, way < 0]
    fewest = min(int(rows.sum()) for rows in sides)
    if fewest < FEWEST or any(np.ptp(P[rows]) == 0 for rows in sides):
        return (0.0, 0.0), 0.0
    fits = [np.polyfit(P[rows], F[rows], 1) for rows in sides]
    rest = max(float(np.std(F[rows] - np.polyval(fit, P[rows]))) for fit, rows in zip(fits, sides, strict=True))
    m, c = (np.mean(fits, axis=0) - line).tolist()
    size = max(abs(m * P.min() + c), abs(m * P.max() + c))
    return (m, c), float(size / F.max()) if size > SURE * rest / sqrt(fewest) else 0.0


def gone_since(test: Test) -> tuple[float, float, float] | None:
    """What the cell reads more at rest after the ramps than before [N], at most, and the middles of these times [s].

    At rest there is no pressure, and the muscle pulls nothing. None where a rest is missing, or it is stretched.
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
