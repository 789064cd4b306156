"""The driver in front of the emulated T7: who it is, commands, lines, lost answers, watchdog, rescue."""

import random
import struct
import time
from dataclasses import replace

import pytest
from pmabench_drivers.labjack import LabJack
from pmabench_drivers.labjack import registers as r
from pymodbus.client import ModbusTcpClient

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, UsageError
from pmabench.bench.interface import EMULATED, ValveRecord
from tests.drivers.common import timed, until
from tests.drivers.labjack.rigs import rig, t7
from tests.drivers.wires.rigs import Peer
from tests.ports import free_port
from tests.reliability.cases import cases

pytestmark = pytest.mark.realtime

BOUND = 0.3
"""The contract is 0.2 s; the rest is for a busy machine."""


@pytest.fixture(name="bench")
def _bench():
    with rig() as parts:
        yield parts


def sent(emulator, kind="set"):
    return emulator.log.of(kind, "t7")


def test_it_says_who_it_is(bench):
    _emulator, _served, device = bench
    identity = device.open()
    assert (identity.maker, identity.firmware, identity.simulated) == ("LabJack", "1.0331", True)
    assert identity.model.startswith(EMULATED)


@pytest.mark.parametrize(
    ("address", "words", "why"),
    [
        (r.TEST, [0x2233, 0x0011], "2233 0011 instead of 0011 2233"),
        (r.PRODUCT_ID, r.f32(4.0), r"is a T4, and the bench file says T7"),
        (r.PRODUCT_ID, r.f32(3.0), r"has the product number 3, and the bench file says T7"),
        (r.PRODUCT_ID, r.f32(8.0), r"is a T8, and the bench file says T7"),
    ],
)
def test_another_device_or_another_order_of_words_is_refused(address, words, why):
    with rig(opened=False) as (_, served, device):
        served.t7._store(address, words)
        with pytest.raises(DeviceError, match=why):
            device.open()


def test_a_real_serial_number_is_no_simulation(bench):
    _emulator, served, device = bench
    served.t7._store(r.SERIAL_NUMBER, r.u32(470012345))
    identity = device.open()
    assert (identity.model, identity.serial, identity.simulated) == ("T7", "470012345", False)


def test_damaged_calibration_is_refused(bench, monkeypatch):
    monkeypatch.setattr("pmabench_drivers.labjack.emulated.constants", lambda: [0.0] * 41)
    with pytest.raises(DeviceError, match="that no T7 has.*its flash is damaged"):
        bench[2].open()


def test_another_stack_reads_the_same(bench):
    """pymodbus by itself at the maker's addresses: the emulator is no mirror of the driver."""
    _emulator, served, device = bench
    device.write("DAC0", 1.25)
    device.switch("FIO0", on=True)
    host, port = served.address.split(":")
    client = ModbusTcpClient(host, port=int(port), timeout=1, retries=0)
    try:

        def f32(address):
            words = client.read_holding_registers(address, count=2, device_id=1).registers
            return client.convert_from_registers(words, client.DATATYPE.FLOAT32)

        assert f32(1000) == 1.25
        assert f32(60000) == 7.0
        assert client.read_holding_registers(2800, count=2, device_id=1).registers[1] & 1 == 1
        assert client.read_holding_registers(2850, count=2, device_id=1).registers == [0, 1]
        assert until(lambda: f32(0) == pytest.approx(2.5, abs=1e-3))  # AIN0, 100 kPa a volt
        assert client.read_holding_registers(3000, count=2, device_id=1).exception_code == 2
        assert client.write_register(1000, 1, device_id=1).exception_code == 4  # half of a float
        assert client.read_holding_registers(55000, count=1, device_id=1).registers == [2315]
    finally:
        client.close()


# -- commands and lines ---------------------------------------------------------------------------------------------


def test_a_dac_is_set_and_read_back_and_the_muscle_is_filled(bench):
    emulator, _served, device = bench
    device.switch("FIO0", on=True)
    device.write("DAC0", 1.5)
    assert device.read_back("DAC0") == 1.5
    assert [(e["output"], e["raw"], e["si"]) for e in sent(emulator)] == [("pressure", 1.5, pytest.approx(300e3))]
    assert until(lambda: emulator.plant.quantities()["pressure"] > 295e3)


def test_the_line_of_the_valve_stays_an_output_however_it_is_looked_at(bench):
    emulator, served, device = bench
    assert device.is_on("FIO0") is False
    device.switch("FIO0", on=True)
    for _ in range(3):
        assert device.is_on("FIO0") is True
        device.level("FIO1")
    assert served.t7._directions == 1
    device.switch("FIO0", on=False)
    assert device.is_on("FIO0") is False
    assert [entry["on"] for entry in sent(emulator, "switch")] == [True, False]


def test_a_line_that_is_only_pulled_up_is_not_on(bench):
    _emulator, served, device = bench
    served.t7._terminal = lambda _line: True
    assert device.is_on("FIO0") is False  # an input: nothing drives it


def test_a_line_that_is_held_down_outside_is_found_out(bench):
    _emulator, served, device = bench
    served.t7._terminal = lambda _line: False
    with pytest.raises(DeviceError, match="FIO0: was commanded 1 and its terminal is low"):
        device.switch("FIO0", on=True)


def test_the_emergency_stop_is_read_also_while_the_stream_runs(bench):
    emulator, _served, device = bench
    device.start(200.0)
    assert device.level("FIO1") is True
    emulator.plant.fail("e_stop_at")
    assert device.level("FIO1") is False
    with pytest.raises(DeviceError, match='no input "FIO0"'):
        device.level("FIO0")  # reading the valve's line would open the valve


# -- lost answers ---------------------------------------------------------------------------------------------------


def test_a_switch_without_answer_is_settled_by_the_terminal(bench):
    emulator, served, device = bench
    served.faults.set("lost", count=1)
    device.switch("FIO0", on=True)
    served.faults.set("silence", count=1)
    with pytest.raises(DeviceError, match="did not answer to the command 0 and its terminal is high"):
        device.switch("FIO0", on=False)
    assert [entry["on"] for entry in sent(emulator, "switch")] == [True]
    served.faults.set("lost")
    with pytest.raises(DeviceError, match="whether it took 0 is not known"):
        device.switch("FIO0", on=False)


def test_a_refusal_names_labjacks_own_reason(bench):
    device = bench[2]
    device.arm_watchdog(1.0)
    with pytest.raises(DeviceError, match="answers with exception 4.*its error 2671: the watchdog is on"):
        device.put(r.WATCHDOG_TIMEOUT, r.u32(5), time.monotonic() + 0.2, "watchdog")
    device.disarm_watchdog()


def test_nobody_there_is_reported_at_once():
    device = LabJack(t7(address=f"127.0.0.1:{free_port()}"), RealClock())
    took, outcome = timed(device.open)
    assert "no connection to 127.0.0.1" in str(outcome)
    assert took < BOUND


def test_a_peer_that_answers_nonsense_is_refused():
    """Right Modbus frames with random contents: a sentence, whatever stands in them."""
    rng = random.Random(1)

    def reply(request):
        if request[7] == 16:
            return request[:4] + b"\0\6" + request[6:12]
        size = 2 * struct.unpack(">H", request[10:12])[0]
        return request[:4] + struct.pack(">HBBB", size + 3, 1, 3, size) + rng.randbytes(size)

    with Peer(reply) as peer:
        device = LabJack(replace(t7(), address=peer.address), RealClock())
        device._prove_words = lambda _deadline: None
        for _ in range(cases(300)):
            took, outcome = timed(device.open)
            assert isinstance(outcome, DeviceError)
            assert took < BOUND


# -- watchdog and rescue --------------------------------------------------------------------------------------------


def test_the_watchdog_vents_when_its_key_is_missing(bench):
    """The stream runs, and other registers are read: only the key counts."""
    emulator, served, device = bench
    device.switch("FIO0", on=True)
    device.write("DAC0", 1.0)
    assert device.arm_watchdog(1.0) == 1.0
    device.start(200.0)
    for _ in range(6):
        time.sleep(0.25)
        device.feed_watchdog()
    fed = time.monotonic()
    assert sent(emulator, "watchdog") == []
    while time.monotonic() < fed + 1.4:
        device.read_back("DAC0")
        device.collect()
        time.sleep(0.02)
    [expiry] = sent(emulator, "watchdog")
    assert 0.99 < expiry["t"] - fed < 1.3
    assert device.read_back("DAC0") == 0.0
    assert not device.is_on("FIO0")
    assert until(lambda: emulator.plant.quantities()["pressure"] < 20e3)
    assert served.t7._directions & 1


def test_the_watchdog_is_set_whatever_was_in_it_before(bench):
    _emulator, served, device = bench
    served.t7._store(r.WATCHDOG_RESET, r.u32(1))
    served.t7._store(r.WATCHDOG_DAC_ENABLE[1], r.u32(1))
    served.t7._store(r.WATCHDOG_TIMEOUT, r.u32(900))
    served.t7._store(r.WATCHDOG_ENABLE, r.u32(1))
    assert device.arm_watchdog(2.7) == 2.0
    held = {a: served.t7._u32(a) for a in (r.WATCHDOG_RESET, r.WATCHDOG_STRICT, *r.WATCHDOG_DAC_ENABLE)}
    assert held == {r.WATCHDOG_RESET: 0, r.WATCHDOG_STRICT: 1, 61640: 1, 61650: 0}
    assert served.t7._u32(r.WATCHDOG_DIO_INHIBIT) == 0x7FFFFE
    device.disarm_watchdog()
    assert served.t7._u32(r.WATCHDOG_ENABLE) == 0


def test_settings_that_stand_are_not_written_to_flash_again(bench):
    _emulator, served, device = bench
    written = []
    store = served.t7._store
    served.t7._store = lambda address, words: (written.append(address), store(address, words))
    device.arm_watchdog(1.0)
    assert r.WATCHDOG_DIO_ENABLE in written
    device.disarm_watchdog()
    written.clear()
    device.arm_watchdog(1.0)
    assert set(written) == {r.WATCHDOG_ENABLE}


def test_a_valve_that_is_energised_to_vent_is_energised_by_the_watchdog():
    record = replace(t7(), valves=(ValveRecord("dump_valve", "t7", "EIO2", energised="open"),))
    with rig(record) as (_, served, device):
        device.arm_watchdog(1.0)
        assert served.t7._u32(r.WATCHDOG_DIO_STATE) == served.t7._u32(r.WATCHDOG_DIO_DIRECTION) == 1 << 10


def test_a_watchdog_that_does_not_hold_its_settings_is_no_watchdog(bench):
    _emulator, served, device = bench
    served.faults.set("ignore")
    with pytest.raises(DeviceError, match="register 61602 holds"):
        device.arm_watchdog(1.0)
    served.faults.set("clear")
    with pytest.raises(DeviceError, match="counts whole seconds"):
        device.arm_watchdog(0.5)


def test_only_this_machine_is_served():
    with (
        pytest.raises(UsageError, match="where other machines could reach what is emulated"),
        rig(t7(address="192.168.0.5")),
    ):
        pass


def test_a_line_that_is_rescued_stays_an_output(bench):
    """A look at its own register makes it an input: a valve that is energised to vent would chatter."""
    _, served, device = bench
    read, look = [], served.t7._read_line
    served.t7._read_line = lambda line: (read.append(line), look(line))[1]
    device.switch("FIO0", on=False)
    device.rescue("FIO0", 1.0)
    assert read == []
    device.open()
    assert device.is_on("FIO0")
