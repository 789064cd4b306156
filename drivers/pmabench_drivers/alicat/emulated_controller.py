"""State and behaviour of an emulated Alicat controller, the same for ASCII and Modbus; knows no wire."""

from __future__ import annotations

import threading
from math import copysign
from time import monotonic

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.alicat.options import MCD, UNITS, Options
from pmabench_drivers.emulator.faults import CommandLog
from pmabench_drivers.emulator.plant import RealPlant

FULL_SCALE = 1.0e6
"""Highest pressure that it measures and regulates [Pa]."""
FULL_FLOW = 100.0
"""Highest flow [SLPM]."""
AIR = 101325.0
"""Of the open air [Pa]."""
ABSOLUTE, GAUGE, VOLUME, MASS = 34, 38, 36, 37
"""Variables of the loop by their statistics."""
GASES = (
    *("Air", "Ar", "CH4", "CO", "CO2", "C2H6", "H2", "He", "N2", "N2O", "Ne", "O2", "C3H8", "n-C4H10", "C2H2"),
    *("C2H4", "i-C2H10", "Kr", "Xe", "SF6", "C-25", "C-10", "C-8", "C-2", "C-75", "A-75", "A-25", "A1025"),
    *("Star29", "P-5"),
)
PER_SECOND = {3: 1e3, 4: 1.0, 5: 1 / 60, 6: 1 / 3600, 7: 1 / 86400}
"""Code of the unit of time of a ramp -> how often that unit fits into a second."""
STATUS_FAULTS = {"held": "HLD", "sensor": "ADC", "limit": "OPL"}
"""Fault of the control socket -> the status that it puts on."""
FILLS = 101325.0 / 60 / 0.1
"""How fast a flow of 1 SLPM fills 0.1 l, about a muscle with its tube [Pa/s]."""


class Controller:
    """The emulated device; pressures in its own unit."""

    def __init__(self, device: DeviceRecord, options: Options, plant: RealPlant, log: CommandLog) -> None:
        self.device, self.options, self._plant, self._log = device, options, plant, log
        self.model = plant.model(device.name)
        self._lock = threading.RLock()
        self._pascal = UNITS[options.unit][1]
        self.mixes: dict[int, str] = {}
        self._power_on()

    def _power_on(self) -> None:
        self.set_point = self.requested = 0.0
        """What the loop controls to now, and what it was sent; different only during its own ramp."""
        self.source = "S"
        self.valves = ""
        """`HLD` or `EXH` where the valves are set by a command."""
        self.variable, self.locked = GAUGE, False
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
        if fault == "over" or not abs(pressure) <= FULL_SCALE:
            pressure = FULL_SCALE
            status.add("POV")
        return (pressure + (AIR if self.variable == ABSOLUTE else 0.0)) / self._pascal, frozenset(status)

    def command(self, value: float) -> None:
        """A set-point; it is ignored where the source is not the serial line, and clipped to the full scale."""
        with self._lock:
            taken = self.source == "S"
            if self.variable in {MASS, VOLUME}:
                wanted = min(max(value, 0.0), FULL_FLOW)
                self._log.note("flow", self.device.name, raw=value, connection=1, held=not taken)
            else:
                over = AIR if self.variable == ABSOLUTE else 0.0
                si = min(max(value * self._pascal - over, -over), FULL_SCALE)
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
        """Bring it to the present: its own ramp, and a flow that fills the muscle."""
        with self._lock:
            now = monotonic()
            passed, self._at = now - self._at, now
            if self.set_point != self.requested:
                step = self.ramp * PER_SECOND[self.ramp_time] * passed
                off = self.requested - self.set_point
                self.set_point = (
                    self.requested if abs(off) <= step or not step else self.set_point + copysign(step, off)
                )
                self._regulate()
            if self.variable in {MASS, VOLUME} and self.set_point > 0 and not self.valves:
                self._filled = min(self._filled + self.mass_flow() * FILLS * passed, FULL_SCALE)
                self._plant.command(self._filled)

    def mass_flow(self) -> float:
        """What flows in while a flow is controlled [SLPM]; while a pressure is, the muscle does not move here."""
        if self.variable not in {MASS, VOLUME} or self.valves or self._filled >= FULL_SCALE:
            return 0.0
        return self.set_point * (1 + self._filled / AIR) if self.variable == VOLUME else self.set_point

    def volume_flow(self) -> float:
        """The same at the pressure of the moment [LPM]."""
        return self.mass_flow() / (1 + self._filled / AIR)

    @property
    def gas(self) -> str:
        """The name of the gas for which flows are shown."""
        return self.mixes.get(self.gas_number) or GASES[self.gas_number % len(GASES)]

    def choose_gas(self, number: int) -> bool:
        """Another gas; whether there is one."""
        known = number < len(GASES) or number in self.mixes
        self.gas_number = number if known else self.gas_number
        return known

    def choose(self, variable: int) -> bool:
        """Another variable of the loop, from set-point 0 on; whether it can be."""
        with self._lock:
            known = {GAUGE, ABSOLUTE, MASS, VOLUME} if self.options.emulate == MCD else {GAUGE}
            if variable in known and variable != self.variable:
                self.variable, self.set_point, self.requested = variable, 0.0, 0.0
                self._filled = min(max(self._plant.quantities()["pressure"], 0.0), FULL_SCALE)
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
        elif not self.valves and self.variable in {MASS, VOLUME}:
            self._plant.command(self._filled)
        elif not self.valves:
            over = AIR if self.variable == ABSOLUTE else 0.0
            self._plant.command(max(self.set_point * self._pascal - over, 0.0))
