"""Joint in closed loop: angles in closed form through a sensor of known faults; intervals must hold the truth."""

import math

import numpy as np
import pytest

from pmabench.kinds.joint_step.reduction import reduce
from pmabench.store.records import ChannelInfo, ClockInfo, Flag, RunData, TrialData
from tests.analysis.test_polled_channels import held

DEG = math.pi / 180
GOAL, WAY, HOLD, BAND = 20 * DEG, 2.0, 5.0, 0.5 * DEG
"""The step, the time before it [s], after it [s], and the band that counts as settled."""
COUNT = 120 * DEG / 2**16
OFFSET, GAIN = 0.02 * DEG, 5e-4
"""Expanded uncertainties of the encoder."""


def step(t, omega, lag=0.0, zeta=0.6, dead=0.03):
    """Second order behind a dead time, seen through a filter of first order: residues at three poles."""
    rest, ring = -zeta * omega, omega * math.sqrt(1 - zeta**2)
    poles = [complex(rest, ring), complex(rest, -ring), *([-1 / lag + 0j] if lag else [])]
    top = omega**2 / (lag or 1.0)
    s = np.maximum(t - dead, 0.0)
    found = np.ones_like(t) + 0j
    for p in poles:
        others = [q for q in poles if q != p]
        found = found + top / (p * np.prod([p - q for q in others])) * np.exp(p * s)
    return GOAL * found.real


def sine(t, frequency, lag=0.0):
    """Answer of two lags of 60 ms, through a filter, after a soft begin."""
    ratio = answer(frequency) / (1 + 2j * math.pi * frequency * lag)
    return GOAL / 2 * (ratio * np.exp(2j * np.pi * frequency * t)).imag * (1 - (1 + t / 0.1) * np.exp(-t / 0.1))


def answer(frequency):
    return 1 / (1 + 2j * math.pi * frequency * 0.06) ** 2


def true(omega, zeta=0.6):
    """Overshoot [rad] in closed form; settling and rise time [s] of a fine table."""
    t = np.linspace(0.0, HOLD, 500_001)
    x = step(t, omega)
    reached = [float(t[np.argmax(x >= share * GOAL)]) for share in (0.1, 0.9)]
    outside = float(t[np.flatnonzero(np.abs(x - GOAL) > BAND)[-1]])
    return {"OS_th": GOAL * math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2)), "t_s": outside, "e_th": 0.0,
            "t_r": reached[1] - reached[0]}  # fmt: skip


def analysed(point, course, *, declared=0.0, off=0.0, gain=0.0, lost=0.0, count=COUNT, noise=1e-5, repeats=3, seed=1,
             change=lambda t, angle: angle):  # fmt: skip
    """The analysis of repeats of one operating point, whose true angle is `course` of the time from the step on."""
    chance, trials = np.random.default_rng(seed), []
    for number in range(repeats):
        t = 2e-3 * np.arange(round((WAY + HOLD + 0.02) / 2e-3))
        angle = np.where(t < WAY, 0.0, course(np.maximum(t - WAY, 0.0)))
        read = change(t - WAY, angle) * (1 + gain) + off + noise * chance.standard_normal(len(t))
        flags = np.where(chance.random(len(t)) < lost, np.uint16(Flag.GAP), np.uint16(0)).astype(np.uint16)
        law = {"t0": 0.0, "reference_lag": 0.0667, "saturated": 0.0}
        channels = {"angle": count * np.round(read / count)}
        trials.append(
            TrialData("made", number, {"goal": GOAL, "integral": 20.0, **point}, number, False, "finished", t, channels,
                      flags, (), {"hold": law})
        )  # fmt: skip
    info = ChannelInfo("angle", "angle", "rad", 1.0, 0.0, -np.inf, np.inf, OFFSET, GAIN, declared, stream="one")
    window = [2.0, HOLD] if point else [4.0, 5.0]
    settings = {"window": window, "band": BAND, "begin": WAY}
    return reduce([
        RunData("made", "", "joint-step", "finished", True, {"specimen": {}}, {"settings": settings}, (),
                {"angle": info}, 500.0, tuple(trials), {"one": ClockInfo()})
    ])  # fmt: skip


def off_by(analysis, truth):
    """Errors in half widths."""
    found = {e.symbol: e for e in analysis.estimates if e.symbol in truth}
    assert all(e.value is not None for e in found.values())
    return {name: (e.value - truth[name]) / e.parts.combined for name, e in found.items()}


def stepped(omega=12.0, lag=0.0, **sensor):
    return analysed({}, lambda t: step(t, omega, lag), **sensor)


def test_lost_samples_are_no_leaps_of_the_encoder():
    """One sample of a hundred is lost; across a hole the angle changes by twice as much."""
    steps = stepped(lost=0.01)
    assert steps.dropped == ()
    assert {e.n for e in steps.estimates} == {3}
    sines = analysed({"goal": GOAL / 2, "frequency": 1.0}, lambda t: sine(t, 1.0), lost=0.01)
    assert sines.dropped == ()
    late = {"g_th": abs(answer(1.0)), "phi_th": float(np.angle(answer(1.0)))}
    assert max(map(abs, off_by(sines, late).values())) < 0.2


@pytest.mark.parametrize("lost", [0.0, 0.01])
def test_an_encoder_that_slips_is_still_seen(lost):
    found = stepped(lost=lost, change=lambda t, angle: angle + 0.2 * DEG * (t > 0.1))
    assert len(found.dropped) == 3
    assert "the encoder or its coupling slips" in found.dropped[0].reason


@pytest.mark.parametrize("omega", [12.0, 25.0, 40.0])
def test_a_quick_overshoot_is_not_flattened(omega):
    """Repeats that agree have narrow intervals; a mean over 20 ms made it up to 2.6 % low."""
    found = off_by(stepped(omega), true(omega))
    assert max(map(abs, found.values())) < 0.5
    height = next(e.value for e in stepped(omega).estimates if e.symbol == "OS_th")
    assert height == pytest.approx(true(omega)["OS_th"], rel=2e-3)


def test_a_declared_filter_is_undone():
    """It lowered the overshoot by 3.6 %, which a shift in time does not give back."""
    found = stepped(lag=0.02, declared=0.02)
    assert max(map(abs, off_by(found, true(12.0)).values())) < 0.5
    height = next(e.value for e in found.estimates if e.symbol == "OS_th")
    assert height == pytest.approx(true(12.0)["OS_th"], rel=4e-3)


@pytest.mark.parametrize(
    "sensor",
    [{"off": OFFSET}, {"off": -OFFSET}, {"gain": GAIN}, {"gain": -GAIN}, {"lag": 0.005}, {"lag": 0.024, "declared": 0.02},
     {"count": 120 * DEG / 2**10, "noise": 0.0}],
)  # fmt: skip
def test_what_the_declaration_leaves_open_is_in_the_intervals(sensor):
    """A zero, a gain, a filter of up to 5 ms that nobody declared, one a fifth longer than declared, and coarse steps."""
    assert max(map(abs, off_by(stepped(**sensor), true(12.0)).values())) < 1.05


def creeping(share, times):
    """What is left to come of a creep of a share of the step, in as many parts as there are times [s]."""
    return lambda t, angle: angle - GOAL * share * np.mean(
        [np.where(t > 0, np.exp(-t / T) * (1 - np.exp(-t / 0.3)), 0.0) for T in times], axis=0
    )  # fmt: skip


@pytest.mark.parametrize("change", [creeping(0.04, [10.0]), creeping(0.04, np.geomspace(0.5, 500.0, 10))])
def test_an_angle_that_creeps_beyond_the_window_is_named_and_where_it_ends_is_in_the_interval(change):
    """The goal is reached in the end, after 10 s or along the logarithm of time."""
    found = stepped(change=change)
    assert "in the window of e_th the angle moves" in " ".join(one.text for one in found.findings)
    assert abs(off_by(found, {"e_th": 0.0})["e_th"]) < 1
    assert "in the window" not in " ".join(one.text for one in stepped().findings)


def test_an_angle_that_dies_away_as_an_exponential_is_not_taken_for_one_that_creeps():
    """What is left of it after 4 s is found from the window itself: 4 % of the step came with 0.9 s."""
    found = stepped(change=creeping(0.04, [0.9]))
    assert "in the window" not in " ".join(one.text for one in found.findings)
    (e,) = (e for e in found.estimates if e.symbol == "e_th")
    assert abs(e.value) < e.parts.combined < 1.3e-3


def test_a_sound_bench_keeps_narrow_intervals():
    halves = {e.symbol: e.parts.combined for e in stepped().estimates}
    assert halves["OS_th"] < 1.5 * math.hypot(OFFSET, GAIN * GOAL)
    assert halves["t_s"] < 0.010
    assert halves["t_r"] < 0.015
    assert halves["e_th"] < 1.5 * math.hypot(OFFSET, GAIN * GOAL)


def polled(rate):
    """An encoder whose noise of 10 urad is read `rate` times a second, and held in between."""

    def read(t, angle):
        return held(t, angle + 1e-5 * np.random.default_rng(8).standard_normal(len(t)), rate)

    return read


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_an_angle_that_is_polled_does_not_leap(rate):
    """All trials were dropped: the angle "leaps" from one answer to the next. At rest it is read again, and the same."""
    truth = true(12.0)
    found = analysed({}, lambda t: step(t, 12.0), noise=0.0, change=polled(rate))
    assert not found.dropped
    assert max(abs(z) for z in off_by(found, truth).values()) < 1.3
    sines = analysed({"goal": GOAL / 2, "frequency": 1.0}, lambda t: sine(t, 1.0), noise=0.0, change=polled(100.0))
    late = {"g_th": abs(answer(1.0)), "phi_th": float(np.angle(answer(1.0)))}
    assert max(map(abs, off_by(sines, late).values())) < 1.0
