"""The certificate of a muscle that is bent: its line is the force of the closed form, and runs through the dots."""

import numpy as np
import pytest

from pmabench.kinds.reduce import reduce_runs
from pmabench.report.certificate.force_chart import _levels
from pmabench.report.certificate.result_table import result_table
from tests.analysis.judged import as_run
from tests.judge.campaign import campaign, muscle_of
from tests.judge.muscle import FRICTION, STROKE, pull, stiffness

SIZE, SEED = 0.35, 3


@pytest.fixture(scope="module")
def analyses():
    return reduce_runs([as_run(campaign("bend", SIZE, SEED))])


@pytest.fixture(scope="module")
def levels(analyses):
    found = _levels(analyses)
    assert len(found) == 3
    return found


def test_the_line_is_the_force_of_the_muscle(levels):
    """Where it was tested, F = F_ce - K x (1 + bend (1 - x / stroke)) of the simulated muscle; straight, 20 N are missed."""
    bend = muscle_of("bend", SIZE, SEED).bend
    for level in levels:
        x = np.linspace(level.rest[:, 0].min(), level.rest[:, 0].max(), 9)
        true = pull(level.P) - stiffness(level.P) * x * (1 + bend * (1 - x / STROKE))
        assert np.abs(level.force(x) - true).max() < 1.0
        assert np.abs(level.F_ce - level.K * x - true).max() > 5.0
        assert level.contraction(level.force(x)) == pytest.approx(x)


def test_dots_are_on_it_but_for_friction(levels):
    for level in levels:
        for dots in (level.rest, level.back):
            assert np.abs(level.force(dots[:, 0]) - dots[:, 1]).max(initial=0.0) < 1.5 * FRICTION


def test_the_table_gives_the_contraction_of_each_K(analyses, levels):
    table, _, _ = result_table(analyses)
    places = ", ".join(f"{1e3 * level.middle:.1f}" for level in levels)
    assert f"K: the slope at {places} mm of contraction, row by row" in table.notes
