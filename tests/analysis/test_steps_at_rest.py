"""Steps of displacement of a muscle in closed form: what regulator, friction, steps of a channel and filters make of K.

F = S (P - P_0) - K x - B x' - f, where f is friction that has the sign of the last motion. The regulator rests beyond
its set-point by a dead band after each motion, and comes there exponentially.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from pmabench.analysis.shared.samples import unresolved
from pmabench.kinds.step_displacement.reduction import reduce
from pmabench.store.records import Command, TrialData
from tests.analysis.judged_forms import as_run
from tests.analysis.test_polled_channels import held

S, P_0, K, B = 1.08e-3, 45e3, 6773.0, 800.0
"""[m2], [Pa], [N/m], [N s/m]"""
START, SPEED, HOLD, CYCLES = 10e-3, 0.1, 1.0, 3
TAU, RATE = 0.06, 1000.0


def motion(step):
    """Time [s], contraction [m], its rate [m/s], sign of the last motion, and the corners of the ramps [s]."""
    way = abs(step) / SPEED
    corners = HOLD + (HOLD + way) * np.arange(2 * CYCLES)
    t = np.arange(round((corners[-1] + way + HOLD) * RATE)) / RATE
    places = np.sort(np.concatenate([[0.0], corners, corners + way]))
    x = np.interp(t, places, [START, *[START, START + step, START + step, START] * CYCLES])
    number = np.searchsorted(corners, t, side="right")
    side = np.where(number % 2, 1.0, -1.0) * np.sign(step)
    side[number == 0] = 1.0  # the start is reached by contracting
    return t, x, np.gradient(x, t), side, corners


def steps(seed, pressure=300e3, step=5e-3, trials=2, band=0.0, swing=4e3, friction=0.0, lag=0.0, lsb=0.0, noise=0.2):
    """Two trials or more of one cell."""
    chance, found = np.random.default_rng(seed), []
    t, x, v, side, corners = motion(step)
    since = t - np.concatenate([[-9.0], corners + step / SPEED])[np.searchsorted(corners, t, side="right")]
    P = pressure - side * (band + swing * np.exp(-np.clip(since, 0, None) / TAU)) * (t >= corners[0])
    F = S * (P - P_0) - K * x - B * v - friction * side
    if lag:
        kept = np.exp(-1 / (RATE * lag))
        F = lfilter([1 - kept], [1, -kept], F - F[0]) + F[0]
    for repeat in range(trials):
        begin = repeat * (t[-1] + 5.0)
        read = {name: y + size * chance.standard_normal(len(t)) for name, y, size in
                (("pressure", P, 100.0), ("force", F, noise), ("displacement", x, 2e-6))}  # fmt: skip
        if lsb:
            read["force"] = lsb * np.round(read["force"] / lsb)
        commands = [
            Command(begin + at, "displacement", "ramp", START + step * (1 - n % 2), START + step * (n % 2),
                    "back" if n % 2 else "step", {"rate": SPEED}) for n, at in enumerate(corners)
        ]  # fmt: skip
        point = {"pressure": pressure, "start": START, "step": step, "speed": SPEED}
        flags, name = np.zeros(len(t), dtype=np.uint16), f"{pressure:g} {step:g}"
        found.append(
            TrialData(name, repeat, point, repeat, False, "finished", begin + t, read, flags, tuple(commands), {})
        )
    return found


def reduced(*cells):
    return reduce([as_run("step-displacement", [one for cell in cells for one in cell], RATE, {"discard": 1})])


def stiffness(found, method="step, relaxed", pressure=300e3):
    return [e for e in found.estimates if (e.symbol, e.method, e.at["pressure"]) == ("K", method, pressure)]


def forces(found, friction=0.0):
    """Each force at rest, and what it is at the pressure of its cell without friction."""
    for e in found.estimates:
        if e.symbol == "F" and e.coordinate in ("before", "relaxed"):
            at_start = (e.at["step"] > 0) == (e.coordinate == "before")
            x = START if at_start else START + abs(e.at["step"])
            yield e, S * (e.at["pressure"] - P_0) - K * x


def holds(e, truth):
    return e.ci95[0] <= truth <= e.ci95[1]


def test_a_regulator_that_comes_back_to_its_set_point_gives_forces_and_stiffness():
    found = reduced(steps(1))
    for e in stiffness(found):
        assert holds(e, K)
        assert e.value == pytest.approx(K, rel=0.01)
        assert e.parts.combined < 0.01 * K
    for e, truth in forces(found):
        assert holds(e, truth)
        assert e.value == pytest.approx(truth, abs=0.15)


@pytest.mark.parametrize("band", [200.0, 1e3])
def test_a_dead_band_of_the_regulator_is_in_the_forces_and_withholds_the_stiffness(band):
    found = reduced(steps(1, band=band))
    for e in stiffness(found):
        assert e.withheld
        assert "the regulator rests at other pressures before and after the steps" in e.note
    assert all(holds(e, truth) for e, truth in forces(found))


def test_a_dead_band_is_withheld_at_one_pressure_and_at_two():
    alone, both = steps(2, band=2e3, swing=0.0), steps(3, 200e3, band=2e3, swing=0.0)
    for found in (reduced(alone), reduced(alone, both)):
        for e in stiffness(found):
            assert e.withheld
            assert "by 4 kPa" in e.note


def test_a_force_that_creeps_on_the_way_back_gives_no_force_per_pressure():
    cell = steps(2, band=1e3)
    for trial in cell:  # a branch that relaxes within half a second
        x = trial.channels["displacement"]
        kept = np.exp(-1 / (RATE * 0.15))
        trial.channels["force"] -= 3e3 * (x - (lfilter([1 - kept], [1, -kept], x - START) + START))
    for e in stiffness(reduced(cell)):
        assert e.value is None or holds(e, K)


def test_friction_that_shows_at_the_first_rest_is_in_the_intervals():
    found = reduced(steps(4, friction=3.0, swing=0.0))
    for e in stiffness(found):
        assert e.value == pytest.approx(K + 2 * 3.0 / 5e-3, rel=0.01)
        assert holds(e, K)
        assert "at least K" in e.note
    assert all(holds(e, truth) for e, truth in forces(found))
    sound = stiffness(reduced(steps(4, swing=0.0)))[0]
    assert sound.parts.combined < 0.015 * K


@pytest.mark.parametrize("lsb", [1.0, 4.0])
def test_a_force_that_is_read_in_steps_has_them_in_its_intervals(lsb):
    found = reduced(steps(7, swing=0.0, lsb=lsb, noise=0.02))
    for e in stiffness(found):
        assert holds(e, K)
        assert 0.3 * lsb / 5e-3 < e.parts.combined < 1.2 * lsb / 5e-3
    for e, truth in forces(found):
        assert holds(e, truth)
        assert 0.4 * lsb < e.parts.combined < 0.7 * lsb


@pytest.mark.parametrize("lag", [0.01, 0.02])
def test_a_filter_of_the_cell_that_nobody_declared_is_no_way_back_of_the_muscle_and_blunts_the_peak(lag):
    found = reduced(steps(8, swing=0.0, lag=lag))
    for e in found.estimates:
        if e.symbol == "tau_F":
            assert e.withheld
            assert "`sensor_lag`" in e.note
    for e in stiffness(found, "step, peak"):
        assert e.value is None or holds(e, K + B * SPEED / 5e-3)


def test_a_way_back_that_the_pressure_shows_is_given_however_fast():
    found = reduced(steps(9, swing=8e3))
    for symbol in ("tau_F", "tau_p"):
        for e in (one for one in found.estimates if one.symbol == symbol):
            assert holds(e, TAU)


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1, 0.2, 0.3, 0.36, 0.45, 0.6])
def test_steps_leave_of_a_mean_what_they_do_to_the_mean_of_rounded_noise(noise):
    """By drawing: 400 places between two steps, each read 2,000 times with Gaussian noise [steps]."""
    chance = np.random.default_rng(3)
    places = (np.arange(400) + 0.5) / 400
    read = np.round(places[:, None] + noise * chance.standard_normal((400, 2000)))
    bound = np.array([unresolved(y, 1.0) for y in read])
    by_chance = 4 * max(0.5, noise) / 2000**0.5  # of a mean that is now one step, now the next
    assert (np.abs(read.mean(axis=1) - places) <= bound + by_chance).all()
    assert bound.max() <= 0.5


@pytest.mark.parametrize("rate", [4.0, 10.0])
def test_a_force_that_is_polled_shows_no_peak(rate):
    """The peak lies between two values: K was 6.8 +- 0.4 N/mm of 22.8 N/mm. What it is at rest is there."""
    found = reduced(
        [
            replace(one, channels={**one.channels, "force": held(one.t, one.channels["force"], rate, seed=seed)})
            for seed, one in enumerate(steps(3))
        ]
    )
    peaks = [e for e in found.estimates if e.method == "step, peak" and e.symbol in ("K", "F")]
    assert len(peaks) == 4
    assert all(e.withheld and "the force is new every" in e.note for e in peaks)
    assert all(e.value == pytest.approx(K, abs=e.parts.combined) for e in stiffness(found))
    plain = stiffness(reduced(steps(3)), "step, peak")
    assert all(e.value is not None or "new every" not in e.note for e in plain)
