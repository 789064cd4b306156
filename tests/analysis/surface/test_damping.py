"""Damping next to hysteresis: a smooth muscle with elastic-plastic friction, pulled at one speed or at two."""

import numpy as np
import pytest

from pmabench.analysis.surface.trials import driven
from pmabench.kinds.surface.reduction import reduce
from pmabench.store.records import TrialData
from tests.analysis.judged_forms import as_run

RATE, GAP, REACH, B = 50.0, 8.0, 0.8e-3, 1200.0
"""[Hz], width of the loop [N], contraction over which it builds up [m], damping [N s/m]."""


def force(x, P):
    return 2.6e-3 * (P - 3e4) * np.exp(-x / 0.045) + 180 * np.exp(-x / 6e-3) - 1500 * x - 0.01 * (P - 3e4) * x


def hysteresis(x):
    state, found = 0.0, np.zeros(len(x))
    for row, change in enumerate(np.diff(x, prepend=x[0])):
        state = min(1.0, max(-1.0, state + change / REACH))
        found[row] = 0.5 * GAP * state
    return found


def through(places, speed):
    at = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(places)) / speed)])
    t = np.arange(0, at[-1], 1 / RATE)
    return t, np.interp(t, at, places)


def found(speeds):
    """Loops at four pressures with small ones in them, at each speed; fills at two lengths."""
    chance, trials, now = np.random.default_rng(1), [], 0.0
    courses = []
    for P, top in ((2e5, 0.025), (3e5, 0.035), (4e5, 0.04), (5e5, 0.04)):
        for speed in speeds:
            t, x = through([0.0, top, 0.4 * top, 0.7 * top, 0.0], speed)
            courses.append((t, x, np.full_like(x, P), {"pressure": P}))
    for at in (0.0, 16e-3):
        t, P = through([1.2e5 + 4e6 * at, 5e5, 1.2e5 + 4e6 * at], 15e3)
        courses.append((t, np.full_like(P, at), P, {"contraction": at}))
    for number, (t, x, P, point) in enumerate(courses):
        F = force(x, P) - hysteresis(x) - B * np.gradient(x, t) + 0.3 * chance.standard_normal(len(t))
        read = {"pressure": P + 300 * chance.standard_normal(len(t)), "force": F,
                "displacement": x + 3e-6 * chance.standard_normal(len(t))}  # fmt: skip
        flags = np.zeros(len(t), dtype=np.uint16)
        trials.append(TrialData("made", number, point, 0, False, "finished", now + t, read, flags, (), {}))
        now += t[-1] + 30.0
    analysis = reduce([as_run("isobaric-ramp", trials, RATE, {})], {"rows": {"isobaric-ramp": driven}})
    return [e for e in analysis.estimates if e.symbol in ("B_c", "B_r")]


def test_damping_is_not_distinguished_from_hysteresis_at_one_speed():
    """The loop was read as damping: 2240 +- 940 N s/m of 1200, always too much."""
    damping = found((3e-3,))
    assert damping
    assert all(e.value is None and "moved at one speed only" in e.note for e in damping)


def test_damping_is_given_at_two_speeds():
    damping = found((3e-3, 15e-3))
    known = [e for e in damping if e.value is not None]
    assert len(known) >= 4
    assert all(e.value == pytest.approx(B, abs=e.parts.combined) for e in known)
