"""LabJack T7: analogue inputs on a hardware-timed stream, DACs, digital lines and its watchdog, over Ethernet.

`registers`: addresses and words; `options`: what the bench file says; `calibration`: counts to volts; `packets`: the
stream as bytes; `stream`: its connection; `watchdog`: the device's own; `driver`: the device interface. Commands go
through the Modbus driver. `emulated`, `emulated_stream`: a T7 on this machine, for `pmabench emulate`.
"""

from pmabench_drivers.labjack.driver import LabJack

__all__ = ["LabJack"]
