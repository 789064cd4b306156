"""Runs of several days in one analysis: sines of known amplitudes, the displacement mounted anew every day."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.recorded_sine.reduction import reduce
from pmabench.kinds.reduce import reduce_runs
from pmabench.store.records import TrialData
from tests.analysis.loop_rig import as_run

RATE, F, X, P = 200.0, 1.0, 4e-3, 46e3


def day(number, scale, seed):
    """A run of two trials, its amplitude of the displacement `scale` times X."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(10 * RATE)) / RATE
    w = 2 * np.pi * F * t
    trials = []
    for i in range(2):
        channels = {
            "pressure": 2.5e5 + P * np.sin(w - 0.3) + rng.normal(0, 300.0, len(t)),
            "displacement": 0.02
            + scale * X * (1 + rng.normal(0, 1e-3)) * np.sin(w - 0.5)
            + rng.normal(0, 4e-6, len(t)),
            "pressure_command": 2.5e5 + 5e4 * np.sin(w),
        }
        flags = np.zeros(len(t), dtype=np.uint16)
        trials.append(
            TrialData(f"day{number}", i, {"frequency": F}, i, False, "finished", 100 * i + t, channels, flags, (), {})
        )
    on_time = {"imported": {"late_by": {"pressure": [0.0, 0.0]}, "folder": f"day{number}"}}
    return replace(as_run("recorded-sine", trials), id=f"day{number}", rate=RATE, manifest=on_time)


def amplitude(analysis):
    return next(e for e in analysis.estimates if e.symbol == "x")


@pytest.mark.parametrize("scales", [(1.008, 1.012, 0.995), (1.012, 0.998), (1.0, 0.99, 1.001, 0.988)])
def test_days_that_differ_by_more_than_their_repeats_are_in_the_interval(scales):
    """The amplitude was up to 3.3 half widths off: trials of all days were repeats of each other."""
    (analysis,) = reduce_runs([day(i, scale, i) for i, scale in enumerate(scales)])
    e = amplitude(analysis)
    assert abs(e.value - X) < e.parts.combined
    assert any(line.name == "scatter between sessions" for line in e.budget)
    assert any("differ between the" in line.text for line in analysis.findings)


def test_days_that_agree_keep_the_interval_of_their_repeats():
    wider = []
    for first in range(10, 60, 10):
        runs = [day(i, 1.0, first + i) for i in range(3)]
        (analysis,) = reduce_runs(runs)
        pairs = zip(analysis.estimates, reduce(runs).estimates, strict=True)
        wider += [one.parts.combined > 1.001 * other.parts.combined for one, other in pairs]
    assert np.mean(wider) < 0.1
