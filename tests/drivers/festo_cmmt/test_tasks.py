"""The emulated drive's tasks as PROFIdrive has them: pymodbus alone, registers and bits written out by hand."""

import contextlib
import struct

import pytest
from pymodbus.client import ModbusTcpClient

from tests.drivers.common import until
from tests.drivers.festo_cmmt.rigs import served

pytestmark = pytest.mark.realtime

ENABLED, REACHED, HOMED, TAKEN = 1 << 2, 1 << 10, 1 << 11, 1 << 12
"""Bits of ZSW1."""
JOGGING, HOMING = 1 << 10, 1 << 11
"""Bits of POS_ZSW1."""
ON = 0x043F
"""STW1: under power and controlled by the program; a task is neither rejected nor interrupted."""
TASK, JOG, HOME = 1 << 6, 1 << 8, 1 << 11
ABSOLUTE, FORWARD, SET_UP, MDI = 1 << 8, 1 << 9, 1 << 14, 1 << 15


class Program:
    """What exchanges process data of telegram 111 with a drive."""

    def __init__(self, address):
        host, port = address.split(":")
        self.client = ModbusTcpClient(host, port=int(port), timeout=1, retries=0)

    def send(self, control, mode=0, target=0, velocity=0, more=0):
        low, high = struct.unpack("<HH", struct.pack("<i", target))
        words = [control, mode, more, 0, 0x4000, low, high, velocity, 0, 0x4000, 0x4000]
        assert not self.client.write_registers(0, words).isError()

    @property
    def words(self):
        return self.client.read_holding_registers(100, count=28).registers

    @property
    def position(self):
        return struct.unpack("<i", struct.pack("<HH", *self.words[5:7]))[0]

    def is_at(self, position):
        return until(lambda: self.words[0] & REACHED and abs(self.position - position) <= 20, 5)

    def parameter(self, number, value=None):
        """Read or write a parameter of 16 bits through the mailbox; what it holds, None where it is refused."""
        for address, word in ((500, number), (501, 0), (502, 1)):
            self.client.write_register(address, word)
        if value is not None:
            self.client.write_register(504, 2)
            self.client.write_registers(510, [value])
        self.client.write_register(503, 1 if value is None else 2)
        if self.client.read_holding_registers(503, count=1).registers != [0x10]:
            return None
        return self.client.read_holding_registers(510, count=1).registers[0]


@contextlib.contextmanager
def program(*, on=True):
    """A program in front of a drive that is under power at 0."""
    with served() as rig:
        rig.inside.timeout = 0
        it = Program(rig.server.address)
        try:
            if on:
                it.send(ON & ~1)
                it.send(ON)
                assert until(lambda: it.words[0] & ENABLED, 2)
            yield rig, it
        finally:
            it.client.close()


def test_a_relative_target_counts_from_where_it_was_sent_and_each_is_acknowledged():
    with program() as (rig, it):
        for target, place in ((4000, 4000), (4000, 8000), (-1000, 7000)):
            it.send(ON, MDI, target, 50)
            assert not it.words[0] & TAKEN
            it.send(ON | TASK, MDI, target, 50)
            assert it.words[0] & TAKEN
            assert it.is_at(place)
        assert [entry["si"] for entry in rig.log("move")] == pytest.approx([0.004, 0.008, 0.007], abs=2e-5)


def test_homing_goes_to_the_reference_mark_and_its_end_is_seen():
    with program() as (rig, it):
        it.send(ON | TASK, MDI | ABSOLUTE, 3000, 50)
        assert it.is_at(3000)
        it.send(ON | HOME)
        status, position_status = it.words[:2]
        assert position_status & HOMING
        assert not status & HOMED
        assert until(lambda: it.words[0] & HOMED and not it.words[1] & HOMING, 3)
        assert it.is_at(0)
        assert rig.emulator.plant.quantities()["displacement"] == pytest.approx(0.0, abs=2e-5)


def test_homing_that_is_given_up_leaves_no_reference():
    with program() as (_rig, it):
        it.send(ON | HOME)
        it.send(ON)
        assert not it.words[1] & HOMING
        assert not it.words[0] & HOMED
        it.send(ON | TASK, MDI | ABSOLUTE, 3000, 50)
        assert not it.words[0] & TAKEN


def test_where_it_is_becomes_the_reference():
    with program() as (rig, it):
        it.send(ON | TASK, MDI | ABSOLUTE, 3000, 50)
        assert it.is_at(3000)
        it.send(ON, more=1 << 1)
        assert it.words[1] & HOMING
        assert until(lambda: not it.words[1] & HOMING, 2)
        assert abs(it.position) <= 20
        it.send(ON | TASK, MDI | ABSOLUTE, 1000, 50)
        assert it.is_at(1000)
        assert rig.emulator.plant.quantities()["displacement"] == pytest.approx(0.004, abs=5e-5)


def test_jogging_goes_on_until_its_bit_goes():
    with program() as (_rig, it):
        it.send(ON | JOG)
        assert it.words[1] & JOGGING
        assert until(lambda: it.position > 500, 2)
        it.send(ON)
        assert not it.words[1] & JOGGING
        is_there = it.position
        assert it.is_at(is_there)


def test_a_velocity_goes_on_and_an_intermediate_stop_interrupts_a_task():
    with program() as (_rig, it):
        it.send(ON | TASK, MDI | SET_UP | FORWARD | ABSOLUTE, velocity=10)
        assert it.words[0] & TAKEN
        assert until(lambda: it.position > 1000, 2)
        it.send(ON & ~(1 << 4))
        assert until(lambda: it.words[0] & REACHED, 1)
        it.send(ON | TASK, MDI | ABSOLUTE, 9000, 10)
        it.send(ON & ~(1 << 5), MDI | ABSOLUTE, 9000, 10)
        is_there = it.position
        assert is_there < 8000
        assert it.is_at(is_there)
        it.send(ON, MDI | ABSOLUTE, 9000, 10)
        assert it.is_at(9000)


def test_the_telegram_is_selected_by_a_parameter_without_power():
    with program(on=False) as (_rig, it):
        assert it.parameter(3490) == 111
        assert it.parameter(3490, 1) == 1
        assert it.parameter(3490) == 1
        assert it.parameter(3490, 7) is None  # no such drive has it
        assert it.parameter(11724, 0) is None  # cannot be written
        assert it.client.write_registers(0, [0x043E, 0]).isError() is False
        assert it.client.write_registers(0, [0x043F, 0]).isError() is False
        assert until(lambda: it.words[0] & ENABLED, 2)
        assert it.parameter(3490, 111) is None  # not under power
        assert it.client.write_registers(0, [0x047F, 0x0400]).isError() is False  # a 16th of the base value, 0.1 m/s
        assert it.words[1] == 0x0400
        assert it.client.write_registers(0, [0, 0]).isError() is False


def test_a_write_of_another_length_than_the_telegrams_is_refused():
    with program(on=False) as (_rig, it):
        assert it.client.write_registers(0, [0x043E] * 5).exception_code == 2
