"""Samples that come late are not from now: a stream of nothing else has failed, and a trial waits for its last ones."""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace

import numpy as np
import pytest

from pmabench.base.clock import VirtualClock
from pmabench.base.errors import DeviceError, LimitRefused, LimitTripped
from pmabench.bench.interface import Block, ChannelRecord, DeviceRecord, Scale, TripRecord
from pmabench.engine.acquire import OLD, SILENCE, Acquisition, Tripped
from pmabench.engine.executor import Executor
from pmabench.engine.recorder import NoRecord
from pmabench.protocol.plan import Record
from tests.engine.benches import mounted, plan
from tests.engine.forked import Forks
from tests.engine.realtime_rig import Reader, Run, assert_safe_since, served
from tests.realtime import eventually

PERIOD = 0.002
EPOCH = 4321.0
"""What the clock of the device shows at bench time 0 [s]."""


class Passing(VirtualClock):
    """Real time without waiting: what has passed stays passed."""

    def back_to(self, moment):
        return False


class Queue:
    """A device that samples at 500 Hz, and whose samples come `delay` [s, of bench time] later, none lost, in order."""

    def __init__(self, clock, delay, channel="supply"):
        self._clock, self._delay, self._channel, self._next = clock, delay, channel, 1

    def start(self, rate):
        return rate

    def stop(self):
        pass

    def collect(self):
        now = self._clock.now()
        last = max(self._next - 1, int((now - self._delay(now)) / PERIOD + 1e-6))
        numbers, self._next = range(self._next, last + 1), last + 1
        times = [round((EPOCH + number * PERIOD) * 1e9) for number in numbers]
        return Block(times, {self._channel: [number * PERIOD for number in numbers]})


class Kept(NoRecord):
    """Keeps what is recorded: by the clock of the device [s]."""

    def __init__(self):
        super().__init__()
        self.times = []

    def append(self, stream, time_ns, columns, flags, host_ns=None):
        self.times += [time * 1e-9 - EPOCH for time in time_ns.tolist()]


CHANNEL = ChannelRecord("supply", "pressure", "gauge", "in", "float64", "Pa", Scale(), -1e5, 1e6)
GAUGE = DeviceRecord("gauge", "none:None", channels=(CHANNEL,))


def sampling(delay, *trips, drift=2e-4):
    """The acquisition of such a device, at work; and what it records."""
    clock, kept = Passing(), Kept()
    bench = replace(mounted("mock-realtime").bench, devices=(replace(GAUGE, drift=drift),), trips=trips)
    acquisition = Acquisition(bench, {"gauge": Queue(clock, delay)}, clock, 500.0, ("supply",), kept)
    acquisition.start()
    return acquisition, kept


def test_what_was_not_collected_while_the_bench_was_armed_is_no_silence():
    """Arming took 1.2 s on a slow line, and a good bench was "silent"."""
    stale = TripRecord("supply", None, None, 0.6, "vent", "bench.yaml:1:1", "stale")
    for anew in (True, False):
        acquisition, _ = sampling(lambda now: 0.0 if now < 1.0 else now - 1.0 if now < 2.5 else 0.0, stale)
        acquisition.pass_time(1.0)
        acquisition.clock.wait_until(2.2)
        if anew:
            acquisition.listen_anew()
        with contextlib.nullcontext() if anew else pytest.raises((DeviceError, Tripped), match="no sample for"):
            acquisition.pass_time(0.4)


def test_a_program_that_was_stopped_blames_no_device():
    """Stopped for 3 s: the record named a gauge that had sent all the time, and not what the guard says."""
    acquisition, _ = sampling(lambda now: 0.001 if now < 1.0 or now > 4.05 else now - 1.0)
    acquisition.pass_time(1.0)
    acquisition.clock.wait_until(4.0)
    acquisition.pass_time(0.3)
    acquisition, _ = sampling(lambda now: 0.001 if now < 1.0 else now - 1.0)
    with pytest.raises(DeviceError, match="no sample for"):
        acquisition.pass_time(3.0)


def ever_later(begins, most):
    """Half a second later each second, up to `most` [s]: a buffer that fills."""
    return lambda now: min(max(0.0, 0.5 * (now - begins)), most)


def test_a_stream_that_comes_ever_later_is_a_fault_of_its_device():
    """Half a second after it began the newest is 0.25 s old; what comes in the second after that is old, too."""
    acquisition, _ = sampling(ever_later(2.0, 2.0))
    with pytest.raises(DeviceError, match=r"^gauge: its samples come 0\.8 s late, for 1 s none was from now: look at"):
        acquisition.pass_time(60.0)
    assert acquisition.clock.now() == pytest.approx(2.0 + OLD / 0.5 + SILENCE, abs=0.11)


def test_one_by_one_it_is_the_same():
    acquisition, _ = sampling(ever_later(0.5, 2.0))
    with pytest.raises(DeviceError, match="late"):
        sample_for_ever(acquisition)
    assert acquisition.clock.now() == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("late", [0.2, 0.5, 0.9])
def test_what_was_late_for_a_moment_goes_on(late):
    """A computer that was busy catches up."""
    acquisition, _ = sampling(lambda now: late if int(now) % 2 and now % 1 < 0.9 else 0.001)
    acquisition.pass_time(10.0)


def test_a_delay_that_was_always_there_is_no_fault():
    acquisition, _ = sampling(lambda _now: 0.7)
    acquisition.pass_time(5.0)


@pytest.mark.parametrize(("drift", "known"), [(1e-4, 2e-4), (-1e-4, 2e-4), (5e-3, 1e-2), (-5e-3, 1e-2)])
def test_a_clock_that_drifts_is_no_fault(drift, known):
    """Quartz, and the ceramic resonator of an Arduino Uno: for a minute and more the newest samples stay from now."""
    acquisition, _ = sampling(lambda now: drift * now + 0.001 * (int(20 * now) % 3), drift=known)
    acquisition.pass_time(100.0)
    [source] = acquisition._sources
    assert source.newest == pytest.approx(100.0, abs=0.02)


def test_a_board_with_a_resonator_is_known_as_one():
    assert [device.drift for device in mounted("serial-line-daq").bench.devices] == [1e-2]
    assert {device.drift for device in mounted("serial").bench.devices if device.name != "board"} == {2e-4}


def test_old_samples_do_not_keep_a_stale_limit_quiet():
    """0.25 s old at 1.5 s; a limit of 0.3 s acts that much later."""
    stale = TripRecord("supply", None, None, 0.3, "vent", "test:1:1", "stale")
    for wait in (lambda acquisition: acquisition.pass_time(5.0), sample_for_ever):
        acquisition, _ = sampling(ever_later(1.0, 2.0), stale)
        with pytest.raises(
            Tripped, match=r"has given no sample for 0.3\d* s but old ones, which come 0.[34]\d s late, at"
        ):
            wait(acquisition)
        assert acquisition.clock.now() == pytest.approx(1.8, abs=0.11)


def sample_for_ever(acquisition):
    while True:
        acquisition.sample()


def test_samples_of_one_device_do_not_stand_for_those_of_another():
    """In a loop that is closed at every sample a channel of a silent device is stale, too."""
    clock, stale = Passing(), TripRecord("pressure", None, None, 0.3, "vent", "test:1:1", "stale")
    other = replace(GAUGE, name="other", channels=(replace(CHANNEL, name="pressure", device="other"),))
    bench = replace(mounted("mock-realtime").bench, devices=(GAUGE, other), trips=(stale,))
    silent = Queue(clock, lambda now: 0.001 if now < 1.0 else now - 1.0, "pressure")
    streams = {"gauge": Queue(clock, lambda _now: 0.001), "other": silent}
    acquisition = Acquisition(bench, streams, clock, 500.0, (), NoRecord())
    acquisition.start()
    with pytest.raises(Tripped, match=r"pressure has given no sample for 0.3\d* s at"):
        sample_for_ever(acquisition)
    assert clock.now() == pytest.approx(1.3, abs=0.02)


def test_values_from_before_confirm_nothing():
    acquisition, _ = sampling(lambda now: 0.001 if now < 1.0 else 0.2)
    acquisition.pass_time(1.0)
    assert acquisition.measure() == {}
    acquisition.pass_time(0.2)
    assert acquisition.measure() == {}
    acquisition, _ = sampling(lambda _now: 0.01)
    acquisition.pass_time(1.0)
    assert acquisition.measure()["supply"] > 1.08


def test_while_it_vents_one_silent_device_hinders_no_other_ones_values():
    clock = Passing()
    other = replace(GAUGE, name="other", channels=(replace(CHANNEL, name="pressure", device="other"),))
    bench = replace(mounted("mock-realtime").bench, devices=(other, GAUGE), trips=())
    gone, vents = Queue(clock, lambda _now: 0.001, "pressure"), []

    def collect(of=gone.collect):
        if vents:
            raise DeviceError("other", "no answer")
        return of()

    gone.collect = collect
    streams = {"other": gone, "gauge": Queue(clock, lambda _now: 0.001)}
    acquisition = Acquisition(bench, streams, clock, 500.0, (), NoRecord())
    acquisition.start()
    acquisition.pass_time(1.0)
    vents.append(True)
    with pytest.raises(DeviceError, match="no answer"):
        acquisition.measure()
    acquisition.begin_safe_state()
    assert acquisition.measure().keys() == {"supply"}


def test_a_device_that_is_not_what_it_was_ends_the_run_and_confirms_nothing():
    def changed(now):
        if now > 1.0:
            raise LimitRefused("gauge: its serial was 1 when the bench was armed and is 2 now")

    acquisition, _ = sampling(lambda _now: 0.001)
    acquisition.question, began = changed, []
    acquisition.on_trip = lambda why, latches, _hurry: began.append((why, latches))
    with pytest.raises(LimitTripped, match="its serial was 1"):
        acquisition.pass_time(5.0)
    assert began == [("gauge: its serial was 1 when the bench was armed and is 2 now", True)]
    acquisition.begin_safe_state()
    assert acquisition.measure() == {}


def test_a_trial_waits_for_its_last_samples():
    acquisition, kept = sampling(lambda now: 0.001 if now < 1.0 else 0.2)
    executor = Executor(plan(record=("supply",)), acquisition._bench, None, acquisition, kept, None, acquisition.clock)
    acquisition.pass_time(0.5)
    executor.do(Record("t", True, 0))
    acquisition.pass_time(1.5)
    ended = acquisition.clock.now()
    executor.do(Record("t", False, 0))
    assert kept.events[-1][:2] == ("trial-end", ended)
    inside = [moment for moment in kept.times if moment <= ended + 1e-9]
    assert inside[-1] == pytest.approx(ended, abs=1.01 * PERIOD)
    assert set(np.round(np.diff(inside), 6)) == {PERIOD}
    assert acquisition.clock.now() == pytest.approx(ended + 0.2, abs=0.02)


def test_a_trial_whose_last_samples_never_come_is_not_finished():
    acquisition, kept = sampling(lambda now: 0.001 if now < 1.0 else now - 0.9)
    executor = Executor(plan(record=("supply",)), acquisition._bench, None, acquisition, kept, None, acquisition.clock)
    executor.do(Record("t", True, 0))
    acquisition.pass_time(1.2)
    with pytest.raises(DeviceError, match="gauge"):
        executor.do(Record("t", False, 0))
    assert executor.finished == set()
    assert "trial-end" not in [kind for kind, _, _ in kept.events]


class EverLater(Reader):
    """For whole runs: the same device, from when its file exists on; it writes down what it gives."""

    def __init__(self, device, clock):
        super().__init__(device, clock)
        self._began = time.monotonic()
        self._queue = Queue(self, self._delay)

    def now(self):
        return time.monotonic() - self._began

    def _delay(self, _now):
        if not self._flag.exists():
            return 0.0
        return min(0.5 * (time.time() - self._flag.stat().st_mtime), 2.0)

    def collect(self):
        return self._queue.collect()


@pytest.mark.realtime
@pytest.mark.singly
def test_a_run_with_samples_that_come_ever_later_ends_vented(tmp_path):
    gauge = replace(GAUGE, driver=f"{__name__}:EverLater", address=str(tmp_path / "late"))
    with Forks() as forks, served(tmp_path) as (bench, plant):
        run = Run(forks, replace(bench, devices=(*bench.devices, gauge)), plant, tmp_path / "run", "hold")
        try:
            run.in_step()
            (tmp_path / "late").touch()
            begun = time.monotonic()
            eventually(lambda: run.said("status"), 8.0)
            assert 1.0 < assert_safe_since(plant, begun) < 3.0
            assert run.end() == 4, run.lines()
        finally:
            run.kill_rest()
        assert run.said("status") == "error"
        assert run.said("why").startswith("gauge: its samples come ")
        assert run.said("vent") == "confirmed"
