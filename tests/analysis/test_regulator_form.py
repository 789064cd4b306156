"""Relay and rising gain behind regulators that swing in, as closed pressure loops do, or vent slower than they fill.

The plant here has its exact solution from sample to sample; the truth is the phase equation, by bisection, and where
filling and venting differ the gain at which a loop without noise neither grows nor dies.
"""

from collections import deque
from math import pi

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from pmabench.engine.laws.gain_steps import GainSteps
from pmabench.engine.laws.relay import Relay
from pmabench.kinds.ultimate_gain.reduction import reduce
from tests.analysis.loop_rig import TS, as_run, as_trial, close_loop

GAIN, DEAD, TAU = 0.1466e-6, 0.040, 0.247


class Plant:
    """Dead time, P'' + 2 z w P' + w^2 P = w^2 u, and tau x' + x = k P; or T P' + P = u with T of filling or venting."""

    def __init__(self, omega=0.0, zeta=1.0, fill=0.0, vent=0.0, noise=(2e-6, 500.0)):
        self.noise, self.random = noise, np.random.default_rng(1)
        self.state, self.queue = np.zeros(3), deque([0.0] * round(DEAD / TS))
        self.exact = [self._exact(omega, zeta, lag) for lag in (vent, fill)]

    @staticmethod
    def _exact(omega, zeta, lag):
        rates = (
            [[0, 1, 0, 0], [-(omega**2), -2 * zeta * omega, 0, omega**2]]
            if omega
            else [[-1 / lag, 0, 0, 1 / lag], [0] * 4]
        )
        return expm(np.array([*rates, [GAIN / TAU, 0, -1 / TAU, 0], [0] * 4]) * TS)[:3]

    def step(self, command):
        self.queue.append(command)
        u = self.queue.popleft()
        self.state = self.exact[int(u > self.state[0])] @ [*self.state, u]

    def read(self):
        x, P = self.state[[2, 0]] + self.noise * self.random.standard_normal(2)
        return {"displacement": x, "pressure": P}


def theory(omega, zeta):
    """K_u [Pa/m] and T_u [s]; the hold of the controller is half a sample of dead time."""

    def phase(w):
        return w * (DEAD + TS / 2) + np.angle(1 + 2j * zeta * w / omega - (w / omega) ** 2) + np.angle(1 + 1j * w * TAU)

    w = brentq(lambda w: phase(w) - pi, 1.0, 60.0)
    return float(abs((1 + 2j * zeta * w / omega - (w / omega) ** 2) * (1 + 1j * w * TAU)) / GAIN), 2 * pi / w


def found(plant, law):
    samples = close_loop(plant, law, 200.0)
    trial = as_trial(samples, {"ultimate-gain": law.result()}, setpoint=0.0, load=0.0)
    return reduce([as_run("ultimate-gain", [trial])]).estimates[:2]


def relay(plant):
    law = Relay(setpoint=0.0, bias=0.0, low=-2e5, high=5e5, amplitudes=[3e4, 6e4], hysteresis=[1e-4, 2e-4], periods=9,
                level_time=20.0, settle=2.0, window=0.03)  # fmt: skip
    return found(plant, law)


@pytest.mark.parametrize(("omega", "zeta"), [(15.0, 0.3), (40.0, 0.6)])
def test_a_regulator_that_swings_is_in_the_fitted_loop(omega, zeta):
    """K_u was 79 % and 11 % high by the relay, with intervals of 5 % and 2.5 %; a controller by the first was unstable."""
    for e, truth in zip(relay(Plant(omega, zeta)), theory(omega, zeta), strict=True):
        assert abs(e.value - truth) < e.parts.combined < 0.02 * truth


def test_a_rising_gain_holds_K_u_of_a_regulator_that_swings():
    omega, zeta = 15.0, 0.3
    K_u, T_u = theory(omega, zeta)
    law = GainSteps(setpoint=0.0, bias=0.0, start=0.6 * K_u, low=-2e5, high=5e5, noise=2e-6, factor=1.05)
    for e, truth in zip(found(Plant(omega, zeta), law), (K_u, T_u), strict=True):
        assert abs(e.value - truth) < e.parts.combined < 0.02 * truth


def limit(fill, vent):
    """K_u [Pa/m] by bisection of the growth without noise."""

    def growth(log_gain):
        plant = Plant(fill=fill, vent=vent, noise=(0.0, 0.0))
        x = np.zeros(4000)
        for k in range(len(x)):
            x[k] = plant.state[2]
            plant.step(-np.exp(log_gain) * x[k] + (2e3 if k < 30 else 0.0))
        return np.log(np.ptp(x[3000:]) / np.ptp(x[1500:2500]))

    return float(np.exp(brentq(growth, np.log(4e7), np.log(1e8), xtol=1e-3)))


def test_filling_quicker_than_venting_is_in_the_interval():
    """At 95.5 and 200 ms K_u was 4 % low with +- 1.3 %."""
    K_u, _ = relay(Plant(fill=0.0955, vent=0.2))
    assert abs(K_u.value - limit(0.0955, 0.2)) < K_u.parts.combined < 0.08 * K_u.value
    assert any(line.name == "form of the regulator" for line in K_u.budget)
    withheld, _ = relay(Plant(fill=0.0955, vent=0.3))
    assert withheld.value is None
    assert "fills quicker than it vents" in withheld.note
