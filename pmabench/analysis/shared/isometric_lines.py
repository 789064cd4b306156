"""Lines F = m P + c at set contractions: tests, the line through all their samples, its intervals and estimates.

The caller chooses which samples are used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import student
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.samples import NotUsable, ends, noise_of, refuse_incomplete, refuse_missing
from pmabench.analysis.shared.trials import grouped, mean_over_sessions, measured_trials, session_of
from pmabench.store.analyses.results import Dropped, Estimate, Parts
from pmabench.store.records import Array, RunData, TrialData

METHOD = "isometric-line"
FEWEST = 50
"""Fewest samples for a line."""
FEWEST_STEPS = 5
"""Fewest successive commands of one phase that count as a staircase."""
PLACES = 9
"""Number of pressures along a line for which forces are given."""
SAME = 4
"""Decimals [m] to which contractions are compared."""
AROUND, ALONE = 3, 4.0
"""Neighbours on either side of a single sample, and by how many standard deviations of noise they must be lower."""
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Test:
    """Usable samples of one trial in the wanted phases; arrays of shape (n,), SI."""

    run: RunData
    trial: TrialData
    t: Array
    P: Array
    F: Array
    x: Array
    """Displacement [m]; NaN where it was not recorded."""
    phase: Array
    """Index into the phase names, shape (n,); -1 where none is known."""

    @property
    def name(self) -> str:
        """`run/index`."""
        return self.trial.name

    @cached_property
    def noise(self) -> float:
        """Of the force [N]."""
        return noise_of(self.F)

    def above(self, least: float) -> Mask:
        """Samples with more force than `least` [N], without single ones whose neighbours in time are far below it."""
        over = np.pad(self.F > least, 1)
        found = over[1:-1]
        for i in np.flatnonzero(found & ~over[:-2] & ~over[2:]):
            near = np.append(self.F[max(0, i - AROUND) : i], self.F[i + 1 : i + 1 + AROUND])
            found[i] = np.median(near) >= least - ALONE * self.noise
        return found


Used = Callable[[Test], Mask]
"""Returns the mask of the samples of a test that enter the line, shape (n,)."""
Groups = dict[float, list[Test]]
"""Contraction [m] -> its tests."""


@dataclass(frozen=True)
class Line:
    """F = m P + c."""

    m: float
    c: float
    n: int
    r2: float
    rms: float
    low: float
    high: float
    """Range of pressures [Pa]."""

    def __call__(self, P: Array) -> Array:
        """F [N] at P [Pa]."""
        return np.asarray(self.m * P + self.c)


@dataclass(frozen=True)
class Pooled:
    """Line through the samples of all tests at one contraction, and the line of each test that has one."""

    line: Line
    each: tuple[Line, ...]
    names: tuple[str, ...]
    """Names of the tests in `each`."""
    repeats: tuple[tuple[float, float], ...]
    """m and c of each repeat: mean of both sides where the contraction was reached from both, else of one test."""
    sessions: tuple[str, ...]
    """The session of each repeat."""

    def half(self, of: str) -> float | None:
        """95 % half width of `m` or `c` from the scatter between sessions, or repeats of one session; or None."""
        return mean_over_sessions([pair["mc".index(of)] for pair in self.repeats], self.sessions)[1]

    @property
    def mean(self) -> tuple[float, float]:
        """M and c as the mean of the sessions' means: each session counts alike, however many samples it has."""
        m, c = (mean_over_sessions([pair[i] for pair in self.repeats], self.sessions)[0] for i in (0, 1))
        return m, c


def spread(values: Sequence[float] | Array) -> float | None:
    """Half width of the 95 % interval of the mean of repeats by Student's t; None for fewer than two."""
    n = len(values)
    return float(student.ppf(0.975, n - 1) * np.std(values, ddof=1) / sqrt(n)) if n > 1 else None


def tests_of(
    runs: Sequence[RunData], phases: Sequence[str], check: Callable[[Test], None]
) -> tuple[Groups, list[Dropped]]:
    """Usable tests by contraction, and the other trials; `check` raises `NotUsable` for a test that lacks something."""

    def usable(run: RunData, trial: TrialData) -> Test:
        test = as_test(run, trial, phases)
        check(test)
        return test

    tests, dropped = measured_trials(runs, usable)
    return grouped(tests, lambda test: round(test.trial.point["contraction"], SAME)), dropped


def as_test(run: RunData, trial: TrialData, phases: Sequence[str]) -> Test:
    """The test of a trial; raises `NotUsable`."""
    refuse_missing(trial, "pressure", "force")
    if "contraction" not in trial.point:
        where = "under `trials` of the map, or as {contraction} in `name_tells`"
        raise NotUsable(f"nothing says at which contraction it was held: give `point: {{contraction: 4 mm}}` {where}")
    refuse_incomplete(trial)
    phase = stairs(trial, phases)
    phase = _phase_of(run, trial, phases) if phase is None else phase
    wanted = trial.usable & ((phase >= 0) | (not phases))
    wanted &= np.isfinite(trial.channels["pressure"]) & np.isfinite(trial.channels["force"])
    P, F = trial.channels["pressure"][wanted], trial.channels["force"][wanted]
    x = trial.channels.get("displacement", np.full(len(trial.t), np.nan))[wanted]
    return Test(run, trial, trial.t[wanted], P, F, x, phase[wanted])


def stairs(trial: TrialData, phases: Sequence[str]) -> Array | None:
    """Index of the phase of each sample in the settled part of a step, -1 elsewhere; None where there is no staircase.

    A staircase has successive commands of one phase, each held for longer than its ramp takes. Samples between holds
    depend on the lags of the sensors and are left out, as is the first half of each hold. The last quarter of a hold
    before a change of phase belongs to the following phase, so that the highest hold belongs to both.
    """
    commands = [c for c in trial.commands if c.output == "pressure"]
    arrived = [ends(c) if c.data.get("rate") else c.t for c in commands]
    over = [*(c.t for c in commands[1:]), float(trial.t[-1]) if len(trial.t) else 0.0]
    in_a_row, longest = 0, 0
    for number, command in enumerate(commands):
        held = command.phase in phases and over[number] - arrived[number] > arrived[number] - command.t
        same = in_a_row > 0 and command.phase == commands[number - 1].phase
        in_a_row = (in_a_row + 1 if same else 1) if held else 0
        longest = max(longest, in_a_row)
    if longest < FEWEST_STEPS:
        return None
    index = np.full(len(trial.t), -1.0)
    for number, (command, begin, end) in enumerate(zip(commands, arrived, over, strict=True)):
        if command.phase not in phases:
            continue
        held_rows = (trial.t >= 0.5 * (begin + end)) & (trial.t < end)
        index[held_rows] = phases.index(command.phase)
        following = commands[number + 1].phase if number + 1 < len(commands) else ""
        if following in phases:
            index[held_rows & (trial.t >= 0.25 * begin + 0.75 * end)] = phases.index(following)
    return index


def _phase_of(run: RunData, trial: TrialData, phases: Sequence[str]) -> Array:
    """Index of the phase of each sample, from `phase` events of imports, else from commands; -1 in other phases.

    Without either, all samples are in the first phase.
    """
    events = [e for e in run.events if e.kind == "phase" and e.data.get("trial") == trial.index]
    begun = [(e.t, str(e.data.get("name"))) for e in events]
    if not begun:
        ramps = [c for c in trial.commands if c.kind == "ramp" and c.data.get("rate")]
        begun = [(c.t, c.phase) for c in trial.commands] + [(ends(c), "") for c in ramps]
    index = np.full(len(trial.t), -1.0 if begun else 0.0)
    for at, name in sorted(begun):
        index[trial.t >= at - 1e-9] = phases.index(name) if name in phases else -1
    return index


def line_of(P: Array, F: Array) -> Line | None:
    """Least squares of F = m P + c; None with fewer than `FEWEST` samples or a single pressure."""
    if len(P) < FEWEST or np.ptp(P) == 0:
        return None
    middle, level = float(P.mean()), float(F.mean())
    off, pull = P - middle, F - level
    # Sums and not dot products: BLAS hands these to threads, which is slow on a busy machine.
    m = float(np.sum(off * pull) / np.sum(off * off))
    residual = pull - m * off
    total = float(np.sum(pull * pull))
    r2 = 1.0 - float(np.sum(residual * residual)) / total if total > 0 else 0.0
    rms = float(np.sqrt(np.mean(residual**2)))
    return Line(m, level - m * middle, len(P), r2, rms, float(P.min()), float(P.max()))


def pool(tests: Sequence[Test], used: Used) -> Pooled | None:
    """Line through the `used` samples of all tests, and that of each; None with too few samples."""
    parts = [(test.P[mask], test.F[mask]) for test in tests for mask in [used(test)]]
    whole = _through(parts)
    if whole is None:
        return None
    with_line = [(test, line) for test, part in zip(tests, parts, strict=True) if (line := line_of(*part)) is not None]
    tests_with, each = [test for test, _ in with_line], tuple(line for _, line in with_line)
    m, c = (by_repeat(tests_with, [getattr(line, of) for line in each]).tolist() for of in ("m", "c"))
    sessions = tuple(session_of(tests_with[places[0]].run) for places in _repeats(tests_with))
    return Pooled(whole, each, tuple(test.name for test in tests_with), tuple(zip(m, c, strict=True)), sessions)


def _through(parts: Sequence[tuple[Array, Array]]) -> Line | None:
    """Line through all pressures and forces together; None with too few samples."""
    return line_of(np.concatenate([P for P, _ in parts]), np.concatenate([F for _, F in parts]))


def _repeats(tests: Sequence[Test]) -> list[list[int]]:
    """Indices of the tests of each repeat: both sides where the contraction was reached from both, else one test."""

    def repeat(place: int) -> object:
        test = tests[place]
        return (test.run.id, test.trial.repeat) if "side" in test.trial.point else place

    return list(grouped(range(len(tests)), repeat).values())


def by_repeat(tests: Sequence[Test], values: Sequence[float] | Array) -> Array:
    """Mean of the values of each repeat: over both sides where the contraction was reached from both, else one."""
    return np.array([np.mean([float(values[place]) for place in places]) for places in _repeats(tests)])


def branches(tests: Sequence[Test], used: Used, phases: Sequence[str]) -> dict[str, float]:
    """Phase -> slope [N/Pa] of the line through its samples, where it has one."""
    found = {}
    for index, name in enumerate(phases):
        masks = [used(test) & (test.phase == index) for test in tests]
        line = _through([(test.P[mask], test.F[mask]) for test, mask in zip(tests, masks, strict=True)])
        if line is not None:
            found[name] = line.m
    return found


def estimates_of(
    pooled: Pooled,
    tests: Sequence[Test],
    at: Mapping[str, float],
    method: str = METHOD,
    others: Sequence[tuple[float, float]] = (),
) -> tuple[Estimate, Estimate]:
    """The slope m [N/Pa] and the intercept c [N] with the interval parts of repeats and calibration.

    The method part is the largest distance from `others`: m and c of equally justified lines, through other samples or
    with other weights.
    """
    line = pooled.line
    scales = Scales.of([test.run for test in tests])
    note = "no repeats part: one test only" if len(pooled.repeats) < 2 else ""
    parents = tuple(test.name for test in tests)

    def estimate(symbol: str, unit: str, quantity: str, coordinate: str, calibration: float | None) -> Estimate:
        value = float(getattr(line, symbol))
        other = max((abs(pair["mc".index(symbol)] - value) for pair in others), default=None)
        parts = Parts(repeats=pooled.half(symbol), method=other, calibration=calibration)
        return Estimate(
            symbol, value, unit, quantity, method, at, parts, len(pooled.each), note=note, trials=parents,
            coordinate=coordinate,
        )  # fmt: skip

    slope = scales.part({"force": line.m, "pressure": line.m})
    start = scales.part({"force": line.c}, {"force": 1.0, "pressure": line.m})
    m = estimate("m", "N/Pa", "force per pressure", "slope", slope)
    return m, estimate("c", "N", "force", "intercept", start)


def forces_of(pooled: Pooled, tests: Sequence[Test], others: Sequence[tuple[float, float]]) -> list[list[float | None]]:
    """Rows of P [Pa], F [N] and the parts of F for repeats, method and calibration, along the line.

    Errors of m and c are correlated, so the interval of F is narrower. `others` as in `estimates_of`.
    """
    line, scales = pooled.line, Scales.of([test.run for test in tests])
    rows: list[list[float | None]] = []
    for P in np.linspace(line.low, line.high, PLACES).tolist():
        F = line.m * P + line.c
        half = mean_over_sessions([m * P + c for m, c in pooled.repeats], pooled.sessions)[1]
        other = max((abs(m * P + c - F) for m, c in others), default=None)
        part = scales.part({"force": F, "pressure": line.m * P}, {"force": 1.0, "pressure": line.m})
        rows.append([P, F, half, other, part])
    return rows
