"""An emulated Alicat PCD on a pseudo-terminal, over ASCII or Modbus RTU, in front of the simulated muscle.

Written independently of the driver: they share only the table of units. It controls with the simulated regulator and
keeps its set-point without communication, as the real one does. A hold keeps the commanded pressure until it is
cancelled. Sources: Alicat, Serial Communications Primer, 02/2023 (commands, statistics, firmware versions that support
them); answers of controllers with firmware 10v20 to `??D*` and `DCU`: recorded from real devices by the project
alicatlib (tests/fixtures, 2026-04-17).
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Mapping

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.alicat import ASCII, UNITS, Options, read_options
from pmabench_drivers.emulator import faults as f
from pmabench_drivers.emulator.modbus_server import ADDRESS, VALUE, Refused, Request, RtuDevice, read_cells
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import OnTerminal
from pmabench_drivers.shared.options import options_of

FULL_SCALE = 1.0e6
"""Highest pressure that it measures and controls [Pa]."""
STATUS_FAULTS = {"held": "HLD", "sensor": "ADC", "limit": "OPL"}
"""Fault of the control socket -> status code that it sets."""
BITS = {"POV": 6, "HLD": 8, "ADC": 9, "EXH": 10, "OPL": 11}
HOLDS = {"HC": "closed", "H": "HLD", "C": ""}
"""ASCII command -> setting of the valves."""
GAUGE, GAUGE_SET_POINT = 6, 38
"""Statistics of the data line."""
WIDTH = 8
DECIMALS = {"Pa": 0, "hPa": 1, "mbar": 1, "kPa": 2, "psi": 3, "bar": 4, "atm": 4, "MPa": 5}
HEAD = "D00 ID_ NAME______________________ TYPE_______ WIDTH NOTES___________________"
FIRMWARE = "10v20.0-R24"


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


class Controller:
    """The emulated device; pressures in its own unit."""

    def __init__(self, device: DeviceRecord, options: Options, plant: RealPlant, log: f.CommandLog) -> None:
        self.device, self.options, self._plant, self._log = device, options, plant, log
        self.model = plant.model(device.name)
        self._lock = threading.RLock()
        self._pascal = UNITS[options.unit][1]
        self._power_on()

    def _power_on(self) -> None:
        self.set_point, self.source = 0.0, "S"
        self.valves = ""
        """`HLD` or `EXH` if the valves are set by a command; else empty."""

    def measured(self, fault: str) -> tuple[float, frozenset[str]]:
        """Pressure and status, with the present fault."""
        pressure = self._plant.quantities()["pressure"]
        status = {self.valves} if self.valves else set()
        if fault in STATUS_FAULTS:
            status.add(STATUS_FAULTS[fault])
        if fault == "over" or not abs(pressure) <= FULL_SCALE:
            pressure = FULL_SCALE
            status.add("POV")
        return pressure / self._pascal, frozenset(status)

    def command(self, value: float) -> None:
        """Take a set-point; ignored unless the source is the serial line, and clipped to full scale."""
        with self._lock:
            taken = self.source == "S"
            si = min(max(value * self._pascal, 0.0), FULL_SCALE)
            names = [output.name for output in self.device.outputs] or ["pressure"]
            self._log.note("set", self.device.name, output=names[0], raw=value, si=si, connection=1, held=not taken)
            if taken:
                self.change_set_point(si / self._pascal)

    def restart(self) -> None:
        """Reset to power-on: set-point 0, no hold, commands over the line."""
        with self._lock:
            self._power_on()
            self._regulate()

    def change_set_point(self, value: float) -> None:
        """Another set-point, as if entered at its display."""
        with self._lock:
            self.set_point = value
            self._regulate()

    def set_valves(self, setting: str) -> None:
        """Set the valves to `EXH`, `HLD`, `closed` (also a hold), or back to control (empty)."""
        with self._lock:
            self._log.note("valves", self.device.name, setting=setting)
            self.valves = "HLD" if setting == "closed" else setting
            self._regulate()

    def _regulate(self) -> None:
        if self.valves == "EXH":
            self._plant.command(0.0)
        elif not self.valves:
            self._plant.command(max(self.set_point * self._pascal, 0.0))


class AsciiDevice(OnTerminal):
    """The controller on a pseudo-terminal, with one answer per request."""

    def __init__(self, controller: Controller, letter: str, log: f.CommandLog) -> None:
        self.controller, self._letter = controller, letter
        faults = f.Faults(f.LINK, f.STUCK, f.IGNORE, f.OVER, f.STATUS, f.RESTART, f.SETPOINT)
        super().__init__(controller.device, log, faults)
        self.restart, self.change_set_point = controller.restart, controller.change_set_point
        self._data = b""

    def change_held(self) -> bool:
        """Switch its set-point source to the analogue input, as if at its display; always possible."""
        self.controller.source = "A"
        return True

    def by_hand(self, _output: str, value: float) -> None:
        """Enter a set-point [its own unit] at its keys."""
        self.controller.command(value)

    def take(self, data: bytes) -> None:
        """Answer each complete request."""
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
        lines = self._lines(question[1:], fault.kind)
        answer = "".join(f"{self._letter} {line}\r" for line in lines) or "?\r"
        self.terminal.write(self.outgoing(answer.encode("ascii"), fault))

    def _lines(self, command: str, fault: str) -> list[str]:
        """Lines that answer a command, given in capitals, both without the unit ID; none: it is refused."""
        controller = self.controller
        word, *given = command.split() or [""]
        if word == "VE":
            return [f"  {FIRMWARE} Jan  9 2025,15:04:07"]
        if word == "??M*":
            return [f" {line}" for line in self._about()]
        if word == "??D*":
            return self._columns()
        if word == "LSS" and set(given) <= {"S", "A", "U"}:
            controller.source = (given or [controller.source])[0]
            return [controller.source]
        if word == "DCU":
            known = given in ([str(GAUGE)], [str(GAUGE_SET_POINT)])
            return [f"{UNITS[controller.options.unit][0]} {controller.options.unit}G"] if known else []
        if command in HOLDS:
            controller.set_valves(HOLDS[command])
        elif command.startswith("S"):
            try:
                value = float(command[1:])
            except ValueError:
                return []
            if not abs(value) < 1e9:
                return []
            if fault != "ignore":
                controller.command(value)
        elif command:
            return []
        pressure, status = controller.measured(fault)
        return [" ".join([self._number(pressure), self._number(controller.set_point), *sorted(status)])]

    def _number(self, value: float) -> str:
        return f"{value:+0{WIDTH}.{DECIMALS[self.controller.options.unit]}f}"

    def _about(self) -> list[str]:
        about = ["EMULATOR OF PMABENCH", "-", "-", "-", f"Model Number {self.controller.model}", "Serial Number 1"]
        about += ["Date Manufactured -", "Date Calibrated   -", "Calibrated By     -", f"Software Revision {FIRMWARE}"]
        return [f"M{number:02d} {text}" for number, text in enumerate(about)]

    def _columns(self) -> list[str]:
        unit = self.controller.options.unit
        pressure = "s decimal", f"{WIDTH}/{DECIMALS[unit]}", f"{UNITS[unit][0]:03d} 02 {unit}G"
        rows = [
            (700, "Unit ID", "string", "1", ""),
            (GAUGE, "Gauge Press", *pressure),
            (GAUGE_SET_POINT, "Gauge Press Setpt", *pressure),
            (701, "*Error", "string", "3", "ADC"),
            *((702, "*Status", "string", "3", code) for code in ("OPL", "POV", "OVR", "HLD", "EXH", "LCK")),
        ]
        return [
            HEAD,
            *(
                f"D{number:02d} {code:03d} {name:<26} {kind:<11} {size:>5} {notes}".rstrip()
                for number, (code, name, kind, size, notes) in enumerate(rows, 1)
            ),
        ]


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
