"""An emulated Alicat PCD on a pseudo-terminal, over ASCII or Modbus RTU, in front of the simulated muscle.

Written apart from the driver: it shares with it the table of units only. It regulates by the simulated regulator and
keeps its set-point when nobody talks to it, as the real one does. A hold keeps what is commanded until it is cancelled.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Mapping

from pmabench.bench.interface import EMULATED, DeviceRecord
from pmabench_drivers.alicat.options import ASCII, UNITS, Options, read_options
from pmabench_drivers.emulator.faults import (
    IGNORE,
    LINK,
    MODBUS,
    OVER,
    RESTART,
    SETPOINT,
    STATUS,
    STUCK,
    Faults,
    Outgoing,
)
from pmabench_drivers.emulator.frames import ADDRESS, VALUE, Refused, Request
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.modbus_server import RtuDevice
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import Terminal
from pmabench_drivers.options import Reader

FULL_SCALE = 1.0e6
"""Highest pressure that it measures and regulates [Pa]."""
WIDTH = 8
DECIMALS = {"Pa": 0, "hPa": 1, "mbar": 1, "kPa": 2, "psi": 3, "bar": 4, "atm": 4, "MPa": 5}
BITS = {"POV": 6, "HLD": 8, "ADC": 9, "EXH": 10, "OPL": 11}
STATUS_FAULTS = {"held": "HLD", "sensor": "ADC", "limit": "OPL"}
"""Fault of the control socket -> the status that it puts on."""
HEAD = "D00 ID_ NAME______________________ TYPE_______ WIDTH NOTES___________________"


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> AsciiDevice | RtuDevice:
    """The controller that a device of the driver `alicat` talks to."""
    reader = Reader()
    options = read_options(device, reader)
    reader.refuse(device.name)
    controller = Controller(device, options, plant, log)
    if options.protocol == ASCII:
        return AsciiDevice(controller, options.letter, log)
    cells = ModbusCells(controller)
    served = RtuDevice(cells, options.number, log, device.address)
    served.faults = Faults(LINK, STUCK, MODBUS, OVER, STATUS, RESTART, SETPOINT)
    cells.faults = served.faults
    return served


class Controller:
    """What the device does, whoever asks over which protocol; pressures in its own unit."""

    def __init__(self, device: DeviceRecord, options: Options, plant: RealPlant, log: CommandLog) -> None:
        self.device, self.options, self._plant, self._log = device, options, plant, log
        self.set_point = 0.0
        self.source = "S"
        self.valves = ""
        """`HLD` or `EXH` where the valves are set by a command."""
        self._lock = threading.Lock()
        self._pascal = UNITS[options.unit][1]

    def measured(self, fault: str) -> tuple[float, frozenset[str]]:
        """Pressure and status, with the fault of the moment."""
        pressure = self._plant.quantities()["pressure"]
        status = {self.valves} if self.valves else set()
        if fault in STATUS_FAULTS:
            status.add(STATUS_FAULTS[fault])
        if fault == "over" or not abs(pressure) <= FULL_SCALE:
            pressure = FULL_SCALE
            status.add("POV")
        return pressure / self._pascal, frozenset(status)

    def command(self, value: float) -> None:
        """A set-point; it is ignored where the source is not the serial line, and clipped to the full scale."""
        with self._lock:
            si = min(max(value * self._pascal, 0.0), FULL_SCALE)
            taken = self.source == "S"
            names = [output.name for output in self.device.outputs] or ["pressure"]
            self._log.note("set", self.device.name, output=names[0], raw=value, si=si, connection=1, held=not taken)
            if taken:
                self.set_point = si / self._pascal
                self._regulate()

    def restart(self) -> None:
        """As after power-on: set-point 0, no hold, commands over the line."""
        with self._lock:
            self.set_point, self.source, self.valves = 0.0, "S", ""
            self._regulate()

    def change_set_point(self, value: float) -> None:
        """Another set-point, entered at its display."""
        with self._lock:
            self.set_point = value
            self._regulate()

    def set_valves(self, setting: str) -> None:
        """`EXH`, `HLD`, `closed` (also a hold), or nothing for what the set-point says."""
        with self._lock:
            self._log.note("valves", self.device.name, setting=setting)
            self.valves = "HLD" if setting == "closed" else setting
            self._regulate()

    def _regulate(self) -> None:
        if self.valves == "EXH":
            self._plant.command(0.0)
        elif not self.valves:
            self._plant.command(self.set_point * self._pascal)


class AsciiDevice:
    """The controller on a pseudo-terminal, one answer to one question."""

    def __init__(self, controller: Controller, letter: str, log: CommandLog) -> None:
        self.controller, self._letter = controller, letter
        self.address, self.faults = (
            controller.device.address,
            Faults(LINK, STUCK, IGNORE, OVER, STATUS, RESTART, SETPOINT),
        )
        self._terminal, self._outgoing = Terminal(self.address, log.tap(controller.device.name)), Outgoing()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"emulated {controller.device.name}", daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def restart(self) -> None:
        """As after power-on; the line stays."""
        self.controller.restart()

    def change_set_point(self, value: float) -> None:
        """Another set-point, entered at its display."""
        self.controller.change_set_point(value)

    def close(self) -> None:
        """Hang up."""
        self._ended.set()
        self._terminal.close()

    def _serve(self) -> None:
        data = b""
        while not self._ended.is_set():
            received = self._terminal.read(0.05)
            if received is None:
                return
            data = (data + received)[-200:]
            while b"\r" in data:
                line, data = data.split(b"\r", 1)
                try:
                    if not self._answer(line.decode("ascii", "replace").strip().upper()):
                        return
                except OSError:
                    return

    def _answer(self, question: str) -> bool:
        """Carry out and answer with the fault of the moment; whether there is anybody to talk to."""
        if question[:1] != self._letter:
            return True
        fault = self.faults.next()
        if fault.kind in {"hang-up", "reset"}:
            self._terminal.close()
            return False
        if fault.kind == "silence":
            return True
        lines = self._lines(question[1:], fault.kind)
        answer = "".join(f"{line}\r" for line in lines).encode("ascii")
        self._terminal.write(self._outgoing.of(answer, fault))
        return True

    def _lines(self, command: str, fault: str) -> list[str]:
        head = self._letter
        simple = {"HC": "closed", "HP": "HLD", "C": ""}
        if command == "VE":
            return [f"{head}   10v20.0-R24 Jan  9 2025,15:04:07"]
        if command == "??M*":
            return [f"{head}  {line}" for line in self._about()]
        if command == "??D*":
            return [f"{head} {line}" for line in self._columns()]
        if command == "LSS":
            return [f"{head} {self.controller.source}"]
        if command in simple:
            self.controller.set_valves(simple[command])
        elif command.startswith("S"):
            try:
                value = float(command[1:])
            except ValueError:
                return ["?"]
            if fault != "ignore":
                self.controller.command(value)
        elif command:
            return ["?"]
        return [self._frame(fault)]

    def _frame(self, fault: str) -> str:
        pressure, status = self.controller.measured(fault)
        decimals = DECIMALS[self.controller.options.unit]
        numbers = (f"{value:+0{WIDTH}.{decimals}f}" for value in (pressure, self.controller.set_point))
        return " ".join([self._letter, *numbers, *sorted(status)])

    def _about(self) -> list[str]:
        name = self.controller.device.name
        return [
            "M00 EMULATOR OF PMABENCH",
            "M01 -",
            "M02 -",
            "M03 -",
            f"M04 Model Number {EMULATED}{name}",
            "M05 Serial Number 1",
            "M06 Date Manufactured -",
            "M07 Date Calibrated   -",
            "M08 Calibrated By     -",
            "M09 Software Revision 10v20.0-R24",
        ]

    def _columns(self) -> list[str]:
        unit = self.controller.options.unit
        note, width = f"{UNITS[unit][0]:03d} 02 {unit}G", f"{WIDTH}/{DECIMALS[unit]}"
        rows = [
            ("700", "Unit ID", "string", "1", ""),
            ("006", "Gauge Press", "s decimal", width, note),
            ("038", "Gauge Press Setpt", "s decimal", width, note),
            ("701", "*Error", "string", "3", "ADC"),
            *(("702", "*Status", "string", "3", code) for code in ("OPL", "POV", "OVR", "HLD", "EXH", "LCK")),
        ]
        return [
            HEAD,
            *(
                f"D{number:02d} {code} {name:<26} {kind:<11} {size:>5} {notes}".rstrip()
                for number, (code, name, kind, size, notes) in enumerate(rows, 1)
            ),
        ]


class ModbusCells:
    """The controller's registers, as on the wire; only function 16 writes, and 3 and 4 read the same."""

    def __init__(self, controller: Controller) -> None:
        self.device, self.controller, self.faults = controller.device, controller, Faults()
        self._command = (0, 0)

    def look_at_watchdog(self) -> None:
        """It has none: silence changes nothing."""

    def restart(self) -> None:
        """As after power-on; the line stays."""
        self._command = (0, 0)
        self.controller.restart()

    def change_set_point(self, value: float) -> bool:
        """Another set-point, entered at its display."""
        self.controller.change_set_point(value)
        return True

    def carry_out(self, request: Request, connection: int, *, ignore: bool = False) -> list[int]:
        """What is read, or nothing; `Refused` where the device says no."""
        wanted = range(request.address, request.address + request.count)
        if request.values:
            if request.function != 16:
                raise Refused(1)
            self._write(request, ignore=ignore)
            return []
        if request.function not in {3, 4}:
            raise Refused(1)
        cells = self._cells()
        if any(address not in cells for address in wanted):
            raise Refused(ADDRESS)
        return [cells[address] for address in wanted]

    def _cells(self) -> Mapping[int, int]:
        pressure, status = self.controller.measured(self.faults.peek().kind)
        flags = sum(1 << BITS[code] for code in status)
        text = f"{EMULATED}{self.device.name}".encode("ascii", "replace")[:32].ljust(32, b"\0")
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
