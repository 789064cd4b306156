"""K and B of steps at the same pressures under two known loads or more: a secant between their places of rest.

At rest F_ce(P) = W + K x, so that two loads W at one pressure give K = -(W2 - W1)/(x2 - x1). It is the stiffness
between the two places, not the tangent at one of them. Knows measured steps and B/K.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot

import numpy as np

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.student import mean_with_half
from pmabench.base.quantities import show
from pmabench.kinds.recorded_step.step import AFTER, SEEN, Step
from pmabench.store.analyses.results import Estimate, Parts
from pmabench.store.records import RunData

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
    for pair, group in sorted(groups.items()):
        K = secant(pair, rests_of([step for _, step in group]), Scales.of([run for run, _ in group]))
        if K is not None:
            found += [K, *_damping(K, estimates)]
    return found


def _times(parts: Parts, factor: float) -> Parts:
    """Parts of a value times a factor."""
    repeats, method, calibration = (
        None if part is None else abs(factor) * part for part in (parts.repeats, parts.method, parts.calibration)
    )
    return Parts(repeats, method, calibration, abs(factor) * parts.skew, abs(factor) * parts.drift)


def _damping(K: Estimate, estimates: Sequence[Estimate]) -> list[Estimate]:
    """B [N.s/m] of the direction of the steps: B/K times K."""
    at = dict(K.at)
    taus = [e for e in estimates if e.symbol in ("tau_c", "tau_r") and e.value and at.items() <= e.at.items()]
    if not taus or K.value is None:
        return []
    values = [e.value or 0.0 for e in taus]
    tau = float(np.mean(values))
    widest = max(taus, key=lambda e: e.parts.combined or 0.0).parts
    of_K, of_tau = _times(K.parts, tau), _times(widest, K.value)
    known = of_K.repeats is not None and of_tau.repeats is not None
    repeats = hypot(of_K.repeats or 0.0, of_tau.repeats or 0.0) if known else None
    apart = K.value * max(abs(value - tau) for value in values)
    method = float(np.linalg.norm([of_K.method or 0.0, of_tau.method or 0.0, apart]))
    symbol = taus[0].symbol.replace("tau", "B")
    names = tuple(name for e in taus for name in e.trials)
    parts = Parts(repeats, method, of_K.calibration)
    note = "B/K of the driven motion times the secant K"
    return [Estimate(symbol, tau * K.value, "N.s/m", "damping", SECANT, at, parts, len(names), note=note, trials=names)]
