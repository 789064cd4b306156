"""Bandwidth over recorded sines: closed forms of one lag, and runs whose muscle is one."""

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest

from pmabench.kinds.recorded_sine.form import COMMAND, PRESSURE, crossing
from pmabench.kinds.recorded_sine.reduction import reduce
from pmabench.store.records import TrialData
from tests.analysis.loop_rig import as_run

TAU = 0.2
TRUTH = 1 / (2 * pi * TAU)


def trial(index, f, *, tau=TAU, noise=0.0, command=True):
    """x follows the command through one lag, P follows it at once and twice as large."""
    t = np.arange(0.0, 12.0 / f + 2.0, min(0.02, 1 / (60 * f)))
    G = 1 / (1 + 2j * pi * f * tau)
    wave = np.exp(2j * pi * f * t)
    rng = np.random.default_rng(index)
    channels = {
        "pressure": 2e5 + 2e4 * wave.real,
        "displacement": 0.02 + 0.005 * (G * wave).real + noise * rng.standard_normal(len(t)),
    }
    channels |= {"pressure_command": 2e5 + 1e4 * wave.real} if command else {}
    flags = np.zeros(len(t), np.uint16)
    return TrialData("r1", index, {"frequency": f}, 0, False, "finished", t, channels, flags, (), {})


def found(*trials):
    run = as_run("recorded-sine", list(trials), {})
    return [e for e in reduce([run]).estimates if e.symbol == "f_b"]


def test_one_lag_between_two_frequencies_is_exact():
    coarse, fine = np.array([1e-4, 0.3, 1.7, 4.0]), np.array([1e-4, 0.75, 0.85])
    for f, most in ((coarse, 0.4), (fine, 0.004)):
        value, apart = crossing(f, 1 / np.sqrt(1 + (2 * pi * f * TAU) ** 2))
        assert value == pytest.approx(TRUTH, rel=1e-6)
        assert 0 < apart < most * TRUTH, "frequencies near the crossing leave little to the form"


def test_that_of_a_recorded_sweep_is_that_of_the_lag():
    """Against the gain at the slowest, which has fallen a little itself."""
    frequencies = (0.05, 0.2, 0.5, 1.0, 2.0)
    (e,) = found(*(trial(i, f, noise=1e-5) for i, f in enumerate(frequencies)))
    first = 1 + (2 * pi * 0.05 * TAU) ** 2
    assert e.value == pytest.approx(sqrt(2 * first - 1) / (2 * pi * TAU), rel=2e-3)
    assert e.method == COMMAND
    assert e.parts.repeats is not None
    (e,) = found(*(trial(i, f, command=False) for i, f in enumerate(frequencies)))
    assert e.method == PRESSURE


def test_a_gain_that_does_not_fall_so_far_has_none():
    (e,) = found(*(trial(i, f) for i, f in enumerate((0.05, 0.1, 0.2))))
    assert e.value is None
    assert "0.2" in e.note
    assert found(trial(0, 0.05), trial(1, 5.0)) == []
    dead = replace(trial(2, 0.2), status="aborted")
    assert found(trial(0, 0.05), trial(1, 5.0), dead) == []
