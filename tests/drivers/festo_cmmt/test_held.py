"""What a drive reports of itself while it is armed: time-out, telegram, serial number, and what forbids a motion."""

import time

import pytest

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Segment, Supervised
from tests.drivers.common import timed
from tests.drivers.festo_cmmt.rigs import served

pytestmark = pytest.mark.realtime


@pytest.fixture
def armed():
    """Armed for 20 s, under power at zero: the driver, the inside of the drive, what is held."""
    with served() as rig:
        rig.device.open()
        rig.device.arm_watchdog(20.0)
        rig.device.write("position", 0.0)
        rig.device.start(100.0)
        yield rig.device, rig.inside, rig.device.held()


def test_it_is_read_anew_in_time_and_stays_as_it_is(armed):
    device, _inside, before = armed
    assert isinstance(device, Supervised)
    assert before == {
        "watchdog": 20.0,
        "telegram": 111.0,
        "unit of the position": "1e-6 m",
        "unit of the velocity": "1e-3 m/s",
        "serial number": "EMULATED1",
        "fault": 0.0,
        "control": "by the network",
        "homed": "yes",
    }
    device.follow("position", Segment("ramp", device._clock.now(), 0.0, 5000.0, rate=20_000.0))
    for _ in range(10):
        took, now = timed(device.held)
        assert now == before
        assert took < 0.2
    assert device.collect().time


def test_a_restart_shows_in_time_out_and_ends_the_samples(armed):
    device, inside, before = armed
    device.write("position", 3000.0)
    inside.restart()
    now = device.held()
    assert {key: held for key, held in now.items() if held != before[key]} == {"watchdog": 1.0}
    with pytest.raises(DeviceError, match="is not under power"):
        collects(device)


def collects(device):
    """Collect until it fails, 2 s at most."""
    deadline = time.monotonic() + 2
    while time.monotonic() < deadline:
        device.collect()
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("name", "value", "shown", "now"),
    [
        ("timeout", 0, "watchdog", 0.0),
        ("timeout", 5000, "watchdog", 5.0),
        ("fault", 126, "fault", 126.0),
        ("control", False, "control", "elsewhere"),
        ("homed", False, "homed", "no"),
    ],
)
def test_what_somebody_changed_shows(armed, name, value, shown, now):
    device, inside, before = armed
    setattr(inside, name, value)
    assert {key: held for key, held in device.held().items() if held != before[key]} == {shown: now}


def test_another_telegram_unit_or_drive_shows_and_no_serial_number_is_no_error(armed):
    device, inside, before = armed
    inside.parameters[3490] = (1).to_bytes(2, "little")
    inside.parameters[11724] = (0xFB).to_bytes(1, "little")
    inside.parameters[11725] = (0xFE).to_bytes(1, "little")
    inside.parameters[2076] = b"ANOTHER"
    units = {"unit of the position": "1e-5 m", "unit of the velocity": "1e-2 m/s"}
    assert device.held() == {**before, "telegram": 1.0, "serial number": "ANOTHER", **units}
    del inside.parameters[2076]
    assert device.held()["serial number"] == ""


def test_the_target_is_read_from_the_drive_and_not_remembered(armed):
    device, inside, _before = armed
    device.write("position", 3000.0)
    assert device.read_back("position") == 3000.0
    device._cycle.stop(0.2)  # which sends its own target again 10 ms later
    assert inside.change_set_point(4000.0)
    assert device.read_back("position") == 4000.0


def test_a_silent_drive_is_an_error_in_time():
    with served() as rig:
        rig.armed()
        rig.server.faults.set("silence")
        took, outcome = timed(rig.device.held)
        assert isinstance(outcome, DeviceError)
        assert took < 0.3  # 0.2 s, and what a busy machine adds
