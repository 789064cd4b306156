"""What is made of a muscle that is bent: certificate, free run, models for simulators and dry runs, by its closed form."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.cli.dry_run import _expected
from pmabench.kinds.contraction_relaxation.values import METHOD
from pmabench.kinds.reduce import reduce_runs
from pmabench.report.certificate.force_chart import Level, _levels, bend_of, slopes_of
from pmabench.report.certificate.result_table import result_table
from pmabench.report.files.simulator_models import control_model, control_text, mujoco_model, rates
from tests.analysis.judged import as_run
from tests.judge.campaign import campaign, muscle_of
from tests.judge.muscle import FRICTION, STROKE, pull, stiffness

SIZE, SEED = 0.35, 3


@pytest.fixture(scope="module")
def analyses():
    return reduce_runs([as_run(campaign("bend", SIZE, SEED))])


def true_force(P, x):
    """F_ce - K x (1 + bend (1 - x / stroke)) of the simulated muscle [N]."""
    return pull(P) - stiffness(P) * x * (1 + muscle_of("bend", SIZE, SEED).bend * (1 - x / STROKE))


@pytest.fixture(scope="module")
def levels(analyses):
    found = _levels(analyses)
    assert len(found) == 3
    return found


@pytest.fixture(scope="module")
def middles(analyses):
    return {P: x for P, (x, _) in slopes_of(analyses, (METHOD,)).items()}


@pytest.fixture(scope="module")
def exported(analyses):
    return control_model(analyses[0])


def test_the_line_is_the_force_of_the_muscle(levels):
    """Where it was tested, that of the simulated muscle; straight, 20 N are missed."""
    for level in levels:
        x = np.linspace(level.rest[:, 0].min(), level.rest[:, 0].max(), 9)
        true = true_force(level.P, x)
        assert np.abs(level.force(x) - true).max() < 1.0
        assert np.abs(level.F_ce - level.K * x - true).max() > 5.0
        assert level.contraction(level.force(x)) == pytest.approx(x)


def test_dots_are_on_it_but_for_friction(levels):
    for level in levels:
        for dots in (level.rest, level.back):
            assert np.abs(level.force(dots[:, 0]) - dots[:, 1]).max(initial=0.0) < 1.5 * FRICTION


def test_the_free_run_is_that_of_the_bent_muscle(analyses):
    """It misses no more than of a straight muscle: run straight, it missed 3 % of the stroke."""
    (check,) = [one for one in analyses[0].facts["checks"] if one["text"].startswith("free run")]
    assert check["value"] < 0.003


def test_exported_laws_are_the_force_of_the_muscle(analyses, levels, exported):
    """The load at which nothing moves, at all contractions tested."""
    law = exported.params
    for level in levels:
        for x in np.linspace(level.rest[:, 0].min(), level.rest[:, 0].max(), 7):
            off = law["M"] * rates(0.0, (x, 0.0), (level.P, true_force(level.P, x)), law)[1]
            assert abs(off) < 1.0
    text = control_text(exported, analyses[0])
    namespace = {"np": np}
    exec(text[text.index("PARAMETERS = {") : text.index("\n\n\ndef rates")], namespace)
    assert namespace["PARAMETERS"]["bend"] == pytest.approx(law["bend"], rel=1e-9)


def test_for_mujoco_it_is_the_tangent(analyses, levels, exported, middles):
    """Its coefficients are one line over pressure each; there it is nearer than with the force without contraction."""
    model, law = mujoco_model(analyses[0]), exported.params
    assert any("its tangent at 15.7 to 46.8 mm" in note for note in model.notes)
    ends = np.polyval(np.polyfit(law["P"], law["F_ce"], 1), model.params["P"])

    def missed(params):
        places = [(middles[level.P], level.P) for level in levels]
        return max(abs(rates(0.0, (x, 0.0), (P, true_force(P, x)), params)[1]) for x, P in places)

    assert missed(model.params) < 0.7 * missed(model.params | {"F_ce": ends})


def test_a_dry_run_takes_the_tangent(analyses, levels, middles):
    expected = _expected(analyses[0], "bent")
    assert len(expected.points) == len(levels)
    for point, level in zip(expected.points, levels, strict=True):
        assert point.F_ce - point.K * middles[level.P] == pytest.approx(true_force(level.P, middles[level.P]), abs=1.0)


def test_the_table_gives_the_contraction_of_each_K(analyses, levels, middles):
    table, _, _ = result_table(analyses)
    places = ", ".join(f"{1e3 * middles[level.P]:.1f}" for level in levels)
    assert f"K: the slope at {places} mm of contraction, row by row" in table.notes


def test_a_bent_line_that_is_not_known_is_not_drawn(analyses):
    """K is its slope at one contraction, and F_ce - K x another line."""
    without = {name: value for name, value in analyses[0].facts["form"].items() if name != "bend"}
    assert _levels([replace(a, facts={**a.facts, "form": without}) for a in analyses]) == []


@pytest.mark.parametrize(
    "form",
    [
        "parallel",
        {"K_at": 3},
        {"bend": [1.0, 2.0]},
        {"bend": {"pressure": [350e3], "contraction": [0.0, 0.01], "force": [[0.0, float("nan")]]}},
        {"bend": {"pressure": [350e3], "contraction": [0.0, 0.01], "force": [0.0, 1.0]}},
        {"K_at": [{"pressure": 350e3}, 5]},
        {"K_at": [{"pressure": 350e3, "contraction": "far", "force": None}]},
        {"K_at": [{"pressure": 350e3, "contraction": 1e-3, "force": float("inf")}]},
    ],
)
def test_facts_that_hold_anything_else_make_straight_lines(analyses, form):
    """Another program's analysis may call something else `form`."""
    other = [replace(a, facts={**a.facts, "form": form}) for a in analyses]
    assert all(level.bend is None for level in _levels(other))
    assert bend_of(other, (METHOD,)) is None
    assert not [note for note in result_table(other)[0].notes if note.startswith("K: the slope")]


def test_the_contractions_are_said_of_the_K_that_they_belong_to(analyses):
    """The same facts next to a K of another method say nothing of it."""
    others = [
        replace(
            a,
            estimates=tuple(replace(e, method="isometric-sections") for e in a.estimates if e.symbol in ("K", "F_ce")),
        )
        for a in analyses
    ]
    assert any(note.startswith("K: the slope") for note in result_table(analyses)[0].notes)
    next_to = [replace(others[0], facts={}), replace(analyses[0], estimates=())]
    assert not [note for note in result_table(next_to)[0].notes if note.startswith("K: the slope")]


def test_a_line_that_does_not_come_down_ends_where_it_is_lowest():
    x = np.linspace(0.0, 0.1, 10_001)
    level = Level(350e3, 1000.0, 10e3, np.empty((0, 2)), np.empty((0, 2)), bend=(x, 400e3 * x * (x - 2 * 0.03)))
    assert float(level.contraction(np.array(0.0))) == pytest.approx(x[np.argmin(level.force(x))], abs=1e-5)
