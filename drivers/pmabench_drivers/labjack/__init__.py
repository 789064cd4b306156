"""LabJack T7, T8 and T4: analogue inputs (a T7 streams them), DACs, digital lines, watchdog, over Ethernet.

`registers`: addresses, words, and what the bench file says; `stream`: packets, volts and their connection; `driver`:
the device interface. Commands go through the Modbus driver. `emulated`, `emulated_map`: a
device on this machine, for `pmabench emulate`.
"""

from pmabench_drivers.labjack.driver import LabJack

__all__ = ["LabJack"]
