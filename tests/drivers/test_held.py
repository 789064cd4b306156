"""`held`, `read_back` and `is_on` ask the device: what happens to it from outside is seen by the next call."""

import contextlib
import time

import pytest
from pmabench_drivers.shared.link import Unanswered

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Segment, Supervised, Watchdog
from tests.drivers.alicat import rigs as alicat
from tests.drivers.common import in_front
from tests.drivers.labjack import rigs as labjack
from tests.drivers.ni import rigs as ni
from tests.drivers.rig import record as mock_record
from tests.drivers.serial_line_daq import rigs as line_daq
from tests.drivers.wires import rigs as wires
from tests.realtime import opened as opened_mock
from tests.realtime import plant_server

pytestmark = pytest.mark.realtime

LONGEST = 0.4
"""A call takes 0.2 s at most, and so much on a machine that has much else to do [s]."""
SERIAL = {**wires.MAP, "identity": {"serial": {"address": 112, "type": "uint32"}}}


class Rig:
    """A driver in front of its device; `do(fault, value)` is what happens to the device from outside."""

    def __init__(self, device, do, output, valve="", limit=1e9):
        self.device, self.do, self.output, self.valve, self.limit = device, do, output, valve, limit

    def held(self):
        """What the device says, in time; on a loaded machine it may miss the 0.2 s of one call."""
        for last in (False, True):
            begin = time.monotonic()
            try:
                return dict(self.device.held())
            except Unanswered:
                if last:
                    raise
            finally:
                assert time.monotonic() - begin < LONGEST
        return None


@contextlib.contextmanager
def emulated(record, output, valve=""):
    """The device of a record in front of its emulator, or in front of that of `ni`."""
    with ni.rig(record) if record.driver == ni.DRIVER else in_front(record) as (emulator, _served, device):

        def do(fault, value=None):
            emulator.act({"device": record.name, "fault": fault, "value": value})

        yield Rig(device, do, output, valve)


@contextlib.contextmanager
def mock(tmp_path):
    with plant_server(tmp_path, mock_record(valve=True)) as shared, opened_mock(shared.device) as device:
        yield Rig(
            device, lambda fault, value=None: shared.ask("inject", fault=fault, value=value), "pressure", "dump_valve"
        )


RIGS = {
    "modbus": lambda _tmp: emulated(wires.regulator(uptime={"table": "input", "address": 30, "type": "uint32"}, identity=SERIAL["identity"], timeout="200 ms"), "pressure", "dump"),
    "labjack": lambda _tmp: emulated(labjack.t7(), "DAC0", "FIO0"),
    "line-daq": lambda tmp: emulated(line_daq.board(tmp / "port"), "o0", "v0"),
    "alicat": lambda tmp: emulated(alicat.controller(tmp / "port"), "pressure"),
    "alicat on modbus": lambda tmp: emulated(alicat.controller(tmp / "port", "modbus"), "pressure"),
    "mock": mock,
}  # fmt: skip
WATCHED = ("modbus", "labjack", "line-daq", "mock")
KEEPS_ITS_WATCHDOG = ("labjack",)
"""Its settings are in flash, and count again from power-on: LabJack, T-series datasheet, 23.0 Watchdog."""


@pytest.fixture
def rig(request, tmp_path):
    with RIGS[request.param](tmp_path) as made:
        yield made


def armed(rig):
    """Armed to a second where it has a watchdog, and under pressure."""
    if isinstance(rig.device, Watchdog):
        rig.device.arm_watchdog(1.0)
    if rig.valve:
        rig.device.switch(rig.valve, on=True)
    rig.device.write(rig.output, 2.0)
    return rig.held()


def without_uptime(found):
    return {name: value for name, value in found.items() if name != "uptime"}


@pytest.mark.singly
@pytest.mark.parametrize("rig", RIGS, indirect=True)
def test_what_nobody_changes_stays_as_it_was(rig):
    first = armed(rig)
    assert isinstance(rig.device, Supervised)
    for _ in range(4):
        rig.device.feed_watchdog() if isinstance(rig.device, Watchdog) else None
        time.sleep(0.2)
        later = rig.held()
        assert without_uptime(later) == without_uptime(first)
        assert later.get("uptime", 0.0) >= first.get("uptime", 0.0)
        assert rig.device.read_back(rig.output) == pytest.approx(2.0, abs=0.01)
        assert not rig.valve or rig.device.is_on(rig.valve)


@pytest.mark.singly
def test_a_board_says_who_it_is(tmp_path):
    """Another one behind the same port has another serial number."""
    with RIGS["line-daq"](tmp_path) as rig:
        assert rig.held()["serial"] == "1"
        assert "board" in rig.held()["model"]


@pytest.mark.singly
@pytest.mark.parametrize("rig", WATCHED, indirect=True)
def test_the_time_is_that_of_the_device(rig):
    assert rig.held()["watchdog"] == 0.0
    assert armed(rig)["watchdog"] == 1.0


@pytest.mark.singly
@pytest.mark.parametrize("rig", WATCHED, indirect=True)
def test_a_watchdog_that_is_switched_off_from_outside_is_seen(rig):
    armed(rig)
    rig.do("watchdog-off")
    assert rig.held()["watchdog"] == 0.0


@pytest.mark.singly
@pytest.mark.parametrize("rig", ["modbus", "line-daq"], indirect=True)
def test_a_watchdog_that_has_fired_is_seen(rig):
    armed(rig)
    rig.do("watchdog")
    time.sleep(0.1)
    assert rig.held()["watchdog"] == 0.0


@pytest.mark.singly
@pytest.mark.parametrize(("rig", "name"), [(name, name) for name in RIGS], indirect=["rig"])
def test_a_restart_is_seen(rig, name):
    """Set-point and valve of power-on; watchdog off, where the device forgets it; an uptime that begins again."""
    first = armed(rig)
    for _ in range(6 if "uptime" in first else 0):
        time.sleep(0.2)
        rig.device.feed_watchdog() if isinstance(rig.device, Watchdog) else None
    before = rig.held()
    assert "uptime" not in first or before["uptime"] > first["uptime"]
    rig.do("restart")
    time.sleep(0.1)
    after = rig.held()
    assert rig.device.read_back(rig.output) == 0.0
    assert not rig.valve or not rig.device.is_on(rig.valve)
    if name in WATCHED:
        assert after["watchdog"] == (1.0 if name in KEEPS_ITS_WATCHDOG else 0.0)
    assert "uptime" not in before or after["uptime"] < before["uptime"]


@pytest.mark.singly
@pytest.mark.parametrize("rig", RIGS, indirect=True)
def test_a_set_point_changed_from_outside_is_seen(rig):
    armed(rig)
    rig.do("setpoint", 1.0)
    assert rig.device.read_back(rig.output) == pytest.approx(1.0, abs=0.01)


@pytest.mark.singly
@pytest.mark.parametrize("rig", RIGS, indirect=True)
def test_while_it_follows_a_ramp_the_value_of_the_moment_is_read(rig):
    armed(rig)
    rig.device.follow(rig.output, Segment("ramp", rig.device._clock.now(), 2.0, 4.0, rate=1.0))
    seen = []
    for _ in range(8):
        time.sleep(0.2)
        rig.device.feed_watchdog() if isinstance(rig.device, Watchdog) else None
        seen.append(rig.device.read_back(rig.output))
    assert seen == sorted(seen)
    assert 2.0 <= seen[0] < 3.0 <= seen[-1] <= 4.0


@pytest.mark.alone
def test_ni_says_what_it_cannot_ask_and_notices_a_restart_by_its_valve_line():
    with emulated(ni.daq(), "ao0", "port1/line0") as rig:
        rig.device.write("ao0", 2.0)
        rig.device.switch("port1/line0", on=True)
        assert rig.held() == {"serial": "0"}
        rig.device.start(500.0)
        time.sleep(0.1)
        rig.do("restart")
        assert not rig.device.is_on("port1/line0")
        time.sleep(0.5)
        with pytest.raises(DeviceError, match="-88710"):
            rig.device.collect() and rig.device.collect()


@pytest.mark.alone
def test_ni_answers_while_a_ramp_is_stepped():
    """No step under way makes `read_back` say that it does not know."""
    with emulated(ni.daq(), "ao0", "port1/line0") as rig:
        rig.device.write("ao0", 1.0)
        rig.device.follow("ao0", Segment("ramp", rig.device._clock.now(), 1.0, 5.0, rate=4.0))
        seen = [rig.device.read_back("ao0") for _ in range(300)]
        assert seen == sorted(seen)


@pytest.mark.singly
def test_a_settings_change_of_the_labjack_watchdog_is_seen():
    """Another program changes what the watchdog would do: time, strictness, DAC and lines are all part of what is held."""
    with labjack.rig() as (_emulator, served, device):
        device.arm_watchdog(1.0)
        before = device.held()
        for address in (61602, 61604, 61610, 61612, 61630, 61632, 61634, 61636, 61640, 61642):
            kept = served.t7._words[address + 1]
            served.t7._words[address + 1] = kept ^ 1
            assert device.held() != before, address
            served.t7._words[address + 1] = kept
        assert without_uptime(device.held()) == without_uptime(before)
