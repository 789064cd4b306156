"""The stream of the emulated T7 through the driver: every scan once, gaps at their place, ends in a sentence."""

import re
import socket
import time
from array import array
from itertools import pairwise

import pytest
from pmabench_drivers.labjack import registers as r
from pmabench_drivers.labjack.stream import Scans, StreamBroken, StreamLink

from pmabench.base.clock import VirtualClock
from pmabench.base.errors import DeviceError
from tests.drivers.common import timed
from tests.drivers.labjack.rigs import rig, t7

pytestmark = pytest.mark.realtime


def counted(served, channels):
    """Let channel k of scan n read the counts n * 8 + k, so that each sample says where it belongs."""
    served.t7.sample = lambda number: [(8 * number + k) % 65536 for k in range(channels)]


def gather(device, seconds, pause=0.02):
    """All that `collect` gives in a while: times [ns] and columns."""
    times, columns = [], None
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        block = device.collect()
        times += block.time
        columns = columns or {name: [] for name in block.columns}
        for name, column in block.columns.items():
            columns[name] += column
        time.sleep(pause)
    return times, columns


def numbers(times, start, rate):
    """The number of each scan by its time on the device's clock."""
    found = [(t - start) * rate / 1e9 for t in times]
    assert all(abs(n - round(n)) < 1e-3 for n in found)
    return [round(n) for n in found]


def check(served, device, times, columns, rate):
    """Each sample is the one that its time says; the numbers of the scans."""
    held = numbers(times, round(device._stream._start * 1e9), rate)
    tables = device._tables
    for k, (name, column) in enumerate(columns.items()):
        wanted = [tables[0][(8 * n + k) % 65536] for n in held]
        assert list(column) == wanted, name
    assert all(later > earlier for earlier, later in pairwise(held))
    return held


@pytest.mark.parametrize(("channels", "rate"), [(4, 500.0), (8, 500.0), (1, 2000.0), (3, 7.0)])
def test_every_scan_comes_once_and_at_its_place(channels, rate):
    with rig(t7(channels)) as (_, served, device):
        counted(served, channels)
        assert device.start(rate) == pytest.approx(rate, rel=1e-4)
        times, columns = gather(device, 0.7)
        held = check(served, device, times, columns, rate)
        assert held == list(range(1, len(held) + 1))
        assert len(held) >= 0.3 * rate
        assert device.lost == 0


@pytest.mark.slow
@pytest.mark.parametrize("channels", [4, 8])
def test_a_minute_without_a_lost_or_repeated_sample(channels):
    with rig(t7(channels)) as (_, served, device):
        counted(served, channels)
        device.start(500.0)
        times, columns = gather(device, 60.0)
        held = check(served, device, times, columns, 500.0)
        assert held == list(range(1, len(held) + 1))
        assert len(held) >= 29_900


def test_the_rate_is_what_the_device_says():
    """Intervals are whole 100 ns: 30 kHz becomes 10^7 / 333."""
    with rig(t7(1)) as (_, _served, device):
        assert device.start(30_000.0) == pytest.approx(1e7 / 333, rel=1e-6)
        device.stop()
        with pytest.raises(DeviceError, match="a T7 takes at most 100000"):
            device.start(100_001.0)


def test_lost_packets_are_gaps_of_their_size():
    with rig() as (_, served, device):
        counted(served, 4)
        device.start(500.0)
        first = gather(device, 0.3)
        served.faults.set("stream-lost", 3)
        second = gather(device, 0.5)
        times, columns = first[0] + second[0], {name: first[1][name] + second[1][name] for name in first[1]}
        held = check(served, device, times, columns, 500.0)
        [gap] = [(a, b) for a, b in pairwise(held) if b != a + 1]
        assert gap[1] - gap[0] - 1 == 15 == device.lost  # three packets of five scans
        assert gap[0] % 5 == 0


def test_scans_that_the_device_leaves_out_are_a_gap_of_their_size():
    with rig() as (_, served, device):
        counted(served, 4)
        device.start(500.0)
        first = gather(device, 0.3)
        served.faults.set("stream-skip", 57)
        second = gather(device, 0.6)
        times, columns = first[0] + second[0], {name: first[1][name] + second[1][name] for name in first[1]}
        held = check(served, device, times, columns, 500.0)
        [gap] = [(a, b) for a, b in pairwise(held) if b != a + 1]
        assert gap[1] - gap[0] - 1 == 57 == device.lost


@pytest.mark.slow
def test_a_buffer_that_really_overflows_leaves_one_gap():
    """At 20 kHz the 16384 samples of the buffer last 0.8 s; the link is dead for 1.2 s."""
    with rig(t7(1)) as (_, served, device):
        counted(served, 1)
        device.start(20_000.0)
        first = gather(device, 0.2)
        served.faults.set("stream-silence", 1.2)
        time.sleep(1.3)
        second = gather(device, 0.7)
        held = check(
            served, device, first[0] + second[0], {"pressure": first[1]["pressure"] + second[1]["pressure"]}, 20_000.0
        )
        gaps = [b - a - 1 for a, b in pairwise(held) if b != a + 1]
        assert len(gaps) == 1
        assert gaps[0] == device.lost > 100


@pytest.mark.parametrize(
    ("fault", "value", "why"),
    [
        ("stream-status", 2942, "scans overlap"),
        ("stream-status", 2943, "did not count what it left out"),
        ("stream-status", 2945, "its buffer was full"),
        ("stream-garbage", 40, "no stream packet"),
        ("stream-silence", 5, "has been silent for"),
    ],
)
def test_a_stream_that_fails_says_why_and_can_be_started_again(fault, value, why):
    with rig() as (_, served, device):
        counted(served, 4)
        device.start(500.0)
        gather(device, 0.2)
        served.faults.set(fault, value)
        with pytest.raises(DeviceError, match=why):
            gather(device, 2.0)
        took, _ = timed(device.start, 500.0)
        assert took < 0.3
        times, columns = gather(device, 0.3)
        assert check(served, device, times, columns, 500.0)[0] == 1


def test_a_lost_connection_is_reported_with_what_came_before_it_kept():
    with rig() as (_, served, device):
        device.start(500.0)
        time.sleep(0.2)
        served.stream._client.shutdown(socket.SHUT_RDWR)
        time.sleep(0.1)
        assert len(device.collect().time) > 30
        with pytest.raises(DeviceError, match="the device closed the connection"):
            device.collect()


def test_a_number_from_the_future_is_no_scan():
    """A packet whose number jumps by 40000 would lie minutes ahead."""
    with rig() as (_, served, device):
        counted(served, 4)
        device.start(500.0)
        gather(device, 0.1)
        device._stream._packets._expected = 20_000
        with pytest.raises(DeviceError, match="cannot have been taken"):
            gather(device, 1.0)


def test_a_stream_that_was_left_over_is_ended_first():
    with rig() as (_, served, device):
        counted(served, 4)
        device.start(500.0)
        device._stream.close()
        device._stream = None  # as if the program had died
        device.start(250.0)
        times, columns = gather(device, 0.3)
        assert check(served, device, times, columns, 250.0)[0] == 1


def test_a_second_start_goes_on_in_time():
    with rig() as (_, served, device):
        counted(served, 4)
        device.start(500.0)
        first, _ = gather(device, 0.2)
        device.stop()
        device.stop()
        assert len(device.collect().time) == 0
        device.start(500.0)
        second, _ = gather(device, 0.2)
        assert second[0] > first[-1]


def test_settings_that_the_device_does_not_hold_are_refused():
    with rig() as (_, served, device):
        served.faults.set("ignore")
        with pytest.raises(DeviceError, match="does not hold what was written for its stream: addresses"):
            device.start(500.0)
        assert device.collect().time == []


def test_ranges_and_differential_inputs_are_set_and_scaled():
    record = t7(channels=3, ranges={"AIN2": "1 V"})
    with rig(record) as (emulator, served, device):
        emulator.plant.load(58.86, 8.0)
        device.switch("FIO0", on=True)
        device.write("DAC0", 1.0)
        device.start(500.0)
        time.sleep(1.0)
        columns = device.collect().columns
        assert served.t7._f32(r.AIN_RANGE + 4) == 1.0
        assert columns["pressure"][-1] == pytest.approx(2.0, abs=1e-3)  # 100 kPa a volt
        assert 200 * columns["force"][-1] - 50 == pytest.approx(58.86, abs=2.0)  # the load that hangs there
    with rig(t7(channels=1, differential=["AIN0"])) as (_, served, device):
        device.start(500.0)
        assert served.t7._words[r.AIN_NEGATIVE] == 1


def test_arrivals_are_noted():
    with rig() as (_, _served, device):
        device.start(500.0)
        time.sleep(0.3)
        block = device.collect()
        assert 0 <= block.host - block.time[-1] < 0.2e9


@pytest.mark.parametrize(("slower", "ends"), [(1e-4, None), (0.002, 0.1 / 0.0018), (0.3, 1.0)])
def test_scans_that_come_ever_later_end_the_stream(slower, ends):
    """At 1 kHz, ten a packet, looked at each second: 0.1 s behind at 56 s, where 2 ms come each second and quartz takes 0.2."""
    scans, clock = 10, VirtualClock()
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = StreamLink("t7", ["pressure"], server.getsockname(), 1.0, clock)
        try:
            link.begin(1000.0, scans, [array("d", range(65536))])
            for packet in range(6000):
                arrived = (packet + 1) * scans / 1000.0 * (1.0 + slower)
                try:
                    link._keep(Scans(1 + packet * scans, array("H", [7] * scans)), arrived)
                except StreamBroken as error:
                    assert re.match(r"scans come 0\.\d\d s later than they did: they wait in its buffer", str(error))
                    assert ends <= arrived <= ends + 2.5
                    return
            assert ends is None
        finally:
            link.close()
