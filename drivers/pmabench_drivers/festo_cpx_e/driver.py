"""The device interface in front of a CPX-E: a Modbus device whose register map follows from the modules.

What differs from any Modbus device: an output is read back from the module's own inputs; eight digital outputs share a
register; ranges and data format are compared when it is opened, through the terminal's data system table; the terminal
has a time-out from the factory on, so it is kept in talk from `open` to `close`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import monotonic, sleep
from typing import TYPE_CHECKING, cast

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import COMPUTER, EMULATED, DeviceRecord, Identity
from pmabench_drivers.festo_cpx_e.terminal import (
    ASK,
    CONTROL,
    DATA_FORMAT,
    DONE,
    FAULTS,
    FIRST_INPUT,
    FORCED,
    PRESENT,
    PROTECTED,
    RANGES,
    READY,
    SHORTEST,
    STATUS,
    TIMEOUT,
    VALUE_IN,
    VALUE_OUT,
    WRITE,
    CpxOptions,
    read_options,
)
from pmabench_drivers.modbus.driver import CALL, OPEN, ModbusDevice
from pmabench_drivers.modbus.registers import Register, decode
from pmabench_drivers.options import Reader
from pmabench_drivers.polling import Cycle

if TYPE_CHECKING:
    from pmabench_drivers.festo_cpx_e.line import NamedLine
    from pmabench_drivers.modbus.adapter import Line

KEEP_ALIVE = 40.0
"""How often it is asked while no watchdog of ours is armed [Hz]: its own time-out is 100 ms from the factory on."""
LOOK = 0.06
"""Longest wait for what an output held before it is written [s]."""
ECHO = 0.003
"""Pause between two looks whether a written value has arrived at the module [s]."""
TABLE = 0.5
"""Longest wait for an answer of the data system table [s]."""
CLEAR = 0.05
"""Longest wait until the terminal takes back the answer to the question before [s]."""


class FestoCpxE(ModbusDevice):
    """A CPX-E terminal: `options: {modules: [...], ranges: {...}}`; channels are named as `ai3.0`, `do2.7`.

    Raw values are counts of the data format "sign + 15 bit"; the scaling is the bench's.
    """

    emulator = "pmabench_drivers.festo_cpx_e.emulated"

    _options: CpxOptions

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._terminal = self._options.terminal
        names = {item.input for item in device.channels} | {item.output for item in device.outputs}
        names |= {valve.output for valve in device.valves} | {lock.input for lock in device.interlocks}
        positions = {self._terminal.module_of(name).position for name in names}
        self._used = [module for module in self._terminal.modules if module.position in positions]
        self._alive = Cycle(f"keep alive {device.name}", self._keep_alive, clock)
        self._armed = False
        self._found = 0.0

    @classmethod
    def read_options(cls, device: DeviceRecord, reader: Reader) -> CpxOptions:
        """The modules and ranges of the bench file, and the register map that follows from them."""
        return read_options(device, reader)

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Connect, read who it is, and compare modules, data format and ranges with the bench file."""
        self.close()
        line = self._new_line()
        self._line, until = line, monotonic() + OPEN
        try:
            told = line.identification(until)
            self._compare(line, until)
            self._found = self._get(TIMEOUT, until)
        except DeviceError:
            self.close()
            raise
        self._alive.start(KEEP_ALIVE)
        model = told.get(4) or told.get(1, "")
        return Identity(
            told.get(0, ""), model, "", told.get(2, ""), simulated=model.startswith(EMULATED), clock=COMPUTER
        )

    def close(self) -> None:
        """End polling and let go of the connection; the terminal's own time-out runs from then on."""
        self._armed = False
        self._alive.stop()
        super().close()

    def _new_line(self) -> NamedLine:
        from pmabench_drivers.festo_cpx_e.line import NamedLine

        return NamedLine(self._device.name, self._device.address, self._map.timeout)

    def _opened(self) -> NamedLine:
        return cast("NamedLine", super()._opened())

    def _keep_alive(self) -> None:
        """One question while no watchdog of ours is armed; once it is, only the program keeps the terminal quiet."""
        line = self._line
        if self._armed or line is None:
            return
        try:
            line.read("holding", STATUS, 1, monotonic() + self._map.timeout, "status")
        except DeviceError:
            return  # the next call that somebody makes tells it

    # -- what is there, and how it is set -------------------------------------------------------------------------

    def _compare(self, line: Line, until: float) -> None:
        name, modules = self._device.name, self._terminal.modules
        present = self._present(line, until)
        if present != len(modules) + 1:
            message = f"has {present} modules with the bus module, and the bench file names {len(modules) + 1}"
            raise DeviceError(name, message, "options.modules")
        faults = self._faulty(line, until)
        if faults:
            raise DeviceError(name, f"reports faults (bits {', '.join(map(str, faults))}): look at the modules' LEDs")
        [status] = line.read("holding", STATUS, 1, until, "status")
        if status & FORCED:
            raise DeviceError(name, "has forced inputs or outputs: end the forcing at the terminal")
        for module in self._used:
            if module.kind.ranges and self._parameter(line, module.parameter(DATA_FORMAT), until) & 1:
                message = 'gives linear scaled values: set its data format to "sign + 15 bit"'
                raise DeviceError(name, message, f"module {module.position} ({module.name})")
        for channel, wanted in self._terminal.ranges.items():
            self._compare_range(line, channel, wanted, until, protected=bool(status & PROTECTED))

    def _compare_range(self, line: Line, channel: str, wanted: int, until: float, *, protected: bool) -> None:
        number, shift = self._terminal.module_of(channel).range_of(int(channel.partition(".")[2]))
        held = self._parameter(line, number, until)
        code = held >> shift & 0xF
        if code == wanted:
            return
        names = {value: key for key, value in RANGES.items()}
        told = f"is set to {names.get(code, f'range {code}')} and the bench file says {names[wanted]}"
        if not self._terminal.set_ranges:
            message = f"{told}: set it at the terminal, or let it be set with set_ranges: true"
            raise DeviceError(self._device.name, message, channel)
        if protected:
            raise DeviceError(self._device.name, f"{told}, and the terminal is write-protected", channel)
        if channel in self._map.outputs and self._get(self._map.outputs[channel], until) != 0:
            raise DeviceError(self._device.name, f"{told}, and it puts out something: bring it to 0 first", channel)
        line.write(16, VALUE_IN, [held & ~(0xF << shift) | wanted << shift], until, channel)
        self._ask_table(line, ASK | WRITE | number, until)
        now = self._parameter(line, number, until) >> shift & 0xF
        if now != wanted:
            raise DeviceError(self._device.name, f"did not take the range {names[wanted]}", channel)

    def held(self) -> dict[str, float | str]:
        """Its time-out [s], how many modules it has and which report faults, whether it is forced, and who it is.

        It tells no serial number in less than half a second.
        """
        until = monotonic() + CALL
        watchdog, line = self._get(TIMEOUT, until) * 1e-3, self._opened()
        [status] = line.read("holding", STATUS, 1, until, "status")
        told = line.identification(until)
        return {
            "watchdog": watchdog,
            "modules": float(self._present(line, until)),
            "modules with a fault": ", ".join(map(str, self._faulty(line, until))) or "none",
            "forced": "yes" if status & FORCED else "no",
            "terminal": " ".join(told[number] for number in sorted(told) if told[number]),
        }

    @staticmethod
    def _present(line: Line, until: float) -> int:
        return sum(word.bit_count() for word in line.read("holding", PRESENT, 3, until, "modules"))

    @staticmethod
    def _faulty(line: Line, until: float) -> list[int]:
        """Places of the modules that report a fault; 0 is the bus module."""
        words = line.read("holding", FAULTS, 3, until, "faults")
        return [16 * i + bit for i, word in enumerate(words) for bit in range(16) if word >> bit & 1]

    def _parameter(self, line: Line, number: int, until: float) -> int:
        """The value of a function number."""
        self._ask_table(line, ASK | number, until)
        return line.read("holding", VALUE_OUT, 1, until, f"function {number}")[0]

    def _ask_table(self, line: Line, question: int, until: float) -> None:
        """Ask the data system table and wait for its answer."""
        what = f"function {question & 0x1FFF}"

        def ready() -> bool:
            return bool(line.read("holding", READY, 1, until, what)[0] & DONE)

        line.write(16, CONTROL, [0], until, what)
        clear = monotonic() + CLEAR
        while ready() and monotonic() < clear:
            sleep(ECHO)
        line.write(16, CONTROL, [question], until, what)
        latest = monotonic() + TABLE
        while not ready():
            if monotonic() > latest:
                raise DeviceError(self._device.name, f"its data system table gave no answer within {TABLE:g} s", what)
            sleep(ECHO)

    # -- samples --------------------------------------------------------------------------------------------------

    def _poll(self) -> None:
        """All inputs of the terminal in one transaction; none are taken from a module that reports a fault."""
        if not self._streaming or not self._inputs:
            return
        asked, deadline = self._clock.now(), monotonic() + self._map.timeout
        words = self._opened().read("holding", FIRST_INPUT, self._terminal.width, deadline, "process data")
        answered = self._clock.now()
        for module in self._used:
            status = words[module.status - FIRST_INPUT]
            if status:
                message = f"reports a fault (status 0x{status:04x}): look at its LEDs and its data sheet"
                raise DeviceError(self._device.name, message, f"module {module.position} ({module.name})")
        row = [decode(item, [words[item.address - FIRST_INPUT]]) for item in self._inputs]
        self._samples.append(round((asked + answered) / 2 * 1e9), row, round(answered * 1e9))

    # -- commands -------------------------------------------------------------------------------------------------

    def _get(self, register: Register, deadline: float = 0.0) -> float:
        """What a module says; asked once more where the terminal had ended the connection."""
        from pmabench_drivers.modbus.adapter import Unanswered

        until = deadline or monotonic() + CALL
        source = self._map.inputs.get(register.name, register)
        try:
            return super()._get(source, until)
        except Unanswered:
            if monotonic() >= until:
                raise
            return super()._get(source, until)

    def _put(
        self,
        register: Register,
        value: float,
        deadline: float = 0.0,
        *,
        resolution: float = 0.0,
        checked: bool = True,
        still: Callable[[], bool] = lambda: True,
    ) -> None:
        """Write once and wait until the module says so; a lost answer is settled by what it says, never by a retry."""
        from pmabench_drivers.modbus.adapter import Unanswered

        line, until, words = self._opened(), deadline or monotonic() + CALL, self._words(register, value)
        wanted = value if register.bit >= 0 else decode(register, words)
        if checked:
            words = self._beside(register, value, words, min(until, monotonic() + LOOK))
        lost: Unanswered | None = None
        try:
            line.write(6 if register == TIMEOUT else 16, register.address, words, until, register.name, still)
        except Unanswered as error:
            if not checked:
                raise
            lost = error
        if not checked:
            return
        while True:
            try:
                held = self._get(register, until)
            except DeviceError as error:
                if lost is None:
                    raise
                message = f"{lost.reason}; whether it took {value:g} is not known ({error})"
                raise Unanswered(self._device.name, message, register.name) from None
            if held == wanted:
                return
            if monotonic() > until - LOOK / 2:
                what = "did not answer to the command" if lost else "was commanded"
                raise DeviceError(self._device.name, f"{what} {wanted:g} and holds {held:g}", register.name)
            sleep(ECHO)

    def _beside(self, register: Register, value: float, words: list[int], until: float) -> list[int]:
        """The words to write, with the other digital outputs of the module as they are now.

        Where that cannot be read, nothing is switched on; switching off leaves all of the module off, as the terminal
        itself does without communication. The look also finds out whether the connection still lives.
        """
        try:
            held = int(self._get(self._whole(register), until))
        except DeviceError:
            if register.bit >= 0 and value:
                raise
            held = 0
        return _with_bit(register, value, held) if register.bit >= 0 else words

    def _whole(self, register: Register) -> Register:
        """What the module says of the whole register that holds an output."""
        source = self._map.inputs.get(register.name, register)
        return replace(source, name=f"{register.name} and its neighbours", bit=-1) if register.bit >= 0 else source

    def rescue(self, output: str, value: float) -> None:
        """Cut the first connection and write over a second one."""
        register = self._map.outputs.get(output)
        if register is None:
            raise DeviceError(self._device.name, f'no output "{output}"{did_you_mean(output, self._map.outputs)}')
        self._following.pop(output, None)
        words, line, until = self._words(register, value), self._line, monotonic() + CALL
        if line is not None:
            line.cut()
        second = self._new_line()
        try:
            if register.bit >= 0:
                source = self._whole(register)
                try:
                    [held] = second.read("holding", source.address, 1, min(until, monotonic() + LOOK), source.name)
                except DeviceError:
                    held = 0
                words = _with_bit(register, value, held)
            second.overrule(16, register.address, words, until, output)
        finally:
            second.close()

    # -- the terminal's watchdog ----------------------------------------------------------------------------------

    def arm_watchdog(self, seconds: float) -> float:
        """Set the time-out of the terminal; returns what it holds then [s]."""
        if seconds < SHORTEST:
            raise DeviceError(self._device.name, f"waits {SHORTEST:g} s at least, not {seconds:g} s", "watchdog")
        self._get(TIMEOUT)
        told = super().arm_watchdog(seconds)
        self._armed = True
        return told

    def disarm_watchdog(self) -> None:
        """Give the terminal the time-out back that it had when it was opened."""
        self._watchdog.forget()
        self._armed = False
        self._put(TIMEOUT, self._found)


def _with_bit(register: Register, value: float, held: int) -> list[int]:
    """The eight outputs of a module with one of them changed."""
    return [held & 0xFF & ~(1 << register.bit) | int(value != 0) << register.bit]
