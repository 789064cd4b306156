"""The regulator does what its manual says, as seen by a Modbus client that somebody else wrote."""

import struct
import time

import pytest
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ConnectionException

from tests.outside.harness import eventually, regulator
from tests.outside.regulator import LASTING, ONCE

pytestmark = pytest.mark.realtime


@pytest.fixture
def device(tmp_path):
    with regulator(tmp_path) as made:
        yield made


@pytest.fixture
def client(device):
    made = ModbusTcpClient("127.0.0.1", port=device.port, timeout=2, retries=0)
    assert made.connect()
    yield made
    made.close()


def measured(client):
    words = client.read_input_registers(0, count=10).registers
    return struct.unpack(">fffIHH", struct.pack(">10H", *words))


def test_registers_and_air(device, client):
    assert struct.pack(">12H", *client.read_holding_registers(100, count=12).registers).rstrip(b"\0") == b"PR-10"
    serial, constant = struct.unpack(">II", struct.pack(">4H", *client.read_holding_registers(112, count=4).registers))
    assert (serial, constant) == (device.port, 0x00112233)
    client.write_coil(0, True)
    client.write_register(10, 3000)
    assert client.read_coils(0, count=1).bits[0]
    time.sleep(0.16)  # two of the time constants of 0.08 s
    pressure, _, force, *_ = measured(client)
    assert pressure == pytest.approx(300 * (1 - 2.718**-2), rel=0.1)
    assert force == pytest.approx(58.86, abs=0.3)
    time.sleep(0.8)
    pressure, contraction, *_ = measured(client)
    assert pressure == pytest.approx(300, abs=0.2)
    assert contraction == pytest.approx((0.95 * 300 - 58.86) / 6.8, abs=0.05)
    client.write_coil(0, False)
    time.sleep(0.4)
    assert measured(client)[0] < 1.0
    assert [line["do"] for line in device.lines("pressurised", "vented")] == ["pressurised", "vented"]


def test_what_it_refuses(client):
    assert client.write_register(10, 10001).exception_code == 3
    assert client.write_register(21, 2).exception_code == 3
    assert client.write_register(11, 1).exception_code == 2
    assert client.read_holding_registers(11, count=1).exception_code == 2
    assert client.read_input_registers(9, count=2).exception_code == 2
    assert client.read_coils(1, count=1).exception_code == 2
    assert client.read_file_record([]).exception_code == 1


def test_the_watchdog_ends_at_its_time_and_any_request_feeds_it(device, client):
    client.write_register(20, 100)
    client.write_register(21, 1)
    client.write_coil(0, True)
    client.write_register(10, 2000)
    for _ in range(20):
        time.sleep(0.1)
        measured(client)
    assert not device.lines("watchdog")
    ended = eventually(lambda: device.lines("watchdog"))[0]
    assert ended["t"] - ended["fed"] == pytest.approx(1.0, abs=0.05)
    state = device.state()
    assert (state["set_point"], state["closed"], state["watchdog"], state["ended"]) == (0, False, 0.0, 1)
    assert client.read_holding_registers(21, count=1).registers == [0]


def test_a_restart_forgets_everything(device, client):
    client.write_register(20, 30)
    client.write_register(21, 1)
    client.write_register(10, 2000)
    device.inject("restart")
    with pytest.raises(ConnectionException):
        client.read_holding_registers(10, count=1)
    client.connect()
    assert client.read_holding_registers(10, count=1).registers == [0]
    assert client.read_holding_registers(20, count=2).registers == [0, 0]
    assert measured(client)[4] == 2


@pytest.mark.parametrize("fault", sorted(LASTING))
def test_a_fault_that_lasts_can_be_cleared(fault, device):
    device.inject(fault, 0.1)
    device.clear()
    client = ModbusTcpClient("127.0.0.1", port=device.port, timeout=2, retries=0)
    assert client.connect()
    client.write_register(10, 1234)
    assert client.read_holding_registers(10, count=1).registers == [1234]
    client.close()


def test_ignored_writes_are_acknowledged_and_logged(device, client):
    device.inject("ignore-set-points")
    assert not client.write_register(10, 2000).isError()
    assert client.read_holding_registers(10, count=1).registers == [0]
    assert [line["done"] for line in device.lines("write")] == [False]


def test_every_kind_of_the_campaign_is_a_fault_of_the_device():
    from tests.outside.kinds import KINDS

    assert {kind.name for kind in KINDS} == LASTING | ONCE
