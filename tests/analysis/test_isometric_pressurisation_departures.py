"""Isometric pressurisation next to a muscle in closed form: lags that are declared.

F = 0.65 N/kPa (1 - x/60 mm) P - 30 N - 0.2 N/mm x, 0 where that is below; a loop of 10 N that turns within 16 kPa.
"""

from itertools import pairwise

import numpy as np
import pytest

from pmabench.kinds.isometric_pressurisation import reduction
from pmabench.store.records import Command, TrialData
from tests.analysis.judged_forms import as_run

TOP, LOOP, REST, PLACES = 500e3, 10.0, 2.0, (0.0, 0.005, 0.01)
SEEDS = range(2)


def slope(x):
    return 0.65e-3 * (1 - x / 0.06)


def start(x):
    return -30.0 - 200.0 * x


def loop(P):
    """Place in the loop, -1 to 1: a play of 16 kPa."""
    found, z = [-1.0], -1.0
    for before, after in pairwise(P):
        z = min(1.0, max(-1.0, z + (after - before) / 8e3))
        found.append(z)
    return np.array(found)


def after_lag(y, steps):
    """A first-order lag, exact for straight lines between samples, of so many sample times."""
    keep, found = np.exp(-1 / steps), [y[0]]
    for before, after in pairwise(y):
        late = (after - before) * steps
        found.append(after - late + (found[-1] - before + late) * keep)
    return np.array(found)


def found(seed, ramp=20e3, rate=50.0, lags=None, declared=0.0, known=None):
    """The analysis of two tests at each of three lengths. `lags`: channel -> lag of its sensor [s]."""
    rng, trials, way = np.random.default_rng(seed), [], TOP / ramp
    corners = np.cumsum([0.0, REST, way, REST, way, REST])
    t = np.arange(round(corners[-1] * rate)) / rate
    P = np.interp(t, corners, [0.0, 0.0, TOP, TOP, 0.0, 0.0])
    for i, x in enumerate(PLACES * 2):
        F = np.maximum((1 + rng.normal(0, 0.002)) * (slope(x) * P + start(x)) - 0.5 * LOOP * loop(P), 0.0)
        read = {"pressure": P, "force": F}
        read |= {name: after_lag(read[name], lag * rate) for name, lag in (lags or {}).items()}
        noise = {"pressure": 400.0, "force": 0.3}
        read = {name: y + rng.normal(0, noise[name], len(t)) for name, y in read.items()}
        read["displacement"] = x + rng.normal(0, 2e-6, len(t))
        begin = i * (corners[-1] + 10.0)
        commands = tuple(
            Command(begin + corners[at], "pressure", "ramp", to, TOP - to, phase, {"rate": ramp})
            for at, to, phase in ((1, TOP, "fill"), (3, 0.0, "empty"))
        )
        trials.append(TrialData("a", i, {"contraction": x}, i // len(PLACES), False, "finished", begin + t, read,
                                np.zeros(len(t), dtype=np.uint16), commands, {}))  # fmt: skip
    facts = {name: dict(of) for name, of in (known or {}).items()}
    for name in lags if lags and declared else ():
        facts[name] = {**facts.get(name, {}), "sensor_lag": declared}
    return reduction.reduce([as_run("isometric-pressurisation", trials, rate, {}, facts)])


def values(analysis, *symbols):
    return [e for e in analysis.estimates if e.symbol in symbols]


def off(e, truth):
    """Error in half widths."""
    return abs(e.value - truth) / e.parts.combined


@pytest.mark.parametrize("channel", ["pressure", "force"])
def test_a_declared_lag_opens_or_closes_no_loop(channel):
    """100 kPa/s: 20 ms are worth 2.6 N of the 10 N of the loop, which was withheld with "ramp more slowly"."""
    for seed in SEEDS:
        for H in values(found(seed, 100e3, 250.0, {channel: 0.02}, 0.02), "H"):
            assert H.value == pytest.approx(LOOP, abs=0.8)
            assert off(H, LOOP) <= 1
            assert H.parts.combined < 1.5


def test_a_lag_that_nobody_declared_is_asked_for():
    notes = [H.note for H in values(found(0, 100e3, 250.0, {"pressure": 0.02}), "H") if H.withheld]
    assert notes
    assert all("declare the `sensor_lag`" in note for note in notes)
