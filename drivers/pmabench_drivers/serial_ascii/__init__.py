"""Indicators that send text lines over a serial port: load cells, gauges, displays.

`driver`: what the bench file says, how a line is read in bounded work, the device interface; `emulator`: an indicator
on a pseudo-terminal.
"""

from pmabench_drivers.serial_ascii.driver import SerialIndicator

__all__ = ["SerialIndicator"]
