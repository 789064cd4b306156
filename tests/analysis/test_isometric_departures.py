"""Isometric lines next to a muscle in closed form: late sensors, a loop that is sampled unevenly, a cell that drifts.

F = 0.65 N/kPa P - 30 N, 0 where that is below; a loop of +-h that turns within 20 kPa. Its middle is the truth.
"""

from itertools import pairwise

import numpy as np
import pytest

from pmabench.kinds.isometric import reduction as isometric
from pmabench.store.records import TrialData
from tests.analysis.judged_forms import as_run

SLOPE, START, TOP, RATE = 0.65e-3, -30.0, 400e3, 100.0
SEEDS = range(4)


def pressure(rise, fall):
    """2 s at rest, a ramp up of `rise` [s], 2 s held, vented with a time constant of a quarter of `fall` [s], rest."""
    t = np.arange(0.0, 6.0 + rise + (fall or 0.0), 1 / RATE)
    up = np.interp(t, [2.0, 2.0 + rise], [0.0, TOP])
    if fall is None:
        return t[t < 2.0 + rise], up[t < 2.0 + rise]
    return t, np.where(t > 4.0 + rise, TOP * np.exp(-4.0 * (t - 4.0 - rise) / fall), up)


def loop(P):
    """Place in the loop, -1 to 1: a play of 20 kPa."""
    found, z = [-1.0], -1.0
    for before, after in pairwise(P):
        z = min(1.0, max(-1.0, z + (after - before) / 10e3))
        found.append(z)
    return np.array(found)


def after_lag(t, y, lag):
    """A first-order lag, exact for straight lines between samples."""
    keep, found = np.exp(-1 / (RATE * lag)), [y[0]]
    for before, after in pairwise(y):
        rate = (after - before) * RATE
        found.append(after - rate * lag + (found[-1] - before + rate * lag) * keep)
    return np.array(found)


def found(seed, rise=20.0, fall=20.0, h=0.0, drift=0.0, lags=None, declared=0.0, options=None):
    """m and c of three tests, and the analysis. `lags`: channel -> lag [s]; `drift` within each test [N/s]."""
    rng, trials = np.random.default_rng(seed), []
    t, P = pressure(rise, fall)
    for i in range(3):
        F = np.maximum(SLOPE * (1 + rng.normal(0, 0.002)) * P + START - h * loop(P), 0.0) + drift * t
        channels = {"pressure": P, "force": F}
        channels |= {name: after_lag(t, channels[name], lag) for name, lag in (lags or {}).items()}
        noise = {"pressure": 500.0, "force": 0.3}
        channels = {name: y + rng.normal(0, noise[name], len(t)) for name, y in channels.items()}
        trials.append(TrialData("a", i, {"contraction": 0.004}, i, False, "finished", 100 * i + t, channels,
                                np.zeros(len(t), dtype=np.uint16), (), {}))  # fmt: skip
    known = {name: {"sensor_lag": declared} for name in lags or {}} if declared else {}
    analysis = isometric.reduce([as_run("isometric", trials, RATE, {}, known)], options or {})
    m, c = (next(e for e in analysis.estimates if e.symbol == symbol) for symbol in "mc")
    return m, c, analysis


def off(e, truth):
    """Error in half widths."""
    return abs(e.value - truth) / e.parts.combined


@pytest.mark.parametrize("channel", ["pressure", "force"])
def test_a_declared_lag_of_a_sensor_is_taken_off(channel):
    """200 kPa/s, filled only: 20 ms are 2.6 N of c, which were in no interval (up to 52 half widths)."""
    for seed in SEEDS:
        m, c, _ = found(seed, rise=2.0, fall=None, lags={channel: 0.02}, declared=0.02)
        assert c.value == pytest.approx(START, abs=0.25)
        assert off(c, START) <= 1
        assert off(m, SLOPE) <= 1.5
        assert c.parts.combined < 1.0


def test_a_filter_of_5_ms_that_nobody_declared_is_in_the_interval():
    for seed in SEEDS:
        _, c, _ = found(seed, rise=2.0, fall=None, lags={"pressure": 0.005})
        assert off(c, START) <= 1.05


@pytest.mark.parametrize(("h", "fall"), [(5.0, 6.0), (10.0, 6.0), (5.0, 3.0), (2.0, 10.0)])
def test_a_loop_that_is_sampled_unevenly_is_in_the_interval(h, fall):
    """More samples of the slow filling than of the fast venting: m was 7, c 10 half widths off."""
    for seed in SEEDS:
        m, c, _ = found(seed, fall=fall, h=h)
        assert off(m, SLOPE) <= 1.05
        assert off(c, START) <= 1.05
        assert m.parts.combined < 0.06 * SLOPE


@pytest.mark.parametrize("drift", [0.5, 1.0, 2.0, 5.0])
def test_a_cell_that_drifts_within_the_tests_is_seen_at_rest(drift):
    """In N/min; c was up to 25 half widths off, and at 5 N/min what the cell read at rest was taken for the muscle."""
    for seed in SEEDS:
        m, c, analysis = found(seed, drift=drift / 60)
        assert off(c, START) <= 1.05
        assert off(m, SLOPE) <= 1.7
        assert c.parts.drift < 1.3 * drift / 60 * 30 + 0.1
        assert any("the force cell drifts" in f.text and f.level == "doubt" for f in analysis.findings)


def test_a_sound_bench_keeps_its_intervals():
    """By the scatter of three slopes, 0.2 %, m has about +-0.5 % x 0.65; nothing is reported."""
    halves = []
    for seed in range(12):
        m, c, analysis = found(seed)
        halves.append((m.parts.combined, c.parts.combined))
        assert m.value == pytest.approx(SLOPE, rel=0.005)
        assert c.value == pytest.approx(START, abs=0.15)
        assert {finding.level for finding in analysis.findings} == {"note"}
    m, c = np.mean(halves, axis=0)
    assert m < 3.5e-6
    assert c < 0.1
