"""Two muscles on a pulley and three under a platform, against closed forms, differences and an independent table."""

import math

import numpy as np
import pytest

from pmabench.model.library import MODELS, OutsideDomain
from pmabench.model.many.joint import Braided, Joint, JointPlant
from pmabench.model.many.platform import LEVEL, Platform
from pmabench.model.regulator import constant, ramp, sine
from tests.model.openings import Opening, simulate

BAR, DEG = 1e5, math.pi / 180
JOINT, INVERSE = MODELS["joint"], MODELS["joint-inverse"]


def test_both_pressures_of_a_torque_and_a_stiffness_give_them_back():
    chance = np.random.default_rng(1)
    angle, torque, K = (chance.uniform(-a, a, 400) for a in (30 * DEG, 4.0, 0.0))
    K = K + chance.uniform(6.0, 20.0, 400)
    tried = 0
    for th, tau, k in zip(angle, torque, K, strict=True):
        try:
            found = INVERSE.evaluate({"angle": th, "torque": tau, "stiffness": k})
        except OutsideDomain:
            continue
        again = JOINT.evaluate({"angle": th} | found)
        assert float(again["torque"]) == pytest.approx(tau, abs=1e-9)
        assert float(again["stiffness"]) == pytest.approx(k, rel=1e-9)
        tried += 1
    assert tried > 200


def test_stiffness_is_the_slope_of_the_torque():
    at = {"pressure_1": 3.2 * BAR, "pressure_2": 1.7 * BAR}
    for angle in np.array([-30.0, -7.0, 0.0, 12.0, 40.0]) * DEG:
        low, high = (float(JOINT.evaluate(at | {"angle": angle + way})["torque"]) for way in (-1e-5, 1e-5))
        assert float(JOINT.evaluate(at | {"angle": angle})["stiffness"]) == pytest.approx((low - high) / 2e-5, rel=1e-7)


def test_a_stiffness_that_the_limits_do_not_allow_is_refused_with_what_they_do():
    for th, most in ((0.0, 30.4), (20.0, 24.4), (40.0, 25)):
        with pytest.raises(OutsideDomain, match=f"to {most} N.m/rad$"):
            INVERSE.evaluate({"angle": th * DEG, "stiffness": 35.0})


def test_stiffness_of_a_platform_is_the_slope_of_its_moment():
    model = MODELS["platform-moment"]
    at = {"phi": 7 * DEG, "psi": -9 * DEG, "pressure_1": 2 * BAR, "pressure_2": 3 * BAR}
    found = model.evaluate(at)
    for name in ("phi", "psi"):
        low, high = (float(model.evaluate(at | {name: at[name] + way})[f"moment_{name}"]) for way in (-1e-5, 1e-5))
        assert float(found[f"stiffness_{name}"]) == pytest.approx((low - high) / 2e-5, rel=1e-6)


OPENINGS = [Opening("fill", 0, 0.10, 0.13), Opening("exhaust", 1, 0.20, 0.23)]
TABLE = """
0.13 -1.3449 0      3.1039 2.5514 2.5514
0.20 -2.4804 0      3.0133 2.5965 2.5965
0.23 -2.8910 0.5658 2.9820 2.3280 2.5737
1.00 -3.2936 0.9823 2.9521 2.3722 2.5611
"""
"""Time [s], phi, psi [deg], pressures [bar]: two other programs with two other integrators agreed on these."""


def test_a_platform_moves_as_two_other_programs_say():
    rows = [[float(cell) for cell in line.split()] for line in TABLE.strip().splitlines()]
    states = simulate(Platform(), OPENINGS, [row[0] for row in rows])
    for (_, phi, psi, *pressures), state in zip(rows, states, strict=True):
        assert [angle / DEG for angle in state[:2]] == pytest.approx([phi, psi], abs=0.002)
        assert list(state[4:7]) == pytest.approx([P * BAR for P in pressures], abs=20.0)


def test_a_level_platform_stays_level_and_vents_level():
    """Three equal muscles at 120 degrees make no moment; only rounding tilts it before the pressure is gone."""
    held, vented = simulate(Platform(), [Opening("exhaust", i, 0.5, 2.0) for i in range(3)], [0.5, 0.8])
    assert held == pytest.approx(LEVEL, abs=1e-6)
    assert vented[:2] == pytest.approx((0.0, 0.0), abs=1e-6)
    assert max(vented[4:7]) < 0.6 * BAR


def swept(most, pressures=(3 * BAR, 3 * BAR), rate=1 * DEG):
    """Angle and torque of the last loop of a slow sweep to both sides, until the loops repeat."""
    course, t, at = [], 0.0, 0.0
    for target in (most, -most, most, -most, most):
        course += ramp(t, at, target, rate)
        t, at = t + abs(target - at) / rate, target
    plant = JointPlant(Joint(), pressures)
    plant.drive(tuple(course))
    times = np.arange(0.0, t, 0.02)
    found = plant.advance(t, times.tolist())
    last = times > t - 4 * most / rate
    return found.angle[last], found.torque[last]


def test_a_slow_sweep_shows_gap_loop_and_stiffness_of_the_closed_forms():
    angle, torque = swept(30 * DEG)
    down, up = np.split(np.arange(len(angle)), [len(angle) // 2])
    gap = np.interp(0.0, -angle[down], torque[down]) - np.interp(0.0, angle[up], torque[up])
    assert gap == pytest.approx(4 * 0.025 * 30.0, rel=0.01)
    # 8 H l0 (a - w), a the amplitude of contraction; the muscles' damping adds 0.2 % at this speed
    amplitude = 0.025 * 30 * DEG / 0.2
    assert abs(np.trapezoid(torque, angle)) == pytest.approx(8 * 30 * 0.2 * (amplitude - 0.006), rel=0.01)
    about = [branch[np.abs(angle[branch]) < 8 * DEG] for branch in (down, up)]
    slopes = [-np.polyfit(angle[rows], torque[rows], 1)[0] for rows in about]
    assert slopes == pytest.approx([15.505] * 2, rel=0.02)


@pytest.mark.parametrize(("most", "slope"), [(0.25, 46.6), (2.0, 41.6), (5.0, 30.1), (10.0, 21.9)])
def test_a_small_perturbation_looks_stiffer_than_the_joint_is(most, slope):
    """Slope of torque over angle in slow sines, as another program found it; 15.5 N.m/rad is true."""
    plant = JointPlant(Joint(), (3 * BAR, 3 * BAR))
    plant.drive(sine(0.0, 0.0, most * DEG, 0.1, 3))
    found = plant.advance(30.0, np.arange(20.0, 30.0, 0.01).tolist())
    assert -np.polyfit(found.angle, found.torque, 1)[0] == pytest.approx(slope, rel=0.005)


@pytest.mark.parametrize(
    ("hysteresis", "gain", "end", "settled"),
    [(0.0, 0.0, 0.0, 0.60), (30.0, 0.0, -4.31, None), (30.0, 20.0, 0.0, 0.78)],
    ids=["feed-forward, no hysteresis", "feed-forward", "and integral action"],
)
def test_a_step_of_angle_ends_where_another_program_says(hysteresis, gain, end, settled):
    """0 to 20 degrees through two lags of 1/15 s, stiffness 20 N.m/rad; the integral gain is in N.m/(rad.s)."""
    level = INVERSE.evaluate({"angle": 0.0})
    plant = JointPlant(Joint(muscle=Braided(hysteresis=hysteresis)), (float(level["pressure_1"]),) * 2)
    goal, h, first, wanted, extra, angles = 20 * DEG, 0.002, 0.0, 0.0, 0.0, []
    for _ in range(2500):
        first += 15 * h * (goal - first)
        wanted += 15 * h * (first - wanted)
        extra += gain * h * (wanted - plant.angle)
        found = INVERSE.evaluate({"angle": wanted, "torque": extra})
        for muscle in (0, 1):
            plant.command(muscle, constant(plant.time, float(found[f"pressure_{muscle + 1}"])))
        plant.advance(plant.time + h)
        angles.append(plant.angle)
    miss = (np.array(angles) - goal) / DEG
    assert miss[-1] == pytest.approx(end, abs=0.02)
    if settled is not None:
        assert (np.abs(miss) > 0.5).nonzero()[0][-1] * h == pytest.approx(settled, abs=0.02)


def test_a_joint_that_goes_back_in_time_does_the_same_again():
    plant = JointPlant(Joint(), (3 * BAR, 3 * BAR))
    plant.command(0, constant(0.1, 4 * BAR))
    plant.advance(0.3)
    kept = plant.snapshot()
    first = plant.advance(0.6, (0.5, 0.6)).angle.tolist()
    plant.restore(kept)
    assert plant.advance(0.6, (0.5, 0.6)).angle.tolist() == first
