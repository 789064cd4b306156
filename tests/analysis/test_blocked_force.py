"""Blocked force from isometric tests at no contraction, against the muscle that made the samples."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.isometric_pressurisation.reduction import reduce
from tests.analysis.test_isometric_pressurisation import daerden, run_of

EPS = (0.0, 0.05, 0.1)


def muscle(P, x):
    """F = F_ce - K x of plant 5.1 with a constant stiffness: F_ce = 1.08 P - 49 N, K = 7 N/mm."""
    return np.maximum(1.08e-3 * P - 49.0 - 7000.0 * x, 0.0)


def blocked(run):
    return {e.at["pressure"]: e for e in reduce([run]).estimates if e.symbol == "F_b"}


@pytest.mark.parametrize("of", [muscle, daerden])
def test_it_is_what_the_muscle_pulls_with_at_its_nominal_length(of):
    found = blocked(run_of(of, EPS, noise=1.0))
    assert sorted(found) == [5e4 * n for n in range(1, 11)]
    for P, e in found.items():
        truth = float(of(np.array([P]), 0.0)[0])
        assert e.value == pytest.approx(truth, abs=1.0), P  # at 50 kPa it has just begun to pull
        assert abs(e.value - truth) < e.parts.combined, P
        assert len(e.trials) == 2
        assert e.parts.repeats is not None


def test_filling_and_emptying_count_alike():
    """A branch that lies 4 N higher and one that lies 4 N lower leave the mean."""
    found = blocked(run_of(muscle, EPS, lag=8.0))
    assert found[3e5].value == pytest.approx(275.0, abs=0.1)


def test_what_the_muscle_was_off_its_nominal_length_is_in_the_method_part():
    """0.5 mm of contraction are worth K times that, 3.5 N."""
    found = blocked(run_of(muscle, (0.0025, 0.05, 0.1)))  # 0.5 mm of 200 mm: within 1 % of it
    assert found[4e5].value == pytest.approx(383.0 - 3.5, abs=0.1)
    assert found[4e5].parts.method == pytest.approx(3.5, rel=0.02)


def test_between_contractions_on_both_sides_of_0_it_is_on_a_parabola():
    """F = F_ce - K x is a line; with a bend of 2 N/mm^2 a line between -2 and 2 mm is 8 N off, and the part says so."""
    eps = (-0.01, 0.01, 0.05)
    e = blocked(run_of(muscle, eps))[4e5]
    assert e.value == pytest.approx(383.0, abs=0.1)
    assert e.parts.method < 0.1
    e = blocked(run_of(lambda P, x: muscle(P, x) + 2e6 * x**2 * (P > 1e5), eps))[4e5]
    assert e.value == pytest.approx(383.0, abs=0.1)
    assert e.parts.method == pytest.approx(8.0, rel=0.02)
    assert "both sides of 0" in e.note
    found = blocked(run_of(daerden, (-0.01, 0.01, 0.03, 0.06)))  # the rubber term has its pole at -4 %
    for P in (2e5, 4e5):
        assert abs(found[P].value - float(daerden(np.array([P]), 0.0)[0])) < found[P].parts.method


def test_scales_count_by_what_they_change():
    """1 % of force is 1 % of F_b; 5 kPa of pressure are dF/dP = 1.08 N/kPa times that."""
    run = run_of(muscle, EPS)
    louder = replace(run.channels["force"], gain_uncertainty=0.01)
    off = replace(run.channels["pressure"], offset_uncertainty=5e3)
    one = blocked(replace(run, channels={**run.channels, "force": louder}))[2e5]
    assert one.parts.calibration == pytest.approx(1.67, rel=1e-3)
    two = blocked(replace(run, channels={**run.channels, "pressure": off}))[2e5]
    assert two.parts.calibration == pytest.approx(5.4, rel=1e-3)
    assert "no calibration part" in blocked(run)[2e5].note


def test_without_a_test_at_no_contraction_there_is_none():
    assert not blocked(run_of(muscle, (0.05, 0.1, 0.15)))
