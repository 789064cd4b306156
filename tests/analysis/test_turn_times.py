"""The time between force and motion at a turn: its interval holds what was put in, and rounding decides nothing."""

import numpy as np
import pytest

from pmabench.analysis.shared.lines import left_by
from pmabench.analysis.shared.ramp_loop import behind

PERIOD = 5e-3
TURNS = (2.0, 4.0, 6.0)
SPAN = 0.2


def turned(late: float, jump: float, noise: float, seed: int):
    """A triangle of displacement [m] and a force [N] that falls and rises by `jump` `late` [s] after each turn."""
    chance = np.random.default_rng(seed)
    t = np.arange(0.0, 8.0, PERIOD) + chance.uniform(0, PERIOD)

    def way(t):
        return np.where((t // 2.0) % 2 == 0, 1.0, -1.0)

    x = 1e-3 * np.abs((t + 2.0) % 4.0 - 2.0)
    F = 300.0 + 2e3 * x + 0.5 * jump * way(t - late) + noise * chance.standard_normal(len(t))
    return t, x + 1e-6 * chance.standard_normal(len(t)), F


@pytest.mark.parametrize(("late", "jump"), [(0.0125, 0.5), (-0.03, 0.5), (-0.03, 3.0)])
def test_the_interval_holds_the_delay(late: float, jump: float):
    found = [behind(*turned(late, jump, 0.3, seed), TURNS, SPAN) for seed in range(30)]
    assert np.mean([abs(one.time - late) <= one.half for one in found]) >= 0.93
    if jump == 3.0:
        assert np.median([one.half for one in found]) < 0.02, "a jump of ten times the noise is seen"


def test_rounding_decides_nothing():
    """Between two samples any delay leaves the same: in another unit of force the same delay comes out."""
    for seed in range(20):
        t, x, F = turned(0.0, 1.0, 0.3, seed)
        one, other = (behind(t, x, F * unit, TURNS, SPAN) for unit in (1.0, 1.0 / 3.0))
        assert (one.time, one.half) == pytest.approx((other.time, other.half), abs=1e-12)


def test_what_is_left_is_what_least_squares_leaves():
    """Also where columns are alike, or all zero."""
    chance = np.random.default_rng(1)
    fixed, tried, y = chance.normal(size=(2, 30)), chance.normal(size=(7, 3, 30)), chance.normal(size=30)
    tried[2, 1] = 2 * tried[2, 0] - fixed[1]
    tried[3] = 0.0
    tried[4] *= 1e-9
    asked = [np.linalg.lstsq(np.vstack([fixed, one]).T, y, rcond=1e-12)[0] @ np.vstack([fixed, one]) for one in tried]
    assert left_by(fixed, tried, y) == pytest.approx([np.sum((y - one) ** 2) for one in asked], rel=1e-9)
