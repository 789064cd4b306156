"""The safe state without a guard, and the engine's face of a guard that is gone (S4, S7, S10)."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import DeviceRecord, Identity, SafeAction
from pmabench.guard import remote
from pmabench.guard.guard import Guard
from pmabench.guard.remote import RemoteGuard, vent_directly
from pmabench.guard.station import UNCLEAN, Station
from tests.guard.rig import BENCH, DEVICE, OUTPUT, Rig, bench

SAFE_COMMANDS = [("halt", "x"), ("write", "p", 0.0), ("switch", "v", False)]


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """What a guard that died sent last is waited for 3 s."""
    monkeypatch.setattr("pmabench.guard.safe.LINGERS", 0.2)


def station(**state):
    made = Station("rig")
    made.folder.mkdir(parents=True)
    if state:
        made.note(**state)
    return made


def test_a_bench_that_nobody_used_is_vented_and_stays_free():
    where = station()
    vent = vent_directly(BENCH, where, "test")
    assert vent.result == "confirmed"
    assert [reported for reported in Rig.made["dac"].reported if reported[0] in {"halt", "write", "switch"}][
        :3
    ] == SAFE_COMMANDS
    assert where.latched() == ""


@pytest.mark.parametrize(
    ("state", "why"), [({"what": "armed", "run": "r"}, UNCLEAN), ({"what": "tripped", "why": "burst"}, "burst")]
)
def test_a_bench_that_was_left_is_vented_and_latched(state, why):
    where = station(**state)
    assert vent_directly(BENCH, where, "test").confirmed
    assert where.latched().startswith(why)


class Full(Rig):
    """Its gauge reads 200 kPa, whatever is commanded."""

    def __init__(self, device, clock):
        super().__init__(device, clock)
        self.reads["pressure"] = 200e3


class Follows(Rig):
    """Its muscle follows; the emergency stop opens a little later."""

    def __init__(self, device, clock):
        super().__init__(device, clock)
        self.at["p"] = lambda _now: OUTPUT.scale.to_raw(60e3)
        self.reads["pressure"] = 60e3

    def collect(self):
        for name, act in self.at.items():
            self.reads["pressure"] = OUTPUT.scale.to_si(act(self.clock.now())) if name == "p" else 0.0
        self.high = self.reads["pressure"] > 55e3
        return super().collect()


def test_a_ramp_without_a_guard_is_not_broken_off_by_a_watchdog_and_waits_for_no_emergency_stop():
    ramp = SafeAction("ramp", "pressure", 0.0, 5.0, 20e3)

    where = station()
    vent = vent_directly(
        bench(replace(DEVICE, driver=f"{__name__}:Follows"), safe_state=(ramp, *BENCH.safe_state[1:])), where, "test"
    )
    rig = Rig.made["dac"]
    assert rig.values("feed_watchdog")
    assert vent.confirmed
    assert 'dac: the interlock "e-stop" is open (dac.in0)' in vent.actions
    assert 'interlock "e-stop" is open' in where.latched()
    assert rig.clock.now() < 2.5


def test_a_vent_that_is_not_confirmed_latches():
    where = station()
    dead = replace(DEVICE, options={"wrong": {"collect": "no answer"}})
    assert vent_directly(bench(dead), where, "test").result == "commanded"
    assert "safe state commanded" in where.latched()
    gone = replace(DEVICE, options={"wrong": {"open": "nobody there"}})
    where = Station("other")
    where.folder.mkdir()
    vent = vent_directly(bench(gone), where, "test")
    assert vent.result == "failed"
    assert "set pressure: failed (dac: nobody there)" in vent.actions
    assert "safe state failed" in where.latched()


class FaultySensor(Rig):
    """Refuses to be opened because of what it measures, but takes commands."""

    def open_to_vent(self):
        self._note("open_to_vent")
        return Identity("test", "rig", "1", "0", simulated=True)


@pytest.mark.parametrize("opens", [True, False])
def test_a_device_that_refuses_what_it_measures_is_opened_for_a_vent(opens):
    """A broken wire of a sensor kept a terminal closed, and its muscle at 300 kPa."""
    wrong = {"open": "reports a fault", **({} if opens else {"open_to_vent": "nobody there"})}
    device = replace(DEVICE, driver="tests.guard.test_direct:FaultySensor", options={"wrong": wrong})
    vent = vent_directly(bench(device), station(), "test")
    assert vent.confirmed is opens
    assert opens or "set pressure: failed (dac: nobody there)" in vent.actions
    assert (("write", "p", 0.0) in Rig.made["dac"].reported) is opens
    with (
        pytest.raises(DeviceError, match="reports a fault"),
        contextlib.closing(Guard(bench(device), RealClock())) as made,
    ):
        made.open()


class BehindGuard(Rig):
    """A serial port that the process of its options holds open."""

    def open(self):
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.device.options["holder"], 0)
            raise DeviceError(self.device.name, "the port is in use")
        return super().open()


def test_a_guard_that_is_stopped_and_holds_the_line_is_killed():
    """Its bench would stay under pressure until somebody lets it go on."""
    where = station()
    code = "import sys, time; from pathlib import Path; from pmabench.base.system import try_lock;"
    code += "print(try_lock(Path(sys.argv[1]))); sys.stdout.flush(); time.sleep(60)"
    holder = subprocess.Popen([sys.executable, "-c", code, where.folder / "lock"], stdout=subprocess.PIPE, text=True)
    with holder:
        assert holder.stdout.readline()
        holder.send_signal(signal.SIGSTOP)
        threading.Thread(target=holder.wait, daemon=True).start()  # no zombie, which would count as there
        where.write("guard", {"pid": holder.pid})
        device = replace(DEVICE, driver="tests.guard.test_direct:BehindGuard", options={"holder": holder.pid})
        assert vent_directly(bench(device), where, "test").confirmed
        assert holder.wait(5) == -signal.SIGKILL


def test_who_does_not_hold_the_bench_is_not_killed():
    where = station()
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as other:
        where.write("guard", {"pid": other.pid})
        gone = replace(DEVICE, options={"wrong": {"open": "nobody there"}})
        assert vent_directly(bench(gone), where, "test").result == "failed"
        assert other.poll() is None
        other.kill()


class StartsLate(Rig):
    """Its first answers to `start` are lost, as on a busy computer; it takes no samples before it has answered one."""

    def start(self, rate):
        self.lost = getattr(self, "lost", 2) - 1
        if self.lost >= 0:
            raise DeviceError(self.device.name, "no answer within 0.18 s")
        return super().start(rate)

    def collect(self):
        if not self.values("start"):
            raise DeviceError(self.device.name, "takes no samples yet")
        return super().collect()


def test_a_vent_is_confirmed_although_the_first_answers_are_lost():
    late = replace(DEVICE, driver=f"{__name__}:StartsLate")
    assert vent_directly(bench(late), station(), "test").confirmed


def test_a_vent_is_confirmed_by_a_gauge_on_a_link_that_only_measures():
    gauge = DeviceRecord("gauge", DEVICE.driver, channels=DEVICE.channels)
    split = replace(BENCH, devices=(replace(DEVICE, channels=()), gauge))
    where = station(what="tripped", why="burst")
    assert vent_directly(split, where, "test").confirmed
    assert ("open",) in Rig.made["gauge"].reported
    assert not [reported for reported in Rig.made["gauge"].reported if reported[0] in {"halt", "write", "switch"}]


def test_a_folder_that_cannot_be_written_hinders_no_vent():
    assert vent_directly(BENCH, Station("never made"), "test").confirmed


def test_the_engine_vents_itself_where_its_guard_is_gone():
    guard = RemoteGuard(BENCH, RealClock())
    station(what="armed", run="r")
    with pytest.raises(DeviceError, match="is not there any more"):
        guard.set("pressure", 1e5)
    vent = guard.safe_state(dict, why="guard: does not answer")
    assert vent.confirmed
    assert guard.safe_state(dict) is vent
    assert Station("rig").latched().startswith(f"{UNCLEAN} (guard: does not answer)")
    guard.close()


def test_the_engine_passes_on_which_gauge_it_doubted(monkeypatch):
    """A gauge that reads 0 and stood still while the muscle was filled confirms nothing after the guard's death either."""
    station(what="armed", run="r")
    guard = RemoteGuard(BENCH, RealClock())
    guard.begin_safe(tripped=True, why="following", doubted=("pressure",))
    guard.begin_safe(tripped=True, why="following")
    assert guard.safe_state(dict, why="following").result == "commanded"


@pytest.mark.parametrize("lost", [True, False])
def test_a_second_signal_ends_the_wait_without_a_guard_too(lost):
    """Also one whose message went to the guard that was dying: the signal is not asked for twice."""
    patient = (*BENCH.safe_state[:-1], replace(BENCH.safe_state[-1], within=60.0))
    station(what="armed", run="r")
    guard = RemoteGuard(bench(replace(DEVICE, driver=f"{__name__}:Full"), safe_state=patient), RealClock())
    if lost:
        guard.begin_safe(hurry=2)
        guard.begin_safe(hurry=1)
    else:
        guard.hurried = lambda: 2
    began = time.monotonic()
    assert guard.safe_state(dict, why="lost").result == "commanded"
    assert time.monotonic() - began < 30.0


def test_whatever_goes_wrong_then_is_the_outcome_of_the_vent(monkeypatch):
    monkeypatch.setattr(remote, "vent_directly", lambda *_: 1 / 0)
    vent = RemoteGuard(BENCH, RealClock()).safe_state(dict)
    assert (vent.result, vent.actions) == ("failed", ("ZeroDivisionError: division by zero",))
