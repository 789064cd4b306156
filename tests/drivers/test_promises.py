"""Promises that drivers of all families keep: a test for each promise, a parameter for each rig.

`CONTROLLERS` are devices with outputs behind a connection, `PORTS` those on a serial port.
"""

import contextlib
import threading
import time
from dataclasses import dataclass, replace
from typing import Any

import pytest
from pmabench_drivers.alicat import AlicatController
from pmabench_drivers.dataq import Dataq
from pmabench_drivers.emulator import Emulator
from pmabench_drivers.ild1420 import Ild1420
from pmabench_drivers.serial_ascii import SerialIndicator
from pmabench_drivers.serial_line_daq import SerialLineDaq

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import (
    Device,
    Follower,
    Inputs,
    Motion,
    Rescue,
    Segment,
    SetPoint,
    Stream,
    Switch,
    Watchdog,
)
from tests.drivers import common
from tests.drivers.alicat.rigs import controller
from tests.drivers.common import timed
from tests.drivers.dataq.rigs import daq
from tests.drivers.festo import rigs as festo
from tests.drivers.festo_cmmt import rigs as festo_cmmt
from tests.drivers.ild1420.rigs import laser
from tests.drivers.labjack import rigs as labjack
from tests.drivers.ni import rigs as ni
from tests.drivers.serial_line_daq.rigs import board
from tests.drivers.wires import rigs as wires

pytestmark = pytest.mark.realtime

BOUND = 0.3
"""A call takes 0.2 s at most; the rest is for a busy machine [s]."""


@dataclass
class Rig:
    """An open driver in front of its emulator, with the names of one output, one valve and one contact."""

    device: Any
    emulator: Emulator
    served: Any
    output: str = ""
    valve: str = ""
    contact: str = ""
    low: float = 0.0
    """Two set-points, of which the guard would allow both [raw]."""
    high: float = 0.0

    def log(self, kind="set"):
        return self.emulator.log.of(kind, self.device._device.name)


@contextlib.contextmanager
def _modbus():
    with (
        wires.emulated(wires.regulator(), preset="ideal") as (emulator, [record]),
        common.opened(record) as device,
    ):
        yield Rig(device, emulator, emulator.devices["regulator"], "pressure", "dump", "e_stop", 10.0, 200.0)


@contextlib.contextmanager
def _terminal():
    """Without a time-out of the terminal's own: from the factory on it is 100 ms, and a lost answer takes longer."""
    with festo.served() as rig:
        rig.inside.timeout = 0
        rig.device.open()
        yield Rig(rig.device, rig.emulator, rig.server, "ao4.0", "do2.0", "di1.0", 10.0, 6400.0)


@contextlib.contextmanager
def _t7():
    with labjack.rig() as (emulator, served, device):
        yield Rig(device, emulator, served, "DAC0", "FIO0", "FIO1", 0.5, 1.0)


@contextlib.contextmanager
def _usb_6215():
    with ni.rig(opened=False, slack=False) as (emulator, served, device):
        ni.patiently(device.open)
        yield Rig(device, emulator, served, "ao0", "port1/line0", "port0/line0", 0.5, 1.0)


@contextlib.contextmanager
def _drive():
    with festo_cmmt.served() as rig:
        rig.device.open()
        yield Rig(rig.device, rig.emulator, rig.server, "position")


CONTROLLERS = {"wires": _modbus, "festo": _terminal, "labjack": _t7, "ni": _usb_6215}
ALL = {**CONTROLLERS, "festo_cmmt": _drive}


def each(*names):
    return pytest.mark.parametrize("rig", names)


@pytest.fixture
def opened(rig):
    with ALL[rig]() as found:
        yield found


OF_A_CONTROLLER = (Device, Stream, SetPoint, Follower, Switch, Inputs, Rescue)
CAPABILITIES = {
    "wires": (*OF_A_CONTROLLER, Watchdog),
    "festo": (*OF_A_CONTROLLER, Watchdog),
    "labjack": (*OF_A_CONTROLLER, Watchdog),
    "ni": OF_A_CONTROLLER,
    "festo_cmmt": (Device, Stream, SetPoint, Follower, Motion, Watchdog),
}


@each(*ALL)
def test_it_has_its_capabilities_and_no_others(opened, rig):
    every = {Device, Stream, SetPoint, Follower, Switch, Inputs, Watchdog, Rescue, Motion}
    assert {capability for capability in every if isinstance(opened.device, capability)} == set(CAPABILITIES[rig])


NAMES = {
    "wires": (
        ("write", ("presure", 1.0), 'no output "presure"; did you mean "pressure"'),
        ("level", ("e_stp",), 'no input "e_stp"; did you mean "e_stop"'),
        ("switch", ("pressure",), 'no valve output "pressure"'),
    ),
    "festo": (
        ("write", ("ao4.9", 1.0), 'no output "ao4.9"; did you mean "ao4.0"'),
        ("level", ("di1.16",), 'no input "di1.16"'),
        ("write", ("ao4.0", 40000.0), "40000 does not fit int16"),
    ),
    "labjack": (
        ("write", ("DAC1", 1.0), 'no output "DAC1"; did you mean "DAC0"'),
        ("switch", ("FIO3",), 'no valve output "FIO3"; did you mean "FIO0"'),
    ),
    "ni": (
        ("write", ("ao1", 1.0), 'no output "ao1"; did you mean "ao0"'),
        ("read_back", ("ao1",), 'no output "ao1"'),
        ("switch", ("port1/line1",), 'no valve output "port1/line1"'),
        ("is_on", ("port0/line0",), 'no valve output "port0/line0"'),
        ("level", ("port1/line0",), 'no input "port1/line0"'),
        ("write", ("ao0", 10.1), "cannot be set to 10.1 V"),
        ("write", ("ao0", float("nan")), "cannot be set to nan V"),
        ("start", (0.0,), "cannot sample at 0.0 Hz"),
        ("start", (100e3,), "cannot take 400000 samples a second: at most 250000"),
        ("follow", ("ao0", Segment("ramp", 0.0, 0.0, 11.0, rate=1.0)), "cannot be set to 11 V"),
    ),
}
"""Rig -> method, what it is called with, and what is said."""


@each(*CONTROLLERS)
def test_names_and_values_that_are_not_there_are_refused_and_a_closed_device_says_so(opened, rig):
    device = opened.device
    for method, given, why in NAMES[rig]:
        with pytest.raises(DeviceError, match=why):
            getattr(device, method)(*given, **({"on": True} if method == "switch" else {}))
    device.close()
    device.close()
    for call in (
        lambda: device.start(10.0),
        lambda: device.write(opened.output, opened.low),
        lambda: device.level(opened.contact) if opened.contact != "FIO1" else device.read_back(opened.output),
    ):
        with pytest.raises(DeviceError, match="is not open"):
            call()


SLOW = {
    "labjack": {"silence", "lost", "reset", "delay", "garbage"},
    "festo": {"silence", "delay", "truncated", "garbage", "reset"},
}
"""Faults that are tried on demand only."""
FAULTS = {
    "wires": ("silence", "lost", "hang-up", "reset", "delay", "stale", "truncated", "garbage"),
    "festo": ("silence", "lost", "hang-up", "reset", "delay", "stale", "truncated", "garbage", "exception"),
    "labjack": ("silence", "lost", "hang-up", "reset", "delay", "stale", "truncated", "garbage"),
}


@pytest.mark.parametrize(
    ("rig", "kind"),
    [
        pytest.param(rig, kind, marks=pytest.mark.slow if kind in SLOW.get(rig, ()) else ())
        for rig, kinds in FAULTS.items()
        for kind in kinds
    ],
)
def test_every_call_ends_in_time_and_the_next_one_is_right(opened, rig, kind):
    device, output, faults = opened.device, opened.output, opened.served.faults
    device.write(output, opened.low)
    calls = [
        lambda: device.write(output, opened.high),
        lambda: device.read_back(output),
        lambda: device.switch(opened.valve, on=True),
        lambda: device.switch(opened.valve, on=False),
        lambda: device.is_on(opened.valve),
        lambda: device.level(opened.contact),
        *([lambda: device.start(200.0), device.stop] if rig == "labjack" else []),
        lambda: device.arm_watchdog(1.0),
        device.feed_watchdog,
        device.disarm_watchdog,
        lambda: device.rescue(opened.valve, 0.0),
        lambda: device.rescue(output, opened.low),
    ]
    for call in calls:
        faults.set(kind, {"truncated": 3.0, "delay": 0.5, "exception": 3.0}.get(kind))
        took, outcome = timed(call)
        faults.set("clear")
        assert took < BOUND
        assert outcome is None or isinstance(outcome, DeviceError | bool | float)
        assert device.read_back(output) in {opened.low, opened.high}


@each(*CONTROLLERS)
def test_rescue_goes_round_a_call_that_hangs(opened, rig):
    """The first connection waits for a slow answer; the second one vents meanwhile."""
    device = opened.device
    ni.patiently(lambda: device.switch(opened.valve, on=True))
    ni.patiently(lambda: device.write(opened.output, opened.high))
    if rig in {"labjack", "ni"}:
        ni.start(device, 200.0)
    opened.served.faults.set("delay", 0.5, count=1)
    hanging = threading.Thread(target=timed, args=(device.level, opened.contact))
    hanging.start()
    time.sleep(0.02)
    for output in (opened.output, opened.valve):
        took, outcome = timed(device.rescue, output, 0.0)
        assert outcome is None
        assert took < BOUND
    hanging.join(1.0)
    assert opened.log()[-1]["raw"] == 0.0
    assert opened.log("switch")[-1]["on"] is False
    assert opened.log()[-1]["connection"] != opened.log()[0]["connection"]


@each("wires", "festo")
def test_rescue_ends_a_ramp(opened):
    opened.device.follow(opened.output, Segment("ramp", 0.0, 0.0, 5 * opened.high, rate=opened.high))
    time.sleep(0.1)
    opened.device.rescue(opened.output, 0.0)
    commanded = len(opened.log())
    time.sleep(0.25)
    assert opened.log()[-1]["raw"] == 0.0
    assert len(opened.log()) <= commanded + 1  # a step that was under way


@each("labjack", "ni")
def test_a_ramp_is_stepped_and_ends_on_its_target(opened):
    start = opened.device._clock.now()
    opened.device.follow(opened.output, Segment("ramp", start, opened.low, opened.high, rate=0.5))
    deadline = time.monotonic() + 5.0
    while not opened.log() or opened.log()[-1]["raw"] != opened.high:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    values = [entry["raw"] for entry in opened.log()]
    assert values == sorted(values)
    assert len(values) > 5
    assert min(values) >= opened.low - 1e-6


@each("wires", "festo")
def test_polling_alone_does_not_keep_the_watchdog_quiet(opened):
    """Any communication feeds these devices: the thread that polls falls silent when nobody feeds."""
    opened.device.start(200.0)
    opened.device.write(opened.output, opened.high)
    opened.device.arm_watchdog(0.2)
    armed = time.monotonic()
    time.sleep(0.7)
    [fired] = opened.log("watchdog")
    assert fired["t"] - armed < 0.5


@each("wires", "festo")
def test_polling_that_gets_no_answers_is_an_error_and_goes_on_when_the_device_is_back(opened):
    device = opened.device
    device.start(100.0)
    time.sleep(0.1)
    opened.served.faults.set("silence")
    deadline, outcome = time.monotonic() + 3, None
    while time.monotonic() < deadline and not isinstance(outcome, DeviceError):
        took, outcome = timed(device.collect)
        assert took < 0.1  # it never waits for the device
        time.sleep(0.02)
    assert "no answer from" in str(outcome)
    opened.served.faults.set("clear")
    time.sleep(0.5)
    assert len(device.collect().time) > 5


# -- serial ports -------------------------------------------------------------------------------------------------------

PORTS = {
    "alicat": (AlicatController, lambda at: controller(at, "ascii"), "controller"),
    "dataq": (Dataq, daq, "daq"),
    "ild1420": (Ild1420, laser, "laser"),
    "serial_line_daq": (SerialLineDaq, board, "board"),
    "wires-text": (SerialIndicator, wires.cell, "cell"),
}
"""Rig -> driver, what makes its record from an address, and the name of the device."""


@each(*PORTS)
def test_one_port_belongs_to_one_program_and_has_to_be_there(tmp_path, rig):
    kind, record, name = PORTS[rig]
    emulator = Emulator([record(tmp_path / "port")], preset="ideal")
    device = kind(replace(record(tmp_path / "port"), address=str(tmp_path / "port")), RealClock())
    try:
        device.open()
        took, outcome = timed(kind(record(tmp_path / "port"), RealClock()).open)
        assert f"{name}: cannot open " in str(outcome)
        assert str(outcome).endswith(": another program has it open")
        assert took < BOUND
        with pytest.raises(DeviceError, match=rf"{name}: cannot open .*nothing: "):
            kind(record(tmp_path / "nothing"), RealClock()).open()
        with pytest.raises(DeviceError, match="is not open"):
            kind(record(tmp_path / "port"), RealClock()).start(100.0)
    finally:
        device.close()
        emulator.close()


@each("dataq", "ild1420", "wires-text")
def test_a_port_that_is_gone_is_said_and_closed_in_time(tmp_path, rig):
    kind, record, name = PORTS[rig]
    emulator = Emulator([record(tmp_path / "port")], preset="ideal")
    device = kind(record(tmp_path / "port"), RealClock())
    try:
        device.open()
        device.start(100.0)
        emulator.devices[name].faults.set("hang-up")
        deadline, outcome = time.monotonic() + 3.0, None
        while not isinstance(outcome, DeviceError):
            assert time.monotonic() < deadline
            _, outcome = timed(device.collect)
            time.sleep(0.01)
        assert str(outcome).startswith(f"{name}: lost {tmp_path / 'port'}: ")
        took, _ = timed(device.close)
        assert took < 1.0
    finally:
        device.close()
        emulator.close()
