"""Adapters of three kinds, and sensors that only send."""

import os
import time
import tty

import pytest
from pmabench_drivers.canbus.frames import Frame
from pmabench_drivers.canbus.link import PythonCan, Slcan

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Scale
from tests.drivers.can.rigs import bus, channel, rig
from tests.drivers.can.test_dbc import LOAD_CELL
from tests.drivers.common import until

pytestmark = pytest.mark.realtime

FRAME, LONG = Frame(0x185, b"\x01\x02\x03"), Frame(0x18FEF1FE, bytes(range(8)), extended=True)
SENSORS = (
    channel("force", "force", "LoadCell.Force", Scale(), "N"),
    channel("pressure", "pressure", "Floats.Small", Scale(1e5), "bar"),
)


def test_python_can_carries_frames_both_ways():
    one, other = (PythonCan("virtual", "pmabench-test", 500_000) for _ in range(2))
    try:
        for frame in (FRAME, LONG):
            one.send(frame)
            assert other.receive(1.0) == frame
        assert other.receive(0.01) is None
    finally:
        one.close()
        other.close()


def test_what_python_can_says_is_an_error_of_the_system():
    with pytest.raises(OSError, match="interface"):
        PythonCan("no-such-interface", "can0", 500_000)


def test_a_serial_slcan_adapter_is_opened_and_given_its_rate():
    near, far = os.openpty()
    tty.setraw(far)
    try:
        adapter = Slcan(os.ttyname(far), 250_000)
        assert os.read(near, 100) == b"\rC\rS5\rO\r"
        adapter.send(FRAME)
        assert os.read(near, 100) == b"t1853010203\r"
        os.write(near, b"z\rt1\xff\x07\x0712T18FEF1FE80001020304050607\rT18FEF1FE80001020304050607\r")
        frames = [adapter.receive(0.05) for _ in range(3)]
        assert LONG in frames  # and what came broken before it is none
        adapter.close()
        assert os.read(near, 100) == b"C\r"
    finally:
        os.close(near)
        os.close(far)


def test_sensors_of_a_dbc_file_alone():
    with rig(bus(nodes={}, channels=SENSORS, dbc=LOAD_CELL), opened=False) as (emulator, _served, driver):
        assert driver.open().simulated  # the emulated adapter says it; such sensors say nothing of themselves
        emulator.plant.command(300e3)
        emulator.plant.load(58.86, 8.0)
        driver.start(100.0)
        assert until(lambda: len(driver.collect().time))
        time.sleep(1.0)
        block = driver.collect()
        truth = emulator.plant.quantities()
        assert block.columns["force"][-1] == pytest.approx(truth["force"], abs=0.5)
        assert block.columns["pressure"][-1] == pytest.approx(truth["pressure"] / 1e5, rel=0.01)  # bar


def test_a_sensor_that_falls_silent_is_named():
    with rig(bus(nodes={}, channels=SENSORS, dbc=LOAD_CELL)) as (_emulator, served, driver):
        driver.start(100.0)
        assert until(lambda: len(driver.collect().time))
        served.faults.set("lost")
        with pytest.raises(DeviceError, match=r"LoadCell.Force did not come for 0.1 s"):
            until(lambda: driver.collect() and False)
