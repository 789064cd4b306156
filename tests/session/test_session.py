"""A session: its table, its zeros, when it counts, what later runs say of it."""

import json
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest
from pmabench_drivers.mock import MockBench

from pmabench.base.errors import DeviceError, PmaError
from pmabench.engine.operator import ConfirmedBeforehand, Nobody
from pmabench.engine.run import run_plan
from pmabench.guard.station import Station
from pmabench.protocol.plan import Ask, Hold, Record, Set
from pmabench.session import ensure
from pmabench.session import session as state
from pmabench.session.session import SessionFailed
from pmabench.store.reader import open_run
from tests.engine.benches import mounted, one_trial, plan

BENCH = "mock-session"


def events(run, kind):
    return [event.data for event in run.events if event.kind == kind]


def failing(tmp_path, **options):
    with pytest.raises(SessionFailed) as refused:
        ensure(mounted(BENCH, **options), ConfirmedBeforehand(), tmp_path / "runs")
    return refused.value


def test_step_of_the_regulator_against_its_closed_form(tmp_path):
    """Dead time 0.04 s and a lag T = 0.0955 s: 5 % after 0.04 - T ln 0.95, 10 to 90 % in T ln 9, 5 % band at 0.04 + T ln 20."""
    tables = []
    ensure(mounted(BENCH), ConfirmedBeforehand(), tmp_path / "runs", report=tables.append)
    table = {check.name: check for check in tables[0]}
    assert all(check.verdict != "failed" for check in tables[0])

    def seconds(name, part=0):
        return float(table[name].value.split(",")[part].split(" s")[0])

    T = 0.0955
    assert seconds("step to 100 kPa: dead time, rise") == pytest.approx(0.04 - T * np.log(0.95), abs=0.006)
    assert seconds("step to 100 kPa: dead time, rise", 1) == pytest.approx(T * np.log(9), abs=0.012)
    assert seconds("step to 100 kPa: settling") == pytest.approx(0.04 + T * np.log(20), abs=0.03)
    assert float(table["step to 100 kPa: overshoot"].value.split()[0]) < 1.0
    assert abs(float(table["time of force against pressure"].value.split()[0])) < 5.0
    assert table["leak"].verdict == "not measured"


def test_zeros_are_taken_off_the_offset_and_the_calibration_stays(tmp_path):
    before = mounted(BENCH, errors={"pressure": {"offset": 2500.0}, "force": {"offset": -3.0}})
    after = ensure(before, ConfirmedBeforehand(), tmp_path / "runs")
    old = {channel.name: channel for channel in before.bench.channels}
    for channel in after.bench.channels:
        moved = old[channel.name].scale.offset - channel.scale.offset
        assert channel.calibration == old[channel.name].calibration
        assert channel.scale.slope == old[channel.name].scale.slope
        if channel.name == "pressure":
            assert moved == pytest.approx(channel.zero, abs=1e-9)
            assert channel.zero == pytest.approx(2500.0, abs=150.0)
        elif channel.name == "force":
            assert moved == pytest.approx(channel.zero, abs=1e-9)
            assert channel.zero == pytest.approx(-3.0, abs=0.1)
        elif channel.name == "displacement":
            assert moved == pytest.approx(channel.zero, abs=1e-9)
            assert channel.zero == pytest.approx(0.0, abs=1e-6)
        else:
            assert moved == 0
            assert channel.zero is None


def test_a_run_takes_the_zeros_and_names_the_session_and_keeps_the_drift(tmp_path):
    with_zeros = ensure(
        mounted(BENCH, errors={"pressure": {"offset": 2500.0}}), ConfirmedBeforehand(), tmp_path / "runs"
    )
    steps = one_trial(Set("c", "pressure", 2e5), Hold("c", 3.0), Set("v", "pressure", 0.0), Hold("v", 2.0))
    outcome = run_plan(steps, with_zeros, ConfirmedBeforehand(), out=tmp_path / "runs")
    assert outcome.exit_code == 0
    run = open_run(outcome.folder)
    session = run.manifest["session"]
    assert (tmp_path / "runs" / session["run"] / "seal.json").is_file()
    assert session["shortened"] == ["warm-up of 20.0 s instead of 10 min 00 s"]
    kept = json.loads((outcome.folder / "bench.json").read_text())
    pressure = next(c for d in kept["devices"] for c in d["channels"] if c["name"] == "pressure")
    assert pressure["zero"] == session["zeros"]["pressure"]["value"]
    assert pressure["calibration"]["id"] == "MOCK-P"
    assert pressure["scale"]["offset"] == pytest.approx(-50e3 - pressure["zero"])
    (check,) = events(run, "zero-check")
    assert check["channels"]["pressure"]["drift"] == pytest.approx(0.0, abs=200.0)
    assert check["channels"]["displacement"]["drift"] is None
    assert json.loads((outcome.folder / "seal.json").read_text())["end"]["zero_check"] == check["channels"]
    values = run.trials[0].channels["pressure"]
    assert values[200:].max() < 2.04e5  # 2500 Pa too much without the zero


def test_a_zero_that_drifts_during_a_run_is_in_the_record(tmp_path):
    ready = ensure(mounted(BENCH), ConfirmedBeforehand(), tmp_path / "runs")
    drifts = {"pressure": {"offset": 900.0, "at": 2.0}}
    devices = tuple(replace(d, options={**d.options, "errors": drifts}) for d in ready.bench.devices)
    ready = replace(ready, bench=replace(ready.bench, devices=devices))
    outcome = run_plan(plan(Hold("rest", 3.0), trials=0), ready, ConfirmedBeforehand(), out=tmp_path / "runs")
    (check,) = events(open_run(outcome.folder), "zero-check")
    assert check["channels"]["pressure"]["drift"] == pytest.approx(900.0, abs=150.0)


@pytest.mark.parametrize(
    ("name", "offset", "said"),
    [
        ("displacement", 1e-3, "zero of displacement is refused"),
        ("force", 7.0, "force at rest"),
        ("pressure", 7e3, "pressure at rest"),
    ],
)
def test_a_zero_beyond_its_limit_is_refused(tmp_path, name, offset, said):
    error = failing(tmp_path, errors={name: {"offset": offset}})
    assert said in str(error)
    assert error.exit_code == 6
    assert state.kept(mounted(BENCH).bench.name) == {}


def test_a_zero_is_refused_while_it_drifts(tmp_path):
    """A gauge that warms up: its offset is still changing when the zero is due. Here: a leak lets nothing come to rest."""
    from pmabench.base.errors import VerdictFailed
    from pmabench.engine.acquire import Samples
    from pmabench.session.guided import steady

    class Drifting:
        rate = 100.0

        def __init__(self):
            self.clock = self
            self.t = 0.0

        def now(self):
            return self.t

        def pass_time(self, seconds, stop):
            t = self.t + np.arange(0, seconds, 0.01)
            self.t += seconds
            stop(Samples(t, {"pressure": 100.0 * t}))

    with pytest.raises(VerdictFailed, match="does not come to rest"):
        steady(Drifting(), "pressure", 50.0)
    assert steady(Drifting(), "pressure", 150.0).drift == pytest.approx(99.0)


def test_a_session_counts_until_something_changes(tmp_path):
    bench = mounted(BENCH)
    said = []
    first = ensure(bench, ConfirmedBeforehand(), tmp_path / "runs", say=said.append)
    again = ensure(bench, Nobody(), tmp_path / "runs", say=said.append)
    assert again.in_session == first.in_session
    assert again.bench == first.bench
    assert "there is none yet" in said[0]
    assert "counts until" in said[-1]
    kept, now = state.kept(bench.bench.name), state.utc_now()
    assert state.out_of_date(kept, bench, now) == ""
    assert "run out" in state.out_of_date(kept, bench, now + timedelta(hours=12.1))
    assert "clock" in state.out_of_date(kept, bench, now - timedelta(hours=1))
    other = replace(bench, specimen_file=bench.specimen_file.model_copy(update={"serial": "B"}))
    assert "another specimen" in state.out_of_date(kept, other, now)
    devices = tuple(
        replace(d, channels=tuple(replace(c, scale=replace(c.scale, slope=c.scale.slope * 1.001)) for c in d.channels))
        for d in bench.bench.devices
    )
    recalibrated = replace(bench, bench=replace(bench.bench, devices=devices))
    assert "pressure" in state.out_of_date(kept, recalibrated, now)
    assert "cannot be read" in state.out_of_date({"at": 3}, bench, now)


@pytest.mark.parametrize(("serial", "refused"), [("4711", False), ("9999", True)])
def test_zeros_count_for_the_device_that_gave_them(tmp_path, monkeypatch, serial, refused):
    """A DAQ that is exchanged has other offsets: 100 N and 10 mm were taken off a force and a way that had none."""
    answers = ["4711"]
    opened = MockBench.open
    monkeypatch.setattr(MockBench, "open", lambda self: replace(opened(self), serial=answers[0]))
    ready = ensure(mounted(BENCH), ConfirmedBeforehand(), tmp_path / "runs")
    assert ready.in_session["devices"] == {"plant": "4711"}
    answers[0] = serial
    ready = ensure(mounted(BENCH), Nobody(), tmp_path / "runs")
    rest = plan(Hold("rest", 1.0), trials=0)
    if not refused:
        assert run_plan(rest, ready, ConfirmedBeforehand(), out=tmp_path / "runs").status == "finished"
        return
    with pytest.raises(
        DeviceError, match="number 9999, and the zeros of the session were taken with 4711: .*--new-ses"
    ):
        run_plan(rest, ready, ConfirmedBeforehand(), out=tmp_path / "runs")
    ensure(mounted(BENCH), ConfirmedBeforehand(), tmp_path / "runs", anew=True)
    assert state.kept(mounted(BENCH).bench.name)["devices"] == {"plant": "9999"}


@pytest.mark.parametrize(("what", "why"), [("tripped", "the emergency stop"), ("safe", "reset")])
def test_a_trip_or_a_reset_ends_a_session(tmp_path, what, why):
    bench = mounted(BENCH)
    ensure(bench, ConfirmedBeforehand(), tmp_path / "runs")
    kept, now = state.kept(bench.bench.name), state.utc_now()
    Station(bench.bench.name).note("safe", why="end of the run")
    assert state.out_of_date(kept, bench, now) == ""
    Station(bench.bench.name).note(what, why=why)
    assert "since then" in state.out_of_date(kept, bench, now)


def test_a_skipped_warm_up_is_recorded_with_its_reason(tmp_path):
    ready = ensure(mounted(BENCH), ConfirmedBeforehand(), tmp_path / "runs", skip_warm_up="it is warm from the morning")
    run = open_run(tmp_path / "runs" / ready.in_session["run"])
    assert ready.in_session["skipped"] == {"warm-up": "it is warm from the morning"}
    assert "it is warm from the morning" in " ".join(run.manifest["deviations"])
    assert not events(run, "warm-up")
    assert events(run, "zeros")
    assert ready.in_session["shortened"] == [], "what is skipped is not shortened as well"


def test_the_warm_up_cycles_as_long_as_it_says(tmp_path):
    ready = ensure(mounted(BENCH), ConfirmedBeforehand(), tmp_path / "runs")
    run = open_run(tmp_path / "runs" / ready.in_session["run"])
    begun, ended = (next(e.t for e in run.events if e.kind == kind) for kind in ("warm-up", "warmed-up"))
    assert ended - begun == pytest.approx(20.0, abs=0.2)
    assert events(run, "warmed-up")[0]["cycles"] == 2
    assert run.kind == "session"
    assert run.status == "finished"


def test_without_a_session_in_the_file_nothing_is_done(tmp_path):
    bench = mounted("mock")
    assert ensure(bench, Nobody(), tmp_path / "runs") is bench
    assert not (tmp_path / "runs").exists()


def test_without_a_terminal_hands_are_not_confirmed(tmp_path):
    with pytest.raises(SessionFailed, match="no terminal") as refused:
        ensure(mounted(BENCH), Nobody(), tmp_path / "runs")
    assert refused.value.exit_code == 2


@pytest.mark.parametrize(("factor", "ok"), [(1.0, True), (1.05, True), (1.2, False), (0.8, False)])
@pytest.mark.parametrize("action", ["warn", "stop"])
def test_the_force_of_a_load_at_rest_is_held_against_its_weight(tmp_path, factor, ok, action):
    bench = mounted("mock", errors={"force": {"factor": factor}})
    bench = replace(bench, bench=replace(bench.bench, load_action=action))
    put = Ask("load", "Put hanger 1.1 kg + 1 x 4.9 kg = 6 kg on.", "vented", (58.86, 8.0))
    steps = plan(put, Record("t", True, 0), Set("c", "pressure", 3e5), Hold("c", 5.0), Record("t", False, 0))
    outcome = run_plan(steps, bench, ConfirmedBeforehand(), out=tmp_path / "runs")
    (check,) = events(open_run(outcome.folder), "load-check")
    assert check["ok"] is ok
    assert check["measured"] == pytest.approx(factor * 58.86, abs=0.2)
    if ok or action == "warn":
        assert outcome.exit_code == 0
    else:
        assert (outcome.status, outcome.exit_code) == ("error", 4)
        assert outcome.vent.confirmed
        assert "1 x 4.9 kg" in outcome.why
        assert "load cell" in outcome.why


@pytest.mark.parametrize(
    ("channel", "error", "said"),
    [
        ("force", {"factor": -1.0}, "the load cell reads -50.00 N"),
        ("force", {"factor": 0.102}, "the load cell reads 6.00 N"),
        ("displacement", {"factor": -1.0}, "under pressure the displacement falls by"),
    ],
)
def test_a_channel_of_another_sign_or_unit_ends_the_run_without_a_session(channel, error, said):
    """Though the bench only warns of a load that is a little off; the contraction trip would never come."""
    bench = mounted("mock", errors={channel: error})
    put = Ask("load", "Put hanger 1.1 kg + 1 x 4.9 kg = 6 kg on.", "vented", (58.86, 8.0))
    steps = plan(put, Record("t", True, 0), Set("c", "pressure", 3e5), Hold("c", 5.0), Record("t", False, 0))
    outcome = run_plan(steps, bench, ConfirmedBeforehand(), out=None)
    assert (outcome.status, outcome.exit_code) == ("error", 4)
    assert outcome.vent.confirmed
    assert said in outcome.why


def test_a_load_on_its_support_is_not_judged(tmp_path):
    """At 100 kPa the muscle pulls with 59 N less its friction of 10 N: 6 kg stay on the support."""
    steps = one_trial(Set("c", "pressure", 1e5), Hold("c", 5.0))
    outcome = run_plan(steps, mounted("mock"), ConfirmedBeforehand(), out=None)
    assert not [event for event in outcome.events if event[0] == "load-check"]


def test_errors_of_the_session_are_sentences(tmp_path):
    assert issubclass(SessionFailed, PmaError)
    said = str(failing(tmp_path, supply=5e5))
    assert "recorded in" in said
    assert "vent confirmed; the same command begins with a session again" in said
