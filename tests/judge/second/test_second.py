"""The second muscle itself, against closed forms, quadrature and solvers: its parts, its motion, its faults."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from tests.judge.second import bench, driven, muscle
from tests.judge.second.campaign import AMOUNTS, CASES, MASSES, PLAN, RATE, REAL, campaign, steps, truth
from tests.judge.second.hanging import hang
from tests.judge.second.muscle import DAMPING, FRICTION, TURN, Muscle

CLEAN = Muscle()
G = 9.80665


# -- parts ---------------------------------------------------------------------------------------------------------


def test_geometry_and_rubber_are_near_the_makers_table():
    """Points of the maker's table of a 20 mm muscle of 250 mm: force, and the slope of a curve through them."""
    points = ((0.0, 100, 253), (0.0, 400, 1012), (0.04, 300, 507), (0.12, 200, 112), (0.12, 300, 241), (0.11, 600, 791))
    for share, P, force in points:
        assert muscle.geometric(np.array(250e-3 * share), np.array(1e3 * P)) == pytest.approx(force, abs=45)
    for share, K in ((0.0, 43.7e3), (0.04, 26.2e3), (0.12, 20.4e3)):
        slope = muscle.geometric_stiffness(np.array(250e-3 * share), np.array(600e3))
        assert slope == pytest.approx(K, rel=0.06)


def test_the_stiffness_is_the_slope_of_the_force():
    x, h = np.linspace(0, 50e-3, 11), 1e-6
    for P in (150e3, 300e3, 550e3):

        def force(x, P=P):
            return muscle.geometric(x, np.array(P)) - np.interp(x, *muscle._tube()) + muscle.rubber(x)

        assert muscle.geometric_stiffness(x, np.array(P)) == pytest.approx(
            (force(x - h) - force(x + h)) / (2 * h), rel=1e-5
        )
    assert np.interp(x, *muscle._tube()) == pytest.approx(muscle.rubber(x), abs=1e-3)


def test_without_departures_the_force_is_straight_in_x_with_straight_lines_over_pressure():
    t = np.arange(5000) / 500.0
    x, P = 12e-3 + 9e-3 * np.sin(1.9 * t), 330e3 + 90e3 * np.sin(0.7 * t)
    v = 9e-3 * 1.9 * np.cos(1.9 * t)
    B = np.where(v > 0, 2.1e3 + 1.6e-3 * P, 1.2e3 + 1.7e-3 * P)
    line = -55 + 2.44e-3 * P - (6.4e3 + 0.0262 * P) * x - B * v - 12.0 * np.sign(v)
    inside = np.abs(v) > 1e-4
    inside[[0, -1]] = False
    assert driven.follow(CLEAN, [P], [x])[0][inside] == pytest.approx(line[inside], abs=1e-3)


def test_a_branch_of_the_hysteresis_takes_the_motion_that_an_integral_says():
    """The motion from one z to another is the integral of 1 over its slope."""
    for start, end, way in ((-1.0, 0.6, 1), (0.7, -1.0, -1), (0.1, 0.8, 1)):
        needs = sum(
            quad(lambda z, way=way: 1 / float(muscle.slope(np.array(z), np.array(float(way)))), *part)[0]
            for part in ((start, 0.0), (0.0, end))
        )
        z = np.array(start)
        for _ in range(500):
            z = muscle.moved(z, np.array(needs * TURN / 500))
        assert float(z) == pytest.approx(end, abs=1e-4)


def test_long_strokes_end_where_the_slope_is_zero_and_differ_by_way():
    high, low = muscle.ends()
    assert muscle.slope(np.array(high), np.array(1.0)) == pytest.approx(0.0, abs=1e-12)
    assert muscle.slope(np.array(low), np.array(-1.0)) == pytest.approx(0.0, abs=1e-12)
    assert -low > 1.3 * high


def test_area_and_gap_of_a_loop_are_those_of_quadrature():
    """In a closed cycle both branches take the same motion; the area is the integral of z over it."""
    stroke = 2 * 1.2e-3 / TURN

    def along(a, b, way, power):
        return quad(lambda z: z**power / float(muscle.slope(np.array(z), np.array(float(way)))), a, b, points=[0.0])[0]

    def top(low):
        return brentq(lambda high: along(low, high, 1, 0) - stroke, 0.05, 0.857)

    low = brentq(lambda low: along(top(low), low, -1, 0) + stroke, -0.95, -0.25)
    area = TURN * (along(low, top(low), 1, 1) + along(top(low), low, -1, 1))
    gap, found = muscle.loop(Muscle(hysteresis=20.0), 500e3, 1.2e-3, cycles=12)
    assert found == pytest.approx(20.0 * area, rel=1e-3)
    assert 0 < gap < 20.0 * (muscle.ends()[0] - muscle.ends()[1])
    far = muscle.loop(Muscle(hysteresis=20.0), 500e3, 30e-3)[0]
    assert far == pytest.approx(20.0 * (muscle.ends()[0] - muscle.ends()[1]), rel=1e-3)


def test_rates_add_up_to_a_power_of_time():
    t = np.geomspace(0.01, 1500, 40)
    summed = (muscle.weights()[:, None] * -np.expm1(-muscle.RATES[:, None] * t)).sum(axis=0)
    assert summed == pytest.approx(muscle.power(t), rel=1e-3)
    assert muscle.power(np.array(10.0)) - muscle.power(np.array(1.0)) == pytest.approx(1.0)


# -- noise and regulator -------------------------------------------------------------------------------------------


def test_the_noise_has_its_colour():
    n, rate = 200_000, 500.0
    for channel in bench.WHITE:
        noise = bench.noise(channel, n, rate, np.random.default_rng(1))
        size, constant = bench.DRIFTING[channel]
        hum = bench.HUM[channel]
        for lag in (1, 7, 10, 25):  # 10 samples are one cycle of the hum
            expected = size**2 * np.exp(-lag / (rate * constant)) + 0.5 * hum**2 * np.cos(2 * np.pi * lag / 10)
            spread = 4 * (bench.WHITE[channel] ** 2 + size**2 * 4 * constant * rate) / np.sqrt(n)
            assert np.mean(noise[lag:] * noise[:-lag]) == pytest.approx(expected, abs=spread)
        white = bench.noise(channel, n, rate, np.random.default_rng(1), colour=0.0)
        assert np.mean(white[1:] * white[:-1]) == pytest.approx(0.0, abs=4 * bench.WHITE[channel] ** 2 / np.sqrt(n))
        assert np.std(white) == pytest.approx(bench.WHITE[channel], rel=0.01)


def test_the_regulator_is_that_of_a_solver():
    t = np.arange(2001) / 1000

    def slope(at, y):
        asked = 300e3 * (at >= 0.2 + bench.DEAD) - 100e3 * (at >= 1.0 + bench.DEAD)
        return [(asked - y[0]) / bench.REGULATOR, (y[0] - y[1]) / bench.REGULATOR]

    solved = solve_ivp(slope, (0, 2), [0.0, 0.0], t_eval=t, max_step=1e-3).y[1]
    assert bench.stepped(((0.2, 300e3), (1.0, 200e3)), t) == pytest.approx(solved, abs=150)
    command = 300e3 * (t >= 0.2) - 100e3 * (t >= 1.0)
    assert bench.regulated(command, 1000.0) == pytest.approx(solved, abs=2000)
    ramp = np.arange(1000) / 1000
    assert (ramp - bench.behind(ramp, 0.02, 1000.0))[-1] == pytest.approx(0.02, rel=1e-6)


# -- motion --------------------------------------------------------------------------------------------------------


def lifted(of: Muscle, fine: int, masses=(6.0, 41.0)):
    t = np.arange(round(3.0 * RATE) * fine + 1) / (RATE * fine)
    P = np.array([bench.stepped(((0.2, 500e3), (1.8, 300e3)), t) for _ in masses])
    return hang(of, np.array(masses), P, RATE * fine, np.full(len(masses), 10.0), fine=fine)


@pytest.mark.parametrize("of", [CLEAN, pytest.param(REAL, marks=pytest.mark.study)], ids=["straight", "real"])
def test_half_the_step_changes_less_than_the_noise(of):
    (x, force), (finer, other) = lifted(of, 2), lifted(of, 4)
    assert np.sqrt(np.mean((x - finer) ** 2)) < 0.1 * bench.WHITE["displacement"]
    assert np.median(np.abs(force - other)) < 0.1 * bench.WHITE["force"]


def test_a_lift_is_that_of_an_adaptive_solver():
    """The real muscle without creep, whose hysteresis the solver carries along."""
    of, mass = Muscle(bend=1.0, hysteresis=22.0), 41.0

    def pressure(t):
        return bench.stepped(((0.2, 500e3),), np.array([t]))[0]

    def slope(t, y):
        x, v, z = y
        P = pressure(t)
        pull = float(of.static(np.array(x), P) - of.rubbed(P) * z) - mass * G
        B = DAMPING[1][0] + DAMPING[1][1] * P
        moves = pull > FRICTION or v > 0
        rise = (pull - B * v - FRICTION) / mass if moves else 0.0
        strands = v + muscle.WIDENS * (pressure(t + 1e-6) - P) / 1e-6
        return [v, rise, strands / TURN * float(muscle.slope(np.array(z), np.array(strands)))]

    t = np.arange(round(1.5 * RATE)) / RATE
    solved = solve_ivp(slope, (0, 1.5), [0.0, 0.0, muscle.ends()[1]], t_eval=t, rtol=1e-8, atol=1e-10, max_step=2e-3)
    x = lifted(of, 4, (mass,))[0][0][: len(t)]
    moving = solved.y[1] > 1e-4
    assert moving.sum() > 100
    assert x[moving] == pytest.approx(solved.y[0][moving], abs=5e-6)


def test_a_weight_that_is_held_creeps_as_the_convolution_says():
    """x_c = integral of power(t - s) over the drive's changes; friction holds back what still creeps up."""
    of = Muscle(creep=0.03)
    t = np.arange(round(20.0 * RATE) + 1) / RATE
    P = bench.stepped(((0.2, 400e3),), t)
    x, force = (one[0] for one in hang(of, np.array([20.0]), P[None, :], RATE, np.array([10.0])))
    drive = of.creep * muscle.heavier(force) * x
    for at in (5.0, 10.0, 20.0):
        n = round(at * RATE)
        crept = float(np.sum(muscle.power(at - t[:n] - 0.5 / RATE) * np.diff(drive)[:n]))
        held = float(CLEAN.static(np.array(x[n] - crept), np.array(400e3))) - 20.0 * G
        v = (x[n] - x[n - 250]) / 0.5
        assert held == pytest.approx(FRICTION + (2.1e3 + 1.6e-3 * 400e3) * v, abs=0.1)
    # of a load held for ever so long, the contraction alone goes by the power of time
    assert of.crept(np.array(10.0), 200.0) - of.crept(np.array(1.0), 200.0) == pytest.approx(0.03)


def test_creep_and_hysteresis_go_over_from_one_trial_to_the_next():
    of, t = Muscle(creep=0.03, hysteresis=20.0), np.arange(1501) / RATE
    P = np.tile(bench.stepped(((0.2, 300e3), (2.0, 0.0)), t), (2, 1))
    x, _ = hang(of, np.full(2, 15.0), P, RATE, np.array([5.0, 5.0]))
    assert 20e-6 < x[1, 900] - x[0, 900] < 1e-3
    alone, _ = hang(of, np.full(1, 15.0), P[:1], RATE, np.array([5.0]))
    assert alone[0] == pytest.approx(x[0], abs=1e-9)


def test_a_ramp_shows_gap_mean_and_tangent_of_the_truth():
    of, P = Muscle(bend=1.0, hysteresis=22.0), 340e3
    there = np.linspace(0, 40e-3, 10001)
    x = np.concatenate([there, there[::-1]])
    force = driven.follow(of, [np.full(len(x), P)], [x])[0]
    v = 40e-3 / 20.0
    at = np.array([15e-3, 20e-3, 25e-3])
    up, down = np.interp(at, there, force[:10001]), np.interp(at, there, force[:10000:-1])
    viscous = [(DAMPING[way][0] + DAMPING[way][1] * P) * v for way in (1, -1)]
    assert down - up == pytest.approx(float(of.gap(np.array(P))) + sum(viscous), abs=0.2)
    mean = 0.5 * (up + viscous[0] + down - viscous[1])
    assert mean == pytest.approx(of.mean(at, np.array(P)), abs=0.1)
    assert -(mean[2] - mean[0]) / 10e-3 == pytest.approx(float(of.tangent(np.array(20e-3), np.array(P))), rel=0.01)


# -- campaigns and tests -------------------------------------------------------------------------------------------


def plateaus(trials, channel="force"):
    return np.array([getattr(trial, channel)[2300:2500].mean() for trial in trials])


def at_rest(trials, channel="force"):
    return np.array([getattr(trial, channel)[:140].mean() for trial in trials])


def test_at_rest_the_cell_reads_the_weight_and_without_pressure_nothing():
    trials = campaign("creep", 0.04, 1)
    assert plateaus(trials) == pytest.approx([mass * G for mass, _ in PLAN], abs=0.3)
    assert at_rest(trials) == pytest.approx(np.zeros(24), abs=0.15)


@pytest.mark.parametrize("seed", [1, 2])
def test_faults_of_the_bench_have_their_size_in_the_record(seed):
    sound = campaign("clean", 0.0, seed)
    loads = np.array([mass * G for mass, _ in PLAN])
    drift = at_rest(campaign("drift", 10.0, seed))
    assert np.abs(drift[-1] - drift[0]) == pytest.approx(10.0, abs=0.5)
    gain = plateaus(campaign("gain", 0.03, seed)) / loads - 1
    assert np.abs(gain) == pytest.approx(np.full(24, 0.03), abs=0.006)
    mass = [trial.load for trial in campaign("mass", 0.05, seed)] / loads - 1
    assert sorted(np.round(np.abs(mass), 6)) == [0.0] * 21 + [0.05] * 3
    slip = plateaus(campaign("slip", 3e-3, seed), "displacement") - plateaus(sound, "displacement")
    assert np.abs(slip[-1]) == pytest.approx(3e-3, abs=2e-4)
    assert np.abs(slip[:3]) == pytest.approx(np.zeros(3), abs=5e-6)
    rise = slice(0, 2300)
    for cause, channel in (
        ("pressure-late", "pressure"),
        ("pressure-lag", "pressure"),
        ("position-lag", "displacement"),
    ):
        size = AMOUNTS[cause][-1]
        late = getattr(campaign(cause, size, seed)[5], channel)
        missing = float(np.sum(getattr(sound[5], channel)[rise] - late[rise])) / RATE
        assert missing == pytest.approx(size * float(late[2300]), rel=0.05 if channel == "displacement" else 0.16)
    slower = campaign("tube", 20e-3, seed)[5].displacement
    missing = float(np.sum(sound[5].displacement[rise] - slower[rise])) / RATE
    assert missing == pytest.approx(20e-3 * slower[2300], rel=0.12)


def test_the_truth_is_a_value_where_the_muscle_is_straight_and_a_range_where_it_is_not():
    P = np.array([200e3, 350e3, 500e3])
    for cause, amount in CASES:
        for symbol, of in truth(cause, amount).items():
            low, high = of(P)
            assert (low <= high).all(), (cause, symbol)
            ranged = {"K": ("bend", "creep", "several", "real"), "F_c": ("hysteresis", "several", "real")}
            ranged["F_ce"] = ranged["F_c"]
            assert (low < high).all() == (cause in ranged.get(symbol, ())), (cause, symbol)
    assert len({mass for mass, _ in PLAN}) == len(MASSES)
    assert steps(350e3)[-1][1] == 0.0


@pytest.mark.study
def test_slow_tests_stay_in_range_and_a_motion_at_random_within_them():
    tests, motions = driven.session(seed=1)
    assert [one.kind for one in tests].count("sine") == 18
    loaded = [one for one in tests if one.kind in ("isobaric-ramp", "sine", "hold", "step")]
    assert min(one.true.min() for one in (*loaded, *motions)) > 0
    for one in motions:
        assert len(one.t) == 4000
        assert np.ptp(one.pressure) > 200e3
        assert np.ptp(one.displacement) > 20e-3
    for one, again, other in zip(*(driven.wander(seed=seed) for seed in (1, 1, 2)), strict=True):
        assert np.array_equal(one.force, again.force)
        assert not np.array_equal(one.force, other.force)


@pytest.mark.study
def test_weights_that_are_held_long_go_on_creeping():
    for trial in driven.held(seed=1):
        x = trial.displacement
        assert plateaus([trial]) == pytest.approx([trial.load], abs=0.3)
        first, second = (x[round((0.6 + b) * RATE)] - x[round((0.6 + a) * RATE)] for a, b in ((4, 12), (12, 36)))
        assert second > 0.8 * first > 0
