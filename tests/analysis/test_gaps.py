"""Samples that are missing where a value lies: it holds the gap in its interval, or is withheld."""

import numpy as np
import pytest

from pmabench.analysis.shared.gaps import highest, reached
from pmabench.analysis.shared.signals import respond

OMEGA, DAMPING, STEP = 9.0, 0.45, 0.35
ROOT = np.sqrt(1 - DAMPING**2)
OVERSHOOT = float(np.exp(-np.pi * DAMPING / ROOT))


def answer(t):
    """Of second order, in closed form; its peak is at pi / (omega root) = 0.391 s."""
    return STEP * (1 - np.exp(-DAMPING * OMEGA * t) * (np.cos(OMEGA * ROOT * t) + DAMPING / ROOT * np.sin(OMEGA * ROOT * t)))  # fmt: skip


def times():
    """Rise and settling time [s] from a fine table."""
    t = np.linspace(0, 5, 500_001)
    x = answer(t)
    return t[np.argmax(x >= 0.9 * STEP)] - t[np.argmax(x >= 0.1 * STEP)], t[
        np.flatnonzero(np.abs(x - STEP) > 0.02 * STEP)[-1]
    ]


def responded(*holes, rate=500.0, noise=1e-4, seed=1):
    t = np.arange(0, 5, 1 / rate)
    x = answer(t) + noise * np.random.default_rng(seed).standard_normal(len(t))
    there = ~np.any([(t >= begin) & (t <= end) for begin, end in [(9, 9), *holes]], axis=0)
    return respond(t[there], x[there], STEP, (4.0, 5.0), 0.02)


@pytest.mark.parametrize("holes", [
    [(0.2, 0.45)], [(0.2, 0.3)], [(0.15, 0.22)], [(0.05, 0.1)], [(0.05, 0.3)], [(-0.1, 0.15)], [(0.05, 0.12), (0.2, 0.3)],
    [(0.03, 0.5)], [(-0.1, 0.5)], [(0.6, 1.0)], [(0.7, 0.85)],
])  # fmt: skip
def test_times_whose_crossing_has_no_samples_hold_the_gap(holes):
    rise, settled = times()
    found = responded(*holes)
    assert abs(found.rise - rise) <= found.unsure.rise
    assert abs(found.settling - settled) <= found.unsure.settling
    assert abs(found.overshoot - OVERSHOOT) <= found.unsure.overshoot


@pytest.mark.parametrize("rate", [50.0, 500.0])
def test_gaps_elsewhere_change_no_interval(rate):
    sound, found = responded(rate=rate), responded((1.6, 1.9), (3.0, 3.7), rate=rate)
    assert found.unsure.rise == sound.unsure.rise
    assert found.unsure.settling == sound.unsure.settling
    assert found.unsure.overshoot == pytest.approx(sound.unsure.overshoot, rel=0.05)
    assert found.rise == sound.rise


@pytest.mark.parametrize("hole", [(-0.1, 0.5), (0.03, 0.5)])
def test_an_overshoot_is_unknown_where_the_whole_way_up_is_missing(hole):
    """The slope before the gap is not the largest of the motion, so it bounds nothing."""
    assert responded(hole).unsure.overshoot == np.inf
    assert responded((hole[0], 0.25)).unsure.overshoot < 0.05, "it still rises after the gap"


def test_a_motion_stays_below_the_lines_before_and_after_a_gap():
    t = np.array([0.0, 1, 2, 3, 4, 10, 11, 12, 13, 14])
    y = np.array([0.0, 1, 2, 3, 4, 6, 5, 4, 3, 2])  # y = t and y = 16 - t meet at 8
    assert highest(t, y, 1.0, 0)[5] == pytest.approx(8.0)
    assert highest(t, y, 1.0, 5)[5] == np.inf
    assert highest(t, y, 1.0, 6)[5] == -np.inf
    assert reached(t, y, highest(t, y, 1.0, 0), 5.0, 1.0) == pytest.approx((4.0, 7.0, 10.0))


@pytest.mark.parametrize("left", [1, 2, 3])
def test_a_gap_just_before_the_end_may_hide_a_peak(left):
    """The slope after it is unknown, and the motion stays below the line before: it was taken for no gap."""
    t = np.concatenate([np.arange(1, 60) * 0.01, 0.81 + 0.01 * np.arange(1, left + 1)])
    y = 1.2 * np.sin(2 * t)  # 1.2 at 0.785 s
    assert 1.2 <= highest(t, y, 0.01, 10)[59] < 1.35
    assert highest(t, y, 0.01, 59)[59] == np.inf
    assert np.all(highest(t[:59], y[:59], 0.01, 10) == -np.inf)
    assert highest(t, 0 * y, 0.01, 10)[59] == 0.0, "at rest nothing is hidden"
