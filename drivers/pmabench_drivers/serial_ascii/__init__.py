"""Indicators that send text lines over a serial port: load cells, gauges, displays.

`lines`: what the bench file says, and how a line is read, in bounded work; `driver`: the device interface; `emulator`:
an indicator on a pseudo-terminal.
"""

from pmabench_drivers.serial_ascii.driver import SerialIndicator

__all__ = ["SerialIndicator"]
