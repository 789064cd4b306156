"""The muscle with hysteresis and creep on its shipped benches: what runs in virtual time record."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.store.reader import open_run

ONCE = ("sweep.repeat.count", "1")


def ran(folder, protocol, bench, settings, **options):
    prepared = prepare(protocol, bench, "dmsp-20-250-real", settings)
    devices = tuple(replace(d, options={**d.options, **options}) for d in prepared.mounted.bench.devices)
    mounted = replace(prepared.mounted, bench=replace(prepared.mounted.bench, devices=devices))
    outcome = run_plan(prepared.plan, mounted, ConfirmedBeforehand(), out=folder)
    assert outcome.status == "finished", outcome.why
    return outcome.folder


def surface(x, P):
    """F_s [N] at x [mm] and P [kPa]."""
    kappa = x / 2.5
    return (244.7 - 0.1115 * P) * math.exp(-0.334 * kappa) - 0.0830 * kappa * P + 2.650 * P - 249.4


def test_a_load_comes_to_where_surface_and_hysteresis_hold_it(tmp_path):
    """Creep off. Up at 300 kPa F_s = 21 kg + H + 18 N; back at 200 kPa the widest stops are still in between:
    that over contraction by the way gone, that over pressure, 100 kPa wide, in its middle.
    """
    settings = [ONCE, ("sweep.matrix.load", "[21 kg]"), ("sweep.matrix.pressure", "[300 kPa]")]
    folder = ran(tmp_path, "contraction-relaxation", "mock-real-ideal", [*settings, ("sample_rate", "100 Hz")], creep=0)
    trial = next(trial for trial in open_run(folder).trials if trial.point["pressure"] > 290e3)
    x, F, P = (np.asarray(trial.channels[name]) for name in ("displacement", "force", "pressure"))
    load = 21 * 9.81
    up = brentq(lambda x: surface(x, 300.0) - load - 20.0 - 18.0, 0.0, 70.0)

    def back(x):
        stops = 0.2 + 0.3 + 0.3 + 0.2 * (up - x - 8.0) / 8.0
        return surface(x, 200.0) - load + 15.0 * stops + 18.0 * 0.4

    for kPa, expected in ((300.0, up), (200.0, brentq(back, 0.0, up))):
        last = np.flatnonzero(np.abs(P - 1e3 * kPa) < 10.0)[-1]
        assert 1e3 * x[last] == pytest.approx(expected, abs=0.005)
        assert F[last] == pytest.approx(load, abs=0.05)


def test_a_ramp_both_ways_is_as_wide_as_stops_and_damping_make_it(tmp_path):
    """10 mm about 10 mm at 300 kPa and 5 mm/s, by hand: 2 20 N 0.85, and (1.6 + 1.15) N.s/mm 5 mm/s."""
    settings = [("sweep.matrix.pressure", "[300 kPa]"), ("sweep.matrix.speed", "[5 mm/s]"), ("trial.cycles", "2")]
    folder = ran(tmp_path, "isobaric-ramp", "mock-real-actuator-ideal", settings, creep=0)
    (trial,) = open_run(folder).trials
    t, x, F = (np.asarray(values) for values in (trial.t, trial.channels["displacement"], trial.channels["force"]))
    ways = []
    for way in (1, -1):
        moving = np.flatnonzero(np.abs(np.gradient(x, t) * 1e3 - 5 * way) < 0.05)
        last = moving[moving > len(t) // 2]
        order = np.argsort(x[last])
        ways.append(np.interp(10e-3, x[last][order], F[last][order]))
    assert ways[1] - ways[0] == pytest.approx(2 * 20 * 0.85 + 2.75 * 5, abs=0.3)
    assert 0.5 * (ways[0] + ways[1]) == pytest.approx(surface(10.0, 300.0) - 18.0 - 0.45 * 5 / 2, abs=0.3)


def test_filling_and_emptying_at_a_fixed_length_are_36_newtons_apart(tmp_path):
    settings = [ONCE, ("sweep.matrix.contraction", "[4 %]"), ("sample_rate", "50 Hz")]
    folder = ran(tmp_path, "isometric-pressurisation", "mock-real-actuator-ideal", settings, creep=0)
    (trial,) = open_run(folder).trials
    P, F = (np.asarray(trial.channels[name]) for name in ("pressure", "force"))
    top = int(P.argmax())
    fills, empties = np.flatnonzero(np.gradient(P) > 100), np.flatnonzero(np.gradient(P) < -100)
    up, down = fills[fills < top], empties[empties > top][::-1]
    gap = np.interp(250e3, P[down], F[down]) - np.interp(250e3, P[up], F[up])
    assert gap == pytest.approx(36.0, abs=0.1)
