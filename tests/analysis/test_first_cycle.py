"""The wider first loop of a rested muscle: against the law of the reference page, stepped here, and on the mock bench.

The page: H(P) (1 + 0.6 exp(-n)), n full cycles since a long rest.
"""

from dataclasses import replace
from math import exp

import numpy as np
import pytest

from pmabench.cli.prepare import prepare
from pmabench.kinds.isobaric_ramp.reduction import reduce
from pmabench.protocol.plan import Hold, Record
from pmabench.store.reader import open_run
from pmabench.store.records import Flag
from tests.analysis.judged_forms import as_run, as_trials
from tests.judge.record import Ramp, Trial
from tests.test_real_bench import ran

RATE, STROKE, CYCLES, DISCARD, P = 100.0, 40.0, 6, 3, 350.0
RADII, WEIGHTS = np.array([0.2, 0.8, 2.5, 8.0]), np.array([0.2, 0.3, 0.3, 0.2])
TIMES = np.array([0.5, 1.58, 5.0, 15.8, 50.0, 158.0])


def loops(seed, extra=0.6, speeds=(2.0, 10.0), height=1.0):
    """The page's muscle at a constant pressure [kPa], mm and N, one trial a speed [mm/s], with noise of 0.3 N."""
    random, start, stops, crept, cycle = np.random.default_rng(seed), 0.0, np.zeros(4), np.zeros(6), 0
    trials = []
    for v in speeds:
        ramp, before = STROKE / v, 0.0
        t = np.arange(0.0, 2 * CYCLES * ramp + 0.5, 1 / RATE)
        x = STROKE * np.clip(1 - np.abs(np.mod(t, 2 * ramp) / ramp - 1), 0, 1) * (t < 2 * CYCLES * ramp)
        F = np.empty(len(t))
        for row, (now, place) in enumerate(zip(t, x, strict=True)):
            n = cycle + min(int(now / (2 * ramp)), CYCLES)
            stops = np.clip(stops + place - before, -RADII, RADII)
            crept += (0.004 * place - crept) * (1 - np.exp(-1 / RATE / TIMES))
            kappa = (place - crept.sum()) / 2.5
            F[row] = (244.7 - 0.1115 * P) * exp(-0.334 * kappa) - 0.0830 * kappa * P + 2.650 * P - 249.4 - 18.0
            F[row] -= height * (5.0 + 0.05 * P) * (1 + extra * exp(-n)) * float(WEIGHTS @ (stops / RADII))
            speed = (place - before) * RATE
            F[row] -= (1.0 + 0.002 * P if speed > 0 else 0.7 + 0.0015 * P) * speed
            before = place
        cycle += CYCLES
        commands = tuple(
            Ramp(start + k * ramp, "displacement", *((40e-3, 0.0) if k % 2 == 0 else (0.0, 40e-3)),
                 ("contract", "expand")[k % 2], v * 1e-3) for k in range(2 * CYCLES)
        )  # fmt: skip
        channels = {"displacement": 1e-3 * x + random.normal(0, 2e-6, len(t)), "force": F + random.normal(0, 0.3, len(t)),
                    "pressure": np.full(len(t), 1e3 * P)}  # fmt: skip
        point = {"pressure": 1e3 * P, "speed": v * 1e-3, "lower": 0.0, "upper": 40e-3}
        trials.append(Trial(point, 1, start + t, channels, commands))
        start += float(t[-1]) + 5.0
    return as_trials(trials)


def h_1(trials, **settings):
    run = as_run("isobaric-ramp", trials, RATE, {"discard": DISCARD, "turn": 1e-3, "rest": 1800.0, **settings})
    return [e for e in reduce([run]).estimates if e.symbol == "h_1"]


@pytest.mark.parametrize("seed", range(3))
def test_the_share_of_the_page_is_within_the_interval(seed):
    (e,) = h_1(loops(seed))
    assert e.ci95[0] <= 0.6 <= e.ci95[1]
    assert e.parts.combined < 0.15
    assert "after a rest of" in e.note


def test_a_muscle_without_it_has_none():
    (e,) = h_1(loops(7, extra=0.0))
    assert e.ci95[0] <= 0.0 <= e.ci95[1]
    assert e.parts.combined < 0.05


@pytest.mark.parametrize(
    ("speeds", "settings", "words"),
    [
        ((2.0, 10.0), {"rest": 60.0}, "let it rest for"),
        ((2.0, 10.0), {"discard": 4}, "there are 2"),
        ((2.0,), {}, "one speed only"),
    ],
)
def test_it_is_withheld_where_the_data_do_not_show_it(speeds, settings, words):
    (e,) = h_1(loops(1, speeds=speeds), **settings)
    assert e.value is None
    assert words in e.note


def test_loops_that_still_fade_are_no_reference():
    (e,) = h_1(loops(1, extra=3.0), discard=1)
    assert e.value is None
    assert "still change by" in e.note


def test_where_creep_alone_makes_the_loops_nothing_is_wider():
    (e,) = h_1(loops(1, height=0.0))
    assert e.ci95[0] <= 0.0 <= e.ci95[1]


def test_a_first_loop_that_was_slack_is_no_first_loop():
    first, *others = loops(1)
    slack = np.where(first.t < 15.0, np.uint16(Flag.SLACK), first.flags)
    (e,) = h_1([replace(first, flags=slack), *others])
    assert e.value is None
    assert "slack" in e.note


SETTINGS = [
    ("sweep.matrix.pressure", "[350 kPa]"), ("sweep.matrix.speed", "[2 mm/s, 10 mm/s]"), ("trial.upper", "40 mm"),
    ("trial.cycles", "6"), ("trial.discard", "3"), ("sample_rate", "100 Hz"),
]  # fmt: skip


@pytest.mark.parametrize("creep", [0.0, 1.0])
def test_on_the_mock_bench_after_a_rest(tmp_path, creep):
    """There n is the way over that of a cycle of 40 mm: the middle is passed after 1/4 and 3/4 of it."""
    settings = [*SETTINGS, ("prepare", "{rest: 30 min}")]
    folder = ran(tmp_path, "isobaric-ramp", "mock-real-actuator", settings, creep=creep, first_cycle=0.6)
    (e,) = [e for e in reduce([open_run(folder)]).estimates if e.symbol == "h_1"]
    assert e.ci95[0] <= 0.6 * 0.5 * (exp(-0.25) + exp(-0.75)) <= e.ci95[1]
    assert e.parts.combined < 0.08


@pytest.mark.parametrize("prepare_", ["{}", "{precondition: {cycles: 2, pressure: 300 kPa, hold: 1 s}}"])
def test_without_a_recorded_rest_there_is_no_such_row(tmp_path, prepare_):
    """As in a file of another program, which does not say how long the muscle rested."""
    settings = [*SETTINGS, ("prepare", prepare_), ("sweep.matrix.speed", "[10 mm/s, 20 mm/s]")]
    folder = ran(tmp_path, "isobaric-ramp", "mock-real-actuator", settings, first_cycle=0.6)
    assert [e for e in reduce([open_run(folder)]).estimates if e.symbol == "h_1"] == []


def test_the_rest_comes_before_the_first_trial_and_after_preconditioning():
    both = "{precondition: {cycles: 1, pressure: 300 kPa, hold: 1 s}, rest: 20 min}"
    plan = prepare("isobaric-ramp", "mock-real-actuator", "dmsp-20-250-real", [*SETTINGS, ("prepare", both)]).plan
    holds = [(n, s.duration) for n, s in enumerate(plan.steps) if isinstance(s, Hold) and s.phase == "precondition"]
    first = next(n for n, s in enumerate(plan.steps) if isinstance(s, Record))
    assert [seconds for _, seconds in holds] == [1.0, 1.0, 1200.0]
    assert holds[-1][0] < first
    assert plan.settings["rest"] == 1200.0
