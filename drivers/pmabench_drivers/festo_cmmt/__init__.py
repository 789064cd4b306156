"""Festo CMMT-AS and CMMT-ST servo drives over Modbus TCP, telegram 111: a driven free end.

`telegram`: the words of telegram 111 and what they mean, registers, parameters; `options`: what the bench file says;
`link`: the connection; `path`: where the drive is wanted, and the pieces of a sine; `driver`: the device interface;
`emulated`: what `pmabench emulate` serves.
"""

from pmabench_drivers.festo_cmmt.driver import FestoCmmt

__all__ = ["FestoCmmt"]
