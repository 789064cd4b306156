"""The answer to many changes of pressure is the sum of exact step responses, by definition and by an ODE solver."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pmabench.kinds.recorded_step.motion import Answer

RNG = np.random.default_rng(7)
T = np.sort(RNG.uniform(-0.5, 0.8, 400))
AT = T[RNG.random(400) < 0.8] - 0.01
JUMPS = RNG.standard_normal(len(AT))


def step_response(t, w, D):
    """Textbook: unit step response of w^2 / (s^2 + 2 D w s + w^2)."""
    t = np.maximum(t, 0.0)
    if D == 1.0:
        return 1 - np.exp(-w * t) * (1 + w * t)
    if D < 1:
        wd = w * np.sqrt(1 - D * D)
        return 1 - np.exp(-D * w * t) * (np.cos(wd * t) + D * w / wd * np.sin(wd * t))
    r = np.sqrt(D * D - 1)
    slow, fast = w * (D - r), w * (D + r)
    return 1 - (fast * np.exp(-slow * t) - slow * np.exp(-fast * t)) / (fast - slow)


@pytest.mark.parametrize("w", [3.0, 30.0, 400.0])
@pytest.mark.parametrize(("D", "close"), [(0.01, 1e-11), (0.3, 1e-11), (1.0, 1e-5), (1.5, 1e-11), (3.0, 1e-11)])
def test_it_is_the_sum_of_the_step_responses(w, D, close):
    one_by_one = step_response(T[:, None] - AT[None, :], w, D) @ JUMPS
    assert Answer(T, AT, w, D).to(JUMPS) == pytest.approx(one_by_one, abs=close)


def test_it_solves_the_equation():
    w, D, at, jumps = 30.0, 0.3, np.array([0.1, 0.15, 0.4]), np.array([1.0, 2.0, -0.5])
    t = np.linspace(0, 0.8, 81)

    def slope(time, state):
        u = float(np.sum(jumps[at <= time]))
        return [state[1], w * w * (u - state[0]) - 2 * D * w * state[1]]

    solved = solve_ivp(slope, (0, 0.8), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=1e-3)
    assert Answer(t, at, w, D).to(jumps) == pytest.approx(solved.y[0], abs=2e-3)  # the solver steps over each change


def test_nothing_before_the_first_change_and_without_any():
    assert not Answer(np.linspace(-1, 0, 5), np.array([0.5]), 20.0, 0.5).to(np.array([1.0])).any()
    assert not Answer(np.linspace(-1, 0, 5), np.empty(0), 20.0, 0.5).to(np.empty(0)).any()
