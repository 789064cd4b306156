"""Modbus RTU on a pseudo-terminal: late answers are never taken for the answer to a later question."""

import itertools
import random
import time

import pytest
from pmabench_drivers.modbus import ModbusDevice
from pmabench_drivers.shared.link import Unanswered

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from tests.drivers.common import opened, timed
from tests.drivers.wires.rigs import emulated, regulator

pytestmark = pytest.mark.realtime

TIMEOUT = 0.03
SERIAL = {"baud": 115200}


def line(tmp_path, **changes):
    quick = {"timeout": "30 ms", "slowest": "100 ms", **changes}
    return regulator(str(tmp_path / "regulator"), SERIAL, **quick)


def test_it_measures_and_commands(tmp_path):
    with emulated(line(tmp_path), preset="ideal") as (emulator, [record]), opened(record) as device:
        device.switch("dump", on=True)
        device.start(50.0)
        device.write("pressure", 250.0)
        time.sleep(0.4)
        assert device.collect().columns["pressure"][-1] == pytest.approx(250.0, abs=1e-3)
        assert device.level("e_stop")
        assert [entry["raw"] for entry in emulator.log.of("set")] == [250.0]


def test_late_answers_are_never_taken_for_new_ones(tmp_path):
    """100 requests, each answered 0.5 to 3 time-outs late: every value that comes back is the one asked for.

    The registers hold different numbers, and each is read in turn, so that an answer to another question shows.
    """
    inputs = {f"r{i}": {"table": "holding", "address": 200 + i} for i in range(4)}
    outputs = {
        "pressure": {"address": 10, "type": "float32"},
        "dump": {"table": "coil", "address": 0},
        **{f"r{i}": {"address": 200 + i} for i in range(4)},
    }
    chance = random.Random(5)
    # a busy machine must not keep an answer back for longer than the slowest that is said of the device
    record = line(tmp_path, slowest="400 ms", outputs=outputs, inputs={**inputs, **line_inputs()})
    with emulated(record) as (emulator, [record]), opened(record) as device:
        for i in range(4):
            device._put(device._map.outputs[f"r{i}"], 1000 + i)
        right = refused = 0
        for number in itertools.islice(itertools.cycle(range(4)), 100):
            emulator.devices["regulator"].faults.set("delay", chance.uniform(0.5, 3.0) * TIMEOUT, count=1)
            took, outcome = timed(device._get, device._map.inputs[f"r{number}"])
            assert took < 0.3
            if isinstance(outcome, DeviceError):
                refused += 1
            else:
                assert outcome == 1000 + number
                right += 1
    assert right + refused == 100
    assert right >= 5
    assert refused >= 25


def test_a_late_answer_that_has_come_is_not_waited_for_any_longer(tmp_path):
    """On a busy machine two answers were late by more than the time-out; then nothing was asked until `slowest` had passed."""
    settings = line(tmp_path, slowest="5 s")
    with emulated(settings, preset="ideal") as (emulator, [record]), opened(record) as device:
        wire, faults = device._opened(), emulator.devices["regulator"].faults

        def read(table):
            return timed(wire.read, table, 10 if table == "holding" else 0, 2, time.monotonic() + 0.19)[1]

        values = {table: read(table) for table in ("holding", "input")}
        faults.set("delay", 2 * TIMEOUT, count=2)
        assert [type(read(table)) for table in values] == [Unanswered, Unanswered]
        time.sleep(0.1)  # both come, in one piece
        assert {table: read(table) for table in values} == values
        faults.set("lost", count=1)
        assert isinstance(read("holding"), Unanswered)
        assert "not taken for a new one" in str(read("holding"))


def line_inputs():
    return {
        "pressure": {"table": "input", "address": 0, "type": "float32"},
        "e_stop": {"table": "discrete", "address": 0},
    }


def test_a_vent_does_not_wait_for_a_late_answer(tmp_path):
    with emulated(line(tmp_path, slowest="2 s")) as (emulator, [record]), opened(record) as device:
        device.write("pressure", 100.0)
        emulator.devices["regulator"].faults.set("silence", count=1)
        with pytest.raises(DeviceError, match="no answer"):
            device.level("e_stop")
        with pytest.raises(DeviceError, match="not taken for a new one"):
            device.level("e_stop")
        took, outcome = timed(device.write, "pressure", 0.0)
        assert outcome is None
        assert took < 0.3
        assert emulator.log.of("set")[-1]["raw"] == 0.0


def test_a_lost_answer_is_settled_by_another_kind_of_question(tmp_path):
    with emulated(line(tmp_path)) as (emulator, [record]), opened(record) as device:
        for number in range(10):
            emulator.devices["regulator"].faults.set("lost", count=1)
            device.write("pressure", 50.0 + number)
        assert [entry["raw"] for entry in emulator.log.of("set")] == [50.0 + number for number in range(10)]


@pytest.mark.parametrize("kind", ["silence", "lost", "garbage", "truncated", "delay"])
def test_every_call_ends_in_time(tmp_path, kind):
    with emulated(line(tmp_path)) as (emulator, [record]), opened(record) as device:
        for call in (lambda: device.write("pressure", 5.0), lambda: device.level("e_stop"), device.feed_watchdog):
            emulator.devices["regulator"].faults.set(kind, {"truncated": 2.0, "delay": 0.2}.get(kind))
            took, outcome = timed(call)
            assert took < 0.3
            assert outcome is None or isinstance(outcome, DeviceError | bool)
            emulator.devices["regulator"].faults.set("clear")
            time.sleep(0.25)
            assert device.level("e_stop")


def test_a_port_that_is_gone_is_said(tmp_path):
    with emulated(line(tmp_path)) as (emulator, [record]), opened(record) as device:
        emulator.devices["regulator"].faults.set("hang-up")
        outcomes = [timed(device.level, "e_stop") for _ in range(3)]
        assert all(took < 0.3 for took, _ in outcomes)
        assert all(isinstance(outcome, DeviceError) for _, outcome in outcomes)
        assert "no connection to" in str(outcomes[-1][1])


def test_one_port_one_program(tmp_path):
    with emulated(line(tmp_path)) as (_, [record]), opened(record):
        other = ModbusDevice(record, RealClock())
        with pytest.raises(DeviceError, match="no connection to"):
            other.open()


def test_a_late_refusal_is_not_taken_for_an_answer_that_leaves_another_one_owed(tmp_path):
    """A late exception meets the next question, whose own answer then comes while the one after it waits."""
    registers = {f"r{i}": {"address": 200 + i} for i in range(2)}
    outputs = {"pressure": {"address": 10, "type": "float32"}, "dump": {"table": "coil", "address": 0}, **registers}
    with emulated(line(tmp_path, outputs=outputs)) as (emulator, [record]), opened(record) as device:
        faults, wire = emulator.devices["regulator"].faults, device._opened()
        for i in range(2):
            device._put(device._map.outputs[f"r{i}"], 1000 + i)

        def read(address, count):
            return timed(wire.read, "holding", address, count, time.monotonic() + 0.19)[1]

        faults.set("delay", 0.06, count=1)
        assert isinstance(read(300, 2), DeviceError)  # no such address; the refusal comes after the time-out
        faults.set("delay", 0.02, count=1)
        assert "exception 2" in str(read(200, 1))
        outcome = read(201, 1)
        assert outcome == [1001] or isinstance(outcome, DeviceError), outcome
