"""Independent tests are held against each other where they have a pressure in common, and only there."""

from dataclasses import replace

import pytest

from pmabench.analysis.reduce import verdicts
from pmabench.analysis.results import Analysis, Estimate, Parts
from pmabench.analysis.verdict.agreement import agreement
from pmabench.report.document.html import render


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
    found = agreement([STEPS, sines(6800.0, 40.0)])
    k, b = found.estimates
    assert (k.value, k.parts.combined) == (pytest.approx(30.0), pytest.approx(50.0))
    assert k.at == {"pressure": 3e5}
    assert b.value == pytest.approx(0.0)
    assert b.parts.combined == pytest.approx((12.0**2 + 5.0**2) ** 0.5)
    assert found.runs == ("r1", "r2")
    assert [f.level for f in found.findings] == ["note", "note"]


def test_what_does_not_agree_is_a_doubt():
    found = agreement([STEPS, sines(6900.0, 40.0)])
    assert found.findings[0].level == "doubt"
    assert "do not agree" in found.findings[0].text


def test_nothing_in_common_is_nothing():
    assert agreement([STEPS]) is None
    elsewhere = sines(6800.0, 40.0)
    moved = replace(elsewhere, estimates=tuple(replace(e, at={"pressure": 2e5}) for e in elsewhere.estimates))
    assert agreement([STEPS, moved]) is None


def test_a_value_that_is_none_is_not_compared():
    broken = replace(STEPS, estimates=tuple(replace(e, value=None) for e in STEPS.estimates))
    assert agreement([broken, sines(6800.0, 40.0)]) is None


def test_a_value_without_an_interval_is_not_compared_and_that_is_said():
    bare = sines(6800.0, None)
    found = agreement([STEPS, bare])
    assert [(e.symbol, e.coordinate) for e in found.estimates] == [("B", "difference")]
    assert [f.text for f in found.findings if "not compared" in f.text] == [
        "K, sine against steps: not compared at 300 kPa, where one has no interval, or several values"
    ]
    halved = tuple(replace(e, parts=Parts()) if e.symbol == "B_r" else e for e in STEPS.estimates)
    found = agreement([replace(STEPS, estimates=halved), bare])
    assert found.estimates == ()
    assert [f.text.partition(",")[0] for f in found.findings] == ["K", "B"]
    assert verdicts([], [found]) == []
    text = render([STEPS, bare, found], [])
    assert "where one has no interval, or several values" in text


def test_sines_at_several_means_are_not_compared_as_if_they_were_one():
    one, two = sines(6800.0, 40.0), sines(5000.0, 40.0)
    deeper = tuple(replace(e, at={**e.at, "mean": 0.02}) for e in two.estimates)
    found = agreement([STEPS, replace(one, estimates=(*one.estimates, *deeper))])
    assert found.estimates == ()
    assert [f.text.partition(",")[0] for f in found.findings if "several values" in f.text] == ["K", "B"]
