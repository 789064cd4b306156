"""Festo CPX-E terminals with the bus module CPX-E-EP (Modbus TCP): 4AI-UI, 4AO-UI, 16DI and 8DO.

`terminal`: modules, addresses and options; `driver`: the device interface, a Modbus device whose map follows from its
modules; `emulated`: what `pmabench emulate` serves.
"""

from pmabench_drivers.festo_cpx_e.driver import FestoCpxE

__all__ = ["FestoCpxE"]
