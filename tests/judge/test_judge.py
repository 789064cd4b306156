"""The simulator itself: its steps are fine enough, its faults have their size, its truth is what was printed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.judge import filled, pair, rung, servo, tilted
from tests.judge.campaign import (
    CASES,
    CAUSES,
    FULL,
    MASSES,
    NOISE,
    PLAN,
    PRESSURES,
    RELAX,
    campaign,
    commands,
    muscle_of,
    truth,
    weighed,
)
from tests.judge.motion import DEAD_TIME, FILLING, GRAVITY, RATE, _advance, hang, pressure
from tests.judge.muscle import (
    CREEP_DECADES,
    CREEP_TIMES,
    FRICTION,
    Muscle,
    damping_down,
    damping_up,
    pull,
    stiffness,
)
from tests.judge.record import lagged


def test_the_lines_are_those_that_were_printed():
    P = np.array([150e3, 200e3, 314e3, 350e3, 500e3, 550e3])
    assert pull(P) == pytest.approx([481.1, 626.6, 958.34, 1063.1, 1499.6, 1645.1])
    assert stiffness(P) == pytest.approx([27885.0, 26280.0, 22620.6, 23265.0, 25950.0, 26845.0])
    assert damping_up(P) == pytest.approx([2900.0] * 6)
    assert damping_down(P) == pytest.approx([1570.0, 1570.0, 1570.0, 1570.0, 2001.0, 2170.0])


def test_the_pressure_follows_its_commands_after_the_dead_time():
    t = np.array([0.0, 0.2 + DEAD_TIME, 0.2 + DEAD_TIME + FILLING, 5.0])
    assert pressure(((0.2, 300e3),), t) == pytest.approx([0.0, 0.0, 300e3 * (1 - np.exp(-1)), 300e3])


@pytest.mark.parametrize(
    "muscle",
    [Muscle(), Muscle(bend=0.2), Muscle(creep=0.1), Muscle(hysteresis=30.0)],
    ids=["straight", "bent", "creeps", "rubs"],
)
def test_half_the_step_changes_less_than_the_noise(muscle):
    masses, steps = np.array([6.0, 41.0]), [commands(500e3), commands(350e3)]
    once, twice = (hang(muscle, masses, steps, 3.0, np.array([10.0, 10.0]), fine=fine) for fine in (2, 4))
    assert np.sqrt(np.mean((once.x - twice.x) ** 2)) < 0.2 * NOISE["displacement"]
    assert np.sqrt(np.mean((once.force - twice.force) ** 2)) < 0.2 * NOISE["force"]


@pytest.mark.parametrize("cause", ["creep", "several"])
def test_what_a_trial_leaves_behind_is_in_the_next_one(cause):
    """Trials one after the other, each from the state that the one before left, as they are done at a bench."""
    muscle, masses, targets = muscle_of(cause, 1.0, 3), np.array([26.0] * 4), [500e3, 350e3, 500e3, 200e3]
    steps, pauses, duration = [shorter(P) for P in targets], np.full(4, 10.0), 5.5
    together = hang(muscle, masses, steps, duration, pauses)
    t = np.arange(round(1000 * duration) + 1) / 1000
    crept, strained = np.zeros((len(muscle.times), 1)), np.zeros((len(muscle.slides), 1))
    for number, one in enumerate(steps):
        P = pressure(one, t)[:, None]
        alone, crept, strained = _advance(muscle, masses[:1], P, crept, strained, 0.0, 2)
        crept = crept * np.exp(-10.0 / np.array(muscle.times))[:, None]
        # one pass less is off by 0.4 of the noise
        assert together.x[number] == pytest.approx(alone.x[0], abs=0.1 * NOISE["displacement"])
        assert together.force[number] == pytest.approx(alone.force[0], abs=0.1 * NOISE["force"])


def shorter(target):
    """Commands of a trial that holds its pressure for 2 s and goes down every half a second."""
    first, *rest = commands(target)
    return (first, *((2.2 + 0.5 * number, P) for number, (_, P) in enumerate(rest)))


def test_the_lift_is_that_of_an_adaptive_solver():
    mass, steps = 26.0, commands(350e3)

    def slope(t, y):
        P = pressure(steps, np.array([t]))
        excess = float((pull(P) - stiffness(P) * y[0] - damping_up(P) * y[1])[0]) - mass * GRAVITY - FRICTION
        return [y[1], excess / mass]

    t = np.arange(round(2.0 * RATE)) / RATE
    P = pressure(steps, t)
    lifts = float(np.interp(mass * GRAVITY + FRICTION, pull(P[t < 1.0]), t[t < 1.0]))
    solved = solve_ivp(slope, (lifts, 2.0), [0.0, 0.0], t_eval=t[t > lifts], rtol=1e-8, atol=1e-10, max_step=0.01)
    ours = hang(Muscle(), np.array([mass]), [steps], 2.0, np.array([10.0])).x[0][: len(t)]
    moving = solved.y[1] > 1e-5
    assert ours[t > lifts][moving] == pytest.approx(solved.y[0][moving], abs=NOISE["displacement"])


def test_at_rest_the_cell_reads_the_weight_and_friction_holds():
    for trial in campaign("clean", 1.0, 1)[::7]:
        P, rest = np.array([trial.target]), slice(2000, 2500)
        x, force = float(np.mean(trial.displacement[rest])), float(np.mean(trial.force[rest]))
        assert force == pytest.approx(trial.load, abs=0.06)
        unbalanced = float(pull(P)[0] - stiffness(P)[0] * x) - trial.load
        assert 0.9 * FRICTION < unbalanced < FRICTION + 0.1
        assert float(np.mean(trial.force[:100])) == pytest.approx(0.0, abs=0.12)


def test_the_faults_have_their_size_in_the_record():
    def end(cause, seed, channel, rows=slice(0, 100)):
        whole = [getattr(trial, channel) for trial in campaign(cause, 1.0, seed)]
        return float(np.mean(whole[-1][rows]) - np.mean(whole[0][rows]))

    assert end("cell-drift", 2, "force") == pytest.approx(15.0, abs=0.5)
    assert end("cell-drift", 3, "force") == pytest.approx(-15.0, abs=0.5)
    assert end("slip-3", 2, "displacement") == pytest.approx(0.0, abs=2e-6)
    assert end("slip-3", 3, "displacement") == pytest.approx(-3e-3, abs=2e-6)
    # heaviest weight at least pressure, before and after: the muscle's mount shortens the stroke by as much
    last = [campaign(cause, 1.0, 2)[-1].displacement[2000:2500].mean() for cause in ("clean", "slip-3")]
    assert last[0] - last[1] == pytest.approx(3e-3, abs=2e-5)


def test_a_late_pressure_and_a_lagged_force_are_late_by_their_time():
    clean, late = (campaign(cause, 1.0, 1)[4] for cause in ("clean", "pressure-late"))
    rows = (clean.pressure > 50e3) & (clean.pressure < 300e3)
    rows[800:] = False
    at = np.interp(late.pressure[rows], clean.pressure[:800], clean.t[:800])
    assert np.mean(clean.t[rows] - at) == pytest.approx(FULL["pressure-late"], abs=1e-3)
    ramp = np.arange(200) / RATE
    assert (ramp - lagged(ramp, 10e-3, RATE))[-1] == pytest.approx(10e-3, rel=1e-6)


def test_each_lagged_and_late_stream_is_late_by_its_time():
    """Areas between the streams of a rise and of a fall: a filter and a delay of the same time lose the same."""
    for cause, channel in (
        ("force-late", "force"), ("pressure-lag", "pressure"), ("position-lag", "displacement"), ("tube", "displacement")
    ):  # fmt: skip
        clean, late = (getattr(campaign(one, 1.0, 1)[4], channel) for one in ("clean", cause))
        rise = slice(0, 2500) if cause != "force-late" else slice(0, 200)
        lost = float(np.sum(clean[rise] - late[rise])) / RATE
        noise = 5 * NOISE[channel] * np.sqrt(2 * 2500) / RATE
        assert lost == pytest.approx(FULL[cause] * float(clean[rise][-20:].mean()), rel=0.06, abs=noise), cause


def test_gain_and_a_wrong_mass_show_in_the_weighings_and_nowhere_else():
    for cause, seed in (("gain", 2), ("gain", 3), ("mass", 2), ("mass", 3)):
        sign, trials = 1 - 2 * (seed % 2), campaign(cause, 1.0, seed)
        clean = campaign("clean", 1.0, 2)
        readings = weighed(trials, seed, held=0.0, lying=0.0)
        lying = readings.weight == 0
        assert readings.read[lying] == pytest.approx(0.0, abs=0.15)
        if cause == "gain":
            assert readings.read[~lying] == pytest.approx(readings.weight[~lying] * (1 + sign * 0.03), abs=0.15)
            continue
        wrong = [i for i, trial in enumerate(trials) if trial.mass not in MASSES]
        assert len(wrong) == 3
        assert readings.read[~lying][wrong] == pytest.approx(
            readings.weight[~lying][wrong] * (1 + sign * 0.05), abs=0.15
        )
        off = [float(a.force[2000:2500].mean() - b.force[2000:2500].mean()) for a, b in zip(trials, clean, strict=True)]
        assert off == pytest.approx([0.0] * 24, abs=0.15)


def test_hysteresis_holds_a_weight_where_friction_and_braid_hold_it():
    """On the way up at 350 kPa, and on the way down from 500 kPa at 300 kPa."""
    trials = campaign("hysteresis", 1.0, 1)
    assert Muscle(hysteresis=30.0).gap(np.array([250e3, 500e3])) == pytest.approx([15.0, 30.0])
    for trial, P, rest, way in ((trials[7], 350e3, slice(2000, 2500), 1), (trials[8], 300e3, slice(3900, 4100), -1)):
        x, force = float(np.mean(trial.displacement[rest])), float(np.mean(trial.force[rest]))
        assert force == pytest.approx(trial.load, abs=0.1)
        unbalanced = float(pull(np.array([P]))[0] - stiffness(np.array([P]))[0] * x) - trial.load
        held = FRICTION + float(muscle_of("hysteresis", 1.0, 1).gap(np.array([P]))[0])
        assert 0.9 * held < way * unbalanced < held + 0.5


def test_creep_a_decade_is_what_its_amount_says():
    muscle = Muscle(creep=0.04 * CREEP_DECADES)
    crept = [muscle.creep * float(np.mean(-np.expm1(-t / np.array(CREEP_TIMES)))) for t in (0.8, 8.0)]
    assert crept[1] - crept[0] == pytest.approx(0.04, rel=0.05)


def test_every_case_of_a_diagnosis_has_a_cause_and_a_slip_goes_either_way():
    assert len(CASES) == 43
    assert {cause for cause, _ in CASES} < set(FULL)
    # with seeds 0 and 2 the mount of the muscle gives way to either side
    ends = [campaign("slip", 1.0, seed)[-1].displacement[2000:2500].mean() for seed in (0, 2)]
    assert ends[1] - ends[0] == pytest.approx(6e-3, abs=4e-5)


def test_creep_goes_on_under_load_and_leaves_with_it():
    trials = campaign("creep", 1.0, 1)
    held = trials[2].displacement[1000], trials[2].displacement[2500]
    assert 0.01 < held[1] / held[0] - 1 < 0.05
    assert max(abs(float(np.mean(trial.displacement[-100:]))) for trial in trials) < 1e-4


def test_truth_is_exact_where_the_muscle_is_straight_and_a_range_where_it_is_not():
    P = np.array(PRESSURES)
    for cause in (*CAUSES, "clean"):
        for symbol, of in truth(cause, 1.0, 0).items():
            low, high = of(P)
            assert (low <= high).all()
            assert (low < high).all() == (symbol == "K" and cause in ("bend", "creep"))
    low, high = truth("bend", 1.0, 0)["K"](P)
    assert (low > 0.8 * stiffness(P)).all()
    assert (high < 1.2 * stiffness(P)).all()


def test_a_bent_muscle_balances_where_its_truth_says():
    P, load = np.array(PRESSURES), 6.0 * GRAVITY
    muscle = muscle_of("bend", 1.0, 0)
    x = muscle._rest(P, load)
    assert pull(P) - stiffness(P) * x * (1 + 0.2 * (1 - x / 60e-3)) == pytest.approx(load)


def test_the_same_seed_gives_the_same_campaign_and_another_seed_another():
    one, again, other = (campaign("force-lag", 0.5, seed)[3] for seed in (4, 4, 5))
    assert np.array_equal(one.force, again.force)
    assert not np.array_equal(one.force, other.force)
    assert len(PLAN) == 24
    assert commands(350e3)[-1][1] == 0.0
    assert commands(350e3)[2][0] - commands(350e3)[1][0] == pytest.approx(RELAX)


def test_the_hanging_mass_rings_as_its_transfer_function_does():
    """S / (M s^2 + B s + K) answers a step behind a dead time and a lag, by partial fractions."""
    t = np.arange(4001) / (rung.RATE * rung.FINE)
    moved = rung._moved(t, rung._pressure(t, rung.LOW, rung.HIGH), 0.0, 0.0, 0.0)
    poles = np.array([*np.roots([rung.MASS, rung.B, rung.K]), -1 / rung.LAG])
    parts = [1 / (pole * np.prod(pole - poles[poles != pole])) for pole in poles]
    late = np.maximum(t - rung.DEAD, 0.0)
    swings = sum(part * np.exp(pole * late) for part, pole in zip(parts, poles, strict=True))
    scale = rung.S * (rung.HIGH - rung.LOW) / (rung.MASS * rung.LAG)
    exact = scale * (np.real(swings) - np.real(1 / np.prod(poles)))
    assert exact[-1] == pytest.approx(rung.WAY, rel=0.01)
    assert np.abs(moved - exact).max() < 0.2 * rung.NOISE["displacement"]


def test_the_platform_of_the_judge_has_the_ropes_that_were_printed(monkeypatch):
    """Lengths and arms at (7, -12) deg of joints and platform, 2.2: anchors on 55 mm, muscles of 200 mm, level at 10 %."""
    anchors = tilted.ANCHORS * 55 / 60
    monkeypatch.setattr(tilted, "ANCHORS", anchors)
    monkeypatch.setattr(tilted, "BASES", anchors - np.array([0.0, 0.0, 0.18])[:, None])
    monkeypatch.setattr(tilted, "HEIGHT", 0.2)
    contraction, arms = tilted._ropes(np.radians([7.0]), np.radians([-12.0]))
    assert 200 * (1 - contraction[:, 0] / 100) == pytest.approx([186.703, 166.829, 186.483], abs=1e-3)
    printed = np.array([[54.605, 0], [-25.975, 46.131], [-28.466, -46.328]])
    assert -1e3 * arms[:, :, 0].T == pytest.approx(printed, abs=1e-3)


def test_the_platform_and_the_joint_of_the_judge_hold_what_their_loops_ask_for():
    t, attitudes, _, _ = tilted._moved("clean", 1.0, 3)
    late = (t > tilted.LEVEL + tilted.HOLD - 1) & (t < tilted.LEVEL + tilted.HOLD)
    for k, goal in enumerate(np.repeat(tilted.GOALS, tilted.REPEATS, axis=0)):
        assert attitudes[:, k, late].mean(axis=1) == pytest.approx(goal, abs=np.radians(0.3))
    felt = tilted._felt("clean", 0.0, t, attitudes[:, 0], np.random.default_rng(1))
    assert np.linalg.norm(felt, axis=0)[late] == pytest.approx(tilted.G, abs=0.02)
    ends = [servo.truth("clean", 1.0, 3)["e_th", "", place][0] for place in (1.0, 2.0, 3.0)]
    assert abs(ends[0]) > np.radians(1.0), "without integral action hysteresis and another muscle leave a miss"
    assert max(map(abs, ends[1:])) < np.radians(0.5)


@pytest.mark.study
def test_half_the_step_leaves_the_joint_and_the_platform_where_they_were(monkeypatch):
    """A valve or a dead band may switch a step earlier, so that the paths are not the same, but their ends are."""
    places = ((servo, "_swung", 1, np.radians(0.15)), (tilted, "_moved", 1, np.radians(0.3)))
    for module, moved, place, near in places:
        walk = getattr(module, moved).__wrapped__
        coarse = walk("clean", 1.0, 4)[place]
        monkeypatch.setattr(module, "FINE", 0.5 * module.FINE)
        monkeypatch.setattr(module, "EVERY", 2 * getattr(module, "EVERY", 1), raising=False)
        fine = walk("clean", 1.0, 4)[place][..., ::2]
        assert np.sqrt(np.mean((fine - coarse) ** 2)) < near


def test_the_air_of_the_judge_weighs_what_a_gas_at_the_temperature_of_the_wall_weighs():
    P = np.concatenate([np.linspace(0, 4e5, 2000), np.full(2000, 4e5)])
    V = np.full(4000, 1e-4)
    mass = filled._mass(P, V, np.full(4000, filled.WARM), filled.HEAT, 0.01)
    assert mass[-1] == pytest.approx((4e5 + filled.ROOM) * 1e-4 / (filled.R_AIR * filled.WARM), rel=1e-6)
    assert float(filled.volume(0.0)) == pytest.approx(np.pi * filled.RADIUS**2 * filled.LENGTH)
    z = np.linspace(-1, 1, 200_001)
    radius = filled.RADIUS + filled.BELLY * (1 - z**2)
    barrel = np.pi * (filled.LENGTH - filled.STROKE) * np.trapezoid(radius**2, z) / 2
    assert float(filled.volume(filled.STROKE)) == pytest.approx(barrel, rel=1e-6)


def test_the_joint_of_the_judge_is_as_stiff_as_its_torque_falls():
    """Against differences of the torque, and the gap of all blocks against 4 R times their load."""
    right = pair.truth("clean", 1.0)
    at = {"pressure_1": 3e5, "pressure_2": 2e5, "angle": pair.ANGLES[4]}
    step = 1e-3
    ends = [float(pair.Joint().torque(np.array(at["angle"] + s), (3e5, 2e5))) for s in (-step, step)]
    assert right["K_th", "", pair.place(at)][0] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4)
    del at["angle"]
    gap = 2 * pair.RADIUS * (pair.load(3e5) + pair.load(2e5))
    assert right["H_tau", "", pair.place(at)][0] == pytest.approx(gap)
