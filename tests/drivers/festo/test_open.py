"""What is compared when a terminal is opened, and what is refused with a sentence."""

import pytest
from pymodbus.client import ModbusTcpClient

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import UNPROVEN
from tests.drivers.common import timed
from tests.drivers.festo.rigs import served

pytestmark = pytest.mark.realtime

FORMAT_AI, RANGE_AI, RANGE_AO = 5026, 5033, 5095
"""Function numbers of the module at place 3 and 4: 4828 + 64 * place + 6, 13 and 11."""


def test_it_shows_who_answers_and_that_it_is_emulated():
    with served() as rig:
        who = rig.device.open()
    assert (who.maker, who.model, who.firmware) == ("emulator of pmabench", f"{UNPROVEN}CPX-E", "1")
    assert who.simulated


def test_another_stack_reads_the_same():
    """pymodbus by itself in front of our frames, with the maker's addresses written out."""
    with served() as rig:
        host, port = rig.server.address.split(":")
        client = ModbusTcpClient(host, port=int(port), timeout=1, retries=0)
        try:
            names = client.read_device_information(read_code=2, object_id=0).information
            assert names[4] == b"emulated unproven CPX-E"
            words = client.read_holding_registers(45367, count=3).registers
            assert sum(word.bit_count() for word in words) == 5
            assert client.read_holding_registers(46100, count=1).registers == [100]
            assert client.write_register(46100, 500).isError() is False
            assert client.read_holding_registers(46100, count=1).registers == [500]
            assert client.write_registers(46100, [300]).isError()
            assert client.read_holding_registers(45409, count=1).exception_code == 2
            client.write_registers(40001, [0])
            client.write_registers(40001, [0x8000 | RANGE_AO])
            for _ in range(100):
                if client.read_holding_registers(45392, count=1).registers[0] & 0x8000:
                    break
            assert client.read_holding_registers(45393, count=1).registers == [0x01]
        finally:
            client.close()


def refused(rig, message):
    took, outcome = timed(rig.device.open)
    assert isinstance(outcome, DeviceError), outcome
    assert message in str(outcome)
    assert took < 2.3
    with pytest.raises(DeviceError, match="is not open"):
        rig.device.read_back("ao4.0")
    assert rig.log("set") == rig.log("switch") == []


def test_another_number_of_modules():
    with served() as rig:
        rig.device._terminal = type(rig.device._terminal)(rig.device._terminal.modules[:3])
        refused(rig, "has 5 modules with the bus module, and the bench file names 4")


def test_a_terminal_with_a_fault():
    with served() as rig:
        rig.inside.faults = 1 << 3 | 1 << 17
        refused(rig, "reports faults (bits 3, 17)")


def test_a_terminal_with_forced_outputs():
    with served() as rig:
        rig.inside.status = 1 << 15
        refused(rig, "has forced inputs or outputs")


def test_for_a_vent_it_is_opened_with_a_fault_and_gives_samples_only_without():
    with served() as rig:
        rig.inside.faults = 1 << 3
        rig.device.open_to_vent()
        rig.device.write("ao4.0", 0.0)
        with pytest.raises(DeviceError, match="reports faults"):
            rig.device.start(100.0)
        rig.inside.faults, rig.inside.parameters[RANGE_AI] = 0, 5 | 2 << 4
        with pytest.raises(DeviceError, match=r"ai3\.0: is set to 0\.\.20 mA"):
            rig.device.start(100.0)
        rig.inside.parameters[RANGE_AI] = 1 | 2 << 4
        assert rig.device.start(100.0) == 100.0
        rig.device._terminal = type(rig.device._terminal)(rig.device._terminal.modules[:3])
        with pytest.raises(DeviceError, match="has 5 modules"):
            rig.device.open_to_vent()


def test_values_in_another_format():
    with served() as rig:
        rig.inside.parameters[FORMAT_AI] |= 1
        refused(rig, "module 3 (4ai-ui): gives linear scaled values")


def test_another_range():
    with served() as rig:
        rig.inside.parameters[RANGE_AI] = 0x26  # channel 0: 4..20 mA, channel 1: -10..10 V
        refused(rig, "terminal.ai3.0: is set to 4..20 mA and the bench file says 0..10 V")
        assert rig.inside.parameters[RANGE_AI] == 0x26


def test_a_data_system_table_that_does_not_answer():
    with served() as rig:
        rig.inside._table = lambda number: None
        rig.inside._show = lambda address: 0
        refused(rig, "its data system table gave no answer within 0.5 s")


@pytest.mark.parametrize("kind", ["silence", "lost", "hang-up", "reset", "stale", "truncated", "garbage", "exception"])
def test_a_terminal_that_does_not_answer_properly(kind):
    with served() as rig:
        rig.server.faults.set(kind, {"truncated": 3.0, "exception": 3.0}.get(kind))
        refused(rig, "terminal")
