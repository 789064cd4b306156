"""An emulated Alicat PCD or MCD on a pseudo-terminal, over ASCII or Modbus RTU, in front of the simulated muscle.

Written apart from the driver: it shares with it the table of units only. It regulates by the simulated regulator and
keeps its set-point when nobody talks to it, as the real one does. A hold keeps what is commanded until it is cancelled.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Mapping
from math import copysign
from time import monotonic

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.alicat import emulated_commands as c
from pmabench_drivers.alicat.options import ASCII, MCD, UNITS, Options, read_options
from pmabench_drivers.emulator.faults import IGNORE, LINK, MODBUS, OVER, RESTART, SETPOINT, STATUS, STUCK, Faults
from pmabench_drivers.emulator.frames import ADDRESS, VALUE, Refused, Request, read_cells
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.modbus_server import RtuDevice
from pmabench_drivers.emulator.on_terminal import OnTerminal
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.shared.options import options_of

BITS = {"POV": 6, "HLD": 8, "ADC": 9, "EXH": 10, "OPL": 11}
STATUS_FAULTS = {"held": "HLD", "sensor": "ADC", "limit": "OPL"}
"""Fault of the control socket -> the status that it puts on."""
FILLS = 101325.0 / 60 / 0.1
"""How fast a flow of 1 SLPM fills 0.1 l, about a muscle with its tube [Pa/s]."""


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> AsciiDevice | RtuDevice:
    """The controller that a device of the driver `alicat` talks to."""
    options = options_of(device, read_options)
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
        self.model = plant.model(device.name)
        self._lock = threading.RLock()
        self._pascal = UNITS[options.unit][1]
        self.mixes: dict[int, str] = {}
        self._power_on()

    def _power_on(self) -> None:
        self.set_point = self.requested = 0.0
        """What the loop controls to now, and what it was sent; apart only during a ramp of its own."""
        self.source = "S"
        self.valves = ""
        """`HLD` or `EXH` where the valves are set by a command."""
        self.variable, self.locked = c.GAUGE, False
        self.gas_number, self._tared, self._filled, self._at = 0, 0.0, 0.0, monotonic()
        self.ramp, self.ramp_time, self.ramps = 0.0, 4, [True, True, False, False]
        self.registers = {85: 2, 21: 500, 22: 5000, 23: 1000}
        """Kind of the loop, then P, D and I; they change nothing here."""

    def measured(self, fault: str) -> tuple[float, frozenset[str]]:
        """Pressure and status, with the fault of the moment."""
        pressure = self._plant.quantities()["pressure"] - self._tared
        status = {self.valves} if self.valves else set()
        if fault in STATUS_FAULTS:
            status.add(STATUS_FAULTS[fault])
        if fault == "over" or not abs(pressure) <= c.FULL_SCALE:
            pressure = c.FULL_SCALE
            status.add("POV")
        return (pressure + (c.AIR if self.variable == c.ABSOLUTE else 0.0)) / self._pascal, frozenset(status)

    def command(self, value: float) -> None:
        """A set-point; it is ignored where the source is not the serial line, and clipped to the full scale."""
        with self._lock:
            taken = self.source == "S"
            if self.variable in {c.MASS, c.VOLUME}:
                wanted = min(max(value, 0.0), c.FULL_FLOW)
                self._log.note("flow", self.device.name, raw=value, connection=1, held=not taken)
            else:
                over = c.AIR if self.variable == c.ABSOLUTE else 0.0
                si = min(max(value * self._pascal - over, -over), c.FULL_SCALE)
                wanted = (si + over) / self._pascal
                names = [output.name for output in self.device.outputs] or ["pressure"]
                self._log.note("set", self.device.name, output=names[0], raw=value, si=si, connection=1, held=not taken)
            if taken:
                self.requested = wanted
                up, down, zero, _power = self.ramps
                ramped = self.ramp and (zero if not wanted else up if wanted > self.set_point else down)
                if not ramped:
                    self.set_point = wanted
                self._regulate()

    def advance(self) -> None:
        """What goes on by itself: a ramp of its own, and a flow that fills."""
        with self._lock:
            now = monotonic()
            passed, self._at = now - self._at, now
            if self.set_point != self.requested:
                step = self.ramp * c.PER_SECOND[self.ramp_time] * passed
                off = self.requested - self.set_point
                self.set_point = (
                    self.requested if abs(off) <= step or not step else self.set_point + copysign(step, off)
                )
                self._regulate()
            if self.variable in {c.MASS, c.VOLUME} and self.set_point > 0 and not self.valves:
                self._filled = min(self._filled + self.mass_flow() * FILLS * passed, c.FULL_SCALE)
                self._plant.command(self._filled)

    def mass_flow(self) -> float:
        """What flows in while a flow is controlled [SLPM]; while a pressure is, the muscle stands still here."""
        if self.variable not in {c.MASS, c.VOLUME} or self.valves or self._filled >= c.FULL_SCALE:
            return 0.0
        return self.set_point * (1 + self._filled / c.AIR) if self.variable == c.VOLUME else self.set_point

    def volume_flow(self) -> float:
        """The same at the pressure of the moment [LPM]."""
        return self.mass_flow() / (1 + self._filled / c.AIR)

    @property
    def gas(self) -> str:
        """The name of the gas for which flows are shown."""
        return self.mixes.get(self.gas_number) or c.GASES[self.gas_number % len(c.GASES)]

    def choose_gas(self, number: int) -> bool:
        """Another gas; whether there is one."""
        known = number < len(c.GASES) or number in self.mixes
        self.gas_number = number if known else self.gas_number
        return known

    def choose(self, variable: int) -> bool:
        """Another variable of the loop, from set-point 0 on; whether it can be."""
        with self._lock:
            known = {c.GAUGE, c.ABSOLUTE, c.MASS, c.VOLUME} if self.options.emulate == MCD else {c.GAUGE}
            if variable in known and variable != self.variable:
                self.variable, self.set_point, self.requested = variable, 0.0, 0.0
                self._filled = min(max(self._plant.quantities()["pressure"], 0.0), c.FULL_SCALE)
                self._regulate()
            return variable in known

    def tare(self, command: str) -> None:
        """The pressure of this moment becomes the zero of gauge pressure (`P`); flows have none here."""
        if command == "P":
            self._tared = self._plant.quantities()["pressure"]

    def restart(self) -> None:
        """As after power-on: set-point 0, no hold, commands over the line."""
        with self._lock:
            self._power_on()
            self._regulate()

    def change_set_point(self, value: float) -> None:
        """Another set-point, entered at its display."""
        with self._lock:
            self.set_point = self.requested = value
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
        elif not self.valves and self.variable in {c.MASS, c.VOLUME}:
            self._plant.command(self._filled)
        elif not self.valves:
            over = c.AIR if self.variable == c.ABSOLUTE else 0.0
            self._plant.command(max(self.set_point * self._pascal - over, 0.0))


class AsciiDevice(OnTerminal):
    """The controller on a pseudo-terminal, one answer to one question."""

    def __init__(self, controller: Controller, letter: str, log: CommandLog) -> None:
        self.controller, self._letter, self._commands = controller, letter, c.Commands(controller, letter)
        super().__init__(controller.device, log, Faults(LINK, STUCK, IGNORE, OVER, STATUS, RESTART, SETPOINT))
        self._data = b""

    def restart(self) -> None:
        """As after power-on; the line stays."""
        self.controller.restart()

    def change_set_point(self, value: float) -> None:
        """Another set-point, entered at its display."""
        self.controller.change_set_point(value)

    def change_held(self) -> bool:
        """The analogue input gives its set-point from now on, as chosen at its display; always possible."""
        self.controller.source = "A"
        return True

    def by_hand(self, _output: str, value: float) -> None:
        """A set-point [its own unit] from its keys."""
        self.controller.command(value)

    def wait(self) -> float:
        """Often enough for its own ramps."""
        return 0.02

    def take(self, data: bytes) -> None:
        """Answer each question."""
        self.controller.advance()
        *lines, rest = (self._data + data)[-200:].split(b"\r")
        self._data = rest
        for line in lines:
            self._answer(line.decode("ascii", "replace").strip().upper())

    def _answer(self, question: str) -> None:
        """Carry out and answer with the fault of the moment."""
        if question[:1] != self._letter:
            return
        fault = self.next_fault()
        if fault.kind == "silence":
            return
        lines = self._commands.answer(question[1:], fault.kind)
        answer = "".join(f"{line}\r" for line in lines).encode("ascii")
        self.terminal.write(self.outgoing(answer, fault))


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
