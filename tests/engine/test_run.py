"""Every way out vents, the vent's result is in the record before its end, and the exit code says what happened (S3, S5)."""

import itertools
import os
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from pmabench.base.errors import DeviceError, RecordError
from pmabench.bench.interface import Identity
from pmabench.cli.outcome import AtLines
from pmabench.engine import ending
from pmabench.engine import run as run_module
from pmabench.engine.bench_checks import refuse_twice
from pmabench.engine.operator import ConfirmedBeforehand, Nobody
from pmabench.engine.recorder import NoRecord
from pmabench.engine.run import run_plan
from pmabench.protocol.plan import Hold, Record, Set, WaitUntil
from tests.engine.benches import STEPS, mounted, one_trial, plan

CAUSES = {
    "Ctrl-C": (signal.SIGINT, "aborted", 130),
    "SIGTERM": (signal.SIGTERM, "aborted", 143),
    "SIGHUP": (signal.SIGHUP, "aborted", 129),
}


def kinds(outcome):
    return [kind for kind, _, _ in outcome.events]


def data(outcome, kind):
    return next(d for k, _, d in outcome.events if k == kind)


def execute(made, bench=None, **options):
    return run_plan(made, bench or mounted(), options.pop("operator", ConfirmedBeforehand()), out=None, **options)


@pytest.mark.parametrize("kind", STEPS)
def test_a_plan_that_ends_well_is_finished_and_vented(kind):
    outcome = execute(one_trial(*STEPS[kind]))
    assert (outcome.status, outcome.exit_code) == ("finished", 0), outcome.why
    assert outcome.vent.confirmed
    assert kinds(outcome)[-2:] == ["trial-end", "vent"]


@pytest.mark.parametrize(
    ("moved", "words"), [(-86400.0, "set back by 86400.0 s"), (7200.0, "set forward (or it slept) by 7200.0 s")]
)
def test_a_time_of_day_that_is_set_in_the_run_is_said_once(monkeypatch, moved, words):
    """The folder says that it was closed a day before it was begun."""
    before = ending.ahead()
    monkeypatch.setattr(ending, "ahead", lambda: before + moved)
    outcome = execute(one_trial(*STEPS["hold"]))
    [reason] = [data["reason"] for kind, _, data in outcome.events if kind == "warning"]
    assert words in reason
    assert (outcome.status, outcome.exit_code) == ("finished", 0)
    monkeypatch.setattr(ending, "ahead", lambda: before + 0.5)
    assert "warning" not in kinds(execute(one_trial(*STEPS["hold"])))


class AfterSomeTime:
    """A clock that does something once, when bench time reaches a moment: the cause comes in the middle of a step."""

    def __init__(self, moment, act):
        self.moment, self.act, self.inner = moment, act, run_module.VirtualClock()

    def __call__(self):
        return self

    def now(self):
        return self.inner.now()

    def back_to(self, moment):
        return self.inner.back_to(moment)

    def set_quiet_until(self, moment):
        self.inner.set_quiet_until(moment)

    def wait_until(self, deadline):
        if self.act is not None and deadline >= self.moment:
            act, self.act = self.act, None
            act()
        self.inner.wait_until(deadline)


@pytest.mark.parametrize("kind", STEPS)
@pytest.mark.parametrize("cause", CAUSES)
def test_a_signal_in_the_middle_of_a_step_vents(monkeypatch, kind, cause):
    number, status, code = CAUSES[cause]
    monkeypatch.setattr(run_module, "VirtualClock", AfterSomeTime(5.0, lambda: os.kill(os.getpid(), number)))
    outcome = execute(one_trial(*STEPS[kind]))
    assert (outcome.status, outcome.exit_code) == (status, code)
    assert outcome.vent.confirmed
    assert data(outcome, "trial-end")["status"] == "interrupted"
    assert kinds(outcome)[-1] == "vent"


def test_a_second_ctrl_c_in_the_vent_changes_nothing(monkeypatch):
    def twice():
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(run_module, "VirtualClock", AfterSomeTime(5.0, twice))
    outcome = execute(one_trial(*STEPS["hold"]))
    assert outcome.exit_code == 130
    assert outcome.vent.confirmed


@pytest.mark.parametrize("kind", STEPS)
def test_a_measured_value_that_is_none_trips_and_vents(kind):
    outcome = execute(one_trial(*STEPS[kind]), mounted(faults={"nan_at": 5.0}))
    assert (outcome.status, outcome.exit_code) == ("tripped", 5)
    assert [kind for kind in kinds(outcome)[-3:] if kind != "trial-end"][-2:] == ["trip", "vent"]


@pytest.mark.parametrize("kind", STEPS)
def test_a_lost_device_ends_the_run_and_the_vent_is_tried(kind):
    outcome = execute(one_trial(*STEPS[kind]), mounted(faults={"lost_at": 5.0}))
    assert (outcome.status, outcome.exit_code) == ("error", 5)
    assert outcome.vent.result == "failed"
    assert "link lost" in outcome.why


def test_contraction_beyond_its_limit_trips_at_that_sample():
    bench = mounted()
    made = one_trial(Set("contract", "pressure", 5.9e5), Hold("contract", 5.0))
    trip = next(t for t in bench.bench.trips if t.channel == "displacement")
    lower = type(trip)("displacement", None, 0.030, 0.0, "vent", "test:1:1")
    bench = replace(bench, bench=replace(bench.bench, trips=(*[t for t in bench.bench.trips if t is not trip], lower)))
    outcome = execute(made, bench)
    assert (outcome.status, outcome.exit_code) == ("tripped", 5)
    assert "displacement 30" in outcome.why
    assert "test:1:1" in outcome.why
    crossed = float(outcome.why.split(" at ")[1].split(" s ")[0])
    reaction = next(t for kind, t, _ in outcome.events if kind == "trip")
    assert outcome.extremes["displacement"][1] < 0.040, "went on after the crossing"
    assert reaction - crossed < 0.5


def test_the_record_that_fails_is_a_failed_run(monkeypatch):
    class Full(NoRecord):
        def append(self, stream, time_ns, columns, flags, host_ns=None):
            raise RecordError("disk full: runs/x/streams/plant.arrows")

    monkeypatch.setattr(run_module, "NoRecord", Full)
    outcome = execute(one_trial(*STEPS["hold"]))
    assert (outcome.status, outcome.exit_code) == ("error", 7)
    assert outcome.vent.confirmed


def test_an_error_in_the_program_vents_and_says_where(monkeypatch):
    monkeypatch.setattr(run_module, "VirtualClock", AfterSomeTime(5.0, lambda: 1 / 0))
    outcome = execute(one_trial(*STEPS["hold"]))
    assert (outcome.status, outcome.exit_code) == ("error", 1)
    assert "ZeroDivisionError" in data(outcome, "ended-early")["reason"]
    assert outcome.vent.confirmed


def test_hands_need_a_person_or_yes():
    outcome = execute(one_trial(*STEPS["hold"]), operator=Nobody())
    assert outcome.exit_code == 2
    assert "--yes" in outcome.why
    assert outcome.vent.confirmed


def test_the_prompt_shows_the_pressure_wants_the_word_and_waits_three_seconds(monkeypatch, capsys):
    read, write = os.pipe()
    monkeypatch.setattr("sys.stdin", SimpleNamespace(fileno=lambda: read))
    monkeypatch.setattr("pmabench.cli.outcome.say", lambda _text: os.write(write, b"yes\n\nclear\n"))
    outcome = execute(one_trial(*STEPS["hold"]), operator=AtLines(realtime=False))
    assert outcome.status == "finished"
    assert "Measured pressure:" in capsys.readouterr().err
    answered = next(t for kind, t, _ in outcome.events if kind == "answer")
    begun = next(t for kind, t, _ in outcome.events if kind == "trial-begin")
    assert begun - answered >= 3.0 - 1e-9


def test_hands_wait_until_the_pressure_is_gone():
    made = one_trial(*STEPS["hold"])
    pressurised = plan(Set("before", "pressure", 3e5), Hold("before", 3.0), *made.steps)
    outcome = execute(pressurised)
    assert outcome.exit_code == 6 or "hands are not let in" in outcome.why
    vented = plan(Set("b", "pressure", 3e5), Hold("b", 3.0), Set("b", "pressure", 0.0), *made.steps)
    outcome = execute(vented)
    assert outcome.status == "finished"
    assert data(outcome, "answer")["pressure"] < 20e3


def test_a_wait_that_is_not_fulfilled_fails_the_trial_and_says_what_it_waited_for():
    made = one_trial(WaitUntil("w", "displacement", "above", 0.05, 0.1, 2.0))
    outcome = execute(made)
    assert (outcome.status, outcome.exit_code) == ("failed", 6)
    assert data(outcome, "limit-reached")["reason"].startswith("waited 2 s for displacement above 50 mm; it is at")
    assert data(outcome, "trial-end")["status"] == "failed"


def test_samples_lie_on_the_grid_and_only_recorded_time_is_kept(monkeypatch):
    kept = []

    class Keep(NoRecord):
        def append(self, stream, time_ns, columns, flags, host_ns=None):
            kept.extend(time_ns.tolist())

    monkeypatch.setattr(run_module, "NoRecord", Keep)
    outcome = execute(one_trial(Hold("a", 10.0)))
    assert outcome.rows == len(kept) == 5000
    assert {b - a for a, b in itertools.pairwise(kept)} == {2_000_000}


def test_no_sample_is_lost_where_a_wait_ends_a_block_early():
    made = one_trial(
        Set("w", "pressure", 3e5), WaitUntil("w", "displacement", "above", 0.02, 0.01, 5.0), Hold("after", 3.0)
    )
    outcome = execute(made)
    begun = next(t for kind, t, _ in outcome.events if kind == "trial-begin")
    ended = next(t for kind, t, _ in outcome.events if kind == "trial-end")
    assert outcome.status == "finished"
    assert abs(outcome.rows - (ended - begun) * 500) <= 1


def test_a_run_is_the_same_twice():
    made = one_trial(*STEPS["hold"])
    assert execute(made).extremes == execute(made).extremes
    assert execute(made).extremes != execute(made, mounted(seed=2)).extremes


def test_the_search_finds_lift_and_set_down_of_the_closed_form_from_both_sides():
    up = STEPS["seek scripted"][0]
    down = replace(up, phase="set-down", parameters={**up.parameters, "direction": "down", "approach_rate": 0.0})
    outcome = execute(one_trial(up, Hold("lifted", 1.0), down), mounted("mock-ideal"))
    lift, set_down = [d["result"]["pressure"] / 1e3 for kind, _, d in outcome.events if kind == "found"]
    true = (58.86 + 49.0) / 1.08
    assert lift == pytest.approx(true, abs=0.5)
    assert set_down == pytest.approx(true, abs=0.5)
    assert (lift + set_down) / 2 == pytest.approx(true, abs=0.1)


def test_the_search_with_friction_lifts_later():
    outcome = execute(one_trial(*STEPS["seek scripted"]))
    found = data(outcome, "found")["result"]
    assert found["pressure"] / 1e3 == pytest.approx((58.86 + 10.0 + 49.0) / 1.08, abs=1.0)


def test_a_search_finds_nothing_where_the_sensor_is_beyond_the_threshold_before_anything_moves():
    """A zero that is off by more than the threshold would be taken for a lift at no pressure."""
    up = STEPS["seek scripted"][0]
    off = replace(up, parameters={**up.parameters, "threshold": -0.1e-3})
    outcome = execute(one_trial(off))
    found = data(outcome, "found")["result"]
    assert found["found"] is False
    assert "displacement is" in found["reason"]
    assert "before anything moves: set its zero" in found["reason"]


def test_a_search_without_success_fails_the_trial():
    short = one_trial(STEPS["seek scripted"][0].__class__("lift", "ramp-until", "pressure", 0.0, 5e4, 100.0,
                                                           STEPS["seek scripted"][0].parameters))  # fmt: skip
    outcome = execute(short)
    assert (outcome.status, outcome.exit_code) == ("failed", 6)


def test_recording_off_keeps_nothing():
    outcome = execute(plan(Set("a", "pressure", 1e5), Hold("a", 2.0), trials=0))
    assert outcome.rows == 0
    assert outcome.extremes["pressure"][1] > 0.9e5


def test_a_run_folder_is_closed_with_the_true_status(tmp_path, monkeypatch):
    from pmabench.store.reader import open_run

    monkeypatch.setattr(run_module, "VirtualClock", AfterSomeTime(5.0, lambda: os.kill(os.getpid(), signal.SIGTERM)))
    outcome = run_plan(one_trial(*STEPS["hold"]), mounted(), ConfirmedBeforehand(), out=tmp_path)
    assert outcome.exit_code == 143
    run = open_run(Path(outcome.folder))
    assert run.status == "aborted"
    assert run.simulated
    assert "SIMULATED" in Path(outcome.folder).name
    assert next(e for e in run.events if e.kind == "vent").data["result"] == "confirmed"


def test_real_time_runs_the_same_plan(monkeypatch):
    bench = mounted()
    bench = replace(bench, bench=replace(bench.bench, realtime=True))
    made = plan(Record("t", True, 0), Set("t", "pressure", 2e5), Hold("t", 0.5), Record("t", False, 0))
    outcome = execute(made, bench)
    assert outcome.status == "finished"
    assert outcome.rows >= 240  # half a second at 500 Hz, and more where the machine is busy
    assert outcome.vent.confirmed


def test_a_stream_that_fell_silent_confirms_nothing(monkeypatch):
    from pmabench_drivers.mock import MockBench

    from pmabench.bench.interface import Block

    real = MockBench.collect

    def silent(self):
        block = real(self)
        return block if self._clock.now() < 5.0 else Block([], {name: [] for name in block.columns})

    monkeypatch.setattr(MockBench, "collect", silent)
    outcome = execute(one_trial(Hold("a", 1.85), Set("a", "pressure", 3e5), Hold("a", 5.0)))
    assert "has sent no sample" in outcome.why
    assert outcome.vent.result == "commanded"
    assert outcome.exit_code == 5


def test_no_number_is_flagged_with_the_rest_of_its_block(monkeypatch):
    kept = []

    class Keep(NoRecord):
        def append(self, stream, time_ns, columns, flags, host_ns=None):
            kept.extend(flags.tolist())

    monkeypatch.setattr(run_module, "NoRecord", Keep)
    execute(one_trial(Hold("a", 5.0)), mounted("mock-ideal", faults={"nan_at": 4.0}))
    assert kept[-1] & 4


def test_the_end_of_input_at_the_prompt_is_an_interruption(monkeypatch):
    read, write = os.pipe()
    os.close(write)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(fileno=lambda: read))
    outcome = execute(one_trial(*STEPS["hold"]), operator=AtLines(realtime=False))
    assert (outcome.status, outcome.exit_code) == ("aborted", 130)
    assert outcome.vent.confirmed


@pytest.mark.parametrize(
    ("serial", "simulated", "refused"), [("4711", False, True), ("4712", False, False), ("", False, False), ("4711", True, False)]
)  # fmt: skip
def test_one_device_that_answers_as_two_of_the_bench_is_refused(serial, simulated, refused):
    answers = {
        name: Identity("Acme", "PR", number, "1", simulated=simulated)
        for name, number in (("a", "4711"), ("b", serial))
    }
    if not refused:
        refuse_twice(mounted().bench, answers)
        return
    with pytest.raises(DeviceError, match="a and b are the same device, Acme PR, serial number 4711"):
        refuse_twice(mounted().bench, answers)
