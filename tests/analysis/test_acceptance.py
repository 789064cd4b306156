"""Limits of a protocol: each that is not kept gives a sentence with limit, value and place; odd ones give none."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pmabench.kinds.reduce import verdicts
from pmabench.store.analyses.folder import read_analysis, write_analysis
from pmabench.store.analyses.results import Analysis, Estimate, Parts, withhold
from tests.analysis.loop_rig import as_run

PLACE = "cr.yaml:7"


def judged(entry, analysis=None, **more):
    limit = {"what": "K", "measure": "of_specimen", "limit": 0.05, "place": PLACE, **entry, **more}
    run = replace(as_run("contraction-relaxation", []), plan={"accept": {"limits": [limit]}})
    K = Estimate("K", 6400.0, "N/m", "stiffness", "m", {"pressure": 3e5}, Parts(20.0))
    return verdicts([run], [replace(analysis or Analysis(run.kind, (), True, (K,)), runs=(run.id,))])


@pytest.mark.parametrize(
    ("expected", "reported"),
    [
        ([[2e5, 6000.0], [4e5, 7600.0]], "6.4 N/mm is 5.9 % below the specimen file's 6.8 N/mm, accepted +-5 % (cr.yaml:7)"),
        ([[3e5, 6080.0]], "6.4 N/mm is 5.3 % above the specimen file's 6.08 N/mm, accepted +-5 % (cr.yaml:7); its "
         "interval reaches into what is accepted"),
        ([[3e5, 6400.0]], ""),
        ([[1e5, 1.0], [2e5, 1.0]], ""),
        (12800.0, "6.4 N/mm is 50 % below the specimen file's 12.8 N/mm, accepted +-5 % (cr.yaml:7)"),
    ],
)  # fmt: skip
def test_a_coefficient_is_held_against_the_specimen_file(expected, reported):
    assert judged({"expected": expected}) == ([f"K at pressure 300 kPa: {reported}"] if reported else [])


def test_a_value_without_an_interval_is_judged_too():
    K = Estimate("K", 6400.0, "N/m", "stiffness", "m", {"pressure": 3e5})
    (reported,) = judged({"expected": [[3e5, 6080.0]]}, Analysis("contraction-relaxation", (), True, (K,)))
    assert reported.endswith("the specimen file's 6.08 N/mm, accepted +-5 % (cr.yaml:7)")


def test_a_check_is_held_against_its_limit_and_must_be_known():
    entry = {"what": "repeat_spread", "measure": "at_most", "limit": 0.03}
    (unknown,) = judged(entry)
    assert unknown.startswith("repeat spread: not known, accepted at most 3 % (cr.yaml:7)")
    check = {"name": "repeat_spread", "value": -0.042, "quantity": "ratio", "level": "note", "text": ""}
    analysis = Analysis("contraction-relaxation", (), True, (Estimate("K", 1.0, "N/m", "stiffness", "m"),))
    far = replace(analysis, facts={"checks": [check]})
    assert judged(entry, far) == ["repeat spread: -4.2 %, accepted at most 3 % (cr.yaml:7)"]
    assert judged(entry, replace(analysis, facts={"checks": [{**check, "value": 0.03}]})) == []


def test_an_interval_names_its_place():
    entry = {"measure": "relative_interval", "limit": 0.001}
    assert judged(entry) == ["K at pressure 300 kPa: interval +-0.31 %, accepted +-0.1 % (cr.yaml:7)"]


@pytest.mark.parametrize(
    "accept",
    [None, 7, [], "x", {"limits": 7}, {"limits": [7, None, {}]}, {"K": "x", "F_ce": True},
     {"limits": [{"what": 3, "measure": "at_most", "limit": 1}]},
     {"limits": [{"what": "K", "measure": "at_most", "limit": True}]},
     {"limits": [{"what": "K", "measure": "of_specimen", "limit": 1.0, "expected": [[1], ["x", 2], 3]}]}],
)  # fmt: skip
def test_what_is_no_limit_judges_nothing(accept):
    run = replace(as_run("contraction-relaxation", []), plan={"accept": accept})
    K = Estimate("K", 6400.0, "N/m", "stiffness", "m", {"pressure": 3e5}, Parts(20.0))
    assert verdicts([run], [Analysis(run.kind, (run.id,), True, (K,))]) == []


@pytest.mark.parametrize(
    ("accept", "name"),
    [
        ({"limits": [{"what": "K", "measure": "of_static", "limit": 0.05}]}, "K of_static"),
        ({"static_E_n": 1.0, "limits": [{"what": "K", "measure": "relative_interval", "limit": 0.05}]}, "static_E_n"),
        ({"limits": [{"what": "R2", "measure": "at_least", "limit": 0.99}]}, "R2 at_least"),
        ({"K": 0.02}, "K"),
    ],
)
def test_a_limit_of_an_older_version_is_not_met_unseen(accept, name):
    """A run whose only limit was removed since was accepted."""
    run = replace(as_run("contraction-relaxation", []), plan={"accept": accept})
    K = Estimate("K", 6400.0, "N/m", "stiffness", "m", {"pressure": 3e5}, Parts(20.0))
    reported = verdicts([run], [Analysis(run.kind, (run.id,), True, (K,))])
    assert reported == [f"{name}: this limit is no longer known, so it is not judged"]


def test_relative_intervals_next_to_the_limits_of_a_plan_are_the_same_limits():
    entry = {"what": "K", "measure": "relative_interval", "limit": 0.02}
    run = replace(as_run("contraction-relaxation", []), plan={"accept": {"K": 0.02, "limits": [entry]}})
    K = Estimate("K", 6400.0, "N/m", "stiffness", "m", {"pressure": 3e5}, Parts(20.0))
    assert verdicts([run], [Analysis(run.kind, (run.id,), True, (K,))]) == []


def test_what_is_withheld_or_refused_is_not_accepted_whatever_the_limits():
    run = replace(as_run("contraction-relaxation", []), plan={})
    K, F = (
        Estimate(symbol, 6400.0, "N/m", "stiffness", "m", {"pressure": 3e5}, Parts(20.0)) for symbol in ("K", "F_ce")
    )
    analysis = Analysis(run.kind, (run.id,), True, (K, withhold(F, "the cell drifted")), refusals=("no zero was read",))
    assert verdicts([run], [analysis]) == [
        "no zero was read",
        "F_ce at pressure 300 kPa: withheld: the cell drifted",
    ]
    assert verdicts([run], [replace(analysis, estimates=(K,), refusals=())]) == []


def test_a_withheld_value_stays_withheld_in_the_analysis_folder(tmp_path):
    K = withhold(Estimate("K", 6400.0, "N/m", "stiffness", "m", {"pressure": 3e5}, Parts(20.0)), "the cell drifted")
    analysis = Analysis("contraction-relaxation", ("a",), True, (K,), refusals=("why",))
    again = read_analysis(write_analysis(analysis, tmp_path / "analysis"))
    assert (again.estimates, again.refusals) == (analysis.estimates, analysis.refusals)
    assert (K.value, K.ci95, K.withheld) == (None, None, True)


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        ({"measure": "relative_interval", "limit": 0.02}, "K at pressure 300 kPa, contraction 10 mm: interval +-7.3 %"),
        ({"measure": "relative_interval", "limit": 0.08}, ""),
        ({"measure": "of_specimen", "expected": 6400.0}, "K: the form of all tests says nothing of it"),
        ({"what": "F_ce", "measure": "relative_interval"}, "F_ce: the form of all tests says nothing of it"),
        ({"what": "repeat_spread", "measure": "at_most"}, "repeat_spread: the form of all tests says nothing of it"),
    ],
)
def test_limits_hold_for_a_form_of_all_tests_too(entry, reason):
    """What the certificate calls accepted was judged: a limit that cannot be judged there is not kept."""
    at = {"pressure": 3e5, "contraction": 0.01}
    K = Estimate("K", 10_000.0, "N/m", "stiffness", "surface", at, Parts(730.0))
    found = judged(entry, Analysis("surface", (), True, (K,)))
    assert len(found) == bool(reason)
    assert all(text.startswith(f"{reason}, accepted") for text in found)
