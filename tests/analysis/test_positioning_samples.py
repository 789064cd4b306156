"""Overshoots with few samples, or none at the peak: a second-order answer in closed form."""

import numpy as np
import pytest

from pmabench.kinds.reduce import reduce_runs
from pmabench.store.records import TrialData
from tests.analysis.judged_forms import as_run

STEP, OMEGA, DAMPING = 0.03, 6.0, 0.45
ROOT = np.sqrt(1 - DAMPING**2)
OVERSHOOT = float(np.exp(-np.pi * DAMPING / ROOT))
"""Of a second-order answer [1], at pi / (omega root) = 0.586 s."""


def found(rate, hole=(0.0, 0.0), spike=0.0):
    """The analysis of three trials; samples within `hole` [s] are missing, and one at 5 s is off by `spike` [m]."""
    rng, trials = np.random.default_rng(1), []
    for number in range(3):
        t = np.arange(-2, 10, 1 / rate)
        t = t[(t <= hole[0]) | (t >= hole[1])]
        after = np.maximum(t, 0)
        swing = np.cos(OMEGA * ROOT * after) + DAMPING / ROOT * np.sin(OMEGA * ROOT * after)
        x = np.where(t > 0, STEP * (1 - np.exp(-DAMPING * OMEGA * after) * swing), 0.0) + rng.normal(0, 1e-5, len(t))
        x[np.argmin(np.abs(t - 5.0))] += spike
        begin = 20.0 * number + 2
        law = {"t0": begin, "t1": begin + 10, "ended": "time", "setpoint": STEP}
        trials.append(TrialData("a", number, {"setpoint": STEP, "load": 0.0}, number, False, "finished", begin + t,
                                {"displacement": x}, np.zeros(len(t), dtype=np.uint16), (), {"position": law}))  # fmt: skip
    known = {"displacement": {"offset_uncertainty": 4e-5, "gain_uncertainty": 0.003}}
    run = as_run("positioning", trials, rate, {"window": [7.0, 10.0], "band": 0.02}, known)
    (analysis,) = reduce_runs([run])
    (value,) = [e for e in analysis.estimates if e.symbol == "OS" and "simulated" not in e.method]
    return value, [f.text for f in analysis.findings if "stand out alone" in f.text]


@pytest.mark.parametrize("rate", [20.0, 30.0, 100.0])
def test_a_smooth_peak_of_few_samples_is_no_spike(rate):
    """At 20 Hz the peak was left out: 4.3 half widths, and "a loose wire"."""
    e, spikes = found(rate)
    assert not spikes
    assert abs(e.value - OVERSHOOT) < e.parts.combined < 0.01


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_a_spike_is_still_left_out(rate):
    e, (text,) = found(rate, spike=0.01)
    assert text.startswith("3 of ")
    assert abs(e.value - OVERSHOOT) < e.parts.combined


@pytest.mark.parametrize("hole", [(0.4, 0.65), (0.5, 0.7), (0.55, 0.62)])
def test_a_peak_without_samples_is_held(hole):
    """3.8 half widths: the highest sample was taken for the peak."""
    e, _ = found(100.0, hole)
    assert abs(e.value - OVERSHOOT) < e.parts.combined
    assert e.parts.combined > found(100.0)[0].parts.combined


def test_samples_that_are_missing_elsewhere_change_nothing():
    assert found(100.0, (3.0, 3.3))[0].parts.combined == pytest.approx(found(100.0)[0].parts.combined, rel=0.02)
