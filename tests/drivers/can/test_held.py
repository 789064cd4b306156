"""What a bus reports of its nodes while it is armed: restarts, lost watchdogs, another node in place of one."""

import contextlib

import pytest

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Supervised
from tests.drivers.can.rigs import bus, rig
from tests.drivers.common import timed, until

pytestmark = pytest.mark.realtime


@pytest.fixture
def armed():
    """Armed for 20 s, so that nobody needs to feed it: the driver, the emulated bus, what is held."""
    with rig() as (_emulator, served, driver):
        driver.arm_watchdog(20.0)
        driver.start(100.0)
        yield driver, served, driver.held()


def changed(driver, before):
    now = driver.held()
    assert now.keys() == before.keys()
    return {name for name in now if now[name] != before[name]}


def test_it_is_read_anew_in_time_and_stays_as_it_is(armed):
    driver, _served, before = armed
    assert isinstance(driver, Supervised)
    starts = {
        name: before[name] for name in ("drive starts", "transducer starts")
    }  # 1: it was open before they were on
    assert before == {
        **starts,
        "watchdog": 20.0,
        "drive state": "operational",
        "transducer state": "operational",
        "drive error register": 0.0,
        "transducer error register": 0.0,
        "drive serial number": "5",
        "transducer serial number": "12",
        "transducer measuring step": 1000.0,
        "transducer mapping": "60200120h",
        "drive position mapping": "60640020h",
        "drive target mapping": "607A0020h",
    }
    driver.write("drive.position", 5000.0)
    for _ in range(10):
        took, now = timed(driver.held)
        assert now == before
        assert took < 0.2
    assert driver.collect().time


def test_a_restart_shows_in_watchdog_starts_and_state(armed):
    driver, served, before = armed
    driver.write("drive.position", 5000.0)
    served.faults.set("restart")

    def started():
        with contextlib.suppress(DeviceError):  # while it starts it does not answer
            return driver.held()["drive starts"] == before["drive starts"] + 1

    assert until(started)
    assert changed(driver, before) >= {"watchdog", "drive starts", "drive state", "transducer starts"}
    assert driver.held()["watchdog"] == 0
    assert driver.read_back("drive.position") != 5000  # it stands where it was, without power
    with pytest.raises(DeviceError, match="has started again"):
        driver.feed_watchdog()


def test_a_watchdog_that_somebody_changed_shows(armed):
    driver, served, before = armed
    served.nodes["drive"].put(0x1016, 1, (127 << 16 | 5000).to_bytes(4, "little"))
    assert changed(driver, before) == {"watchdog"}
    assert driver.held()["watchdog"] == 5.0
    served.nodes["drive"].put(0x1016, 1, (99 << 16 | 20_000).to_bytes(4, "little"))  # it waits for another node
    assert driver.held()["watchdog"] == 0
    served.nodes["drive"].put(0x1016, 1, bytes(4))
    assert driver.held()["watchdog"] == 0


def test_a_watchdog_that_has_fired_shows_until_the_next_heartbeat(armed):
    driver, served, before = armed
    assert served.expire_watchdog()
    assert until(lambda: driver.held()["watchdog"] == 0)
    assert changed(driver, before) == {"watchdog", "drive error register"}


def test_another_node_in_place_of_one_shows(armed):
    driver, served, before = armed
    served.nodes["transducer"].preset(0x1018, 4, 4711)
    assert changed(driver, before) == {"transducer serial number"}


@pytest.mark.parametrize(
    ("node", "index", "sub", "value", "what"),
    [
        ("transducer", 0x6005, 1, 500, "transducer measuring step"),
        ("transducer", 0x1A00, 1, 0x60040020, "transducer mapping"),
        ("drive", 0x1A00, 2, 0x60620020, "drive position mapping"),
        ("drive", 0x1600, 1, 0x60810020, "drive target mapping"),
    ],
)
def test_what_gives_its_numbers_another_meaning_shows(armed, node, index, sub, value, what):
    """A transducer that started again in 60 ms with another step, its word of it lost, doubled every displacement."""
    driver, served, before = armed
    served.nodes[node].preset(index, sub, value)
    assert changed(driver, before) == {what}


def test_a_set_point_from_outside_is_read_back(armed):
    driver, served, _before = armed
    driver.write("drive.position", 5000.0)
    assert driver.read_back("drive.position") == 5000
    served.nodes["drive"].put(0x607A, 0, (7000).to_bytes(4, "little"))
    assert driver.read_back("drive.position") == 7000


def test_a_silent_node_is_an_error_and_a_bus_without_drives_has_no_watchdog(armed):
    driver, served, _before = armed
    served.faults.set("silence")
    served.faults.set("lost")
    took, outcome = timed(driver.held)
    assert isinstance(outcome, DeviceError)
    assert took < 0.25
    nodes = {"transducer": {"profile": 406, "node": 12}}
    with rig(bus(channels=bus().channels[:1], nodes=nodes)) as (_emulator, _bus, alone):
        assert "watchdog" not in alone.held()
