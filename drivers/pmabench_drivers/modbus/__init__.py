"""Modbus devices of any maker, described by a register map in YAML (TCP, and RTU on a serial port).

`registers`: the map in its file and as records, conversion of words; `adapter`: the connection, the only module that
imports pymodbus; here: the device interface; `emulated`: a device with any map.

One thread polls the inputs and steps ramps and sines; calls and polls take turns on the one connection.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from time import monotonic
from typing import TYPE_CHECKING, Any

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, NotSent
from pmabench.bench.interface import COMPUTER, DeviceRecord, Identity
from pmabench_drivers.modbus import registers as r
from pmabench_drivers.shared.device import Controlled, L, Polled
from pmabench_drivers.shared.link import JOIN, Still, Unanswered, always, who

if TYPE_CHECKING:
    from pmabench_drivers.modbus.adapter import Line

CALL = 0.19
"""Longest time of a call [s]; the guard gives up at 0.2 s."""
OPEN = 1.9
LATE = 0.05
"""Latest time at which a command is carried out that was in progress when its connection was cut [s]."""

LOOK, SUPERVISED, PART = 0.05, 0.45, 0.25
"""Intervals of a guard's interlock reads and of `held` [s]; they take at most `PART` and 2 `PART` of the time [1]."""
TRIED = 4
"""Number of further requests at `open` that show how long an answer takes; a single one may meet a busy computer."""
SHARE, LEAST = 0.25, 0.1
"""Fraction of the watchdog's time, and shortest time [s], that the polling thread waits for a call of the program."""


class Watched(Polled[L]):
    """A polled device whose own watchdog is made of registers."""

    _watchdog: r.WatchdogRegisters | None

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._armed = self._fed = 0.0
        self._found = 0.0
        """Its time when it was opened [counts], restored at the end; 0: off."""
        self._beat = 0

    @abstractmethod
    def _get(self, register: r.Register, deadline: float) -> float:
        """Read a register before a deadline [s, monotonic]."""

    @abstractmethod
    def _put(self, register: r.Register, value: float, deadline: float, *, checked: bool = True) -> None:
        """Write a register before a deadline [s, monotonic]; then read it back if `checked`."""

    def _heard(self) -> float:
        """Time of its last answer [s, monotonic]; -inf if it keeps none."""
        return -math.inf

    def _called(self) -> float:
        """When the program last called it, apart from the polling thread [s, monotonic]."""
        return self._fed

    def _hungry(self) -> bool:
        """Whether the watchdog is armed and has not been fed for a quarter of its time.

        Most devices count any communication as a sign of life, so the polling thread must then stop. The device vents
        at most a quarter of its time (or 0.1 s) late, wherever the program hangs.
        """
        return self._armed > 0 and monotonic() - max(self._fed, self._called()) > max(SHARE * self._armed, LEAST)

    def arm_watchdog(self, seconds: float) -> float:
        """Set it to `seconds` and start it; returns the time that the device holds [s]."""
        registers = self._own_watchdog()
        if not 0 < seconds < math.inf:
            raise self._error(f"a watchdog of {seconds} s cannot be set", "watchdog")
        counts = max(1, math.floor(seconds / registers.resolution + 1e-6))
        if registers.trigger is not None:
            self._put(registers.trigger, registers.off, monotonic() + CALL, checked=False)
        self._put(registers.timeout, counts, monotonic() + CALL, checked=False)
        held = self._get(registers.timeout, monotonic() + CALL)
        if registers.trigger is not None:
            self._put(registers.trigger, registers.on, monotonic() + CALL)
        if held <= 0:
            raise self._error("holds a watchdog time of 0, which is none", "watchdog")
        self._armed, self._fed = held * registers.resolution, monotonic()
        return self._armed

    def feed_watchdog(self) -> None:
        """Write the heartbeat; if any communication feeds it, read its time unless it has just answered anyway."""
        registers, deadline = self._own_watchdog(), monotonic() + CALL
        if registers.heartbeat is not None:
            self._beat = self._beat % 1000 + 1
            self._put(registers.heartbeat, self._beat, deadline)
        elif monotonic() - self._heard() > max(SHARE * self._armed, LEAST) / 2:
            self._get(registers.timeout, deadline)
        self._fed = monotonic()

    def disarm_watchdog(self) -> None:
        """Stop it, or restore its previous time; outputs stay."""
        registers, self._armed = self._own_watchdog(), 0.0
        off = (registers.timeout, self._found) if registers.trigger is None else (registers.trigger, registers.off)
        self._put(*off, monotonic() + CALL)

    def _own_watchdog(self) -> r.WatchdogRegisters:
        if self._watchdog is None:
            raise self._error('has no watchdog: the map has no "watchdog"', "watchdog")
        return self._watchdog


class ModbusDevice(Watched["Line"], Controlled["Line"]):
    """A device with Modbus: `options: {map: ...}`; inputs, outputs and watchdog as its register map names them.

    Raw values are those of the registers; the bench file has the scaling. Ramps and sines are stepped at the poll rate.
    """

    emulator = "pmabench_drivers.modbus.emulated"
    read_options = staticmethod(r.read_options)
    _options: r.Mapped

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._map = self._options.map
        inputs = self._map.inputs  # without those that a kind of device streams
        self._inputs = [inputs[channel.input] for channel in device.channels if channel.input in inputs]
        self._spans = r.spans(self._inputs)
        polled = [register for span in self._spans for register in span.registers]
        self._places = [polled.index(register) for register in self._inputs]
        self._watchdog = self._map.watchdog
        self._seen, self._over = ("", 0.0), 0
        """Last serial number and uptime, and the number of the connection they were read on."""
        registers = self._watchdog
        own = [] if registers is None else [registers.trigger, registers.timeout]
        self._reported = r.spans(item for item in (*own, self._map.uptime) if item is not None)
        """Registers about the device itself, except for its serial number."""

    @classmethod
    def map_schema(cls) -> dict[str, Any]:
        """The JSON Schema of the file that the option `map` names."""
        return r.map_schema()

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Connect, identify, and check the order of words by a known constant (if the map has one)."""
        self.close()
        line = self._link = self._new_line()
        deadline = monotonic() + OPEN
        with self._closed_on_error():
            found = {name: self._identify(item, deadline) for name, item in self._map.identity.items()}
            if not found and self._spans:
                self._values(self._spans[:1], deadline)
            for _ in range(TRIED if self._spans else 0):
                self._values(self._spans[:1], deadline)
            self._over, self._seen = line.connections, self._who(deadline)
        maker, model, serial, firmware = (found.get(name, "") for name in ("maker", "model", "serial", "firmware"))
        answers = line.quickest
        return who(maker, model, serial, firmware, clock=COMPUTER, answers=answers if answers < math.inf else 0.0)

    def close(self) -> None:
        """Stop polling and close the connection."""
        self._following.clear()
        self._streaming = False
        self._armed = 0.0
        line, self._link = self._link, None
        if line is not None:
            line.cut()
        self._cycle.stop(JOIN)
        if line is not None:
            line.close()

    def _new_line(self) -> Line:
        from pmabench_drivers.modbus.adapter import Line

        options, map_ = self._options, self._map
        serial = {}
        if isinstance(options, r.Options):
            serial = {"baudrate": options.baud, "parity": options.parity, "stopbits": options.stop_bits}
        return Line(self._device.name, self._device.address, map_.unit_id, map_.timeout, map_.slowest, serial)

    def _identify(self, item: r.Register | str, deadline: float) -> str:
        if isinstance(item, str):
            return item
        words = self._opened().read(item.table, item.address, item.count, deadline, item.name)
        if item.type == "text":
            return r.decode_text(words)
        value = r.decode(item, words)
        if item.expect is not None and value != item.expect:
            message = f"holds {value:g} instead of {item.expect:g}: another device, or another map"
            if len(words) > 1 and r.decode(item, words[::-1]) == item.expect:
                message = f'gives {item.expect:g} with its words in the other order: change "words" in the map'
            raise self._error(message, item.name)
        return f"{value:.10g}"

    # -- samples --------------------------------------------------------------------------------------------------

    def _heard(self) -> float:
        return self._opened().heard

    def _called(self) -> float:
        return self._opened().called

    def _fastest(self) -> float:
        """The map's rate, or the rate that the line allows beside the guard's requests."""
        takes, device = self._opened().quickest, self._device
        if not self._spans or takes == math.inf:
            return self._options.rate
        free = 1.0
        if device.guarded:
            look = len(device.interlocks) + (2 if self._watchdog is not None and self._watchdog.heartbeat else 0)
            held = len(self._reported) + len(device.outputs) + len(device.valves)
            free -= min(PART, takes * look / LOOK) + min(2 * PART, takes * held / SUPERVISED)
        return min(self._options.rate, free / (len(self._spans) * takes))

    def _tick(self) -> None:
        """One turn of the thread: the next step of each segment, then the inputs."""
        if self._hungry():
            return  # the program that should feed the watchdog hangs: polling must not feed it instead
        failure = self._step()
        try:
            self._poll()
        except DeviceError as error:
            failure = failure or error
        self._cycle.note(failure)

    def _poll(self) -> None:
        if not self._streaming or not self._spans:
            return
        line, values, begun = self._opened(), [], math.inf
        for span in self._spans:
            deadline, name = monotonic() + 2 * CALL + self._map.timeout, span.registers[0].name
            values += span.values(line.read(span.table, span.address, span.count, deadline, name, sample=True))
            begun = min(begun, line.asked)
        answered, took = self._clock.now(), monotonic() - begun
        if not self._is_the_same(line):
            return  # another device, or a restarted one: `held` will show that and end the run
        self._keep([values[place] for place in self._places], answered - took, answered)

    def _is_the_same(self, line: Line) -> bool:
        """Whether a new connection leads to the same device as before, if that can be known.

        Samples of a device with outputs are accepted in any case: they show whether it vents.
        """
        if line.connections == self._over or self._device.guarded:
            return True
        over, (serial, uptime) = line.connections, self._who(monotonic() + CALL)
        if serial != self._seen[0] or uptime < self._seen[1]:
            return False
        self._over, self._seen = over, (serial, uptime)
        return True

    # -- commands -------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Command a value once; if no answer comes, the value that the device holds shows whether it was executed."""
        record = self._output(output)
        self._following.pop(output, None)
        self._put(self._map.outputs[output], value, resolution=record.resolution)

    def read_back(self, output: str) -> float:
        """The value in the device's register."""
        self._output(output)
        self._opened().let_samples()
        return self._get(self._map.outputs[output])

    def switch(self, output: str, *, on: bool) -> None:
        """Write 1 or 0 to a coil or a register."""
        self._put(self._switched(output), float(on))

    def is_on(self, output: str) -> bool:
        """Value of the coil or register."""
        self._opened().let_samples()
        return self._get(self._switched(output)) != 0

    def level(self, name: str) -> bool:
        """Whether a digital input, or the bit of a register, is set."""
        self._known("input", name, self._map.inputs)
        self._opened().let_samples()
        return self._get(self._map.inputs[name]) != 0

    def rescue(self, output: str, value: float) -> None:
        """Write over a second connection and cut the first one; on a serial line, after the request in progress."""
        self._known("output", output, self._map.outputs)
        register = self._map.outputs[output]
        self._following.pop(output, None)
        words, function = self._words(register, value), self._function(register)
        line, deadline = self._link, monotonic() + CALL
        if line is not None and line.is_serial:
            line.write(function, register.address, words, deadline, output)
            return
        under_way = line is not None and line.cut()
        second = self._new_line()
        try:
            self._overrule(second, register, value, deadline, LATE if under_way else 0.0)
        finally:
            second.close()

    def _overrule(self, second: Line, register: r.Register, value: float, deadline: float, watch: float) -> None:
        """Write over a second connection, and check for `watch` [s] whether the value stays."""
        words, function = self._words(register, value), self._function(register)
        second.overrule(function, register.address, words, deadline, register.name, watch=watch)

    # -- ramps and sines ------------------------------------------------------------------------------------------

    def _refuse_value(self, output: str, value: float) -> None:
        self._words(self._map.outputs[output], value)

    def _send_step(self, output: str, value: float, still: Still, *, last: bool) -> None:
        self._put(self._map.outputs[output], value, checked=False, still=still)

    # -- what the device reports ----------------------------------------------------------------------------------

    def held(self) -> Mapping[str, float | str]:
        """Its watchdog, the register `uptime` and the serial number, if the map has them."""
        self._opened().let_samples()
        deadline, found = monotonic() + CALL, dict[str, float | str]()
        values = self._values(self._reported, deadline)
        if (registers := self._watchdog) is not None:
            on = registers.on
            if registers.trigger in values:
                on = found["watchdog trigger"] = values[registers.trigger]
            if registers.timeout in values:  # off: 0
                found["watchdog"] = values[registers.timeout] * registers.resolution if on == registers.on else 0.0
        if isinstance(serial := self._map.identity.get("serial"), r.Register):
            found["serial"] = self._identify(serial, deadline)
        if self._map.uptime in values:
            found["uptime"] = values[self._map.uptime]
        return found

    def _values(self, spans: Sequence[r.Span], deadline: float) -> dict[r.Register | None, float]:
        """Values of the registers of some spans."""
        line, found = self._opened(), dict[r.Register | None, float]()
        for span in spans:
            words = line.read(span.table, span.address, span.count, deadline, span.registers[0].name)
            found |= zip(span.registers, span.values(words), strict=True)
        return found

    def _who(self, deadline: float) -> tuple[str, float]:
        """Serial number and uptime, if the map has registers for them."""
        serial, uptime = self._map.identity.get("serial", ""), self._map.uptime
        return self._identify(serial, deadline), 0.0 if uptime is None else self._get(uptime, deadline)

    # -- registers ------------------------------------------------------------------------------------------------

    def _switched(self, output: str) -> r.Register:
        self._known("valve output", output, set(self._map.outputs) - set(self._outputs))
        return self._map.outputs[output]

    def _words(self, register: r.Register, value: float) -> list[int]:
        try:
            return r.encode(register, value)
        except ValueError as error:
            raise self._error(str(error), register.name) from None

    def _get(self, register: r.Register, deadline: float = 0.0) -> float:
        until = deadline or monotonic() + CALL
        words = self._opened().read(register.table, register.address, register.count, until, register.name)
        return r.decode(register, words)

    def _put(
        self,
        register: r.Register,
        value: float,
        deadline: float = 0.0,
        *,
        resolution: float = 0.0,
        checked: bool = True,
        still: Still = always,
    ) -> None:
        """Write once and read back; nothing is sent if `still()` is false when the line is free."""
        line, until = self._opened(), deadline or monotonic() + CALL
        words, wanted = self._to_send(register, value, until, checked=checked)
        lost: Unanswered | None = None
        try:
            line.write(self._function(register), register.address, words, until, register.name, still)
        except Unanswered as error:
            if not checked:
                raise
            lost = error
        if checked:
            self._settle(register, wanted, until, resolution, lost)

    def _function(self, register: r.Register) -> int:
        """The function code that writes a register."""
        if register.is_bit:
            return 5 if self._map.write_single else 15
        return 6 if register.count == 1 and self._map.write_single else 16

    def _to_send(self, register: r.Register, value: float, _until: float, *, checked: bool) -> tuple[list[int], float]:
        """The words of a value, and the value that the device then holds."""
        words = self._words(register, value)
        return words, r.decode(register, words)

    def _settle(
        self, register: r.Register, wanted: float, until: float, resolution: float, lost: Unanswered | None
    ) -> None:
        """Raise an error if the device holds another value; a lost answer is settled so, never by writing again."""
        try:
            held = self._arrived(register, wanted, until, resolution)
        except DeviceError as error:
            if lost is None:
                raise
            message = f"{lost.message}; whether it took {wanted:g} is not known ({error})"
            raise Unanswered(self._device.name, message, register.name) from None
        if not abs(held - wanted) <= resolution:
            if lost is None:
                shown = f"was commanded {wanted:g} and {self._shows(register, held)}"
                raise NotSent(self._device.name, shown, register.name)
            shown = f"did not answer to the command {wanted:g} and {self._shows(register, held)}"
            raise self._error(shown, register.name)

    def _shows(self, _register: r.Register, held: float) -> str:
        """Value of a register, in words."""
        return f"holds {held:g}"

    def _arrived(self, register: r.Register, _wanted: float, until: float, _resolution: float) -> float:
        """Value that the device holds after a command."""
        return self._get(register, until)
