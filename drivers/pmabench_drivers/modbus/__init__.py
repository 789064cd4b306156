"""Modbus devices of any maker: a register map in YAML says what is where (TCP, and RTU on a serial port).

`registers`: the map as people write it and as records, and their words; `adapter`: the
connection, the only module that imports pymodbus; `driver`: the device interface; `emulated`: a device with any map.
"""

from pmabench_drivers.modbus.driver import ModbusDevice

__all__ = ["ModbusDevice"]
