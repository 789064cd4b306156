"""DATAQ DI-2108, DI-4108 and DI-1110: analogue inputs sampled by the device's own clock, over a serial port (USB CDC).

`driver`: options, scans as bytes, the device interface; `emulator`: a device on a pseudo-terminal.
"""

from pmabench_drivers.dataq.driver import Dataq

__all__ = ["Dataq"]
