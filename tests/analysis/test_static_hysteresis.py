"""Static load of muscles with hysteresis and creep: F_ce holds the middle of the loop, or is withheld."""

from __future__ import annotations

import numpy as np
import pytest

from pmabench.kinds.static_load.reduction import offers, reduce
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import TrialData
from tests.analysis.judged_forms import as_run
from tests.judge.second.lifted import MOVED, RATE, lifted
from tests.judge.second.muscle import Muscle

MASSES = (11.0, 26.0, 41.0)
STRAIGHT, BRAID, WIDE = Muscle(), Muscle(bend=1.0, hysteresis=22.0), Muscle(bend=1.0, hysteresis=40.0)
REAL = Muscle(bend=1.0, hysteresis=22.0, creep=0.008)


def reduced(of: Muscle, stroke: float, seed: int = 1, masses: tuple[float, ...] = MASSES) -> Analysis:
    trials = []
    for index, one in enumerate(lifted(of, masses, stroke, seed)):
        found = {
            name: {"found": True, "t": t, "pressure": P, "displacement": MOVED}
            for name, (t, P) in (("lift", one.lift), ("set-down", one.set_down))
        }
        flags = np.zeros(len(one.t), dtype=np.uint16)
        point = {"load": one.load, "mass": one.load / 9.81}
        trials.append(TrialData("s", index, point, 0, False, "finished", one.t, one.channels, flags, (), found))
    return reduce([as_run("static-load", trials, RATE, {})])


def off(of: Muscle, analysis: Analysis) -> list[float]:
    """Errors of F_ce over their half widths."""
    found = [e for e in analysis.estimates if e.method == "static-mean" and e.at and e.value is not None]
    return [(e.value - float(of.mean(np.zeros(()), np.array(e.at["pressure"])))) / e.parts.combined for e in found]


def test_a_stroke_shows_hysteresis_which_is_taken_off():
    analysis = reduced(BRAID, 80e3)
    errors = off(BRAID, analysis)
    assert len(errors) >= 2
    assert max(map(abs, errors)) < 1.0
    assert any("taken off F_ce" in f.text for f in analysis.findings)
    assert [o.symbol for o in offers(analysis)] == ["F"], "friction of a hardly moved braid is no bound of F_c"


def test_damping_and_dry_friction_are_not_taken_for_hysteresis():
    analysis = reduced(STRAIGHT, 60e3)
    errors = off(STRAIGHT, analysis)
    assert len(errors) >= 2
    assert max(map(abs, errors)) < 0.5
    assert not any("hysteresis" in f.text for f in analysis.findings)
    assert [o.symbol for o in offers(analysis)] == ["F", "F_c"]


@pytest.mark.study
def test_without_a_stroke_the_interval_holds_hysteresis_and_the_reason_is_said():
    analysis = reduced(BRAID, 0.0)
    errors = off(BRAID, analysis)
    assert len(errors) >= 2
    assert max(map(abs, errors)) < 1.0
    assert any("no load was raised" in f.text for f in analysis.findings)


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_f_ce_of_many_muscles_and_strokes():
    print()
    worst, errors = 0.0, []
    for name, of in (("straight", STRAIGHT), ("bent", Muscle(bend=1.0)), ("braid", BRAID), ("wide", WIDE),
                     ("creep", Muscle(bend=1.0, creep=0.008)), ("real", REAL)):  # fmt: skip
        for stroke in (0.0, 40e3, 60e3, 80e3, 120e3):
            seen = [e for seed in range(3) for e in off(of, reduced(of, stroke, seed, (11.0, 21.0, 31.0, 41.0, 51.0)))]
            worst = max(map(abs, seen), default=0.0)
            print(f"{name}, {stroke / 1e3:.0f} kPa: {len(seen)} values, worst {worst:.2f} half widths")
            errors += seen
    held = np.mean(np.abs(errors) <= 1.0)
    print(f"{len(errors)} values, {held:.3f} hold the truth, worst {np.abs(errors).max():.2f} half widths", end="")
    assert held >= 0.95
    assert np.abs(errors).max() < 1.5
