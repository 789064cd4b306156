"""Alicat PC and PCD pressure controllers, over ASCII or Modbus RTU on a serial line.

`options`: what the bench file says, and what a reading says; `ascii_link`, `modbus_link`: the two protocols behind the
same few methods; `driver`: the device interface; `emulator`, `emulated_commands`, `emulated_controller`: the device for
`pmabench emulate`.

Sources: Alicat, manual of standard flow and pressure devices, 02/2023 (Modbus registers, special commands, status
bits; ASCII commands); Apex/Alicat PC manual, page 22 (set-points, data frame). The list of columns is read as devices
with firmware 6v21 to 10v20 are known to send it.
"""

from pmabench_drivers.alicat.driver import AlicatController

__all__ = ["AlicatController"]
