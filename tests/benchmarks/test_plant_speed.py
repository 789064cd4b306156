"""How fast the simulated plant is: real-time factors, printed, and ratios within one run. `make bench`."""

import math
import time

import numpy as np
import pytest
from scipy.integrate import solve_ivp

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


def levels(made, pressures=LEVELS):
    """A 20 s trial of four pressures at 500 Hz."""
    parts = []
    for i, P in enumerate(pressures):
        made.command(constant(5.0 * i, P))
        parts.append(made.advance(5.0 * (i + 1), SAMPLES[2500 * i : 2500 * (i + 1)]).x)
    return np.concatenate(parts)


def closed_loop():
    """20 s of a PI loop at 500 Hz on the contraction, with stiction."""
    made, integral = plant(force=0.0, mass=2.0), 0.0
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


CASES = {
    "steps, ideal": (20, lambda: levels(plant("ideal", mass=0.5))),
    "steps, stiction": (20, lambda: levels(plant())),
    "steps, stiction, 10 g": (20, lambda: levels(plant(force=0.0, mass=0.01))),
    "ramp 2 kPa/s, stick-slip": (63, lambda: waves(constant(0, 150e3), ramp(3, 150e3, 270e3, 2e3), end=63)),
    "sine 0.5 Hz, stiction": (20, lambda: waves(constant(0, 300e3), sine(2, 300e3, 80e3, 0.5, 9), end=20)),
    "100 s stuck": (100, lambda: waves(constant(0, 50e3), end=100)),
    "closed loop at 500 Hz": (20, closed_loop),
}


@pytest.mark.parametrize("case", CASES)
def test_real_time_factor(case, benchmark):
    seconds, run = CASES[case]
    benchmark.pedantic(run, rounds=3, warmup_rounds=1)
    if benchmark.stats is not None:
        best = benchmark.stats.stats.min
        print(f"\n{case}: {1e3 * best:.1f} ms for {seconds} s, {seconds / best:.0f} times real time")


def rk45(made):
    """A trial aloft without friction by solve_ivp's default method, restarted at every command too."""
    muscle, lag, P0, y, parts = made.muscle, made.supply.regulator.lag, 0.0, [0.0, 0.0], [np.zeros(20)]
    for i, level in enumerate(ALOFT):
        begin, end = 5.0 * i + 0.04, min(5.0 * (i + 1) + 0.04, 20.0)

        def P(t, begin=begin, level=level, P0=P0):
            return level + (P0 - level) * math.exp(-(t - begin) / lag)

        def rate(t, y, P=P):
            p, (x, v) = P(t), y
            damping = muscle.B_c(p) if v > 0 else muscle.B_r(p)
            pull = muscle.F_ce(p) - muscle.K(p) * x - damping * v - made.force
            if x <= 0 and v <= 0 and pull <= 0:
                return [0.0, 0.0]
            return [v, pull / made.mass]

        t = SAMPLES[(SAMPLES >= begin) & (SAMPLES < end)]
        solution = solve_ivp(rate, (begin, end), y, t_eval=t, rtol=1e-7, atol=1e-9)
        parts.append(solution.y[0])
        y, P0 = solution.y[:, -1], P(end)
    return np.concatenate(parts)


def best_of(run, times=3):
    took = []
    for _ in range(times):
        begin = time.perf_counter()
        run()
        took.append(time.perf_counter() - begin)
    return min(took)


def test_lsoda_from_event_to_event_against_rk45(request):
    """Both find the same; the ratio is printed, and asserted where benchmarks are asked for."""
    ours, theirs = levels(plant(friction=0), ALOFT), rk45(plant(friction=0))
    assert np.abs(ours - theirs).max() < 5e-6
    if not request.config.getoption("benchmark_disable"):
        ratio = best_of(lambda: rk45(plant(friction=0))) / best_of(lambda: levels(plant(friction=0), ALOFT))
        print(f"\nsolve_ivp RK45 takes {ratio:.0f} times as long")
        assert ratio > 20
