"""Independent tests are held against each other where they have a pressure in common, and only there."""

from dataclasses import replace

import pytest
from scipy.stats import binom

from pmabench.kinds.reduce import compared, verdicts
from pmabench.report.words import described
from pmabench.store.analyses.results import Analysis, Estimate, Parts
from tests.report.samples import render


def estimate(symbol, value, half, pressure, method, quantity="stiffness", **at):
    return Estimate(symbol, value, "N/m", quantity, method, {"pressure": pressure, **at}, Parts(repeats=half))


STEPS = Analysis(
    "contraction-relaxation", ("r1",), False,
    (
        estimate("K", 6770.0, 30.0, 3e5, "measured-pressure"),
        estimate("K", 7500.0, 30.0, 4e5, "measured-pressure"),
        estimate("K", 9999.0, 1.0, 3e5, "step-exponential"),
        estimate("B_c", 1680.0, 6.0, 3e5, "measured-pressure", "damping"),
        estimate("B_r", 2120.0, 8.0, 3e5, "measured-pressure", "damping"),
    ),
)  # fmt: skip


def sines(k, half, b=1900.0):
    return Analysis(
        "sinusoidal-displacement", ("r2",), False,
        (
            estimate("K", k, half, 3e5, "sine-harmonic", mean=0.01),
            estimate("K", 1.0, half, 3e5, "sine-harmonic", frequency=1.0),
            estimate("B", b, 12.0, 3e5, "sine-harmonic", "damping", mean=0.01),
        ),
    )  # fmt: skip


def test_differences_carry_the_root_of_the_sum_of_squares():
    found = compared([STEPS, sines(6800.0, 40.0)])
    k, b = found.estimates
    assert (k.value, k.parts.combined) == (pytest.approx(-30.0), pytest.approx(50.0))
    assert k.at == {"pressure": 3e5, "contraction": 0.01}
    assert b.value == pytest.approx(0.0)
    assert b.parts.combined == pytest.approx((12.0**2 + 5.0**2) ** 0.5)
    assert found.runs == ("r1", "r2")
    assert [f.level for f in found.findings] == ["note", "note"]


def test_what_does_not_agree_is_a_doubt():
    found = compared([STEPS, sines(6900.0, 40.0)])
    assert found.findings[0].level == "doubt"
    assert "do not agree" in found.findings[0].text


def test_K_of_a_bent_muscle_is_compared_at_its_contraction_only():
    for contraction, symbols in ((0.01, ["K", "B"]), (0.03, ["B"])):
        slopes = [{"pressure": P, "contraction": contraction} for P in (3e5, 4e5)]
        bent = replace(STEPS, facts={"form": {"K_at": slopes}})
        found = compared([bent, sines(6800.0, 40.0)])
        assert [e.symbol.removeprefix("d") for e in found.estimates] == symbols


def test_nothing_in_common_is_nothing():
    assert compared([STEPS]) is None
    elsewhere = sines(6800.0, 40.0)
    moved = replace(elsewhere, estimates=tuple(replace(e, at={"pressure": 2e5}) for e in elsewhere.estimates))
    assert compared([STEPS, moved]) is None


def test_a_value_that_is_none_is_not_compared():
    broken = replace(STEPS, estimates=tuple(replace(e, value=None) for e in STEPS.estimates))
    assert compared([broken, sines(6800.0, 40.0)]) is None


def test_a_value_without_an_interval_is_not_compared_and_that_is_said():
    bare = sines(6800.0, None)
    found = compared([STEPS, bare])
    assert [(e.symbol, e.coordinate) for e in found.estimates] == [("B", "difference")]
    assert [f.text for f in found.findings if "not compared" in f.text] == [
        "K, contraction against sine: not compared at 300 kPa and 10 mm, where one has no interval"
    ]
    halved = tuple(replace(e, parts=Parts()) if e.symbol == "B_r" else e for e in STEPS.estimates)
    found = compared([replace(STEPS, estimates=halved), bare])
    assert found.estimates == ()
    assert [f.text.partition(",")[0] for f in found.findings] == ["K", "B"]
    assert verdicts([], [found]) == []
    text = render([STEPS, bare, found], [])
    assert "where one has no interval" in text


def test_sines_at_several_means_are_compared_each_at_its_own():
    """A straight muscle has one K: 5000 N/m at 20 mm is none of 6770."""
    one, two = sines(6800.0, 40.0), sines(5000.0, 40.0)
    deeper = tuple(replace(e, at={**e.at, "mean": 0.02}) for e in two.estimates if e.symbol == "K")
    found = compared([STEPS, replace(one, estimates=(*one.estimates, *deeper))])
    assert [(e.at["contraction"], e.value) for e in found.estimates if e.symbol == "K"] == [
        (0.01, pytest.approx(-30.0)),
        (0.02, pytest.approx(1770.0)),
    ]
    (refusal,) = found.refusals
    assert refusal.startswith(
        "K at 300 kPa and 20 mm (1 of 2 places): contraction 6.77 N/mm +- 0.03 N/mm and sine 5 N/mm"
    )


def static(*points):
    return Analysis(
        "static-load", ("r3",), False,
        tuple(estimate("F_ce", F, half, P, "static-mean", "force") for P, F, half in points),
    )  # fmt: skip


def forces(*methods, kind="contraction-relaxation", pressure=3e5):
    return Analysis(
        kind, ("r1",), False, tuple(estimate("F_ce", F, 3.0, pressure, method, "force") for method, F in methods)
    )


def test_static_load_is_read_between_its_points():
    found = compared(
        [forces(("measured-pressure", 590.0), pressure=3.5e5), static((3e5, 500.0, 4.0), (4e5, 700.0, 4.0))]
    )
    (difference,) = found.estimates
    assert (difference.value, difference.at, difference.parts.combined) == (
        pytest.approx(10.0),
        {"pressure": 3.5e5},
        5.0,
    )


def test_the_way_that_a_protocol_of_paper_1_names_is_compared():
    """K of the first method alone: F_ce of that way is geometry, and B_r carries another pressure."""
    papers = Analysis(
        "contraction-relaxation-paper-1", ("r1",), False,
        (estimate("K", 6770.0, 30.0, 3e5, "paper-1-xmax"), estimate("K", 9999.0, 1.0, 3e5, "paper-1-x0"),
         estimate("B_c", 1.0, 1.0, 3e5, "paper-1-xmax", "damping"), estimate("B_r", 1.0, 1.0, 3e5, "paper-1-xmax", "damping")),
    )  # fmt: skip
    found = compared([papers, sines(6800.0, 40.0)])
    assert [(e.method, e.value, e.parts.combined) for e in found.estimates] == [
        ("contraction against sine, paper 1's way", pytest.approx(-30.0), pytest.approx(50.0))
    ]
    assert described("contraction against sine, paper 1's way") == described("contraction against sine") != ""


@pytest.mark.parametrize("beyond", range(8))
def test_many_small_differences_tell_what_none_does(beyond):
    """10 of 23 were beyond, by 6 % of the cell in one of the tests, and the tests "agreed"."""
    pressures = [1e5 + 2e4 * n for n in range(23)]
    one = [estimate("K", 6770.0, 30.0, P, "measured-pressure") for P in pressures]
    two = [
        estimate("K", 6770.0 + (45.0 if n < beyond else 5.0), 30.0, P, "sine-harmonic", mean=0.01)
        for n, P in enumerate(pressures)
    ]
    tests = [Analysis("contraction-relaxation", ("r1",), False, tuple(one)), replace(sines(0, 0), estimates=tuple(two))]
    found = compared(tests)
    assert found.facts == {"comparisons": 23, "beyond_intervals": beyond}
    doubts = [f.text for f in found.findings if f.level == "doubt"]
    assert bool(doubts) == (binom.sf(beyond - 1, 23, 0.05) <= 1e-3)
    assert not found.refusals
