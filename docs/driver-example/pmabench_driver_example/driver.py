"""The device interface in front of the example controller: pressure in kPa, its set-point, a dump valve."""

from __future__ import annotations

import math
from collections.abc import Iterable
from time import monotonic

from pmabench_drivers.options import Place, Reader
from pmabench_drivers.polling import JOIN, Cycle, Samples

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import EMULATED, Block, DeviceRecord, Identity
from pmabench_driver_example.wire import Connection

CALL = 0.18
"""Longest time that a call may take, a little less than the guard waits [s]."""
PATIENCE = 0.25
"""So long polling may fail before `collect` says so [s]."""
INPUT, OUTPUT, VALVE = "pressure", "pressure", "dump"


class ExampleController:
    """A pressure controller: measures, takes a set-point up to 600 kPa, switches a dump valve."""

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
        self._samples = Samples([channel.name for channel in device.channels])
        self._cycle = Cycle(f"polls {device.name}", self._poll, clock)
        self._failing: float | None = None
        self._failure: DeviceError | None = None

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
        self._connection = Connection(self._device.name, self._device.address, self._timeout)
        try:
            told = self._ask("ID").split(",")
        except DeviceError:
            self.close()
            raise
        if len(told) != 3 or not told[0].removeprefix(EMULATED).startswith("EX-"):
            self.close()
            raise DeviceError(self._device.name, f'answers "{",".join(told)[:60]}": an EX controller was expected')
        model, serial, firmware = told
        return Identity("Example", model, serial, firmware, simulated=model.startswith(EMULATED))

    def close(self) -> None:
        """End polling and let go of the connection."""
        connection, self._connection = self._connection, None
        self._cycle.stop(JOIN)
        if connection is not None:
            connection.close()

    # -- samples --------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> float:
        """Poll at `rate` [Hz], or as fast as the options allow if that is less."""
        if not 0 < rate < math.inf:
            raise DeviceError(self._device.name, f"cannot sample at {rate} Hz")
        self._opened()
        self._failing = self._failure = None
        self._samples.take()
        used = min(rate, self._rate)
        self._cycle.start(used)
        return used

    def collect(self) -> Block:
        """What was polled since the last call; an error once polling has failed for a while."""
        if self._cycle.broken is not None:
            raise DeviceError(self._device.name, f"polling broke off: {self._cycle.broken}")
        if self._failing is not None and self._failure is not None and self._clock.now() - self._failing > PATIENCE:
            raise self._failure
        return self._samples.take()

    def stop(self) -> None:
        """Poll no more."""
        self._cycle.stop()

    def _poll(self) -> None:
        asked = self._clock.now()
        try:
            value = self._number("P", self._ask("P"))
        except DeviceError as error:
            self._failure = error
            self._failing = asked if self._failing is None else self._failing
            return
        self._failing, answered = None, self._clock.now()
        taken = round((asked + answered) / 2 * 1e9)
        self._samples.append(taken, [value] * len(self._device.channels), round(answered * 1e9))

    # -- commands -------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Command the set-point [kPa] once; the answer is what the controller holds then."""
        self._known(output, OUTPUT)
        held = self._number("S", self._ask(f"S {value:.2f}"))
        if abs(held - value) > 0.0051:
            raise DeviceError(self._device.name, f"was commanded {value:g} kPa and holds {held:g} kPa", output)

    def read_back(self, output: str) -> float:
        """The set-point that the controller holds [kPa]."""
        self._known(output, OUTPUT)
        return self._number("S", self._ask("S"))

    def switch(self, output: str, *, on: bool) -> None:
        """Energise the valve or not; the answer is what the controller holds then."""
        self._known(output, VALVE)
        if self._held(self._ask(f"V {int(on)}")) != on:
            raise DeviceError(self._device.name, f"was told to switch to {int(on)} and did not", output)

    def is_on(self, output: str) -> bool:
        """Whether the valve is energised."""
        self._known(output, VALVE)
        return self._held(self._ask("V"))

    # -- questions ------------------------------------------------------------------------------------------------

    def _opened(self) -> Connection:
        if self._connection is None:
            raise DeviceError(self._device.name, "is not open")
        return self._connection

    def _ask(self, text: str) -> str:
        answer = self._opened().ask(text, monotonic() + CALL)
        if answer.startswith("E "):
            raise DeviceError(self._device.name, f'refuses "{text}": {answer[2:]}')
        return answer

    def _known(self, output: str, name: str) -> None:
        if output != name:
            raise DeviceError(self._device.name, f'no output "{output}"{did_you_mean(output, [name])}')

    def _number(self, word: str, answer: str) -> float:
        told, _, text = answer.partition(" ")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if told != word or not math.isfinite(value):
            raise DeviceError(self._device.name, f'answers "{answer[:40]}", which is no number')
        return value

    def _held(self, answer: str) -> bool:
        if answer not in {"V 0", "V 1"}:
            raise DeviceError(self._device.name, f'answers "{answer[:40]}", which is no state of a valve')
        return answer == "V 1"


def _options(device: DeviceRecord, reader: Reader) -> tuple[float, float]:
    """Polling rate [Hz] and time-out of one answer [s]; faults go to the reader."""
    given = reader.keys(device.options, ("options",), {"rate", "timeout"})
    rate = reader.quantity(given, "rate", ("options",), "frequency", 50.0, 1.0, 200.0)
    timeout = reader.quantity(given, "timeout", ("options",), "time", 0.1, 0.01, 0.15)
    host, _, port = device.address.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        reader.fault(("address",), f'HOST:PORT is expected, for instance "192.168.0.10:4000", not "{device.address}"')
    for channel in device.channels:
        if channel.input != INPUT:
            reader.fault(("channels", channel.name, "input"), f'no input "{channel.input}"; there is "{INPUT}"')
    for output in device.outputs:
        if output.output != OUTPUT:
            reader.fault(("outputs", output.name, "output"), f'no output "{output.output}"; there is "{OUTPUT}"')
    for valve in device.valves:
        if valve.output != VALVE:
            reader.fault(("outputs", valve.name, "output"), f'no valve "{valve.output}"; there is "{VALVE}"')
    return rate, timeout
