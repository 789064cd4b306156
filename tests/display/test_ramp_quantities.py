"""Numbers of one isobaric ramp against a closed form: F = F_ce - K x - B x', and a hysteresis of 12 N."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.analysis.trial import Expected, Quick
from pmabench.display.verdicts import _not_reached, measure
from pmabench.store.records import Command, RunData, TrialData

EXPECTED = Expected(
    source="closed form", pressure=np.array([3e5]), F_ce=np.array([275.0]), K=np.array([7000.0]),
    B_c=np.array([1500.0]), B_r=np.array([1700.0]), F_c=6.0,
)  # fmt: skip


def ramp(sign=1.0, status="finished"):
    """Two cycles between 0 and 20 mm at 10 mm/s."""
    t = np.arange(0, 8.0, 0.005)
    up = (t % 4.0) < 2.0
    x = 0.01 * np.where(up, t % 4.0, 4.0 - t % 4.0)
    F = 275.0 - sign * 7000.0 * x - np.where(up, 1500.0 * 0.01 + 6.0, -1700.0 * 0.01 - 6.0)
    commands = tuple(
        Command(2.0 * i, "displacement", "ramp", *((0.02, 0.0, "contract") if i % 2 == 0 else (0.0, 0.02, "expand")),
                {"rate": 0.01})
        for i in range(4)
    )  # fmt: skip
    point = {"pressure": 3e5, "speed": 0.01, "lower": 0.0, "upper": 0.02, "cycles": 2.0}
    channels = {"displacement": x, "force": F, "pressure": np.full(len(t), 3e5)}
    return TrialData("r", 0, point, 0, False, status, t, channels, np.zeros(len(t), np.uint16), commands, {})


def reported(trial):
    settings = {"discard": 1, "turn": 0.001}
    run = RunData("r", "r", "isobaric-ramp", "running", True, {}, {"settings": settings}, (), {}, 200.0, ())
    numbers, doubts = measure(run, trial, EXPECTED, Quick())
    return {number.symbol: number for number in numbers}, doubts


def test_a_ramp_gives_stiffness_and_the_gap_of_its_branches():
    numbers, doubts = reported(ramp())
    assert doubts == []
    assert numbers["K"].value == pytest.approx(7000.0, rel=1e-6)
    assert numbers["H"].value == pytest.approx(12.0 + 3200.0 * 0.01, rel=1e-6)
    assert numbers["H"].expected == pytest.approx(44.0)
    assert numbers["P"].value == pytest.approx(3e5)


def test_what_is_wrong_with_a_ramp_is_said():
    assert reported(ramp(status="failed"))[1] == ["the trial is failed"]
    upside_down = ramp()
    channels = {**upside_down.channels, "force": 500.0 - upside_down.channels["force"]}
    assert any(
        "upper one" in doubt for doubt in reported(type(upside_down)(**{**vars(upside_down), "channels": channels}))[1]
    )


@pytest.mark.parametrize(("share", "said"), [(1.06, ["318 kPa of 300 kPa (held)"]), (1.005, [])])
def test_a_pressure_that_was_set_before_the_trial_is_held_against_its_command(share, said):
    """A regulator that gave 6 % more was "ok" in every trial's line."""
    trial = ramp()
    trial = replace(trial, channels={**trial.channels, "pressure": share * trial.channels["pressure"]})
    assert [text.partition(": ")[2] for text in _not_reached(trial)] == said


def test_a_step_of_displacement_gives_stiffness_and_what_the_peak_is_beyond():
    """F = 275 - K x - B x', 5 mm at 50 mm/s: the peak is B v below the relaxed force."""
    t = np.arange(0.0, 4.2, 0.002)
    x = 0.01 + np.interp(t, [0, 1.0, 1.1, 2.1, 2.2, 4.2], [0, 0, 0.005, 0.005, 0, 0])
    v = np.interp(t, [0, 0.999, 1.0, 1.099, 1.1, 2.099, 2.1, 2.199, 2.2, 4.2], [0, 0, 1, 1, 0, 0, -1, -1, 0, 0]) * 0.05
    commands = (
        Command(1.0, "displacement", "ramp", 0.015, 0.01, "step", {"rate": 0.05}),
        Command(2.1, "displacement", "ramp", 0.01, 0.015, "back", {"rate": 0.05}),
    )
    channels = {"displacement": x, "force": 275.0 - 7000.0 * x - 1500.0 * v, "pressure": np.full(len(t), 3e5)}
    point = {"pressure": 3e5, "start": 0.01, "step": 0.005, "speed": 0.05, "cycles": 1.0}
    trial = TrialData("r", 0, point, 0, False, "finished", t, channels, np.zeros(len(t), np.uint16), commands, {})
    run = RunData("r", "r", "step-displacement", "running", True, {}, {"settings": {"discard": 0}}, (), {}, 500.0, ())
    numbers, doubts = measure(run, trial, EXPECTED, Quick())
    assert doubts == []
    assert {n.symbol: n.value for n in numbers} == pytest.approx({"K": 7000.0, "overshoot": 75.0}, rel=0.01)
