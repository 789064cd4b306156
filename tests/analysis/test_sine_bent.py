"""Sines on the bent curve of plant 5.5, in closed form: force and stiffness at the mean, or the reason why not.

`pytest -s -m study tests/analysis/test_sine_bent.py` counts how many intervals hold the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.sinusoidal_displacement.reduction import reduce
from pmabench.store.analyses.results import Analysis, Estimate
from tests.analysis.judged_forms import as_run, as_trials
from tests.judge import daerden
from tests.judge.daerden import force, stiffness

MM = 1e-3


def reduced(P: float, cells: Sequence[tuple[float, float]], seed: int = 1, friction: float = 0.0) -> Analysis:
    """Of sines with these means and amplitudes [mm]."""
    trials = [
        one for mean, amplitude in cells for one in daerden.campaign(P, mean * MM, amplitude * MM, seed, friction)
    ]
    sines = [
        replace(one, index=n, commands=tuple(
            replace(c, kind="sine", data={"amplitude": one.point["amplitude"], "frequency": one.point["frequency"],
                                          "cycles": one.point["cycles"]}) for c in one.commands))
        for n, one in enumerate(as_trials(trials))
    ]  # fmt: skip
    return reduce([as_run("sinusoidal-displacement", sines, daerden.RATE, {"discard": 1})])


def pooled(analysis: Analysis, symbol: str) -> list[Estimate]:
    """Values over all frequencies, by the harmonics."""
    return [
        e for e in analysis.estimates if e.symbol == symbol and "frequency" not in e.at and e.method != "loop-width"
    ]


def share(e: Estimate, truth: float) -> float:
    """Distance from the truth in half widths."""
    return abs((e.value or 0.0) - truth) / (e.parts.combined or 1e-9)


@pytest.mark.parametrize(("P", "eps", "expected"), [
    (5e5, -0.03, 2061), (5e5, 0.0, 1288), (5e5, 0.05, 942), (5e5, 0.10, 700), (5e5, 0.20, 320), (3e5, 0.0, 773),
])  # fmt: skip
def test_the_curve_is_that_of_the_plant(P: float, eps: float, expected: float) -> None:
    assert float(force(eps * daerden.LENGTH, P)) == pytest.approx(expected, abs=1.0)
    h = 1e-6
    slope = float(force(0.017 + h, P) - force(0.017 - h, P)) / (2 * h)
    assert stiffness(0.017, P) == pytest.approx(-slope, rel=1e-6)


@pytest.mark.parametrize(("P", "amplitude", "K_A", "h2", "h3"), [
    (3e5, 23.0, 20.5, 0.35, 0.21), (5e5, 23.0, 30.3, 0.25, 0.14),
])  # fmt: skip
def test_a_large_sine_gives_the_stiffness_over_its_stroke_with_its_harmonics_and_nothing_at_a_point(
    P: float, amplitude: float, K_A: float, h2: float, h3: float
) -> None:
    found = reduced(P, [(17.0, amplitude)])
    assert all(e.withheld for symbol in ("K", "F", "F_ce") for e in pooled(found, symbol))
    (over,) = pooled(found, "K_A")
    assert over.value == pytest.approx(1e3 * K_A, rel=5e-3)
    assert f"second harmonic {100 * found.facts['lines'][0]['h2/h1']:.1f}%" in over.note
    assert found.facts["lines"][0]["h2/h1"] == pytest.approx(h2, abs=6e-3)
    assert abs(found.facts["lines"][0]["h3/h1"]) == pytest.approx(h3, abs=6e-3)


@pytest.mark.parametrize(("P", "amplitude", "K", "F", "friction"), [
    (3e5, 10.0, 13.33, 431.0, 0.0), (3e5, 2.0, 13.33, 431.0, 6.0), (5e5, 10.0, 23.10, 767.3, 6.0),
    (5e5, 2.0, 23.10, 767.3, 0.0),
])  # fmt: skip
def test_a_small_sine_gives_force_and_stiffness_at_its_mean_and_no_f_ce(
    P: float, amplitude: float, K: float, F: float, friction: float
) -> None:
    """Within 0.3 % and 0.3 N where there is no friction; what friction may add to a third harmonic is in the interval."""
    found = reduced(P, [(17.0, amplitude)], friction=friction)
    (stiff,), (pull,), (F_ce,) = (pooled(found, symbol) for symbol in ("K", "F", "F_ce"))
    assert abs(stiff.value - 1e3 * K) < max(3e-3 * 1e3 * K + 10.0, stiff.parts.combined)
    assert share(stiff, stiffness(0.017, P)) < 1.0
    assert stiff.parts.combined < (0.025 if friction == 0.0 or amplitude > 5.0 else 0.06) * stiff.value
    assert abs(pull.value - F) < 0.5
    assert share(pull, float(force(0.017, P))) < 1.0
    assert pull.parts.combined < 0.025 * F
    assert F_ce.value is None
    assert "amplitudes from the mean" in F_ce.note


@pytest.mark.parametrize(("P", "cells"), [
    (3e5, ((4.0, 4.0), (12.0, 4.0), (20.0, 4.0))),
    (5e5, ((5.0, 5.0), (15.0, 5.0), (25.0, 5.0))),
    (3e5, ((2.0, 2.0), (6.0, 2.0), (10.0, 2.0))),
])  # fmt: skip
def test_a_curve_bent_near_0_gives_no_f_ce_about_whatever_means(
    P: float, cells: tuple[tuple[float, float], ...]
) -> None:
    """The second harmonic of the sine that holds x = 0 is 6 to 9 % there; K and F are given at each mean."""
    found = reduced(P, cells)
    given = pooled(found, "F_ce")
    assert len(given) == len(cells)
    assert all(e.value is None for e in given)
    assert given[0].withheld
    assert "2% is accepted" in given[0].note
    assert len(pooled(found, "F")) == len(cells)


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_intervals_on_bent_curves_hold_the_truth() -> None:
    scores: dict[str, list[float]] = {"K": [], "F": []}
    for seed in range(20):
        for P in (2e5, 3e5, 5e5):
            for friction in (0.0, 6.0, 15.0):
                cells = [(1.0 * n * a, 1.0 * a) for a in (2.0, 4.0, 6.0) for n in (1, 3, 5)]
                for three in (cells[:3], cells[3:6], cells[6:]):
                    found = reduced(P, three, seed, friction)
                    for symbol, of in (("K", stiffness), ("F", lambda x, P: float(force(x, P)))):
                        scores[symbol] += [
                            share(e, of(e.at["mean"], P)) for e in pooled(found, symbol) if e.value is not None
                        ]
                    assert all(e.value is None for e in pooled(found, "F_ce"))
    for symbol, of in scores.items():
        held = float(np.mean(np.array(of) <= 1))
        print(f"\n{symbol}: {len(of)} values, {held:.3f} hold the truth, worst {max(of):.2f} half widths", end="")
        assert held >= 0.93
        assert max(of) < 2.0
