"""Contraction with coarse steps, wrong zeros, polled channels or spikes; the muscle is integrated by scipy."""

from dataclasses import replace
from functools import lru_cache
from math import sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pmabench.analysis.shared.samples import sticks
from pmabench.analysis.shared.simulated import between_steps
from pmabench.kinds.contraction_relaxation.reduction import reduce
from pmabench.kinds.reduce import reduce_runs
from pmabench.store.records import Command, TrialData
from tests.analysis.judged_forms import as_run

RATE, HOLD, DEAD, TAU = 500.0, 2.5, 0.03, 0.09
TRUE = {
    "F_ce": lambda P: -49 + 1.08e-3 * P,
    "K": lambda P: 5600 + 1e-3 * P + 9.7e-9 * P**2,
    "B_c": lambda P: 1200 + 1.6e-3 * P,
    "B_r": lambda P: 900 + 2e-3 * P,
}
CELLS = [(W, P) for W in (60.0, 130.0, 200.0, 270.0) for P in (2e5, 3e5, 4e5, 5e5) if TRUE["F_ce"](P) > W + 15]
"""Weight [N] and pressure [Pa] of each trial; from there the pressure comes down by 100 kPa at a time."""


def pressed(t, target):
    """A lag of first order behind each command (n,)."""
    P, now = np.zeros(len(t)), 0.0
    for k, to in enumerate(np.arange(target, -1.0, -1e5)):
        since = np.maximum(t - 0.2 - k * HOLD - DEAD, 0.0)
        P = np.where(since > 0, to + (now - to) * np.exp(-since / TAU), P)
        now = to + (now - to) * np.exp(-HOLD / TAU)
    return P


@lru_cache
def motion(weight, target):
    """Time [s] and contraction [m]: B x' = F_ce - W - K x, which rests at 0."""
    t = np.arange(0.0, 0.2 + HOLD * (target / 1e5 + 1), 1 / RATE)

    def speed(at, x):
        P = pressed(np.array([at]), target)[0]
        pull = TRUE["F_ce"](P) - weight - TRUE["K"](P) * x[0]
        v = pull / TRUE["B_c" if pull > 0 else "B_r"](P)
        return [v if x[0] > 0 or v > 0 else 0.0]

    return t, solve_ivp(speed, (0.0, t[-1]), [0.0], "LSODA", t, max_step=0.02, rtol=1e-6, atol=1e-8).y[0]


def recorded(bits=16, noise=250.0, seed=0, off=None, known=None, read_as=lambda _name, values, _chance: values):
    """The run of all trials; `read_as` makes what is read of each channel's values."""
    chance, trials, step = np.random.default_rng(seed), [], 1e6 / 2**bits
    for number, (weight, target) in enumerate(CELLS):
        t, x = motion(weight, target)
        P = pressed(t, target) + noise * chance.standard_normal(len(t))
        read = {
            "pressure": step * np.round(P / step),
            "displacement": x + 3e-6 * chance.standard_normal(len(t)),
            "force": np.where(x > 0, weight, np.clip(TRUE["F_ce"](P), 0, weight))
            + 0.3 * chance.standard_normal(len(t)),
        }
        read = {name: read_as(name, values + (off or {}).get(name, 0.0), chance) for name, values in read.items()}
        begin, levels = 30.0 * number, np.arange(target, -1.0, -1e5)
        commands = tuple(
            Command(begin + 0.2 + k * HOLD, "pressure", "set", float(to), 0.0 if not k else float(levels[k - 1]),
                    "contract" if not k else "relax" if to > 0 else "vent", {})
            for k, to in enumerate(levels)
        )  # fmt: skip
        point = {"load": weight, "mass": 1.0, "pressure": target}
        trials.append(
            TrialData(
                "judged",
                number,
                point,
                0,
                False,
                "finished",
                begin + t,
                read,
                np.zeros(len(t), np.uint16),
                commands,
                {},
            )
        )
    return as_run("contraction-relaxation", trials, RATE, {}, known)


def reduced(*given, **named):
    return reduce([recorded(*given, **named)])


def scores(found):
    """Distance to the truth over the half width, of each value of the fit."""
    return {
        (e.symbol, e.at["pressure"]): (e.value - TRUE[e.symbol](e.at["pressure"])) / e.parts.combined
        for e in found.estimates
        if e.method == "measured-pressure" and e.value is not None and e.at
    }


@pytest.mark.parametrize(("bits", "noise"), [(8, 250.0), (9, 25.0)])
def test_a_pressure_that_is_read_in_steps_is_in_the_intervals(bits, noise):
    """By 8 or 9 bits of 10 bar; B_r was 9 half widths off, for each trial meets the same steps."""
    found = reduced(bits, noise)
    known = scores(found)
    assert any(f.text.startswith("the pressure is read in steps of") for f in found.findings)
    assert sum(symbol in ("F_ce", "K") for symbol, _ in known) >= 6
    assert max(abs(score) for score in known.values()) < 1.5
    assert sqrt(np.mean(np.square(list(known.values())))) < 0.9


def test_fine_steps_leave_the_intervals_as_they_are():
    """What they were before steps counted."""
    found = {
        (e.symbol, e.at.get("pressure")): e for e in reduced(16, 25.0).estimates if e.method == "measured-pressure"
    }
    assert not any("between its steps" in line.name for e in found.values() for line in e.budget)
    assert found["F_ce", 3e5].parts.combined < 0.2
    assert found["B_r", 3e5].parts.combined < 5.0


@pytest.mark.parametrize("uncertain", [0.0, 1.5e3])
def test_a_gauge_that_reads_a_pressure_while_vented_may_be_wrong(uncertain):
    """It reads 5 kPa: F_ce was 49 half widths off, 2.4 where 1.5 kPa were declared."""
    found = reduced(off={"pressure": 5e3}, known={"pressure": {"offset_uncertainty": uncertain}})
    assert max(abs(score) for score in scores(found).values()) < 1.3
    assert any(f.level == "doubt" and f.text.startswith("vented, the gauge reads 5 kPa") for f in found.findings)


@pytest.mark.parametrize("uncertain", [0.0, 20e-6])
def test_a_displacement_that_reads_a_length_on_the_support_may_be_wrong(uncertain):
    """It reads -1 mm: F_ce of both methods was K times that off."""
    found = reduced(off={"displacement": -1e-3}, known={"displacement": {"offset_uncertainty": uncertain}})
    assert max(abs(score) for score in scores(found).values()) < 1.3
    forces = [e for e in found.estimates if e.symbol == "F_ce" and e.method == "step-exponential"]
    forces = [e for e in forces if e.value is not None and e.parts.combined is not None]
    assert all(abs(e.value - TRUE["F_ce"](e.at["pressure"])) < 1.3 * e.parts.combined for e in forces)
    assert forces
    assert any(f.level == "doubt" and "the displacement reads -1 mm" in f.text for f in found.findings)


@pytest.mark.parametrize("channel", ["displacement", "pressure", "force"])
def test_a_channel_that_is_polled_ten_times_less_often_is_within(channel):
    """At 50 Hz, held in between: nothing moved by the displacement, and the form was refused by the others."""

    def held(name, values, chance):
        rows = np.arange(len(values)) + int(chance.integers(10))
        return values[np.maximum(rows - rows % 10 - rows[0], 0)] if name == channel else values

    found = reduced(16, 25.0, read_as=held)
    known = scores(found)
    assert sum(symbol in ("F_ce", "K") for symbol, _ in known) >= 6
    assert max(abs(score) for score in known.values()) < 1.5
    assert any(f"the {channel} is new every 20 ms only" in f.text for f in found.findings)


@pytest.mark.parametrize(("channel", "size"), [("displacement", 2e-3), ("pressure", 5e4), ("force", 50.0)])
def test_samples_that_stand_out_alone_are_left_out(channel, size):
    """One in 500: all values were withheld for the form of the model."""
    made = 0

    def disturbed(name, values, chance):
        nonlocal made
        where = (chance.random(len(values)) < 0.002) & (name == channel)
        made += np.count_nonzero(where)
        return values + size * where * chance.choice([-1, 1], len(values))

    run = recorded(16, 25.0, 1, read_as=disturbed)
    [found] = reduce_runs([run])
    known = scores(found)
    assert sum(symbol in ("F_ce", "K") for symbol, _ in known) >= 6
    assert max(abs(score) for score in known.values()) < 1.6
    [doubt] = [f.text for f in found.findings if "stand out alone" in f.text]
    assert abs(int(doubt.split()[0]) - made) <= 0.02 * made
    assert f"of {sum(len(trial.t) for trial in run.trials)} samples of the {channel}" in doubt


def played(values, half):
    """What a sensor shows that keeps its value until it is moved by more than `half` away from it."""
    found, now = np.empty(len(values)), values[0]
    for i, one in enumerate(values):
        found[i] = now = min(max(now, one - half), one + half)
    return found


@pytest.mark.parametrize("noise", [0.0, 250.0])
def test_hysteresis_of_a_gauge_within_its_uncertainty_is_in_the_intervals(noise):
    """Of 500 Pa of 1.5 kPa: B_r was 2 half widths off where the noise comes before it, F_c 3 where it comes after."""
    known = {"pressure": {"offset_uncertainty": 1.5e3, "gain_uncertainty": 5e-3}}

    def read_as(name, values, chance):
        return (
            played(values, 500.0) + (250.0 - noise) * chance.standard_normal(len(values))
            if name == "pressure"
            else values
        )

    found = reduced(16, max(noise, 1e-3), known=known, read_as=read_as)
    assert max(abs(score) for score in scores(found).values()) < 1.0
    (F_c,) = [e for e in found.estimates if (e.symbol, e.method) == ("F_c", "measured-pressure")]
    assert abs(F_c.value) < 1.5 * F_c.parts.combined
    assert 0.3 < F_c.parts.combined < 1.0


@pytest.mark.parametrize(("bits", "noise", "half", "stuck"), [(16, 250.0, 0.0, False), (9, 25.0, 0.0, False),
                                                              (12, 25.0, 0.0, False), (16, 250.0, 500.0, True)])  # fmt: skip
def test_a_gauge_sticks_that_stays_and_then_moves_by_no_single_steps(bits, noise, half, stuck):
    """Only then are B_c and B_r as wide as that makes them: of steps and noise they were up to four times."""
    chance, step, t = np.random.default_rng(5), 1e6 / 2**bits, np.arange(0.0, 8.0, 1 / RATE)
    P = pressed(t, 3e5) + noise * chance.standard_normal(len(t))
    assert sticks(step * np.round(played(P, half) / step)) is stuck


def test_zeros_that_were_taken_are_in_no_interval():
    found = reduced()
    assert not any("at rest" in line.name for e in found.estimates for line in e.budget)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_pressure_between_its_steps_is_found_while_it_moves(noise):
    """In units of a step: an exponential over 100 of them, to a third of what rounding makes."""
    t = np.arange(0.0, 4.0, 1 / RATE)
    P = 100.3 * (1 - np.exp(-np.maximum(t - 0.5, 0) / 0.5))
    read = np.round(P + noise * np.random.default_rng(1).standard_normal(len(t)))
    rows = (t > 0.55) & (t < 2.0)
    assert sqrt(np.mean((between_steps(read, 1.0) - P)[rows] ** 2)) < 0.1
    assert sqrt(np.mean((read - P)[rows] ** 2)) > 0.28
    assert np.abs(between_steps(read, 1.0) - P).max() < 1.0


def test_a_force_that_is_turned_round_gives_no_value():
    """It was "corrected" by 200 %, and F_ce came out as 275 N +- 605 N."""
    run = recorded(read_as=lambda name, values, _chance: -values if name == "force" else values)
    hung = (replace(trial, point=trial.point | {"mass": trial.point["load"] / 9.81}) for trial in run.trials)
    found = reduce([replace(run, trials=tuple(hung))])
    assert not any(e.value is not None for e in found.estimates)
    assert any(f.level == "fault" and "its sign is wrong" in f.text for f in found.findings)
