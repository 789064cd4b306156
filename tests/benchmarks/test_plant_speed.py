"""How fast the simulated plant is, in processor time beside `scipy.integrate.solve_ivp` in the same process."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pmabench.model.driven import Actuator
from pmabench.model.overrides import Overrides
from pmabench.model.plant import Plant
from pmabench.model.presets import preset
from pmabench.model.regulator import constant, ramp, sine
from tests.benchmarks.least import least

LEVELS = (200e3, 400e3, 300e3, 0.0)
ALOFT = (200e3, 400e3, 300e3, 150e3)
SAMPLES = np.arange(10_000) / 500


def plant(kind="bench", force=58.86, mass=8.0, **changes):
    setup = preset("paper0", kind, Overrides(**changes))
    return Plant(setup.muscle, setup.regulator, force=force, mass=mass)


def airy(force=58.86, mass=8.0, **changes):
    """With everything: stiction, a regulator of second order, and the air that it has to move."""
    return preset("paper0-air", "bench", Overrides(**changes)).free(force=force, mass=mass)


def levels(made, pressures=LEVELS):
    """A 20 s trial of four pressures at 500 Hz."""
    parts = []
    for i, P in enumerate(pressures):
        made.command(constant(5.0 * i, P))
        parts.append(made.advance(5.0 * (i + 1), SAMPLES[2500 * i : 2500 * (i + 1)]).x)
    return np.concatenate(parts)


def closed_loop(made=None):
    """20 s of a PI loop at 500 Hz on the contraction, with stiction."""
    made, integral = made or plant(force=0.0, mass=2.0), 0.0
    for k in range(10_000):
        made.advance((k + 1) * 2e-3)
        error = 0.03 - made.reading()[0]
        integral += error * 2e-3
        made.command(constant(made.time, min(max(28.8e6 * (error + integral / 0.29), 0.0), 600e3)))
    return made.x


def waves(*commands, end):
    made = plant()
    for i, wave in enumerate(commands):
        made.command(wave)
        stop = commands[i + 1][0].start if i + 1 < len(commands) else end
        made.advance(stop, np.arange(round(made.time * 500), round(stop * 500)) / 500)
    return made.x


def stroke(name, kind):
    """20 s of a driven end at 500 Hz in blocks of 1 s, as the mock takes them."""
    made = preset(name, kind).driven(Actuator(force=9000.0, speed=1.0))
    made.command(constant(0.0, 300e3))
    made.move(sine(0.0, 0.0, 5e-3, 1.0, 20))
    for k in range(20):
        made.advance(k + 1.0, SAMPLES[500 * k : 500 * (k + 1)])
    return made.reading()


def one_by_one():
    """2 s of the driven muscle with its air, each sample a stretch of its own."""
    made = preset("daerden", "bench").driven(Actuator(force=9000.0, speed=1.0))
    made.command(constant(0.0, 300e3))
    made.move(sine(0.0, 0.0, 5e-3, 1.0, 20))
    for t in SAMPLES[1:1001].tolist():
        made.advance(t, (t,))
    return made.reading()


def hanging():
    """Paper 1's muscle on a bench: four steps of 5 s."""
    made = preset("dmsp-40-305", "bench").free(force=5.0, mass=0.5)
    return levels(made)


def peer(mass, method, rtol, atol=None):
    """The contraction by `solve_ivp`, restarted at every command, the right-hand side in plain Python like ours."""
    made = plant(mass=mass, friction=0)
    muscle, lag, force = made.muscle, made.supply.regulator.lag, made.force
    f_ce, stiffness, B_c, B_r = (curve.function() for curve in (muscle.F_ce, muscle.K, muscle.B_c, muscle.B_r))
    P0, y, parts, exp = 0.0, [0.0, 0.0], [np.zeros(20)], math.exp
    for i, level in enumerate(ALOFT):
        begin, end = 5.0 * i + 0.04, min(5.0 * (i + 1) + 0.04, 20.0)

        def rate(t, y, begin=begin, level=level, P0=P0):
            p, (x, v) = level + (P0 - level) * exp(-(t - begin) / lag), y
            pull = f_ce(p) - stiffness(p) * x - (B_c if v > 0 else B_r)(p) * v - force
            return [0.0, 0.0] if x <= 0 and v <= 0 and pull <= 0 else [v, pull / mass]

        t = SAMPLES[(SAMPLES >= begin - 1e-12) & (SAMPLES < end - 1e-12)]
        given = {"rtol": rtol, "atol": rtol * 1e-2 if atol is None else atol}
        solution = solve_ivp(rate, (begin, end), y, method=method, t_eval=np.maximum(t, begin), **given)
        assert solution.success, solution.message
        parts.append(solution.y[0])
        y, P0 = solution.y[:, -1], level + (P0 - level) * exp(-(end - begin) / lag)
    return np.concatenate(parts)


CASES = {
    # seconds that are simulated, how, how many times as fast as `solve_ivp` at least: less than half of what was seen
    "steps, ideal": (20, lambda: levels(plant("ideal", mass=0.5)), 3),
    "steps, stiction": (20, lambda: levels(plant()), 2),
    "steps, stiction, 10 g": (20, lambda: levels(plant(force=0.0, mass=0.01)), 2),
    "steps, everything": (20, lambda: levels(airy()), 1.2),
    "steps, everything, aloft": (20, lambda: levels(airy(), ALOFT), 1.2),
    "steps, everything, 10 g": (20, lambda: levels(airy(force=0.0, mass=0.01)), 1.4),
    "steps, everything but stiction": (20, lambda: levels(airy(friction=0)), 1.2),
    "steps, everything but the chamber": (20, lambda: levels(airy(conductance_fill=0.0, conductance_vent=0.0)), 1.6),
    "closed loop at 500 Hz, everything": (20, lambda: closed_loop(airy(force=0.0, mass=2.0)), 0.05),
    "ramp 2 kPa/s, stick-slip": (63, lambda: waves(constant(0, 150e3), ramp(3, 150e3, 270e3, 2e3), end=63), 1.1),
    "sine 0.5 Hz, stiction": (20, lambda: waves(constant(0, 300e3), sine(2, 300e3, 80e3, 0.5, 9), end=20), 0.6),
    "100 s stuck": (100, lambda: waves(constant(0, 50e3), end=100), 20),
    "closed loop at 500 Hz": (20, closed_loop, 0.13),
    "dmsp-40-305, steps": (20, hanging, 1.1),
    "driven, paper0": (20, lambda: stroke("paper0", "bench"), 4),
    "driven, daerden ideal": (20, lambda: stroke("daerden", "ideal"), 2.7),
    "driven, daerden with air": (20, lambda: stroke("daerden", "bench"), 0.9),
    "driven, daerden with air, sample by sample": (2, one_by_one, 0.006),
}


@pytest.fixture(scope="module")
def yardstick():
    """Processor time of `solve_ivp` for a second of a trial aloft [s]: LSODA, 8 kg, no friction, within 1e-6."""
    return least(lambda: peer(8.0, "LSODA", 1e-6))[0] / 20


@pytest.mark.parametrize("case", CASES)
def test_times_as_fast_as_solve_ivp(case, yardstick):
    seconds, run, at_least = CASES[case]
    took, _ = least(run)
    times = yardstick * seconds / took
    print(f"\n{case}: {1e3 * took:.1f} ms for {seconds} s, {times:.3g} times as fast as solve_ivp, at least {at_least}")
    assert times > at_least
