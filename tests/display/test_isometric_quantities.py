"""Numbers of one isometric pressurisation against a closed form: F = 1 N/kPa (P - 45 kPa), 4 N between the ramps."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.analysis.trial import Expected, Quick
from pmabench.display.verdicts import measure
from pmabench.display.wording import point_text
from pmabench.store.records import Command, RunData, TrialData

EXPECTED = Expected(
    source="closed form", pressure=np.array([1e5, 5e5]), F_ce=np.array([55.0, 455.0]), K=np.array([6000.0, 8000.0]),
    B_c=np.array([1500.0, 2000.0]), B_r=np.array([1700.0, 2200.0]), F_c=3.0,
)  # fmt: skip


def trial():
    t = np.arange(0, 54.0, 0.01)
    P = np.interp(t, [1.0, 26.0, 28.0, 53.0], [0.0, 5e5, 5e5, 0.0])
    F = np.maximum(1e-3 * (P - 45e3), 0.0)
    F = F + np.where(t < 27.0, -2.0, 2.0) * (F > 0) * (P < 5e5)
    commands = (
        Command(1.0, "pressure", "ramp", 5e5, 0.0, "fill", {"rate": 20e3}),
        Command(28.0, "pressure", "ramp", 0.0, 5e5, "empty", {"rate": 20e3}),
    )
    channels = {"pressure": P, "force": F, "displacement": np.zeros(len(t))}
    flags = np.zeros(len(t), np.uint16)
    return TrialData("r", 0, {"contraction": 0.0}, 0, False, "finished", t, channels, flags, commands, {})


def reported(this):
    run = RunData("r", "r", "isometric-pressurisation", "running", True, {}, {"settings": {}}, (), {}, 100.0, ())
    numbers, doubts = measure(run, this, EXPECTED, Quick())
    return {number.symbol: number for number in numbers}, doubts


def test_slope_threshold_gap_and_force_at_the_top():
    numbers, doubts = reported(trial())
    assert doubts == []
    assert numbers["m"].value == pytest.approx(1e-3, rel=1e-3)
    assert numbers["p_0"].value == pytest.approx(45e3, abs=1.5e3)
    assert numbers["H"].value == pytest.approx(4.0, abs=0.1)
    assert numbers["F"].value == pytest.approx(455.0, abs=2.1)
    assert numbers["F"].expected == pytest.approx(455.0)


def test_a_slack_muscle_and_a_trial_cut_short_are_said():
    slack = trial()
    _, doubts = reported(replace(slack, channels={**slack.channels, "force": np.zeros(len(slack.t))}))
    assert "slack: up to 500 kPa" in doubts[0]
    numbers, doubts = reported(replace(trial(), status="failed"))
    assert doubts == ["the trial is failed"]
    assert numbers["m"].value is None


def test_contractions_and_speeds_are_reported_in_their_units():
    assert point_text({"contraction": -0.002, "side": 1.0}) == "contraction -2 mm, side 1"
    assert point_text({"speed": 0.01, "upper": 0.02}) == "speed 10 mm/s, upper 20 mm"
