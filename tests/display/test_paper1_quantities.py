"""What is told after each of paper 1's single steps: stroke and time constant, and K of a contraction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmabench.analysis.trial import Quick
from pmabench.display.verdicts import measure
from tests.analysis.test_paper1 import single_steps, table


def test_each_direction_shows_its_stroke_and_time_constant():
    run = single_steps([3e5])
    S = table("K")(3e5)
    reported = [{m.symbol: m.value for m in measure(run, trial, None, Quick())[0]} for trial in run.trials]
    assert set(reported[0]) == {"x_max", "tau", "K"}
    assert set(reported[1]) == {"x_max", "tau"}
    assert reported[0]["K"] == pytest.approx(S, rel=1e-4)
    for values, symbol in zip(reported, ("B_c", "B_r"), strict=True):
        assert values["x_max"] == pytest.approx(65.9e-3, abs=0.05e-3)
        assert values["tau"] == pytest.approx(table(symbol)(3e5) / S, rel=3e-3)
    assert not any(measure(run, trial, None, Quick())[1] for trial in run.trials)


def test_a_step_that_does_not_move_or_does_not_rest_is_doubted():
    run = single_steps([3e5])
    trial = run.trials[0]
    still = replace(trial, channels={**trial.channels, "displacement": np.zeros(len(trial.t))})
    found, doubts = measure(run, still, None, Quick())
    assert [m.value for m in found] == [None, None]
    assert "too little motion" in doubts[0]
    rows = trial.t < trial.t[0] + 1.2
    short = replace(
        trial,
        t=trial.t[rows],
        flags=trial.flags[rows],
        channels={name: values[rows] for name, values in trial.channels.items()},
    )
    assert "still drifting" in measure(run, short, None, Quick())[1][0]
