"""What a terminal reports of itself while it is armed: time-out, modules, faults, and who it is."""

import pytest

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Supervised
from tests.drivers.common import timed
from tests.drivers.festo.rigs import served

pytestmark = pytest.mark.realtime


@pytest.fixture
def armed():
    """Armed for 20 s and at 300 kPa: the driver, the inside of the terminal, what is held."""
    with served() as rig:
        rig.device.open()
        rig.device.arm_watchdog(20.0)
        rig.device.start(100.0)
        rig.device.switch("do2.0", on=True)
        rig.device.write("ao4.0", 9600.0)
        yield rig.device, rig.inside, rig.device.held()


def test_it_is_read_anew_in_time_and_stays_as_it_is(armed):
    device, _inside, before = armed
    assert isinstance(device, Supervised)
    assert before.pop("terminal").startswith("emulator of pmabench CPX-E-EP 1")
    assert {name: before.pop(name) for name in list(before) if " of " in name} == {
        "range of ai3.0": "0..10 V",
        "range of ai3.1": "-10..10 V",
        "range of ao4.0": "0..10 V",
        "data format of module 3": "sign + 15 bit",
        "data format of module 4": "sign + 15 bit",
    }
    assert before == {"watchdog": 20.0, "modules": 5.0, "modules with a fault": "none", "forced": "no"}
    device.write("ao4.0", 3200.0)
    for _ in range(10):
        took, now = timed(device.held)
        assert now.items() >= before.items()
        assert took < 0.2
    assert device.collect().time


def test_a_restart_shows_in_time_out_and_outputs(armed):
    device, inside, before = armed
    inside.restart()
    now = device.held()
    assert now.pop("watchdog") == 0.1
    assert now.items() <= before.items()
    assert (device.read_back("ao4.0"), device.is_on("do2.0")) == (0.0, False)


@pytest.mark.parametrize(
    ("name", "value", "shown", "now"),
    [
        ("timeout", 5000, "watchdog", 5.0),
        ("timeout", 0, "watchdog", 0.0),
        ("faults", 1 << 4, "modules with a fault", "4"),
        ("status", 1 << 15, "forced", "yes"),
    ],
)
def test_what_somebody_changed_shows(armed, name, value, shown, now):
    device, inside, before = armed
    setattr(inside, name, value)
    assert {key: held for key, held in device.held().items() if held != before[key]} == {shown: now}


@pytest.mark.parametrize(
    ("number", "value", "shown", "now"),
    [
        (5033, 5 | 2 << 4, "range of ai3.0", "0..20 mA"),
        (5033, 1 | 3 << 4, "range of ai3.1", "-5..5 V"),
        (5095, 4, "range of ao4.0", "1..5 V"),
        (5026, 0xE1, "data format of module 3", "linear scaled"),
    ],
)
def test_a_range_that_somebody_changed_shows(armed, number, value, shown, now):
    """A gauge at 0..20 mA reads half. Each is asked every few calls, and what has changed in the next one again."""
    device, inside, before = armed
    kept, inside.parameters[number] = inside.parameters[number], value
    changed = lambda: {key: held for key, held in device.held().items() if held != before[key]}  # noqa: E731
    assert any(changed() for _ in range(5))
    assert changed() == {shown: now}
    inside.parameters[number] = kept
    assert not all(changed() for _ in range(6))


def test_outputs_are_read_from_the_terminal_and_not_remembered(armed):
    device, inside, _before = armed
    assert inside.change_set_point(12_800.0)
    inside._put(40003, 0)  # the outputs of the 8DO
    assert device.read_back("ao4.0") in {9600.0, 12_800.0}  # it shows in the module's inputs a cycle later
    assert wait_until(lambda: device.read_back("ao4.0") == 12_800.0 and not device.is_on("do2.0"))


def wait_until(condition):
    return any(condition() for _ in range(50))


def test_a_silent_terminal_is_an_error_in_time():
    with served() as rig:
        rig.device.open()
        rig.device.arm_watchdog(20.0)
        rig.server.faults.set("silence")
        took, outcome = timed(rig.device.held)
        assert isinstance(outcome, DeviceError)
        assert took < 0.3  # 0.2 s, and what a busy machine adds
