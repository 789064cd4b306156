"""The driver in front of two boards that know nothing of each other: the emulator, and the sketch's own code compiled."""

import itertools
import math
import os
import pathlib
import random
import subprocess
import time

import pytest
from pmabench_drivers.serial_line_daq import SerialLineDaq

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Device, Follower, Inputs, Rescue, Segment, SetPoint, Stream, Switch, Watchdog
from tests.drivers.common import opened, timed
from tests.drivers.serial_line_daq.rigs import LATE, SKETCH, board, collected, compiled, emulated, gather, sketch
from tests.reliability.cases import cases

pytestmark = pytest.mark.realtime
WRAPS_SOON = (1 << 32) - 300_000


@pytest.fixture(scope="session")
def program(tmp_path_factory):
    return compiled(tmp_path_factory.mktemp("sketch"))


@pytest.fixture(params=["emulator", "sketch"])
def address(request, tmp_path):
    if request.param == "emulator":
        with emulated(tmp_path / "board", WRAPS_SOON) as served:
            yield served.address
    else:
        with sketch(request.getfixturevalue("program"), WRAPS_SOON) as port:
            yield port


@pytest.fixture
def device(address):
    with opened(board(address)) as driver:
        yield driver


def fed(device, seconds):
    """Keep its watchdog quiet for a time."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        device.feed_watchdog()
        time.sleep(0.02)


def test_who_it_is(address):
    with opened(board(address)) as driver:
        for capability in (Device, Stream, SetPoint, Follower, Switch, Inputs, Watchdog, Rescue):
            assert isinstance(driver, capability)
        identity = driver.open()
        assert identity.simulated
        assert identity.firmware == "line-daq 1"


def test_samples_have_the_boards_clock_also_where_it_wraps(device):
    assert device.start(200.0) == 200.0
    times, columns = gather(device, 1.0)
    steps = [b - a for a, b in itertools.pairwise(times)]
    assert min(steps) > 0
    assert sum(steps) > 0.4e9  # its clock has wrapped
    assert sum(steps) == pytest.approx((len(steps) + device.missed) * 5e6, abs=5.1e6)
    assert all(len(column) == len(times) for column in columns.values())


def test_it_is_no_faster_than_the_board_and_never_another_rate_than_it_says(device):
    assert device.start(100_000.0) == 500.0
    block = device.collect()
    while not len(block.time):
        block = device.collect()
    assert 0 < block.host <= device._clock.now() * 1e9  # when the newest came, in bench time
    assert block.host > (device._clock.now() - LATE) * 1e9
    assert device.start(3.0) == pytest.approx(3.0, abs=1e-5)
    for rate in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(DeviceError):
            device.start(rate)


def test_nothing_goes_on_before_the_watchdog_is_armed(device):
    for call in (lambda: device.write("o0", 100.0), lambda: device.switch("v0", on=True)):
        with pytest.raises(DeviceError, match="watchdog is not armed"):
            call()
    device.write("o0", 0.0)
    device.switch("v0", on=False)
    assert device.read_back("o0") == 0.0
    assert not device.is_on("v0")


def test_commands_are_held_and_read_back(device):
    assert device.arm_watchdog(1.0) == 1.0
    for value in (1.0, 4095.0, 300.0):
        device.write("o0", value)
        assert device.read_back("o0") == value
    device.switch("v0", on=True)
    assert device.is_on("v0")
    assert device.level("d0")
    device.rescue("o0", 0.0)
    device.rescue("v0", 0.0)
    assert (device.read_back("o0"), device.is_on("v0")) == (0.0, False)
    for value in (4096.0, -1.0, math.nan, math.inf):
        with pytest.raises(DeviceError, match="0 to 4095 counts"):
            device.write("o0", value)
    with pytest.raises(DeviceError, match='no output "o1"'):
        device.write("o1", 0.0)
    with pytest.raises(DeviceError, match='"v3" is none'):
        device.switch("v3", on=True)


def test_the_board_vents_after_silence_whatever_else_is_said_and_stays_so_until_it_is_armed_again(device):
    assert device.arm_watchdog(0.8) == 0.8
    device.start(100.0)
    device.switch("v0", on=True)
    device.write("o0", 300.0)
    fed(device, 1.0)
    assert device.read_back("o0") == 300.0  # fed for longer than its time
    device.feed_watchdog()
    silent = time.monotonic()
    while device.read_back("o0") == 300.0:  # questions are no sign of life, neither are samples
        assert time.monotonic() - silent < 1.5
        time.sleep(0.005)
    assert 0.78 < time.monotonic() - silent
    assert not device.is_on("v0")
    reported = ""
    while "has vented by itself" not in reported:
        reported = str(timed(device.collect)[1])
        assert time.monotonic() - silent < 5.0
    assert collected(device, 5)  # told once: what comes after shows whether it is empty
    for call in (device.feed_watchdog, lambda: device.write("o0", 5.0), lambda: device.switch("v0", on=True)):
        with pytest.raises(DeviceError, match="has vented by itself"):
            call()
    device.write("o0", 0.0)
    device.arm_watchdog(0.8)
    device.write("o0", 5.0)
    assert device.read_back("o0") == 5.0


def test_disarming_leaves_nothing_on(device):
    device.arm_watchdog(1.0)
    device.write("o0", 300.0)
    device.switch("v0", on=True)
    device.disarm_watchdog()
    assert (device.read_back("o0"), device.is_on("v0")) == (0.0, False)
    with pytest.raises(DeviceError, match="not armed"):
        device.feed_watchdog()
    for seconds in (0.0, math.nan, 0.01, 1.5):
        with pytest.raises(DeviceError):
            device.arm_watchdog(seconds)


def test_a_ramp_and_a_sine_are_stepped_and_a_write_ends_them(device):
    device.arm_watchdog(1.0)
    now = device._clock.now()
    device.follow("o0", Segment("ramp", now, 100.0, target=400.0, rate=1000.0))
    seen = []
    for _ in range(40):
        device.feed_watchdog()
        seen.append(device.read_back("o0"))
        time.sleep(0.01)
    assert seen == sorted(seen)
    assert len(set(seen)) > 8
    assert seen[-1] == 400.0
    device.follow("o0", Segment("sine", device._clock.now(), 400.0, amplitude=100.0, frequency=5.0, cycles=1000.0))
    seen = []
    for _ in range(40):
        device.feed_watchdog()
        seen.append(device.read_back("o0"))
        time.sleep(0.01)
    assert min(seen) >= 300.0
    assert max(seen) <= 500.0
    assert max(seen) - min(seen) > 150.0
    device.write("o0", 7.0)
    time.sleep(0.1)
    assert device.read_back("o0") == 7.0


def test_garbage_towards_the_board_is_not_obeyed_and_the_next_command_is(address):
    """Hostile bytes into the board: it still answers, holds what it held, and never touches memory that is not its own."""
    chance = random.Random(11)
    with opened(board(address)) as driver:
        driver.arm_watchdog(1.0)
        driver.write("o0", 250.0)
    port = os.open(address, os.O_RDWR | os.O_NOCTTY)
    try:
        for _ in range(cases(300)):
            kind = chance.randrange(3)
            if kind == 0:
                data = chance.randbytes(chance.randrange(1, 200))
            elif kind == 1:
                data = b"W,1,0,%d*%04X\n" % (chance.randrange(4096), chance.randrange(1 << 16))
            else:
                data = b"W,1,0,4095*" + b"9" * chance.randrange(300) + b"\n"
            os.write(port, data)
            if chance.random() < 0.2:
                time.sleep(0.002)
        os.write(port, b"\n")
    finally:
        os.close(port)
    with opened(board(address)) as driver:
        assert driver.read_back("o0") in {250.0, 0.0}  # 0: its watchdog was not fed meanwhile
        driver.arm_watchdog(1.0)
        driver.write("o0", 123.0)
        assert driver.read_back("o0") == 123.0


def test_counts_of_32_bits_arrive_whole(program):
    """The compiled sketch reads the lowest count there is on a2, and counts its readings on a1."""
    with sketch(program) as port, opened(board(port)) as driver:
        driver.start(500.0)
        _, columns = collected(driver, 50)
        assert set(columns["force"]) == {-2147483648.0}
        assert columns["displacement"] == [
            float(n)
            for n in range(int(columns["displacement"][0]), len(columns["force"]) + int(columns["displacement"][0]))
        ]


def test_a_board_that_is_late_leaves_periods_out_and_says_so(program):
    """Every 50th reading takes 23 ms, at 200 Hz: at least 3 numbers are missing there, and the times agree."""
    with sketch(program, stall=23_000) as port, opened(board(port)) as driver:
        driver.start(200.0)
        times, columns = collected(driver, 201)
        steps = [b - a for a, b in itertools.pairwise(times)]
        late = [i for i, reading in enumerate(columns["displacement"][:-1]) if reading % 50 == 49]
        assert len(late) == 4
        assert min(steps[i] for i in late) > 20e6
        assert driver.missed >= 12
        assert sum(steps) == pytest.approx((len(steps) + driver.missed) * 5e6, abs=5.1e6)


def test_levels_are_read_one_by_one(program):
    """Level 1 of the compiled sketch shows valve 0."""
    with sketch(program) as port, opened(board(port)) as driver:
        driver.arm_watchdog(1.0)
        assert (driver.level("d0"), driver.level("d1")) == (True, False)
        driver.switch("v0", on=True)
        assert (driver.level("d0"), driver.level("d1")) == (True, True)
        with pytest.raises(DeviceError, match='"d2" is none'):
            driver.level("d2")


def test_a_board_that_dies_is_an_error_and_after_it_is_back_it_opens_again(program):
    with sketch(program) as port:
        driver = SerialLineDaq(board(port), RealClock())
        driver.open()
        driver.start(100.0)
        gather(driver, 0.1)
    try:
        time.sleep(0.1)
        timed(driver.collect)  # what came before it died
        for call in (driver.collect, lambda: driver.write("o0", 0.0), lambda: driver.rescue("v0", 0.0)):
            took, error = timed(call)
            assert isinstance(error, DeviceError)
            assert took < LATE
    finally:
        driver.close()
    with sketch(program) as port, opened(board(port)) as again:
        again.start(100.0)
        assert collected(again, 5)


def test_the_sketch_is_short():
    assert sum(len(path.read_text().splitlines()) for path in SKETCH.iterdir()) < 250


def test_the_sketch_compiles_for_an_uno(tmp_path):
    """With Debian's compiler and Arduino core, where they are installed."""
    core = "/usr/share/arduino/hardware/arduino/avr"
    try:
        subprocess.run(["avr-g++", "--version"], check=True, capture_output=True)
    except OSError:
        pytest.skip("not run: no AVR compiler")
    if not pathlib.Path(core).is_dir():
        pytest.skip("not run: no AVR compiler")
    source = tmp_path / "sketch.cpp"
    source.write_text("#include <Arduino.h>\n" + (SKETCH / "serial_line_daq.ino").read_text())
    folders = [f"-I{core}/cores/arduino", f"-I{core}/variants/standard", f"-I{SKETCH}"]
    defines = ["-mmcu=atmega328p", "-DF_CPU=16000000L", "-DARDUINO=10819", "-DARDUINO_AVR_UNO", "-DARDUINO_ARCH_AVR"]
    command = [
        "avr-g++",
        "-fsyntax-only",
        "-O1",
        "-std=gnu++11",
        "-Wall",
        "-Wextra",
        "-Werror",
        *defines,
        *folders,
        str(source),
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
