"""The fit: what it is given comes back, and its bounded least squares agree with another program's."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from pmabench.analysis.surface.fit import Data, bounded, choose
from pmabench.analysis.surface.muscle import ALWAYS
from tests.analysis.surface.campaign import campaign, record_of


class Plain:
    """A force that is a polynomial in pressure and contraction, without memory: F in N, x in m, P in Pa."""

    @staticmethod
    def static(x, P):
        return -60 + 2.4e-3 * P - 5e3 * x - 0.045 * P * x + 3e5 * x**2 + 1e-10 * P**2

    @staticmethod
    def stiffness(x, P):
        return 5e3 + 0.045 * P - 6e5 * x

    def drive(self, t, x, P):
        return self.static(x, P)


def records(muscle, seed, noise, kinds=("ramp", "fill", "sine"), by_hand=()):
    rng = np.random.default_rng(seed)
    found, end = [], 0.0
    for trial in campaign():
        name, t, x, P = trial
        if name.split()[0] in kinds:
            found.append(record_of(muscle, (name, t + end, x, P), rng, noise, goes_on=bool(found)))
            end += t[-1] + 5.0
    return found


def test_a_surface_without_hysteresis_gives_itself_back():
    found = choose(Data.of(records(Plain(), 3, noise=0.2)))
    assert found.terms == ALWAYS
    P, x = np.meshgrid([250e3, 400e3, 550e3], [3e-3, 15e-3, 30e-3])
    P, x = P.ravel(), x.ravel()
    assert found.muscle.static(P, x) == pytest.approx(Plain.static(x, P), abs=0.2)
    assert found.muscle.stiffness(P, x) == pytest.approx(Plain.stiffness(x, P), rel=0.003)
    assert found.muscle.damping(400e3) == pytest.approx((0.0, 0.0), abs=60.0)
    true = 5e3 + 0.045 * 4e5 - 2 * 3e5 * 0.5 * (5e-3 + 25e-3)
    assert found.muscle.secant(400e3, 5e-3, 25e-3) == pytest.approx(true, rel=0.003)


def test_bounded_least_squares_agree_with_another_program():
    rng = np.random.default_rng(5)
    for _ in range(20):
        A, y = rng.standard_normal((40, 12)), rng.standard_normal(40)
        free = rng.uniform(size=12) < 0.5
        free[0] = True
        other = lsq_linear(A, y, (np.where(free, -np.inf, 0.0), np.inf), method="bvls", tol=1e-14).x
        assert bounded(A.T @ A, A.T @ y, free) == pytest.approx(other, abs=1e-7)
