"""The synchronous client of the package `pymodbus` in front of a register map over TCP: a pressure regulator.

Calls: https://pymodbus.readthedocs.io (Client: Client usage, calls with ModbusTcpClient; examples/simple_sync_client.py).
"""

import sys
import time

from pymodbus.client import ModbusTcpClient
from said import call

host, port = sys.argv[1].rsplit(":", 1)
client = ModbusTcpClient(host, port=int(port))
UNIT = {"device_id": 7}


def floats(words):
    return client.convert_from_registers(words, client.DATATYPE.FLOAT32)


with call("connect"):
    assert client.connect()
with call("read_holding_registers, convert_from_registers"):
    answer = client.read_holding_registers(110, count=2, **UNIT)
    assert not answer.isError()
    assert client.convert_from_registers(answer.registers, client.DATATYPE.UINT32) == 0x00112233
with call("convert_to_registers, write_registers") as saw:
    words = client.convert_to_registers(150.0, client.DATATYPE.FLOAT32)
    assert not client.write_registers(10, words, **UNIT).isError()
    assert floats(client.read_holding_registers(10, count=2, **UNIT).registers) == 150.0
    saw["commanded"] = 150e3
with call("read_input_registers") as saw:
    client.write_coil(0, True, **UNIT)  # the dump valve lets the air through
    time.sleep(2.0)
    assert floats(client.read_input_registers(0, count=2, **UNIT).registers) > 100.0
    saw["pressure"] = 1e3 * floats(client.read_input_registers(0, count=2, **UNIT).registers)
with call("write_register"):
    assert not client.write_register(20, 100, **UNIT).isError()
    assert client.read_holding_registers(20, count=1, **UNIT).registers == [100]
    client.write_register(20, 0, **UNIT)
with call("write_coil, read_coils") as saw:
    assert not client.write_coil(0, True, **UNIT).isError()
    assert client.read_coils(0, count=1, **UNIT).bits[0] is True
    saw["valve"] = 1.0
with call("write_coils") as saw:
    assert not client.write_coils(0, [False], **UNIT).isError()
    assert client.read_coils(0, count=1, **UNIT).bits[0] is False
    saw["valve"] = 0.0
with call("read_discrete_inputs"):
    assert client.read_discrete_inputs(0, count=1, **UNIT).bits[0] is True
with call("isError, exception_code"):
    assert client.read_holding_registers(500, count=1, **UNIT).exception_code == 2
    assert client.write_registers(10, [1], **UNIT).exception_code == 3
with call("read_device_information: refused as not known"):
    assert client.read_device_information(**UNIT).exception_code == 1
with call("close, connect again"):
    client.close()
    assert client.connect()
    assert floats(client.read_holding_registers(10, count=2, **UNIT).registers) == 150.0
client.close()
