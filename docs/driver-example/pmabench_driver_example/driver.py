"""The device interface in front of the EX-2 of device.md: pressures, set-point, valves, contact, watchdog."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from time import monotonic

from pmabench_drivers.modbus.segments import refuse_nonsense, stepped
from pmabench_drivers.options import Place, Reader
from pmabench_drivers.polling import JOIN, Cycle, Samples

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import EMULATED, Block, DeviceRecord, Identity, Segment
from pmabench_driver_example.wire import Connection

CALL = 0.18
"""Longest time that a call may take, a little less than the guard waits [s]."""
STEPS = 50.0
"""Set-points a second along a ramp or sine, which this device cannot follow by itself [Hz]."""
INPUTS, OUTPUTS, CONTACTS = ("outlet", "supply"), ("outlet",), ("contact",)
VALVES = {"dump": "1", "supply": "2"}
"""Name in a bench file -> number on the wire."""


class ExampleController:
    """A pressure controller: two pressures, a set-point up to 600 kPa, dump and supply valve, a contact."""

    verified = "emulator only"
    """Once somebody has compared every value and the vent with instruments: `hardware (who, date, firmware)`."""
    emulator = "pmabench_driver_example.emulator"
    """The module whose `serve(device, plant, log)` makes the other end of the wire."""

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        reader = Reader()
        self._rate, self._timeout = _options(device, reader)
        reader.refuse(device.name)
        self._device, self._clock = device, clock
        self._connection: Connection | None = None
        self._places = [INPUTS.index(channel.input) for channel in device.channels]
        self._samples = Samples([channel.name for channel in device.channels])
        self._cycle = Cycle(f"polls {device.name}", self._poll, clock)
        self._steps = Cycle(f"leads {device.name}", self._step, clock)
        self._segment: Segment | None = None

    @classmethod
    def check(cls, device: DeviceRecord) -> Iterable[tuple[Place, str]]:
        """What is wrong with the options, each with its place; touches no device."""
        reader = Reader()
        _options(device, reader)
        return reader.problems

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Connect and ask who it is."""
        self.close()
        self._connection = self._connect()
        try:
            [answer] = self._ask("ID", 1)
            model, serial, firmware = answer.split(",")
        except (DeviceError, ValueError) as error:
            self.close()
            raise error if isinstance(error, DeviceError) else self._unreadable(answer) from None
        if not model.removeprefix(EMULATED).startswith("EX-2"):
            self.close()
            raise DeviceError(self._device.name, f'is a "{model[:40]}"; an EX-2 was expected')
        return Identity("Example", model, serial, firmware, simulated=model.startswith(EMULATED), clock="computer")

    def close(self) -> None:
        """End polling and let go of the connection."""
        connection, self._connection, self._segment = self._connection, None, None
        self._cycle.stop(JOIN)
        self._steps.stop(JOIN)
        if connection is not None:
            connection.close()

    # -- samples --------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> float:
        """Poll at `rate` [Hz], or as fast as the options allow if that is less."""
        if not 0 < rate < math.inf:
            raise DeviceError(self._device.name, f"cannot sample at {rate} Hz")
        self._opened()
        self._cycle.note(None)
        self._samples.take()
        used = min(rate, self._rate)
        self._cycle.start(used)
        return used

    def collect(self) -> Block:
        """What was polled since the last call; an error once polling has failed for a while."""
        self._cycle.refuse(self._device.name)
        return self._samples.take()

    def stop(self) -> None:
        """Poll no more."""
        self._cycle.stop()

    def _poll(self) -> None:
        asked = self._clock.now()
        try:
            values = self._numbers("P", 2)
        except DeviceError as error:
            self._cycle.note(error)
            return
        self._cycle.note(None)
        answered = self._clock.now()
        taken = round((asked + answered) / 2 * 1e9)
        self._samples.append(taken, [values[place] for place in self._places], round(answered * 1e9))

    # -- set-point ------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Command the set-point [kPa] once; the answer is what the controller holds then."""
        self._known(output, OUTPUTS)
        self._segment = None
        self._put(self._opened(), value)

    def read_back(self, output: str) -> float:
        """The set-point that the controller holds [kPa]."""
        self._known(output, OUTPUTS)
        return self._numbers("S", 1)[0]

    def _put(self, connection: Connection, value: float) -> None:
        [held] = self._numbers(f"S {value:.2f}", 1, connection)
        if abs(held - value) > 0.0051:
            raise DeviceError(self._device.name, f"was commanded {value:g} kPa and holds {held:g} kPa", OUTPUTS[0])

    def follow(self, output: str, segment: Segment) -> None:
        """Step along the segment, from its start on, or from now on if that has passed."""
        self._known(output, OUTPUTS)
        refuse_nonsense(self._device.name, output, segment)
        self._opened()
        self._steps.note(None)
        self._segment = segment
        if not self._steps.running:
            self._steps.start(STEPS)

    def _step(self) -> None:
        """Command the value of this moment; the last one ends the segment."""
        segment, connection = self._segment, self._connection
        if segment is None or connection is None:
            return
        value, over = stepped(segment, self._clock.now())
        if value is None or self._segment is not segment:
            return
        try:
            self._put(connection, value)
        except DeviceError as error:
            self._steps.note(error)
            return
        self._steps.note(None)
        if over and self._segment is segment:
            self._segment = None

    # -- valves and contact ---------------------------------------------------------------------------------------

    def switch(self, output: str, *, on: bool) -> None:
        """Energise a valve or not; the answer is what the controller holds then."""
        self._known(output, VALVES)
        self._put_valve(self._opened(), output, on=on)

    def is_on(self, output: str) -> bool:
        """Whether a valve is energised."""
        self._known(output, VALVES)
        return self._state(f"V {VALVES[output]}", 2)

    def level(self, name: str) -> bool:
        """Whether the contact is closed."""
        self._known(name, CONTACTS)
        return self._state("D", 1)

    def _put_valve(self, connection: Connection, valve: str, *, on: bool) -> None:
        if self._state(f"V {VALVES[valve]} {int(on)}", 2, connection) != on:
            raise DeviceError(self._device.name, f"was commanded to switch to {int(on)} and did not", valve)

    # -- watchdog, and the second way -----------------------------------------------------------------------------

    def arm_watchdog(self, seconds: float) -> float:
        """Set the watch time; returns what the controller holds [s]."""
        [held] = self._numbers(f"W {seconds:.2f}", 1)
        if not 0 < held <= seconds:
            raise DeviceError(self._device.name, f"was to watch for {seconds:g} s and holds {held:g} s")
        return held

    def feed_watchdog(self) -> None:
        """Any line is a sign of life; this one asks whether it still watches."""
        if not self._numbers("W", 1)[0]:
            raise DeviceError(self._device.name, "its watch time was over, or nobody set it: it has vented by itself")

    def disarm_watchdog(self) -> None:
        """End the watch; outputs stay as they are."""
        self._numbers("W 0", 1)

    def held(self) -> Mapping[str, float | str]:
        """Watch time, time since it was switched on [s], and serial number, as the controller answers now."""
        watch, uptime, serial = self._numbers("H", 3)
        return {"watchdog": watch, "uptime": uptime, "serial": f"{serial:.0f}"}

    def rescue(self, output: str, value: float) -> None:
        """Command the set-point [kPa] or a valve over a second connection."""
        self._known(output, (*OUTPUTS, *VALVES))
        self._segment, second = None, self._connect()
        try:
            if output in VALVES:
                self._put_valve(second, output, on=value != 0)
            else:
                self._put(second, value)
        finally:
            second.close()

    # -- questions ------------------------------------------------------------------------------------------------

    def _connect(self) -> Connection:
        return Connection(self._device.name, self._device.address, self._timeout)

    def _opened(self) -> Connection:
        if self._connection is None:
            raise DeviceError(self._device.name, "is not open")
        return self._connection

    def _known(self, name: str, names: Iterable[str]) -> None:
        if name not in names:
            raise DeviceError(self._device.name, f'no "{name}"{did_you_mean(name, list(names))}')

    def _ask(self, question: str, count: int, connection: Connection | None = None) -> list[str]:
        """The `count` words that answer, behind the first word of the question."""
        answer = (connection or self._opened()).ask(question, monotonic() + CALL)
        word, _, text = answer.partition(" ")
        if word == "E":
            raise DeviceError(self._device.name, f'refuses "{question}": {text}')
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
        return DeviceError(self._device.name, f'answers "{answer[:40]}", which is not what its page says')


def _options(device: DeviceRecord, reader: Reader) -> tuple[float, float]:
    """Polling rate [Hz] and time-out of one answer [s]; faults go to the reader."""
    given = reader.keys(device.options, ("options",), {"rate", "timeout"})
    rate = reader.quantity(given, "rate", ("options",), "frequency", 50.0, 1.0, 200.0)
    timeout = reader.quantity(given, "timeout", ("options",), "time", 0.1, 0.01, 0.15)
    host, _, port = device.address.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        reader.fault(("address",), f'HOST:PORT is expected, for instance "192.168.0.10:4000", not "{device.address}"')
    named = [
        *((("channels", channel.name, "input"), channel.input, INPUTS) for channel in device.channels),
        *((("outputs", output.name, "output"), output.output, OUTPUTS) for output in device.outputs),
        *((("outputs", valve.name, "output"), valve.output, tuple(VALVES)) for valve in device.valves),
        *((("interlocks", lock.name, "input"), lock.input, CONTACTS) for lock in device.interlocks),
    ]
    for place, name, names in named:
        if name not in names:
            reader.fault(place, f'no "{name}"; there is {" and ".join(names)}')
    return rate, timeout
