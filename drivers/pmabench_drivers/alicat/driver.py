"""The device interface in front of an Alicat controller; knows no protocol.

It has no watchdog: a controller that hears nothing keeps its last set-point. One thread polls and steps ramps and
sines; calls and polls take turns on the one line.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from time import monotonic
from typing import Protocol

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import Block, DeviceRecord, Identity, OutputRecord, Segment
from pmabench_drivers.alicat.options import ASCII, read_options
from pmabench_drivers.alicat.reading import NO_VALUE, OVER, Reading, trouble
from pmabench_drivers.modbus.segments import refuse_nonsense, stepped
from pmabench_drivers.options import Place, Reader
from pmabench_drivers.polling import JOIN, Cycle, Samples

CALL = 0.18
"""Longest time that a call takes [s]; the guard gives up at 0.2 s."""
OPEN = 1.9


class Link(Protocol):
    """What the driver needs of a protocol; every deadline is in seconds of `time.monotonic`."""

    exhausting: bool
    """Whether this program has opened the exhaust."""

    @property
    def fastest(self) -> float:
        """Polls a second that the line can carry [Hz]."""

    def open(self, deadline: float) -> Identity:
        """Connect and identify."""

    def close(self) -> None:
        """Let go."""

    def poll(self, deadline: float) -> Reading | None:
        """One reading, or None where there is none this time."""

    def command(
        self, value: float, deadline: float, tolerance: float, still: Callable[[], bool] = ...
    ) -> Reading | None:
        """A set-point, proven by what the device holds."""

    def vent(self, value: float, deadline: float, tolerance: float, still: Callable[[], bool] = ...) -> Reading | None:
        """The set-point that vents, with the exhaust where there is one."""

    def held(self, deadline: float) -> float:
        """The set-point that the device holds."""

    def reported(self, deadline: float) -> Mapping[str, float | str]:
        """What else it holds and reports in one short answer."""


class AlicatController:
    """A pressure controller: measures `pressure` and `set_point`, takes the output `pressure`.

    A set-point at or below the output's safe value vents: over Modbus with the exhaust of a dual-valve controller.
    """

    emulator = "pmabench_drivers.alicat.emulator"

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        reader = Reader()
        self._options = read_options(device, reader)
        reader.refuse(device.name)
        self._device, self._clock = device, clock
        self._outputs = {output.output: output for output in device.outputs}
        self._samples = Samples([channel.name for channel in device.channels])
        self._inputs = [channel.input for channel in device.channels]
        self._cycle = Cycle(f"alicat {device.name}", self._tick, clock)
        self._following: Segment | None = None
        self._link: Link | None = None
        self._streaming = False

    @classmethod
    def check(cls, device: DeviceRecord) -> Iterable[tuple[Place, str]]:
        """What is wrong with the options, each with its place; touches no device."""
        reader = Reader()
        read_options(device, reader)
        return reader.problems

    @classmethod
    def fastest(cls, device: DeviceRecord) -> float:
        """Highest rate at which it is polled [Hz]; the line may allow less."""
        return read_options(device, Reader()).rate

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Connect and learn what the device tells of itself; nothing is commanded."""
        self.close()
        link = self._new_link()
        try:
            identity = link.open(monotonic() + OPEN)
        except DeviceError:
            link.close()
            raise
        self._link = link
        return identity

    def close(self) -> None:
        """End polling and let go of the port; the device keeps its set-point."""
        self._following, self._streaming = None, False
        link, self._link = self._link, None
        self._cycle.stop(JOIN)
        if link is not None:
            link.close()

    def _new_link(self) -> Link:
        given = self._device.name, self._device.address, self._options, self._clock
        if self._options.protocol == ASCII:
            from pmabench_drivers.alicat.ascii_link import AsciiLink

            return AsciiLink(*given)
        from pmabench_drivers.alicat.modbus_link import ModbusLink

        return ModbusLink(*given)

    # -- samples --------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> float:
        """Poll at `rate` [Hz], or as fast as the options and the line allow if that is less."""
        if not 0 < rate < math.inf:
            raise DeviceError(self._device.name, f"cannot sample at {rate} Hz")
        used = min(rate, self._options.rate, self._opened().fastest)
        self._cycle.note(None)
        self._samples.take()
        self._streaming = True
        self._cycle.start(used)
        return used

    def collect(self) -> Block:
        """What was polled since the last call; an error once polls fail, or a status is wrong, for 0.25 s."""
        self._cycle.refuse(self._device.name)
        return self._samples.take()

    def stop(self) -> None:
        """Poll no more; a ramp under way goes on."""
        self._streaming = False
        if self._following is None:
            self._cycle.stop()

    @property
    def missed(self) -> int:
        """Polls that fell out because the device or the machine was late."""
        return self._cycle.missed

    def _tick(self) -> None:
        """One turn of the thread: the next step of a segment, whose answer may be a reading, or a poll."""
        link = self._link
        if link is None:
            return
        failure: DeviceError | None = None
        reading: Reading | None = None
        try:
            reading = self._step(link)
        except DeviceError as error:
            failure = error
        try:
            if self._streaming and reading is None and failure is None:
                reading = link.poll(monotonic() + self._options.timeout)
        except DeviceError as error:
            failure = error
        if reading is not None:
            wrong = trouble(reading.status, exhausting=link.exhausting)
            if wrong:
                failure = DeviceError(self._device.name, wrong)
            if self._streaming and not reading.status & NO_VALUE:
                self._take(reading)
        elif failure is None:
            return  # nothing was learned
        self._cycle.note(failure)

    def _take(self, reading: Reading) -> None:
        values = {
            "pressure": math.nan if OVER in reading.status else reading.pressure,
            "set_point": reading.set_point,
        }
        time = (reading.asked + reading.answered) / 2
        row = [values[name] for name in self._inputs]
        self._samples.append(round(time * 1e9), row, round(reading.answered * 1e9))

    # -- commands -------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Command a set-point once; what the device then holds decides. At or below the safe value it vents."""
        record = self._output(output)
        self._following = None
        link, deadline = self._opened(), monotonic() + CALL
        if self._vents(record, value):
            link.vent(value, deadline, record.resolution / 2)
        else:
            link.command(value, deadline, record.resolution / 2)

    def read_back(self, output: str) -> float:
        """The set-point that the device holds."""
        self._output(output)
        return self._opened().held(monotonic() + CALL)

    def held(self) -> Mapping[str, float | str]:
        """Where its set-point comes from, as it says itself over ASCII from firmware 10v05 on; else nothing.

        It has no watchdog and reports no uptime: a restart shows in its set-point, which `read_back` asks for.
        """
        return self._opened().reported(monotonic() + CALL)

    def follow(self, output: str, segment: Segment) -> None:
        """Step along the segment at the poll rate, from its start on, or from now on if that has passed."""
        self._output(output)
        refuse_nonsense(self._device.name, output, segment)
        link = self._opened()
        self._following = segment
        if not self._cycle.running:
            self._cycle.start(min(self._options.rate, link.fastest))

    def _step(self, link: Link) -> Reading | None:
        """Send the set-point of this moment of a segment; the last one ends it, and vents where it is low enough."""
        segment = self._following
        if segment is None:
            return None
        [record] = self._outputs.values()
        value, over = stepped(segment, self._clock.now(), record.resolution)
        if value is None:
            return None
        last = over and self._vents(record, value)
        deadline = monotonic() + (CALL if last else self._options.timeout)
        send = link.vent if last else link.command
        reading = send(value, deadline, record.resolution / 2, lambda: self._following is segment)
        if over and self._following is segment:
            self._following = None
        return reading

    def _vents(self, record: OutputRecord, value: float) -> bool:
        """Whether a set-point is that of the safe state, or beyond it."""
        return value <= float(record.scale.to_raw(record.safe)) + 1e-9

    def _output(self, output: str) -> OutputRecord:
        record = self._outputs.get(output)
        if record is None:
            raise DeviceError(self._device.name, f'no output "{output}"{did_you_mean(output, self._outputs)}')
        return record

    def _opened(self) -> Link:
        link = self._link
        if link is None:
            raise DeviceError(self._device.name, "is not open")
        return link
