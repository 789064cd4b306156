"""A free end that moves air: against an independent integration of the whole equations, limits, and itself."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pmabench.model.driven import Actuator
from pmabench.model.overrides import Overrides
from pmabench.model.presets import preset
from pmabench.model.regulator import constant, ramp, sine

MICROMETRE = 1e-6
DEAD, W, ZETA = 0.04, 2 * math.pi * 2.5, 0.9
FILL, VENT, K, RT, ROOM = 1e-7, 0.5e-7, 1.2, 287.0 * 293.0, 101325.0
F_S, F_C, KNEE, STOP = 10.0, 6.0, 1e-3, 0.07


def bench(force=0.0, mass=0.5, kind="bench", **changes):
    return preset("paper0-air", kind, Overrides(**changes)).free(force=force, mass=mass)


def f_ce(P):
    return max(0.0, 1.08e-3 * P - 49.0)


def stiffness(P):
    return 5.6e3 + 1e-3 * P + 9.7e-9 * P * P


def volume(x):
    """Volume [m3] and its slope [m2] of a tube of 20 mm by 250 mm braided at 25 deg, whose strands do not stretch."""
    strand, turns = 0.25 / math.cos(math.radians(25)), 0.25 * math.tan(math.radians(25)) / (math.pi * 0.02)
    long = 0.25 - min(max(x, 0.0), STOP)
    V = long * (strand**2 - long**2) / (4 * math.pi * turns**2)
    return V, -(strand**2 - 3 * long**2) / (4 * math.pi * turns**2) if 0 <= x <= STOP else 0.0


def independent(levels, force, mass, end, *, F_s=F_S, F_c=F_C):
    """Contraction [m] and pressure [Pa] at 500 Hz; `levels` [(start, Pa)]. Rest and motion are told apart by events."""
    t_all = np.arange(round(end * 500) + 1) / 500
    edges = [(0.0, 0.0)] + [(start + DEAD, P) for start, P in levels] + [(end, 0.0)]
    state, way = np.zeros(5), 0
    x_all, P_all = np.zeros(t_all.shape), np.zeros(t_all.shape)

    def drive(y):
        return f_ce(y[2]) - stiffness(y[2]) * y[0] - force

    def rates(y, wanted, way):
        x, v, P, r, s = y
        V, slope = volume(x)
        flow = K * RT * (FILL if r > P else VENT) * (r - P)
        if way == 0:
            return [0.0, 0.0, flow / V, s, W * W * (wanted - r) - 2 * ZETA * W * s]
        B = (1.2e3 + 1.6e-3 * P) if way > 0 else (1.1e3 + 3.4e-3 * P)
        resist = max(F_c, F_s - (F_s - F_c) / KNEE * way * v)
        pressure = (flow - K * (P + ROOM) * slope * v) / V
        return [v, (drive(y) - B * v - way * resist) / mass, pressure, s, W * W * (wanted - r) - 2 * ZETA * W * s]

    for (t, wanted), (until, _) in itertools.pairwise(edges):
        while t < until - 1e-12:
            if way == 0:
                now = drive(state)
                held_up, held_down = state[0] >= STOP - 1e-15, state[0] <= 0
                way = 1 if now > F_s + 1e-9 and not held_up else -1 if now < -F_s - 1e-9 and not held_down else 0
            if way == 0:
                events = [lambda t, y: drive(y) - F_s - 2e-9, lambda t, y: -drive(y) - F_s - 2e-9]
                events = [event for event, held in zip(events, (held_up, held_down), strict=True) if not held]
                for event in events:
                    event.direction = 1
            else:
                events = [lambda t, y, way=way: way * y[1], lambda t, y: y[0], lambda t, y: STOP - y[0]]
                for event in events:
                    event.direction = -1
            for event in events:
                event.terminal = True
            solved = solve_ivp(
                lambda t, y, wanted=wanted, way=way: rates(y, wanted, way), (t, until), state, "LSODA",
                dense_output=True, events=events, rtol=1e-10, atol=[1e-13, 1e-11, 1e-5, 1e-5, 1e-4],
                max_step=0.05,
            )  # fmt: skip
            rows = (t_all >= t) & (t_all <= solved.t[-1])
            if rows.any():
                x_all[rows], P_all[rows] = solved.sol(t_all[rows])[[0, 2]]
            t, state = solved.t[-1], solved.y[:, -1].copy()
            if way and solved.status == 1:
                state[1] = 0.0
                state[0] = min(max(state[0], 0.0), STOP)
                way = 0
    return x_all, P_all


LEVELS = [(0.0, 300e3), (2.0, 450e3), (4.0, 200e3), (6.0, 0.0)]


def stepped(plant, levels=LEVELS, end=8.0):
    """Contraction [m] and pressure [Pa] at 500 Hz."""
    t = np.arange(round(end * 500) + 1) / 500
    x, P = [], []
    for i, (start, level) in enumerate(levels):
        plant.command(constant(start, level))
        until = levels[i + 1][0] if i + 1 < len(levels) else end
        last = t <= until if until == end else t < until
        motion = plant.advance(until, t[(t >= start) & last])
        x.append(motion.x)
        P.append(motion.P)
    return np.concatenate(x), np.concatenate(P)


@pytest.mark.parametrize(("force", "mass"), [(0.0, 0.01), (58.86, 1.0), (294.3, 30.0), (0.0, 50.0)])
@pytest.mark.parametrize("friction", [1, 0])
def test_steps_up_and_down_are_those_of_an_independent_integration(force, mass, friction):
    x, P = stepped(bench(force, mass, friction=friction))
    expected, pressure = independent(LEVELS, force, mass, 8.0, F_s=friction * F_S, F_c=friction * F_C)
    assert expected.max() > 0.01, "it lifts"
    assert np.abs(x - expected).max() < 0.2 * MICROMETRE
    assert np.abs(P - pressure).max() < 10.0


def test_the_motion_is_felt_in_the_pressure():
    """While 8 kg are let down the muscle's air is pressed together; a chamber that does not move knows nothing of it."""
    _, moving = stepped(bench(58.86, 8.0))
    _, still = stepped(bench(1e4, 8.0))
    assert (moving - still)[2100:2300].max() > 5e3
    assert (moving - still)[20:300].min() < -5e3


@pytest.mark.parametrize("order", [{}, {"regulator_lag": 0.0955}])
def test_a_regulator_that_moves_all_the_air_at_once_is_one_without_chamber(order):
    plain, _ = stepped(bench(58.86, 8.0, conductance_fill=0.0, conductance_vent=0.0, **order))
    for conductance, apart in ((1e-6, 200.0), (1e-5, 20.0), (1e-3, 0.5)):
        x, _ = stepped(bench(58.86, 8.0, conductance_fill=conductance, conductance_vent=conductance, **order))
        assert np.abs(x - plain).max() < apart * MICROMETRE


def test_pressure_at_rest_is_the_lag_of_the_chamber():
    """A load that is not lifted: V / (k r T C) = 7.783 ms while filling, twice that while venting."""
    plant = bench(1e4, 10.0, natural_frequency=0.0, dead_time=0.0)
    lag = math.pi * 0.01**2 * 0.25 / (K * RT * FILL)
    plant.command(constant(0.0, 300e3))
    t = np.array([0.0, lag, 3 * lag, 0.5])
    assert plant.advance(0.5, t).P == pytest.approx(300e3 * -np.expm1(-t / lag), abs=1e-3)
    plant.command(constant(0.5, 0.0))
    assert plant.advance(0.5 + 2 * lag, np.array([0.5 + 2 * lag])).P[0] == pytest.approx(300e3 / math.e, rel=1e-6)


def test_a_shut_valve_keeps_p_v_to_the_k():
    """P_abs V^1.2 stays what it is while a load is taken off and put on again."""
    plant = bench(200.0, 10.0)
    plant.command(constant(0.0, 300e3))
    plant.advance(3.0)
    kept = (plant.pressure + ROOM) * volume(plant.x)[0] ** K
    plant.shut(shut=True)
    plant.command(constant(3.0, 0.0))
    before = plant.x
    for until, force in ((5.0, 0.0), (7.0, 300.0), (9.0, 100.0)):
        plant.load(force, 5.0)
        motion = plant.advance(until, np.linspace(until - 2, until, 1001)[1:])
        held = (motion.P + ROOM) * np.array([volume(x)[0] for x in motion.x]) ** K
        np.testing.assert_allclose(held, kept, rtol=5e-6)
    assert abs(plant.x - before) > 2e-3
    plant.shut(shut=False)
    assert plant.advance(12.0, np.array([12.0])).P[0] == pytest.approx(0.0, abs=1.0)


def test_ramps_and_sines_are_those_of_fine_steps():
    """Stick-slip under a slow ramp, and a sine; LSODA and closed forms against implicit steps of 50 us."""

    def run(longest):
        plant, x = bench(58.86, 8.0), []
        for t in np.arange(1, 501) / 100:
            if t == 0.01:
                plant.command(constant(0.0, 250e3))
            elif t == 2.0:
                plant.command(ramp(2.0, 250e3, 266e3, 8e3))
            elif t == 4.0:
                plant.command(sine(4.0, 266e3, 60e3, 1.0, 9))
            if longest:
                plant.reach(float(t), longest)
            else:
                plant.advance(float(t), (float(t),))
            x.append(plant.x)
        return np.array(x)

    found, fine = run(None), run(5e-5)
    assert np.ptp(fine[400:]) > 5e-3
    assert np.abs(found - fine).max() < 1.0 * MICROMETRE


def test_a_loop_closed_every_sample_is_that_of_fine_steps():
    def run(longest):
        plant, integral, x = bench(0.0, 2.0), 0.0, []
        for k in range(1500):
            plant.reach((k + 1) * 2e-3, longest)
            error = (0.03 if k < 1000 else 0.01) - plant.x
            integral += error * 2e-3
            plant.command(constant(plant.time, min(max(10e6 * (error + integral / 0.5), 0.0), 600e3)))
            x.append(plant.x)
        return np.array(x)

    fine = run(1e-4)
    assert np.ptp(fine) > 0.02
    assert np.abs(run(2e-3) - fine).max() < 5 * MICROMETRE


@pytest.mark.parametrize("conductance", [1e-12, 1e-3])
def test_steps_of_a_closed_loop_bear_every_mass_and_conductance(conductance):
    plant = bench(0.0, 0.01, conductance_fill=conductance, conductance_vent=conductance, friction=0)
    for k in range(500):
        plant.command(constant(plant.time, 600e3 if k % 100 < 50 else 0.0))
        plant.reach((k + 1) * 2e-3)
        assert 0 <= plant.x <= plant.muscle.stop
        assert -1e3 < plant.pressure < 700e3


def test_a_moment_can_be_come_back_to():
    plant = bench(58.86, 8.0)
    plant.command(constant(0.0, 300e3))
    plant.advance(0.2)
    kept, t = plant.snapshot(), np.linspace(0.2, 1.0, 50)
    first = plant.advance(1.0, t)
    for _ in range(2):
        plant.restore(kept)
        again = plant.advance(1.0, t)
        assert (again.x == first.x).all()
        assert (again.P == first.P).all()


def test_a_driven_end_has_the_same_air():
    plant = preset("paper0-air", "bench", Overrides(follow_lag=0.0)).driven(Actuator(force=9e3, speed=1.0), 0.02)
    plant.command(constant(0.0, 300e3))
    plant.move(sine(0.0, 0.02, 15e-3, 2.0, 6))
    t = np.arange(1, 751) / 500
    omega = 2 * math.pi * 2.0

    def rates(s, y):
        x, v = 0.02 + 15e-3 * math.sin(omega * s), 15e-3 * omega * math.cos(omega * s)
        V, slope = volume(x)
        flow = K * RT * (FILL if y[1] > y[0] else VENT) * (y[1] - y[0])
        wanted = 300e3 if s > DEAD else 0.0
        return [(flow - K * (y[0] + ROOM) * slope * v) / V, y[2], W * W * (wanted - y[1]) - 2 * ZETA * W * y[2]]

    solved = solve_ivp(rates, (0.0, 1.5), [0.0] * 3, t_eval=t, rtol=1e-9, atol=1e-4, max_step=1e-3)
    assert np.ptp(solved.y[0] - solved.y[1]) > 20e3, "the motion is felt"
    np.testing.assert_allclose(plant.advance(1.5, t).P, solved.y[0], atol=100.0)


@pytest.mark.parametrize("seed", range(8))
def test_whatever_is_commanded_both_ways_of_going_on_agree(seed):
    """Random regulators, conductances, masses, commands, loads and a valve; numbers and bounds, LSODA against steps."""
    rng = np.random.default_rng(seed)
    changes = {
        "friction": rng.choice([0.0, 1.0, 3.0]),
        "natural_frequency": 10 ** rng.uniform(-0.3, 1.5),
        "damping_ratio": rng.choice([0.2, 0.7, 1.0, 3.0]),
        "conductance_fill": 10 ** rng.uniform(-8, -5),
        "conductance_vent": 10 ** rng.uniform(-8, -5),
        "leak": rng.choice([0.0, 0.02, 1.0]),
    }
    mass, force = 10 ** rng.uniform(-2, 1.7), rng.choice([0.0, 50.0, 200.0])
    parts = [(rng.integers(5), rng.uniform(0, 550e3), rng.uniform(0, 300), rng.uniform(0.01, 20)) for _ in range(4)]
    long, short = (bench(float(force), float(mass), **{k: float(v) for k, v in changes.items()}) for _ in range(2))
    for what, level, other, heavy in parts:
        t = long.time + np.arange(1, 201) / 500
        found = []
        for plant in (long, short):
            plant.shut(shut=bool(what == 1))
            if what == 2:
                plant.load(float(other), float(heavy))
            elif what == 3:
                plant.command(sine(plant.time, 200e3, 100e3, 3.0, 5))
            elif what == 4:
                plant.command(ramp(plant.time, plant.supply.setpoint(plant.time), float(level), 200e3))
            else:
                plant.command(constant(plant.time, float(level)))
        motion = long.advance(float(t[-1]), t)
        for s in t.tolist():
            short.reach(s, 4e-4)
            found.append((short.x, short.pressure))
        x, P = np.array(found).T
        assert np.isfinite(motion.F).all()
        assert motion.x.min() >= 0
        assert motion.x.max() <= STOP
        np.testing.assert_allclose(motion.x, x, atol=10 * MICROMETRE)
        np.testing.assert_allclose(motion.P, P, atol=500.0)
