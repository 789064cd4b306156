"""Segments are moving, unflagged, off the support; their averages satisfy the equation of motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from pmabench.analysis.shared.samples import Noise, Samples
from pmabench.kinds.contraction_relaxation.diagnosis import held_out
from pmabench.kinds.contraction_relaxation.segments import Gate, cut, gather, moved, noise_seen, velocity
from pmabench.store.records import Command, TrialData
from tests.analysis.judged_forms import as_run

RATE = 500.0
B, K, F_CE, F_L, TAU = 1500.0, 6000.0, 300.0, 100.0, 0.25


def exponential(noise: float = 0.0) -> Samples:
    """x = 33.3 mm (1 - exp(-t/0.25 s)) at constant pressure: B x' + K x = F_ce - F_L exactly."""
    t = np.arange(0, 4, 1 / RATE)
    x = (F_CE - F_L) / K * (1 - np.exp(-t / TAU))
    x += noise * np.random.default_rng(3).standard_normal(len(t))
    ok = np.ones(len(t), dtype=np.bool_)
    return Samples(0, t, np.full(len(t), 3e5), x, np.full(len(t), F_L), ok, F_L, 0.5)


def test_averages_satisfy_the_equation_of_motion():
    segments = cut([exponential()], RATE, Gate())
    assert len(segments) > 10
    x, v = segments.x @ segments.weights, segments.v.mean(axis=1)
    assert segments.weights.sum() == pytest.approx(1.0)
    assert (F_CE - K * x - B * v) == pytest.approx(F_L, abs=5e-3)
    assert segments.force == pytest.approx(F_L)
    assert (segments.way == 1.0).all()


def test_every_segment_moves_faster_than_the_gate():
    gate = Gate(speed=20e-3)
    segments = cut([exponential(2e-6)], RATE, gate)
    assert np.abs(segments.v).min() > gate.speed
    # x' = 133 mm/s exp(-t / 0.25 s) falls below 20 mm/s at 0.474 s
    assert segments.t.max() + gate.length < 0.475


def test_relaxing_and_the_inertia_of_a_weight():
    up = exponential()
    down = replace(up, x=up.x[::-1].copy(), force=None, mass=40.0)
    segments = cut([down], RATE, Gate())
    assert (segments.way == -1.0).all()
    v = segments.v.mean(axis=1)
    # going backwards, x'' = v / tau: M x'' adds to the weight
    assert segments.force == pytest.approx(F_L + 40.0 * v / TAU, rel=2e-3)
    assert (segments.mass == 40.0).all()


def test_flagged_samples_are_in_no_segment():
    samples = exponential()
    samples.ok[100:103] = False
    samples.x[100:103] = np.nan
    segments = cut([samples], RATE, Gate())
    assert np.isfinite(segments.x).all()
    assert np.isfinite(segments.v).all()
    flagged = samples.t[101]
    assert not np.any((segments.t < flagged) & (segments.t + 0.04 > flagged))


def test_nothing_moves_no_segment():
    samples = exponential()
    none = cut([replace(samples, x=np.zeros_like(samples.x))], RATE, Gate())
    assert len(none) == 0


def test_velocity_of_a_straight_line():
    t = np.arange(50) / RATE
    assert velocity(t, 0.3 * t, 4)[4:-4] == pytest.approx(0.3)


def test_a_shifted_channel():
    segments = cut([exponential()], RATE, Gate())
    assert segments.shifted("pressure", 0.01, 100.0).pressure == pytest.approx(3e5 * 1.01 + 100.0)
    longer = segments.shifted("displacement", 0.01, 0.0)
    assert longer.v == pytest.approx(1.01 * segments.v)
    assert segments.shifted("force", 0.0, 2.0).force == pytest.approx(F_L + 2.0)


def test_noise_is_seen_where_nothing_moves():
    samples = exponential(5e-6)
    assert noise_seen([samples], [slice(1000, 2000)])[0] == Noise(0.0, pytest.approx(5e-6, rel=0.1), 0.0)


def test_a_flagged_sample_does_not_hide_the_noise_of_a_rest():
    samples = exponential(5e-6)
    samples.ok[[1100, 1500]] = False
    assert noise_seen([samples], [slice(1000, 2000)])[0].displacement == pytest.approx(5e-6, rel=0.15)
    samples.ok[1000:2000] = False
    assert noise_seen([samples], [slice(1000, 2000)])[0] == Noise(0.0, 0.0, 0.0)


def test_coarse_steps_are_noise_though_a_channel_at_rest_shows_none():
    fine, step = exponential(), 23e-6
    samples = replace(fine, x=step * np.round(fine.x / step))
    still = noise_seen([samples], [slice(1000, 2000)])[0]
    moving = np.std((samples.x - fine.x)[50:500])
    assert still.displacement == pytest.approx(step / np.sqrt(12), rel=1e-6)
    assert moving == pytest.approx(still.displacement, rel=0.1)


def test_noise_of_a_channel_that_is_interpolated_counts_for_the_samples_that_there_are():
    """A mean over 20 rows of a channel whose own samples come at every 10th is a mean of two."""
    own = 3e5 + 500 * np.random.default_rng(5).standard_normal(2000)
    rows = np.arange(20_000)
    P = np.interp(rows, np.arange(2000) * 10 + 3, own)
    samples = replace(exponential(), t=rows / RATE, P=P, x=np.zeros(20_000), force=None, ok=np.ones(20_000, bool))
    noise = noise_seen([samples], [slice(100, 19_000)], {"P": 10})[0].pressure
    means = P[100:19_100].reshape(-1, 20).mean(axis=1)
    assert noise == pytest.approx(500 * np.sqrt(10), rel=0.1)
    assert means.std() == pytest.approx(noise / np.sqrt(20), rel=0.25)


def white(rng: np.random.Generator) -> Samples:
    """20 samples of rest with white noise of 1 on the displacement."""
    still = np.zeros(20)
    return Samples(0, still, still, rng.standard_normal(20), None, np.ones(20, dtype=np.bool_), F_L, 0.5)


def test_noise_of_short_rests_is_as_uncertain_as_its_degrees_of_freedom_say():
    rng, rests = np.random.default_rng(2), [slice(0, 20)] * 8
    found = [noise_seen([white(rng) for _ in rests], rests) for _ in range(400)]
    freedom = found[0][2]["displacement"]
    sizes = np.array([noise.displacement for noise, _, _ in found])
    assert sizes.mean() == pytest.approx(1.0, abs=0.03)
    assert sizes.std() == pytest.approx(np.sqrt(1 / (2 * freedom)), rel=0.15)


@pytest.mark.parametrize(("n", "m"), [(50, 24), (470, 130), (470, 1e6), (2000, 60)])
def test_the_largest_ratio_of_two_variances_by_chance(n, m):
    assert held_out._largest(4.0, n, m) == pytest.approx(stats.f.isf(stats.norm.sf(4.0), n, m), rel=0.03)


def test_a_slow_gauge_shows_its_noise_in_all_rests_of_few_trials():
    """At 50 Hz the last fifth of a short hold has 10 values, of which the noise came out up to a third too small."""
    rows, own = np.arange(2000), np.arange(202) * 10
    commands = tuple(Command(at, "pressure", "set", 1e5, 0.0, "", {}) for at in (0.0, 2.0))
    found = []
    for seed in range(40):
        rng, trials = np.random.default_rng([7, seed]), []
        for number in range(6):
            P = np.interp(rows + rng.integers(10), own, 3e5 + 500 * rng.standard_normal(len(own)))
            channels = {"pressure": P, "displacement": np.zeros(2000)}
            flags, point = np.zeros(2000, np.uint16), {"pressure": 3e5, "load": 50.0}
            trials.append(
                TrialData("judged", number, point, 0, False, "finished", rows / RATE, channels, flags, commands, {})
            )
        campaign, _ = gather([as_run("contraction-relaxation", trials, RATE, {}, {"pressure": {"rate": 50.0}})])
        found.append(campaign.noise.pressure / (500 * np.sqrt(10)))
    assert np.mean(found) == pytest.approx(1.0, abs=0.05)
    assert np.std(found) < 0.1  # 0.17 of one rest each
    assert np.std(found) == pytest.approx(np.sqrt(1 / (2 * campaign.freedom["pressure"])), rel=0.3)


@pytest.mark.parametrize("channel", ["pressure", "displacement", "force"])
def test_a_clock_that_is_moved_loses_no_segment_where_samples_come_unevenly(channel):
    """A polled device on a busy machine: steps of 1 ms to 5 ms at 500 Hz. Lost segments would be taken for the clock."""
    even = exponential()
    t = even.t + 1.5e-3 * np.random.default_rng(8).uniform(-1, 1, len(even.t))
    x = (F_CE - F_L) / K * (1 - np.exp(-t / TAU))
    uneven = replace(even, t=t, x=x)
    before, after = (cut([one], RATE, Gate()) for one in (uneven, moved(uneven, [channel], 1e-6)))
    assert after.t.tolist() == before.t.tolist()
    assert len(before) > 10
