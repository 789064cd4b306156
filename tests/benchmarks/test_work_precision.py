"""Work and precision of the simulated plant beside `scipy.integrate.solve_ivp`: one trial, one machine, one table.

A trial aloft of 20 s at 500 Hz: four pressures behind 40 ms and a first-order lag, without friction, since `solve_ivp`
knows no rest. Work is processor time, so that what else the machine does counts less. `make bench` prints it.
"""

import numpy as np
import pytest

from pmabench.model import plant as module
from pmabench.model.plant import STEP
from pmabench.model.regulator import constant
from tests.benchmarks.least import least
from tests.benchmarks.test_plant_speed import ALOFT, levels, peer, plant

MICROMETRE = 1e-6


def ours(mass):
    return levels(plant(mass=mass, friction=0), ALOFT)


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


def test_work_and_precision_next_to_solve_ivp(request, monkeypatch):
    """The table; what is asserted holds within one run, and of time only where benchmarks are asked for."""
    timed = request.config.getoption("benchmark_enable")
    reference = peer(8.0, "DOP853", 1e-12, 1e-15)
    rows = []
    for rtol in (1e-5, 1e-6, 1e-7, 1e-9) if timed else (1e-7,):
        monkeypatch.setattr(module, "RELATIVE", rtol)
        monkeypatch.setattr(module, "ABSOLUTE", rtol * 5e-2)
        rows.append((f"plant{' (as shipped)' if rtol == 1e-7 else ''}", rtol, *least(lambda: ours(8.0))))
    for method in ("LSODA", "RK45"):
        for rtol in (1e-4, 1e-6, 1e-8) if timed else (1e-6,):
            rows.append((f"solve_ivp {method}", rtol, *least(lambda m=method, r=rtol: peer(8.0, m, r))))
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
