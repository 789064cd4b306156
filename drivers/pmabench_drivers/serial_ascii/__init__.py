"""Indicators that send text lines over a serial port: load cells, gauges, displays.

`options`: what the bench file says; `pattern`: how a line is read, in bounded work; `driver`: the device interface.
"""

from pmabench_drivers.serial_ascii.driver import SerialIndicator

__all__ = ["SerialIndicator"]
