"""Verdicts: what the protocol does not accept, and analyses that gave nothing, in sentences with units."""

from __future__ import annotations

from dataclasses import replace

from pmabench.kinds.reduce import reduce_runs, verdicts
from pmabench.store.analyses.results import Analysis, Dropped, Estimate, Finding, Parts
from pmabench.store.records import RunData
from tests.analysis.loop_rig import as_run
from tests.analysis.sine_rig import Muscle51

AT = {"pressure": 3e5, "mean": 0.01}


def K(half: float | None, value: float | None = 6773.0, **more: object) -> Estimate:
    return replace(Estimate("K", value, "N/m", "stiffness", "sine-harmonic", AT, Parts(half, 1.0)), **more)


def run(**accept: float) -> RunData:
    limits = [{"what": name, "measure": "relative_interval", "limit": limit} for name, limit in accept.items()]
    return replace(as_run("sinusoidal-displacement", []), plan={"accept": {"limits": limits}})


def judged(*estimates: Estimate, **accept: float) -> list[str]:
    bench = run(**accept)
    return verdicts([bench], [Analysis(bench.kind, (bench.id,), True, estimates)])


def test_a_wide_interval_is_reported_in_units_that_people_use():
    assert judged(K(677.3), K=0.05) == ["K at pressure 300 kPa, mean 10 mm: interval +-10 %, accepted +-5 %"]
    assert judged(K(67.73), K=0.05) == []


def test_a_value_for_the_whole_campaign_names_no_place():
    F_c = Estimate("F_c", 6.0, "N", "force", "sine-harmonic", parts=Parts(3.0))
    assert judged(F_c, F_c=0.1) == ["F_c: interval +-50 %, accepted +-10 %"]


def test_a_value_without_an_interval_is_not_accepted():
    reported = judged(K(None, note="no repeats part: one trial of one cycle"), K=0.05)
    assert reported == [
        "K at pressure 300 kPa, mean 10 mm: no interval, accepted +-5 %; no repeats part: one trial of one cycle"
    ]


def test_an_interval_that_is_cut_at_0_is_judged_whole():
    B = Estimate("B", 10.0, "N.s/m", "damping", "sine-harmonic", AT, Parts(20.0))
    assert judged(B, B=1.6) == ["B at pressure 300 kPa, mean 10 mm: interval +-200 %, accepted +-160 %"]


def test_nothing_at_all_is_a_verdict_without_any_acceptance():
    empty = Analysis("isometric", ("r",), False, findings=(Finding("note", "x"), Finding("fault", "no whole counts")))
    assert verdicts([], [empty]) == ["isometric: nothing came out: no whole counts"]
    refused = Analysis("ultimate-gain", ("r",), False, (K(None, None, note="it does not oscillate"),))
    assert verdicts([], [refused]) == ["ultimate-gain: nothing came out: it does not oscillate"]
    unused = Analysis("isometric", ("r",), False, dropped=(Dropped("r/0", {}, "the trial is aborted"),))
    assert verdicts([], [unused]) == ["isometric: nothing came out: r/0: the trial is aborted"]
    assert verdicts([], [Analysis("isometric", ("r",), False)]) == ["isometric: nothing came out: there is no trial"]


def test_a_fault_next_to_values_is_no_verdict():
    some = Analysis("isometric", ("r",), False, (K(1.0),), findings=(Finding("fault", "one file is implausible"),))
    assert verdicts([], [some]) == []


def test_what_another_method_withholds_is_no_verdict_on_the_first():
    """K by the fit was given, and the run not accepted for K of single steps, under one name."""
    other = K(None, None, method="step-exponential", withheld=True, note="only the order of 7.4 N/mm is known")
    assert judged(K(67.7), other) == []
    assert judged(K(None, None, withheld=True, note="creep"), other) == [
        "K at pressure 300 kPa, mean 10 mm: withheld: creep"
    ]
    assert judged(K(None, None, note="no load moves"), other) == [
        "K at pressure 300 kPa, mean 10 mm: withheld: only the order of 7.4 N/mm is known"
    ]
    there = replace(K(None, None, method="relay", withheld=True, note="it hunts"), at={"pressure": 5e5})
    assert judged(K(67.7), other, there) == ["K at pressure 500 kPa: withheld: it hunts"]


def test_a_run_of_sines_that_went_slack_gives_nothing():
    slack = as_run("sinusoidal-displacement", [Muscle51(F_ce=60.0).trial(0, 1.0, 11)])
    (reported,) = verdicts([slack], reduce_runs([slack]))
    assert reported.startswith("sinusoidal-displacement: nothing came out: r1/1: the specimen was slack")
