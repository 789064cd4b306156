"""The package `minimalmodbus` 2.1.1 in front of a register map over RTU: a pressure regulator on a serial line.

Calls: https://minimalmodbus.readthedocs.io (General info: Example of use; API for MinimalModbus).
"""

import os
import sys
import time

import minimalmodbus
from said import call, not_tried

PORT = os.path.realpath(sys.argv[1])
device = minimalmodbus.Instrument(PORT, 7)
device.serial.baudrate = 19200
device.serial.timeout = 0.2


def refused(act, kind):
    try:
        act()
    except kind:
        return
    raise AssertionError(f"no {kind.__name__}")


with call("Instrument, read_register"):
    assert device.read_register(110) == 0x0011
    assert device.read_register(111) == 0x2233
with call("read_long"):
    assert device.read_long(110) == 0x00112233
with call("read_registers"):
    assert device.read_registers(110, 2) == [0x0011, 0x2233]
with call("write_float, read_float") as saw:
    device.write_float(10, 150.0)
    assert device.read_float(10) == 150.0
    saw["commanded"] = 150e3
with call("read_float(functioncode=4)") as saw:
    device.write_bit(0, 1)  # the dump valve lets the air through
    time.sleep(2.0)
    assert device.read_float(0, functioncode=4) > 100.0
    saw["pressure"] = 1e3 * device.read_float(0, functioncode=4)
with call("write_register, number of decimals"):
    device.write_register(20, 0.5, number_of_decimals=2)
    assert device.read_register(20) == 50
    assert device.read_register(20, number_of_decimals=2) == 0.5
    device.write_register(20, 0)
with call("write_register(functioncode=6)"):
    device.write_register(20, 100, functioncode=6)
    assert device.read_register(20) == 100
    device.write_register(20, 0, functioncode=6)
with call("write_registers") as saw:
    device.write_registers(10, [0x42C8, 0x0000])
    assert device.read_float(10) == 100.0
    saw["commanded"] = 100e3
with call("write_long"):
    refused(lambda: device.write_long(110, 5), minimalmodbus.IllegalRequestError)
with call("write_bit, read_bit(functioncode=1)") as saw:
    device.write_bit(0, 1)
    assert device.read_bit(0, functioncode=1) == 1
    saw["valve"] = 1.0
with call("read_bit(functioncode=2)"):
    assert device.read_bit(0) == 1
with call("read_bits, write_bits"):
    assert device.read_bits(0, 1, functioncode=1) == [1]
    device.write_bits(0, [0])
    assert device.read_bits(0, 1, functioncode=1) == [0]
with call("IllegalRequestError"):
    refused(lambda: device.read_register(500), minimalmodbus.IllegalRequestError)
with call("NoResponseError: another address"):
    other = minimalmodbus.Instrument(PORT, 8)
    other.serial.timeout = 0.2
    refused(lambda: other.read_register(110), minimalmodbus.NoResponseError)
not_tried("read_string, write_string", "the map has no text")
