"""The device interface in front of the EX-2 of device.md: pressures, set-point, valves, contact, watchdog."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from time import monotonic

from pmabench_drivers.shared.device import Controlled
from pmabench_drivers.shared.link import JOIN, Still
from pmabench_drivers.shared.options import Reader, option

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import EMULATED, DeviceRecord, Identity
from pmabench_driver_example.wire import Connection

CALL = 0.18
"""Longest time that a call may take, a little less than the guard waits [s]."""
INPUTS, OUTPUTS, CONTACTS = ("outlet", "supply"), ("outlet",), ("contact",)
VALVES = {"dump": "1", "supply": "2"}
"""Name in a bench file -> number on the wire."""


@dataclass(frozen=True)
class Options:
    """What a bench file says about the device."""

    rate: float = option(Reader.quantity, "frequency", 50.0, 1.0, 200.0)
    """Highest rate at which it is polled, and at which ramps and sines are stepped [Hz]."""
    timeout: float = option(Reader.quantity, "time", 0.1, 0.01, 0.15)
    """Longest wait for an answer [s]."""


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """The options; every problem goes to the reader, with its place."""
    options, _ = reader.options(Options, device.options, ("options",))
    reader.host(device, "192.168.0.10:4000")
    named = [
        *((("channels", channel.name, "input"), channel.input, INPUTS) for channel in device.channels),
        *((("outputs", output.name, "output"), output.output, OUTPUTS) for output in device.outputs),
        *((("outputs", valve.name, "output"), valve.output, tuple(VALVES)) for valve in device.valves),
        *((("interlocks", lock.name, "input"), lock.input, CONTACTS) for lock in device.interlocks),
    ]
    for place, name, names in named:
        reader.known(place, "no", name, names, f"; there is {' and '.join(names)}")
    return options


class ExampleController(Controlled[Connection]):
    """A pressure controller: two pressures, a set-point up to 600 kPa, dump and supply valve, a contact.

    `Controlled` (`pmabench_drivers.shared.device`) polls it and steps ramps and sines in one thread, which calls
    `_tick`; `start`, `collect`, `stop` and `follow` come from there.
    """

    verified = "emulator only"
    """Once somebody has compared every value and the vent with instruments: `hardware (who, date, firmware)`."""
    emulator = "pmabench_driver_example.emulator"
    """The module whose `serve(device, plant, log)` makes the other end of the wire."""
    read_options = staticmethod(read_options)
    _options: Options

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._places = [INPUTS.index(channel.input) for channel in device.channels]

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Connect and ask who it is."""
        self.close()
        self._link = self._connect()
        try:
            [answer] = self._ask("ID", 1)
            model, serial, firmware = answer.split(",")
        except (DeviceError, ValueError) as error:
            self.close()
            raise error if isinstance(error, DeviceError) else self._unreadable(answer) from None
        if not model.removeprefix(EMULATED).startswith("EX-2"):
            self.close()
            raise self._error(f'is a "{model[:40]}"; an EX-2 was expected')
        return Identity("Example", model, serial, firmware, simulated=model.startswith(EMULATED), clock="computer")

    def close(self) -> None:
        """End polling and let go of the connection."""
        self._following.clear()
        self._cycle.stop(JOIN)
        self._hang_up()

    # -- samples --------------------------------------------------------------------------------------------------

    def _fastest(self) -> float:
        self._opened()
        return self._options.rate

    def _tick(self) -> None:
        """One turn of the thread: the next step of a ramp or sine, then the pressures."""
        failure = self._step()
        try:
            if self._streaming:
                self._poll()
        except DeviceError as error:
            failure = failure or error
        self._cycle.note(failure)

    def _poll(self) -> None:
        asked = self._clock.now()
        values = self._numbers("P", 2)
        self._keep([values[place] for place in self._places], asked, self._clock.now())

    # -- set-point ------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Command the set-point [kPa] once; the answer is what the controller holds then."""
        self._known("output", output, OUTPUTS)
        self._following.clear()
        self._put(self._opened(), value)

    def read_back(self, output: str) -> float:
        """The set-point that the controller holds [kPa]."""
        self._known("output", output, OUTPUTS)
        return self._numbers("S", 1)[0]

    def _put(self, connection: Connection, value: float) -> None:
        [held] = self._numbers(f"S {value:.2f}", 1, connection)
        if abs(held - value) > 0.0051:
            raise self._error(f"was commanded {value:g} kPa and holds {held:g} kPa", OUTPUTS[0])

    def _refuse_value(self, output: str, value: float) -> None:
        """Any number can be sent: the controller and the guard have their limits."""

    def _send_step(self, output: str, value: float, still: Still, *, last: bool) -> None:
        """Command the value of this moment of a ramp or sine."""
        connection = self._opened()
        if still():
            self._put(connection, value)

    # -- valves and contact ---------------------------------------------------------------------------------------

    def switch(self, output: str, *, on: bool) -> None:
        """Energise a valve or not; the answer is what the controller holds then."""
        self._known("valve", output, VALVES)
        self._put_valve(self._opened(), output, on=on)

    def is_on(self, output: str) -> bool:
        """Whether a valve is energised."""
        self._known("valve", output, VALVES)
        return self._state(f"V {VALVES[output]}", 2)

    def level(self, name: str) -> bool:
        """Whether the contact is closed."""
        self._known("contact", name, CONTACTS)
        return self._state("D", 1)

    def _put_valve(self, connection: Connection, valve: str, *, on: bool) -> None:
        if self._state(f"V {VALVES[valve]} {int(on)}", 2, connection) != on:
            raise self._error(f"was commanded to switch to {int(on)} and did not", valve)

    # -- watchdog, and the second way -----------------------------------------------------------------------------

    def arm_watchdog(self, seconds: float) -> float:
        """Set the watch time; returns what the controller holds [s]."""
        [held] = self._numbers(f"W {seconds:.2f}", 1)
        if not 0 < held <= seconds:
            raise self._error(f"was to watch for {seconds:g} s and holds {held:g} s")
        return held

    def feed_watchdog(self) -> None:
        """Any line is a sign of life; this one asks whether it still watches."""
        if not self._numbers("W", 1)[0]:
            raise self._error("its watch time was over, or nobody set it: it has vented by itself")

    def disarm_watchdog(self) -> None:
        """End the watch; outputs stay as they are."""
        self._numbers("W 0", 1)

    def held(self) -> Mapping[str, float | str]:
        """Watch time, time since it was switched on [s], and serial number, as the controller answers now."""
        watch, uptime, serial = self._numbers("H", 3)
        return {"watchdog": watch, "uptime": uptime, "serial": f"{serial:.0f}"}

    def rescue(self, output: str, value: float) -> None:
        """Command the set-point [kPa] or a valve over a second connection."""
        self._known("output", output, (*OUTPUTS, *VALVES))
        self._following.clear()
        second = self._connect()
        try:
            if output in VALVES:
                self._put_valve(second, output, on=value != 0)
            else:
                self._put(second, value)
        finally:
            second.close()

    # -- questions ------------------------------------------------------------------------------------------------

    def _connect(self) -> Connection:
        return Connection(self._device.name, self._device.address, self._options.timeout)

    def _ask(self, question: str, count: int, connection: Connection | None = None) -> list[str]:
        """The `count` words that answer, behind the first word of the question."""
        answer = (connection or self._opened()).ask(question, monotonic() + CALL)
        word, _, text = answer.partition(" ")
        if word == "E":
            raise self._error(f'refuses "{question}": {text}')
        words = text.split(" ") if count > 1 else [text]
        if word != question.partition(" ")[0] or len(words) != count:
            raise self._unreadable(answer)
        return words

    def _numbers(self, question: str, count: int, connection: Connection | None = None) -> list[float]:
        words = self._ask(question, count, connection)
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = [math.nan]
        if not all(map(math.isfinite, values)):
            raise self._unreadable(" ".join(words))
        return values

    def _state(self, question: str, count: int, connection: Connection | None = None) -> bool:
        words = self._ask(question, count, connection)
        if words[-1] not in {"0", "1"} or words[:-1] != question.split(" ")[1:count]:
            raise self._unreadable(" ".join(words))
        return words[-1] == "1"

    def _unreadable(self, answer: str) -> DeviceError:
        return self._error(f'answers "{answer[:40]}", which is not what its page says')
