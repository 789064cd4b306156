"""Closed loops over several muscles through engine and guard: what a law may not want, and when it is ended."""

import math
import re
from dataclasses import replace

import pytest

from pmabench.engine.laws.platform_loop import PlatformLoop
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import Outcome, run_plan
from pmabench.protocol.plan import Control, Hold, Plan, Record, TrialRecord
from tests.engine.platform_rig import AIMS, SHIPPED, Watched, mounted

DEG = math.pi / 180
RECORD = tuple(channel.name for channel in SHIPPED.bench.channels)


def control(*goals, duration, aims=None, limit=None, **law):
    """A step from level at once and at the times of `goals` (time [s], phi, psi [deg])."""
    goals = [[0.0, 0.0, 0.0], *([t, phi * DEG, psi * DEG] for t, phi, psi in goals)]
    parameters = {"goals": goals, "duration": duration, **law}
    return Control("hold", "platform", aims or AIMS, limit or duration + 1.0, parameters)


def execute(*steps, bench=None, **options) -> Outcome:
    made = mounted(**options)
    if bench is not None:
        made = replace(made, bench=replace(made.bench, **bench))
    inside = (Record("t", True, 0), *steps, Record("t", False, 0))
    plan = Plan("test", "test", "none", "platform", 500.0, RECORD, (TrialRecord(0, {}),), inside)
    Watched.made.clear()
    return run_plan(plan, made, ConfirmedBeforehand(), out=None)


def events(outcome, kind):
    return [data for what, _t, data in outcome.events if what == kind]


def test_a_law_that_wants_more_than_its_step_allows_ends_the_run():
    narrow = AIMS | {"pressure_1": (20e3, 240e3)}
    outcome = execute(control((1.0, -10.0, 0.0), duration=2.0, aims=narrow))
    assert outcome.status == "error"
    assert 'the law "platform" wants' in outcome.why
    assert outcome.vent.confirmed


def test_a_bench_with_a_lower_limit_of_one_muscle_refuses_in_the_guard():
    made = mounted().bench
    low = tuple(replace(aim, high=260e3) if aim.name == "pressure_1" else aim for aim in made.aims)
    outcome = execute(control((1.0, -10.0, 0.0), duration=2.0), bench={"aims": low})
    assert re.search(r"for pressure_1 is outside 20 kPa to 260 kPa \(.*mock-platform.yaml:\d+:\d+\)", outcome.why)
    assert outcome.vent.confirmed


def test_a_law_that_does_not_end_is_ended():
    outcome = execute(control(duration=5.0, limit=0.5))
    (found,) = events(outcome, "found")
    assert (found["result"]["found"], found["result"]["reason"]) == (False, "not done within 0.5 s")


def test_between_loops_the_valves_are_shut_and_the_platform_stays():
    outcome = execute(control(duration=1.5), Hold("rest", 1.0), control(duration=0.5))
    assert outcome.status == "finished"
    assert len(events(outcome, "found")) == 2


def test_the_law_of_the_platform_sees_every_sample(monkeypatch):
    """Its watch, too: 500 a second; only its pulses come every 20 ms."""
    seen = []
    update = PlatformLoop.update
    monkeypatch.setattr(PlatformLoop, "update", lambda law, t, values: (seen.append(t), update(law, t, values))[1])
    execute(control(duration=1.0))
    assert len(seen) == pytest.approx(501, abs=1)


def test_a_plan_knows_how_long_a_loop_takes_and_what_it_may_command():
    step = control(duration=2.0)
    assert (step.shortest(), step.longest()) == (2.0, 3.0)
    assert step.commands()["pressure_3"] == (20e3, 550e3)
