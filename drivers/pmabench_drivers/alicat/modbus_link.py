"""An Alicat controller over Modbus RTU: set-point, status and pressure as registers, exhaust as a special command.

Registers from the manual of 02/2023, which counts from 1; here they count from 0, as on the wire. Every write is
function 16, numbers are 32-bit floats with the high word first. `modbus.adapter.Line` keeps late answers apart. The
valve settings "hold closed" and "hold current" are never sent: they trap the pressure.
"""

from __future__ import annotations

import math
import threading
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, NotSent
from pmabench.bench.interface import COMPUTER, EMULATED, Identity
from pmabench_drivers.alicat import OTHER_SET_POINT, OUTPUT, Options, Reading, from_bits
from pmabench_drivers.modbus.registers import Register, decode, decode_text, encode
from pmabench_drivers.shared.link import Still, Unanswered, always, opened, turn

if TYPE_CHECKING:
    from pmabench_drivers.modbus.adapter import Line

WRITE = 16
COMMAND = Register("command", "holding", 999)
"""Command and its argument; when read, the last command and its result."""
SET_POINT = Register(OUTPUT, "holding", 1009, "float32")
STATUS = Register("status", "holding", 1200, "uint32")
PRESSURE = Register("pressure", "holding", 1202, "float32")
EMULATOR = Register("emulator", "input", 0xFE00, "text", length=16)
"""Only the emulator has this register: a controller refuses the address."""
VALVES = 6
CANCEL, EXHAUST = 0, 3
RESULTS = {
    32769: "it does not know the command",
    32770: "it does not know the setting",
    32771: "it has no such feature",
}
FLOAT32 = 1e-6
"""Relative resolution of the numbers on the line."""


class ModbusLink:
    """The line to one controller, used by any thread."""

    def __init__(self, device: str, address: str, options: Options, clock: Clock) -> None:
        self._device, self._address, self._options, self._clock = device, address, options, clock
        self._lock = threading.Lock()
        self._line: Line | None = None
        self._regulating = False
        """Whether no valve setting overrides the set-point, as far as is known."""
        self.exhausting = False
        self._table = "holding"
        """Function for reading: the device does not distinguish holding and input registers."""

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self, deadline: float) -> Identity:
        """Open the port and read the registers once; the device cannot be identified over Modbus."""
        from pmabench_drivers.modbus.adapter import Line

        options, serial = self._options, {"baudrate": self._options.baud}
        times = options.timeout, options.slowest
        self._line = Line(self._device, self._address, options.number, *times, serial)
        self._regulating = self.exhausting = False
        with self._turn(deadline):
            self._get(SET_POINT, deadline)
            self._read(deadline)
            try:
                words = self._opened().read(EMULATOR.table, EMULATOR.address, EMULATOR.count, deadline, "identity")
                model = decode_text(words)
            except Unanswered:
                raise
            except DeviceError:
                model = ""
        if model and not model.startswith(EMULATED):
            model = ""
        return Identity("Alicat", model or "controller on Modbus", "", "", simulated=bool(model), clock=COMPUTER)

    def close(self) -> None:
        """Close the port; may be called again."""
        line, self._line = self._line, None
        if line is not None:
            line.close()

    def compare(self, deadline: float) -> None:
        """No effect: there is no register for the unit or for the source of its set-point."""

    @property
    def fastest(self) -> float:
        """Polling rate that the line allows [Hz]: two requests, 46 characters and the pauses between frames."""
        return 0.8 * self._options.baud / 10 / (46 + 4 * 3.5)

    # -- commands -------------------------------------------------------------------------------------------------

    def poll(self, deadline: float) -> Reading:
        """One reading."""
        with self._turn(deadline):
            return self._read(deadline)

    def command(self, value: float, deadline: float, tolerance: float, still: Still = always) -> None:
        """Close the exhaust, send a set-point once and read it back. Nothing is sent if `still()` is false."""
        words = encode(SET_POINT, value)
        with self._turn(deadline):
            if not still():
                return
            if not self._regulating:
                self._put(COMMAND, [VALVES, CANCEL], deadline)
                self._refuse_other_result(CANCEL, deadline)
                self._regulating, self.exhausting = True, False
            lost = self._put(SET_POINT, words, deadline)
            self._refuse_other_set_point(value, deadline, tolerance, lost)

    def vent(self, value: float, deadline: float, tolerance: float, still: Still = always) -> None:
        """Send the venting set-point, then exhaust (with one valve: end the hold); both, even if the first fails."""
        words, setting = encode(SET_POINT, value), EXHAUST if self._options.valves > 1 else CANCEL
        with self._turn(deadline):
            if not still():
                return
            self._regulating, self.exhausting = False, setting == EXHAUST
            lost = self._put(SET_POINT, words, deadline)
            self._put(COMMAND, [VALVES, setting], deadline)
            self._refuse_other_set_point(value, deadline, tolerance, lost)
            self._refuse_other_result(setting, deadline)
            self._regulating = setting == CANCEL

    def held(self, deadline: float) -> float:
        """Set-point that the device holds."""
        with self._turn(deadline):
            return self._get(SET_POINT, deadline)

    def reported(self, deadline: float) -> dict[str, float | str]:
        """Empty: there is no register for the source of its set-point or its uptime."""
        return {}

    # -- registers ------------------------------------------------------------------------------------------------

    def _turn(self, deadline: float) -> AbstractContextManager[None]:
        """Exclusive use of the line, from the first to the last request of one action."""
        return turn(self._lock, deadline, self._device)

    def _read(self, deadline: float) -> Reading:
        asked = self._clock.now()
        words = self._words_at(STATUS, deadline, STATUS.count + PRESSURE.count)
        answered = self._clock.now()
        set_point = self._get(SET_POINT, deadline)
        pressure = self._finite(decode(PRESSURE, words[STATUS.count :]), PRESSURE)
        return Reading(pressure, set_point, from_bits(int(decode(STATUS, words[: STATUS.count]))), asked, answered)

    def _get(self, register: Register, deadline: float) -> float:
        return self._finite(decode(register, self._words_at(register, deadline)), register)

    def _words_at(self, register: Register, deadline: float, count: int = 0) -> list[int]:
        """Read registers; after a lost answer with the other of functions 3 and 4, to recognise a late answer."""
        try:
            return self._opened().read(self._table, register.address, count or register.count, deadline, register.name)
        except DeviceError:
            self._table = "input" if self._table == "holding" else "holding"
            raise

    def _finite(self, value: float, register: Register) -> float:
        if not math.isfinite(value):
            raise DeviceError(self._device, f"gives {value} in register {register.address}", register.name)
        return value

    def _put(self, register: Register, words: list[int], deadline: float) -> DeviceError | None:
        """Write once; a lost or refused answer is returned, as the value that the device then holds decides."""
        try:
            self._opened().write(WRITE, register.address, words, deadline, register.name)
        except DeviceError as error:
            return error
        return None

    def _refuse_other_set_point(
        self, value: float, deadline: float, tolerance: float, lost: DeviceError | None
    ) -> None:
        try:
            held = self._get(SET_POINT, deadline)
        except DeviceError as error:
            first = f"{lost.message}; " if lost else ""
            message = f"{first}whether it took {value:g} is not known ({error.message})"
            raise DeviceError(self._device, message, OUTPUT) from None
        if not abs(held - value) <= tolerance + FLOAT32 * abs(value):
            kind, why = (DeviceError, lost.message) if lost else (NotSent, OTHER_SET_POINT)
            raise kind(self._device, f"was commanded {value:g} and holds {held:g}: {why}", OUTPUT)

    def _refuse_other_result(self, setting: int, deadline: float) -> None:
        """Check the result of the last command; read with function 4, so that no other answer looks like this one."""
        command, result = self._opened().read("input", COMMAND.address, 2, deadline, COMMAND.name)
        what = {EXHAUST: "exhaust", CANCEL: "cancel"}[setting]
        if command != VALVES:
            message = f"did not take the valve setting {what}: its last command is {command}"
            raise DeviceError(self._device, message, COMMAND.name)
        if result != 0:
            why = RESULTS.get(result, f"result {result}")
            hint = '; has it one valve only? then "valves: 1"' if setting == EXHAUST and result != 32769 else ""
            raise DeviceError(self._device, f"refuses the valve setting {what}: {why}{hint}", COMMAND.name)

    def _opened(self) -> Line:
        return opened(self._line, self._device)
