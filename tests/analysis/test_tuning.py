"""Tuning rules against their printed tables, and the test of whether an ultimate period can be true."""

from __future__ import annotations

import json
from dataclasses import replace
from math import degrees

import pytest

from pmabench.analysis.tuning import facts, plausibility, rules_named, tune
from pmabench.base.quantities import QUANTITIES
from pmabench.model.loop import Loop, ultimate
from pmabench.model.rules import all_rules
from pmabench.store.analyses.results import Estimate, Parts, Source


def pair(
    K_u: float = 7.1, T_u: float = 9.0, unit: str = "1", half: tuple[float, float] = (0.0, 0.0)
) -> tuple[Estimate, Estimate]:
    return (
        Estimate("K_u", K_u, unit, "gain", "gain-steps", parts=Parts(repeats=half[0] * K_u)),
        Estimate("T_u", T_u, "s", "time", "gain-steps", parts=Parts(repeats=half[1] * T_u)),
    )


EXPECTED = {
    "Ziegler-Nichols P": {"K_p": 3.55},
    "Ziegler-Nichols PI": {"K_p": 3.195, "T_i": 7.5, "K_i": 0.426},
    "Ziegler-Nichols PID": {"K_p": 4.26, "T_i": 4.5, "T_d": 1.125, "K_i": 4.26 / 4.5, "K_d": 4.26 * 1.125},
    "Tyreus-Luyben PI": {"K_p": 7.1 / 3.2, "T_i": 19.8, "K_i": 7.1 / 3.2 / 19.8},
    "Tyreus-Luyben PID": {
        "K_p": 7.1 / 2.2,
        "T_i": 19.8,
        "T_d": 9 / 6.3,
        "K_i": 7.1 / 2.2 / 19.8,
        "K_d": 7.1 / 2.2 * 9 / 6.3,
    },
}


@pytest.mark.parametrize("title", EXPECTED)
def test_gains_of_paper_0s_ultimate_gain(title: str) -> None:
    (found,) = tune(*pair(), rules=rules_named(title))
    assert {e.symbol: e.value for e in found.estimates} == pytest.approx(EXPECTED[title])


def test_the_misprint_never_comes_out_as_ziegler_nichols() -> None:
    for found in tune(*pair(), rules=rules_named("ziegler-nichols")):
        assert found.K_p.value != pytest.approx(2.195, rel=1e-3)
        assert found.T_i is None or found.T_i.value != pytest.approx(3.0, rel=1e-3)


def test_units_of_ideal_and_parallel_form() -> None:
    found = tune(*pair(60e6, 0.35, "Pa/m"), rules=rules_named("Ziegler-Nichols PID"))[0]
    assert {e.symbol: e.unit for e in found.estimates} == {
        "K_p": "Pa/m", "T_i": "s", "T_d": "s", "K_i": "Pa/(m.s)", "K_d": "Pa.s/m"
    }  # fmt: skip
    assert all(QUANTITIES[e.quantity].unit == e.unit for e in found.estimates)
    bare = tune(*pair(), rules=rules_named("Ziegler-Nichols PID"))[0]
    assert {e.symbol: e.unit for e in bare.estimates} == {"K_p": "1", "T_i": "s", "T_d": "s", "K_i": "1/s", "K_d": "s"}


def test_intervals_are_carried_through() -> None:
    found = tune(*pair(60e6, 0.35, "Pa/m", (0.03, 0.04)), rules=rules_named("Ziegler-Nichols PID"))[0]
    relative = {e.symbol: (e.parts.repeats or 0.0) / (e.value or 1.0) for e in found.estimates}
    assert relative == pytest.approx({"K_p": 0.03, "T_i": 0.04, "T_d": 0.04, "K_i": 0.05, "K_d": 0.05})
    assert found.K_p.parts.method is None


def test_the_budget_of_K_u_is_not_that_of_a_setting() -> None:
    """Its halves are in the unit of K_u, and a T_i in seconds is none."""
    K_u, T_u = pair(60e6, 0.35, "Pa/m", (0.03, 0.04))
    K_u = replace(K_u, budget=(Source("scatter of the cycles", "repeats", "A", 1.8e6),))
    assert all(e.budget == () for e in tune(K_u, T_u, rules=rules_named("Ziegler-Nichols PID"))[0].estimates)


def test_margins_where_a_model_is_known() -> None:
    loop = Loop(1.466e-7, 0.041, (0.0955, 0.247))
    true = ultimate(loop)
    by_rule = {g.rule.title: g for g in tune(*pair(true.gain, true.period, "Pa/m"), loop=loop)}
    assert len(by_rule) == len(all_rules())
    proportional = by_rule["Ziegler-Nichols P"].margins
    assert proportional is not None
    assert proportional.gain_margin == pytest.approx(2.0, rel=1e-3)
    classic, calm = by_rule["Ziegler-Nichols PI"], by_rule["Tyreus-Luyben PI"]
    assert classic.margins.M_s > 2.0 > calm.margins.M_s
    assert json.loads(json.dumps(facts(by_rule.values(), {"setpoint": 0.03}), allow_nan=False))


def test_simc_by_the_half_rule() -> None:
    """By hand: lags 10, 2 and 0.4 with dead time 1; tau_c = theta."""
    loop = Loop(2.0, 1.0, (10.0, 2.0, 0.4))
    true = ultimate(loop)
    by_rule = {g.rule.title: g for g in tune(*pair(true.gain, true.period), loop=loop)}
    reported = {e.symbol: e.value for e in by_rule["SIMC PI"].estimates}  # tau_1 = 11, theta = 1 + 1 + 0.4
    assert reported == pytest.approx({"K_p": 11 / (2 * 2 * 2.4), "T_i": 11.0, "K_i": 1 / (2 * 2 * 2.4)})
    reported = {e.symbol: e.value for e in by_rule["SIMC PID"].estimates}  # tau_1 = 10, tau_2 = 2.2, theta = 1.2
    series, tau_i, tau_d = 10 / (2 * 2 * 1.2), 8 * 1.2, 2.2
    f = 1 + tau_d / tau_i
    assert reported == pytest.approx(
        {"K_p": series * f, "T_i": tau_i * f, "T_d": tau_d / f, "K_i": series / tau_i, "K_d": series * tau_d}
    )


def test_simc_of_one_lag_has_the_margins_that_its_paper_prints() -> None:
    """Skogestad 2003, table 1, tau_c = theta: gain margin 3.14, phase margin 61.4 deg, M_s 1.59, for tau_1 <= 8 theta."""
    loop = Loop(3.0, 0.5, (2.0,))
    (found,) = tune(*pair(), rules=rules_named("simc pi"), loop=loop)
    assert found.margins is not None
    assert found.margins.gain_margin == pytest.approx(3.14, abs=0.01)
    assert degrees(found.margins.phase_margin) == pytest.approx(61.4, abs=0.1)
    assert found.margins.M_s == pytest.approx(1.59, abs=0.01)
    assert found.K_p.ci95 is None


def test_simc_is_left_out_where_it_cannot_be() -> None:
    assert tune(*pair(), rules=rules_named("SIMC")) == ()
    swinging = Loop(1.0, 0.1, (0.2 + 0.3j, 0.2 - 0.3j))
    assert tune(*pair(), rules=rules_named("SIMC"), loop=swinging) == ()
    assert [g.rule.form for g in tune(*pair(), rules=rules_named("SIMC"), loop=Loop(1.0, 0.1, (1.0,)))] == ["PI"]


def test_rules_are_found_by_name_form_or_title() -> None:
    assert {r.title for r in rules_named("pi")} == {"Ziegler-Nichols PI", "Tyreus-Luyben PI", "SIMC PI"}
    with pytest.raises(ValueError, match="did you mean"):
        rules_named("Ziegler-Nicols")
    with pytest.raises(ValueError, match="above 0"):
        tune(*pair(K_u=-1.0))


def test_nine_seconds_are_impossible_for_a_linear_loop() -> None:
    said = plausibility(9.0, Loop(1.466e-7, 0.04, (0.22, 0.25)))
    assert said.level == "fault"
    assert "T_u = 9 s is impossible" in said.text
    assert "oscillates at 0.436 s" in said.text
    assert "stiction" in said.text


def test_what_agrees_is_said_to_agree() -> None:
    loop = Loop(1.466e-7, 0.041, (0.0955, 0.247))
    true = ultimate(loop)
    assert plausibility(true.period * 1.02, loop).level == "note"
    assert plausibility(true.period * 1.3, loop).level == "doubt"
    assert plausibility(true.period * 1.8, loop).level == "fault"
