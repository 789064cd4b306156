"""An emulated board on a pseudo-terminal: the protocol of the sketch, on the plant, with faults.

`delay`, `silence`, `lost`, `truncated`, `garbage`, `double` act on lines; `hang-up` and `reset` are those of the
line and of the board.
"""

from __future__ import annotations

import threading
from time import monotonic

from pmabench.base.errors import UsageError
from pmabench.bench.interface import DeviceRecord
from pmabench_drivers import serial_line_daq as w
from pmabench_drivers.emulator import faults as f
from pmabench_drivers.emulator.faults import CommandLog
from pmabench_drivers.emulator.plant import RealPlant, Wiring
from pmabench_drivers.emulator.ports import OnTerminal
from pmabench_drivers.shared.options import options_of

INPUTS, DIGITAL, OUTPUTS, VALVES = 6, 2, 1, 1
FULL_COUNT, FULL_SCALE, SHORTEST = 4092, 4095, 2000
"""Highest count of an input, of an output, and the shortest period [us]."""
LONGEST = 47
"""Longest command [bytes]."""
GARBAGE = b"\x00\xff*FFFF\n@#\n"


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> EmulatedBoard:
    """Emulated board for a device of the driver `serial-line-daq`."""
    options_of(device, w.read_options)
    if not device.address.startswith("/"):
        raise UsageError(f"{device.name} is at {device.address}; an emulator serves only a path of a serial port")
    return EmulatedBoard(device, plant, log)


class EmulatedBoard(OnTerminal):
    """One board, wired according to the channels, outputs and valves of the device.

    `boot_micros`: its clock's value when it starts [us].
    """

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog, boot_micros: int = 0) -> None:
        self._device, self._plant, self._log = device, plant, log
        faults = f.Faults(f.LINK, f.STUCK, f.SKEW, f.EXPIRY, f.WATCHDOG_OFF, f.RESTART, f.SETPOINT)
        super().__init__(device, log, faults, GARBAGE)
        self._clock, self._boot_micros, self._wiring = f.DeviceClock(faults), boot_micros, Wiring(device, plant, log)
        self._boot()

    def _boot(self) -> None:
        self._booted, self._rest, self._restart = self._clock.now(), b"", False
        self._period = self._due = self._number = 0
        self._armed, self._vented, self._fed, self._expire = 0.0, False, 0.0, False
        self._vent()

    def expire_watchdog(self) -> bool:
        """Let the watchdog expire; returns whether it was armed."""
        self._expire = self._armed > 0
        return self._expire

    def switch_off_watchdog(self) -> bool:
        """Switch it off without venting, as a fault of its memory would; returns whether it was armed."""
        armed, self._armed = self._armed, 0.0
        return armed > 0

    def restart(self) -> None:
        """Reset to power-on: vented, not sampling; carried out in its own thread."""
        self._restart = True

    def change_set_point(self, value: float) -> bool:
        """Set another value of the first output [count]; returns whether there is one."""
        if name := self._wiring.first_output:
            self._held[name] = round(value)
            self._wiring.give(name, value)
        return bool(name)

    # -- the program ----------------------------------------------------------------------------------------------

    def take(self, data: bytes) -> None:
        """Carry out each whole line, then any due actions."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[: LONGEST + 1]
        for line in lines:
            if len(line) <= LONGEST:
                self._obey(line)
        self._turn()

    def wait(self) -> float:
        """Time until the next action."""
        if self._period:
            return min(max(self._due - self._micros(), 0) * 1e-6, 0.005)
        return 0.005 if self._armed else 0.05

    def _micros(self) -> int:
        """Its clock, which runs on this program's [us]."""
        return self._boot_micros + round((self._clock.now() - self._booted) * 1e6)

    def _turn(self) -> None:
        if self._restart:
            self._boot()
        if self._armed and (self._expire or monotonic() - self._fed >= self._armed):
            self._log.note("watchdog", self._device.name, silent=monotonic() - self._fed)
            self._vent()
            self._armed, self._vented, self._expire = 0.0, True, False
        now, at = self._micros(), monotonic()
        if not self._period or now < self._due:
            return
        while self._period and self._due <= now:  # the board is on time, even if this program is not
            moment = at - 1e-6 * (now - self._due)
            number, micros = self._number % (1 << 32), self._due % (1 << 32)
            self._number += 1
            self._due += self._period
            self._send(self.faults.next(), "S", number, micros, self._state(), *self._counts(moment))

    def _vent(self) -> None:
        self._held = {f"o{i}": 0 for i in range(OUTPUTS)} | {f"v{i}": 0 for i in range(VALVES)}
        for name in self._held:
            self._wiring.give(name, 0)
            self._wiring.drive(name, on=False)

    def _counts(self, moment: float) -> list[int]:
        quantities = self._plant.at(moment)
        raw = (self._wiring.raw(f"a{i}", quantities) for i in range(INPUTS))
        return [min(max(round(value), 0), FULL_COUNT) for value in raw]

    def _state(self) -> int:
        bits = (w.ARMED if self._armed else 0) | (w.VENTED if self._vented else 0)
        return bits | sum(self._wiring.level(f"d{i}") << w.LEVELS + i for i in range(DIGITAL))

    # -- commands -------------------------------------------------------------------------------------------------

    def _obey(self, line: bytes) -> None:
        fault = self.faults.next()
        if fault.kind == "silence":
            return
        try:
            letter, *numbers = w.decode(line)
        except w.NoLine:
            return
        if not 0 < len(numbers) <= 3 or not all(text.isdecimal() and len(text) <= 9 for text in numbers):
            return
        number, *values = map(int, numbers)
        answer = self._answer(letter, values)
        fields = answer if isinstance(answer, tuple) else (answer,)
        self._send(fault, "E" if isinstance(answer, str) else "A", number, *fields)

    def _answer(self, letter: str, values: list[int]) -> int | str | tuple[object, ...]:
        match letter, values:
            case "I", []:
                model = self._plant.model(self._device.name)
                return (w.PROTOCOL, w.VERSION, model, "1", INPUTS, DIGITAL, OUTPUTS, VALVES, FULL_SCALE, SHORTEST)
            case "D", []:
                return self._state()
            case "G", [period]:
                if not 0 <= period <= 10_000_000:
                    return "range"
                self._period = max(period, SHORTEST) if period else 0
                self._number, self._due = 0, self._micros()
                return self._period
            case "T", []:
                return round(self._armed * 1e3)
            case "T", [time_ms]:
                return self._arm(time_ms)
            case "F", []:
                if not self._armed:
                    return "vented" if self._vented else "unarmed"
                self._fed = monotonic()
                return self._state()
            case "W" | "V", [index, *rest]:
                return self._hold(f"{'o' if letter == 'W' else 'v'}{index}", rest)
        return "unknown"

    def _arm(self, time_ms: int) -> int | str:
        if time_ms and not w.WATCHDOG[0] <= time_ms * 1e-3 <= w.WATCHDOG[1]:
            return "range"
        if not time_ms:
            self._vent()
        self._armed, self._vented, self._fed = time_ms * 1e-3, False, monotonic()
        self._log.note("armed", self._device.name, seconds=self._armed)
        return time_ms

    def _hold(self, name: str, rest: list[int]) -> int | str:
        if name not in self._held or len(rest) > 1:
            return "range"
        if not rest:
            return self._held[name]
        [value] = rest
        if not 0 <= value <= (FULL_SCALE if name[0] == "o" else 1):
            return "range"
        if value and not self._armed:
            return "vented" if self._vented else "unarmed"
        self.by_hand(name, value)
        return value

    def by_hand(self, name: str, value: float) -> None:
        """Set an output [count] or a valve (0, 1) of the board, by a command or without one."""
        self._held[name] = int(value)
        self._wiring.set(name, value)
        self._wiring.switch(name, on=value != 0)

    # -- lines ----------------------------------------------------------------------------------------------------

    def _send(self, fault: f.Fault, *fields: object) -> None:
        line = w.encode(*fields)
        if fault.kind == "hang-up":
            raise ConnectionAbortedError
        if fault.kind == "reset":
            self.faults.set("clear")
            self._boot()
            return
        if fault.kind == "delay":
            later = threading.Timer(fault.value, self.terminal.write, [line])
            later.daemon = True
            later.start()
        else:
            self.terminal.write(self.outgoing(line, fault))
