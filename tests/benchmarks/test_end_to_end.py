"""How many recorded seconds one second makes, from protocol to coefficients, beside RK45 on the same trial. `make bench`."""

import time

import numpy as np
from scipy.integrate import solve_ivp

from pmabench.analysis.reduce import reduce_runs
from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.store.reader import open_run

ONE_BLOCK = [("sweep.repeat.count", "1")]


def seconds(work):
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


def rk45_trial():
    """10 s of contraction at 300 kPa with 6 kg by solve_ivp's default method, no friction, sampled at 500 Hz."""

    def slope(_t, state):
        x, v, P = state
        p = P / 1e3
        pull = 1.08 * p - 49.0 - (5.6 + 1e-3 * p + 9.7e-6 * p * p) * x * 1e3 - (1.2 + 1.6e-3 * p) * v * 1e3
        return [v, (pull - 58.86) / 8.0 if x > 0 or pull > 58.86 else 0.0, (300e3 - P) / 0.0955]

    return solve_ivp(slope, (0.0, 10.0), [0.0, 0.0, 0.0], t_eval=np.arange(5000) / 500, rtol=1e-6, atol=1e-9)


def test_recorded_seconds_per_second(tmp_path):
    prepared = prepare("contraction-relaxation", "mock", "mas-20-250-paper0", ONE_BLOCK)
    run_plan(prepared.plan, prepared.mounted, ConfirmedBeforehand(), out=None)
    outcome, running = seconds(lambda: run_plan(prepared.plan, prepared.mounted, ConfirmedBeforehand(), out=tmp_path))
    run, opening = seconds(lambda: open_run(outcome.folder))
    (analysis,), reducing = seconds(lambda: reduce_runs([run]))
    _, again = seconds(lambda: reduce_runs([run]))
    solution, reference = seconds(rk45_trial)
    recorded = outcome.rows / 500.0
    whole = running + opening + reducing
    print(
        f"\nrecorded {recorded:.0f} s in {whole:.2f} s: {recorded / whole:.0f} times real time end to end"
        f"\n  run and record {running:.2f} s ({recorded / running:.0f}), open {opening:.2f} s,"
        f" reduce with intervals {reducing:.2f} s (again {again:.2f} s)"
        f"\n  solve_ivp RK45, one 10 s contraction alone: {reference:.3f} s ({10 / reference:.0f} times real time)"
    )
    assert outcome.status == "finished"
    assert analysis.estimates
    assert solution.success
