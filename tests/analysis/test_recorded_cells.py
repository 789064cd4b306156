"""Recorded steps of a muscle in closed form, whose channels are read in steps.

B x' = S (P - P_0) - K x - W - k x, where W hangs and a spring k pulls, too; P comes to its end exponentially. The cell
reads W + k x. A motion that rings is integrated by scipy.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pmabench.kinds.recorded_step.reduction import reduce
from pmabench.store.records import Command, TrialData
from tests.analysis.judged_forms import as_run

S, P_0, K, B, SPRING = 1.05e-3, 50e3, 7000.0, 1700.0, 3000.0
"""[m2], [Pa], [N/m], [N s/m], [N/m]"""
DEAD, TAU_P, BEFORE, AFTER = 0.04, 0.0955, 1.0, 3.0
FULL_SCALE = {"pressure": 1e6, "displacement": 0.1, "force": 1000.0}
NOISE = {"pressure": 300.0, "displacement": 5e-6, "force": 0.3}


def pressed(t, before, after):
    return after + (before - after) * np.exp(-np.maximum(t - DEAD, 0.0) / TAU_P)


def moved(t, before, after, load, spring):
    """Contraction [m], shape (n,): at rest, two exponentials from the dead time on."""
    stiff = K + spring
    tau, start, end = B / stiff, *((S * (P - P_0) - load) / stiff for P in (before, after))
    driven = S * (before - after) / (stiff - B / TAU_P)
    s = np.maximum(t - DEAD, 0.0)
    return end + driven * np.exp(-s / TAU_P) + (start - end - driven) * np.exp(-s / tau)


def trial(number, point, t, channels, chance, bits):
    read = {name: y + (0.02 if name in bits else 1.0) * NOISE[name] * chance.standard_normal(len(t))
            for name, y in channels.items()}  # fmt: skip
    for name, bit in bits.items():
        lsb = FULL_SCALE[name] / 2**bit
        read[name] = lsb * np.round(read[name] / lsb)
    begin = 8.0 * number + BEFORE
    command = Command(begin, "pressure", "set", point["pressure"], point["from"], "step", {})
    return TrialData("r", number, point, 0, False, "finished", begin + t, read, np.zeros(len(t), np.uint16),
                     (command,), {})  # fmt: skip


def reduced(trials, rate):
    run = as_run("recorded-step", trials, rate, {})
    return reduce([replace(run, manifest={"imported": {"late_by": {"pressure": [0.0, 0.0]}}})])


def weighted(bits):
    """Steps under two weights, to one pressure from below and from above, twice."""
    chance, t, found = np.random.default_rng(2), np.arange(-BEFORE, AFTER, 1 / 80), []
    for load in (60.0, 160.0) * 2:
        for before, after in ((2e5, 3e5), (4e5, 3e5)):
            x = moved(t, before, after, load, SPRING)
            channels = {"pressure": pressed(t, before, after), "displacement": x, "force": load + SPRING * x}
            point = {"from": before, "pressure": after, "load": load, "mass": 2.0}
            found.append(trial(len(found), point, t, channels, chance, bits))
    return reduced(found, 80.0)


def of(found, symbol, method):
    return [e for e in found.estimates if (e.symbol, e.method) == (symbol, method)]


def holds(e, truth):
    return e.ci95[0] <= truth <= e.ci95[1]


def test_what_channels_read_in_steps_make_of_values_at_rest_is_in_their_intervals():
    lsb, of_P = (FULL_SCALE[name] / 2**bits for name, bits in (("displacement", 10), ("pressure", 8)))
    found = weighted({"displacement": 10, "pressure": 8})
    stiff = K + SPRING
    for e in of(found, "X", "recorded-step"):
        assert holds(e, S * (e.at["pressure"] - e.at["from"]) / stiff)
        assert e.parts.combined < 1.6 * lsb
    for e in of(found, "dP/dx", "recorded-step"):
        assert holds(e, stiff / S)
        assert e.parts.combined < 0.8 * np.hypot(lsb * stiff / S / 1e5, of_P / 1e5) * stiff / S


def ringing(creep, weight=20.0, damping=150.0):
    """A weight that rings after a step, on a muscle of which a share creeps within half a second."""
    chance, t = np.random.default_rng(3), np.arange(-BEFORE, AFTER, 1 / 500)
    load = 9.81 * weight
    start = (S * (2e5 - P_0) - load) / K / (1 - creep)

    def rates(s, y):
        x, v, c = y
        pull = S * (float(pressed(s, 2e5, 3e5)) - P_0) - K * (x - c) - damping * v - load
        return [v, pull / weight, (creep * x - c) / 0.5]

    late = t[t >= 0]
    solved = solve_ivp(rates, (0, AFTER), [start, 0.0, creep * start], "LSODA", late, rtol=1e-8, atol=1e-11,
                       max_step=0.01)  # fmt: skip
    x = np.concatenate([np.full(len(t) - len(late), start), solved.y[0]])
    point = {"from": 2e5, "pressure": 3e5, "load": load, "mass": weight}
    channels = {"pressure": pressed(t, 2e5, 3e5), "displacement": x}
    return reduced([trial(0, point, t, channels, chance, {})], 500.0)


def test_a_motion_that_gives_no_stiffness_gives_no_damping():
    found = ringing(0.03)
    (stiff,), (damping,) = of(found, "K", "ringing-of-known-mass"), of(found, "B", "ringing-of-known-mass")
    assert stiff.withheld
    assert damping.withheld
    assert stiff.note in damping.note
    (sound,) = of(ringing(0.0), "B", "ringing-of-known-mass")
    assert sound.value == pytest.approx(150.0, rel=0.05)
