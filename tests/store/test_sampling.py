"""How evenly a run was sampled, against times made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.store.records import Flag, TrialData
from pmabench.store.timebase import sampling


def trial(times, flags=None):
    flags = np.zeros(len(times), dtype=np.uint16) if flags is None else np.array(flags, dtype=np.uint16)
    return TrialData("r", 0, {}, 0, False, "finished", np.array(times, dtype=float), {}, flags, (), {})


def test_ten_seconds_at_500_hz_are_5000_intervals_without_jitter():
    found = sampling([trial(np.arange(5001) / 500)])
    assert (found.rows, found.late, found.gaps) == (5001, 0, 0)
    assert found.rate == pytest.approx(500.0)
    assert (found.interval, found.longest) == pytest.approx((0.002, 0.002))
    assert found.jitter == pytest.approx(0.0, abs=1e-12)


def test_jitter_is_the_spread_of_what_was_taken_and_leaves_gaps_out():
    rng = np.random.default_rng(3)
    times = np.arange(20_000) / 100 + rng.normal(0.0, 1e-3, 20_000)
    kept = np.r_[0:5000, 5010:20_000]
    flags = np.zeros(len(kept), dtype=np.uint16)
    flags[5000] = Flag.GAP
    flags[7] = Flag.LATE
    found = sampling([trial(times[kept], flags)])
    assert found.jitter == pytest.approx(np.sqrt(2) * 1e-3, rel=0.03)  # of a difference of two
    assert found.longest == pytest.approx(0.11, abs=5e-3)
    assert (found.late, found.gaps) == (1, 1)


def test_time_between_trials_is_not_an_interval():
    two = [trial([0.0, 0.1, 0.2]), replace(trial([10.0, 10.1, 10.2]), index=1)]
    assert sampling(two).rate == pytest.approx(10.0)
    assert sampling([trial([1.0])]) is None
