"""The step in which a channel is read: of rounded samples, and none of ramps without noise."""

import math

import numpy as np
import pytest

from pmabench.analysis.shared.samples import count_of, step_of
from pmabench.store.records import ChannelInfo, RunData, TrialData

STEP = 1e-3


def rounded(y):
    return STEP * np.round(y / STEP)


T = np.arange(0.0, 10.0, 0.002)
SLOW = {
    "ramp": 0.037 * T,
    "wave": 0.05 * np.sin(2.3 * T),
    "rest with noise": 0.8 * STEP * np.random.default_rng(1).standard_normal(len(T)),
    "fast ramp with noise": 2.3 * T + 3 * STEP * np.random.default_rng(2).standard_normal(len(T)),
    "staircase": 0.01 * np.floor(T),
}


@pytest.mark.parametrize("name", SLOW)
def test_what_is_rounded_has_its_step(name):
    assert step_of(rounded(SLOW[name])) == pytest.approx(10 * STEP if name == "staircase" else STEP, rel=1e-6)


@pytest.mark.parametrize("y", [
    0.5 * T, np.clip(0.5 * T, 1.0, 4.0), np.concatenate([0.5 * T, 0.5 * T[::-1]]),
    np.interp(T, [0, 2, 4, 6, 10], [0, 1, 1, 2, 0]),
])  # fmt: skip
def test_ramps_without_noise_have_none(y):
    """Each sample moves as far as the one before: 1 mm with each was taken for steps of 1 mm."""
    assert step_of(y) == 0.0


def test_a_constant_has_no_step_that_is_known():
    assert step_of(np.full(100, 2.0)) == np.inf


def test_a_count_is_that_of_the_declaration_or_of_the_record():
    """Of an encoder in rad that reads in counts, nobody declares them."""
    count = 2 * math.pi / 2**12
    angle = count * np.round(0.2 * np.sin(T) / count)
    flags = np.zeros(len(T), np.uint16)
    trial = TrialData("c", 0, {}, 0, False, "finished", T, {"angle": angle}, flags, (), {})

    def counted(unit, slope):
        info = ChannelInfo("angle", "angle", unit, slope, 0.0, -np.inf, np.inf)
        return count_of(
            RunData("c", "", "made", "finished", True, {}, {}, (), {"angle": info}, 500.0, (trial,)), trial, "angle"
        )

    assert counted("rad", 1.0) == pytest.approx(count, rel=1e-6)
    assert counted("rad", count) == pytest.approx(count, rel=1e-6)
    assert counted("counts", 1e-3) == 1e-3
