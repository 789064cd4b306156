"""Faults of plant and sensors on the mock bench: which limit trips, what is recorded, how soon it vents (S2)."""

import math
import os
import re
import signal
from dataclasses import replace
from types import SimpleNamespace

import pytest

from pmabench.base.clock import VirtualClock
from pmabench.bench.interface import TripRecord
from pmabench.engine import run as run_module
from pmabench.engine.acquire import Acquisition
from pmabench.engine.bench_checks import await_drives
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.recorder import NoRecord
from pmabench.engine.run import run_plan
from pmabench.guard.guard import Guard
from pmabench.protocol.plan import Follow, Hold, Ramp, Record, Set, WaitUntil
from tests.engine.benches import STEPS, mounted, one_trial, plan

SAMPLE = 1 / 500.0


def limited(*trips, name="mock", **options):
    made = mounted(name, **options)
    return replace(made, bench=replace(made.bench, trips=(*made.bench.trips, *trips)))


def limit(kind, channel="pressure", **changes):
    given = {"low": None, "high": None, "delay": 0.0, "action": "vent", "source": "test:1:1", **changes}
    return TripRecord(channel, kind=kind, **given)


def execute(made, steps, **options):
    return run_plan(one_trial(*steps), made, ConfirmedBeforehand(), out=None, **options)


def event(outcome, kind):
    return next((t, data) for k, t, data in outcome.events if k == kind)


HOLD = (Set("h", "pressure", 3e5), Hold("h", 8.0))
FALL = (Set("h", "pressure", 3e5), Hold("h", 2.5), Ramp("r", "pressure", 3e5, 0.0, 5e4))
FAULTS = {
    # name: limits on top, options of the mock, steps, kind of limit and channel that trip, earliest and latest [s]
    "regulator sticks, and too much contraction": (
        (limit("range", "displacement", high=0.030),), {"faults": {"regulator_stuck_at": 5.0}},
        (Set("h", "pressure", 5.5e5), Hold("h", 8.0)), "range", "displacement", 3.0, 6.0,
    ),
    "no number": ((), {"faults": {"nan_at": 5.0}}, HOLD, "range", "pressure", 5.0, 5.01),
    "sensor at its end": ((), {"errors": {"pressure": {"end": "high", "at": 5.0}}}, HOLD, "range", "pressure", 5.0, 5.01),
    "cut wire": ((), {"errors": {"pressure": {"end": "low", "at": 5.0}}}, HOLD, "range", "pressure", 5.0, 5.01),
    "stuck sensor": ((limit("frozen", delay=0.5),), {"faults": {"pressure_stuck_at": 5.0}}, HOLD, "frozen", "pressure", 5.49, 5.51),
    "burst": ((limit("burst", high=60e3, window=0.05),), {"faults": {"burst_at": 6.0}}, HOLD, "burst", "pressure", 6.0, 6.1),
    "supply lost": ((limit("following", high=60e3, delay=0.3),), {"faults": {"supply_lost_at": 6.0}}, HOLD,
                    "following", "pressure", 6.3, 6.9),
    "regulator sticks while it should fall": ((limit("following", high=60e3, delay=0.3),), {"faults": {"regulator_stuck_at": 5.0}},
                                              FALL, "following", "pressure", 6.5, 8.5),
    "jump of the sensor": ((limit("rate", high=9e6),), {"errors": {"pressure": {"offset": 2e5, "at": 5.0}}}, HOLD,
                           "rate", "pressure", 5.0, 5.05),
    "slack": ((limit("slack", "force", low=-20.0, delay=0.05),), {"errors": {"force": {"offset": -400.0, "at": 5.0}}}, HOLD,
              "slack", "force", 5.04, 5.06),
    "off range": ((limit("off-range", "force", delay=0.01),), {"errors": {"force": {"end": "low", "at": 5.0}}}, HOLD,
                  "off-range", "force", 5.0, 5.02),
}  # fmt: skip


@pytest.fixture
def commands(monkeypatch):
    """When the safe state was begun [s]."""
    begun = []
    begin = Guard.begin_safe

    def noted(self, **how):
        begun.append(self.clock.now())
        begin(self, **how)

    monkeypatch.setattr(Guard, "begin_safe", noted)
    return begun


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_trips_its_limit_and_vents_at_that_sample(name, commands):
    trips, options, steps, kind, channel, earliest, latest = FAULTS[name]
    outcome = execute(limited(*trips, **options), steps)
    assert (outcome.status, outcome.exit_code) == ("tripped", 5), outcome.why
    _, trip = event(outcome, "trip")
    assert (trip["limit"], trip["channel"]) == (kind, channel), outcome.why
    moment = event(outcome, "trip")[0]
    assert earliest <= moment <= latest, outcome.why
    assert commands[0] - moment <= SAMPLE + 1e-9, "time from the sample to the vent"
    assert [k for k, _, _ in outcome.events if k in {"trip", "vent"}] == ["trip", "vent"]


LATE = (Hold("rest", 3.0), *HOLD)


@pytest.mark.parametrize(
    ("trip", "faults", "result"),
    [
        (limit("following", high=60e3, delay=0.3), {"pressure_stuck_at": 5.0}, "commanded"),
        (limit("frozen", delay=0.5), {"pressure_stuck_at": 5.0}, "commanded"),
        (limit("following", high=60e3, delay=0.3), {"supply_lost_at": 9.0}, "confirmed"),
        (limit("following", high=60e3, delay=0.3, action="stop"), {"pressure_stuck_at": 5.0}, "commanded"),
        (limit("following", high=60e3, delay=0.3, action="hold"), {"pressure_stuck_at": 5.0}, "commanded"),
    ],
)
def test_a_gauge_that_ended_the_run_as_it_does_not_move_confirms_no_vent(trip, faults, result):
    """It reads 0 with 300 kPa in the muscle; one that reads high, and then falls, confirms."""
    made = limited(trip, faults=faults)
    made = replace(made, bench=replace(made.bench, stop_rate=2e5))
    outcome = execute(made, LATE)
    assert outcome.vent.result == result
    assert outcome.exit_code == 5
    assert any("has not moved: it confirms nothing" in text for text in outcome.vent.actions) == (result == "commanded")


@pytest.mark.parametrize("kind", STEPS)
@pytest.mark.parametrize("name", ["no number", "sensor at its end"])
def test_a_fault_is_seen_in_every_kind_of_step(name, kind, commands):
    trips, options, *_ = FAULTS[name]
    outcome = execute(limited(*trips, **options), STEPS[kind])
    assert outcome.status == "tripped"
    assert commands[0] - event(outcome, "trip")[0] <= SAMPLE + 1e-9


@pytest.mark.parametrize("kind", ["hold", "seek sampled"])
def test_a_gap_longer_than_its_limit_trips_where_the_limit_is_shorter(monkeypatch, kind):
    """In virtual time samples come in blocks of at most a second; a silent device gives none."""
    from pmabench_drivers.mock import MockBench

    from pmabench.bench.interface import Block

    real = MockBench.collect

    def silent(self):
        block = real(self)
        return block if self._clock.now() < 5.0 else Block([], {name: [] for name in block.columns})

    monkeypatch.setattr(MockBench, "collect", silent)
    outcome = execute(limited(limit("stale", delay=0.25)), STEPS[kind])
    assert outcome.status == "tripped"
    assert "has given no sample" in outcome.why
    assert outcome.vent.result == "commanded"


# -- a driven end, on the shipped bench ------------------------------------------------------------------------------

SINES = (Ramp("approach", "displacement", 0.0, 0.01, 0.02), Follow("s", "displacement", 0.01, 5e-3, 0.5, 4),
         Ramp("return", "displacement", 0.01, 0.0, 0.02))  # fmt: skip
DRIVES = {
    # error of the displacement, what it says, and where it is stopped at the latest [m]
    "counts the other way": ({"factor": -1.0}, "(below its limit -3 mm|further than 2 mm)", 0.009),
    "counts twice as far": ({"factor": 2.0}, "further than 2 mm", 0.017),
    "runs away upwards": ({"offset": 0.02, "at": 5.0}, "further than 2 mm", 0.036),
    "runs away downwards": ({"offset": -0.03, "at": 5.0}, "below its limit -3 mm", 0.04),
    "the encoder stands": ({"end": "low", "at": 3.0}, "below its limit -3 mm", 0.02),
}
"""As the encoder sees them; a runaway is a jump here."""


def driven(*steps, **options):
    return run_plan(plan(Record("t", True, 0), *steps, Record("t", False, 0)), mounted("mock-actuator", **options),
                    ConfirmedBeforehand(), out=None)  # fmt: skip


def test_a_drive_that_goes_where_it_is_sent_is_left_alone():
    assert driven(*SINES).status == "finished"


@pytest.mark.parametrize("what", DRIVES)
def test_a_drive_that_goes_where_it_was_not_sent_is_stopped(what):
    error, says, most = DRIVES[what]
    outcome = driven(*SINES, errors={"displacement": error})
    assert (outcome.status, outcome.exit_code) == ("tripped", 5), outcome.why
    assert re.search(says, outcome.why), outcome.why
    assert abs(event(outcome, "trip")[1]["value"]) < most


@pytest.mark.parametrize("zero", [9e-3, -2.5e-3])
def test_a_drive_that_lost_its_zero_moves_nothing_and_no_pressure_is_let_in(zero):
    """After a power loss an incremental drive says 0 wherever it stands; only the encoder knows."""
    outcome = driven(Set("p", "pressure", 3e5), *SINES, errors={"displacement": {"offset": zero}})
    assert outcome.status == "tripped", outcome.why
    assert "sent to 0 mm, and displacement stays at" in outcome.why
    assert not [data for kind, _, data in outcome.events if kind == "command"]


def test_a_drive_on_its_way_to_where_arming_sent_it_is_waited_for(monkeypatch):
    places = iter((0.02, 0.012, 0.006, 0.001))
    acquisition = SimpleNamespace(latest={"displacement": 0.03}, passed=0.0)

    def pass_time(seconds):
        acquisition.passed += seconds
        acquisition.latest["displacement"] = next(places)

    acquisition.pass_time = pass_time
    await_drives(mounted("mock-actuator").bench, acquisition)
    assert acquisition.passed == 2.0


# -- a stop that is controlled --------------------------------------------------------------------------------------


def stoppable(*trips, **options):
    made = limited(*trips, **options)
    return replace(made, bench=replace(made.bench, stop_rate=1e5))


def test_a_stop_takes_the_pressure_down_at_its_rate_and_is_not_cut_by_its_own_cause():
    made = stoppable(limit("range", "displacement", high=0.02, action="stop"))
    outcome = execute(made, HOLD)
    stopped, how = event(outcome, "controlled-stop")
    assert how == {"origin": 3e5, "rate": 1e5}
    vented = event(outcome, "vent")[0]
    assert vented - stopped >= 3.0 - 1e-6, "the ramp takes 3 s"
    assert (outcome.status, outcome.vent.result) == ("tripped", "confirmed")
    assert sum(kind == "trip" for kind, _, _ in outcome.events) == 1


def test_a_stop_that_the_pressure_does_not_follow_is_vented_at_once(monkeypatch):
    """A regulator that sticks at 300 kPa, as its gauge shows; the ramp alone would take 12 s."""
    from pmabench_drivers.mock import MockBench

    real = MockBench.collect

    def stuck(self):
        block = real(self)
        if len(block.time) and block.time[-1] * 1e-9 > stops:
            held.append(block.columns["pressure"][0])
            return replace(block, columns={**block.columns, "pressure": [held[0]] * len(block.time)})
        return block

    made = stoppable(limit("range", "displacement", high=0.03, action="stop"))
    made = replace(made, bench=replace(made.bench, stop_rate=25e3))
    free = execute(made, HOLD)
    assert event(free, "vent")[0] - event(free, "controlled-stop")[0] >= 12.0 - 1e-6, "it follows: nothing is cut"
    assert not [data for kind, _, data in free.events if kind == "warning"]
    stops, held = event(free, "controlled-stop")[0], []
    monkeypatch.setattr(MockBench, "collect", stuck)
    outcome = execute(made, HOLD)
    stopped, warned = event(outcome, "controlled-stop")[0], event(outcome, "warning")
    assert 1.5 <= warned[0] - stopped < 4.0
    assert "kPa where the stop commands" in warned[1]["reason"]
    assert event(outcome, "vent")[0] - warned[0] < 8.0, "no longer than the vent itself takes to be given up"


def test_a_limit_that_vents_cuts_a_controlled_stop():
    made = stoppable(
        limit("range", "displacement", high=0.02, action="stop"),
        errors={"force": {"end": "high", "at": 7.0}},
    )
    outcome = execute(made, (Set("h", "pressure", 3e5), Hold("h", 8.0)))
    stopped, vented = event(outcome, "controlled-stop")[0], event(outcome, "vent")[0]
    if stopped < 7.0:
        assert vented < 7.0 + 1.5
    assert outcome.status == "tripped"
    assert "displacement" in outcome.why


def test_a_controlled_stop_is_no_burst_and_no_following_error(commands):
    made = stoppable(limit("range", "displacement", high=0.02, action="stop"), limit("burst", high=4e3, window=0.05),
                     limit("following", high=60e3, delay=0.5))  # fmt: skip
    outcome = execute(made, HOLD)
    assert sum(kind == "trip" for kind, _, _ in outcome.events) == 1
    assert event(outcome, "vent")[0] - event(outcome, "controlled-stop")[0] >= 3.0 - 1e-6


def test_the_proof_test_is_no_burst():
    made = limited(limit("burst", high=10e3, window=0.2), name="mock")
    from pmabench.bench.interface import ProofTest

    made = replace(made, bench=replace(made.bench, proof=ProofTest(80e3, 20e3, 3.0)))
    outcome = execute(made, (Set("h", "pressure", 2e5), Hold("h", 1.0)))
    assert outcome.status == "finished", outcome.why


# -- trip and stop rule in one block ----------------------------------------------------------------------------------


def reached(above, trip):
    made = limited(limit("range", "displacement", high=trip, source="trip:1:1"))
    return execute(
        made, (Set("w", "pressure", 5e5), WaitUntil("w", "displacement", "above", above, 0.002, 8.0), Hold("w", 0.05))
    )


def test_a_stop_rule_before_a_crossing_in_the_same_block_ends_the_wait():
    outcome = reached(above=0.010, trip=0.050)
    assert outcome.extremes["displacement"][1] < 0.050
    assert outcome.status == "finished", outcome.why


def test_a_crossing_before_the_stop_rule_in_the_same_block_ends_the_run():
    outcome = reached(above=0.020, trip=0.015)
    assert outcome.status == "tripped"
    assert 0.015 <= event(outcome, "trip")[1]["value"] < 0.0155
    assert outcome.extremes["displacement"][1] < 0.020, "only what moved on while it was vented"
    assert "trip:1:1" in outcome.why


# -- hold, and hands ----------------------------------------------------------------------------------------------------


def test_a_limit_that_holds_keeps_the_next_command_back_until_it_is_over():
    hold = limit("range", "force", high=130.0, action="hold")
    steps = (Set("a", "pressure", 1e5), Hold("a", 1.0), Set("b", "pressure", 1.2e5), Hold("b", 1.0))
    free = execute(limited(), steps)
    outcome = execute(limited(hold, errors={"force": {"offset": 500.0, "at": 3.5}}), steps)
    assert outcome.status == "tripped"
    assert "held for 60 s" in outcome.why
    assert free.status == "finished"
    assert any(data.get("action") == "hold" for kind, _, data in outcome.events if kind == "warning")
    assert [data["value"] for kind, _, data in outcome.events if kind == "command"] == [1e5], (
        "none was sent, none is told"
    )


def test_a_command_that_was_held_back_is_reported_when_it_is_sent():
    """The force is off by 500 N from 3.5 s on and right again at 5.5 s: what was due at 4 s comes then."""
    hold = limit("range", "force", high=130.0, action="hold")
    steps = (Set("a", "pressure", 1e5), Hold("a", 1.0), Set("b", "pressure", 1.2e5), Hold("b", 1.0))
    free = [t for kind, t, _ in execute(limited(), steps).events if kind == "command"]
    acting = Acquisition._act

    def act(self, trips):
        acting(self, trips)
        if self.clock.now() >= 5.5:
            self.holding.clear()

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Acquisition, "_act", act)
        events = execute(limited(hold, errors={"force": {"offset": 500.0, "at": 3.5}}), steps).events
    reported = [t for kind, t, _ in events if kind == "command"]
    assert reported[0] == free[0]
    assert free[1] < 5.0
    assert 5.5 <= reported[1] < 5.6


def keys(*typed):
    left = list(typed)

    class Typing(ConfirmedBeforehand):
        def poll(self, measured):
            return [left.pop(0)[1]] if left and self.clock.now() >= left[0][0] else []

    return Typing()


def typed(monkeypatch, *keyed):
    operator = keys(*keyed)
    real = run_module.VirtualClock

    def clock():
        operator.clock = real()
        return operator.clock

    monkeypatch.setattr(run_module, "VirtualClock", clock)
    return operator


def test_the_key_v_vents_now_and_says_who(monkeypatch):
    operator = typed(monkeypatch, (5.0, ("key", "v")))
    outcome = run_plan(one_trial(*HOLD), stoppable(), operator, out=None)
    assert (outcome.status, outcome.exit_code) == ("aborted", 130)
    assert "the operator (key v)" in outcome.why
    assert not [kind for kind, _, _ in outcome.events if kind == "controlled-stop"]


def test_the_first_of_several_signals_is_the_cause(monkeypatch):
    class Three(ConfirmedBeforehand):
        def poll(self, measured):
            return ()

    operator, sent = Three(), []

    class Clock(run_module.VirtualClock):
        def wait_until(self, deadline):
            if deadline > 5.0 and not sent:
                sent.extend((signal.SIGTERM, signal.SIGINT, signal.SIGHUP))
                for number in sent:
                    os.kill(os.getpid(), number)
            super().wait_until(deadline)

    monkeypatch.setattr(run_module, "VirtualClock", Clock)
    outcome = run_plan(one_trial(*HOLD), stoppable(), operator, out=None)
    assert (outcome.status, outcome.exit_code) == ("aborted", 143)
    assert "SIGTERM" in outcome.why
    assert not [kind for kind, _, _ in outcome.events if kind == "controlled-stop"]


def test_notes_and_pauses_are_recorded_where_they_are_typed(monkeypatch):
    steps = [
        step
        for n in (0, 1)
        for step in (Record("t", True, n), Set("t", "pressure", 2e5), Hold("t", 1.5), Record("t", False, n))
    ]
    operator = typed(monkeypatch, (0.5, ("note", "it creaks")), (1.0, ("key", "p")), (3.2, ("key", "p")))
    outcome = run_plan(plan(*steps, trials=2), mounted(), operator, out=None)
    assert outcome.status == "finished", outcome.why
    kinds = [kind for kind, _, _ in outcome.events]
    assert event(outcome, "note")[1]["text"] == "it creaks"
    assert kinds.index("pause") > kinds.index("trial-end")
    assert kinds.index("goes-on") < kinds.index("trial-begin", kinds.index("pause"))
    assert event(outcome, "pause")[0] < event(outcome, "goes-on")[0]


def test_hands_are_sent_away_where_the_pressure_rises_while_they_are_in():
    class Slow(ConfirmedBeforehand):
        def ask(self, text, measured, wait):
            for _ in range(100):
                wait()
            return "clear"

    outcome = run_plan(one_trial(*HOLD), mounted(errors={"pressure": {"offset": 30e3, "at": 5.0}}), Slow(), out=None)
    assert outcome.status == "error"
    assert "hands are not let in" in outcome.why
    assert "rose above 20 kPa" in outcome.why
    assert event(outcome, "ended-early")[0] == pytest.approx(5.1, abs=0.11)
    assert not [kind for kind, _, _ in outcome.events if kind == "answer"]


def test_a_trial_is_repeated_where_it_was_asked_for(monkeypatch):
    operator = typed(monkeypatch, (5.0, ("key", "r")))
    outcome = run_plan(one_trial(*HOLD), mounted(), operator, out=None)
    assert [data["attempt"] for kind, _, data in outcome.events if kind == "trial-begin"] == [1, 2]
    assert outcome.status == "finished"


@pytest.mark.parametrize(
    ("asked", "order"),
    [
        ((0.5,), [0, 0, 1]),  # in the first trial
        ((1.8,), [0, 0, 1]),  # behind it, when its line is read
        ((2.8,), [0, 1, 1]),
        ((3.9,), [0, 1, 1]),  # behind the last one
        ((0.5, 0.6), [0, 1]),  # taken back
    ],
)
def test_a_repeat_means_the_trial_under_way_or_the_one_before(monkeypatch, asked, order):
    steps = [
        step
        for n in (0, 1)
        for step in (Record("t", True, n), Set("t", "pressure", 2e5), Hold("t", 1.3), Record("t", False, n),
                     Set("v", "pressure", 0.0), Hold("v", 0.7))
    ]  # fmt: skip
    operator = typed(monkeypatch, *((t, ("key", "r")) for t in asked))
    outcome = run_plan(plan(*steps, trials=2), mounted(), operator, out=None)
    begun = [data["trial"] for kind, _, data in outcome.events if kind == "trial-begin"]
    assert (outcome.status, begun) == ("finished", order)


# -- the end: sampling and status ------------------------------------------------------------------------------------


def test_a_stream_that_fails_to_stop_spoils_neither_the_vent_nor_the_record(monkeypatch):
    def broken(self):
        raise RuntimeError("it does not stop")

    monkeypatch.setattr(Acquisition, "stop", broken)
    outcome = execute(mounted(), HOLD)
    assert outcome.vent.confirmed
    assert (outcome.status, outcome.exit_code) == ("error", 1)
    assert "it does not stop" in outcome.why


def test_the_cause_is_reported_not_what_failed_after_it(monkeypatch):
    def broken(self):
        raise RuntimeError("it does not stop")

    monkeypatch.setattr(Acquisition, "stop", broken)
    outcome = execute(limited(faults={"nan_at": 5.0}), HOLD)
    assert outcome.status == "tripped"
    assert "it does not stop" not in outcome.why


def test_the_vent_goes_out_before_sampling_is_ended(monkeypatch, commands):
    order = []
    stop, begin = Acquisition.stop, Acquisition.begin_safe_state
    monkeypatch.setattr(
        Acquisition, "begin_safe_state", lambda self: (order.append(("watch off", len(commands))), begin(self))
    )
    monkeypatch.setattr(Acquisition, "stop", lambda self: (order.append(("stop", len(commands))), stop(self)))
    outcome = execute(mounted(), HOLD)
    assert outcome.status == "finished"
    assert [name for name, _ in order] == ["watch off", "stop"]
    assert order[0][1] >= 1


def test_a_vent_that_is_not_confirmed_is_worse_than_a_lost_record():
    from pmabench.base.errors import DeviceError, Interrupted, LimitTripped, RecordError, VerdictFailed
    from pmabench.engine.ending import exit_code
    from pmabench.guard.safe import Vent

    good, sent, bad = Vent("confirmed", ()), Vent("commanded", ()), Vent("failed", ())
    lost = RecordError("full")
    order = [(None, lost, bad, 5), (None, lost, sent, 5), (LimitTripped("x"), lost, good, 5), (DeviceError("x", "y"), lost, good, 7),
             (DeviceError("x", "y"), None, good, 4), (Interrupted("SIGTERM", 143), None, good, 143),
             (VerdictFailed("x"), None, good, 6), (None, None, good, 0), (None, None, sent, 5), (ValueError(), None, good, 1)]  # fmt: skip
    assert [exit_code(cause, record, vent) for cause, record, vent, _ in order] == [code for *_, code in order]


def test_the_judge_of_these_tests_has_a_clock():
    assert math.isclose(VirtualClock().now(), 0.0)
    assert NoRecord().events == []
