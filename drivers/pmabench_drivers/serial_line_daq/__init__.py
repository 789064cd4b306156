"""A microcontroller board with an open line protocol: samples by its own clock, set-points, valves, its own watchdog.

The protocol is in docs/devices/serial-line-daq.md, the program of the board in `sketch`. `wire`: lines as bytes, times,
options; `driver`: the device interface; `emulator`: a board on a pseudo-terminal.
"""

from pmabench_drivers.serial_line_daq.driver import SerialLineDaq

__all__ = ["SerialLineDaq"]
