"""The DATAQ driver in front of an emulated device on a pseudo-terminal: the stream, and everything that goes wrong."""

import itertools
import time

import pytest

from pmabench.bench.interface import Device, SetPoint, Stream
from tests.drivers.common import refused
from tests.drivers.dataq.rigs import daq, rig
from tests.drivers.ild1420.test_driver import failure, lose

pytestmark = pytest.mark.realtime


@pytest.fixture
def bench(tmp_path):
    with rig(daq(tmp_path / "daq")) as (emulator, driver):
        yield emulator.devices["daq"], driver, emulator


def gather(driver, seconds):
    """Times [ns] and both columns [V] of so many seconds."""
    times, columns, deadline = [], {"pressure": [], "force": []}, time.monotonic() + seconds
    while time.monotonic() < deadline:
        time.sleep(0.02)
        block = driver.collect()
        times += block.time
        for name, column in columns.items():
            column += block.columns[name]
    return times, columns


def test_it_says_who_it_is_and_only_measures(bench):
    _, driver, _ = bench
    assert isinstance(driver, Device)
    assert isinstance(driver, Stream)
    assert not isinstance(driver, SetPoint)
    identity = driver.open()
    assert (identity.maker, identity.model) == ("DATAQ", "emulated unproven 2108")
    assert identity.simulated


@pytest.mark.parametrize("number", range(16))
def test_a_command_that_is_lost_is_sent_again(bench, number):
    device, driver, _ = bench
    heard = lose(device, number)
    driver.open()
    driver.start(500.0)
    assert failure(driver, 0.1) is None
    assert heard[number] == heard[number + 1]


@pytest.mark.parametrize("model", ["DI-2108", "DI-4108", "DI-1110"])
def test_every_scan_comes_once_at_the_devices_own_pace(tmp_path, model):
    with rig(daq(tmp_path / "daq", model=model)) as (emulator, driver):
        emulator.plant.command(300e3)
        time.sleep(1.0)
        assert driver.start(1000.0) == 1000.0
        times, columns = gather(driver, 0.6)
    steps = {later - earlier for earlier, later in itertools.pairwise(times)}
    assert steps <= {999_999, 1_000_000, 1_000_001}
    assert len(times) > 300
    assert driver.lost == 0
    assert columns["pressure"][-1] == pytest.approx(3.0, abs=0.02)  # 300 kPa at 1 V for 100 kPa


def test_channels_are_distinguished_and_ranges_are_set(tmp_path):
    record = daq(tmp_path / "daq", inputs=("a5", "a2"), model="DI-4108", ranges={"a5": "5 V", "a2": "0.5 V"})
    with rig(record) as (emulator, driver):
        emulator.plant.load(58.86, 8.0)
        emulator.plant.command(300e3)
        time.sleep(1.5)
        assert driver.start(500.0) == 500.0
        _, columns = gather(driver, 0.2)
        assert emulator.devices["daq"]._list == [0x402, 0x105, 0x008]
    assert columns["force"][-1] == pytest.approx(58.86 / 200, abs=0.0002)
    assert columns["pressure"][-1] == pytest.approx(3.0, abs=0.02)


@pytest.mark.parametrize(
    ("kind", "value"), [("truncated", 1), ("truncated", 2), ("truncated", 5), ("garbage", 0), ("over", 0)]
)
def test_a_broken_stream_is_begun_again_and_never_a_false_value(bench, kind, value):
    device, driver, emulator = bench
    emulator.plant.at = lambda _moment: {"pressure": 151e3, "force": 777.0}
    driver.start(500.0)
    times, columns = gather(driver, 0.3)
    device.faults.set(kind, value, 1)
    more, rest = gather(driver, 0.5)
    times += more
    assert driver.lost == 1
    gaps = [later - earlier for earlier, later in itertools.pairwise(times) if later - earlier > 3_000_000]
    assert len(gaps) == 1
    assert gaps[0] < 300_000_000
    assert all(later - earlier > 1_900_000 for earlier, later in itertools.pairwise(times))
    assert len(more) > 50
    assert all(value == pytest.approx(777.0 / 200, abs=0.0002) for value in (*columns["force"], *rest["force"]))
    assert all(value == pytest.approx(1.51, abs=0.0002) for value in (*columns["pressure"], *rest["pressure"]))


def test_a_stream_that_breaks_again_and_again_is_an_error(bench):
    device, driver, _ = bench
    driver.start(500.0)
    device.faults.set("truncated", 1)
    assert failure(driver) == "daq: lost bytes or ran over 4 times within 5 s"
    device.faults.set("clear")
    driver.start(500.0)
    assert failure(driver, 0.3) is None


def test_whole_scans_that_never_came_are_an_error(bench):
    """100 scans at 500 Hz: all that follow seem 0.2 s late."""
    device, driver, _ = bench
    driver.start(500.0)
    gather(driver, 0.5)
    device.faults.set("lost", count=100)
    why = failure(driver, 5.0)
    assert why is not None
    assert "s behind its clock: scans are lost" in why


def test_whole_scans_too_many_are_an_error(bench):
    device, driver, _ = bench
    driver.start(500.0)
    device.faults.set("double")
    assert "sends more scans than 500 a second" in failure(driver, 4.0)


def test_silence_is_soon_an_error(bench):
    device, driver, _ = bench
    driver.start(500.0)
    gather(driver, 0.1)
    device.faults.set("lost")
    assert failure(driver) == "daq: has sent no scan for 0.5 s"


def test_a_scan_that_a_dead_program_left_is_stopped(bench):
    device, driver, _ = bench
    driver.start(4000.0)
    driver._link.hush()
    time.sleep(0.3)
    driver._link.close()
    driver._link = None
    start = time.monotonic()
    driver.open()
    assert time.monotonic() - start < 2.0
    assert not device.streaming
    driver.start(500.0)
    assert failure(driver, 0.2) is None


def test_what_does_not_answer_or_is_another_model_is_not_opened(tmp_path):
    record = daq(tmp_path / "daq")
    why = refused(record, lambda device: device.faults.set("silence"))
    assert why == 'daq: did not answer "stop": is it in its CDC mode?'
    other = daq(tmp_path / "daq", model="DI-4108")

    def swap(device):
        device._options = device._options.__class__()

    assert refused(other, swap) == 'daq: is "DATAQ emulated unproven 2108", and the bench file says DI-4108'


@pytest.mark.slow
def test_sixty_seconds_at_500_hertz_without_a_loss(tmp_path):
    with rig(daq(tmp_path / "daq")) as (_emulator, driver):
        driver.start(500.0)
        times, _ = gather(driver, 60.0)
    assert driver.lost == 0
    assert len(times) > 29_000
    assert max(later - earlier for earlier, later in itertools.pairwise(times)) <= 2_000_001
