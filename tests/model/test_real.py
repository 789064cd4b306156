"""Plant `real` at its driven end against printed numbers (docs/plants.md, worked out apart from the code)."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pmabench.model.curve import Curve
from pmabench.model.driven import Actuator
from pmabench.model.overrides import Overrides
from pmabench.model.presets import preset
from pmabench.model.real.muscle import Creep, Stops, reference
from pmabench.model.real.plants import RealDrivenPlant
from pmabench.model.regulator import Regulator, Wave, constant, ramp, sine

SURFACE = {
    100: ([249.1, 43.8], [34.52, 11.52, 5.48]),
    200: ([503.0, 272.7, 163.2, 85.4, 16.1], [36.35, 14.45, 8.69, 7.18, 6.78, 6.68]),
    300: ([756.8, 501.5, 361.0, 250.6, 148.2, 47.9], [38.18, 17.38, 11.91, 10.47, 10.09, 10.00]),
    400: ([1010.7, 730.4, 558.8, 415.8, 280.4, 146.9], [40.01, 20.31, 15.13, 13.77, 13.41, 13.31]),
    500: ([1264.6, 959.3, 756.7, 581.0, 412.5, 245.8], [41.84, 23.24, 18.34, 17.06, 16.72, 16.63]),
    600: ([1518.4, 1188.1, 954.5, 746.2, 544.6, 344.8], [43.67, 26.16, 21.56, 20.35, 20.03, 19.95]),
}
"""F_s [N] where it pulls and K [N/mm] at 0, 10, ... mm, over P [kPa]."""
LOOPS = {
    (5, 200): (24.00, 0.178), (10, 200): (25.51, 0.442), (20, 200): (30.00, 1.042),
    (5, 500): (48.01, 0.356), (10, 500): (51.02, 0.884), (20, 500): (60.00, 2.084),
}  # fmt: skip
"""Amplitude [mm], P [kPa]: gap at the centre [N] and area [J] of the second cycle, without creep and damping."""
AREAS_OF_1_MM = {200: 0.013, 500: 0.026}
NO_DELAY = Regulator(dead_time=0.0)
NO_DAMPING = Curve(((0.0,),))
FAST = Actuator(low=-7e-3, high=70e-3, speed=10.0, force=5000.0)


def muscle(*, loops_x=0.0, loops_p=0.0, creep=0.0, **changes):
    """The reference without damping, its departures times the given factors."""
    given = reference()
    return replace(
        given,
        B_c=NO_DAMPING,
        B_r=NO_DAMPING,
        over_x=given.over_x.scaled(loops_x),
        over_P=given.over_P.scaled(loops_p),
        creep=replace(given.creep, share=creep * given.creep.share),
        **changes,
    )


def plant(of, kPa=0.0, mm=0.0):
    return RealDrivenPlant(of, NO_DELAY, FAST, pressure=1e3 * kPa, position=1e-3 * mm)


@pytest.mark.parametrize("kPa", SURFACE)
def test_force_and_stiffness_while_it_moves_slowly_through_the_table(kPa):
    moving = plant(muscle(), kPa)
    moving.move(ramp(0.0, 0.0, 51e-3, 1e-3))
    forces, stiffnesses = SURFACE[kPa]
    t = np.arange(0.0, 51.0, 0.01)
    motion = moving.advance(51.0, t)
    for i, force in enumerate(forces):
        assert motion.F[1000 * i] == pytest.approx(force, abs=0.1)
        slope = -(motion.F[1000 * i + 10] - motion.F[max(1000 * i - 10, 0)]) / (0.2 if i else 0.1)
        if i:
            assert slope == pytest.approx(stiffnesses[i], abs=0.01)
    assert np.all(motion.F >= 0)


@pytest.mark.parametrize("kPa", SURFACE)
def test_tangent_stiffness_of_the_table(kPa):
    given = reference()
    stiffnesses = SURFACE[kPa][1]
    x = 1e-2 * np.arange(len(stiffnesses))
    K = given.stiffness(np.full(x.shape, 1e3 * kPa), x)
    assert K / 1e3 == pytest.approx(stiffnesses, abs=0.01)


def looped(mm, kPa, centre=17.0, cycles=2):
    """Contraction [mm] and force [N] of the last of slow cycles about a centre."""
    turning = plant(muscle(loops_x=1.0), kPa, centre)
    turning.move(sine(0.0, centre * 1e-3, mm * 1e-3, 0.1, cycles))
    t = np.linspace(10.0 * (cycles - 1), 10.0 * cycles, 4001)
    motion = turning.advance(t[-1], t)
    return 1e3 * motion.x, motion.F


@pytest.mark.parametrize(("mm", "kPa"), LOOPS)
def test_gap_and_area_of_the_second_cycle(mm, kPa):
    gap, area = LOOPS[mm, kPa]
    x, F = looped(mm, kPa)
    assert F[2000] - F[4000] == pytest.approx(gap, abs=0.1)
    assert -np.trapezoid(F, x) / 1e3 == pytest.approx(area, rel=0.01)


@pytest.mark.parametrize("kPa", AREAS_OF_1_MM)
def test_area_of_a_small_loop(kPa):
    x, F = looped(1, kPa)
    assert -np.trapezoid(F, x) / 1e3 == pytest.approx(AREAS_OF_1_MM[kPa], abs=0.0005)


def test_a_loop_does_not_depend_on_its_centre():
    """2 H (0.2 + 0.3 + 0.3) at 400 kPa, by hand."""
    for centre in (10.0, 30.0):
        _, F = looped(5, 400, centre)
        assert F[2000] - F[4000] == pytest.approx(2 * 25.0 * 0.8, abs=0.05)


def test_isometric_loop_over_pressure():
    """36 N apart, half way up and down between 0 and 600 kPa: both stops are at their ends."""
    held = plant(muscle(loops_p=1.0), 0.0)
    held.command((Wave(0.0, 0.0, slope=10e3), Wave(60.0, 600e3, slope=-10e3), Wave(120.0, 0.0)))
    F = held.advance(120.0, np.array([0.0, 30.0, 90.0])).F
    assert F[0] == pytest.approx(18.0 - 4.7, abs=0.01)
    assert F[2] - F[1] == pytest.approx(36.0, abs=0.01)


def test_creep_after_a_step_of_the_driven_end():
    """x_c = 0.004 x sum (1 - exp(-t / T)) after a step, and the force that it gives back: K x_c."""
    stepped = plant(muscle(creep=1.0), 400.0)
    stepped.move(constant(0.0, 20e-3))
    t = np.array([0.1, 1.0, 10.0, 100.0])
    F = stepped.advance(100.0, t).F
    for i, moment in enumerate(t):
        crept = 0.004 * 20.0 * sum(1 - math.exp(-moment / T) for T in (0.5, 1.58, 5.0, 15.8, 50.0, 158.0))
        kappa = (20.0 - crept) / 2.5
        force = (244.7 - 0.1115 * 400) * math.exp(-0.334 * kappa) - 0.0830 * kappa * 400 + 2.650 * 400 - 249.4
        assert F[i] == pytest.approx(force, abs=0.1)


COURSE = (
    Wave(0.0, 10e-3),
    Wave(1.0, 10e-3, amplitude=8e-3, omega=7.0),
    Wave(4.0, 20e-3),
    Wave(5.0, 20e-3, slope=-3e-3),
)
PRESSURES = (Wave(0.5, 300e3), Wave(2.0, 350e3, amplitude=90e3, omega=3.0), Wave(4.5, 120e3))


def wandering():
    """A bench-like plant on an irregular way: follow error, filling against venting."""
    of = replace(reference(), over_x=replace(reference().over_x, extra=0.6))
    regulator = Regulator(dead_time=0.02, lag=0.0955, vent_ratio=1.5)
    made = RealDrivenPlant(of, regulator, replace(FAST, lag=0.005, speed=0.5))
    made.move(COURSE)
    made.command(PRESSURES)
    return made


def test_samples_do_not_depend_on_how_time_is_cut_nor_on_each_other():
    t = np.arange(0.0, 8.0, 0.002)
    whole = wandering().advance(8.0, t)
    sparse = wandering().advance(8.0, t[::50])
    assert sparse.F == pytest.approx(whole.F[::50], abs=1e-6)
    cut = wandering()
    pieces = [cut.advance(float(t[i + 250]) - 7e-4, t[i : i + 250]).F for i in range(0, 3750, 250)]
    assert np.concatenate(pieces) == pytest.approx(whole.F[:3750], abs=1e-6)


def test_the_driven_force_is_that_of_the_equation_stepped_finely():
    """The same equation as a plain loop of 0.25 ms over the plant's own x and P, without any of its parts."""
    dt = 2.5e-4
    t = np.arange(0.0, 8.0, dt)
    motion = wandering().advance(8.0, t)
    radii, weights, S = np.array([0.2, 0.8, 2.5, 8.0]), np.array([0.2, 0.3, 0.3, 0.2]), np.zeros(4)
    rho, q, S_P = np.array([20.0, 100.0]), np.array([0.4, 0.6]), np.array([-20.0, -100.0])
    T, crept, gone = np.array([0.5, 1.58, 5.0, 15.8, 50.0, 158.0]), np.zeros(6), 0.0
    x, P, v = 1e3 * motion.x, motion.P / 1e3, 1e3 * motion.v
    F = np.zeros(t.shape)
    for i in range(len(t)):
        if i:
            S = np.minimum(radii, np.maximum(-radii, S + x[i] - x[i - 1]))
            S_P = np.minimum(rho, np.maximum(-rho, S_P + P[i] - P[i - 1]))
            crept += dt * (0.004 * 0.5 * (x[i] + x[i - 1]) - crept) / T
            gone += abs(x[i] - x[i - 1])
        kappa = (x[i] - crept.sum()) / 2.5
        F[i] = (244.7 - 0.1115 * P[i]) * math.exp(-0.334 * kappa) - 0.0830 * kappa * P[i] + 2.650 * P[i] - 249.4
        F[i] -= (5 + 0.05 * P[i]) * (1 + 0.6 * math.exp(-gone / 80.0)) * (weights * S / radii).sum()
        F[i] -= 18.0 * (q * S_P / rho).sum()
        F[i] -= (1.0 + 0.002 * P[i] if v[i] > 0 else 0.7 + 0.0015 * P[i]) * v[i]
    assert motion.F == pytest.approx(np.maximum(F, 0.0), abs=0.05)


def test_a_muscle_without_history_is_straight_lines_over_pressure():
    """Bend, stops and creep off: F_ce as before, K the secant from 0 to 40 mm of the table."""
    straight = muscle(surface=replace(reference().surface, bend=0.0))
    for kPa, secant in ((300, (756.8 - 148.2) / 40), (500, (1264.6 - 412.5) / 40)):
        held = plant(straight, kPa)
        held.move(ramp(0.0, 0.0, 40e-3, 10e-3))
        F = held.advance(4.0, np.array([0.0, 1.0, 2.0, 4.0])).F
        expected = SURFACE[kPa][0][0] - secant * np.array([0.0, 10.0, 20.0, 40.0])
        assert F == pytest.approx(expected, abs=0.1)


OFF = {"hysteresis_x": 0.0, "hysteresis_p": 0.0, "creep": 0.0, "bend": 0.0}


def held_and_moved(off):
    """Forces [N] at 300 kPa: at 20 mm from below at once and after 100 s, and from above."""
    setup = preset("real", "ideal", Overrides(**off))
    plant = setup.driven(FAST)
    plant.command(constant(0.0, 300e3))
    plant.move((*constant(1.0, 20e-3), *constant(101.0, 50e-3), *constant(101.5, 20e-3)))
    return plant.advance(102.0, np.array([1.01, 100.9, 102.0])).F


def test_each_departure_is_switched_off_singly():
    """At 300 kPa and 20 mm, by hand: F_s 361.0 N, H 20 N, H_P 18 N, K 11.91 N/mm times what has crept by 0.01 s."""
    straight = 756.8 - 20 * (756.8 - 148.2) / 40
    crept = 0.004 * 20.0 * sum(1 - math.exp(-0.01 / T) for T in (0.5, 1.58, 5.0, 15.8, 50.0, 158.0)) * 11.91
    whole = held_and_moved({})
    assert whole[0] == pytest.approx(361.0 - 20 - 18 + crept, abs=0.1)
    without_x, without_P, without_creep, without_bend = (held_and_moved({name: 0.0}) for name in OFF)
    assert without_x[0] - whole[0] == pytest.approx(20.0, abs=0.01)
    assert without_P[0] - whole[0] == pytest.approx(18.0, abs=0.01)
    assert without_creep[1] - without_creep[0] == pytest.approx(0.0, abs=0.001)
    assert without_creep[2] - without_creep[0] == pytest.approx(40.0, abs=0.01)
    assert without_bend[0] - whole[0] == pytest.approx(straight - 361.0, abs=0.2)
    assert whole[1] - whole[0] > 3.0
    assert held_and_moved(OFF) == pytest.approx([straight] * 3, abs=0.1)
    assert held_and_moved({"friction": 0.0})[0] == pytest.approx(361.0 + crept, abs=0.1)


def test_the_first_cycle_is_wider_and_fades_with_the_way_gone():
    """1.6 H after a rest, and 1 + 0.6 / e of it after 80 mm."""
    first = held_and_moved({"creep": 0.0, "hysteresis_p": 0.0, "first_cycle": 0.6})
    bare = held_and_moved({"creep": 0.0, "hysteresis_p": 0.0, "hysteresis_x": 0.0})
    assert bare[0] - first[0] == pytest.approx(20.0 * (1 + 0.6 * math.exp(-20 / 80)), abs=0.01)
    assert first[2] - bare[2] == pytest.approx(20.0 * (1 + 0.6 / math.e), abs=0.01)


@pytest.mark.parametrize("change", [{"F_c": 3.0}, {"hysteresis_x": -1.0}, {"creep": 60.0}, {"hysteresis": 3.0}])
def test_changes_that_it_cannot_take_are_refused(change):
    with pytest.raises(ValueError, match=r"real|negative|less than 1"):
        preset("real", "bench", Overrides(**change))


@pytest.mark.parametrize("name", OFF)
def test_other_plants_have_no_such_departure(name):
    with pytest.raises(ValueError, match="it is for the plant real"):
        preset("paper0", "bench", Overrides(**{name: 0.0}))


def test_a_snapshot_brings_stops_and_creep_back():
    made = wandering()
    made.advance(2.5)
    kept = made.snapshot()
    t = np.arange(2.5, 6.0, 0.01)
    first = made.advance(6.0, t).F
    made.restore(kept)
    assert made.advance(6.0, t).F == pytest.approx(first, abs=1e-9)
    assert made.time == 6.0


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Stops((1e-3,), (0.5,), 5.0),
        lambda: Stops((0.0,), (1.0,), 5.0),
        lambda: Stops((1e-3, 2e-3), (1.0,), 5.0),
        lambda: Creep(0.5, (1.0, 2.0)),
        lambda: Creep(0.1, (0.0,)),
        lambda: reference().over_x.scaled(-1.0),
        lambda: replace(reference(), reach=(0.1, 0.2)),
    ],
)
def test_impossible_parameters_are_refused(wrong):
    with pytest.raises(ValueError, match=r"\d"):
        wrong()
