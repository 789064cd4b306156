"""A whole campaign of a muscle with hysteresis and creep: what it predicts of motion at random, and what it reports.

Expected values are the plant's own closed forms; the limits are those of a published prototype on the same campaign.
"""

import time
from functools import cache

import numpy as np
import pytest

from pmabench.analysis.surface.fit import Data, choose
from pmabench.analysis.surface.muscle import CREEP_X, STOPS_P, STOPS_X
from tests.analysis.surface.braided import FULL, Braided, stiffness, surface
from tests.analysis.surface.campaign import record_of, wandering
from tests.analysis.surface.straight import straight_form
from tests.analysis.surface.test_fit import records

EVERY = ("ramp", "fill", "sine", "stroke")


@cache
def found(seed):
    fitted = records(Braided(), seed, 0.3, EVERY)
    start = time.process_time()
    choice = choose(Data.of(fitted))
    return fitted, choice, time.process_time() - start


def errors(seed):
    """Rms error on three records of motion at random as shares of the full scale: of the muscle, of the straight form."""
    rng = np.random.default_rng(1000 + seed)
    fitted, choice, _ = found(seed)
    held = [record_of(Braided(), wandering(rng), rng, goes_on=False) for _ in range(3)]
    own = [choice.muscle.force([one]) for one in held]
    both = zip(own, straight_form(fitted, held), held, strict=True)
    return [[np.sqrt(np.mean((F - r.F)[r.used] ** 2)) / FULL for F in pair] for *pair, r in both]


def test_motion_at_random_is_predicted_to_a_fifth_of_a_percent_of_full_scale():
    for own, straight in errors(0):
        assert own <= 0.002
        assert 0.015 <= straight <= 0.04, "the straight form should be off by about 2.7 %"


def test_the_terms_that_the_muscle_has_are_found_and_no_others():
    assert set(found(0)[1].terms[2:]) == {STOPS_X, STOPS_P, CREEP_X}
    assert found(0)[1].undecided == ()


def test_tangent_stiffness_and_force_are_those_of_the_surface():
    muscle = found(0)[1].muscle
    P, x = (grid.ravel() for grid in np.meshgrid([200e3, 350e3, 500e3], [5e-3, 15e-3, 25e-3]))
    assert muscle.stiffness(P, x) == pytest.approx(stiffness(x, P), rel=0.02)
    assert muscle.static(P, x) == pytest.approx(surface(x, P), abs=4.0)


def test_loops_and_creep_are_those_of_the_plant():
    """Gap at the centre and area of the second cycle, P 500 kPa, from the widths and weights of the plant's stops."""
    muscle = found(0)[1].muscle
    for amplitude, gap, area in ((5e-3, 48.01, 0.356), (10e-3, 51.02, 0.884), (20e-3, 60.0, 2.084)):
        assert muscle.gap(500e3, amplitude) == pytest.approx(gap, rel=0.15)
        assert muscle.area(500e3, amplitude) == pytest.approx(area, rel=0.05)
    assert muscle.creep_per_decade(1.0, 100.0) == pytest.approx(0.008, rel=0.25)
    assert muscle.pressure_gap(10e-3, 200e3) == pytest.approx(36.0, rel=0.35)


def test_a_campaign_takes_less_than_five_seconds_of_one_core():
    assert found(0)[2] < 5.0


@pytest.mark.study
@pytest.mark.parametrize("seed", range(1, 6))
def test_study_five_campaigns_and_three_records_of_each(seed):
    for own, straight in errors(seed):
        assert own <= 0.002
        assert straight >= 5 * own
    muscle = found(seed)[1].muscle
    P, x = (grid.ravel() for grid in np.meshgrid([200e3, 350e3, 500e3], [5e-3, 15e-3, 25e-3]))
    assert muscle.stiffness(P, x) == pytest.approx(stiffness(x, P), rel=0.02)
