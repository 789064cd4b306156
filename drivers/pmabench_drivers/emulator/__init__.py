"""The plant of the mock behind real wires: Modbus TCP on 127.0.0.1, Modbus RTU and serial text on pseudo-terminals.

`plant`: the muscle in real time; `frames`: Modbus as bytes; `registers`, `modbus_server`: a Modbus device; `indicator`:
a text line indicator; `ports`: pseudo-terminals; `faults`, `log`, `control`: what goes wrong, what was commanded, and
the socket for both. `emulator` puts them together for the devices of a bench.
"""

from pmabench_drivers.emulator.emulator import Emulator

__all__ = ["Emulator"]
