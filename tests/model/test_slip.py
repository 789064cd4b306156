"""One implicit step of sliding against `solve_ivp` at tight tolerance, on both parts of the friction and across them."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pmabench.model.muscle import Friction
from pmabench.model.plant import glide

STICTION = Friction(F_s=10.0, F_c=6.0, speed=1e-3)
STICKY = Friction(F_s=40.0, F_c=8.0, speed=1e-3)
"""With a slope far beyond every damping: what begins to slide runs away from rest."""


def reference(friction, h, speed, drive, linear, mass):
    """Way, speed and the time left when it stood, by DOP853, restarted where the friction changes its part."""
    (push, rate), (B, K) = drive, linear
    t, y = 0.0, [0.0, speed]

    def slope(t, y):
        return [y[1], (push + rate * t - K * y[0] - B * y[1] - float(friction.values(np.array(max(y[1], 0.0))))) / mass]

    def is_there(t, y):
        return y[1] if t > 1e-9 else 1.0

    def changes(t, y):
        return y[1] - friction.knee

    is_there.terminal = changes.terminal = True
    is_there.direction = -1
    while t < h:
        found = solve_ivp(slope, (t, h), y, "DOP853", events=(is_there, changes), rtol=1e-12, atol=1e-16)
        assert found.success
        t, y = float(found.t[-1]), found.y[:, -1]
        if len(found.t_events[0]):
            return y[0], 0.0, h - t
        if len(found.t_events[1]):  # just beyond, so that the event is not found again
            y[1] += math.copysign(1e-13, slope(t, y)[1])
    return y[0], y[1], 0.0


CASES = {
    "out of stiction, past the knee": (STICTION, 4e-3, 0.0, (12.0, 100.0), (1500.0, 6000.0), 8.0),
    "growing slowly at first": (STICKY, 4e-3, 0.0, (40.001, 2.0), (1500.0, 6000.0), 8.0),
    "strongly damped": (STICTION, 4e-3, 5e-4, (10.5, -20.0), (9000.0, 6000.0), 8.0),
    "comes to a stand": (STICTION, 4e-3, 3e-3, (5.0, -1000.0), (1500.0, 6000.0), 2.0),
    "fast, through the knee to a stand": (Friction(8.0, 6.0, 1e-3), 2e-3, 2e-3, (0.0, 0.0), (2000.0, 6000.0), 1.0),
    "swinging: damping near the slope": (STICTION, 4e-3, 2e-4, (9.9, 100.0), (4000.0, 60000.0), 0.5),
    "ten grams": (STICTION, 2e-3, 0.05, (130.0, 2000.0), (1500.0, 6000.0), 0.01),
    "half a tonne": (STICTION, 2e-3, 0.0, (60.0, 500.0), (1500.0, 6000.0), 500.0),
    "no friction": (Friction(), 2e-3, 0.0, (20.0, -300.0), (1500.0, 6000.0), 8.0),
    "hardly a spring": (Friction(), 2e-3, 1e-2, (20.0, 300.0), (1500.0, 1e-3), 8.0),
    "nothing but a mass": (Friction(), 2e-3, 1e-2, (20.0, 300.0), (0.0, 0.0), 8.0),
    "equal exponents": (Friction(), 2e-3, 1e-2, (20.0, 300.0), (2.0 * math.sqrt(6000.0 * 8.0), 6000.0), 8.0),
}


@pytest.mark.parametrize("case", CASES)
def test_a_step_is_exact(case):
    friction, h, speed, drive, linear, mass = CASES[case]
    way, after, left = glide(friction, h, speed, drive, linear, mass)
    way_0, after_0, left_0 = reference(friction, h, speed, drive, linear, mass)
    assert way == pytest.approx(way_0, rel=2e-6, abs=1e-13)
    assert after == pytest.approx(after_0, rel=2e-6, abs=1e-10)
    assert left == pytest.approx(left_0, abs=2e-9)


def test_a_growth_that_would_overflow_is_cut_where_it_leaves_stiction():
    way, speed, left = glide(STICKY, 4e-3, 0.0, (40.1, 0.0), (1500.0, 6000.0), 1e-4)
    assert left == 0.0
    assert 0 < way < 4e-3 * 32.1 / 1500.0
    assert speed == pytest.approx((40.1 - 8.0 - 6000.0 * way) / 1500.0, rel=1e-2), "the speed that the damping allows"


def test_nothing_moves_where_less_than_stiction_pushes_from_rest():
    assert glide(STICTION, 2e-3, 0.0, (9.0, 0.0), (1500.0, 6000.0), 8.0) == (0.0, 0.0, 0.0)
