"""What each kind of fault does to an answer, to what is measured and to clocks; which device has which."""

import struct

import pytest
from pmabench_drivers.emulator import faults as faults_of
from pmabench_drivers.emulator.faults import LINK, STUCK, DeviceClock, Fault, Faults, Outgoing
from pmabench_drivers.emulator.modbus_server import Request

from pmabench.base.errors import UsageError
from tests.drivers.wires.rigs import cell, emulated, gauge, regulator

ANSWERS = [b"alpha", b"bravo", b"charlie"]


@pytest.mark.parametrize(
    ("kind", "value", "leaves"),
    [
        ("", 0, [b"alpha", b"bravo", b"charlie"]),
        ("silence", 0, [b"", b"", b""]),
        ("lost", 1, [b"", b"", b""]),
        ("late", 0, [b"", b"alpha", b"bravo"]),
        ("stale", 0, [b"", b"alpha", b"bravo"]),
        ("truncated", 2, [b"alp", b"bra", b"charl"]),
        ("truncated", 9, [b"", b"", b""]),
        ("corrupted", 1, [b"a\x93pha", b"b\x8davo", b"c\x97arlie"]),
        ("garbage", 0, [b"?alpha", b"?bravo", b"?charlie"]),
        ("double", 0, [b"alphaalpha", b"bravobravo", b"charliecharlie"]),
    ],
)
def test_what_leaves_of_an_answer(kind, value, leaves):
    outgoing = Outgoing(b"?")
    assert [outgoing.of(answer, Fault(kind, value)) for answer in ANSWERS] == leaves


def test_one_late_answer_comes_just_before_the_next_and_one_stale_answer_is_the_one_before():
    late, stale = Outgoing(), Outgoing()
    assert [late.of(a, Fault("late" if a == b"alpha" else "")) for a in ANSWERS] == [b"", b"alphabravo", b"charlie"]
    assert [stale.of(a, Fault("stale" if a == b"bravo" else "")) for a in ANSWERS] == [b"alpha", b"alpha", b"charlie"]


def test_a_share_is_lost():
    faults = Faults()
    faults.set("lost", 0.3)
    lost = sum(faults.next().kind == "lost" for _ in range(2000))
    assert lost == pytest.approx(600, abs=4 * (2000 * 0.3 * 0.7) ** 0.5)


def test_a_fault_is_counted_and_then_over():
    faults = Faults(LINK)
    faults.set("delay", None, 2)
    assert [faults.next() for _ in range(3)] == [Fault("delay", 0.1, 2), Fault("delay", 0.1, 1), Fault()]


def test_a_skewed_clock_runs_on_from_where_it_was(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(faults_of, "monotonic", lambda: now[0])
    faults = Faults()
    clock = DeviceClock(faults)
    now[0] += 10.0
    assert clock.now() == pytest.approx(10.0)
    faults.set("skew", 1e-3)
    now[0] += 10.0
    assert clock.now() == pytest.approx(20.01)
    faults.set("clear")
    now[0] += 10.0
    assert clock.now() == pytest.approx(30.01)


def test_a_device_has_its_faults_and_no_others(tmp_path):
    with emulated(regulator(), cell(tmp_path / "cell"), gauge(tmp_path / "gauge")) as (emulator, _):
        for name, device in emulator.devices.items():
            assert {*LINK, *STUCK} <= {*device.faults.kinds}, name
        assert "exception" in emulator.devices["regulator"].faults.kinds
        assert "skew" in emulator.devices["gauge"].faults.kinds
        with pytest.raises(ValueError, match='no fault "skew"'):
            emulator.act({"device": "cell", "fault": "skew"})  # it is asked, and has no clock
        with pytest.raises(ValueError, match='no fault "exception"'):
            emulator.act({"device": "gauge", "fault": "exception"})
        with pytest.raises(ValueError, match=r'no device "gage".*"gauge"'):
            emulator.act({"device": "gage", "fault": "lost"})


def test_stuck_values_are_those_of_one_device(tmp_path):
    with emulated(regulator(), cell(tmp_path / "cell"), preset="ideal") as (emulator, _):
        registers, shown = emulator.devices["regulator"].registers, [1e5, 2e5]
        emulator.plant.quantities = lambda: {"pressure": shown[0], "force": 0.0}

        def read():
            words = registers.carry_out(Request(4, 0, 2), 1)
            return struct.unpack(">f", struct.pack(">HH", *words))[0]

        assert read() == 100.0
        emulator.act({"device": "cell", "fault": "stuck"})
        shown[0] = 2e5
        assert read() == 200.0
        emulator.act({"device": "regulator", "fault": "stuck"})
        assert read() == 200.0
        shown[0] = 3e5
        assert read() == 200.0
        emulator.act({"device": "regulator", "fault": "clear"})
        assert read() == 300.0


def test_an_armed_watchdog_expires_when_asked(tmp_path):
    with emulated(regulator()) as (emulator, _):
        registers = emulator.devices["regulator"].registers
        with pytest.raises(ValueError, match="regulator has no armed watchdog"):
            emulator.act({"device": "regulator", "fault": "watchdog"})
        for address, value in ((20, 5000), (21, 1)):
            registers.carry_out(Request(6, address, 1, (value,)), 1)
        emulator.act({"device": "regulator", "fault": "watchdog"})
        [noted] = emulator.log.of("watchdog", "regulator")
        assert noted["silent"] < 50.0
        with pytest.raises(ValueError, match="has no armed watchdog"):
            emulator.act({"device": "regulator", "fault": "watchdog"})


def test_nothing_outside_this_machine_is_served_unasked():
    for address in ("0.0.0.0:0", "[::]:0", "192.168.7.7:502"):
        with pytest.raises(UsageError, match="--expose"), emulated(regulator(address)):
            pass
    with emulated(regulator("[::1]:0")) as (emulator, _):
        assert emulator.devices["regulator"].address.startswith("[::1]:")
    with emulated(regulator("0.0.0.0:0"), expose=True) as (emulator, _):
        assert not emulator.devices["regulator"].address.endswith(":0")
