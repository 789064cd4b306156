"""The laser driver in front of an emulated ILD1420 on a pseudo-terminal: the stream, and everything that goes wrong."""

import itertools
import math
import os
import threading
import time
from dataclasses import replace

import pytest
from pmabench_drivers.ild1420 import WRAP, Ild1420, encode

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Device, SetPoint, Stream
from tests.drivers.common import refused
from tests.drivers.ild1420.rigs import laser, rig

pytestmark = pytest.mark.realtime


@pytest.fixture
def bench(tmp_path):
    with rig(laser(tmp_path / "laser")) as (emulator, driver):
        yield emulator.devices["laser"], driver, emulator


def gather(driver, seconds):
    """Times [ns] and distances of so many seconds."""
    times, values, deadline = [], [], time.monotonic() + seconds
    while time.monotonic() < deadline:
        time.sleep(0.02)
        block = driver.collect()
        times += block.time
        values += block.columns["displacement"]
    return times, values


def failure(driver, within=3.0):
    """What `collect` raises within a time."""
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        try:
            driver.collect()
        except DeviceError as error:
            return str(error)
        time.sleep(0.01)
    return None


def test_it_says_who_it_is_and_only_measures(bench, tmp_path):
    _sensor, driver, _ = bench
    assert isinstance(driver, Device)
    assert isinstance(driver, Stream)
    assert not isinstance(driver, SetPoint)
    driver.close()
    identity = driver.open()
    assert identity.model == "emulated unproven ILD1420-100"
    assert identity.simulated


def test_its_key_is_locked_where_it_can_be(bench):
    """A press of it sets zero, which shifts the displacement by 45 mm."""
    sensor, driver, _ = bench
    assert sensor.locked
    obeyed = sensor._carry_out
    sensor._carry_out = lambda word, value: "E220 unknown command" if word == "KEYLOCK" else obeyed(word, value)
    driver.open()


def lose(device, number):
    """The commands that a device gets from now on, of which it does not hear the one with this number."""
    heard, obeyed = [], device.command

    def command(line):
        heard.append(line)
        if len(heard) - 1 != number:
            obeyed(line)

    device.command = command
    return heard


@pytest.mark.parametrize("number", range(8))
def test_a_command_that_is_lost_is_sent_again(bench, number):
    sensor, driver, _ = bench
    heard = lose(sensor, number)
    driver.open()
    driver.start(1000.0)
    assert failure(driver, 0.1) is None
    assert heard[number] == heard[number + 1]


def test_every_measurement_comes_once_at_the_sensors_own_pace(bench):
    _sensor, driver, _ = bench
    assert driver.start(100.0) == 1000.0
    times, values = gather(driver, 1.0)
    steps = {later - earlier for earlier, later in itertools.pairwise(times)}
    assert steps <= {999_999, 1_000_000, 1_000_001}
    assert len(times) > 500
    assert driver.lost == 0
    assert values[-1] == pytest.approx(5.0, abs=0.002)  # the plant at rest, 5 mm from the begin; 1.6 um a step


def test_it_shows_what_the_plant_does(bench):
    _sensor, driver, emulator = bench
    emulator.plant.load(58.86, 8.0)
    emulator.plant.command(300e3)
    time.sleep(1.5)
    driver.start(1000.0)
    _times, values = gather(driver, 0.2)
    assert values[-1] - 5.0 == pytest.approx(31.91, abs=0.2)  # the equilibrium of the plant's own example


def test_lost_measurements_are_a_gap_of_their_length_at_their_place(bench):
    """25 measurements are lost where the counter begins again: 26 periods to the next one but one, and the same clock."""
    sensor, driver, _ = bench
    sensor.counter = WRAP - 150
    driver.start(1000.0)
    times, _ = gather(driver, 0.1)
    sensor.faults.set("lost", count=25)
    more, _ = gather(driver, 0.4)
    times += more
    steps = [later - earlier for earlier, later in itertools.pairwise(times)]
    assert [round(step / 1e6) for step in steps if step > 1_500_000] == [27]
    assert driver.lost == 26
    assert all(abs(t - times[0] - 1_000_000 * round((t - times[0]) / 1e6)) <= 1 for t in times)


@pytest.mark.parametrize(("kind", "value"), [("truncated", 1), ("truncated", 4), ("garbage", 0)])
def test_broken_measurements_are_gaps_and_never_numbers(bench, kind, value):
    sensor, driver, _ = bench
    driver.start(1000.0)
    values = []
    for _ in range(10):
        values += gather(driver, 0.05)[1]
        sensor.faults.set(kind, value, 1)
    values += gather(driver, 0.1)[1]
    assert len(values) > 200
    assert all(found == pytest.approx(5.0, abs=0.002) for found in values)
    assert 10 <= driver.lost <= 50


def test_each_measurement_twice_is_recorded_once(bench):
    sensor, driver, _ = bench
    driver.start(1000.0)
    sensor.faults.set("double")
    times, _ = gather(driver, 0.3)
    assert max(later - earlier for earlier, later in itertools.pairwise(times)) <= 1_000_001


@pytest.mark.parametrize(("kind", "value"), [("over", 0.0), ("exception", 262076.0)])
def test_nothing_before_the_laser_is_no_number_and_no_end(bench, kind, value):
    sensor, driver, _ = bench
    driver.start(1000.0)
    sensor.faults.set(kind, value)
    gather(driver, 0.1)
    _times, values = gather(driver, 0.7)
    assert len(values) > 200
    assert all(math.isnan(found) for found in values)
    sensor.faults.set("clear")
    assert failure(driver, 0.2) is None


@pytest.mark.parametrize(
    ("code", "words"),
    [(262075, "more than its baud rate"), (262082, "laser switched off"), (70000, "no distance: a master value")],
)
def test_a_sensor_that_is_set_wrong_is_an_error_in_words(bench, code, words):
    sensor, driver, _ = bench
    driver.start(1000.0)
    sensor.faults.set("exception", code)
    assert words in failure(driver)


@pytest.mark.parametrize(("kind", "value"), [("lost", 1), ("truncated", 6), ("garbage", 0)])
def test_silence_and_noise_are_soon_an_error_and_over_when_begun_again(bench, kind, value):
    sensor, driver, _ = bench
    driver.start(1000.0)
    sensor.faults.set(kind, value)
    assert failure(driver) == "laser: sends no measurement that can be read for 0.5 s"
    sensor.faults.set("clear")
    driver.start(1000.0)
    assert failure(driver, 0.3) is None


def test_a_counter_that_begins_elsewhere_is_an_error(bench):
    sensor, driver, _ = bench
    driver.start(1000.0)
    gather(driver, 0.1)
    sensor.counter = 200_000
    assert "counter has jumped" in failure(driver)


def test_another_rate_than_agreed_is_an_error(bench):
    sensor, driver, _ = bench
    driver.start(1000.0)
    sensor._rate = 500.0
    why = failure(driver, 6.0)
    assert why == "laser: measures slower than the 1000 Hz that it was set to"


def test_a_stream_that_a_dead_program_left_is_quieted(tmp_path):
    """Nobody has read for a while and the terminal is full of measurements: opening takes hold of it all the same."""
    record = laser(tmp_path / "laser", rate="4 kHz")
    with rig(record) as (_emulator, driver):
        driver.start(100.0)
        driver._link.hush()  # as killed: nothing is read, nothing is said
        time.sleep(0.5)
        driver._link.close()
        driver._link = None
        start = time.monotonic()
        driver.open()
        assert time.monotonic() - start < 2.0
        driver.start(100.0)
        _times, values = gather(driver, 0.2)
        assert len(values) > 200
        assert all(value == pytest.approx(5.0, abs=0.002) for value in values)


def test_what_does_not_answer_or_refuses_is_not_opened(tmp_path):
    record = laser(tmp_path / "laser")
    why = refused(record, lambda sensor: sensor.faults.set("silence"))
    assert why == 'laser: sent nothing when it was asked "OUTPUT NONE"'
    why = refused(record, lambda sensor: sensor.faults.set("truncated", 1))
    assert "without the end of an answer" in why
    assert 'refuses "MEASRATE 3": E220' in refused(laser(tmp_path / "laser", rate="3 kHz"), lambda _sensor: None)


def test_another_range_than_the_bench_says_is_refused(tmp_path):
    record = laser(tmp_path / "laser")

    def other(sensor):
        sensor._options = replace(sensor._options, range=50)

    assert refused(record, other) == "laser: is a sensor of 50.00mm, and the bench file says 100 mm"


def test_a_recorded_stream_is_read_whatever_reads_before_it(tmp_path):
    """A far end written by hand: prompts as the manual prints them, then a stream cut at odd places."""
    near, far = os.openpty()
    answers = {
        b"GETINFO": b"GETINFO\r\nName: ILD1420-100   //Model name\r\nSerial: 15030002\r\nOption: 000\r\n"
        b"Article: 4120212\r\nCable head: Wire\r\nMeasuring range: 100.00mm\r\nVersion: 001.010\r\n"
        b"Hardware-rev: 00\r\nBoot-version: 001.000\r\n->"
    }
    ended = threading.Event()

    def serve():
        asked = b""
        while not ended.is_set():
            try:
                asked += os.read(near, 100)
            except OSError:
                return
            *lines, asked = asked.split(b"\n")
            for line in lines:
                os.write(near, answers.get(line, line + b" ok\r\n->"))
                if line == b"OUTPUT RS422":
                    stream = b"".join(encode(643 + i, 7 + i) for i in range(50))
                    for cut in range(0, len(stream), 7):
                        os.write(near, stream[cut : cut + 7])

    thread = threading.Thread(target=serve, daemon=True)
    import tty

    tty.setraw(far)
    thread.start()
    driver = Ild1420(laser(os.ttyname(far)), RealClock())
    try:
        identity = driver.open()
        assert (identity.model, identity.serial, identity.firmware) == ("ILD1420-100", "15030002", "001.010")
        assert not identity.simulated
        driver.start(1.0)
        time.sleep(0.2)
        values = driver.collect().columns["displacement"]
        assert len(values) == 49
        assert values[0] == pytest.approx(100 * 102 / 65520 / 100 * 644 - 1.0, abs=1e-9)
    finally:
        driver.close()
        ended.set()
        os.close(far)
        os.close(near)


@pytest.mark.slow
def test_sixty_seconds_at_two_kilohertz_without_a_lost_measurement(tmp_path):
    with rig(laser(tmp_path / "laser", rate="2 kHz")) as (_sensor, driver):
        driver.start(100.0)
        times, _ = gather(driver, 60.0)
        steps = {later - earlier for earlier, later in itertools.pairwise(times)}
    assert driver.lost == 0
    assert len(times) > 100_000
    assert max(steps) <= 500_001
