"""The guard as a service: silence, lost links, strangers, replays, its own errors; nothing commands past it (S7b, P3)."""

import json
import random
import select
import socket
import struct
import threading
import time
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

from pmabench.base.clock import VirtualClock
from pmabench.base.errors import DeviceError, RecordError
from pmabench.bench.interface import DeviceRecord, Identity, InterlockRecord, ProofTest, SafeAction, ValveRecord
from pmabench.guard import process, supervision
from pmabench.guard.guard import State
from pmabench.guard.remote import exchange
from pmabench.guard.supervision import Supervision
from pmabench.guard.wire import LONGEST, Messages, encode
from tests.guard.rig import DEVICE, DRIVE, DRIVER, OUTPUT, SAFE, Rig, armed, bench
from tests.guard.serving import ANSWERS, ASKS, TOKEN, Serving
from tests.reliability.cases import cases

pytestmark = pytest.mark.realtime
SAFE_COMMANDS = [("halt", "x"), ("write", "p", 0.0), ("switch", "v", False)]


def outputs_of(rig):
    return rig.values("write", "follow", "switch", "halt")


def test_an_engine_is_served_and_leaves():
    with Serving() as serving:
        link = serving.link()
        opened = serving.ask(link, "open")
        assert opened["streams"] == ["dac"]
        assert opened["identities"]["dac"]["model"] == "rig"
        assert serving.ask(link, "arm", run="")["state"] == "running"
        assert serving.ask(link, "set", name="pressure", value=3e5)["value"] == 3e5
        assert "error" not in serving.ask(link, "ramp", name="pressure", origin=3e5, target=1e5, rate=1e5)
        assert "error" not in serving.ask(
            link, "sine", name="pressure", mean=2e5, amplitude=1e4, frequency=1.0, cycles=2
        )
        assert "error" not in serving.ask(link, "valves", closed=False)
        assert "error" not in serving.ask(link, "place", force=10.0, mass=1.0)
        assert serving.ask(link, "stream", name="dac", rate=100.0)["value"] == 100.0
        serving.rig.reads["pressure"] = 5.0
        block = serving.ask(link, "collect", device="dac", seen={})
        assert (block["rows"], block["columns"]) == (1, ["pressure"])
        assert struct.unpack("=d", block["payload"][8:]) == (5.0,)
        assert serving.ask(link, "status")["run"] == ""
        ended = serving.ask(link, "safe", tripped=False, hurry=False, why="end")
        assert ended["ended"] == {"how": "engine", "why": "end"}
        serving.until_over()
        assert serving.station.noted[-1][0] == "safe"
        assert serving.ask(link, "status")["vent"]["result"] == "confirmed"
        assert not serving.service._over()
        serving.ask(link, "bye")
        assert serving.service._over()


def test_before_the_proof_is_released_only_low_pressure_passes_here_too():
    with Serving(bench(proof=ProofTest(50e3, 20e3, 1.0))) as serving:
        link = serving.link()
        serving.ask(link, "open")
        serving.ask(link, "arm", run="")
        assert "not proven" in serving.ask(link, "set", name="pressure", value=3e5)["error"]["text"]
        serving.ask(link, "release")
        assert "error" not in serving.ask(link, "set", name="pressure", value=3e5)


def ended_by(serving, why, *, how="lost"):
    serving.until_over()
    assert why in serving.service._ended["why"]
    assert serving.service._ended["how"] == how
    assert outputs_of(serving.rig)[-3:] == SAFE_COMMANDS
    assert serving.station.noted[-1][0] == "tripped"
    assert serving.guard.state is State.TRIPPED


def test_a_silent_engine_is_lost():
    with Serving(pauses=True) as serving:
        serving.armed()
        began = time.monotonic()
        ended_by(serving, "the engine was silent for")
        assert time.monotonic() - began > 0.8 * process.SILENCE


def test_what_the_guard_itself_takes_is_no_silence(monkeypatch):
    with Serving(pauses=True) as serving:
        link = serving.link()
        serving.ask(link, "open")
        slow = serving.guard.arm
        monkeypatch.setattr(serving.guard, "arm", lambda run: (time.sleep(1.2 * process.SILENCE), slow(run)))
        assert serving.ask(link, "arm", run="")["state"] == "running"
        serving.service.turn()
        assert serving.guard.state is State.RUNNING


def test_a_link_that_is_closed_is_a_lost_engine():
    with Serving() as serving:
        serving.armed().close()
        ended_by(serving, "the engine has gone")


def test_an_engine_that_says_goodbye_too_early_is_lost():
    with Serving() as serving:
        serving.ask(serving.armed(), "bye")
        ended_by(serving, "left an armed bench")


def test_the_guard_measures_what_the_engine_does_not_ask_for():
    """The engine may fail at one device again and again; the others must be measured all the same."""
    gauge = DeviceRecord("gauge", DRIVER, watchdog=1.0)
    with Serving(bench(devices=(gauge, DEVICE))) as serving:
        link = serving.armed()
        serving.rig.reads["pressure"] = 1e3
        Rig.made["gauge"].wrong["collect"] = "no answer"
        serving.ask(link, "safe", tripped=False, hurry=False, why="x")
        until = time.monotonic() + 2.0
        while serving.service._vent is None and time.monotonic() < until:
            serving.ask(link, "collect", device="gauge", seen={})
        assert serving.service._vent is not None and serving.service._vent.confirmed  # noqa: PT018


def test_one_lost_answer_is_no_lost_device():
    with Serving() as serving:
        link = serving.armed()
        rig, lost = serving.rig, 0
        rig.wrong["level"] = "no answer"
        until = time.monotonic() + 0.3
        while time.monotonic() < until:
            serving.ask(link, "status")
            call = serving.guard.supervision._asked.get("dac" + supervision.SAFE[0])
            if call is not None and call.error is not None and rig.wrong.pop("level", None):
                lost += 1
        assert (lost, serving.service._ended) == (1, {})


def test_time_that_is_lost_before_it_is_armed_begins_nothing():
    with Serving() as serving:
        serving.ask(serving.link(), "open")
        serving.service._pulse.lost = 1.9
        serving.service.turn()
        assert serving.guard.state is State.DISARMED


def test_a_ramp_does_not_go_on_in_a_guard_that_lost_time():
    """Somebody else may have vented while it was stopped: it sends the end of the ramp at once."""
    with Serving(bench(safe_state=(SafeAction("ramp", "pressure", 0.0, 5.0, 100e3), *SAFE))) as serving:
        link = serving.armed()
        serving.ask(link, "set", name="pressure", value=400e3)
        serving.rig.reads["pressure"] = 390e3
        serving.ask(link, "safe", tripped=False, hurry=False, why="x")
        assert serving.rig.values("follow")
        serving.rig.reported.clear()
        serving.service._pulse.lost = 1.9
        serving.service.turn()
        serving.service.turn()
        assert serving.rig.values("write")[:1] == [("write", "p", 0.0)]


@pytest.mark.parametrize("cause", ["interlock", "lost time"])
def test_no_ramp_begins_after_an_emergency_stop_or_lost_time(cause):
    """The stop, or a watchdog, may have emptied the muscle: its ramp would fill it from what was commanded last."""
    with Serving(bench(safe_state=(SafeAction("ramp", "pressure", 0.0, 5.0, 100e3), *SAFE))) as serving:
        serving.ask(serving.armed(), "set", name="pressure", value=400e3)
        serving.rig.reads["pressure"] = 390e3
        serving.rig.reported.clear()
        if cause == "interlock":
            serving.rig.high = False
        else:
            serving.service._pulse.lost = 1.9
        until = time.monotonic() + 1.0
        while not serving.rig.values("follow", "write"):
            serving.service.turn()
            assert time.monotonic() < until
        assert serving.rig.values("follow", "write")[0] == ("write", "p", 0.0)


def test_an_open_interlock_and_a_lost_device_end_it():
    with Serving() as serving:
        serving.armed()
        serving.rig.high = False
        ended_by(serving, 'the interlock "e-stop" is open', how="trip")
    with Serving() as serving:
        serving.armed()
        serving.rig.wrong["level"] = "link lost"
        ended_by(serving, "dac: link lost")
    with Serving() as serving:
        serving.armed()
        serving.rig.wrong["feed_watchdog"] = "its watchdog has vented"
        link = serving.service._engine.link
        assert link is not None
        ended_by(serving, "its watchdog has vented")


def test_a_changed_wall_clock_is_no_lost_time(monkeypatch):
    with Serving(pauses=True) as serving:
        link = serving.armed()
        monkeypatch.setattr(process.time, "time", lambda: 4e9)
        serving.ask(link, "status")
        assert serving.guard.state is State.RUNNING


@pytest.mark.parametrize("asleep", [0.3, 0.9, 3600.0])
def test_a_computer_that_slept_ends_the_run_whatever_was_sent_before(monkeypatch, asleep):
    """The sleep shows in the clock since boot only; the engine's message from before it lies in the socket."""
    with Serving(pauses=True) as serving:
        link = serving.armed()
        link.sendall(encode({"do": "set", "name": "pressure", "value": 1e5, "at": time.monotonic()}, ASKS))
        boot = time.clock_gettime
        monkeypatch.setattr(process.time, "clock_gettime", lambda clock: boot(clock) + asleep)
        serving.rig.reports["watchdog"] = 0.0
        serving.service.turn()
        assert outputs_of(serving.rig)[:3] == SAFE_COMMANDS, "before anything else"
        ended_by(serving, "the guard was stopped for", how="trip")
        noticed = "dac: its watchdog was 1 when the bench was armed and is 0 now"
        assert any(action.startswith(noticed) for action in serving.service._vent.actions)


def test_a_system_without_a_clock_that_sees_sleep_has_the_monotonic_one(monkeypatch):
    monkeypatch.delattr(process.time, "CLOCK_BOOTTIME")
    assert abs(process._since_boot() - time.monotonic()) < 1.0


def test_a_guard_that_only_waits_for_a_device_was_not_interrupted(monkeypatch):
    with Serving(pauses=True, threads=True) as serving:
        link = serving.armed()
        collect = serving.guard.links.collect
        monkeypatch.setattr(
            serving.guard.links, "collect", lambda name: (time.sleep(1.2 * process.LOST_TIME), collect(name))[1]
        )
        assert "error" not in serving.ask(link, "collect", device="dac", seen={})
        serving.service._refuse_lost_time()
        assert serving.guard.state is State.RUNNING


@pytest.mark.parametrize(
    ("change", "why"),
    [({"watchdog": 0.0}, "its watchdog was 1 when the bench was armed and is 0 now: it restarted, or"),
     ({"uptime": 0.4}, "it restarted: its uptime fell from 5 to 0.4"),
     ({"serial": "2"}, "its serial was 1 when the bench was armed and is 2 now")],
)  # fmt: skip
def test_a_device_that_changed_by_itself_is_a_trip(change, why):
    with Serving(threads=True) as serving:
        serving.armed()
        serving.rig.reports |= change
        began = time.monotonic()
        serving_on(serving)
        assert time.monotonic() - began < 1.0
        ended_by(serving, why, how="trip")


def test_a_device_that_has_a_fault_is_a_trip_and_has_not_restarted():
    with Serving(threads=True) as serving:
        serving.armed()
        serving.rig.reports["fault"] = 299.0
        serving_on(serving)
        ended_by(serving, "its fault was 0 when the bench was armed and is 299 now", how="trip")
        assert "restarted" not in serving.service._ended["why"]


UPTIMES = {
    # what a counter of milliseconds shows from the arming on, and whether it restarted
    "goes on": ((71001, 71450, 71900, 72350), False),
    "one torn upwards": ((71001, 136925, 71882, 72300, 72750), False),
    "one torn downwards": ((71001, 5800, 71450, 71900), False),
    "restarts": ((71001, 71450, 71900, 300, 330), True),
    "restarts after one that was torn": ((71001, 71450, 136925, 71882, 300, 330), True),
    "restarts at once": ((71001, 300, 330), True),
}


@pytest.mark.parametrize("what", UPTIMES)
def test_one_torn_reading_of_an_uptime_is_no_restart(what):
    """Two words are read while the lower one begins again: one reading is 65536 off, each 65 s of such a counter."""
    readings, restarts = UPTIMES[what]
    left = list(readings)
    device = SimpleNamespace(held=lambda: {"uptime": float(left.pop(0))})
    links = SimpleNamespace(devices={"daq": device}, call=lambda _name, act: act(), need=lambda *_what: device)
    supervision = Supervision(None, links, VirtualClock(), None, {})
    supervision.begin()
    said = []
    while left:
        said.append(supervision._twice(lambda: supervision._held_differs("daq")))
    assert [bool(text) for text in said if text] == [True] * restarts
    assert not restarts or "it restarted: its uptime fell from 7" in said[-1]


def test_a_set_point_and_a_valve_that_nobody_commanded_are_a_trip():
    with Serving(threads=True) as serving:
        link = serving.armed()
        assert "error" not in serving.ask(link, "set", name="pressure", value=3e5)
        serving.rig.at["p"] = lambda _now: 0.0
        serving_on(serving)
        ended_by(serving, '"pressure" was commanded to 300 kPa and the device holds 0 kPa', how="trip")
    with Serving(threads=True) as serving:
        serving.armed()
        serving.rig.on["v"] = not serving.rig.on["v"]
        serving_on(serving)
        ended_by(serving, '"dump_valve" was commanded closed and the device holds it open', how="trip")


def test_a_command_that_is_acknowledged_and_not_carried_out_is_noticed():
    with Serving(threads=True) as serving:
        link = serving.armed()
        serving.rig.ignores = True
        began = time.monotonic()
        assert "error" not in serving.ask(link, "set", name="pressure", value=3e5)
        serving_on(serving)
        assert time.monotonic() - began < 1.0
        assert "was commanded to 300 kPa and the device holds 0 kPa" in serving.service._ended["why"]


def test_a_bench_that_does_what_it_was_asked_is_left_alone():
    with Serving(threads=True) as serving:
        link = serving.armed()
        serving.rig.reports["uptime"] = 6.0
        for do, data in (
            ("set", {"name": "pressure", "value": 1e5}), ("ramp", {"name": "pressure", "origin": 1e5, "target": 4e5, "rate": 4e5}),
            ("sine", {"name": "displacement", "mean": 0.0, "amplitude": 0.0, "frequency": 2.0, "cycles": 1}),
            ("valves", {"closed": False}), ("set", {"name": "pressure", "value": 5e5}), ("valves", {"closed": True}),
        ):  # fmt: skip
            assert "error" not in serving.ask(link, do, **data), do
            until = time.monotonic() + 0.8
            while time.monotonic() < until:
                assert "error" not in serving.ask(link, "status")
                time.sleep(0.01)
        assert serving.guard.state is State.RUNNING
        assert len(serving.rig.values("held")) > 5


def test_one_lost_answer_is_no_lost_device_and_a_second_of_them_is():
    with Serving(threads=True) as serving:
        link = serving.armed()
        serving.rig.wrong["held"] = "an answer was lost"
        until = time.monotonic() + 0.5
        while time.monotonic() < until:
            serving.ask(link, "status")
        assert serving.guard.state is State.RUNNING
        for what in ("read_back", "is_on"):
            serving.rig.wrong[what] = "an answer was lost"
        serving_on(serving)
        ended_by(serving, "an answer was lost")
    with Serving(threads=True) as serving:
        serving.armed()
        serving.rig.wrong |= {"held": (hangs := threading.Event()), "level": hangs}
        serving.guard.bench = serving.guard.links._bench = serving.guard.supervision._bench = replace(
            serving.guard.bench, devices=(replace(DEVICE, interlocks=()),)
        )
        serving_on(serving)
        hangs.set()
        assert "whether it holds what was commanded" in serving.service._ended["why"]


def test_an_interlock_that_cannot_be_read_any_more_ends_it():
    with Serving(threads=True) as serving:
        serving.armed()
        serving.rig.wrong["level"] = hangs = threading.Event()
        serving_on(serving)
        hangs.set()
        assert "has not answered for 0.5 s whether its interlocks are closed" in serving.service._ended["why"]


def test_a_device_that_takes_long_for_each_answer_is_not_lost():
    """60 ms for each: commands and samples wait for the question that is under way, and no question for another."""
    with Serving(threads=True) as serving:
        link, rig = serving.armed(), serving.rig
        for what in ("level", "held", "read_back", "is_on", "write"):
            answer = getattr(rig, what)
            setattr(rig, what, lambda *how, answer=answer: (time.sleep(0.06), answer(*how))[1])
        until, longest, rows = time.monotonic() + 2.0, 0.0, 0
        while time.monotonic() < until:
            begun = time.monotonic()
            assert "error" not in serving.ask(link, "set", name="pressure", value=1e5)
            rows += serving.ask(link, "collect", device="dac", seen={})["rows"]
            longest = max(longest, time.monotonic() - begun)
        assert serving.service._ended == {}
        assert rows > 4
        assert longest < 0.35, "a question and the command"
        assert {call[0] for call in rig.reported} >= {"feed_watchdog", "level", "held", "read_back", "is_on"}


def test_samples_of_a_device_that_is_busy_are_handed_over_later():
    guard, rig = armed(threads=True)
    rig.wrong["read_back"] = busy = threading.Event()
    guard.links.submit("dac", partial(rig.read_back, "p"))
    begun = time.monotonic()
    assert len(guard.collect("dac").time) == 0
    assert time.monotonic() - begun < 0.15
    busy.set()
    assert len(guard.collect("dac").time) == 1
    rig.wrong["collect"] = hangs = threading.Event()
    for _ in range(10):
        assert len(guard.collect("dac").time) == 0
    time.sleep(0.4)
    with pytest.raises(DeviceError, match="did not answer"):
        guard.collect("dac")
    hangs.set()
    guard.close()


def serving_on(serving, within=15.0):
    """The engine beats, and the guard serves, until the run is ended."""
    until = time.monotonic() + within
    while not serving.service._ended:
        serving.service._heard = time.monotonic()
        serving.service.turn()
        assert time.monotonic() < until


def test_a_guard_that_is_asked_to_end_vents_first():
    with Serving() as serving:
        serving.armed()
        serving.service._note_signal(15, None)
        assert not serving.service._over()
        ended_by(serving, "asked to end")
        assert serving.service._over()


def test_a_latched_bench_is_made_safe_again_and_refused():
    with Serving(latch="burst, yesterday") as serving:
        link = serving.link()
        reported = serving.ask(link, "open")["error"]
        assert reported["type"] == "LimitRefused"
        assert "burst, yesterday" in reported["text"]
        assert outputs_of(serving.rig) == SAFE_COMMANDS
        assert "cannot be armed" in serving.ask(link, "arm", run="")["error"]["text"]
        assert outputs_of(serving.rig) == SAFE_COMMANDS
        serving.until_over()


def test_a_latched_bench_whose_device_does_not_answer_shows_both():
    device = replace(DEVICE, options={"wrong": {"open": "does not answer at COM7"}})
    with Serving(bench(device), latch="burst, yesterday") as serving:
        reported = serving.ask(serving.link(), "open")["error"]
        assert reported["type"] == "LimitRefused"
        assert "burst, yesterday" in reported["text"]
        assert "--reset" in reported["text"]
        assert "does not answer at COM7" in reported["text"]
    with Serving(bench(device)) as serving:
        assert serving.ask(serving.link(), "open")["error"]["text"] == "does not answer at COM7"


def test_a_vent_from_somebody_else_is_answered_at_once_and_when_it_is_over():
    with Serving() as serving:
        engine, other = serving.armed(), serving.link()
        serving.rig.reads["pressure"] = 3e5
        first = serving.ask(other, "vent", who="me")
        assert first["commanded"] is True
        assert first["vent"] is None
        assert outputs_of(serving.rig) == SAFE_COMMANDS
        assert serving.ask(engine, "status")["ended"] == {"how": "vent", "why": "vent by me"}
        serving.rig.reads["pressure"] = 1e3
        serving.until_over()
        assert next(iter(Messages(ANSWERS).feed(other.recv(1 << 16))))[0]["vent"]["result"] == "confirmed"
        assert serving.guard.state is State.SAFE
        assert serving.ask(other, "vent", who="me")["vent"]["result"] == "confirmed"


def test_the_first_cause_is_the_one_that_is_reported():
    with Serving() as serving:
        engine = serving.armed()
        serving.ask(serving.link(), "vent", who="me")
        serving.ask(engine, "safe", tripped=True, hurry=True, why="other")
        serving.until_over()
        assert serving.service._ended["why"] == "vent by me"
        assert serving.guard.state is State.TRIPPED


def test_only_one_engine_is_served():
    with Serving() as serving:
        engine, other = serving.armed(), serving.link()
        assert "has an engine already" in serving.ask(other, "set", name="pressure", value=1e5)["error"]["text"]
        assert "error" not in serving.ask(engine, "set", name="pressure", value=1e5)
        assert [reported for reported in outputs_of(serving.rig) if reported[-1] != 0.0] == [("write", "p", 666.0)]
        other.close()
        serving.service.turn()
        assert serving.guard.state is State.RUNNING
        serving.ask(engine, "bye")
        late = serving.link()
        assert "has an engine already" in serving.ask(late, "arm", run="")["error"]["text"]


def test_a_stranger_is_hung_up_on_and_nothing_happens():
    with Serving() as serving:
        engine, stranger = serving.armed(), serving.link()
        for key in (b"", b"guess", bytes(16), ANSWERS):
            stranger = serving.link()
            message = {"do": "set", "at": time.monotonic(), "name": "pressure", "value": 1e5}
            assert serving.say(stranger, encode(message, key)) is None
        assert outputs_of(serving.rig) == []
        assert "error" not in serving.ask(engine, "status")
        assert serving.guard.state is State.RUNNING


@pytest.mark.parametrize(
    "raw",
    [b"\xff" * 64, *(ASKS + struct.pack("!II", *lengths) + text for lengths, text in (
        ((LONGEST, 1), b""), ((5, 0), b"nonse"), ((2, 0), b"[]"), ((60000, 0), b"[" * 60000), ((4, 0), b"\xff\xfe\xfd\xfc"),
    ))],
)  # fmt: skip
def test_bytes_that_are_no_message_end_the_link_and_the_run(raw):
    with Serving() as serving:
        stranger = serving.link()
        assert serving.say(stranger, raw) is None
        engine = serving.armed()
        assert serving.say(engine, raw) is None
        ended_by(serving, "the engine has gone")


@pytest.mark.parametrize("at", [None, 0.0, "a minute ago", 1e12, float("nan"), "now"])
def test_a_command_that_was_sent_too_long_ago_is_not_carried_out(at):
    """A guard that was stopped must not do afterwards what its engine has given up."""
    at = time.monotonic() - 60.0 if at == "a minute ago" else at
    with Serving() as serving:
        link = serving.armed()
        for do, data in (("set", {"name": "pressure", "value": 1e5}), ("valves", {"closed": True}), ("release", {})):
            assert "error" in serving.say(link, encode({"do": do, "at": at, **data}, ASKS))
        assert outputs_of(serving.rig) == []
        assert "error" not in serving.say(link, encode({"do": "status", "at": at}, ASKS))
        serving.say(link, encode({"do": "safe", "at": at, "tripped": False, "hurry": False, "why": "x"}, ASKS))
        assert outputs_of(serving.rig)[-3:] == SAFE_COMMANDS


@pytest.mark.parametrize(
    "message",
    [{"do": "set"}, {"do": "set", "name": ["pressure"], "value": 1.0}, {"do": "set", "name": "pressure", "value": "1"},
     {"do": "set", "name": "pressure", "value": 10**400}, {"do": "nothing"}, {"do": 5}, {"do": ["set"]}, {},
     {"do": "set", "name": "pressure", "value": 1.0, "peer": 1}, {"do": "collect", "device": "dac", "seen": 5},
     {"do": "collect", "device": [], "seen": {}}, {"do": "stream", "name": "dac", "rate": "fast"},
     {"do": "collect", "device": "dac", "seen": {"x": "y"}}, {"do": "open"}, {"do": "arm", "run": ""}],
)  # fmt: skip
def test_an_engines_mistake_is_reported_to_it_and_commands_nothing(message):
    with Serving() as serving:
        link = serving.armed()
        answer = serving.say(link, encode({"at": time.monotonic(), **message}, ASKS))
        assert answer["error"]["text"]
        assert outputs_of(serving.rig) == []
        assert "error" not in serving.ask(link, "set", name="pressure", value=1e5)
        link.close()
        ended_by(serving, "the engine has gone")


def test_a_run_name_that_is_no_path_ends_nothing(tmp_path):
    with Serving() as serving:
        link = serving.link()
        serving.ask(link, "open")
        serving.ask(link, "arm", run="\0")
        link.close()
        ended_by(serving, "the engine has gone")


def test_a_lost_engine_finds_what_happened_in_its_run(tmp_path):
    with Serving() as serving:
        link = serving.link()
        serving.ask(link, "open")
        serving.ask(link, "arm", run=str(tmp_path))
        link.close()
        ended_by(serving, "the engine has gone")
        assert list(tmp_path.iterdir()) == []
        reported = json.loads((Path(f"{tmp_path}.late") / "guard.json").read_text())
        assert (reported["cause"], reported["vent"]["result"]) == ("the engine has gone", "confirmed")


def test_what_the_engine_says_it_measured_counts_only_where_the_guard_cannot_measure(monkeypatch):
    with Serving() as serving:
        link = serving.armed()
        serving.rig.reads["pressure"] = 3e5
        step, seen = serving.guard.step_safe, []
        monkeypatch.setattr(serving.guard, "step_safe", lambda latest: (seen.append(dict(latest)), step(latest))[1])
        serving.ask(link, "safe", tripped=False, hurry=False, why="x")
        serving.ask(link, "collect", device="dac", seen={"pressure": 0.0, "supply": 7.0})
        serving.until_over()
        assert {"pressure": 3e5, "supply": 7.0} in seen
        assert serving.station.noted[-1][0] == "tripped", "not confirmed"


def test_what_the_engine_measured_comes_with_its_sign_of_life_where_the_guard_has_no_channels():
    """The vent was never confirmed: values came with the samples only that nobody collected."""
    gauge = replace(DEVICE, channels=())
    with Serving(bench(devices=(gauge,))) as serving:
        link, stranger = serving.armed(), serving.link()
        serving.ask(link, "safe", tripped=False, hurry=False, why="x")
        serving.ask(stranger, "status", seen={"pressure": 7e5})
        assert serving.guard.latest == {}, "a client who only asks is not believed"
        until = time.monotonic() + 3.0
        while serving.guard.state is State.STOPPING and time.monotonic() < until:
            serving.ask(link, "status", seen={"pressure": 0.0})
        assert serving.service._vent.confirmed


def test_an_error_in_the_guard_itself_makes_the_bench_safe(monkeypatch):
    with Serving() as serving:
        serving.armed()
        monkeypatch.setattr(serving.guard.supervision, "look", lambda _now: 1 / 0)
        ended_by(serving, "an error in the guard")


def test_an_error_in_every_turn_does_not_end_the_guard(monkeypatch):
    with Serving() as serving:
        serving.armed()
        monkeypatch.setattr(serving.guard, "step_safe", lambda latest: 1 / 0)
        serving.service._engine.link.shutdown(socket.SHUT_RDWR)
        for _ in range(20):
            serving.service.turn()
        assert not serving.service._over()
        monkeypatch.undo()
        ended_by(serving, "the engine has gone")


def test_a_state_that_cannot_be_written_is_reported_and_ends_no_vent(monkeypatch):
    def full(*_args, **_data):
        raise RecordError("disk full")

    with Serving() as serving:
        link = serving.armed()
        monkeypatch.setattr(serving.station, "note", full)
        link.close()
        serving.until_over()
        assert outputs_of(serving.rig)[-3:] == SAFE_COMMANDS
    with Serving() as serving:
        link = serving.link()
        serving.ask(link, "open")
        monkeypatch.setattr(serving.station, "note", full)
        assert serving.ask(link, "arm", run="")["error"] == {"type": "RecordError", "text": "disk full"}
        assert outputs_of(serving.rig) == []


def test_a_log_that_cannot_be_written_ends_nothing(monkeypatch):
    def full():
        raise OSError("no space")

    monkeypatch.setattr(process.traceback, "print_exc", full)
    with Serving() as serving:
        link = serving.armed()
        assert serving.say(link, b"\xff" * 64) is None
        ended_by(serving, "the engine has gone")


def test_a_vent_whose_asker_has_gone_is_done_all_the_same():
    with Serving() as serving:
        serving.armed()
        other = serving.link()
        other.sendall(encode({"do": "vent", "who": "me"}, ASKS))
        other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        other.close()
        serving.until_over()
        assert outputs_of(serving.rig)[:3] == SAFE_COMMANDS


def test_the_watchdog_is_fed_while_the_safe_state_lasts():
    with Serving(bench(safe_state=(SafeAction("hold", "", 0.0, 0.4), *SAFE))) as serving:
        link = serving.armed()
        serving.ask(link, "safe", tripped=False, hurry=False, why="x")
        serving.until_over()
        assert len(serving.rig.values("feed_watchdog")) >= 4
        serving.rig.reported.clear()
        until = time.monotonic() + 0.3
        while time.monotonic() < until:
            serving.service.turn()
        assert serving.rig.values("feed_watchdog"), "it does not fire after a good vent"
        serving.rig.wrong["feed_watchdog"] = "gone"
        serving.service.turn()


def test_nobody_who_comes_is_not_waited_for(monkeypatch):
    with Serving() as serving:
        assert not serving.service._over()
        monkeypatch.setattr(process, "CONNECTS_WITHIN", -1.0)
        assert serving.service._over()


def test_an_accept_that_fails_ends_nothing(monkeypatch):
    with Serving() as serving:
        serving.armed()

        class Broken:
            def accept(self):
                raise OSError("too many open files")

        monkeypatch.setattr(serving.service, "_listener", Broken())
        serving.service._accept()
        assert serving.guard.state is State.RUNNING


# -- wire -----------------------------------------------------------------------------------------------------------


def test_an_exchange_needs_an_answer():
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as link:
        other, _ = listener.accept()
        other.sendall(encode({"a": 1}, ANSWERS, b"xyz")[:5])
        with pytest.raises(TimeoutError):
            exchange(link, {"do": "x"}, TOKEN, 0.05)
        other.sendall(encode({"a": 1}, ANSWERS, b"xyz")[5:])
        other.close()
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as link:
        other, _ = listener.accept()
        other.sendall(encode({"a": 1}, ANSWERS, b"xyz"))
        assert exchange(link, {"do": "x"}, TOKEN, 5.0) == ({"a": 1}, b"xyz")
        other.shutdown(socket.SHUT_WR)
        with pytest.raises(ConnectionError):
            exchange(link, {"do": "x"}, TOKEN, 5.0)
        other.close()


# -- an engine that lies --------------------------------------------------------------------------------------------

NUMBERS = [0.0, -1.0, 1.0, 599e3, 600e3, 600.1e3, 1e9, -1e9, 1e308, float("nan"), float("inf"), -float("inf"), 25e-3,
           50e-3, 51e-3, 10**400, True, None, "1", [1.0], {"a": 1}]  # fmt: skip


def a_message(rng):
    """A request, legal or not."""
    do = rng.choice(["set", "set", "set", "ramp", "sine", "valves", "place", "stream", "collect", "status", "arm", "open",
                     "release", "__init__", "end", "", 7])  # fmt: skip
    number = lambda: rng.choice([*NUMBERS, rng.uniform(-1e5, 9e5), rng.uniform(0.0, 60e-3)])  # noqa: E731
    name = rng.choice(["pressure", "pressure", "displacement", "dump_valve", "", None, ["pressure"]])
    fields = {
        "set": {"name": name, "value": number()},
        "ramp": {"name": name, "origin": number(), "target": number(), "rate": number()},
        "sine": {"name": name, "mean": number(), "amplitude": number(), "frequency": number(), "cycles": number()},
        "valves": {"closed": rng.choice([True, False, None])},
        "place": {"force": number(), "mass": number()},
        "stream": {"name": rng.choice(["dac", "x", None]), "rate": number()},
        "collect": {
            "device": rng.choice(["dac", "x", None]),
            "seen": rng.choice([{}, {"pressure": 0.0}, 5, {"a": "b"}]),
        },
        "arm": {"run": rng.choice(["", 5, "\0"])},
    }.get(do, {})
    if rng.random() < 0.1 and fields:
        fields.pop(rng.choice(list(fields)))
    if rng.random() < 0.05:
        fields[rng.choice(["peer", "self", "x"])] = number()
    return {"do": do, "at": time.monotonic(), **fields}


def legal_set(message, state):
    value, limits = message.get("value"), {"pressure": 600e3, "displacement": 50e-3}
    return (
        state is State.RUNNING
        and message["do"] == "set"
        and set(message) == {"do", "at", "name", "value"}
        and isinstance(message["name"], str)
        and message["name"] in limits
        and type(value) is float
        and 0.0 <= value <= limits[message["name"]]
    )


def judge(reported):
    """Whether what reached the device lies inside its limits, decoded here again."""
    most = {"p": 600e3 / OUTPUT.scale.slope, "x": 50.0}
    for kind, output, *how in (call for call in reported if call[0] in {"write", "follow"}):
        if kind == "write":
            assert -1e-6 <= how[0] <= most[output] * (1 + 1e-8), (output, how)
        elif kind == "follow":
            s = how[0]
            ends = [
                s.origin - abs(s.amplitude),
                s.origin + abs(s.amplitude),
                s.target if s.kind == "ramp" else s.origin,
            ]
            assert all(-1e-6 <= end <= most[output] * (1 + 1e-8) for end in ends), (output, s)


def test_an_engine_that_lies_commands_nothing_illegal_and_the_guard_survives(record_property):
    count = cases(10_000)
    record_property("cases", count)
    rng, tally = random.Random(3), Counter()
    done, kept = 0, b""
    quiet = bench(replace(DEVICE, outputs=(OUTPUT, replace(DRIVE, rate=0.0))), safe_state=SAFE[:3])
    while done < count:
        with Serving(quiet) as serving:
            link = serving.armed()
            while done < count:
                done += 1
                message = a_message(rng)
                raw, way = encode(message, ASKS), rng.random()
                if way < 0.01:
                    raw = bytearray(raw)
                    raw[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
                    raw = bytes(raw)
                elif way < 0.015:
                    raw = raw[: rng.randrange(len(raw))]
                elif way < 0.03 and kept:
                    raw = kept
                elif way < 0.04:
                    raw = encode(message, rng.randbytes(16))
                elif way < 0.05:
                    raw = encode({**message, "at": message["at"] - rng.uniform(0.6, 1e6)}, ASKS)
                else:
                    kept = kept or raw
                before, state = len(serving.rig.reported), serving.guard.state
                link.sendall(raw)
                if raw != encode(message, ASKS):
                    link.shutdown(socket.SHUT_WR)
                answer = serving.say(link, b"") if way >= 0.05 else drained(serving, link)
                judge(serving.rig.reported[before:])
                if way >= 0.05:
                    assert answer is not None
                    tally["refused" if "error" in answer else "done"] += 1
                    if legal_set(message, state):
                        tally["legal"] += 1
                        assert "error" not in answer, (message, answer)
                        assert serving.rig.values("write"), "a legal command was blocked"
                    if len(serving.rig.reported) > 1000:
                        serving.rig.reported.clear()
                else:
                    tally["broken"] += 1
                    break
            judge(serving.rig.reported)
            if done < count:
                serving.until_over()
                assert outputs_of(serving.rig)[-3:] == SAFE_COMMANDS, "its engine was lost, and it vented"
    assert min(tally[name] for name in ("refused", "done", "legal", "broken")) > count // 1000


def drained(serving, link):
    """Let it read all that was sent, up to the end of the link."""
    until = time.monotonic() + 5.0
    while serving.service._engine is not None:
        serving.service.turn()
        assert time.monotonic() < until


def test_an_engine_that_leaves_a_safe_bench_is_not_lost():
    with Serving() as serving:
        engine = serving.armed()
        serving.ask(engine, "safe", tripped=False, hurry=False, why="end")
        serving.until_over()
        engine.close()
        while serving.service._engine is not None:
            serving.service.turn()
        assert serving.service._ended == {"how": "engine", "why": "end"}
        assert serving.guard.state is State.SAFE


def test_only_what_streams_is_reported_and_only_what_is_open_counts_as_measured():
    from tests.guard.rig import CHANNEL, Plain

    relay = DeviceRecord("relay", f"{Plain.__module__}:Plain", valves=(ValveRecord("spare", "relay", "r"),))
    reader = DeviceRecord("reader", DEVICE.driver, channels=(replace(CHANNEL, name="supply", device="reader"),))
    with Serving(bench(devices=(DEVICE, relay, reader)), threads=True) as serving:
        link = serving.link()
        assert serving.ask(link, "open")["streams"] == ["dac"]
        serving.ask(link, "collect", device="dac", seen={"supply": 5.0, "pressure": 1.0})
        assert serving.guard.latest == {"supply": 5.0, "pressure": 0.0}


def test_a_device_that_reports_nothing_of_itself_is_watched_by_its_outputs():
    quiet = DEVICE.driver.replace(":Rig", ":Quiet")
    door = DeviceRecord("door", quiet, interlocks=(InterlockRecord("door", "door", "in0"),))
    reader = DeviceRecord("reader", DEVICE.driver)
    with Serving(bench(devices=(door, reader, replace(DEVICE, driver=quiet))), threads=True) as serving:
        serving.armed()
        serving.rig.at["p"] = lambda _now: 4000.0
        serving_on(serving)
        ended_by(serving, "was commanded to 0 kPa and the device holds 600 kPa", how="trip")


@pytest.mark.parametrize("failure", ["hangs", "an answer was lost"])
def test_what_a_device_did_in_lost_time_is_recorded_although_it_answers_late(monkeypatch, failure):
    """A question was under way when both stood still; the first answers after it come late, or not at all."""
    with Serving(pauses=True, threads=True) as serving:
        serving.armed()
        serving.rig.reads["pressure"] = 3e5
        serving.rig.wrong["held"] = threading.Event() if failure == "hangs" else failure
        boot = time.clock_gettime
        monkeypatch.setattr(process.time, "clock_gettime", lambda clock: boot(clock) + 0.9)
        serving.rig.reports["watchdog"] = 0.0
        until = time.monotonic() + 0.4  # longer than a call may take
        while time.monotonic() < until:
            serving.service.turn()
        held = serving.rig.wrong.pop("held")
        if failure == "hangs":
            held.set()
        until = time.monotonic() + 0.1
        while time.monotonic() < until:
            serving.service.turn()
        serving.rig.reads["pressure"] = 0.0
        ended_by(serving, "the guard was stopped for", how="trip")
        noticed = "dac: its watchdog was 1 when the bench was armed and is 0 now"
        assert any(action.startswith(noticed) for action in serving.service._vent.actions)


def test_a_device_that_never_says_what_it_did_in_lost_time_is_named(monkeypatch):
    with Serving(pauses=True, threads=True) as serving:
        serving.armed()
        serving.rig.wrong["held"] = "does not answer"
        boot = time.clock_gettime
        monkeypatch.setattr(process.time, "clock_gettime", lambda clock: boot(clock) + 0.9)
        ended_by(serving, "the guard was stopped for", how="trip")
        said = "dac: has not answered whether it is as it was when the bench was armed"
        assert serving.service._vent.actions[-1] == said


def test_devices_that_are_as_they_were_are_not_named(monkeypatch):
    with Serving(pauses=True, threads=True) as serving:
        serving.armed()
        boot = time.clock_gettime
        monkeypatch.setattr(process.time, "clock_gettime", lambda clock: boot(clock) + 0.9)
        ended_by(serving, "the guard was stopped for", how="trip")
        assert not [action for action in serving.service._vent.actions if action.startswith("dac: ")]


# -- strangers (S15) --------------------------------------------------------------------------------------------------


def test_a_stranger_is_hung_up_on_before_his_bytes_are_read_or_parsed(monkeypatch):
    with Serving() as serving:
        engine, stranger = serving.armed(), serving.link()
        monkeypatch.setattr("pmabench.guard.wire.json.loads", lambda text: pytest.fail("a stranger's text was parsed"))
        sent = poured(serving, stranger, 64 << 20)
        assert sent < 16 << 20
        monkeypatch.undo()
        assert "error" not in serving.ask(engine, "status")
        assert serving.guard.state is State.RUNNING


def poured(serving, link, size):
    """Send so many bytes while the engine is heard; how many went before the guard hung up."""
    link.setblocking(False)
    sent = 0
    while sent < size:
        try:
            sent += link.send(b"x" * 65536)
        except BlockingIOError:
            serving.service.turn()
        except OSError:
            return sent
        serving.service._heard = time.monotonic()
    return sent


def test_idle_links_are_closed_oldest_first_and_the_engine_is_not_among_them():
    with Serving() as serving:
        engine = serving.armed()
        idle = [socket.create_connection(serving.listener.getsockname()) for _ in range(100)]
        try:
            until = time.monotonic() + 5.0
            while len(closed(idle)) < 100 - process.STRANGERS:
                assert "error" not in serving.ask(engine, "status")
                assert time.monotonic() < until
            assert len(serving.service._peers) == 1 + process.STRANGERS
            other = serving.link()
            assert serving.ask(other, "vent", who="me")["commanded"] is True
        finally:
            for link in idle:
                link.close()


def closed(links):
    """Descriptors of links whose other end was closed."""
    readable, _, _ = select.select(links, [], [], 0)
    return {link.fileno() for link in readable}


def test_a_link_that_was_closed_in_this_turn_is_not_read():
    with Serving() as serving:
        serving.link()
        peer = serving.service._peers[-1]
        serving.service._hang_up(peer)
        serving.service._hear(peer)
        assert peer not in serving.service._peers


def test_the_same_device_behind_another_address_is_known_by_its_serial_number(monkeypatch):
    with Serving() as serving:
        assert "error" not in serving.ask(serving.link(), "open")
        assert not [what for what, _ in serving.station.noted if what == "device"]
    monkeypatch.setattr("tests.guard.rig.Rig.open", lambda self: Identity("Alicat", "PCD", "0815", "1"))
    with Serving() as serving:
        assert "error" not in serving.ask(serving.link(), "open")
        assert serving.station.noted == [("device", {"where": "Alicat PCD serial 0815"})]


def test_a_drivers_own_kind_of_device_error_reaches_the_engine_as_one():
    class Unanswered(DeviceError):
        pass

    with Serving() as serving:
        link = serving.armed()
        serving.rig.wrong["write"] = Unanswered("dac", "gave no answer", "p")
        reported = serving.ask(link, "set", name="pressure", value=1e5)["error"]
        assert reported == {"type": "DeviceError", "device": "dac", "channel": "p", "text": "gave no answer"}
