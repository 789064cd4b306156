"""State and behaviour of an emulated Alicat controller, and its answers to each ASCII command; uses no connection.

A pressure controller (PCD), or a mass flow controller with two valves whose loop controls gauge pressure until another
variable is chosen (MCD): it has temperature, flows and a gas in its line. Sources: Alicat, Serial Communications
Primer, 02/2023 (commands, statistics, firmware versions that support them); answers of controllers with firmware 10v20
to `??D*`, `LS`, `LV`, `DCU`, `FPF`, `DV`, `??G*`: recorded from real devices by the project alicatlib (tests/fixtures,
2026-04-17); registers 21 to 23, 46, 85 and 122, and `$$` before a command: as used by the package alicat 0.9.0.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from math import copysign
from time import monotonic

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.alicat import MCD, UNITS, Options
from pmabench_drivers.emulator.faults import CommandLog
from pmabench_drivers.emulator.plant import RealPlant

FULL_SCALE = 1.0e6
"""Highest pressure that it measures and controls [Pa]."""
FULL_FLOW = 100.0
"""Highest flow [SLPM]."""
AIR = 101325.0
"""Atmospheric pressure [Pa]."""
ABSOLUTE, GAUGE, VOLUME, MASS = 34, 38, 36, 37
"""Controlled variables of the loop, as statistics."""
GASES = (
    *("Air", "Ar", "CH4", "CO", "CO2", "C2H6", "H2", "He", "N2", "N2O", "Ne", "O2", "C3H8", "n-C4H10", "C2H2"),
    *("C2H4", "i-C2H10", "Kr", "Xe", "SF6", "C-25", "C-10", "C-8", "C-2", "C-75", "A-75", "A-25", "A1025"),
    *("Star29", "P-5"),
)
PER_SECOND = {3: 1e3, 4: 1.0, 5: 1 / 60, 6: 1 / 3600, 7: 1 / 86400}
"""Code of a ramp's time unit -> that unit in 1/s."""
STATUS_FAULTS = {"held": "HLD", "sensor": "ADC", "limit": "OPL"}
"""Fault of the control socket -> status code that it sets."""
FILLS = 101325.0 / 60 / 0.1
"""Pressure rise by a flow of 1 SLPM into 0.1 l, about a muscle with its tube [Pa/s]."""


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
        """Present set-point of the loop, and the requested one; they differ only during its own ramp."""
        self.source = "S"
        self.valves = ""
        """`HLD` or `EXH` if the valves are set by a command; else empty."""
        self.variable, self.locked = GAUGE, False
        self.gas_number, self._tared, self._filled, self._at = 0, 0.0, 0.0, monotonic()
        self.ramp, self.ramp_time, self.ramps = 0.0, 4, [True, True, False, False]
        self.registers = {85: 2, 21: 500, 22: 5000, 23: 1000}
        """Type of the loop, then P, D and I; without effect here."""

    def measured(self, fault: str) -> tuple[float, frozenset[str]]:
        """Pressure and status, with the present fault."""
        pressure = self._plant.quantities()["pressure"] - self._tared
        status = {self.valves} if self.valves else set()
        if fault in STATUS_FAULTS:
            status.add(STATUS_FAULTS[fault])
        if fault == "over" or not abs(pressure) <= FULL_SCALE:
            pressure = FULL_SCALE
            status.add("POV")
        return (pressure + (AIR if self.variable == ABSOLUTE else 0.0)) / self._pascal, frozenset(status)

    def command(self, value: float) -> None:
        """Take a set-point; ignored unless the source is the serial line, and clipped to full scale."""
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
        """Advance to the present: its own ramp, and a flow that fills the muscle."""
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
        """Inflow while a flow is controlled [SLPM]; 0 while a pressure is, as the muscle does not move here."""
        if self.variable not in {MASS, VOLUME} or self.valves or self._filled >= FULL_SCALE:
            return 0.0
        return self.set_point * (1 + self._filled / AIR) if self.variable == VOLUME else self.set_point

    def volume_flow(self) -> float:
        """The same at the present pressure [LPM]."""
        return self.mass_flow() / (1 + self._filled / AIR)

    @property
    def gas(self) -> str:
        """Name of the gas for which flows are shown."""
        return self.mixes.get(self.gas_number) or GASES[self.gas_number % len(GASES)]

    def choose_gas(self, number: int) -> bool:
        """Choose another gas; returns whether it exists."""
        known = number < len(GASES) or number in self.mixes
        self.gas_number = number if known else self.gas_number
        return known

    def choose(self, variable: int) -> bool:
        """Choose another controlled variable, with set-point 0; returns whether that is possible."""
        with self._lock:
            known = {GAUGE, ABSOLUTE, MASS, VOLUME} if self.options.emulate == MCD else {GAUGE}
            if variable in known and variable != self.variable:
                self.variable, self.set_point, self.requested = variable, 0.0, 0.0
                self._filled = min(max(self._plant.quantities()["pressure"], 0.0), FULL_SCALE)
                self._regulate()
            return variable in known

    def tare(self, command: str) -> None:
        """Make the present pressure the zero of gauge pressure (`P`); flows have no offset here."""
        if command == "P":
            self._tared = self._plant.quantities()["pressure"]

    def restart(self) -> None:
        """Reset to power-on: set-point 0, no hold, commands over the line."""
        with self._lock:
            self._power_on()
            self._regulate()

    def change_set_point(self, value: float) -> None:
        """Another set-point, as if entered at its display."""
        with self._lock:
            self.set_point = self.requested = value
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
        elif not self.valves and self.variable in {MASS, VOLUME}:
            self._plant.command(self._filled)
        elif not self.valves:
            over = AIR if self.variable == ABSOLUTE else 0.0
            self._plant.command(max(self.set_point * self._pascal - over, 0.0))


TEMPERATURE = 23.5
WIDTH = 8
DECIMALS = {"Pa": 0, "hPa": 1, "mbar": 1, "kPa": 2, "psi": 3, "bar": 4, "atm": 4, "MPa": 5}
HEAD = "D00 ID_ NAME______________________ TYPE_______ WIDTH NOTES___________________"
FIRMWARE = "10v20.0-R24"
NAMES = {ABSOLUTE: "Abs Press", GAUGE: "Gauge Press", VOLUME: "Volu Flow", MASS: "Mass Flow"}
MIXES = range(236, 256)
TIMES = {3: "ms", 4: "s", 5: "m", 6: "h", 7: "d"}
NO_STATISTIC = "1 ---"

Lines = list[str]
FLOW = {VOLUME: ("7/2", "007 02 LPM"), MASS: ("7/2", "007 02 SLPM")}
"""Width and unit of flows in the list of columns."""


class Commands:
    """Answers of one controller with a unit ID."""

    def __init__(self, controller: Controller, letter: str) -> None:
        self._controller, self._letter = controller, letter
        self._named: dict[str, Callable[[list[str], str], Lines]] = {
            "VE": lambda _given, _fault: self._said(f"  {FIRMWARE} Jan  9 2025,15:04:07"),
            "??M*": lambda _given, _fault: [f"{letter}  {line}" for line in self._about()],
            "??D*": lambda _given, _fault: [f"{letter} {line}" for line in self._columns()],
            "??G*": lambda _given, _fault: [f"{letter} G{i:02d} {name:>8}" for i, name in enumerate(GASES)],
            "LSS": self._source,
            "LV": self._variable,
            "LS": self._set_point,
            "DCU": self._unit,
            "FPF": self._full_scale,
            "DV": self._values,
            "SR": self._ramp,
            "LSRC": self._ramps,
            "GM": self._mix,
            "GS": self._gas,
        }

    def answer(self, command: str, fault: str) -> Lines:
        """Lines that answer a command, given in capitals without its unit ID."""
        controller, command = self._controller, command.removeprefix("$$")
        word, *given = command.split() or [""]
        if word in self._named:
            return self._named[word](given, fault)
        holds = {"HC": "closed", "HP": "HLD", "H": "HLD", "C": ""}
        if command in holds:
            controller.set_valves(holds[command])
        elif command in {"L", "U"}:
            controller.locked = command == "L"
        elif command in {"P", "PC", "V", "T"}:
            controller.tare(command)
        elif command[:1] in {"R", "W"} and command[1:2].isdigit():
            return self._register(command)
        elif command.startswith("GD"):
            return self._forget_mix(command[2:])
        elif command[:1] == "G" and command[1:].strip().isdigit():
            return self._gas([command[1:].strip()], fault)
        elif command[:1] == "S":
            if (value := _number(command[1:])) is None:
                return ["?"]
            if fault != "ignore":
                controller.command(value)
        elif command:
            return ["?"]
        return [self.frame(fault)]

    def _said(self, text: str) -> Lines:
        return [f"{self._letter} {text}"]

    # -- the data line ----------------------------------------------------------------------------------------------

    def frame(self, fault: str) -> str:
        """Present data line."""
        controller = self._controller
        pressure, status = controller.measured(fault)
        codes = sorted(status | ({"LCK"} if controller.locked else set()))
        shown = [self._pressure(pressure), self._target(controller.set_point)]
        if controller.options.emulate == MCD:
            flows = [_flow(TEMPERATURE), _flow(controller.volume_flow()), _flow(controller.mass_flow())]
            shown = [shown[0], *flows, shown[1], f"{controller.gas:>6}"]
        return " ".join([self._letter, *shown, *codes])

    def _pressure(self, value: float) -> str:
        return f"{value:+0{WIDTH}.{DECIMALS[self._controller.options.unit]}f}"

    def _target(self, value: float) -> str:
        """Text of a set-point: of a pressure, or of a flow."""
        return self._pressure(value) if self._controller.variable in {ABSOLUTE, GAUGE} else _flow(value)

    def _about(self) -> Lines:
        about = ["EMULATOR OF PMABENCH", "-", "-", "-", f"Model Number {self._controller.model}", "Serial Number 1"]
        about += ["Date Manufactured -", "Date Calibrated   -", "Calibrated By     -", f"Software Revision {FIRMWARE}"]
        return [f"M{number:02d} {text}" for number, text in enumerate(about)]

    def _columns(self) -> Lines:
        controller = self._controller
        unit, variable = controller.options.unit, controller.variable
        absolute = variable == ABSOLUTE
        note, width = f"{UNITS[unit][0]:03d} 02 {self._label(absolute)}", f"{WIDTH}/{DECIMALS[unit]}"
        of_pressure = variable in {ABSOLUTE, GAUGE}
        target = (
            f"{variable:03d}",
            f"{NAMES[variable]} Setpt",
            "s decimal",
            *((width, note) if of_pressure else FLOW[variable]),
        )
        first = ("002", "Abs Press") if absolute else ("006", "Gauge Press")
        rows = [("700", "Unit ID", "string", "1", ""), (*first, "s decimal", width, note)]
        if controller.options.emulate == MCD:
            rows += [
                ("003", "Flow Temp", "s decimal", "7/2", "002 02 `C"),
                ("004", "Volu Flow", "s decimal", *FLOW[VOLUME]),
                ("005", "Mass Flow", "s decimal", *FLOW[MASS]),
                target,
                ("703", "Gas", "string", "6", ""),
            ]
        else:
            rows.append(target)
        rows.append(("701", "*Error", "string", "3", "ADC"))
        rows += [("702", "*Status", "string", "3", code) for code in ("OPL", "POV", "OVR", "HLD", "EXH", "LCK")]
        return [
            HEAD,
            *(
                f"D{number:02d} {code} {name:<26} {kind:<11} {size:>5} {notes}".rstrip()
                for number, (code, name, kind, size, notes) in enumerate(rows, 1)
            ),
        ]

    def _label(self, absolute: bool) -> str:
        return f"{self._controller.options.unit}{'A' if absolute else 'G'}"

    # -- requests and settings --------------------------------------------------------------------------------------

    def _source(self, given: list[str], _fault: str) -> Lines:
        if given and given[0] in {"S", "A", "U"}:
            self._controller.source = given[0]
        elif given:
            return ["?"]
        return self._said(self._controller.source)

    def _variable(self, given: list[str], _fault: str) -> Lines:
        if given and not (given[0].isdigit() and self._controller.choose(int(given[0]))):
            return ["?"]
        return self._said(str(self._controller.variable))

    def _set_point(self, given: list[str], fault: str) -> Lines:
        controller = self._controller
        if given:
            if (value := _number(given[0])) is None:
                return ["?"]
            if fault != "ignore":
                controller.command(value)
        now, wanted = self._target(controller.set_point), self._target(controller.requested)
        return self._said(f"{now} {wanted} {self._unit_of(controller.variable)}")

    def _unit_of(self, statistic: int) -> str:
        """Code and name of the unit of a statistic."""
        code = UNITS[self._controller.options.unit][0]
        if statistic in {6, GAUGE}:
            return f"{code} {self._label(absolute=False)}"
        flow = self._controller.options.emulate == MCD
        if flow and statistic in {2, ABSOLUTE}:
            return f"{code} {self._label(absolute=True)}"
        known = {3: "2 `C", 4: "7 LPM", VOLUME: "7 LPM", 5: "7 SLPM", MASS: "7 SLPM"}
        return known.get(statistic, NO_STATISTIC) if flow else NO_STATISTIC

    def _unit(self, given: list[str], _fault: str) -> Lines:
        """Unit of a statistic; it cannot be changed here, as every number on the line would change."""
        given = given or [str(self._controller.variable)]
        if not given[0].isdigit():
            return ["?"]
        unit = self._unit_of(int(given[0]))
        return ["?"] if len(given) > 1 and given[-1] != unit.split()[0] else self._said(unit)

    def _full_scale(self, given: list[str], _fault: str) -> Lines:
        given = given or [str(self._controller.variable)]
        if not given[0].isdigit():
            return ["?"]
        statistic, pascal = int(given[0]), UNITS[self._controller.options.unit][1]
        unit = self._unit_of(statistic)
        if unit == NO_STATISTIC or statistic == 3:
            return self._said(NO_STATISTIC)
        over = AIR if statistic in {2, ABSOLUTE} else 0.0
        of_pressure = statistic in {2, 6, ABSOLUTE, GAUGE}
        value = self._pressure((FULL_SCALE + over) / pascal) if of_pressure else _flow(FULL_FLOW)
        return self._said(f"{value} {unit}")

    def _values(self, given: list[str], fault: str) -> Lines:
        """Statistics over a time [ms]: the only answer without a unit ID."""
        numbers = [int(text) for text in given if text.isdigit()]
        if len(numbers) != len(given) or len(numbers) < 2 or not numbers[0]:
            return ["?"]
        controller = self._controller
        pressure, _status = controller.measured(fault)
        over = AIR / UNITS[controller.options.unit][1]
        gauge = pressure - over if controller.variable == ABSOLUTE else pressure
        known = {6: self._pressure(gauge), controller.variable: self._set_point([], fault)[0].split()[1]}
        if controller.options.emulate == MCD:
            known |= {2: self._pressure(gauge + over), 3: _flow(TEMPERATURE)}
            known |= {4: _flow(controller.volume_flow()), 5: _flow(controller.mass_flow())}
        return [" ".join(known.get(number, "--") for number in numbers[1:])]

    def _ramp(self, given: list[str], _fault: str) -> Lines:
        """Steepest ramp of the set-point: step and time unit; 0: no ramp."""
        controller = self._controller
        if given:
            value = _number(given[0])
            if value is None or value < 0 or len(given) < 2 or given[1] not in {str(unit) for unit in TIMES}:
                return ["?"]
            controller.ramp, controller.ramp_time = value, int(given[1])
        code, label = self._unit_of(controller.variable).split()
        return self._said(f"{controller.ramp:.7f} {code} {controller.ramp_time} {label}/{TIMES[controller.ramp_time]}")

    def _ramps(self, given: list[str], _fault: str) -> Lines:
        """Which changes are ramped: up, down, to zero, at power-on."""
        if given and (len(given) != 4 or not set(given) <= {"0", "1"}):
            return ["?"]
        if given:
            self._controller.ramps = [text == "1" for text in given]
        return self._said(" ".join(str(int(flag)) for flag in self._controller.ramps))

    def _register(self, command: str) -> Lines:
        """`R122`, or `W122=37`: the answer is the value then held."""
        number, equals, value = command[1:].partition("=")
        registers, controller = self._controller.registers, self._controller
        if not number.isdigit() or (command[0] == "W") != bool(equals) or (equals and not value.isdigit()):
            return ["?"]
        if number == "122":
            if equals:
                controller.choose(int(value))
            return self._said(f"  122 = {controller.variable}")
        if number == "46" and controller.options.emulate == MCD:
            if equals:
                controller.choose_gas(int(value))
            return self._said(f"  046 = {controller.gas_number}")
        if int(number) not in registers:
            return ["?"]
        if equals:
            registers[int(number)] = int(value)
        return self._said(f"  {int(number):03d} = {registers[int(number)]}")

    def _gas(self, given: list[str], fault: str) -> Lines:
        controller = self._controller
        if controller.options.emulate != MCD or (
            given and not (given[0].isdigit() and controller.choose_gas(int(given[0])))
        ):
            return ["?"]
        return self._said(f"{controller.gas_number} {controller.gas} {controller.gas}")

    def _mix(self, given: list[str], _fault: str) -> Lines:
        """Define a mix: name, number (0: the next free one), then pairs of percentage and gas."""
        controller = self._controller
        numbers = [_number(text) for text in given[1:]]
        if controller.options.emulate != MCD or len(given) < 6 or len(given) % 2 or None in numbers:
            return ["?"]
        place, parts = int(numbers[0] or MIXES[0]), [value or 0.0 for value in numbers[1:]]
        gases = [int(value) for value in parts[1::2]]
        if place not in MIXES or abs(sum(parts[::2]) - 100.0) > 0.01 or not all(0 <= gas < len(GASES) for gas in gases):
            return ["?"]
        controller.mixes[place] = given[0][:6]
        shares = " ".join(f"{share:.2f}% {GASES[gas]}" for share, gas in zip(parts[::2], gases, strict=True))
        return self._said(f"{place} {given[0][:6]} {shares}")

    def _forget_mix(self, text: str) -> Lines:
        number = int(text) if text.strip().isdigit() else 0
        return ["?"] if self._controller.mixes.pop(number, None) is None else self._said(str(number))


def _flow(value: float) -> str:
    """Text of a flow or a temperature."""
    return f"{value:+07.2f}"


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < 1e9 else None
