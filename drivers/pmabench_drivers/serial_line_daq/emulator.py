"""An emulated board on a pseudo-terminal: the protocol as the sketch speaks it, in front of the plant, with faults.

`delay`, `silence`, `lost`, `truncated`, `garbage`, `double` act on lines; `hang-up` and `reset` are those of the
line and of the board.
"""

from __future__ import annotations

import threading
from time import monotonic

from pmabench.base.errors import UsageError
from pmabench.bench.interface import EMULATED, DeviceRecord
from pmabench_drivers.emulator.faults import (
    EXPIRY,
    LINK,
    RESTART,
    SETPOINT,
    SKEW,
    STUCK,
    WATCHDOG_OFF,
    DeviceClock,
    Fault,
    Faults,
    Outgoing,
)
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import Terminal
from pmabench_drivers.options import Reader
from pmabench_drivers.serial_line_daq.options import WATCHDOG, read_options
from pmabench_drivers.serial_line_daq.wire import ARMED, LEVELS, PROTOCOL, VENTED, VERSION, NoLine, decode, encode

INPUTS, DIGITAL, OUTPUTS, VALVES = 6, 2, 1, 1
FULL_COUNT, FULL_SCALE, SHORTEST = 4092, 4095, 2000
"""Highest count of an input, of an output, and the shortest period [us]."""
LONGEST = 47
"""Longest command [bytes]."""
GARBAGE = b"\x00\xff*FFFF\n@#\n"


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> EmulatedBoard:
    """The board that the driver of `device` talks to."""
    reader = Reader()
    read_options(device, reader)
    reader.refuse(device.name)
    if not device.address.startswith("/"):
        raise UsageError(f"{device.name} is at {device.address}; an emulator serves only a path of a serial port")
    return EmulatedBoard(device, plant, log)


class EmulatedBoard:
    """One board; the channels, outputs and valves of the device say which of its inputs and outputs is what.

    `boot_micros`: what its clock shows when it starts [us].
    """

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog, boot_micros: int = 0) -> None:
        self._device, self._plant, self._log = device, plant, log
        self.address, self.faults = device.address, Faults(LINK, STUCK, SKEW, EXPIRY, WATCHDOG_OFF, RESTART, SETPOINT)
        self._clock, self._outgoing = DeviceClock(self.faults), Outgoing(GARBAGE)
        self._inputs = {channel.input: channel for channel in device.channels}
        self._levels = {lock.input: lock for lock in device.interlocks}
        self._outputs = {output.output: output for output in device.outputs}
        self._valves = {valve.output: valve for valve in device.valves}
        self._boot_micros, self._terminal = boot_micros, Terminal(device.address, log.tap(device.name))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"emulated {device.name}", daemon=True)
        self._boot()

    def _boot(self) -> None:
        self._booted, self._rest, self._restart = self._clock.now(), b"", False
        self._period = self._due = self._number = 0
        self._armed, self._vented, self._fed, self._expire = 0.0, False, 0.0, False
        self._vent()

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def expire_watchdog(self) -> bool:
        """Let the watchdog expire; whether it was armed."""
        self._expire = self._armed > 0
        return self._expire

    def switch_off_watchdog(self) -> bool:
        """Switch it off without venting, as a fault of its memory would; whether it was armed."""
        armed, self._armed = self._armed, 0.0
        return armed > 0

    def restart(self) -> None:
        """As after power-on: vented, not sampling; its own thread does it."""
        self._restart = True

    def change_set_point(self, value: float) -> bool:
        """Another value of the first output [count]; whether there is one."""
        for name in list(self._outputs)[:1]:
            self._held[name] = round(value)
            self._plant.command(float(self._outputs[name].scale.to_si(value)))
        return bool(self._outputs)

    def close(self) -> None:
        """Hang up."""
        self._ended.set()
        self._terminal.close()

    # -- the program ----------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        while not self._ended.is_set():
            received = self._terminal.read(self._idle())
            if received is None:
                return
            try:
                *lines, self._rest = (self._rest + received).split(b"\n")
                self._rest = self._rest[: LONGEST + 1]
                for line in lines:
                    if len(line) <= LONGEST:
                        self._obey(line)
                self._turn()
            except (OSError, ConnectionAbortedError):
                return

    def _idle(self) -> float:
        if self._period:
            return min(max(self._due - self._micros(), 0) * 1e-6, 0.005)
        return 0.005 if self._armed else 0.05

    def _micros(self) -> int:
        """Its clock, which this program lets run on [us]."""
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
        while self._period and self._due <= now:  # the board is in time, even where this program is not
            moment = at - 1e-6 * (now - self._due)
            number, micros = self._number % (1 << 32), self._due % (1 << 32)
            self._number += 1
            self._due += self._period
            self._send(self.faults.next(), "S", number, micros, self._state(), *self._counts(moment))

    def _vent(self) -> None:
        self._held = {f"o{i}": 0 for i in range(OUTPUTS)} | {f"v{i}": 0 for i in range(VALVES)}
        for name, output in self._outputs.items():
            if name in self._held:
                self._plant.command(float(output.scale.to_si(0)))
        for name, valve in self._valves.items():
            if name in self._held:
                self._plant.switch(on=valve.energised != "closed")

    def _counts(self, moment: float) -> list[int]:
        quantities = self._plant.at(moment)
        counts = []
        for i in range(INPUTS):
            channel = self._inputs.get(f"a{i}")
            raw = 0.0 if channel is None else float(channel.scale.to_raw(quantities.get(channel.name, 0.0)))
            counts.append(min(max(round(raw), 0), FULL_COUNT))
        return counts

    def _state(self) -> int:
        bits = (ARMED if self._armed else 0) | (VENTED if self._vented else 0)
        for i in range(DIGITAL):
            lock = self._levels.get(f"d{i}")
            high = lock is not None and (self._plant.e_stop_high() == (lock.safe == "high"))
            bits |= high << LEVELS + i
        return bits

    # -- commands -------------------------------------------------------------------------------------------------

    def _obey(self, line: bytes) -> None:
        fault = self.faults.next()
        if fault.kind == "silence":
            return
        try:
            letter, *numbers = decode(line)
        except NoLine:
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
                model = f"{EMULATED}{self._device.name}"
                return (PROTOCOL, VERSION, model, "1", INPUTS, DIGITAL, OUTPUTS, VALVES, FULL_SCALE, SHORTEST)
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
        if time_ms and not WATCHDOG[0] <= time_ms * 1e-3 <= WATCHDOG[1]:
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
        self._held[name] = value
        if name in self._outputs:
            output = self._outputs[name]
            si = float(output.scale.to_si(value))
            self._log.note("set", self._device.name, output=output.name, raw=value, si=si)
            self._plant.command(si)
        elif name in self._valves:
            valve = self._valves[name]
            self._log.note("switch", self._device.name, valve=valve.name, on=value != 0)
            self._plant.switch(on=(value != 0) == (valve.energised == "closed"))
        return value

    # -- lines ----------------------------------------------------------------------------------------------------

    def _send(self, fault: Fault, *fields: object) -> None:
        line = encode(*fields)
        if fault.kind == "hang-up":
            self._terminal.close()
            raise ConnectionAbortedError
        if fault.kind == "reset":
            self.faults.set("clear")
            self._boot()
            return
        if fault.kind == "delay":
            later = threading.Timer(fault.value, self._terminal.write, [line])
            later.daemon = True
            later.start()
        else:
            self._terminal.write(self._outgoing.of(line, fault))
