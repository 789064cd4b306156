"""The plant of the mock behind real wires: Modbus TCP on 127.0.0.1, Modbus RTU and serial text on pseudo-terminals.

`plant`: the muscle in real time, and what is wired to a device; `truth`: what is really wired, and what is wrong with
it; `modbus_server`: Modbus devices; `ports`: where emulated devices listen; `faults`: what goes wrong, and what
happened, written down. `emulator` puts them together for the devices of a bench. Each emulated device is next to its
driver.
"""

from pmabench_drivers.emulator.emulator import Emulator

__all__ = ["Emulator"]
