"""Plant `real` with a load on its free end: printed creep, and the same equation written anew."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from pmabench.model.curve import Curve
from pmabench.model.motion import shares
from pmabench.model.plant import Plant
from pmabench.model.presets import paper0
from pmabench.model.real import plants as free
from pmabench.model.real.muscle import Surface, reference
from pmabench.model.real.plants import RealPlant
from pmabench.model.regulator import Regulator, Wave, constant, sine

BENCH = Regulator(dead_time=0.02, lag=0.0955, vent_ratio=1.5)
CREPT = {
    (300, 200): (34.899, {1: 35.124, 3: 35.258, 10: 35.405, 30: 35.534, 100: 35.659}),
    (500, 400): (40.748, {1: 41.011, 3: 41.167, 10: 41.338, 30: 41.489, 100: 41.635}),
}
"""P [kPa], load [N]: x [mm] at once and after so many seconds, hysteresis, damping and regulator off."""


def without(*, loops=0.0, creep=0.0, damping=None, **changes):
    given = reference()
    curves = {} if damping is None else {"B_c": Curve(((damping,),)), "B_r": Curve(((damping,),))}
    return replace(
        given,
        over_x=given.over_x.scaled(loops),
        over_P=given.over_P.scaled(loops),
        creep=replace(given.creep, share=creep * given.creep.share),
        **curves,
        **changes,
    )


@pytest.mark.parametrize(("kPa", "load"), CREPT)
def test_creep_under_a_held_load(kPa, load):
    """The damping is a tenth of the muscle's: the load is where it comes to within 10 ms."""
    at_once, later = CREPT[kPa, load]
    ideal = Regulator(dead_time=0.0)
    still = RealPlant(without(damping=100.0), ideal, force=load, mass=1e-3)
    still.command(constant(0.0, 1e3 * kPa))
    assert 1e3 * still.advance(1.0, np.array([1.0])).x[0] == pytest.approx(at_once, abs=0.001)
    plant = RealPlant(without(creep=1.0, damping=100.0), ideal, force=load, mass=1e-3)
    plant.command(constant(0.0, 1e3 * kPa))
    x = 1e3 * plant.advance(100.0, np.array(sorted(later), dtype=float)).x
    assert x == pytest.approx([later[t] for t in sorted(later)], abs=0.005)


RADII, WEIGHTS = np.array([0.2, 0.8, 2.5, 8.0]), np.array([0.2, 0.3, 0.3, 0.2])
TAUS = np.array([0.5, 1.58, 5.0, 15.8, 50.0, 158.0])
VENT_AT = 4.0


def pressure(t):
    """kPa: 400 behind 20 ms and a lag of 95.5 ms, from 4 s on vented with 143.25 ms."""
    filled = 400 * -math.expm1(-min(max(t - 0.02, 0.0), VENT_AT) / 0.0955)
    return filled * math.exp(-max(t - VENT_AT - 0.02, 0.0) / 0.14325)


def over_pressure(t):
    """Sum q S / rho of a filling and then a venting, in closed form."""
    P = pressure(t)
    if t <= VENT_AT + 0.02:
        S = [min(rho, P - rho) for rho in (20.0, 100.0)]
    else:
        S = [max(-rho, P - 400 + rho) for rho in (20.0, 100.0)]
    return 0.4 * S[0] / 20 + 0.6 * S[1] / 100


def static(x, crept, S, t):
    """Force without damping [N]; x, crept [mm]."""
    P, kappa = pressure(t), (x - crept) / 2.5
    force = (244.7 - 0.1115 * P) * math.exp(-0.334 * kappa) - 0.0830 * kappa * P + 2.650 * P - 249.4
    return force - (5 + 0.05 * P) * float(WEIGHTS @ (S / RADII)) - 18.0 * over_pressure(t)


def viscous(v, t):
    """Force of the damping [N] at v [mm/s]."""
    return (1.0 + 0.002 * pressure(t) if v > 0 else 0.7 + 0.0015 * pressure(t)) * v


def rates(t, y, load, mass):
    """x [mm], v [mm/s], four stops [mm], six creeping lengths [mm]."""
    x, v, S, lengths = y[0], y[1], y[2:6], y[6:]
    net = static(x, lengths.sum(), S, t) - viscous(v, t) - load
    slides = ((S >= RADII) & (v > 0)) | ((S <= -RADII) & (v < 0))
    return np.concatenate(([v, 1e3 * net / mass], np.where(slides, 0.0, v), (0.004 * x - lengths) / TAUS))


def independent(load, mass, until):
    """The motion from where the load leaves its support; its interpolant, and that moment."""
    nothing = np.zeros(4)
    lift = brentq(lambda t: static(0.0, 0.0, nothing, t) - load, 0.021, 1.0, xtol=1e-12)
    found, begin, y = [], lift, np.zeros(12)
    for end in (VENT_AT + 0.02, until):
        part = solve_ivp(
            rates, (begin, end), y, "LSODA", args=(load, mass), rtol=1e-8, atol=1e-8, max_step=1e-3, dense_output=True
        )
        found.append((end, part.sol))
        begin, y = end, part.y[:, -1]
    return lift, lambda t: next(motion(t) for end, motion in found if t <= end)


@pytest.mark.parametrize("kg", [26.0])
def test_a_step_of_400_kPa_and_back_is_the_equation_solved_by_another_program(kg):
    load, mass = kg * 9.81, kg + 2.0
    plant = RealPlant(reference(), BENCH, force=load, mass=mass)
    plant.command((Wave(0.0, 400e3), Wave(VENT_AT, 0.0)))
    t = np.arange(0.0, 4.9, 0.002)
    motion = plant.advance(4.9, t)
    lift, solution = independent(load, mass, 4.4)
    on_support = t < lift
    assert np.all(motion.x[on_support] == 0.0)
    assert np.all(motion.x[t > 4.8] == 0.0)
    for i in np.flatnonzero((t > lift) & (t < 4.4))[::25]:
        y = solution(t[i])
        x, v, S, crept = y[0], y[1], np.clip(y[2:6], -RADII, RADII), y[6:].sum()
        if x < 0.3:
            continue
        assert 1e3 * motion.x[i] == pytest.approx(x, abs=1e-3)
        assert motion.F[i] == pytest.approx(static(x, crept, S, t[i]) - viscous(v, t[i]), abs=0.1)


def test_with_straight_lines_it_moves_as_the_three_element_plant():
    """F_ce = 1.08 P - 49, K = 0.025 P N/mm, as a surface without bend: the plant that LSODA integrates."""
    damping = {"B_c": Curve.printed((1.2, 1.6e-3), unit=1e3), "B_r": Curve.printed((1.1, 3.4e-3), unit=1e3)}
    straight = Surface(A=0.0, A_P=0.0, s=1.0, C=-0.25 * 0.025, D=1.08e-3, E=-49.0, bend=0.0)
    lines = {"F_ce": Curve.printed((-49.0, 1.08)), "K": Curve.printed((0.0, 0.025), unit=1e3)}
    load = {"force": 120.0, "mass": 14.0, "pressure": 1e3}
    t = np.arange(0.0, 8.0, 0.01)
    made = []
    for plant in (
        RealPlant(replace(without(surface=straight), **damping), BENCH, **load),
        Plant(replace(paper0(), **lines, **damping), BENCH, **load),
    ):
        plant.command((*sine(0.5, 300e3, 80e3, 0.8, 4.0), Wave(6.0, 0.0)))
        made.append(plant.advance(8.0, t))
    assert np.ptp(made[1].x) > 20e-3
    assert made[0].x == pytest.approx(made[1].x, abs=2e-6)
    assert made[0].F == pytest.approx(np.maximum(made[1].F, 0.0), abs=0.05)


def lifted(load=255.06, mass=28.0):
    plant = RealPlant(reference(), BENCH, force=load, mass=mass)
    plant.command((Wave(0.1, 400e3), Wave(2.0, 250e3, amplitude=60e3, omega=9.0), Wave(4.0, 0.0)))
    return plant


T = np.arange(0.0, 6.0, 0.002)


@pytest.mark.parametrize(
    ("load", "mass"),
    [
        (255.06, 28.0),
        (0.0, 0.01),
        pytest.param(60.0, 0.5, marks=pytest.mark.study),
        pytest.param(490.5, 52.0, marks=pytest.mark.study),
    ],
)
def test_half_the_step_and_other_cuts_change_less_than_the_noise(load, mass, monkeypatch):
    whole = lifted(load, mass).advance(6.0, T)
    cut = lifted(load, mass)
    for i in range(0, 3000, 100):
        cut.advance(float(T[i]) + 1.3e-3)
    sparse = lifted(load, mass).advance(6.0, T[::50])
    assert cut.advance(6.0, T[-1:]).x[-1] == pytest.approx(whole.x[-1], abs=5e-7)
    assert sparse.x == pytest.approx(whole.x[::50], abs=5e-7)
    monkeypatch.setattr(free, "BEND", free.BEND / 4)
    monkeypatch.setattr(free, "SHORTEST", free.SHORTEST / 2)
    monkeypatch.setattr(free, "LOOK", free.LOOK / 2)
    finer = lifted(load, mass).advance(6.0, T)
    assert finer.x == pytest.approx(whole.x, abs=1e-6)
    assert np.sqrt(np.mean((finer.F - whole.F) ** 2)) < 0.05


def test_creep_outlasts_a_trial_and_stops_remember():
    plant = RealPlant(reference(), BENCH, force=200.0, mass=22.0)
    forces = []
    for trial in range(2):
        begin = 60.0 * trial
        plant.command((Wave(begin, 400e3), Wave(begin + 50.0, 0.0)))
        motion = plant.advance(begin + 60.0, np.array([begin, begin + 2.0, begin + 55.0]))
        forces.append(motion)
    assert [motion.x[2] for motion in forces] == [0.0, 0.0]
    assert forces[0].F[0] == pytest.approx(18.0 - 4.7, abs=0.01)
    # at rest after a contraction: both kinds of stops pull back to the load, and the crept length is still there
    assert forces[1].F[0] > 18.0 - 4.7 + 5.0
    assert forces[1].x[1] > forces[0].x[1] + 5e-5


def test_a_snapshot_brings_everything_back():
    plant = lifted()
    plant.advance(1.0)
    kept = plant.snapshot()
    first = plant.advance(3.0, T[500:1500])
    plant.restore(kept)
    again = plant.advance(3.0, T[500:1500])
    assert np.array_equal(first.x, again.x)
    assert np.array_equal(first.F, again.F)


def test_a_long_rest_costs_little_however_often_it_is_sampled():
    plant = lifted()
    plant.advance(10.0)
    steps = []
    plant._step = lambda h, P: (steps.append(h), RealPlant._step(plant, h, P))[1]
    plant.advance(3610.0, np.arange(10.0, 3610.0, 0.01))
    assert len(steps) < 20_000


@pytest.mark.parametrize("seed", range(6))
def test_however_it_lands_it_takes_steps_that_come_to_an_end(seed):
    """Loads that leave and land again and again, at both stops: no step is a vanishing share of the one before it."""
    chance = np.random.default_rng(seed)
    mass = float(10 ** chance.uniform(-2, 1.7))
    plant = RealPlant(reference(), BENCH, force=float(chance.choice([0.0, 0.3, 1.0])) * mass * 9.81, mass=mass)
    steps = []

    def counted(h, P):
        steps.append(h)
        assert len(steps) < 40_000
        return RealPlant._step(plant, h, P)

    plant._step = counted
    for t in np.arange(0.0, 10.0, 0.5):
        plant.command((Wave(float(t), float(chance.choice([0.0, 20e3, 250e3, 650e3]))),))
        motion = plant.advance(float(t) + 0.5, np.linspace(t, t + 0.5, 51)[1:])
        assert np.all((motion.x >= 0) & (motion.x <= plant.muscle.stop))


@pytest.mark.parametrize("above", [5e-15, 3e-10, 1e-7, 1e-5])
def test_a_load_that_lands_is_on_its_support_within_one_step_and_does_not_come_nearer_for_ever(above):
    plant = RealPlant(reference(), BENCH, force=127.5, mass=13.0)
    plant.x, plant.v = above, -0.078
    steps = plant._steps(0.01)
    next(steps)
    while plant.x == above:
        next(steps)
    assert (plant.x, plant.v < 0) == (0.0, True)
    next(steps)
    assert (plant.x, plant.v) == (0.0, 0.0)


def test_without_load_it_goes_back_by_its_rubber_and_the_cell_reads_no_push():
    plant = RealPlant(reference(), BENCH, force=0.0, mass=0.5)
    plant.command((Wave(0.0, 300e3), Wave(3.0, 0.0)))
    motion = plant.advance(10.0, np.arange(0.0, 10.0, 0.01))
    assert 1e3 * motion.x.max() == pytest.approx(54.8 - (20 + 18) / 10 + 0.6, abs=0.5)
    assert motion.x[-1] < 1e-3
    assert np.all(motion.F >= 0.0)


@pytest.mark.parametrize("z", [0.0, 1e-12, 1e-5, 0.0099, 0.0101, 0.5, 30.0, 1e6])
def test_shares_of_a_step_are_the_integrals_that_they_stand_for(z):
    """phi_n = integral of exp(-z (1 - u)) u^(n - 1) / (n - 1)! over 0..1, by Gauss-Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    edges = np.unique([0.0, max(0.0, 1 - 50 / max(z, 50.0)), 1.0])
    for n, share in enumerate(shares(z)):
        total = 0.0
        for low, high in itertools.pairwise(edges):
            u = low + (high - low) * (nodes + 1) / 2
            total += (high - low) / 2 * float(weights @ (np.exp(-z * (1 - u)) * u**n / math.factorial(n)))
        assert share == pytest.approx(total, rel=1e-7)


def test_a_load_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match="mass above 0"):
        lifted().load(10.0, 0.0)
