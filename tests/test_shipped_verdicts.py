"""What the shipped protocols say of the shipped benches: no more is withheld than the bench gives reason to.

A bench that is sound and a protocol that fits it are accepted; a test of intervals asks only whether the truth is inside.
"""

import pytest

from pmabench.kinds.reduce import reduce_runs, verdicts
from pmabench.report.foremost import verdict_of
from tests.analysis.driven_runs import recorded

BENT = "its force over contraction is bent, which the form does not say"
SOUND = [
    ("arm-angle", "mock-arm-ideal", "arm-30"),
    ("arm-angle", "mock-arm", "arm-30"),
    ("closed-volume", "mock-daerden-closed", "daerden-20-200"),
    ("contraction-relaxation", "mock-air", "mas-20-250-paper0"),
    ("contraction-relaxation-paper1", "mock-dmsp", "dmsp-40-305"),
    ("free-contraction", "mock-contractor-free", "contractor-30"),
    ("isobaric-ramp", "mock-real-actuator", "dmsp-20-250-real"),
    ("joint-step", "mock-joint-free", "joint-daerden"),
    ("joint-sweep", "mock-joint", "joint-daerden"),
    ("joint-torque", "mock-joint", "joint-daerden"),
    ("platform", "mock-platform", "platform-daerden"),
    ("platform-paper3", "mock-platform", "platform-daerden"),
    ("relaxation", "mock-daerden-relaxing", "daerden-20-200"),
    ("sinusoidal-displacement", "mock-actuator", "mas-20-250-paper0"),
    ("static-load", "mock", "mas-20-250-paper0"),
    ("step-displacement", "mock-daerden", "daerden-20-200"),
    ("ultimate-gain-open-loop", "mock-linear", "mas-20-250-paper0"),
]
WITHHELD = {
    ("isometric-pressurisation", "mock-contractor", "contractor-30"): ({"F_ce"}, BENT),
    ("isometric-pressurisation-flow", "mock-daerden-flow", "daerden-20-200"): ({"F_ce", "K"}, BENT),
    ("isometric-pressurisation-paper3", "mock-daerden", "daerden-20-200"): ({"F_ce", "K"}, BENT),
    ("sinusoidal-displacement-paper3", "mock-daerden", "daerden-20-200"): ({"F", "F_ce", "K"}, BENT),
    ("real-muscle-sines", "mock-real-actuator", "dmsp-20-250-real"): (
        {"F_c", "F_ce", "H", "K"},
        f"{BENT}, and its friction is no constant",
    ),
    ("real-muscle-holds", "mock-real-actuator", "dmsp-20-250-real"): ({"tau_F"}, "it creeps longer than a hold"),
    ("contraction-relaxation", "mock-real", "dmsp-20-250-real"): (set(), "it creeps, and has hysteresis"),
    ("isobaric-ramp-paper3", "mock-daerden", "daerden-20-200"): ({"K"}, "almost none is left at the end of a stroke"),
}


@pytest.mark.study
@pytest.mark.parametrize("which", SOUND, ids="-".join)
def test_a_sound_bench_is_accepted_without_a_doubt(which, tmp_path):
    run = recorded(tmp_path, *which)
    analyses = reduce_runs([run])
    failed = verdicts([run], analyses)
    assert not failed
    assert verdict_of(analyses, [run], failed, accepted=True).word == "Accepted"


@pytest.mark.study
@pytest.mark.parametrize(("which", "expected"), WITHHELD.items(), ids=map("-".join, WITHHELD))
def test_of_a_muscle_that_a_form_does_not_fit_no_more_is_withheld(which, expected, tmp_path):
    analyses = reduce_runs([recorded(tmp_path, *which)])
    symbols, _why = expected
    assert {e.symbol for analysis in analyses for e in analysis.estimates if e.withheld} == symbols
