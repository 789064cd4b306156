"""Festo CPX-E terminals with the bus module CPX-E-EP (Modbus TCP): 4AI-UI, 4AO-UI, 16DI and 8DO.

`terminal`: modules, addresses and options; here: the device interface, a Modbus device whose map follows from its
modules; `emulated`: the device for `pmabench emulate`.

Differences from other Modbus devices: an output is read back from the module's own inputs; eight digital outputs share
a register; ranges and data format are compared at `open`, and read again in turn while armed, through the terminal's
data system table; the terminal has a time-out by default, so communication is kept up from `open` to `close`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import monotonic, sleep
from typing import TYPE_CHECKING, cast

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import DeviceRecord, Identity
from pmabench_drivers.festo_cpx_e import terminal as t
from pmabench_drivers.festo_cpx_e.terminal import DONE, STATUS, TIMEOUT, CpxOptions, read_options
from pmabench_drivers.modbus import CALL, LATE, OPEN, ModbusDevice
from pmabench_drivers.modbus.registers import Register, decode
from pmabench_drivers.shared.link import Cycle
from pmabench_drivers.shared.options import names_in

if TYPE_CHECKING:
    from pmabench_drivers.modbus.adapter import Line, NamedLine

KEEP_ALIVE = 40.0
"""Rate of requests while our watchdog is not armed [Hz]: the terminal's own time-out is 100 ms by default."""
LOOK = 0.06
"""Longest wait for the present value of an output before it is written [s]."""
ECHO = 0.003
"""Pause between two checks whether a written value has reached the module [s]."""
SHOWN = 0.01
"""Time within which a written value appears at the module's inputs [s]."""
TABLE = 0.5
"""Longest wait for an answer of the data system table [s]."""
CLEAR = 0.05
"""Longest wait until the terminal clears its previous answer [s]."""
SETTINGS = 0.02
"""Time spent on reading ranges and formats in each call of `held` [s]; commands wait for it."""


class FestoCpxE(ModbusDevice):
    """A CPX-E terminal: `options: {modules: [...], ranges: {...}}`; channels have names such as `ai3.0`, `do2.7`.

    Raw values are counts of the data format "sign + 15 bit"; the bench file has the scaling.
    """

    emulator = "pmabench_drivers.festo_cpx_e.emulated"

    read_options = staticmethod(read_options)
    _options: CpxOptions

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._terminal = self._options.terminal
        positions = {self._terminal.module_of(name).position for _kind, _place, name in names_in(device)}
        self._used = [module for module in self._terminal.modules if module.position in positions]
        self._alive = Cycle(f"keep alive {device.name}", self._keep_alive, clock)
        self._compared = False
        numbers = {self._range_at(channel)[0] for channel in self._terminal.ranges}
        numbers |= {module.parameter(t.DATA_FORMAT) for module in self._used if module.kind.ranges}
        self._settings: dict[int, int | None] = dict.fromkeys(sorted(numbers))
        """Function number of each range and data format, least recently read first -> value then."""

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Connect, identify, and compare modules, data format and ranges with the bench file."""
        return self._open(self._compare)

    def open_to_vent(self) -> Identity:
        """Connect and compare only the modules: a terminal with a fault or another range still takes commands.

        The other comparisons of `open` follow before sampling, so that no wrong sample confirms a vent.
        """
        return self._open(self._compare_modules)

    def _open(self, compare: Callable[[NamedLine, float], None]) -> Identity:
        self.close()
        line = self._new_line()
        self._link, until = line, monotonic() + OPEN
        self._settings, self._compared = dict.fromkeys(self._settings), compare == self._compare
        with self._closed_on_error():
            identity = line.identity(until)
            compare(line, until)
            self._found = self._get(TIMEOUT, until)
        self._alive.start(KEEP_ALIVE)
        return identity

    def start(self, rate: float) -> float:
        """Start sampling at `rate` [Hz]; returns the rate used."""
        if not self._compared:
            self._compare(self._opened(), monotonic() + CALL)
            self._compared = True
        return super().start(rate)

    def close(self) -> None:
        """Stop polling and close the connection; the terminal's own time-out then runs."""
        self._alive.stop()
        super().close()

    def _new_line(self) -> NamedLine:
        from pmabench_drivers.modbus.adapter import NamedLine

        return NamedLine(self._device.name, self._device.address, self._map.timeout)

    def _opened(self) -> NamedLine:
        return cast("NamedLine", super()._opened())

    def _keep_alive(self) -> None:
        """Send a request while our watchdog is not armed; once it is, only the program prevents the time-out."""
        line = self._link
        if self._armed or line is None:
            return
        try:
            line.read("holding", STATUS, 1, monotonic() + self._map.timeout, "status")
        except DeviceError:
            return  # reported by the next call

    # -- what is there, and how it is set -------------------------------------------------------------------------

    def _compare_modules(self, line: Line, until: float) -> None:
        """Compare the number of modules, from which the addresses of the outputs follow."""
        modules = self._terminal.modules
        if (present := self._present(line, until)) != len(modules) + 1:
            message = f"has {present} modules with the bus module, and the bench file names {len(modules) + 1}"
            raise self._error(message, "options.modules")

    def _compare(self, line: Line, until: float) -> None:
        self._compare_modules(line, until)
        if faults := self._faulty(line, until):
            raise self._error(f"reports faults (bits {', '.join(map(str, faults))}): look at the modules' LEDs")
        [status] = line.read("holding", STATUS, 1, until, "status")
        if status & t.FORCED:
            raise self._error("has forced inputs or outputs: end the forcing at the terminal")
        for module in self._used:
            if module.kind.ranges and self._setting(line, module.parameter(t.DATA_FORMAT), until) & 1:
                message = 'gives linear scaled values: set its data format to "sign + 15 bit"'
                raise self._error(message, f"module {module.position} ({module.name})")
        for channel, wanted in self._terminal.ranges.items():
            self._compare_range(line, channel, wanted, until)

    def _compare_range(self, line: Line, channel: str, wanted: int, until: float) -> None:
        number, shift = self._range_at(channel)
        held = self._setting(line, number, until)
        if held >> shift & 0xF == wanted:
            return
        found = f"is set to {_range(held >> shift)} and the bench file says {_range(wanted)}"
        raise self._error(f"{found}: set it at the terminal", channel)

    def held(self) -> dict[str, float | str]:
        """Its time-out [s], modules, those with faults, whether anything is forced, identity, ranges and formats.

        Ranges and data formats are read in turn, some per call: the data system table is slow, and commands wait.
        The serial number takes half a second and more to read, and is left out.
        """
        until = monotonic() + CALL
        watchdog, line = self._get(TIMEOUT, until) * 1e-3, self._opened()
        [status] = line.read("holding", STATUS, 1, until, "status")
        found = line.identification(until)
        return {
            "watchdog": watchdog,
            "modules": float(self._present(line, until)),
            "modules with a fault": ", ".join(map(str, self._faulty(line, until))) or "none",
            "forced": "yes" if status & t.FORCED else "no",
            "terminal": " ".join(found[number] for number in sorted(found) if found[number]),
            **self._settings_held(line, until),
        }

    def _settings_held(self, line: Line, until: float) -> dict[str, float | str]:
        """Range of each channel and data format of each module; one that has changed is read again in the next call."""
        enough, found = monotonic() + SETTINGS, dict[str, float | str]()
        for number, before in list(self._settings.items()):
            if before is not None and monotonic() > enough:
                break
            if self._setting(line, number, until) != before and before is not None:
                self._settings = {number: self._settings.pop(number), **self._settings}
                break
            line.let_samples()
        for channel in self._terminal.ranges:
            number, shift = self._range_at(channel)
            found[f"range of {channel}"] = _range((self._settings[number] or 0) >> shift)
        for module in self._used:
            if module.kind.ranges:
                linear = (self._settings[module.parameter(t.DATA_FORMAT)] or 0) & 1
                found[f"data format of module {module.position}"] = "linear scaled" if linear else "sign + 15 bit"
        return found

    def _range_at(self, channel: str) -> tuple[int, int]:
        """Function number of a channel's range, and its offset there [bits]."""
        return self._terminal.module_of(channel).range_of(int(channel.partition(".")[2]))

    @staticmethod
    def _present(line: Line, until: float) -> int:
        return sum(word.bit_count() for word in line.read("holding", t.PRESENT, 3, until, "modules"))

    @staticmethod
    def _faulty(line: Line, until: float) -> list[int]:
        """Positions of the modules that report a fault; 0 is the bus module."""
        words = line.read("holding", t.FAULTS, 3, until, "faults")
        return [16 * i + bit for i, word in enumerate(words) for bit in range(16) if word >> bit & 1]

    def _setting(self, line: Line, number: int, until: float) -> int:
        """The value of a function number, which is stored as the one last read."""
        self._ask_table(line, t.ASK | number, until)
        [value] = line.read("holding", t.VALUE_OUT, 1, until, f"function {number}")
        self._settings.pop(number, None)
        self._settings[number] = value
        return value

    def _ask_table(self, line: Line, question: int, until: float) -> None:
        """Send a request to the data system table and wait for its answer."""
        what = f"function {question & 0x1FFF}"

        def ready() -> bool:
            return bool(line.read("holding", t.READY, 1, until, what)[0] & DONE)

        line.write(16, t.CONTROL, [0], until, what)
        clear = monotonic() + CLEAR
        while ready() and monotonic() < clear:
            sleep(ECHO)
        line.write(16, t.CONTROL, [question], until, what)
        latest = monotonic() + TABLE
        while not ready():
            if monotonic() > latest:
                raise self._error(f"its data system table gave no answer within {TABLE:g} s", what)
            sleep(ECHO)

    # -- samples --------------------------------------------------------------------------------------------------

    def _poll(self) -> None:
        """Read all inputs of the terminal in one transaction; raises DeviceError if a module in use reports a fault."""
        if not self._streaming or not self._inputs:
            return
        line, deadline = self._opened(), monotonic() + 2 * CALL + self._map.timeout
        words = line.read("holding", t.FIRST_INPUT, self._terminal.width, deadline, "process data", sample=True)
        answered, took = self._clock.now(), monotonic() - line.asked
        for module in self._used:
            if status := words[module.status - t.FIRST_INPUT]:
                message = f"reports a fault (status 0x{status:04x}): look at its LEDs and its data sheet"
                raise self._error(message, f"module {module.position} ({module.name})")
        values = [decode(item, [words[item.address - t.FIRST_INPUT]]) for item in self._inputs]
        self._keep(values, answered - took, answered)

    # -- commands -------------------------------------------------------------------------------------------------

    def _get(self, register: Register, deadline: float = 0.0) -> float:
        """Value that a module reports; asked again if the terminal had closed the connection."""
        until = deadline or monotonic() + CALL
        source = self._map.inputs.get(register.name, register)
        return decode(source, self._opened().read_again(source.address, source.count, until, source.name))

    def _function(self, register: Register) -> int:
        return 6 if register == TIMEOUT else 16

    def _to_send(self, register: Register, value: float, until: float, *, checked: bool) -> tuple[list[int], float]:
        words = self._words(register, value)
        wanted = value if register.bit >= 0 else decode(register, words)
        return self._with_neighbours(
            register, value, words, min(until, monotonic() + LOOK)
        ) if checked else words, wanted

    def _arrived(self, register: Register, wanted: float, until: float, _resolution: float) -> float:
        """Value that the module shows, once it is the wanted one, or shortly before `until`."""
        while (held := self._get(register, until)) != wanted and monotonic() <= until - LOOK / 2:
            sleep(ECHO)
        return held

    def _with_neighbours(self, register: Register, value: float, words: list[int], until: float) -> list[int]:
        """Words to write, with the present state of the module's other digital outputs.

        If that cannot be read, nothing is switched on; switching off switches off the whole module, as the terminal
        itself does without communication. The read also shows whether the connection still works.
        """
        try:
            held = int(self._get(self._whole(register), until))
        except DeviceError:
            if register.bit >= 0 and value:
                raise
            held = 0
        return _with_bit(register, value, held) if register.bit >= 0 else words

    def _whole(self, register: Register) -> Register:
        """Register of the module's inputs that shows the whole register of an output."""
        source = self._map.inputs.get(register.name, register)
        return replace(source, name=f"{register.name} and its neighbours", bit=-1) if register.bit >= 0 else source

    def _overrule(self, second: Line, register: Register, value: float, deadline: float, watch: float) -> None:
        """Write over a second connection; another vent may write the register of a digital output at the same time."""
        words, source, mask, watch = self._words(register, value), self._whole(register), 0xFFFF, watch or SHOWN
        if register.bit >= 0:
            try:
                [held] = second.read("holding", source.address, 1, min(deadline, monotonic() + LOOK), source.name)
            except DeviceError:
                held = 0
            words, mask, watch = _with_bit(register, value, held), 1 << register.bit, LATE
        second.overrule(16, register.address, words, deadline, register.name, source.address, mask, watch)

    # -- the terminal's watchdog ----------------------------------------------------------------------------------

    def arm_watchdog(self, seconds: float) -> float:
        """Set the time-out of the terminal; returns the time it then holds [s]."""
        if seconds < t.SHORTEST:
            raise self._error(f"waits {t.SHORTEST:g} s at least, not {seconds:g} s", "watchdog")
        self._get(TIMEOUT)
        return super().arm_watchdog(seconds)


def _range(code: int) -> str:
    """The name of a range."""
    return next((name for name, known in t.RANGES.items() if known == code & 0xF), f"range {code & 0xF}")


def _with_bit(register: Register, value: float, held: int) -> list[int]:
    """The eight outputs of a module with one of them changed."""
    return [held & 0xFF & ~(1 << register.bit) | int(value != 0) << register.bit]
