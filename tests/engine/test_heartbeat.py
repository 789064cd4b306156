"""What holds samples up is no silence of the program: it says that it lives, and no collection of garbage stops it."""

import gc
import itertools
import threading
import time
from array import array
from dataclasses import replace

import pytest

from pmabench.base.clock import RealClock
from pmabench.base.errors import LimitTripped, RecordError
from pmabench.bench.interface import Block
from pmabench.engine.acquire import Acquisition
from pmabench.engine.recorder import NoRecord
from pmabench.engine.run import _no_long_collection
from tests.engine.benches import CHANNELS, mounted


class Slow:
    """A stream that gives nothing, whose `collect` makes one thread wait for an event."""

    def __init__(self):
        self.go, self.of = threading.Event(), None

    def start(self, rate):
        return rate

    def collect(self):
        if threading.current_thread() is self.of:
            self.go.wait(20.0)
        return Block(array("q"), {name: array("d") for name in CHANNELS}, -1)

    def stop(self):
        pass


@pytest.fixture
def made(monkeypatch):
    monkeypatch.setattr("pmabench.engine.acquire.SILENCE", 60.0)  # this device never sends a sample
    bench = replace(mounted().bench, realtime=True, trips=())
    (device,) = bench.devices
    slow = Slow()
    acquisition = Acquisition(bench, {device.name: slow}, RealClock(), 100.0, CHANNELS, NoRecord())
    beats = []
    acquisition.beat = lambda: beats.append(time.monotonic())
    acquisition.start()
    acquisition.supervise()
    yield acquisition, slow, beats
    slow.go.set()
    acquisition.stop()


def test_while_a_device_is_waited_for_the_program_says_that_it_lives(made):
    acquisition, slow, beats = made
    acquisition.pass_time(0.2)
    assert beats == []
    slow.of = executor = threading.Thread(target=acquisition.pass_time, args=(0.2,), daemon=True)
    executor.start()
    until = time.monotonic() + 10.0
    while len(beats) < 4 and time.monotonic() < until:
        time.sleep(0.01)
    assert len(beats) >= 4
    assert executor.is_alive()
    slow.go.set()
    executor.join()


@pytest.mark.realtime
def test_while_the_second_pair_of_eyes_waits_for_a_device_the_program_says_that_it_lives(made):
    """The executor is at something else; whoever looks instead of it hangs in the device."""
    _, slow, beats = made
    of = []

    def collect():
        if threading.current_thread() is not threading.main_thread():
            of.append(threading.current_thread())
            slow.go.wait(20.0)
        return Block(array("q"), {name: array("d") for name in CHANNELS}, -1)

    slow.collect = collect
    until = time.monotonic() + 1.2
    while time.monotonic() < until:
        time.sleep(0.01)
    assert len(of) == 1
    assert len(beats) > 10
    assert max(later - earlier for earlier, later in itertools.pairwise(beats)) < 0.2


def test_a_guard_that_is_asked_for_no_samples_hears_that_the_program_lives():
    """All that is measured comes from devices of the engine: nothing was said, and the guard vented."""
    bench = mounted().bench
    (device,) = bench.devices
    reader = replace(device, name="daq", outputs=(), valves=(), interlocks=(), watchdog=0.0)
    bench = replace(bench, realtime=True, trips=(), devices=(replace(device, channels=()), reader))
    acquisition = Acquisition(bench, {"daq": Slow(), device.name: object()}, RealClock(), 100.0, CHANNELS, NoRecord())
    beats = []
    acquisition.beat = lambda: beats.append(time.monotonic())
    acquisition.start()
    acquisition.pass_time(0.5)
    acquisition.stop()
    assert 5 <= len(beats) <= 11


def test_nothing_that_was_there_before_is_collected_again_during_a_run_in_real_time():
    gc.unfreeze()  # what the whole session of tests has set aside
    before = gc.get_freeze_count()
    with _no_long_collection():
        assert gc.get_freeze_count() > before + 10_000
        assert len(gc.get_objects()) < 10_000
    assert gc.get_freeze_count() == 0


@pytest.mark.parametrize(("error", "latches"), [(RecordError("full"), False), (LimitTripped("too high"), True)])
def test_what_the_second_pair_of_eyes_finds_latches_only_as_it_does_elsewhere(made, error, latches):
    """A full disk or a lost device vents; only a limit latches the bench, whichever thread meets it."""
    acquisition, slow, _ = made
    reported = []
    acquisition.on_trip = lambda why, latches, _hurry: reported.append((why, latches))

    def collect():
        raise error

    slow.collect = collect
    until = time.monotonic() + 10.0
    while not reported and time.monotonic() < until:
        time.sleep(0.01)
    assert reported == [(str(error), latches)]
