"""The surface of a muscle held against the second simulated muscle: motions that it has not seen, and what it reports.

`pytest -s -m study tests/analysis/test_judged_surface.py` prints five sessions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from pmabench.analysis.surface.fit import Data, choose
from pmabench.analysis.surface.trials import Record, rows_of
from pmabench.kinds.reduce import reduce_together
from tests.analysis.judged import as_slow_runs
from tests.analysis.surface.straight import straight_form
from tests.judge.second import driven
from tests.judge.second.campaign import REAL
from tests.judge.second.muscle import heavier, power

FULL_SCALE = 1512.0
"""Force of the muscle at 600 kPa without contraction [N]."""
HELD_OUT, STRAIGHT = 0.01, 2.0
"""Error on motions at random over the full scale, and by how many times the straight form is worse."""
COVERED, FAR = 0.90, 2.0
LONG = 300.0
"""Time [s] in which creep goes on, or not, in what the force at a place may be taken for."""


@dataclass(frozen=True)
class Judged:
    """What became of a session."""

    errors: tuple[tuple[float, float], ...]
    """Of the surface and of the straight form, for each motion [N]."""
    scores: tuple[float, ...]
    """Distance of each reported F and K from the truth, in half widths."""
    asked: int


@cache
def judged(seed: int) -> Judged:
    tests, motions = driven.session(REAL, seed)
    fitted, unseen = [_rows(one) for one in tests], [_rows(one) for one in motions]
    muscle = choose(Data.of(fitted)).muscle
    errors = tuple(
        (_rms(muscle.force([one]) - one.F), _rms(straight - one.F))
        for one, straight in zip(unseen, straight_form(fitted, unseen), strict=True)
    )
    analysis = reduce_together("surface", as_slow_runs(tests))[0]
    values = [e for e in analysis.estimates if e.symbol in ("F", "K") and "contraction" in e.at]
    scores = []
    for e in values:
        if e.value is None or e.parts.combined is None:
            continue
        low, high = right(e.symbol, e.at["pressure"], e.at["contraction"])
        scores.append(max(low - e.value, e.value - high, 0.0) / e.parts.combined)
    return Judged(errors, tuple(scores), len(values))


def right(symbol: str, pressure: float, contraction: float) -> tuple[float, float]:
    """Least and greatest value that is right: force and tangent of the middle of long strokes, crept or not."""
    P, x = np.array(pressure), np.array(contraction)
    share = REAL.creep * float(heavier(REAL.mean(x, P)) * power(np.array(LONG)))
    if symbol == "F":
        ends = float(REAL.mean(x, P)), float(REAL.mean(x * (1 - share), P))
    else:
        ends = float(REAL.tangent(x, P)), float(REAL.tangent(x * (1 - share), P)) * (1 - share)
    return min(ends), max(ends)


def _rows(one: driven.Record) -> Record:
    rows = rows_of(one.t, one.pressure, one.displacement, one.force, np.ones(len(one.t), bool))
    place = ", ".join(f"{name} {value:g}" for name, value in one.point.items())
    return Record(f"{one.kind} {place}", f"{one.kind} {place}", *rows, rows[3] > 5.0)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def check(one: Judged) -> None:
    assert max(surface for surface, _ in one.errors) <= HELD_OUT * FULL_SCALE
    assert len(one.scores) > 0.5 * one.asked
    assert max(one.scores) <= FAR


def ratio(found: list[Judged]) -> float:
    """By how many times the straight form is worse, over all motions."""
    surface, straight = np.mean(np.square([pair for one in found for pair in one.errors]), axis=0)
    return float(np.sqrt(straight / surface))


@pytest.mark.study
def test_five_sessions_of_another_family_of_muscle():
    found = [judged(seed) for seed in range(5)]
    for one in found:
        errors = ", ".join(f"{a:.1f} ({b:.1f})" for a, b in one.errors)
        inside = np.mean(np.array(one.scores) <= 1)
        print(
            f"N {errors}; {100 * inside:.0f} % of {len(one.scores)} values of {one.asked}, worst {max(one.scores):.2f}"
        )
    assert np.mean([score <= 1 for one in found for score in one.scores]) >= COVERED
    assert ratio(found) >= STRAIGHT
    for one in found:
        check(one)
