"""The free-end plant against closed forms, printed values and independent tight integrations."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from pmabench.model.muscle import Friction
from pmabench.model.overrides import Overrides
from pmabench.model.plant import Plant
from pmabench.model.presets import preset
from pmabench.model.regulator import constant, ramp, sine

LOADS = [58.86 + 49.05 * i for i in range(10)]


def free_end(name="paper0", kind="ideal", force=0.0, mass=0.5, pressure=0.0, **changes):
    setup = preset(name, kind, Overrides(**changes))
    return Plant(setup.muscle, setup.regulator, force=force, mass=mass, pressure=pressure)


def run(plant, commands, end, rate=500.0):
    """Apply (start, waves) in turn; everything at `rate`."""
    t = np.arange(round(end * rate) + 1) / rate
    parts = []
    for i, (_, waves) in enumerate(commands):
        until = commands[i + 1][0] if i + 1 < len(commands) else end
        plant.command(waves)
        now = plant.time
        parts.append(plant.advance(until, t[(t > now) & (t <= until)] if i else t[t <= until]))
    return {name: np.concatenate([getattr(part, name) for part in parts]) for name in ("t", "x", "v", "P", "F")}


# -- ideal: closed forms -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kPa", [150, 200, 300, 400, 500])
@pytest.mark.parametrize("force", [0.0, 58.86, 157.0])
def test_it_settles_where_the_spring_says(kPa, force):
    plant = free_end(force=force)
    plant.command(constant(0.0, kPa * 1e3))
    plant.advance(10.0)
    f_ce, stiffness = 1.08 * kPa - 49.0, 5.6 + 1.0e-3 * kPa + 9.7e-6 * kPa**2
    assert plant.x * 1e3 == pytest.approx(max(0.0, (f_ce - force) / stiffness), abs=1e-4)


def test_a_step_is_the_exponential_of_the_paper_after_40_ms():
    plant = free_end(force=58.86, mass=0.01)
    data = run(plant, [(0.0, constant(0.0, 300e3))], 5.0)
    x_end, tau = (275 - 58.86) / 6.773e3, 1.68e3 / 6.773e3
    expected = np.where(data["t"] < 0.04, 0.0, x_end * (1 - np.exp(-(data["t"] - 0.04) / tau)))
    np.testing.assert_allclose(data["x"], expected, atol=2e-6)
    assert data["t"][np.flatnonzero(data["x"] > 1e-6)[0]] == pytest.approx(0.042)
    at_tau = np.interp(0.04 + tau, data["t"], data["x"]) / x_end
    assert at_tau == pytest.approx(0.63212, abs=1e-4)


def test_relaxation_has_the_damping_of_relaxation():
    plant = free_end(mass=0.01)
    run(plant, [(0.0, constant(0.0, 400e3))], 8.0)
    x0, x1 = 383 / 7.552e3, 275 / 6.773e3
    plant.command(constant(8.0, 300e3))
    t = 8.0 + np.array([0.04, 0.2, 0.5, 1.0])
    tau = 2.12e3 / 6.773e3
    expected = x1 + (x0 - x1) * np.exp(-(t - 8.04) / tau)
    np.testing.assert_allclose(plant.advance(9.0, t).x, expected, atol=3e-6)


@pytest.mark.parametrize("name", ["paper0", "serres2009"])
@pytest.mark.parametrize("kind", ["ideal", "bench"])
def test_the_cell_reads_load_and_inertia(name, kind):
    plant = free_end(name, kind, force=78.48, mass=10.0)
    data = run(plant, [(0.0, constant(0.0, 300e3)), (5.0, constant(5.0, 200e3))], 10.0, rate=5000)
    acceleration = np.gradient(data["v"], data["t"])
    moving = (data["x"] > 1e-3) & (np.abs(np.gradient(acceleration)) < 0.01)
    np.testing.assert_allclose(data["F"][moving], 78.48 + 10 * acceleration[moving], atol=0.1)


def test_energy_of_a_stroke_balances():
    """Work of the pressure force = load raised + spring + damper + friction + motion, over a whole stroke."""
    plant = free_end(kind="bench", force=98.1, mass=12.0)
    data = run(plant, [(0.0, constant(0.0, 350e3))], 3.0, rate=5000)
    muscle, dx = plant.muscle, np.diff(data["x"])

    def middle(y):
        return (y[1:] + y[:-1]) / 2

    P, v = middle(data["P"]), middle(data["v"])
    active = np.sum(muscle.F_ce.values(P) * dx)
    spring = np.sum(muscle.K.values(P) * middle(data["x"]) * dx)
    damper = np.sum(muscle.B_c.values(P) * v * dx)
    friction = np.sum(muscle.friction.values(v) * dx)
    balance = active - spring - damper - friction - 98.1 * data["x"][-1] - 6.0 * data["v"][-1] ** 2
    assert active > 5
    assert abs(balance) < 2e-4 * active


# -- the support, the stop, stiction --------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "friction"), [("ideal", 0.0), ("bench", 10.0)])
@pytest.mark.parametrize("force", LOADS)
def test_a_load_lifts_at_the_pressure_of_its_weight_and_the_stiction(kind, friction, force):
    """docs/papers.md, row 4: 58.86 N at 99.9 kPa, 545.44 N at 550.4 kPa, 9.3 kPa more with friction."""
    plant = free_end(kind=kind, force=force, mass=force / 9.81 + 2, regulator_lag=0.0, dead_time=0.0)
    lift = (force + friction + 49) / 1.08
    plant.command(ramp(0.0, 0.0, 620e3, 2e3))
    plant.advance(lift / 2 - 0.01)
    assert (plant.x, plant.v) == (0.0, 0.0)
    motion = plant.advance(lift / 2 + 0.3, np.arange(lift / 2, lift / 2 + 0.3, 0.002))
    assert motion.x[-1] > 1e-6
    assert motion.P[np.flatnonzero(motion.x)[0]] / 1e3 == pytest.approx(lift, abs=0.1)


def test_the_cell_on_the_support_reads_the_muscle_up_to_the_load():
    plant = free_end(kind="bench", force=100.0, mass=12.2, regulator_lag=0.0, dead_time=0.0)
    plant.command(ramp(0.0, 0.0, 150e3, 10e3))
    t = np.array([0.0, 4.0, 10.0, 13.0, 14.0, 14.5])
    motion = plant.advance(14.5, t)
    assert motion.F.tolist() == pytest.approx([0.0, 0.0, 59.0, 91.4, 100.0, 100.0])
    assert not motion.x.any()


def test_at_rest_above_the_support_the_cell_reads_the_load():
    plant = free_end(kind="bench", force=100.0, mass=12.2)
    plant.command(constant(0.0, 300e3))
    plant.advance(8.0)
    assert plant.v == 0
    assert plant.reading()[2] == 100.0
    assert abs(275 - 100 - plant.x * 6773) < 10.0


def test_a_vented_load_lands_on_its_support_and_stays():
    plant = free_end(kind="bench", force=58.86, mass=8.0)
    data = run(plant, [(0.0, constant(0.0, 300e3)), (5.0, constant(5.0, 0.0))], 10.0)
    assert data["x"][-1] == 0.0
    assert data["F"][-1] == 0.0
    assert data["x"].min() == 0.0


def test_the_muscle_has_an_end():
    plant = free_end("serres2009", force=0.0)
    plant.command(constant(0.0, 700e3))
    motion = plant.advance(5.0, np.array([5.0]))
    assert motion.x[0] == plant.muscle.stop == 0.07
    assert motion.F[0] == pytest.approx(2.91 * 700 + 44.6 - (17 + 0.0179 * 700) * 70)


def test_stiction_leaves_a_band_of_rest_positions():
    """Up and down to the same pressure end apart by at most 2 F_s / K and more than F_c / K."""
    plant = free_end(kind="bench", force=58.86, mass=8.0)
    data = run(
        plant, [(0.0, constant(0, 200e3)), (5.0, constant(5, 400e3)), (10.0, constant(10, 200e3))], 15.0, rate=500
    )
    up, down = data["x"][2400], data["x"][-1]
    assert 6.0 / 6188 < down - up < 20.0 / 6188


def test_a_slow_ramp_creeps_in_jumps_of_the_right_size():
    """A slip starts F_s out of balance and ends where damping takes 1 mm/s: it frees F_s - F_c - B 1 mm/s, some 2.6 N.

    Meanwhile the ramp adds less than 1 N.
    """
    plant = free_end(kind="bench", force=58.86, mass=2.5, pressure=0.0)
    data = run(plant, [(0.0, constant(0, 150e3)), (3.0, ramp(3, 150e3, 250e3, 2e3))], 53.0)
    moving = data["v"] > 0
    starts = np.flatnonzero(moving[1:] & ~moving[:-1])[2:]
    ends = np.flatnonzero(~moving[1:] & moving[:-1])[2:]
    jumps = data["x"][ends[: len(starts)] + 1] - data["x"][starts[: len(ends)]]
    assert len(jumps) > 20
    freed = jumps * plant.muscle.K(200e3)
    assert freed.min() > 2.4
    assert freed.max() < 3.6


# -- against independent tight integrations ---------------------------------------------------------------------


def tight(muscle, P, force, mass, way, x0, v0, begin, end, t, friction=lambda u: 0.0, **options):
    damping = muscle.B_c if way > 0 else muscle.B_r

    def rate(s, y):
        p = P(s)
        pull = muscle.F_ce(p) - muscle.K(p) * y[0] - damping(p) * y[1] - way * friction(way * y[1])
        return [y[1], (pull - force) / mass]

    return solve_ivp(rate, (begin, end), [x0, v0], t_eval=t, method="LSODA", rtol=1e-10, atol=1e-13, **options)


@pytest.mark.parametrize("mass", [0.01, 0.5, 57.0])
@pytest.mark.parametrize("name", ["paper0", "serres2009"])
def test_smooth_motion_is_within_a_micrometre_of_a_tight_solution(name, mass):
    plant = free_end(name, "bench", force=58.86, mass=mass, friction=0)

    def P(s):
        return 300e3 * (1 - math.exp(-(s - 0.04) / 0.0955))

    onset = brentq(lambda s: plant.muscle.F_ce(P(s)) - 58.86, 0.04, 0.5)
    t = np.arange(math.ceil(onset * 500) + 1, 1500) / 500
    truth = tight(plant.muscle, P, 58.86, mass, 1, 0.0, 0.0, onset, 3.0, t)
    plant.command(constant(0.0, 300e3))
    motion = plant.advance(3.0, t)
    assert np.abs(motion.x - truth.y[0]).max() < 1e-6


@pytest.mark.parametrize("mass", [0.5, 8.0, 57.0])
def test_stiction_is_within_a_micrometre_of_a_tight_solution(mass):
    plant = free_end(kind="bench", force=78.48, mass=mass)
    friction = plant.muscle.friction

    def P(s):
        return 250e3 * (1 - math.exp(-(s - 0.04) / 0.0955))

    def resist(u):
        return max(friction.F_c, min(friction.F_s, friction.F_s - friction.slope * u))

    def stops(s, y):
        return y[1]

    stops.terminal, stops.direction = True, -1
    onset = brentq(lambda s: plant.muscle.F_ce(P(s)) - 78.48 - 10.0, 0.04, 0.5, xtol=1e-13)
    t = np.arange(math.ceil(onset * 500) + 1, 1500) / 500
    truth = tight(plant.muscle, P, 78.48, mass, 1, 0.0, 1e-12, onset, 3.0, t, resist, events=stops, max_step=2e-3)
    plant.command(constant(0.0, 250e3))
    motion = plant.advance(3.0, t)
    assert truth.status == 1
    count = len(truth.t)
    assert np.abs(motion.x[:count] - truth.y[0]).max() < 1e-6
    assert motion.x[-1] == pytest.approx(truth.y_events[0][0][0], abs=1e-6)
    assert not motion.v[count + 1 :].any()


def test_a_sine_is_within_a_micrometre_of_a_tight_solution():
    """Friction off; contraction and relaxation differ, so that every turn is an event."""
    plant = free_end(kind="bench", force=58.86, mass=2.5, friction=0)
    run(plant, [(0.0, constant(0.0, 300e3))], 10.0)
    plant.command(sine(10.0, 300e3, 80e3, 0.8, 4))
    t = np.arange(5021, 7500) / 500
    motion = plant.advance(15.0, t)
    muscle, lag, w = plant.muscle, 0.0955, 2 * math.pi * 0.8
    share = 80e3 / (1 + (w * lag) ** 2)

    def P(s):
        s = s - 10.04
        wave = math.sin(w * s) - w * lag * math.cos(w * s) + w * lag * math.exp(-s / lag)
        return 300e3 + share * wave

    def rate(s, y):
        p = P(s)
        damping = muscle.B_c(p) if y[1] > 0 else muscle.B_r(p)
        return [y[1], (muscle.F_ce(p) - muscle.K(p) * y[0] - damping * y[1] - 58.86) / 2.5]

    start = [(275 - 58.86) / 6773, 0.0]
    truth = solve_ivp(rate, (10.04, 15), start, t_eval=t, method="LSODA", rtol=1e-10, atol=1e-12, max_step=1e-3)
    assert np.abs(motion.x - truth.y[0]).max() < 1e-6


@pytest.mark.parametrize("mass", [0.01, 0.5, 8.0, 57.0])
@pytest.mark.parametrize("kind", ["ideal", "bench"])
@pytest.mark.parametrize("name", ["paper0", "serres2009"])
def test_steps_and_integration_agree(name, kind, mass):
    """Steps of 0.5 ms stay within 10 um of LSODA through steps, stops and landings."""
    commands = [
        (0.0, constant(0.0, 300e3)),
        (2.0, sine(2.0, 300e3, 50e3, 1.0, 2)),
        (5.0, ramp(5.0, 300e3, 280e3, 10e3)),
        (8.0, constant(8.0, 0.0)),
    ]
    data = run(free_end(name, kind, force=58.86, mass=mass), commands, 10.0)
    plant, waiting, worst = free_end(name, kind, force=58.86, mass=mass), list(commands), 0.0
    for t, x in zip(data["t"], data["x"], strict=True):
        plant.reach(float(t), 5e-4)
        while waiting and waiting[0][0] <= t:
            plant.command(waiting.pop(0)[1])
        worst = max(worst, abs(plant.x - x))
    assert worst < 10e-6


@pytest.mark.parametrize("mass", [0.01, 0.05, 1.0])
@pytest.mark.parametrize("dt", [1e-4, 2e-3, 20e-3])
def test_steps_are_stable_for_any_mass_and_step(mass, dt):
    plant = free_end(kind="bench", mass=mass)
    for k in range(400):
        plant.command(constant(plant.time, 300e3 if (k // 50) % 2 else 100e3))
        plant.reach(plant.time + dt, dt)
        x, P, F = plant.reading()
        assert 0 <= x <= 0.07
        assert math.isfinite(P)
        assert -50 < F < 400


# -- bookkeeping -------------------------------------------------------------------------------------------------


def test_what_comes_out_does_not_depend_on_how_it_is_asked_for():
    whole, pieces = free_end(kind="bench", force=58.86, mass=8.0), free_end(kind="bench", force=58.86, mass=8.0)
    for plant in (whole, pieces):
        plant.command(constant(0.0, 300e3))
    t = np.arange(0, 3001) / 1000
    expected = whole.advance(3.0, t)
    found = [pieces.advance((k + 1) * 0.1, t[k * 100 : (k + 1) * 100]).x for k in range(30)]
    np.testing.assert_allclose(np.concatenate(found), expected.x[:-1], atol=2e-7)
    sparse = free_end(kind="bench", force=58.86, mass=8.0)
    sparse.command(constant(0.0, 300e3))
    np.testing.assert_allclose(sparse.advance(3.0, t[::500]).x, expected.x[::500], atol=2e-7)


def test_a_snapshot_brings_everything_back_more_than_once():
    plant = free_end(kind="bench", force=58.86, mass=8.0)
    plant.command(constant(0.0, 300e3))
    plant.advance(0.3)
    snapshot, t = plant.snapshot(), np.arange(151, 400) / 500
    first = plant.advance(0.8, t)
    for _ in range(2):
        plant.restore(snapshot)
        plant.command(constant(0.35, 0.0))
        plant.load(30.0, 3.0)
        plant.advance(0.8)
        plant.restore(snapshot)
        assert plant.advance(0.8, t).x.tolist() == first.x.tolist()


def test_pure_coulomb_friction_needs_no_stribeck_range():
    muscle = preset("paper0", "ideal").muscle
    assert Friction(6.0, 6.0).knee == 0
    plant = free_end(kind="bench", force=58.86, mass=8.0, F_s=6.0, F_c=6.0)
    plant.command(constant(0.0, 300e3))
    plant.advance(10.0)
    assert plant.x == pytest.approx((275 - 58.86 - 6.0) / muscle.K(300e3), abs=1e-7)


@pytest.mark.parametrize(("force", "mass"), [(-1.0, 1.0), (1.0, 0.0), (math.nan, 1.0), (1.0, math.nan)])
def test_an_impossible_load_is_refused(force, mass):
    with pytest.raises(ValueError, match="load"):
        free_end().load(force, mass)


@pytest.mark.parametrize("name", ["paper0", "paper0-air"])
def test_a_sample_may_come_within_a_rounding_of_now(name):
    plant = preset(name, "bench").free(force=58.86, mass=8.0)
    plant.command(constant(0.0, 300e3))
    plant.advance(0.3)
    assert plant.way == 1
    now = plant.reading()[0]
    motion = plant.advance(0.5, np.array([np.nextafter(0.3, 1.0), 0.4]))
    assert motion.x[0] == pytest.approx(now, abs=1e-12)
    assert motion.x[1] > now + 1e-3
