"""Samples of the emulated USB-6215 through the driver: each once and at its place, gaps where answers were lost."""

import re
import time
from itertools import pairwise

import pytest

from pmabench.base.errors import DeviceError
from tests.drivers.ni.rigs import daq, patiently, rig, start

pytestmark = pytest.mark.realtime

TIMEBASE = 20e6


def counted(served, channels):
    """Let channel k of sample n read (8 n + k) steps, so that each sample says where it belongs."""
    board = served.board
    board._volts = lambda name, span, _quantities: (
        (8 * board.tasks[next(n for n in board.tasks if n.endswith(" ai"))].taken + int(name[2:])) % 65536 / 6553.6
        - 5.0
    )


def start_of(device):
    return device._sampling.start


def gather(device, seconds):
    """All that `collect` gives in a while: times [ns] and columns."""
    times, columns = [], {}
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        block = patiently(device.collect)
        times += block.time
        for name, column in block.columns.items():
            columns.setdefault(name, []).extend(column)
        time.sleep(0.02)
    return times, columns


def check(device, times, columns, rate):
    """Each sample is the one that its time says; the numbers of the samples, from 0."""
    begun = round(start_of(device) * 1e9)
    held = [round((t - begun) * rate / 1e9) for t in times]
    assert all(abs((t - begun) * rate / 1e9 - n) < 1e-3 for t, n in zip(times, held, strict=True))
    for k, (name, column) in enumerate(columns.items()):
        wanted = [(8 * (n + 1) + k) % 65536 / 6553.6 - 5.0 for n in held]
        assert column == pytest.approx(wanted, abs=1e-9), name
    assert all(later > earlier for earlier, later in pairwise(held))
    return held


@pytest.mark.parametrize(("channels", "rate"), [(4, 500.0), (8, 500.0), (1, 5000.0), (3, 7.0)])
def test_every_sample_comes_once_and_at_its_place(channels, rate):
    with rig(daq(channels)) as (_, served, device):
        counted(served, channels)
        used = start(device, rate)
        assert used == pytest.approx(TIMEBASE / (TIMEBASE // rate), rel=1e-12)
        times, columns = gather(device, 0.8)
        held = check(device, times, columns, used)
        assert held == list(range(len(held)))
        assert len(held) >= 0.5 * rate  # the rest is for a busy machine
        assert device.lost == 0


def test_the_rate_is_the_one_that_the_device_can_have():
    with rig() as (_, _served, device):
        assert start(device, 333.0) == TIMEBASE / 60060  # 20 MHz by a whole number
        assert start(device, 500.0) == 500.0


@pytest.mark.parametrize(("call", "gap"), [("ReadAnalogF64", True), ("GetReadAttributeUInt32", False)])
def test_a_lost_answer_is_a_gap_of_just_its_samples(call, gap):
    with rig() as (_, served, device):
        counted(served, 4)
        rate = start(device, 500.0)
        answer, lose = served._answer, [3, 9]

        def answer_or_not(grpc, name, request, context):
            if name == call and lose and len(device.asked) == lose[0]:
                del lose[0]
                served.faults.set("lost", count=1)
            device.asked += [name] * (name == call)
            return answer(grpc, name, request, context)

        device.asked = []
        served._answer = answer_or_not
        times, columns = gather(device, 0.1)
        while lose or times[-1] - times[0] < 1.5e9:
            more, more_columns = gather(device, 0.1)
            times += more
            for name, column in more_columns.items():
                columns[name] += column
        held = check(device, times, columns, rate)
        missing = set(range(held[-1] + 1)) - set(held)
        assert len(missing) == device.lost
        assert bool(missing) == gap  # what was never asked for is still there


def test_a_cut_connection_is_made_again_and_nothing_is_lost_that_was_not_asked_for():
    with rig() as (_, served, device):
        counted(served, 4)
        rate = start(device, 500.0)
        times, columns = gather(device, 0.3)
        served.serve_again(forget=False)
        more, more_columns = gather(device, 2.0)
        times += more
        for name, column in more_columns.items():
            columns[name] += column
        held = check(device, times, columns, rate)
        assert held[-1] > 1.5 * rate
        assert len(set(range(held[-1] + 1)) - set(held)) == device.lost


def test_a_server_that_was_restarted_has_no_tasks_and_that_is_reported():
    with rig() as (_, served, device):
        start(device, 500.0)
        gather(device, 0.2)
        served.serve_again(forget=True)
        with pytest.raises(DeviceError, match="sampling broke off: the task is gone: the server was restarted"):
            gather(device, 10.0)


def test_samples_that_nobody_reads_in_time_end_the_sampling():
    with rig() as (_, served, device):
        start(device, 500.0)
        gather(device, 0.1)
        [task] = [task for task in served.board.tasks.values() if task.kind == "ai"]
        task.buffer = 5
        device._sampling._cycle.stop(0.2)
        time.sleep(0.2)
        device._sampling._cycle.start(50.0)
        with pytest.raises(DeviceError, match=r"sampling broke off: samples were overwritten.*-200279"):
            gather(device, 1.0)


@pytest.mark.parametrize(
    ("code", "why"),
    [(-200361, "its memory overflowed on the way to the computer"), (-201003, "is it plugged in, and has it power")],
)
def test_errors_while_it_samples_end_it_with_the_reason(code, why):
    with rig() as (_, served, device):
        start(device, 500.0)
        gather(device, 0.1)
        served.faults.set("exception", code)
        with pytest.raises(DeviceError, match=why):
            gather(device, 1.0)


def test_silence_is_reported_with_its_reason():
    with rig() as (_, served, device):
        start(device, 500.0)
        gather(device, 0.1)
        served.faults.set("silence")
        reason = re.compile(r"no sample for \d+\.\d\d s: 127.0.0.1:\d+ did not answer")
        until, reported = time.monotonic() + 15.0, ""
        while not reason.search(reported):
            assert time.monotonic() < until, reported
            try:
                device.collect()
            except DeviceError as error:
                reported = str(error)
                assert "no sample for" in reported
            time.sleep(0.02)


def test_samples_that_fall_behind_the_rate_are_no_samples_of_that_rate():
    """A device that loses samples without a word, or runs on another clock than it says."""
    with rig() as (_, served, device):
        start(device, 500.0)
        [task] = [task for task in served.board.tasks.values() if task.kind == "ai"]
        task.rate = 400.0
        with pytest.raises(DeviceError, match=r"samples come 0.\d\d s too late for 500 Hz"):
            gather(device, 6.0)


def test_a_voltage_that_no_converter_gives_is_none():
    with rig(daq(ranges={"ai2": "1 V"})) as (_, served, device):
        start(device, 500.0)
        served.board._volts = lambda _name, _span, _quantities: 1.5
        with pytest.raises(DeviceError, match="ai2 gives 1.5 V at a range of 1 V"):
            gather(device, 1.0)


def test_times_go_on_after_a_stop():
    with rig() as (_, _served, device):
        start(device, 500.0)
        first, _ = gather(device, 0.15)
        device.stop()
        device.collect()
        assert not len(device.collect().time)
        start(device, 100.0)
        second, _ = gather(device, 0.3)
        assert second[0] > first[-1]
        device.stop()
        device.stop()


@pytest.mark.slow
def test_a_minute_of_eight_channels_without_a_loss():
    with rig(daq(8)) as (_, served, device):
        counted(served, 8)
        rate = start(device, 500.0)
        times, columns = gather(device, 60.0)
        assert check(device, times, columns, rate) == list(range(len(times)))
        assert len(times) > 29_500
