"""How fast the simulated plant is: real-time factors in processor time, printed. `make bench`."""

import time

import numpy as np
import pytest

from pmabench.model.driven import Actuator
from pmabench.model.overrides import Overrides
from pmabench.model.plant import Plant
from pmabench.model.presets import preset
from pmabench.model.signal import constant, ramp, sine

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


CASES = {
    "steps, ideal": (20, lambda: levels(plant("ideal", mass=0.5))),
    "steps, stiction": (20, lambda: levels(plant())),
    "steps, stiction, 10 g": (20, lambda: levels(plant(force=0.0, mass=0.01))),
    "steps, everything": (20, lambda: levels(airy())),
    "steps, everything, aloft": (20, lambda: levels(airy(), ALOFT)),
    "steps, everything, 10 g": (20, lambda: levels(airy(force=0.0, mass=0.01))),
    "steps, everything but stiction": (20, lambda: levels(airy(friction=0))),
    "steps, everything but the chamber": (20, lambda: levels(airy(conductance_fill=0.0, conductance_vent=0.0))),
    "closed loop at 500 Hz, everything": (20, lambda: closed_loop(airy(force=0.0, mass=2.0))),
    "ramp 2 kPa/s, stick-slip": (63, lambda: waves(constant(0, 150e3), ramp(3, 150e3, 270e3, 2e3), end=63)),
    "sine 0.5 Hz, stiction": (20, lambda: waves(constant(0, 300e3), sine(2, 300e3, 80e3, 0.5, 9), end=20)),
    "100 s stuck": (100, lambda: waves(constant(0, 50e3), end=100)),
    "closed loop at 500 Hz": (20, closed_loop),
    "dmsp-40-305, steps": (20, hanging),
    "driven, paper0": (20, lambda: stroke("paper0", "bench")),
    "driven, daerden ideal": (20, lambda: stroke("daerden", "ideal")),
    "driven, daerden with air": (20, lambda: stroke("daerden", "bench")),
    "driven, daerden with air, sample by sample": (2, one_by_one),
}


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize("case", CASES)
def test_real_time_factor(case, benchmark):
    seconds, run = CASES[case]
    benchmark.pedantic(run, rounds=7, warmup_rounds=1)
    if benchmark.stats is not None:
        best = benchmark.stats.stats.min
        print(f"\n{case}: {1e3 * best:.1f} ms for {seconds} s, {seconds / best:.0f} times real time")
