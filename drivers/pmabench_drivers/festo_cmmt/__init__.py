"""Festo CMMT-AS and CMMT-ST servo drives over Modbus TCP, telegram 111: a driven free end.

`telegram`: the words of telegram 111 and what they mean, registers, parameters, the pieces of a sine, and what the
bench file says, and the connection; `driver`: the device interface; `emulated`, `emulated_motion`: what
`pmabench emulate` serves.
"""

from pmabench_drivers.festo_cmmt.driver import FestoCmmt

__all__ = ["FestoCmmt"]
