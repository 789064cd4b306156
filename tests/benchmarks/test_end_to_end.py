"""A campaign from protocol to coefficients against the simulated plant alone, in one run. `make bench`.

`mock-air` is the plant with everything: stiction, a regulator of second order that has to move air, noise, counts.
The plant alone gets the same commands and loads at the same moments and is asked for the same samples: without noise
and counts, driver, acquisition, record and reduction. Ours rests in closed form, several times faster than the rest of
the program; so the same plant as one system of equations for LSODA (`plain_plant`) stands beside it in the same run.
`PMABENCH_REPEATS=6 make bench` makes it 528 trials.
"""

import os
import time

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.reduce import reduce_runs
from pmabench.model.plant import Plant
from pmabench.model.presets import preset
from pmabench.model.regulator import Regulated
from pmabench.store.reader import open_run
from tests.benchmarks.least import least
from tests.benchmarks.plain_plant import plain

SHORT = [("sweep.matrix.load", "[6 kg, 31 kg]"), ("sweep.matrix.pressure.step", "175 kPa")]
"""A campaign of six trials, where nothing is timed."""
RATE = 500.0


@pytest.fixture
def reported(monkeypatch):
    """What the plant is told in a run: moment [s], what, and with which values."""
    calls = []

    def tap(owner, name, moment):
        method = getattr(owner, name)

        def tapped(self, *given):
            calls.append((moment(self, given), name, given))
            return method(self, *given)

        monkeypatch.setattr(owner, name, tapped)

    for name in ("command", "load"):
        tap(Plant, name, lambda plant, _: getattr(plant, "time", 0.0))
    for name in ("force", "release"):
        tap(Regulated, name, lambda _, given: given[0])
    return calls


def alone(name, calls, end):
    """Contraction [m] at 500 Hz up to `end` [s] of a plant that is told the same."""
    plant, parts, taken = preset(name, "bench").free(mass=2.0), [], 0
    do = {"command": plant.command, "load": plant.load, "force": plant.supply.force, "release": plant.supply.release}
    for moment, name, given in [*calls, (end, "", ())]:
        if moment > plant.time:
            due = np.arange(taken, int(moment * RATE + 1e-6) + 1)
            parts.append(plant.advance(moment, due / RATE).x)
            taken += len(due)
        if name:
            do[name](*given)
    return np.concatenate(parts)


def rk45_trial():
    """10 s of contraction at 300 kPa with 6 kg by solve_ivp's default method, no friction, sampled at 500 Hz."""

    def slope(_t, state):
        x, v, P = state
        p = P / 1e3
        pull = 1.08 * p - 49.0 - (5.6 + 1e-3 * p + 9.7e-6 * p * p) * x * 1e3 - (1.2 + 1.6e-3 * p) * v * 1e3
        return [v, (pull - 58.86) / 8.0 if x > 0 or pull > 58.86 else 0.0, (300e3 - P) / 0.0955]

    return solve_ivp(slope, (0.0, 10.0), [0.0, 0.0, 0.0], t_eval=np.arange(5000) / 500, rtol=1e-6, atol=1e-9)


PLANT = {"mock-air": ("paper0-air", 4.5, 8.0), "mock": ("paper0", 9.0, 16.0)}
"""Bench: its plant, and how many times the processor time of that plant alone a whole campaign takes at most: one of 500
trials, and a short one, in which what is done once counts for more."""


@pytest.mark.parametrize("bench", PLANT)
def test_recorded_seconds_per_second(tmp_path, request, reported, bench):
    timed = request.config.getoption("benchmark_enable")
    preset_name, *limits = PLANT[bench]
    changes = [("sweep.repeat.count", os.environ.get("PMABENCH_REPEATS", "1"))] + ([] if timed else SHORT)
    prepared = prepare("contraction-relaxation", bench, "mas-20-250-paper0", changes)
    if timed:  # what is imported at the first time is no part of it
        short = prepare("contraction-relaxation", bench, "mas-20-250-paper0", [*SHORT, ("sweep.repeat.count", "1")])
        first = run_plan(short.plan, short.mounted, ConfirmedBeforehand(), out=tmp_path / "first")
        reduce_runs([open_run(first.folder)])
        reported.clear()
    begin = time.perf_counter()
    running, outcome = least(lambda: run_plan(prepared.plan, prepared.mounted, ConfirmedBeforehand(), out=tmp_path), 1)
    calls = list(reported)
    opening, run = least(lambda: open_run(outcome.folder), 1)
    reducing, (analysis,) = least(lambda: reduce_runs([run]), 1)
    wall = time.perf_counter() - begin
    plant, x = least(lambda: alone(preset_name, calls, outcome.bench_seconds))
    bare, common = 0.0, None
    if bench == "mock-air":  # the dump valve opens where the pressure is 0 already
        bare, common = least(lambda: plain(preset(preset_name, "bench"), calls, outcome.bench_seconds, RATE), 1)
    reference, _ = least(rk45_trial, 1)
    recorded, whole = outcome.rows / RATE, running + opening + reducing
    full = len(run.trials) >= 500
    most = limits[0 if full else 1]
    print(
        f"\n{bench}: {len(run.trials)} trials, {recorded:.0f} s recorded in {wall:.2f} s: {recorded / wall:.0f} times real time"
        f"\n  processor time: run and record {running:.2f} s, open {opening:.2f} s, reduce with intervals {reducing:.2f} s"
        f"\n  the plant alone {plant:.2f} s ({outcome.bench_seconds / plant:.0f} times): end to end {whole / plant:.1f}"
        f" times that, at most {most}, run and record {running / plant:.1f} times"
        + (
            f"\n  LSODA alone {bare:.2f} s ({outcome.bench_seconds / bare:.0f} times): end to end {whole / bare:.2f} times that"
            if bare
            else ""
        )
        + f"\n  solve_ivp RK45, one 10 s contraction: {reference:.3f} s ({10 / reference:.0f} times real time)"
    )
    assert outcome.status == "finished"
    assert analysis.estimates
    rows = np.concatenate([np.rint(trial.t * RATE).astype(int) for trial in run.trials])
    measured = np.concatenate([trial.channels["displacement"] for trial in run.trials])
    assert np.abs(measured - x[rows]).max() < 15e-6, "the plant alone does the same; noise 2 um"
    if common is not None:
        distinguished = "it is the same plant; a bristle gives by 10 um, and sticks elsewhere by some of them"
        assert np.abs(common - x[: len(common)]).max() < 200e-6, distinguished
    if timed:
        assert whole < most * plant
        assert not (full and bare) or whole < 2.2 * bare, "on an idle machine; up to 2.7 times on a busy one"
