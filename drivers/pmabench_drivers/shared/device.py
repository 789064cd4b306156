"""Common part of all drivers: read options, look names up, poll, and step along ramps and sines.

A driver derives from `Driver`; from `Polled` if a thread of the driver requests each sample; from `Stepped`
if the device only takes single set-points; from `Controlled` if one thread does both. Devices that send by
themselves: `serial_port`. Uses no connection. Standard library only.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, NotSent, did_you_mean
from pmabench.bench.interface import Block, DeviceRecord, OutputRecord, Segment
from pmabench_drivers.shared.link import Cycle, Samples, Still, opened
from pmabench_drivers.shared.options import Place, Reader, options_of

STEPS = 100.0
"""Rate at which ramps and sines are stepped where no polling sets it [Hz]."""
MOTIONS = ("length", "angle")
"""Quantities of outputs that move."""
HURRY = 1.5
"""After a stall of computer or link, a motion is led back to its ramp or sine at most so many times as fast as that."""
STALL = 0.05
"""A step that comes so late [s] comes after a stall."""


def refuse_nonsense(device: str, output: str, segment: Segment) -> None:
    """Raise DeviceError if a segment is neither a ramp nor a sine, has a number that is not finite, or has no rate."""
    ends = (segment.start, segment.origin, segment.target, segment.amplitude)
    paces = (segment.rate, segment.frequency, segment.cycles)
    if segment.kind not in {"ramp", "sine"} or not all(map(math.isfinite, (*ends, *paces))):
        raise DeviceError(device, f"cannot follow {segment}", output)
    if not (segment.rate if segment.kind == "ramp" else segment.frequency) > 0:
        raise DeviceError(device, f"a {segment.kind} needs a rate above zero", output)


def stepped(segment: Segment, now: float, resolution: float = 0.0) -> tuple[float | None, bool]:
    """Set-point [device units] at bench time `now` [s], and whether it is the last one; None before the start.

    On the device's steps if it has any, and never outside the segment: between origin and target of a ramp, between
    the crests of a sine.
    """
    if (since := now - segment.start) < 0:
        return None, False
    if segment.kind == "ramp":
        low, high = sorted((segment.origin, segment.target))
        if (way := abs(segment.rate) * since) >= high - low:
            return segment.target, True
        return _on_step(
            segment.origin + math.copysign(way, segment.target - segment.origin), resolution, low, high
        ), False
    if since >= segment.cycles / segment.frequency:
        return segment.origin, True
    swing = abs(segment.amplitude)
    value = segment.origin + segment.amplitude * math.sin(2 * math.pi * segment.frequency * since)
    return _on_step(value, resolution, segment.origin - swing, segment.origin + swing), False


def _on_step(value: float, resolution: float, low: float, high: float) -> float:
    """The nearest whole step, limited to `low` to `high`."""
    if resolution > 0:
        value = round(value / resolution) * resolution
    return min(max(value, low), high)


class Closes(Protocol):
    """A connection to a device."""

    def close(self) -> None:
        """Close it; may be called again."""


L = TypeVar("L", bound=Closes)
"""The kind of connection that a driver has."""


class Driver(ABC, Generic[L]):
    """One device of a bench with its options, and while it is open its connection."""

    _options: Any
    _link: L | None = None

    @staticmethod
    @abstractmethod
    def read_options(device: DeviceRecord, reader: Reader) -> Any:
        """The options of this family; reports every problem to the reader."""

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        self._options = options_of(device, self.read_options)
        self._device, self._clock = device, clock
        self._outputs = {output.output: output for output in device.outputs}

    @classmethod
    def check(cls, device: DeviceRecord) -> Iterable[tuple[Place, str]]:
        """Errors of the options, each with its place; touches no device."""
        reader = Reader()
        cls.read_options(device, reader)
        return reader.problems

    @abstractmethod
    def close(self) -> None:
        """Close the connection; may be called again."""

    def _opened(self) -> L:
        """The connection; raises DeviceError if the device is not open."""
        return opened(self._link, self._device.name)

    def _hang_up(self) -> None:
        """Close the connection, if there is one."""
        link, self._link = self._link, None
        if link is not None:
            link.close()

    @contextmanager
    def _closed_on_error(self) -> Iterator[None]:
        """Close everything if opening fails."""
        try:
            yield
        except DeviceError:
            self.close()
            raise

    def _error(self, message: str, what: str = "") -> DeviceError:
        return DeviceError(self._device.name, message, what)

    def _known(self, kind: str, name: str, known: Iterable[str]) -> None:
        """Refuse a name that is not known."""
        if name not in (names := list(known)):
            raise self._error(f'no {kind} "{name}"{did_you_mean(name, names)}')

    def _output(self, output: str) -> OutputRecord:
        self._known("output", output, self._outputs)
        return self._outputs[output]

    def _refuse_rate(self, rate: float) -> None:
        if not 0 < rate < math.inf:
            raise self._error(f"cannot sample at {rate} Hz")


class Rated(Driver[L]):
    """A device whose options have its highest `rate` of sampling [Hz]."""

    @classmethod
    def fastest(cls, device: DeviceRecord) -> float:
        """Highest rate of its options [Hz]; its line may allow less."""
        return float(cls.read_options(device, Reader()).rate)


class Polled(Rated[L]):
    """A device that is read for each sample, by a thread that calls `_tick` at absolute deadlines."""

    _doing = "polling"
    """Activity of the thread, for error messages."""

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._samples = Samples([channel.name for channel in device.channels])
        self._cycle = Cycle(f"polls {device.name}", self._tick, clock)
        self._streaming = False

    @abstractmethod
    def _tick(self) -> None:
        """One turn of the thread."""

    def _fastest(self) -> float:
        """Highest rate of the open device [Hz]; raises DeviceError if it is not open."""
        return float(self._options.rate)

    def start(self, rate: float) -> float:
        """Poll at `rate` [Hz], or as fast as options and line allow if that is less."""
        self._refuse_rate(rate)
        used = min(rate, self._fastest())
        self._cycle.note(None)
        self._samples.take()
        self._streaming = True
        self._cycle.start(used)
        return used

    def collect(self) -> Block:
        """Samples since the last call; raises DeviceError once polls or steps have failed for 0.25 s."""
        self._cycle.refuse(self._device.name, self._doing)
        return self._samples.take()

    def stop(self) -> None:
        """Stop polling."""
        self._streaming = False
        self._cycle.stop()

    @property
    def missed(self) -> int:
        """Polls left out because the device or the computer was late."""
        return self._cycle.missed

    def _keep(self, values: Iterable[float], asked: float, answered: float) -> None:
        """Keep the values of one poll, taken halfway between request and answer [s, bench time]."""
        self._samples.append(round((asked + answered) / 2 * 1e9), list(values), round(answered * 1e9))


class Stepped(Driver[L]):
    """A device that takes single set-points: the driver sends those of a ramp or sine one by one."""

    _following: dict[str, Segment]
    """Output -> its present segment."""

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        self._following = {}
        self._led: dict[str, tuple[Segment, float, float]] = {}
        """Output -> the segment of its last step, the moment of it that was sent, and when [s, bench time]."""
        self.unanswered = -math.inf
        """When a step was last sent whose outcome is unknown [s, bench time]."""
        super().__init__(device, clock)

    @abstractmethod
    def _begin_steps(self) -> None:
        """Start the thread that calls `_step`, unless it runs; raises DeviceError if the device is not open."""

    @abstractmethod
    def _refuse_value(self, output: str, value: float) -> None:
        """Refuse a value [device units] that the output cannot take."""

    @abstractmethod
    def _send_step(self, output: str, value: float, still: Still, *, last: bool) -> None:
        """Send a set-point [device units], unless `still()` is false when the line is free."""

    def follow(self, output: str, segment: Segment) -> None:
        """Step along the segment from its start, or from now if that has passed."""
        self._output(output)
        refuse_nonsense(self._device.name, output, segment)
        swing = abs(segment.amplitude)
        for value in (segment.origin - swing, segment.origin + swing, segment.target):
            self._refuse_value(output, value)
        self._begin_steps()
        self._following[output] = segment

    def _step(self) -> DeviceError | None:
        """Send the present value of every segment, and end a segment with its last; returns the first error."""
        failure: DeviceError | None = None
        for output, segment in list(self._following.items()):
            value, last = stepped(segment, self._moment(output, segment), self._outputs[output].resolution)
            if value is None:
                continue
            still = partial(self._follows, output, segment)
            try:
                self._send_step(output, value, still, last=last)
            except DeviceError as error:
                self.unanswered = self.unanswered if isinstance(error, NotSent) else self._clock.now()
                failure = failure or (error if still() else None)
            else:
                if last and still():
                    self._following.pop(output, None)
        return failure

    def _moment(self, output: str, segment: Segment) -> float:
        """The moment of a segment [s, bench time] whose value is sent now; a motion does not leap after a stall."""
        now = self._clock.now()
        if self._outputs[output].quantity not in MOTIONS or now < segment.start:
            return now
        of, led, before = self._led.get(output, (None, 0.0, 0.0))
        if of is not segment:
            led = before = segment.start
        moment = min(now, led + HURRY * min(now - before, STALL))
        self._led[output] = segment, moment, now
        return moment

    def _follows(self, output: str, segment: Segment) -> bool:
        return self._following.get(output) is segment


class Led(Stepped[L]):
    """A device that samples by itself; a thread of the driver steps ramps and sines, 100 times a second."""

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._steps = Cycle(f"leads {device.name}", self._lead, clock)

    def _begin_steps(self) -> None:
        self._opened()
        self._steps.note(None)
        if not self._steps.running:
            self._steps.start(STEPS)

    def _lead(self) -> None:
        self._steps.note(self._step())


class Controlled(Stepped[L], Polled[L]):
    """A polled device with set-points, whose one thread polls and steps."""

    def _begin_steps(self) -> None:
        rate = self._fastest()
        if not self._cycle.running:
            self._cycle.start(rate)

    def stop(self) -> None:
        """Stop polling; a ramp in progress continues."""
        self._streaming = False
        if not self._following:
            self._cycle.stop()
