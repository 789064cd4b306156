"""An emulated Alicat PCD or MCD on a pseudo-terminal, over ASCII or Modbus RTU, in front of the simulated muscle.

Written independently of the driver: they share only the table of units. It controls with the simulated regulator and
keeps its set-point without communication, as the real one does. A hold keeps the commanded pressure until it is
cancelled.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.alicat import ASCII, read_options
from pmabench_drivers.alicat.emulated_controller import Commands, Controller
from pmabench_drivers.emulator import faults as f
from pmabench_drivers.emulator.modbus_server import ADDRESS, VALUE, Refused, Request, RtuDevice, read_cells
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import OnTerminal
from pmabench_drivers.shared.options import options_of

BITS = {"POV": 6, "HLD": 8, "ADC": 9, "EXH": 10, "OPL": 11}


def serve(device: DeviceRecord, plant: RealPlant, log: f.CommandLog) -> AsciiDevice | RtuDevice:
    """Emulated controller for a device of the driver `alicat`."""
    options = options_of(device, read_options)
    controller = Controller(device, options, plant, log)
    if options.protocol == ASCII:
        return AsciiDevice(controller, options.letter, log)
    cells = ModbusCells(controller)
    served = RtuDevice(cells, options.number, log, device.address)
    served.faults = f.Faults(f.LINK, f.STUCK, f.MODBUS, f.OVER, f.STATUS, f.RESTART, f.SETPOINT)
    cells.faults = served.faults
    return served


class AsciiDevice(OnTerminal):
    """The controller on a pseudo-terminal, with one answer per request."""

    def __init__(self, controller: Controller, letter: str, log: f.CommandLog) -> None:
        self.controller, self._letter, self._commands = controller, letter, Commands(controller, letter)
        super().__init__(
            controller.device, log, f.Faults(f.LINK, f.STUCK, f.IGNORE, f.OVER, f.STATUS, f.RESTART, f.SETPOINT)
        )
        self.restart, self.change_set_point = controller.restart, controller.change_set_point
        self._data = b""

    def change_held(self) -> bool:
        """Switch its set-point source to the analogue input, as if at its display; always possible."""
        self.controller.source = "A"
        return True

    def by_hand(self, _output: str, value: float) -> None:
        """Enter a set-point [its own unit] at its keys."""
        self.controller.command(value)

    def wait(self) -> float:
        """Interval that is short enough for its own ramps [s]."""
        return 0.02

    def take(self, data: bytes) -> None:
        """Answer each complete request."""
        self.controller.advance()
        *lines, rest = (self._data + data)[-200:].split(b"\r")
        self._data = rest
        for line in lines:
            self._answer(line.decode("ascii", "replace").strip().upper())

    def _answer(self, question: str) -> None:
        """Carry out a request and answer with the present fault."""
        if question[:1] != self._letter:
            return
        fault = self.next_fault()
        if fault.kind == "silence":
            return
        lines = self._commands.answer(question[1:], fault.kind)
        self.terminal.write(self.outgoing("".join(f"{line}\r" for line in lines).encode("ascii"), fault))


class ModbusCells:
    """The controller's registers, as on the wire; only function 16 writes, and 3 and 4 read the same."""

    def __init__(self, controller: Controller) -> None:
        self.device, self.controller, self.faults = controller.device, controller, f.Faults()
        self._command, self.change_set_point = (0, 0), controller.change_set_point

    def look_at_watchdog(self) -> None:
        """No effect: it has no watchdog."""

    def restart(self) -> None:
        """Reset to power-on; the line stays open."""
        self._command = (0, 0)
        self.controller.restart()

    def carry_out(self, request: Request, connection: int, *, ignore: bool = False) -> list[int]:
        """Registers read, or an empty list for a write; raises `Refused`."""
        if request.values:
            if request.function != 16:
                raise Refused(1)
            self._write(request, ignore=ignore)
            return []
        if request.function not in {3, 4}:
            raise Refused(1)
        return read_cells(self._cells(), request)

    def _cells(self) -> Mapping[int, int]:
        pressure, status = self.controller.measured(self.faults.peek().kind)
        flags = sum(1 << BITS[code] for code in status)
        text = self.controller.model.encode("ascii", "replace")[:32].ljust(32, b"\0")
        blocks = {
            999: struct.pack(">HH", *self._command),
            1009: struct.pack(">f", self.controller.set_point),
            1200: struct.pack(">If", flags, pressure),
            0xFE00: text,
        }
        return {
            address + index: word
            for address, data in blocks.items()
            for index, word in enumerate(struct.unpack(f">{len(data) // 2}H", data))
        }

    def _write(self, request: Request, *, ignore: bool) -> None:
        if request.address == 1009 and request.count == 2:
            value = struct.unpack(">f", struct.pack(">HH", *request.values))[0]
            if not abs(value) < 1e9:
                raise Refused(VALUE)
            if not ignore:
                self.controller.command(value)
        elif request.address == 999 and request.count == 2:
            if not ignore:
                self._special(*request.values)
        else:
            raise Refused(ADDRESS)

    def _special(self, command: int, argument: int) -> None:
        settings = {0: "", 1: "closed", 2: "HLD", 3: "EXH"}
        if command != 6:
            self._command = (command, 32769)
        elif argument not in settings:
            self._command = (command, 32770)
        elif argument == 3 and self.controller.options.valves == 1:
            self._command = (command, 32771)
        else:
            self.controller.set_valves(settings[argument])
            self._command = (command, 0)
