"""Steps under a hanging mass, integrated by scipy: K and B of the muscle change along the step, or it rubs."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from pmabench.kinds.recorded_step.reduction import reduce
from pmabench.store.records import Command, TrialData
from tests.analysis.loop_rig import as_run

G = 9.80665
RATE = 500.0
BEGIN = 1.0
"""When the step is commanded [s]."""


def straight(P, x):
    """Pull of a muscle [N] whose K grows with the pressure, 16 N/m for each kPa."""
    return 2.2e-3 * P - 60.0 - (8000.0 + 16e-3 * P) * x


def braided(P, x):
    """Pull [N] of a braid of 20 mm, 250 mm and 25 degrees (Chou and Hannaford 1996), and a rubber of 3 N/mm."""
    area, angle = np.pi / 4 * 0.02**2, np.radians(25.0)
    return P * area * (3 * (1 - x / 0.25) ** 2 / np.tan(angle) ** 2 - 1 / np.sin(angle) ** 2) - 3000.0 * x


def at_rest(pull, P, M):
    """Contraction [m] where the muscle holds the weight, and K [N/m], the slope of the pull there."""
    x = brentq(lambda x: pull(P, x) - M * G, -0.1, 0.2)
    return x, (pull(P, x - 1e-6) - pull(P, x + 1e-6)) / 2e-6


def rung(pull, before, after, M=20.0, B=lambda P: 120.0 + 0.1e-3 * P, friction=0.0, lag=0.06, late=0.0):
    """One trial of a weight that hangs from a muscle, whose pressure [Pa] follows a step with a lag [s]."""
    t = np.arange(0.0, 4.5, 1 / RATE)

    def pressure(time):
        since = np.maximum(np.asarray(time) - BEGIN - 0.012, 0.0)
        return before + (after - before) * (1 - np.exp(-since / lag) * (1 + since / lag))

    def slope(time, state):
        x, v = state
        P = float(pressure(time))
        return [v, (pull(P, x) - B(P) * v - friction * np.tanh(v / 5e-5) - M * G) / M]

    begin = [at_rest(pull, before, M)[0], 0.0]
    solved = solve_ivp(slope, (0.0, t[-1]), begin, "LSODA", t_eval=t, rtol=1e-8, atol=1e-10, max_step=2e-3)
    rng = np.random.default_rng(1)
    return TrialData(
        run="r1", index=0, point={"from": before, "pressure": after, "mass": M}, repeat=0, reference=False,
        status="finished", t=t,
        channels={
            "pressure": pressure(t - late) + rng.normal(0, 150.0, len(t)),
            "displacement": solved.y[0] + rng.normal(0, 5e-6, len(t)),
        },
        flags=np.zeros(len(t), np.uint16),
        commands=(Command(BEGIN, "pressure", "set", after, before, "step", {"within": 1 / RATE}),), found={},
    )  # fmt: skip


def K_and_B(trial):
    analysis = reduce([as_run("recorded-step", [trial])])
    return (next(e for e in analysis.estimates if e.symbol == symbol) for symbol in "KB")


def holds(estimate, truth, widest):
    """Within what one step leaves open, which is no wider than a share of it to either side."""
    assert estimate.value is not None, estimate.note
    assert estimate.parts.method < widest * truth
    assert abs(estimate.value - truth) < estimate.parts.method


@pytest.mark.parametrize(("before", "after", "late"), [
    (350e3, 450e3, 0.012), (450e3, 350e3, 0.0), (400e3, 450e3, 0.0), (420e3, 380e3, 0.012),
])  # fmt: skip
@pytest.mark.parametrize("pull", [straight, braided])
def test_K_and_B_are_those_at_the_end_of_the_step(pull, before, after, late):
    """Fits with one K for the whole step found a B that was 13 % off, with an interval of 5 %."""
    K, B = K_and_B(rung(pull, before, after, late=late))
    holds(K, at_rest(pull, after, 20.0)[1], 0.03)
    holds(B, 120.0 + 0.1e-3 * after, 0.08)


def test_dry_friction_is_not_taken_for_damping():
    K, B = K_and_B(rung(straight, 350e3, 450e3, M=40.0, friction=1.0, lag=0.03))
    holds(K, 15200.0, 0.02)
    holds(B, 165.0, 0.08)


def test_dry_friction_that_ends_the_swinging_gives_none():
    K, B = K_and_B(rung(straight, 350e3, 450e3, friction=4.0))
    assert K.value is None
    assert B.value is None


@pytest.mark.parametrize("friction", [0.0, 4.0])
@pytest.mark.parametrize("pull", [straight, braided])
@pytest.mark.parametrize(("before", "after"), [(350e3, 450e3), (450e3, 350e3)])
def test_the_lag_of_a_damped_motion_holds_what_cannot_be_known_of_it(pull, before, after, friction):
    """By one form alone B/K was 8 % off, with an interval of 3 %."""
    trial = rung(pull, before, after, M=40.0, B=lambda P: 700.0 + 1e-3 * P, friction=friction, lag=0.03)
    analysis = reduce([as_run("recorded-step", [trial])])
    tau = next(e for e in analysis.estimates if e.symbol in ("tau_c", "tau_r"))
    assert abs(tau.value - (700.0 + 1e-3 * after) / at_rest(pull, after, 40.0)[1]) < tau.parts.method < 0.5 * tau.value
