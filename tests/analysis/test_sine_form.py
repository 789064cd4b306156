"""Driven sines test the straight form by the higher harmonics of the force; the truth is a closed form in sine_rig."""

from __future__ import annotations

from math import pi
from pathlib import Path

import pytest

from pmabench.kinds.reduce import verdicts
from pmabench.kinds.sinusoidal_displacement.reduction import reduce
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import TrialData
from tests.analysis.driven_runs import recorded
from tests.analysis.loop_rig import as_run
from tests.analysis.sine_rig import Muscle51, value

NOISE = (2e-6, 0.3, 500.0)
K, F_MEAN = 6773.0, 275.0 - 67.73
C = 2e5
"""A curve that is bent by 20 N/m per mm; at x = 0, 10 mm from the mean, that is 20 N."""


def reduced(trials: list[TrialData]) -> Analysis:
    return reduce([as_run("sinusoidal-displacement", trials, {"discard": 1})])


def withheld(analysis: Analysis) -> set[str]:
    return {e.symbol for e in analysis.estimates if e.withheld}


@pytest.mark.parametrize("muscle", [Muscle51(), Muscle51(F_s=10.0, F_c=6.0, noise=NOISE, lag=0.005)])
def test_a_straight_muscle_is_not_withheld(muscle: Muscle51) -> None:
    found = reduced(muscle.trials(repeats=2, mean=0.004))
    assert withheld(found) == set()
    assert not any("bent" in finding.text for finding in found.findings)
    assert verdicts([], [found]) == []
    assert value(found, "F_ce", "sine-mean").parts.combined < 2.5
    assert value(found, "K", "sine-harmonic").parts.combined < 0.005 * K


def test_the_straight_line_through_a_bent_curve_gives_no_f_ce() -> None:
    """275 N is what the line gives at x = 0; the curve has 275 + 0.2 N/mm2 (10 mm)^2 = 295 N there."""
    found = reduced(Muscle51(F_c=6.0, noise=NOISE, bend=(C, 0.0)).trials(repeats=2))
    assert withheld(found) == {"F_ce"}
    note = value(found, "F_ce", "sine-mean").note
    assert "2 amplitudes from the mean of these sines, beyond what they measured" in note
    assert "isobaric" in note
    (sentence,) = verdicts([], [found])
    assert sentence.startswith("F_ce at pressure 300 kPa")
    stiffness, force = value(found, "K", "sine-harmonic"), value(found, "F", "sine-mean")
    assert abs(stiffness.value - K) < stiffness.parts.combined, "the tangent at the mean is untouched by c"
    assert abs(force.value - F_MEAN) < force.parts.combined < 3.0
    assert found.facts["lines"][0]["h2/h1"] == pytest.approx(C * 0.005**2 / 2 / (K * 0.005), rel=0.02)


def test_where_0_lies_inside_the_stroke_a_small_bend_is_taken_off_and_a_large_one_withholds() -> None:
    """About x = 0 the mean force is c A^2/2 above F(0) = 275 N: 0.5 N with h2/h1 = 1.5 %, 2.5 N with 7 %."""
    small = value(reduced(Muscle51(noise=NOISE, bend=(C / 5, 0.0)).trials(repeats=2, mean=0.0)), "F_ce", "sine-mean")
    assert abs(small.value - 275.0) < 0.1 < small.parts.combined < 1.5
    found = reduced(Muscle51(noise=NOISE, bend=(C, 0.0)).trials(repeats=2, mean=0.0))
    large, there = value(found, "F_ce", "sine-mean"), value(found, "F", "sine-mean")
    assert large.withheld
    assert "second harmonic 7.4%" in large.note
    assert abs(there.value - 275.0) < there.parts.combined < 2.0, "as the force at the mean it is corrected"


def test_a_stiffness_that_changes_along_the_stroke_is_given_at_its_middle() -> None:
    """d u^3 with d A^2 = K/4: the first harmonic gives K - 3/4 d A^2, 19 % less than the tangent."""
    found = reduced(Muscle51(noise=NOISE, bend=(0.0, K / 4 / 0.005**2)).trials())
    assert withheld(found) == {"F_ce"}
    stiffness = value(found, "K", "sine-harmonic")
    assert abs(stiffness.value - K) < 0.01 * K
    assert 0.03 * K < stiffness.parts.combined < 0.1 * K
    assert "third 7.7% of the first" in stiffness.note


def test_a_friction_that_has_to_be_wound_up_is_neither_stiffness_nor_coulomb() -> None:
    """20 N that slip after 4 mm: along 2 x 5 mm the first harmonic holds a part of 5 N/mm."""
    found = reduced(Muscle51(noise=NOISE, slip=(20.0, 0.004)).trials())
    assert withheld(found) >= {"K", "F_c"}
    assert "the friction is not constant along the stroke" in value(found, "K", "sine-harmonic").note
    assert "the friction is not constant along the stroke" in value(found, "F_c", "sine-harmonic").note


def test_one_frequency_leaves_a_bend_and_unlike_dampings_together() -> None:
    """At 3 Hz the dampings make a second harmonic of (B_r - B_c)/2 omega A 4/(3 pi) = 9 N: no bend is claimed."""
    found = reduced([Muscle51(noise=NOISE).trial(i, 3.0, 31, mean=0.004) for i in range(3)])
    F_ce = value(found, "F_ce", "sine-mean")
    assert not F_ce.withheld
    assert abs(F_ce.value - 275.0) < F_ce.parts.combined
    assert F_ce.parts.method > 1900 * 6 * pi * 0.005 / pi


def test_paper_3s_sines_on_the_curve_of_its_own_muscle_give_no_f_ce(tmp_path: Path) -> None:
    """On mock-daerden the line gave 909 +- 7 N at 3 bar, where the curve has 773 N."""
    kept = [("pressure", "3 bar", "5 bar"), ("frequency", "0.2 Hz", "0.2 Hz"), ("amplitude", "23 mm", "23 mm")]
    first = [(f"sweep.concat.0.zip.{name}", f"[{one}]") for name, one, _ in kept]
    second = [(f"sweep.concat.1.zip.{name}", f"[{one}]") for name, _, one in kept]
    run = recorded(tmp_path, "sinusoidal-displacement-paper3", "mock-daerden", "daerden-20-200", *first, *second)
    found = reduce([run])
    assert withheld(found) >= {"K", "F_ce"}
    assert [e.at["pressure"] for e in found.estimates if e.symbol == "F_ce" and e.withheld] == [3e5, 5e5]
    assert any(sentence.startswith("F_ce at pressure 300 kPa") for sentence in verdicts([run], [found]))


@pytest.mark.parametrize(("height", "way", "mean", "amplitude"), [(3.0, 3e-3, 0.005, 0.008), (8.0, 2e-4, 0.009, 0.01)])
def test_friction_that_builds_up_is_in_the_force_that_k_carries_to_0(
    height: float, way: float, mean: float, amplitude: float
) -> None:
    """It adds to K, over the mean: F_ce was 1.4 N too large with +- 0.1 N where K itself is withheld, 2.1 N with 0.2."""
    muscle = Muscle51(B_r=1680.0, noise=NOISE, slip=(height, way))
    F_ce = value(reduced(muscle.trials(mean=mean, amplitude=amplitude)), "F_ce", "sine-mean")
    assert abs(F_ce.value - 275.0) < F_ce.parts.combined < 6.0


def test_friction_that_takes_most_of_the_stroke_to_build_up_is_no_stiffness() -> None:
    """5 N that slip after 12 mm of 16: the third harmonic says so, and the force at x = 0 holds what it adds to K.

    K was 7.6 N/mm +- 0.06 for 6.8, F_ce 279 N +- 0.14 for 275.
    """
    found = reduced(Muscle51(B_c=1200.0, B_r=1200.0, noise=NOISE, slip=(5.0, 6e-3)).trials(mean=0.005, amplitude=0.008))
    assert withheld(found) >= {"K", "F_c"}
    F_ce = value(found, "F_ce", "sine-mean")
    assert abs(F_ce.value - 275.0) < F_ce.parts.combined < 6.0
