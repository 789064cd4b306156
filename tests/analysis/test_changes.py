"""Somebody changes a gain, or a mount slips, in the middle of a run: small benches in closed form, all in arrays.

The trials after the change agree with each other, so their scatter says nothing. Values had intervals 3 to 41 times too
small, without a doubt. Who was right, before or after, is not known: a value holds the truth, or there is none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from pmabench.analysis.shared.changes import Rows, followed
from pmabench.kinds.reduce import reduce_runs
from pmabench.store.analyses.results import Analysis, Estimate
from pmabench.store.records import Command, RunData, TrialData
from tests.analysis.judged_forms import as_run
from tests.analysis.sine_rig import Muscle51

RATE, LOWER, UPPER, LAG = 100.0, 0.0, 0.02, 5e-3
PRESSURES, SPEEDS, CYCLES = (2e5, 3e5, 4e5), (2e-3, 5e-3), 4
DAMPING, FRICTION = 2000.0, 3.0
Alter = Callable[[str, np.ndarray, np.ndarray], np.ndarray]


def F_ce(P: float) -> float:
    return 1.08e-3 * P - 49.0


def K(P: float) -> float:
    return 5600.0 + 1.0e-3 * P + 9.7e-9 * P * P


def ramps(alter: Alter, seed: int = 1) -> RunData:
    """Ramps both ways of a muscle F = F_ce - K x - B v -+ F_c by a drive that lags; `alter` (channel, t, y) is wrong."""
    random, trials, begin = np.random.default_rng(seed), list[TrialData](), 20.0
    for P in PRESSURES:
        for speed in SPEEDS:
            leg = (UPPER - LOWER) / speed
            n = int((2 * CYCLES * leg + 1.0) * RATE)
            t = begin + np.arange(n) / RATE

            def place(since: np.ndarray, leg: float = leg, speed: float = speed) -> np.ndarray:
                phase = np.clip(since, 0.0, 2 * CYCLES * leg) % (2 * leg)
                return LOWER + speed * np.minimum(phase, 2 * leg - phase)

            sent = place(t - begin)
            x = place(t - begin - LAG)
            v = speed * np.sign(np.gradient(x))
            F = F_ce(P) - K(P) * x - DAMPING * v - FRICTION * np.sign(v)
            channels = {
                "pressure": P + 100.0 * random.standard_normal(n),
                "displacement": x + 2e-6 * random.standard_normal(n),
                "force": F + 0.1 * random.standard_normal(n),
                "displacement_command": sent + 1e-5 * random.standard_normal(n),  # read from an analog output
            }
            legs = [begin + leg * k for k in range(2 * CYCLES)]
            commands = tuple(
                Command(at, "displacement", "ramp", *((LOWER, UPPER) if k % 2 else (UPPER, LOWER)),
                        "expand" if k % 2 else "contract", {"rate": speed})
                for k, at in enumerate(legs)
            )  # fmt: skip
            point = {"pressure": P, "speed": speed, "lower": LOWER, "upper": UPPER, "cycles": float(CYCLES)}
            made = {name: alter(name, t, y) for name, y in channels.items()}
            trials.append(
                TrialData(
                    "lab", len(trials), point, 0, False, "finished", t, made, np.zeros(n, np.uint16), commands, {}
                )
            )
            begin = float(t[-1]) + 5.0
    known = {
        "displacement": {"gain_uncertainty": 5e-4, "offset_uncertainty": 2e-5},
        "force": {"gain_uncertainty": 2e-3, "offset_uncertainty": 1.0},
        "pressure": {"gain_uncertainty": 2e-3, "offset_uncertainty": 1500.0},
    }
    return as_run("isobaric-ramp", trials, RATE, {"discard": 1, "turn": 1e-3}, known)


def middle(run: RunData, share: float = 0.3) -> float:
    """A time in the middle of the trial that holds this share of the run [s]."""
    trial = run.trials[int(share * len(run.trials)) + 1]
    return float(trial.t[len(trial.t) // 2])


def changed(channel: str, since: float, gain: float = 0.0, offset: float = 0.0) -> Alter:
    return lambda name, t, y: y + np.where((t >= since) & (name == channel), gain * y + offset, 0.0)


def good(_name: str, _t: np.ndarray, y: np.ndarray) -> np.ndarray:
    return y


def truth(e: Estimate) -> float | None:
    P = e.at["pressure"]
    x = e.at.get("contraction", 0.5 * (LOWER + UPPER))
    return {"K": K(P), "F_ce": F_ce(P), "F": F_ce(P) - K(P) * x, "B": DAMPING}.get(e.symbol)


def wrong(
    analysis: Analysis, of: Callable[[Estimate], float | None]
) -> list[tuple[str, dict[str, float], float, float]]:
    """Values whose interval does not hold the truth, with how many half widths they are off."""
    found = []
    for e in analysis.estimates:
        true = of(e)
        if e.value is None or e.withheld or true is None or not e.parts.combined:
            continue
        off = abs(e.value - true) / e.parts.combined
        if off > 1:
            found.append((e.symbol, dict(e.at), round(off, 2), e.value))
    return found


def doubts(analysis: Analysis, text: str) -> list[str]:
    return [f.text for f in analysis.findings if f.level == "doubt" and text in f.text]


WRONG = [
    ("displacement", 0.06, 0.0, "compared with its command", 0.0),
    ("displacement", -0.03, 0.0, "compared with its command", 7.0),
    ("displacement", 0.0, 1e-3, "compared with its command", 7.0),
    ("force", 0.06, 0.0, "the force at the same places changed", 7.0),
    ("force", 0.0, 15.0, "the force at the same places changed", 0.0),
]
"""Channel, what happens to it, what is said, and how long after the end of a cycle [s]: of each channel one in a cycle."""


@pytest.mark.parametrize(("channel", "gain", "offset", "said", "later"), WRONG)
def test_a_sensor_changed_in_the_middle_of_ramps_is_in_every_interval_and_said(channel, gain, offset, said, later):
    """At the end of a cycle, or within one, which then has neither the scale before nor that after."""
    since = middle(ramps(good)) + later
    (analysis,) = reduce_runs([ramps(changed(channel, since, gain, offset))])
    assert not wrong(analysis, truth)
    assert any(e.withheld for e in analysis.estimates)
    (text,) = doubts(analysis, said)
    when = float(text.split("from ")[1].removeprefix("about ").split(" s on")[0])
    cycle = 2 * (UPPER - LOWER) / SPEEDS[0]
    assert since - cycle <= when <= since + 1.0


def test_a_drive_that_goes_further_than_it_is_sent_from_the_middle_on_is_said_as_well():
    """The record does not show whether sensor or drive is wrong."""
    since = middle(ramps(good))
    run = ramps(good)
    trials = [
        replace(t, channels={**t.channels, "displacement_command": np.where(t.t >= since, 0.95, 1.0) * t.channels["displacement_command"]})
        for t in run.trials
    ]  # fmt: skip
    (analysis,) = reduce_runs([replace(run, trials=tuple(trials))])
    assert doubts(analysis, "compared with its command")
    assert not wrong(analysis, truth)


def test_a_displacement_that_is_off_its_command_throughout_is_a_doubt():
    (analysis,) = reduce_runs([ramps(changed("displacement", 0.0, 0.03))])
    assert len(doubts(analysis, "+3.0% of the way that the drive was sent")) == 1


@pytest.mark.parametrize("offset", [2e-3, 1e-3, -4e-4])
def test_a_place_that_differs_from_the_command_throughout_is_in_the_intervals(offset):
    """The forces along the stroke then belong to other contractions: they were 6 half widths off at 2 mm, said and not held."""
    (slipped,) = reduce_runs([ramps(changed("displacement", 0.0, 0.0, offset))])
    assert len(doubts(slipped, f"{1e3 * offset:g} mm off the place where it was sent")) == 1
    assert not wrong(slipped, truth)


@pytest.mark.parametrize("imported", [False, True])
@pytest.mark.parametrize("gain", [0.015, 0.06, -0.05])
@pytest.mark.parametrize("channel", ["displacement", "displacement_command"])
def test_a_scale_that_differs_from_the_command_throughout_is_in_the_intervals(channel, gain, imported):
    """K was up to 6 half widths off; of imports nothing was said. Either of the two channels may be wrong."""
    run = ramps(changed(channel, 0.0, gain))
    if imported:
        run = replace(run, manifest={**run.manifest, "imported": {"file": "log.csv", "test": "T1"}})
    (analysis,) = reduce_runs([run])
    assert doubts(analysis, "of the way that the drive was sent")
    for e in (e for e in analysis.estimates if e.symbol == "K" and truth(e) is not None):
        assert e.value is not None
        without = replace(e.parts, drift=0.0).combined
        assert abs(e.value - truth(e)) < e.parts.combined <= without + 3 * abs(gain) * e.value
    if not imported:  # the zero of an imported command is not known
        assert not wrong(analysis, truth)


@pytest.mark.parametrize("seed", range(2))
def test_nothing_is_said_of_good_ramps_and_their_values_stay_sharp(seed):
    (analysis,) = reduce_runs([ramps(good, seed)])
    assert not wrong(analysis, truth)
    assert not doubts(analysis, "changed")
    assert not doubts(analysis, "sensor or drive")
    for e in (e for e in analysis.estimates if (e.symbol, e.method) == ("F", "mean-curve, local")):
        assert e.parts.combined is not None
        assert e.parts.combined < 0.02 * F_ce(e.at["pressure"])
        assert e.parts.drift == 0.0


def sines(alter: Alter) -> Sequence[TrialData]:
    """Three blocks of sines of plant 5.1 by a drive that lags."""
    found = []
    muscle = Muscle51(noise=(2e-6, 0.1, 100.0), lag=LAG)
    for trial in muscle.trials(3):
        point, begin = trial.point, float(trial.t[0])
        sent = point["mean"] + point["amplitude"] * np.sin(2 * np.pi * point["frequency"] * (trial.t - begin))
        channels = {**trial.channels, "displacement_command": sent}
        found.append(replace(trial, channels={name: alter(name, trial.t, y) for name, y in channels.items()}))
    return found


@pytest.mark.parametrize(("channel", "gain"), [("displacement", 0.06), ("force", 0.06), ("none", 0.0)])
def test_a_gain_changed_in_the_middle_of_sines(channel, gain):
    """A gain changed in the last trials: two of three repeats, and the extrapolation over all frequencies, were before."""
    run = as_run("sinusoidal-displacement", sines(changed(channel, 845.0, gain)), 500.0, {"discard": 1})
    (analysis,) = reduce_runs([run])
    true = {"K": 6773.0, "B": 1900.0}
    assert not wrong(analysis, lambda e: true.get(e.symbol) if e.method == "sine-harmonic" else None)
    assert bool(doubts(analysis, "changed")) == (gain > 0)


LENGTH, MOST = 0.3, 0.08
LEVELS = (0.0, 100e3, 200e3, 350e3, 500e3)


def contraction(P: np.ndarray) -> np.ndarray:
    """Of a muscle without load [m]."""
    return MOST * (1 - np.exp(-np.maximum(P, 0.0) / 150e3))


def lengths(alter: Alter) -> RunData:
    """Three blocks of rests at each pressure, reached from 0."""
    random, trials = np.random.default_rng(3), list[TrialData]()
    for repeat in range(3):
        for P_set in LEVELS:
            t = 10.0 * len(trials) + np.arange(0.0, 6.0, 0.02)
            P = P_set * np.clip(t - t[0] - 2.0, 0.0, 1.0)
            channels = {
                "pressure": P + 50.0 * random.standard_normal(len(t)),
                "displacement": contraction(P) + 3e-6 * random.standard_normal(len(t)),
            }
            ramp = Command(t[0] + 2.0, "pressure", "ramp", P_set, 0.0, "fill", {"rate": max(P_set, 1.0)})
            made = {name: alter(name, t, y) for name, y in channels.items()}
            flags = np.zeros(len(t), np.uint16)
            point = {"pressure": P_set, "side": -1.0}
            trials.append(TrialData("lab", len(trials), point, repeat, False, "finished", t, made, flags, (ramp,), {}))
    known = {"displacement": {"gain_uncertainty": 5e-4}, "pressure": {"gain_uncertainty": 2e-3}}
    return as_run("free-contraction", trials, 50.0, {"nominal_length": LENGTH}, known)


def length(e: Estimate) -> float | None:
    x = float(contraction(np.array(e.at.get("pressure", 0.0))))
    return {"L": LENGTH - x, "eps_max": x / LENGTH}.get(e.symbol) if not e.coordinate else None


@pytest.mark.parametrize("rate", [0.0, 3e-4])
@pytest.mark.parametrize("gain", [0.05, -0.05])
def test_what_the_repeats_of_some_pressures_show_is_in_the_lengths_at_all_of_them(gain, rate):
    """At the last two pressures all repeats lie after the change: 41 half widths off. The same for a drift by `rate`."""

    def alter(name: str, t: np.ndarray, y: np.ndarray) -> np.ndarray:
        by = np.sign(gain) * rate * t if rate else np.where(t >= 28.0, gain, 0.0)
        return y * (1 + by) if name == "displacement" else y

    (analysis,) = reduce_runs([lengths(alter)])
    assert not wrong(analysis, length)
    assert doubts(analysis, "the contraction changed")


def test_good_lengths_stay_as_sharp_as_they_are():
    (analysis,) = reduce_runs([lengths(good)])
    assert not wrong(analysis, length)
    assert not doubts(analysis, "changed")
    assert max(e.parts.combined or 0.0 for e in analysis.estimates if e.symbol == "L" and not e.coordinate) < 0.3e-3


def test_what_the_speed_makes_of_the_force_is_no_change():
    """Trials of one speed after the other at each pressure, whose force rises with the speed, bent, as with damping."""
    speeds = np.repeat([2.0, 9.0, 23.0, 46.0, 138.0], 5)
    rows = [(cell, 100.0 * cell + n, 500.0 * (cell + 1) * (1 + 6e-4 * v - 1e-6 * v * v), v)
            for cell in (0.0, 1.0) for n, v in enumerate(speeds)]  # fmt: skip
    good = Rows(*np.array(rows).T)
    assert good.change() is None
    later = Rows(good.cell, good.t, good.value * np.where(good.t > 107.0, 1.04, 1.0), good.rate)
    found = later.change()
    assert found is not None
    assert found.time == pytest.approx(108.0)
    assert found.size == pytest.approx(0.04, rel=0.3)


def holds(alter: Alter) -> RunData:
    """Rests of the drive at four places, twice."""
    random, trials = np.random.default_rng(6), list[TrialData]()
    for place in (0.0, 0.01, 0.02, 0.03) * 2:
        t = 100.0 * len(trials) + np.arange(0.0, 50.0, 0.1)
        channels = {
            "displacement": place + 2e-6 * random.standard_normal(len(t)),
            "displacement_command": np.full(len(t), place),
        }
        made = {name: alter(name, t, y) for name, y in channels.items()}
        flags = np.zeros(len(t), np.uint16)
        trials.append(
            TrialData("lab", len(trials), {"contraction": place}, 0, False, "finished", t, made, flags, (), {})
        )
    return as_run("relaxation", trials, 10.0, {})


def test_rests_of_a_drive_show_a_slip_but_a_constant_scale_is_a_difference_only():
    assert followed(holds(good)) is None
    slipped = followed(holds(changed("displacement", 420.0, 0.0, 1e-3)))
    assert slipped is not None
    assert (slipped.gain, slipped.offset) == (0.0, pytest.approx(1e-3, rel=0.01))
    assert "from 420 s on, in trial 5" in slipped.text
    scaled = followed(holds(changed("displacement", 0.0, 0.04)))
    assert scaled is not None
    assert scaled.throughout
    assert -1.5 * 0.04 < scaled.gain < 1 / 1.04 - 1, "back to the command at least"
    assert "+4.0% of the way" in scaled.text


@pytest.mark.parametrize("seed", range(8))
def test_noise_on_a_short_way_is_no_change_of_scale_but_one_above_the_noise_is(seed):
    """A drive that goes to each place and back, over 1 to 12 mm; nearly all samples are at either end."""
    random, trials = np.random.default_rng(seed), list[TrialData]()
    for travel in (2e-3, 4e-3, 4e-3, *(6e-3 * n for n in range(1, 6))) * 2:
        t = 100.0 * len(trials) + np.arange(0.0, 60.0, 0.1)
        sent = np.interp(t - t[0], (1.0, 1.4, 30.0, 30.4), (0.0, travel, travel, 0.0))
        channels = {
            "displacement": sent + 4e-6 * random.standard_normal(len(t)),
            "displacement_command": sent,
        }
        flags = np.zeros(len(t), np.uint16)
        trials.append(
            TrialData("lab", len(trials), {"contraction": 0.0}, 0, False, "finished", t, channels, flags, (), {})
        )
    assert followed(as_run("isometric-pressurisation", trials, 10.0, {})) is None
    later = [
        replace(one, channels=one.channels | {"displacement": 1.01 * one.channels["displacement"]})
        for one in trials[8:]
    ]
    assert "from 8" in followed(as_run("isometric-pressurisation", [*trials[:8], *later], 10.0, {})).text
