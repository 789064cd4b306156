"""Work and precision of the simulated plant beside `scipy.integrate.solve_ivp`: one trial, one machine, one table.

A trial aloft of 20 s at 500 Hz: four pressures behind 40 ms and a first-order lag, without friction, since `solve_ivp`
knows no rest. Work is processor time, so that what else the machine does counts less. `make bench` prints it.
"""

import math
import time

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pmabench.model import slip
from pmabench.model.plant import STEP
from pmabench.model.signal import constant
from tests.benchmarks.test_plant_speed import ALOFT, CASES, SAMPLES, levels, plant

MICROMETRE = 1e-6


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


def ours(mass):
    return levels(plant(mass=mass, friction=0), ALOFT)


def worked(run, times=3):
    """Least processor time of a run [s], and what it gave."""
    took = []
    for _ in range(times):
        begin = time.process_time()
        found = run()
        took.append(time.process_time() - begin)
    return min(took), found


@pytest.mark.parametrize(("mass", "method"), [(8.0, "DOP853"), (1.0, "LSODA"), (0.1, "LSODA"), (0.01, "LSODA")])
def test_the_plant_is_within_a_micrometre_at_every_mass(mass, method):
    found, reference = ours(mass), peer(mass, method, 1e-11, 1e-14)
    assert np.isfinite(found).all()
    assert np.ptp(reference) > 0.02, "it moves"
    assert np.abs(found - reference).max() < 0.25 * MICROMETRE


def test_a_closed_loop_has_no_nan_at_ten_grams():
    made = plant(force=0.0, mass=0.01)
    for k in range(1000):
        made.advance((k + 1) * 2e-3)
        x = made.reading()[0]
        assert 0 <= x <= made.muscle.stop
        made.command(constant(made.time, 300e3 if x < 0.03 else 0.0))
    assert made.x > 0.02


def closed_loop(longest):
    """Contraction [m] of 4 s of a PI loop at 500 Hz with stiction, the plant in steps of at most `longest` [s]."""
    made, integral, x = plant(force=0.0, mass=2.0), 0.0, []
    for k in range(2000):
        made.reach((k + 1) * 2e-3, longest)
        error = (0.03 if k < 1200 else 0.01) - made.x
        integral += error * 2e-3
        made.command(constant(made.time, min(max(28.8e6 * (error + integral / 0.29), 0.0), 600e3)))
        x.append(made.x)
    return np.array(x)


def test_one_step_a_sample_is_enough_in_a_closed_loop():
    found, fine = closed_loop(STEP), closed_loop(5e-5)
    assert np.ptp(fine) > 0.02, "it moves both ways"
    assert np.abs(found - fine).max() < 1.5 * MICROMETRE
    assert np.abs(closed_loop(STEP / 4) - fine).max() < 0.1 * MICROMETRE, "a quarter of the step, a sixteenth of it"


def test_work_and_precision_beside_solve_ivp(request, monkeypatch):
    """The table; what is asserted holds within one run, and of time only where benchmarks are asked for."""
    timed = request.config.getoption("benchmark_enable")
    reference = peer(8.0, "DOP853", 1e-12, 1e-15)
    rows = []
    for rtol in (1e-5, 1e-6, 1e-7, 1e-9) if timed else (1e-7,):
        monkeypatch.setattr(slip, "RELATIVE", rtol)
        monkeypatch.setattr(slip, "ABSOLUTE", rtol * 5e-2)
        rows.append((f"plant{' (as shipped)' if rtol == 1e-7 else ''}", rtol, *worked(lambda: ours(8.0))))
    for method in ("LSODA", "RK45"):
        for rtol in (1e-4, 1e-6, 1e-8) if timed else (1e-6,):
            rows.append((f"solve_ivp {method}", rtol, *worked(lambda m=method, r=rtol: peer(8.0, m, r))))
    print("\n\nmethod                  rtol   ms / 20 s   times real time   error nm")
    table = {}
    for name, rtol, took, found in rows:
        error = np.abs(found - reference).max()
        table[name, rtol] = took, error
        print(f"{name:22} {rtol:6.0e} {1e3 * took:10.1f} {20 / took:16.0f} {1e9 * error:10.1f}")
    took, error = table["plant (as shipped)", 1e-7]
    assert error < MICROMETRE
    for method in ("LSODA", "RK45"):
        exact = [t for (name, _), (t, e) in table.items() if name == f"solve_ivp {method}" and e < MICROMETRE]
        assert exact or timed
        assert not timed or not exact or min(exact) > 3 * took, f"{method} is as good"


LEAST = {
    "steps, stiction": 2000,
    "steps, everything": 2000,
    "steps, everything, 10 g": 2000,
    "closed loop at 500 Hz, everything": 80,
    "ramp 2 kPa/s, stick-slip": 1200,
    "sine 0.5 Hz, stiction": 800,
    "dmsp-40-305, steps": 1200,
    "driven, daerden with air": 800,
    "closed loop at 500 Hz": 100,
}
"""Times real time; what a slow machine reaches."""


@pytest.mark.parametrize(("case", "least"), LEAST.items())
def test_times_real_time(request, case, least):
    timed = request.config.getoption("benchmark_enable")
    seconds, run = CASES[case]
    took, _ = worked(run, 5 if timed else 1)
    print(f"\n{case}: {seconds / took:.0f} times real time in processor time")
    assert not timed or seconds / took > least
