"""Limits of a protocol: each that is not kept gives a sentence with limit, value and place; odd ones give none."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pmabench.analysis.reduce import verdicts
from pmabench.analysis.results import Analysis, Curve, Estimate, Parts
from pmabench.analysis.verdict.acceptance import limits_of
from tests.analysis.loop_rig import as_run

PLACE = "cr.yaml:7"


def judged(entry, analysis=None, **more):
    limit = {"what": "K", "measure": "of_specimen", "limit": 0.05, "place": PLACE, **entry, **more}
    run = replace(as_run("contraction-relaxation", []), plan={"accept": {"limits": [limit]}})
    K = Estimate("K", 6400.0, "N/m", "stiffness", "m", {"pressure": 3e5}, Parts(20.0))
    return verdicts([run], [replace(analysis or Analysis(run.kind, (), True, (K,)), runs=(run.id,))])


@pytest.mark.parametrize(
    ("expected", "told"),
    [
        ([[2e5, 6000.0], [4e5, 7600.0]], "6.4 N/mm is 5.9 % below the specimen file's 6.8 N/mm, accepted +-5 % (cr.yaml:7)"),
        ([[3e5, 6080.0]], "6.4 N/mm is 5.3 % above the specimen file's 6.08 N/mm, accepted +-5 % (cr.yaml:7); its "
         "interval reaches into what is accepted"),
        ([[3e5, 6400.0]], ""),
        ([[1e5, 1.0], [2e5, 1.0]], ""),
        (12800.0, "6.4 N/mm is 50 % below the specimen file's 12.8 N/mm, accepted +-5 % (cr.yaml:7)"),
    ],
)  # fmt: skip
def test_a_coefficient_is_held_against_the_specimen_file(expected, told):
    assert judged({"expected": expected}) == ([f"K at pressure 300 kPa: {told}"] if told else [])


def test_a_value_without_an_interval_is_judged_too():
    K = Estimate("K", 6400.0, "N/m", "stiffness", "m", {"pressure": 3e5})
    (told,) = judged({"expected": [[3e5, 6080.0]]}, Analysis("contraction-relaxation", (), True, (K,)))
    assert told.endswith("the specimen file's 6.08 N/mm, accepted +-5 % (cr.yaml:7)")


def test_a_check_is_held_against_its_limit_and_must_be_known():
    entry = {"what": "repeat_spread", "measure": "at_most", "limit": 0.03}
    (unknown,) = judged(entry)
    assert unknown.startswith("repeat spread: not known, accepted at most 3 % (cr.yaml:7)")
    check = {"name": "repeat_spread", "value": -0.042, "quantity": "ratio", "level": "note", "text": ""}
    analysis = Analysis("contraction-relaxation", (), True, (Estimate("K", 1.0, "N/m", "stiffness", "m"),))
    far = replace(analysis, facts={"checks": [check]})
    assert judged(entry, far) == ["repeat spread: -4.2 %, accepted at most 3 % (cr.yaml:7)"]
    assert judged(entry, replace(analysis, facts={"checks": [{**check, "value": 0.03}]})) == []


def test_r2_is_that_of_the_best_curve():
    K = Estimate("K", 1.0, "N/m", "stiffness", "m")
    line, bent = (
        Curve("K", form, (), "pressure", (1e5, 5e5), r2, 0.0, "m") for form, r2 in (("line", 0.9), ("quadratic", 0.97))
    )
    entry = {"what": "R2", "measure": "at_least", "limit": 0.98}
    analysis = Analysis("contraction-relaxation", (), True, (K,), (line, bent))
    assert judged(entry, analysis) == ["R2 of K over pressure (quadratic): 0.97, accepted at least 0.98 (cr.yaml:7)"]
    assert judged({**entry, "limit": 0.96}, analysis) == []
    assert judged(entry, replace(analysis, curves=())) == [
        "R2: there is no curve over pressure, accepted at least 0.98 (cr.yaml:7)"
    ]
    nan = replace(analysis, curves=(replace(bent, r2=float("nan")),))
    assert judged(entry, nan) == ["R2 of K over pressure (quadratic): nan, accepted at least 0.98 (cr.yaml:7)"]


def test_an_interval_names_its_place_and_plans_from_before_still_count():
    entry = {"measure": "relative_interval", "limit": 0.001}
    assert judged(entry) == ["K at pressure 300 kPa: interval +-0.31 %, accepted +-0.1 % (cr.yaml:7)"]
    run = replace(as_run("contraction-relaxation", []), plan={"accept": {"K": 0.02, "F_ce": 0.01}})
    assert [(limit.what, limit.limit, limit.place) for limit in limits_of(run)] == [("K", 0.02, ""), ("F_ce", 0.01, "")]
    both = {
        "accept": {"K": 0.02, "limits": [{"what": "K", "measure": "relative_interval", "limit": 0.02, "place": "a:1"}]}
    }
    assert [limit.place for limit in limits_of(replace(run, plan=both))] == ["a:1"]


@pytest.mark.parametrize(
    "accept",
    [None, 7, [], "x", {"limits": 7}, {"limits": [7, None, {}]}, {"K": "x", "F_ce": True},
     {"limits": [{"what": 3, "measure": "at_most", "limit": 1}]},
     {"limits": [{"what": "K", "measure": "at_most", "limit": True}]},
     {"limits": [{"what": "K", "measure": "else", "limit": 1.0}]},
     {"limits": [{"what": "K", "measure": "of_specimen", "limit": 1.0, "expected": [[1], ["x", 2], 3]}]}],
)  # fmt: skip
def test_what_is_no_limit_judges_nothing(accept):
    run = replace(as_run("contraction-relaxation", []), plan={"accept": accept})
    K = Estimate("K", 6400.0, "N/m", "stiffness", "m", {"pressure": 3e5}, Parts(20.0))
    assert verdicts([run], [Analysis(run.kind, (run.id,), True, (K,))]) == []
