"""Ultimate gain and period, margins and overshoot against printed tables and closed forms."""

from __future__ import annotations

from dataclasses import replace
from math import atan, inf, pi, sqrt

import numpy as np
import pytest

from pmabench.model.loop import (
    Controller,
    Loop,
    margins,
    muscle_loop,
    sensitivity,
    ultimate,
)


@pytest.mark.parametrize(
    ("L", "T_r", "tau", "T_u", "K_u"),
    [
        (0.04, 0.22, 0.25, 0.4361, 12.427),
        (0.04, 0.0955, 0.25, 0.3426, 9.464),
        (0.04, 0.22, 0.11, 0.3503, 9.003),
        (0.04, 0.22, 0.50, 0.4989, 18.785),
    ],
)
def test_table_of_ultimate_gains(L: float, T_r: float, tau: float, T_u: float, K_u: float) -> None:
    found = ultimate(Loop(1.0, L, (T_r, tau)))
    assert found.period == pytest.approx(T_u, abs=5e-5)
    assert found.gain == pytest.approx(K_u, abs=5e-4)


def test_fixture_of_paper_0s_numbers() -> None:
    found = ultimate(Loop(0.5174157, 2.4313531, (0.22, 5.0)))
    assert found.gain == pytest.approx(7.1, rel=1e-6)
    assert found.period == pytest.approx(9.0, rel=1e-6)


def plant_51(x_mm: float, T_r: float) -> Loop:
    """Plant 5.1 (kPa, N, mm) resting at x: L = 43 ms as in 5.4."""
    low, high = 46.0, 700.0
    for _ in range(60):
        P = (low + high) / 2
        low, high = (P, high) if 1.08 * P - 49.0 - (5.6 + 1e-3 * P + 9.7e-6 * P * P) * x_mm < 0 else (low, P)
    K = 5.6 + 1e-3 * low + 9.7e-6 * low * low
    gain = sensitivity(1.08, K, 1e-3 + 2 * 9.7e-6 * low, x_mm) * 1e-6
    return muscle_loop(
        gain=gain, K=K * 1e3, B=(1.2 + 1.6e-3 * low) * 1e3,
        regulator_lag=T_r, dead_time=0.042, sample_period=0.002,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("x", "T_r", "K_u"),
    [(10, 0.0955, 46.8), (30, 0.0955, 59.9), (60, 0.0955, 200), (10, 0.22, 62.0), (30, 0.22, 78.7), (60, 0.22, 266)],
)
def test_ultimate_gain_changes_four_fold_over_the_stroke(x: float, T_r: float, K_u: float) -> None:
    assert ultimate(plant_51(x, T_r)).gain / 1e6 == pytest.approx(K_u, rel=2e-3)


def test_the_operating_point_of_30_mm() -> None:
    loop = plant_51(30, 0.0955)
    assert loop.gain * 1e6 == pytest.approx(0.1466, rel=1e-3)
    assert loop.dead_time == pytest.approx(0.043)
    assert sorted(complex(lag).real for lag in loop.lags) == pytest.approx([0.0955, 0.247], abs=5e-4)
    assert ultimate(loop).period == pytest.approx(0.355, abs=1e-3)
    assert ultimate(plant_51(30, 0.22)).period == pytest.approx(0.451, abs=1e-3)


def test_three_equal_lags_without_dead_time() -> None:
    found = ultimate(Loop(2.0, 0.0, (0.5, 0.5, 0.5)))
    assert found.gain == pytest.approx(8.0 / 2.0)
    assert found.period == pytest.approx(2 * pi * 0.5 / sqrt(3))


def test_no_ultimate_gain_without_enough_phase() -> None:
    with pytest.raises(ValueError, match="never oscillate"):
        ultimate(Loop(1.0, 0.0, (0.2, 0.3)))
    with pytest.raises(ValueError, match="gain above 0"):
        Loop(0.0, 0.04, (0.2,))


def test_mass_adds_a_lag_and_may_make_a_pair_complex() -> None:
    heavy = muscle_loop(gain=1e-7, K=6e3, B=1500.0, mass=46.0, regulator_lag=0.1, dead_time=0.04)
    pair = [complex(lag) for lag in heavy.lags if lag != 0.1]
    assert sum(pair) == pytest.approx(1500.0 / 6e3)
    assert pair[0] * pair[1] == pytest.approx(46.0 / 6e3)
    ringing = muscle_loop(gain=1e-7, K=6e3, B=400.0, mass=46.0, regulator_lag=0.1, dead_time=0.04)
    s = 10j
    expected = 1e-7 * np.exp(-0.04 * s) / (1 + 0.1 * s) / (1 + 400.0 / 6e3 * s + 46.0 / 6e3 * s * s)
    assert complex(ringing.response(s)) == pytest.approx(complex(expected))
    assert ringing.phase_lag(10.0) % (2 * pi) == pytest.approx(-np.angle(expected) % (2 * pi))
    assert ultimate(ringing).gain > 0


def test_margins_of_a_proportional_loop() -> None:
    loop = Loop(1.0, 0.1, (1.0,))
    seen = margins(loop, Controller(2.0))
    assert seen.phase_margin == pytest.approx(pi - 0.1 * sqrt(3) - atan(sqrt(3)), rel=1e-4)
    assert seen.gain_margin == pytest.approx(ultimate(loop).gain / 2.0, rel=1e-4)
    omega = np.linspace(0.1, 60, 200_000)
    nearest = np.abs(1 + 2.0 * loop.response(1j * omega)).min()
    assert seen.M_s == pytest.approx(1 / nearest, rel=1e-3)
    assert seen.stable
    unstable = margins(loop, Controller(1.1 * ultimate(loop).gain))
    assert not unstable.stable
    assert unstable.M_s == inf


def inverted(loop: Loop, controller: Controller, length: float) -> tuple[np.ndarray, np.ndarray]:
    """A step of the set-point by the inverse Fourier integral of C_PI G / (1 + C G) / s, in 2^18 frequencies, with C_PI = C without
    its derivative, which acts on the displacement alone.

    Written out; midpoints between them leave the pole at 0 in the middle, which makes half the final value.
    """
    count, apart = 2**18, pi / (2 * length)
    s = 1j * apart * (np.arange(count // 4) + 0.5)
    through = controller.K_p * loop.gain * np.exp(-loop.dead_time * s) / np.prod([1 + lag * s for lag in loop.lags], 0)
    action = 1 + 1 / s / controller.T_i
    wanted = through * action
    through = through * (action + controller.T_d * s / (1 + 0.1 * controller.T_d * s))
    t = np.arange(count) * 2 * pi / (count * apart)
    y = np.fft.ifft(np.pad(apart * wanted / (1 + through) / s, (0, count - len(s)))) * count
    half = 0.5 if controller.T_i < inf else 0.5 * controller.K_p * loop.gain / (1 + controller.K_p * loop.gain)
    return t[t < length], (half + np.real(y * np.exp(0.5j * apart * t)) / pi)[t < length]


def test_a_loop_that_less_gain_makes_unstable_is_stable() -> None:
    """Its integral and two long lags take more than half a turn below crossover, and the derivative gives it back.

    It answers nothing before the command comes through, as no unstable loop does in this integral.
    """
    loop = Loop(1.0, 0.005, (0.22, 0.25))
    found = ultimate(loop)
    controller = Controller(0.6 * found.gain, 0.5 * found.period, 0.125 * found.period)
    t, x = inverted(loop, controller, 16 * found.period)
    assert np.abs(x[t < 0.004]).max() < 1e-3
    seen = margins(loop, controller)
    assert seen.stable
    s = 2j * pi / found.period * np.linspace(0.05, 5.0, 200_000)
    assert seen.M_s == pytest.approx(1 / np.abs(1 + loop.response(s) * controller.response(s)).min(), rel=1e-3)
    for more, stable in ((0.99, True), (1.01, False)):
        t, x = inverted(loop, replace(controller, K_p=more * seen.gain_margin * controller.K_p), 16 * found.period)
        assert (np.abs(x[t < 0.004]).max() < 0.1) == stable
