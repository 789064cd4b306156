"""Reference trials against the first: the stroke by hand, drift told with its size."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.analysis.shared.trials import compared, reference_findings
from pmabench.store.records import Command, Flag, RunData, TrialData

FIRST = 40e-3
REST = 1.5e-3


def trial(index, stroke, *, again=False, reference=True, pressure=250e3):
    """5 s: rest until 1 s, at once to `stroke` until 4 s, back."""
    t = np.arange(0.0, 5.0, 0.01)
    x = REST + np.where((t >= 1.0) & (t < 4.0), stroke, 0.0)
    commands = (Command(1.0, "pressure", "set", pressure, 0.0, "contract"),
                Command(4.0, "pressure", "set", 0.0, pressure, "vent"))  # fmt: skip
    return TrialData(
        "one", index, {"load": 58.86, "pressure": pressure}, 0, reference, "finished", t, {"displacement": x},
        np.zeros(len(t), dtype=np.uint16), commands, {}, again=again,
    )  # fmt: skip


def run(*trials, start="2026-11-21T10:00", name="one"):
    manifest = {"started_utc": start, "specimen": {"type": "MAS-20", "serial": "A1"}}
    trials = tuple(replace(one, run=name) for one in trials)
    return RunData(name, name, "contraction-relaxation", "finished", True, manifest, {}, (), {}, 100.0, trials)


def test_the_change_of_stroke_is_that_of_the_numbers_put_in():
    runs = [run(trial(0, FIRST), trial(1, 30e-3, reference=False), trial(5, FIRST * 1.004))]
    later = run(trial(11, FIRST * 0.95, again=True), start="2026-11-22T09:00", name="two")
    found = compared([later, *runs])
    assert [(one.trial.name, one.off) for one in found] == [
        ("one/6", pytest.approx(0.004, abs=1e-9)),
        ("two/12", pytest.approx(-0.05, abs=1e-9)),
    ]


def test_drift_beyond_the_bound_is_a_doubt_and_less_is_a_note():
    reported = reference_findings([run(trial(0, FIRST), trial(5, FIRST * 1.019), trial(11, FIRST * 0.95, again=True))])
    assert [one.level for one in reported] == ["doubt", "note"]
    assert "38 mm" in reported[0].text
    assert "-5.00%" in reported[0].text


def test_other_points_are_not_compared_and_flagged_samples_do_not_count():
    assert compared([run(trial(0, FIRST), trial(5, 50e-3, pressure=300e3))]) == []
    bad = trial(5, FIRST)
    bad.channels["displacement"][390:] += 1.0
    bad.flags[390:400] = Flag.DROPOUT
    (one,) = compared([run(trial(0, FIRST), bad)])
    assert one.off == pytest.approx(0.0, abs=1e-9)
