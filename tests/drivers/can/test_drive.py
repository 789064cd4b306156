"""The driver against the emulated bus: motion, refusals with their reasons, stops, heartbeats, emergencies, faults."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from pmabench_drivers.canbus import CanBus
from pmabench_drivers.canbus.frames import State

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Segment
from tests.drivers.can.rigs import CHANNELS, bus, rig
from tests.drivers.common import until

pytestmark = pytest.mark.realtime
POSITION = "drive.position"


def node(served, name="drive"):
    return served.nodes[name]


class Fed:
    """The guard's part: the heartbeat, until it is told to end."""

    def __init__(self, driver, every=0.05):
        self._driver, self._every, self._ended = driver, every, threading.Event()
        self.thread = threading.Thread(target=self._feed, daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.end()

    def end(self):
        self._ended.set()
        self.thread.join()

    def _feed(self):
        while not self._ended.wait(self._every):
            try:
                self._driver.feed_watchdog()
            except DeviceError:
                continue


def collects(driver):
    """Collect until it fails, 3 s at most."""
    until(lambda: driver.collect() and False)


def ramp(driver, origin, target, rate):
    return Segment("ramp", driver._clock.now(), origin, target, rate=rate)


def sine(driver, mean, amplitude, frequency, cycles):
    return Segment("sine", driver._clock.now(), mean, amplitude=amplitude, frequency=frequency, cycles=cycles)


def test_nothing_moves_and_no_power_is_on_before_a_command():
    with rig() as (emulator, served, driver):
        driver.arm_watchdog(0.5)
        driver.start(100.0)
        time.sleep(0.1)
        assert emulator.log.of("move") == []
        assert [entry["state"] for entry in emulator.log.of("state")] == ["ready to switch on", "switched on"]
        assert node(served).get(0x6007) == 3


def test_a_ramp_is_the_drives_own_and_a_sine_goes_target_by_target():
    with rig(bus(watchdog=0.0)) as (emulator, _served, driver):
        driver.start(100.0)
        driver.write(POSITION, 0.0)
        assert driver.read_back(POSITION) == 0.0
        driver.follow(POSITION, ramp(driver, 0, 5000, 50_000))
        assert emulator.log.of("move")[-1]["speed"] == pytest.approx(0.05)
        assert until(lambda: driver._nodes["drive"].position == 5000)
        before = len(emulator.log.of("move"))
        driver.collect()
        segment = sine(driver, 5000, 2000, 2.0, 2)
        driver.follow(POSITION, segment)
        assert until(lambda: not driver._following)
        time.sleep(0.1)
        moves = emulator.log.of("move")[before:]
        at, sent = (np.array([entry[key] for entry in moves]) for key in ("t", "si"))
        assert len(sent) > 50  # of 100 SYNCs in a second, those at which it moved
        assert 0.006 < max(sent) <= 0.007
        assert 0.003 <= min(sent) < 0.004
        assert sent[-1] == pytest.approx(0.005)
        assert max(abs(np.diff(sent))) <= 1.5 * 4 * np.pi * 0.002 * 0.01 + 2e-6  # led back gently after a stall
        wanted = 0.005 + 0.002 * np.sin(4 * np.pi * (at + 0.01 - driver._clock.start - segment.start))
        assert np.median(abs(sent - wanted)) < 3e-4  # the sine that was asked for, one SYNC ahead
        measured = driver.collect().columns["displacement"]
        assert 6000 < max(measured) <= 7010
        assert 2990 <= min(measured) < 4000


def test_samples_are_on_sync_and_on_the_computers_clock():
    with rig() as (_emulator, _served, driver):
        assert driver.start(30.0) == pytest.approx(100 / 3)
        time.sleep(0.4)
        block = driver.collect()
        assert set(block.columns) == {channel.name for channel in CHANNELS}
        assert 4 < len(block.time) < 20
        assert 25e6 < np.median(np.diff(block.time)) < 60e6  # 30 ms, and more where the machine is busy
        assert block.host >= block.time[-1]
        assert driver.start(1000.0) == pytest.approx(100.0)  # no faster than SYNC


def test_quick_stop_holds_where_it_is_and_the_next_command_goes_on_from_there():
    with rig(bus(watchdog=0.0)) as (emulator, served, driver):
        driver.arm_watchdog(5.0)
        driver.write(POSITION, 0.0)
        driver.follow(POSITION, ramp(driver, 0, 40_000, 40_000))
        time.sleep(0.25)
        driver.halt(POSITION)
        [stopped] = emulator.log.of("halt")
        assert 0.005 < stopped["si"] < 0.03
        time.sleep(0.1)
        assert node(served).get(0x6064) == pytest.approx(stopped["si"] * 1e6, abs=1)
        assert node(served).drive_state.value == "quick stop active"
        driver.halt(POSITION)  # may be repeated
        driver.write(POSITION, 2000.0)
        assert until(lambda: node(served).get(0x6064) == 2000)


def test_a_quick_stop_in_the_middle_of_a_sine_ends_it():
    with rig(bus(watchdog=0.0)) as (emulator, _served, driver):
        driver.write(POSITION, 0.0)
        driver.arm_watchdog(5.0)
        driver.follow(POSITION, sine(driver, 0, 2000, 2.0, 10))
        time.sleep(0.2)
        driver.halt(POSITION)
        moves = len(emulator.log.of("move"))
        time.sleep(0.1)
        assert len(emulator.log.of("move")) == moves
        assert emulator.log.of("halt")


def test_without_the_heartbeat_the_drive_stops_by_itself():
    with rig() as (emulator, served, driver):
        assert driver.arm_watchdog(0.4) == pytest.approx(0.4)
        driver.start(100.0)
        with Fed(driver) as fed:
            driver.write(POSITION, 0.0)
            driver.follow(POSITION, sine(driver, 0, 2000, 1.0, 100))
            time.sleep(0.6)
            assert emulator.log.of("watchdog") == []
            fed.end()
            silent = time.monotonic()
            # SYNC and targets go on: they are no sign of life of the guard
            assert until(lambda: emulator.log.of("watchdog"))
        [entry] = emulator.log.of("watchdog")
        assert 0.2 < entry["t"] - silent < 1.0
        assert until(lambda: node(served).drive_state.value == "quick stop active")
        assert until(lambda: emulator.log.of("halt"))
        assert emulator.log.of("halt")[0]["t"] - entry["t"] < 0.5
        with pytest.raises(DeviceError, match="emergency 8130h: it heard no heartbeat any more"):
            collects(driver)


def test_disarmed_it_waits_for_no_heartbeat():
    with rig() as (emulator, _served, driver):
        driver.arm_watchdog(0.1)
        driver.disarm_watchdog()
        time.sleep(0.3)
        assert emulator.log.of("watchdog") == []


def test_a_drive_that_does_not_go_on_says_where_it_stays_and_why():
    with rig() as (_emulator, served, driver):
        served.faults.set("disabled")
        time.sleep(0.05)
        with pytest.raises(DeviceError, match="stays in switch on disabled .* to operation enabled: .*safe torque off"):
            driver.write(POSITION, 0.0)
        with pytest.raises(DeviceError, match="stays in switch on disabled .* to switched on"):
            driver.arm_watchdog(0.5)
        served.faults.set("clear")
        time.sleep(0.05)
        driver.write(POSITION, 0.0)


def test_a_fault_from_before_is_acknowledged_once_and_a_new_one_is_not():
    with rig(bus(watchdog=0.0)) as (_emulator, served, driver):
        driver.close()
        node(served).fault(0x8611)
        driver.open()
        driver.write(POSITION, 0.0)
        node(served).fault(0x4310)
        time.sleep(0.05)
        with pytest.raises(DeviceError, match="emergency 4310h: temperature"):
            driver.level("drive.ready")
        with pytest.raises(DeviceError, match="emergency 4310h: temperature; it is not moved"):
            driver.write(POSITION, 100.0)


def test_a_fault_that_no_emergency_reported_is_not_acknowledged_in_a_run_either():
    with rig(bus(watchdog=0.0)) as (_emulator, served, driver):
        driver.write(POSITION, 0.0)
        node(served).objects[0x603F, 0].value = 0x3210
        node(served)._enter(State.FAULT)
        with pytest.raises(DeviceError, match="in fault, error code 3210h: voltage; the next run acknowledges it"):
            driver.write(POSITION, 100.0)
        assert node(served).drive_state is State.FAULT


def test_a_fault_whose_cause_stays_is_reported_with_its_code():
    with rig(opened=False) as (_emulator, served, driver):
        drive = node(served)
        assert until(lambda: served._booted)
        drive.fault(0x8611)
        drive._reset_fault = lambda: None
        driver.open()
        with pytest.raises(DeviceError, match="fault, error code 8611h: following error.*cause is still there"):
            driver.write(POSITION, 0.0)


def test_a_following_error_stops_the_drive_and_ends_the_samples():
    with rig(bus(watchdog=0.0)) as (emulator, served, driver):
        driver.write(POSITION, 0.0)
        driver.start(100.0)
        drive = node(served)
        drive.objects[0x6065, 0].value, drive.objects[0x6066, 0].value = 500, 50
        drive._actual = lambda: 0  # it is blocked
        driver.follow(POSITION, ramp(driver, 0, 20_000, 20_000))
        with pytest.raises(DeviceError, match="emergency 8611h: following error"):
            collects(driver)
        assert drive.drive_state.value == "fault"
        assert emulator.log.of("halt")


def test_a_motion_that_would_begin_with_a_jump_is_refused():
    with rig(bus(watchdog=0.0)) as (emulator, _served, driver):
        driver.write(POSITION, 0.0)
        with pytest.raises(DeviceError, match="is at 0 counts and cannot jump to 20000"):
            driver.follow(POSITION, sine(driver, 20_000, 100, 1.0, 1))
        driver.follow(POSITION, ramp(driver, 0, 10_000, 10_000))
        with pytest.raises(DeviceError, match="still on its way"):
            driver.follow(POSITION, sine(driver, 0, 100, 1.0, 1))
        assert [entry["si"] for entry in emulator.log.of("move")] == pytest.approx([0.0, 0.01])


def test_limits_of_the_drive_inside_those_of_the_bench_are_refused():
    with rig(opened=False) as (_emulator, served, driver):
        node(served).objects[0x607D, 2].value = 20_000
        with pytest.raises(DeviceError, match=r"software limits \(607Dh\) are -\d+ to 20000 counts"):
            driver.open()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda n: n["drive"].objects[0x1000, 0].__setattr__("value", 401), "profile CiA 401, and CiA 402 is needed"),
        (lambda n: n["drive"].objects[0x6502, 0].__setattr__("value", 1), "no mode cyclic synchronous position"),
        (
            lambda n: n["drive"].objects[0x1017, 0].__setattr__("writable", False),
            "1017h:0: this object can only be read",
        ),
        (lambda n: n["transducer"].objects[0x6503, 0].__setattr__("value", 1), "magnet is missing"),
        (lambda n: n["transducer"].objects[0x6005, 1].__setattr__("value", 0), "does not report its measuring step"),
        (
            lambda n: n["transducer"].objects[0x1A00, 1].__setattr__("value", 0x60300110),
            "first PDO begins with 60300110h",
        ),
    ],
)
def test_a_node_that_is_not_what_is_needed_says_so_when_it_is_opened(change, reason):
    with rig(opened=False) as (_emulator, served, driver):
        change(served.nodes)
        with pytest.raises(DeviceError, match=reason):
            driver.open()


def test_a_watchdog_that_the_drive_does_not_have_is_refused_at_arming():
    with rig() as (_emulator, served, driver):
        node(served).objects.pop((0x6007, 0))
        with pytest.raises(DeviceError, match="6007h:0: it has no such object.*would not stop and hold"):
            driver.arm_watchdog(0.5)


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("emergency", "emergency 5000h: its hardware"),
        ("restart", "it has started again, or was commanded to stop"),
        ("silence", "no heartbeat for 0.5 s|no answer to SYNC"),
        ("lost", "no heartbeat for 0.5 s|no answer to SYNC"),
        ("hang-up", "lost slcan:socket"),
        ("reset", "lost slcan:socket|started again"),
    ],
)
def test_what_goes_wrong_ends_the_samples_with_its_reason(fault, reason):
    with rig() as (_emulator, served, driver):
        driver.start(100.0)
        time.sleep(0.1)
        assert len(driver.collect().time)
        served.faults.set(fault)
        with pytest.raises(DeviceError, match=reason):
            collects(driver)


@pytest.mark.parametrize("fault", ["garbage", "double", "late", "stale", "truncated", "corrupted"])
def test_a_bad_line_makes_gaps_or_an_error_and_no_wrong_sample(fault):
    with rig() as (_emulator, served, driver):
        driver.start(100.0)
        time.sleep(0.1)
        served.faults.set(fault, None, 30)
        values, failed = [], False
        until_then = time.monotonic() + 0.6
        while time.monotonic() < until_then and not failed:
            try:
                values += driver.collect().columns["displacement"]
            except DeviceError:
                failed = True
            time.sleep(0.02)
        assert values or failed
        assert np.ptp(values or [0.0]) < 10  # at rest: 1 um steps and nothing else


def test_a_late_node_is_a_gap_and_belongs_to_no_other_sync():
    with rig() as (_emulator, served, driver):
        driver.start(100.0)
        time.sleep(0.1)
        served.faults.set("lost", 1.0, 3)
        time.sleep(0.3)
        block = driver.collect()
        gaps = np.diff(block.time) * 1e-6
        assert max(gaps) > 15
        assert driver.missed > 0


def test_addresses_nobody_answers_at():
    record = replace(bus(), address="slcan:socket://127.0.0.1:1")
    with pytest.raises(DeviceError, match="cannot open slcan:socket://127.0.0.1:1: Connection refused"):
        CanBus(record, RealClock()).open()
    record = replace(bus(), address="slcan:/dev/pmabench-no-such-port")
    with pytest.raises(DeviceError, match="cannot open slcan:/dev/pmabench-no-such-port"):
        CanBus(record, RealClock()).open()
    record = replace(bus(), address="socketcan:pmabench9")
    with pytest.raises(DeviceError, match="cannot open socketcan:pmabench9"):
        CanBus(record, RealClock()).open()


def test_a_node_that_is_not_there_says_which():
    nodes = {"drive": {"profile": 402, "node": 5, "approach": "50 mm/s"}, "gauge": {"profile": 406, "node": 13}}
    with rig(opened=False) as (_emulator, served, _driver):
        record = bus(served.address, channels=(), nodes=nodes)
        other = CanBus(record, RealClock())
        with pytest.raises(DeviceError, match="gauge did not answer .* is node 13 on"):
            other.open()
