"""The laser sensor Micro-Epsilon optoNCDT ILD1420: distances with their numbers, over RS422.

`wire`: bytes as values; `numbering`: which measurement a value is, and what was lost; `options`: what the bench file
says; `driver`: the device interface; `emulator`: a sensor on a pseudo-terminal.
"""

from pmabench_drivers.ild1420.driver import Ild1420

__all__ = ["Ild1420"]
