"""A channel that repeats one reading although it has noise was not measured; others that rest are sound (R5)."""

import numpy as np
import pytest

from pmabench.analysis.verdict.repeated import repeated
from pmabench.store.records import ChannelInfo, Flag, RunData, TrialData

T = np.arange(0.0, 6.0, 0.01)


def run(*trials, flags=0, manifest=None, t=T, rate=0.0):
    """A run of one load cell; `trials` are its readings [N], `rate` is that of its stream [Hz], 0 if not regular."""
    made = tuple(
        TrialData("r", n, {}, 0, False, "finished", t, {"force": force}, np.full(len(t), flags, np.uint16), (), {})
        for n, force in enumerate(trials)
    )
    info = ChannelInfo("force", "force", "N", 1.0, 0.0, -50.0, 1950.0, rate=rate)
    return RunData("r", "", "x", "finished", False, manifest or {}, {}, (), {"force": info}, 100.0, made)


def noise(seed, rms=0.2, at=58.86, t=T):
    return np.round(at + np.random.default_rng(seed).normal(0.0, rms, len(t)), 2)


def stopped(seed, after, t=T):
    """The last reading of a device that measures until `after` [s]."""
    force = noise(seed, t=t)
    force[t >= after] = 58.90
    return force


def test_a_load_cell_that_answers_and_measures_no_more_is_named():
    """58.90 N for 5 s of the second trial and all of the third; the noise of before is 0.2 N."""
    (found,) = repeated([run(noise(1), stopped(2, 1.0), stopped(3, 0.0))])
    assert found.level == "doubt"
    assert "force repeats 58.9 N exactly, for up to 5.99 s (trials 2, 3)" in found.text
    scatter = float(found.text.partition("scatters by ")[2].split()[0])
    assert scatter == pytest.approx(0.2, rel=0.25)


def test_a_slower_stream_on_the_times_of_a_faster_one_is_named_too():
    fast = np.arange(0.0, 6.0, 0.002)
    slow = np.arange(0.0, 6.0, 0.02)
    readings = [np.interp(fast, slow, force) for force in (noise(1, t=slow), stopped(2, 3.0, t=slow))]
    assert "for up to 3 s (trial 2)" in repeated([run(*readings, t=fast, rate=50.0)])[0].text


def gauge(t):
    """A noise-free encoder: it moves with a time constant of 0.4 s, and rests."""
    return np.round(40.0 * (1 - np.exp(-t / 0.4)) * np.where(t < 4.0, 1.0, np.exp(-(t - 4.0) / 0.4)), 2)


SOUND = {
    "noise": [noise(seed) for seed in range(3)],
    "an encoder without noise": [gauge(T), gauge(T) + 10.0],
    "a drive on a sine, and at rest": [np.where(T < 3.0, 20.0 + 5.0 * np.sin(2 * np.pi * 3.0 * T), 20.0 + k) for k in (1, 2)],
    "coarse steps": [np.round(noise(seed, 0.05, 58.3 + 0.1 * seed) / 0.5) * 0.5 for seed in range(5)],
    "a gauge that reads no less than 0": [np.maximum(noise(seed, 0.2, -3.0 if seed % 2 else 50.0), 0.0) for seed in range(6)],
    "short": [stopped(1, 5.2), noise(2)],
    "at its upper end": [np.minimum(noise(seed, 0.2, 58.0 + 6.0 * (seed % 2)), 60.0) for seed in range(6)],
    "nothing measured": [np.full(len(T), np.nan)] * 2,
    "no samples": [],
}  # fmt: skip


@pytest.mark.parametrize("rate", [100.0, 200.0, 1000.0])
@pytest.mark.parametrize("f", [4.5, 5.0, 5.7, 6.3, 7.3, 7.7, 9.0])
def test_a_motion_that_reverses_often_is_no_noise(f, rate):
    """10 um counts at rest for 4 s, then a sine of 0.8 mm; 0.1 N counts under a weight, and a vibration of 0.4 N."""
    t = np.arange(0.0, 12.0, 1 / rate)
    for rest, swing, count in ((12.34, 0.8, 0.01), (20.03, 0.4, 0.1)):
        y = np.where(t < 4.0, rest, rest + 3 + swing * np.sin(2 * np.pi * f * (t - 4.0)))
        y = y + (count > 0.05) * np.random.default_rng(2).normal(0.0, 0.01, len(t))
        y[0] = 0.0
        assert repeated([run(np.round(y / count) * count, t=t)]) == ()


@pytest.mark.parametrize("name", SOUND)
def test_what_rests_is_not_named(name):
    assert repeated([run(*SOUND[name])]) == ()


def test_what_is_known_already_is_not_named():
    """An import looks at it with the map of the file; flagged samples are in no fit."""
    readings = noise(1), stopped(2, 1.0)
    assert repeated([run(*readings, manifest={"imported": {"file": "x"}})]) == ()
    assert repeated([run(*readings, flags=int(Flag.STALE))]) == ()


def test_a_trial_without_samples_is_left_out():
    empty = np.zeros(0)
    assert repeated([run(empty, empty, t=empty)]) == ()
