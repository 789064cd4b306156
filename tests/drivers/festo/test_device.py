"""The driver in front of the emulated terminal: samples, commands, lost answers, neighbours, watchdog, rescue."""

import contextlib
import socket
import threading
import time
from itertools import pairwise

import pytest

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Segment
from tests.drivers.common import timed, until
from tests.drivers.festo.rigs import served

pytestmark = pytest.mark.realtime

BOUND = 0.3
"""The contract is 0.2 s; the rest is for a busy machine."""
WRITES, READS = (6, 16), (3,)
STEP = 922


@pytest.fixture
def rig():
    """Without a time-out of the terminal's own: from the factory on it is 100 ms, and a lost answer takes longer."""
    with served() as rig:
        rig.inside.timeout = 0
        rig.device.open()
        yield rig


def test_it_measures_what_it_commands(rig):
    device = rig.device
    assert device.start(50.0) == 50.0
    device.switch("do2.0", on=True)
    assert device.is_on("do2.0")
    device.write("ao4.0", 9600.0)
    assert device.read_back("ao4.0") == 9600.0
    time.sleep(0.6)
    block = device.collect()
    assert len(block.time) > 10
    assert all(later > earlier for earlier, later in pairwise(block.time))
    assert block.columns["pressure"][-1] == pytest.approx(9600, abs=1)  # 300 kPa of 1000 kPa at 32000 counts
    assert block.columns["displacement"][-1] > 1000
    assert [entry["si"] for entry in rig.log("set")] == [pytest.approx(300e3)]
    assert rig.emulator.plant.quantities()["pressure"] == pytest.approx(300e3)


def test_negative_counts_have_their_sign(rig):
    rig.inside.statuses = {45399: 0xFFFF, 45400: 0x8000}  # the first two channels of the 4AI-UI
    rig.device.start(100.0)
    time.sleep(0.2)
    block = rig.device.collect()
    assert block.columns["pressure"][-1] == -1
    assert block.columns["displacement"][-1] == -32768


def test_the_emergency_stop_is_seen(rig):
    assert rig.device.level("di1.0") is True
    assert rig.device.level("di1.1") is False
    rig.emulator.plant.fail("e_stop_at")
    assert rig.device.level("di1.0") is False


def test_a_module_with_a_fault_gives_no_samples_and_is_named(rig):
    rig.device.start(100.0)
    time.sleep(0.1)
    rig.inside.statuses = {45403: 0x0010}  # the status behind the four channels of the 4AI-UI
    time.sleep(0.1)
    rig.device._samples.take()
    deadline, outcome = time.monotonic() + 3, None
    while time.monotonic() < deadline and not isinstance(outcome, DeviceError):
        _took, outcome = timed(rig.device.collect)
        assert isinstance(outcome, DeviceError) or not len(outcome.time)
        time.sleep(0.02)
    assert "module 3 (4ai-ui): reports a fault (status 0x0010)" in str(outcome)
    rig.inside.statuses = {}
    time.sleep(0.3)
    assert len(rig.device.collect().time) > 5


# -- lost answers ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["lost", "hang-up"])
def test_a_lost_answer_is_settled_by_what_the_module_says(rig, kind):
    for number in range(5):
        rig.at_requests(WRITES, kind)
        took, outcome = timed(rig.device.write, "ao4.0", 1000.0 + number)
        rig.well()
        assert took < BOUND
        if kind == "lost":
            assert outcome is None, outcome
        else:
            assert "did not answer to the command" in str(outcome)
    expected = [1000.0 + number for number in range(5)] if kind == "lost" else []
    assert [entry["raw"] for entry in rig.log("set")] == expected  # never more than once


def test_a_write_that_was_not_executed_says_so_and_is_not_sent_again(rig):
    for output, value in (("ao4.0", 8000.0), ("do2.0", 1.0)):
        rig.at_requests(WRITES, "silence")
        call = rig.device.write if output == "ao4.0" else lambda name, on: rig.device.switch(name, on=bool(on))
        with pytest.raises(
            DeviceError, match=rf"terminal.{output}: did not answer to the command {value:g} and holds 0$"
        ):
            call(output, value)
        rig.well()
    assert rig.log("set") == rig.log("switch") == []


def test_a_terminal_that_answers_and_does_nothing_is_found_out(rig):
    rig.server.faults.set("ignore")
    with pytest.raises(DeviceError, match="ao4.0: was commanded 8000 and holds 0"):
        rig.device.write("ao4.0", 8000.0)
    with pytest.raises(DeviceError, match="do2.0: was commanded 1 and holds 0"):
        rig.device.switch("do2.0", on=True)
    rig.inside.timeout = 2000
    assert rig.device.arm_watchdog(0.5) == 2.0  # what it holds, not what was asked for: the guard refuses that


def test_an_unknown_outcome_is_called_unknown(rig):
    rig.server.faults.set("lost")
    took, outcome = timed(rig.device.write, "ao4.0", 8000.0)
    assert "whether it took 8000 is not known" in str(outcome)
    assert took < BOUND
    assert len(rig.log("set")) == 1


def test_after_the_terminal_has_hung_up_the_next_call_is_done_once(rig):
    device = rig.device

    def hang_up():
        for connection in list(rig.server._open):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    for number in range(5):
        hang_up()
        device.write("ao4.0", 500.0 + number)
        hang_up()
        assert device.read_back("ao4.0") == 500.0 + number
        hang_up()
        assert device.arm_watchdog(0.5) == 0.5
        device.disarm_watchdog()
    assert [entry["raw"] for entry in rig.log("set")] == [500.0 + number for number in range(5)]


# -- eight outputs in one register ----------------------------------------------------------------------------------


def test_a_valve_leaves_its_neighbours_alone(rig):
    rig.inside._put(40003, 0b10101000)
    time.sleep(0.01)
    rig.device.switch("do2.0", on=True)
    assert rig.inside._words[40003] == 0b10101001
    rig.device.switch("do2.3", on=False)
    assert rig.inside._words[40003] == 0b10100001
    rig.device.rescue("do2.0", 0.0)
    assert rig.inside._words[40003] == 0b10100000


def test_what_the_terminal_took_away_is_not_put_back_next_to_another_valve(rig):
    rig.device.switch("do2.0", on=True)
    rig.inside._put(40003, 0)  # as its time-out does
    time.sleep(0.01)
    rig.device.switch("do2.1", on=True)
    assert rig.inside._words[40003] == 0b10


def test_where_the_neighbours_cannot_be_read_all_goes_off_and_nothing_on(rig):
    rig.inside._put(40003, 0b101)
    time.sleep(0.01)
    rig.at_requests(READS, "lost")
    took, outcome = timed(rig.device.switch, "do2.1", on=True)
    assert isinstance(outcome, DeviceError)
    assert took < BOUND
    assert rig.inside._words[40003] == 0b101
    took, outcome = timed(rig.device.switch, "do2.0", on=False)
    assert "whether it took 0 is not known" in str(outcome) or "no answer" in str(outcome)
    assert took < BOUND
    assert rig.inside._words[40003] == 0
    rig.well()
    rig.inside._put(40003, 0b101)
    time.sleep(0.01)
    rig.at_requests(READS, "lost")
    took, outcome = timed(rig.device.rescue, "do2.0", 0.0)
    assert outcome is None
    assert took < BOUND
    assert rig.inside._words[40003] == 0


# -- ramps ----------------------------------------------------------------------------------------------------------


def test_a_ramp_is_stepped_in_whole_counts_and_ends_on_its_target(rig):
    device = rig.device
    device.write("ao4.0", 1000.0)
    device.follow("ao4.0", Segment("ramp", 0.0, 1000.0, 2000.0, rate=4000.0))
    time.sleep(0.6)
    values = [entry["raw"] for entry in rig.log("set")][1:]
    assert len(values) > 10
    assert values == sorted(values)
    assert values[-1] == 2000
    device.follow("ao4.0", Segment("ramp", 0.0, 2000.0, 30000.0, rate=1000.0))
    time.sleep(0.1)
    device.write("ao4.0", 0.0)
    number = len(rig.log("set"))
    time.sleep(0.2)
    assert len(rig.log("set")) == number
    assert rig.log("set")[-1]["raw"] == 0


# -- the time-out ---------------------------------------------------------------------------------------------------


def test_it_is_kept_in_talk_until_a_watchdog_is_armed(rig):
    """The terminal hangs up after its time-out; opened and left alone the connection stays."""
    rig.inside.timeout = 600
    rig.inside._put(40004, 1)
    time.sleep(1.5)
    assert rig.log("watchdog") == []
    assert len(rig.log("connect")) == 1


def test_the_watchdog_is_set_in_milliseconds_and_given_back():
    with served() as rig:
        rig.device.open()
        assert rig.device.arm_watchdog(0.5) == 0.5
        assert rig.inside.timeout == 500
        rig.device.disarm_watchdog()
        assert rig.inside.timeout == 100
        with pytest.raises(DeviceError, match=r"waits 0.1 s at least, not 0.05 s"):
            rig.device.arm_watchdog(0.05)


def test_without_a_sign_of_life_the_outputs_go(rig):
    device = rig.device
    device.switch("do2.0", on=True)
    device.write("ao4.0", 6400.0)
    device.arm_watchdog(0.2)
    for _ in range(6):
        time.sleep(0.04)
        device.feed_watchdog()
    fed = time.monotonic()
    assert rig.log("watchdog") == []
    time.sleep(0.45)
    [expiry] = rig.log("watchdog")
    assert 0.19 < expiry["t"] - fed < 0.4
    assert not device.is_on("do2.0")
    assert device.read_back("ao4.0") == 0.0


# -- rescue and silence ---------------------------------------------------------------------------------------------


def test_rescue_has_the_last_word_over_a_step_that_the_terminal_carries_out_late(rig):
    """The step had arrived when its connection was cut, and is carried out after the rescue's own command."""
    plain, came = rig.inside.carry_out, threading.Event()

    def carry_out(request, connection, *, ignore=False):
        if request.values and request.values[0] == STEP:
            came.set()
            until(lambda: rig.log("set") and rig.log("set")[-1]["raw"] == 0.0)
            time.sleep(0.02)
        return plain(request, connection, ignore=ignore)

    rig.inside.carry_out = carry_out

    def send():
        with contextlib.suppress(DeviceError):
            rig.device.write("ao4.0", float(STEP))

    step = threading.Thread(target=send)
    step.start()
    assert came.wait(2.0)
    rig.device.rescue("ao4.0", 0.0)
    step.join()
    time.sleep(0.1)
    values = [entry["raw"] for entry in rig.log("set")]
    assert values[-1] == 0.0
    assert STEP in values


def test_two_rescues_at_once_leave_each_valve_of_a_module_as_asked(rig):
    for _ in range(5):
        rig.device.switch("do2.0", on=False)
        rig.device.switch("do2.1", on=True)
        calls = [threading.Thread(target=rig.device.rescue, args=(f"do2.{i}", float(i == 0))) for i in (0, 1)]
        for call in calls:
            call.start()
        for call in calls:
            call.join()
        time.sleep(0.02)
        assert (rig.device.is_on("do2.0"), rig.device.is_on("do2.1")) == (True, False)
