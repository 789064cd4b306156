"""The serial driver in front of emulated indicators on pseudo-terminals: polled, by itself, and everything that goes wrong."""

import contextlib
import itertools
import math
import os
import random
import time

import pytest
from pmabench_drivers.serial_ascii import SerialIndicator
from pmabench_drivers.shared.serial_port import SerialPort

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Device, SetPoint, Stream
from tests.drivers.common import opened, timed
from tests.drivers.wires.rigs import cell, emulated, gauge

pytestmark = pytest.mark.realtime


@pytest.fixture
def rig(tmp_path):
    with emulated(cell(tmp_path / "cell"), preset="ideal") as (emulator, [record]), opened(record) as device:
        emulator.plant.load(58.86, 8.0)
        yield emulator, record, device


def fault(emulator, kind, value=0.0, count=-1, name="cell"):
    emulator.devices[name].faults.set(kind, value, count)


def failure(device, within=2.0):
    """What `collect` raises within a time."""
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        took, outcome = timed(device.collect)
        assert took < 0.05
        if isinstance(outcome, Exception):
            return outcome
        time.sleep(0.01)
    return None


def test_it_measures_and_nothing_else(rig):
    device = rig[2]
    assert isinstance(device, Device)
    assert isinstance(device, Stream)
    assert not isinstance(device, SetPoint)
    assert device.start(500.0) == 100.0
    time.sleep(0.3)
    block = device.collect()
    assert len(block.time) >= 10
    assert set(block.columns["force"]) == {0.0}
    assert all(later > earlier for earlier, later in zip(block.time, block.time[1:], strict=False))


def test_one_that_sends_by_itself_keeps_its_rate(tmp_path):
    with emulated(gauge(tmp_path / "gauge"), preset="ideal") as (_, [record]), opened(record) as device:
        assert device.start(500.0) == 100.0
        time.sleep(1.0)
        block = device.collect()
        assert 80 <= len(block.time) <= 110
        assert set(block.columns["displacement"]) == {0.0}


def test_it_shows_what_the_plant_does(tmp_path):
    devices = cell(tmp_path / "cell"), gauge(tmp_path / "gauge")
    served = emulated(*devices, preset="ideal")
    with served as (emulator, [one, two]), opened(one) as force, opened(two) as displacement:
        emulator.plant.load(58.86, 8.0)
        emulator.plant.command(300e3)
        time.sleep(1.5)
        for device in (force, displacement):
            device.start(100.0)
        time.sleep(0.3)
        x = displacement.collect().columns["displacement"][-1]
        assert force.collect().columns["force"][-1] == pytest.approx(58.86, abs=0.02)
    assert x == pytest.approx(31.91, abs=0.2)  # the equilibrium of the plant's own example, 300 kPa and 58.86 N


def test_a_wrong_unit_is_an_error_and_never_a_number(rig):
    emulator, _record, device = rig
    device.start(100.0)
    time.sleep(0.1)
    device.collect()
    fault(emulator, "unit")
    error = failure(device)
    assert str(error) == 'cell: gives "kg" and the bench expects "N": set the indicator back'
    fault(emulator, "clear")
    assert failure(device, 0.1) is not None  # it stays an error until sampling is begun again
    device.start(100.0)
    assert failure(device, 0.2) is None


def test_over_range_is_no_number(rig):
    emulator, _record, device = rig
    device.start(100.0)
    fault(emulator, "over")
    time.sleep(0.1)
    device.collect()
    time.sleep(0.1)
    values = device.collect().columns["force"]
    assert len(values) > 2
    assert all(math.isnan(value) for value in values)


def test_noise_on_the_wire_is_measured_as_it_is(rig):
    emulator, _record, device = rig
    device.start(100.0)
    fault(emulator, "noise", 5.0)
    time.sleep(0.1)
    device.collect()
    time.sleep(0.3)
    values = device.collect().columns["force"]
    assert all(-5.0 <= value <= 5.0 for value in values)
    assert max(values) - min(values) > 0.5


@pytest.mark.parametrize(("kind", "value"), [("garbage", 0), ("double", 0), ("truncated", 4), ("lost", 1)])
def test_what_cannot_be_read_is_no_sample_and_soon_an_error(rig, kind, value):
    emulator, _record, device = rig
    device.start(100.0)
    time.sleep(0.1)
    fault(emulator, kind, value)
    time.sleep(0.05)
    device.collect()
    time.sleep(0.2)
    assert len(device.collect().time) == 0
    error = failure(device)
    assert "no line that can be read" in str(error)
    fault(emulator, "clear")
    device.start(100.0)
    time.sleep(0.5)
    assert len(device.collect().time) > 5


def test_a_single_bad_line_is_a_gap_and_no_error(rig):
    emulator, _record, device = rig
    device.start(100.0)
    for _ in range(10):
        fault(emulator, "garbage", count=1)
        time.sleep(0.05)
    assert failure(device, 0.3) is None


def test_late_answers_are_never_taken_for_new_ones(tmp_path):
    """The force changes at each poll, answers are 0.5 to 3 time-outs late, 100 times: no sample shows an older force."""
    chance = random.Random(3)
    # a busy machine must not keep an answer back for longer than the slowest that is said of the device
    device = cell(tmp_path / "cell", timeout="20 ms", slowest="500 ms", rate="200 Hz")
    with emulated(device, preset="ideal") as (emulator, [record]), opened(record) as driver:
        numbers = itertools.count(1)
        asked: list[int] = []

        def quantities():
            asked.append(next(numbers))
            return {"force": float(asked[-1])}

        emulator.plant.quantities = quantities
        taken = 0
        while len(asked) < 100:
            fault(emulator, "delay", chance.uniform(0.5, 3.0) * 0.02, count=1)
            before = len(asked)
            driver._tick()
            time.sleep(0.004)
            for value in driver.collect().columns["force"]:
                assert value == asked[-1]
                assert len(asked) == before + 1
                taken += 1
    assert 5 <= taken <= 60


class Pieces:
    """A port on which answers come in pieces that are drained one at a time."""

    def __init__(self, answers, drained):
        self.answers, self.drained, self.asked = iter(answers), iter(drained), 0

    def drain(self):
        return next(self.drained)

    def send(self, _question):
        self.asked += 1

    def receive(self, _whole, _seconds):
        return next(self.answers)


@pytest.mark.parametrize("lost", [b"", b"+0"])
def test_half_of_a_late_answer_is_no_answer(lost):
    """At 9600 baud a line takes 20 ms: asked again in its middle, its other half was taken for the answer."""
    device = SerialIndicator(cell("/dev/none", pattern=r"(?P<value>[+-]?\d+\.\d+)", good_status=[]), RealClock())
    device._link = port = Pieces([lost, b"+0021.00\r"], [b"", b"+001", b"2.34", b"\r"])
    asked = []
    for _ in range(4):
        device._tick()
        asked.append(port.asked)
    assert asked == [1, 1, 1, 2]
    assert list(device._samples.take().columns["force"]) == [21.0]


def test_a_port_that_takes_nothing_ends_in_time(tmp_path):
    """Nobody reads the other end: the terminal's buffer fills, and writing would block."""
    near, far = os.openpty()
    try:
        device = SerialIndicator(cell(os.ttyname(far), poll="P" * 40), RealClock())
        took, outcome = timed(device.open)
        assert isinstance(outcome, DeviceError)
        assert "sent no line that can be read" in str(outcome)
        assert took < 2.0
        os.set_blocking(far, False)
        with contextlib.suppress(BlockingIOError):
            while os.write(far, b"x" * 4096):
                pass
        took, outcome = timed(device.open)
        assert isinstance(outcome, DeviceError)
        assert took < 2.0
    finally:
        os.close(near)
        os.close(far)


def test_a_port_that_is_not_there_or_no_longer_is_said_once_with_what_to_do(tmp_path):
    """The path stood there three times, and of a plug that was pulled out "returned no data (... multiple access?)"."""
    hint, missing = "is it plugged in, and still at this address?", str(tmp_path / "nothing")
    with pytest.raises(DeviceError) as raised:
        SerialIndicator(cell(missing), RealClock()).open()
    assert str(raised.value) == f"cell: cannot open {missing}: No such file or directory: {hint}"
    near, far = os.openpty()
    port = SerialPort("cell", os.ttyname(far), 9600, RealClock())
    os.close(near)
    with contextlib.closing(port), pytest.raises(DeviceError) as raised:
        port.receive(bool, 1.0)
    os.close(far)
    assert str(raised.value).endswith(f": Input/output error: {hint}")


def test_who_it_is_can_be_asked(tmp_path):
    with emulated(cell(tmp_path / "cell", ask_identity="ID\r")) as (_, [record]):
        device = SerialIndicator(record, RealClock())
        assert device.open().model == "emulated unproven cell"
        device.close()


def test_an_indicator_that_says_something_else_is_refused_when_it_is_opened(tmp_path):
    with emulated(cell(tmp_path / "cell", emulate="hello %.1f\r"), preset="ideal") as (_, [record]):
        took, outcome = timed(SerialIndicator(record, RealClock()).open)
    assert 'it sent "hello 0.0", which is not what the pattern says' in str(outcome)
    assert took < 2.0


def test_closing_while_it_listens_is_quick_and_can_be_repeated(tmp_path):
    with emulated(gauge(tmp_path / "gauge")) as (_, [record]), opened(record) as device:
        device.start(100.0)
        time.sleep(0.05)
        took, _ = timed(device.close)
        assert took < 0.3
        device.close()
        with pytest.raises(DeviceError, match="is not open"):
            device.start(10.0)
