"""The laser sensor Micro-Epsilon optoNCDT ILD1420: distances with their numbers, over RS422.

`driver`: options, bytes as values, what was lost, the device interface; `emulator`: a sensor on a pseudo-terminal.
"""

from pmabench_drivers.ild1420.driver import Ild1420

__all__ = ["Ild1420"]
