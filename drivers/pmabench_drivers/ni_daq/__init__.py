"""NI multifunction devices like the USB-6215, through NI-DAQmx on this computer or behind NI's gRPC server.

`options`: options of a bench file; `connection`: the only part that uses NI's package `nidaqmx`; here: the device
interface; `emulated`, `emulated_tasks`: NI's server with one device on the simulated muscle.

A thread fetches the samples of one start and numbers them; their time is their number over the rate that NI-DAQmx
reports. The device's clock starts at the bench time of the start.
"""

from __future__ import annotations

import math
import threading
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from time import monotonic

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block, DeviceRecord, Identity, OutputRecord
from pmabench_drivers.ni_daq.connection import Connection
from pmabench_drivers.ni_daq.options import Input, Options, read_options
from pmabench_drivers.shared.device import Led
from pmabench_drivers.shared.link import JOIN, Cycle, Pace, Samples, Still, Unanswered

FETCH = 0.17
"""Longest time of a fetch [s]."""
LOOK = 50.0
"""Rate at which waiting samples are fetched [Hz]."""
PATIENCE = 0.25
"""Time without a sample after which `collect` raises an error [s]."""
SLIP = 0.1
"""Largest increase of the delay of all samples of a second [s]."""
BEYOND = 1.2
"""Largest possible value of a converter, relative to its range."""
CALL = 0.17
"""Longest time of a call [s]."""
ANSWER = 0.1
"""Longest wait for the answer to a command, before the line itself is read [s]."""
STEP = 0.06
"""Longest time of a step of a ramp, so that a command that ends the ramp still has its time [s]."""
OPEN = 1.8
LATE, LOOSE = 0.1, 0.02
"""Delay after which a looped output is compared [s], and its tolerance as a fraction of its limits [1]."""


class Sampling:
    """Sampling from one start to its end; separate objects keep the rest of an earlier start from affecting it."""

    def __init__(
        self, device: str, names: Sequence[str], inputs: Sequence[Input], link: Connection, rate: float, clock: Clock
    ) -> None:
        self._device, self._inputs, self._link, self._rate, self._clock = device, inputs, link, rate, clock
        self._names, self._samples = tuple(names), Samples(names)
        self._cycle = Cycle(f"ni-daq {device}", self._fetch, clock)
        self._number = 0
        self._unsure = True
        """Whether the device must be asked for the number of the next sample."""
        self._pace = Pace(SLIP)
        self._failure = self._unheard = ""
        self.newest: tuple[float, Mapping[str, float]] = (-math.inf, {})
        """Time of the newest sample [s, bench time], and its values by channel [V]."""
        self.lost = 0
        """Samples that were taken and did not arrive; each is a gap in the times."""

    def begin(self, start: float) -> None:
        """Start fetching; `start` is the time of sample 0 [s, bench time]."""
        self.start = start
        self._heard = monotonic()
        self._cycle.start(LOOK)

    def end(self) -> None:
        """Stop fetching; may be called again."""
        self._cycle.stop(JOIN)

    def collect(self) -> Block:
        """Samples since the last call; once all are returned, raises DeviceError if no more arrive."""
        block = self._samples.take()
        if len(block.time):
            return block
        if why := self._failure or str(self._cycle.broken or ""):
            raise DeviceError(self._device, f"sampling broke off: {why}")
        if (silent := monotonic() - self._heard) > max(PATIENCE, 3 / self._rate):
            raise DeviceError(self._device, ": ".join(filter(None, [f"no sample for {silent:.2f} s", self._unheard])))
        return block

    def _fetch(self) -> None:
        """Fetch all waiting samples, in the fetching thread."""
        if self._failure:
            return
        try:
            with self._link.calls(FETCH):
                if self._unsure:
                    self._find_place(self._link.position())
                columns = self._link.read()
        except Unanswered as error:  # the requested samples may be lost: the next fetch finds out how many
            self._unsure, self._unheard = True, error.message
            return
        except DeviceError as error:
            self._failure = error.message
            return
        self._unheard = ""
        if columns:
            self._keep(columns)

    def _find_place(self, position: int) -> None:
        """Continue at the sample that the device reports as next; missing ones before it are a gap."""
        if position < self._number:
            raise DeviceError(self._device, f"is at sample {position} after {self._number}: it began again")
        self.lost += position - self._number
        self._number, self._unsure = position, False

    def _keep(self, columns: list[array[float]]) -> None:
        now, first = self._clock.now(), self._number
        self._number += len(columns[0])
        for item, column in zip(self._inputs, columns, strict=True):
            if strange := [value for value in column if not abs(value) <= BEYOND * item.span]:
                self._failure = f"{item.name} gives {strange[0]:g} V at a range of {item.span:g} V"
                return
        if behind := self._pace.behind(self.start + (self._number - 1) / self._rate, now):
            late = "late" if behind > 0 else "early"
            self._failure = f"samples come {abs(behind):.2f} s too {late} for {self._rate:g} Hz"
            return
        self._heard = monotonic()
        self._samples.extend(first, columns, self.start, self._rate, now)
        last = self.start + (self._number - 1) / self._rate
        self.newest = last, {name: column[-1] for name, column in zip(self._names, columns, strict=True)}


class NiDaq(Led[Connection]):
    """Inputs `ai0`... [V], outputs `ao0`, `ao1` [V], lines `port0/line0`...; by NI-DAQmx here or NI's gRPC server."""

    emulator = "pmabench_drivers.ni_daq.emulated"
    read_options = staticmethod(read_options)
    _options: Options

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._sampling: Sampling | None = None
        self._turn = threading.Lock()
        self._second: Connection | None = None
        self._held: dict[str, float] = {}
        self._sent: dict[str, float] = {}
        """When each output was last set [s, bench time]."""
        measured = {channel.name: channel for channel in device.channels}
        commands = {o.output: "{}_command{}{}".format(*o.name.partition("_")) for o in device.outputs}
        self._loops = {output: measured[name] for output, name in commands.items() if name in measured}
        """Channel into which each output is looped, if any."""

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Find the device, check that it has everything the bench uses, prepare its tasks; outputs stay as they are."""
        self.close()
        link = self._link = Connection(self._device.name, self._options)
        with self._closed_on_error():
            with link.calls(OPEN):
                link.load()
            until = monotonic() + OPEN
            with link.calls(OPEN):
                identity = link.open()
            if self._options.server:
                second = self._second = Connection(self._device.name, self._options)
                with second.calls(until - monotonic()):
                    second.attach()
        return identity

    def close(self) -> None:
        """Stop sampling and stepping and close the connections; outputs stay as they are."""
        self._following.clear()
        self._end_sampling()
        self._steps.stop(JOIN)
        link, self._link = self._link, None
        second, self._second = self._second, None
        self._held = {}
        if second is not None:
            second.hang_up()
        if link is not None:
            with suppress(DeviceError), link.calls(CALL):
                link.close()

    # -- samples --------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> float:
        """Sample all channels together at `rate` [Hz]; returns the rate that NI-DAQmx reports."""
        self._refuse_rate(rate)
        link = self._opened()
        self._end_sampling()
        with link.calls(CALL):
            before = self._clock.now()
            used = link.begin(rate)
        names, inputs = list(self._options.inputs), list(self._options.inputs.values())
        sampling = self._sampling = Sampling(self._device.name, names, inputs, link, used, self._clock)
        sampling.begin((before + self._clock.now()) / 2)
        return used

    def collect(self) -> Block:
        """Samples since the last call; once all are returned, raises DeviceError if no more arrive."""
        self._steps.refuse(self._device.name, "stepping", once=True)
        if self._sampling is not None:
            return self._sampling.collect()
        return Samples([channel.name for channel in self._device.channels]).take()

    def stop(self) -> None:
        """Stop sampling; a ramp in progress continues."""
        if self._sampling is not None:
            self._end_sampling()
            with self._opened().calls(CALL):
                self._opened().end()

    def _end_sampling(self) -> None:
        sampling, self._sampling = self._sampling, None
        if sampling is not None:
            sampling.end()

    @property
    def lost(self) -> int:
        """Samples since the start that were taken and did not arrive; each is a gap in the times."""
        return 0 if self._sampling is None else self._sampling.lost

    # -- outputs ---------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Set an output [V] once."""
        self._following.pop(output, None)
        self._steps.note(None)
        self._put(self._opened(), output, value)

    cannot_read_back = "NI-DAQmx cannot be asked what an output gives"
    """Why `read_back` answers from memory; the conformance suite then reports that it was not checked."""

    def read_back(self, output: str) -> float:
        """Last value of the output [V] acknowledged by NI-DAQmx, or the measured one if that differs.

        An output is measured if it is looped into a channel (`pressure_command` of `pressure`). A restart of the device
        is not seen here, but by `is_on`, `held` and the end of its samples.
        """
        record = self._output(output)
        with self._command_turn():  # a step of a ramp may be in progress
            if output in self._held:
                return self._measured(record, self._held[output])
        message = "what it gives is not known: nothing was set since it was opened, or the answer was lost"
        raise self._error(message, output)

    def _measured(self, record: OutputRecord, sent: float) -> float:
        """The measured value [V] of a looped output if another program has changed it, else `sent`."""
        channel, sampling = self._loops.get(record.output), self._sampling
        if channel is None or sampling is None:
            return sent
        t, volts = sampling.newest
        value = channel.scale.to_si(volts.get(channel.name, math.nan))
        slack = LOOSE * (record.high - record.low) + channel.calibration.uncertainty(value)
        other = t > self._sent[record.output] + LATE and abs(value - record.scale.to_si(sent)) > slack
        return float(record.scale.to_raw(value)) if other else sent

    def held(self) -> Mapping[str, float | str]:
        """Its serial number, which NI-DAQmx only gives while the device is present; it has no watchdog and no uptime.

        Raises DeviceError if its tasks are gone: after a restart its outputs are unknown.
        """
        link = self._opened()
        with link.calls(CALL):
            link.refuse_lost()
            return {"serial": link.serial()}

    def rescue(self, output: str, value: float) -> None:
        """Set an output [V] or a valve line over the second connection."""
        self._following.pop(output, None)
        link = self._second or self._opened()
        if output in self._outputs:
            self._put(link, output, value)
        else:
            self._put_line(link, output, on=value != 0)

    def _put(self, link: Connection, output: str, value: float) -> None:
        self._output(output)
        self._refuse_value(output, value)
        until = monotonic() + CALL
        with self._command_turn():
            self._send(link, output, value, until - monotonic())

    @contextmanager
    def _command_turn(self) -> Iterator[None]:
        """Wait for a step in progress; a call that hangs is not waited for."""
        turn = self._turn.acquire(timeout=CALL / 2)
        try:
            yield
        finally:
            if turn:
                self._turn.release()

    def _send(self, link: Connection, output: str, value: float, within: float) -> None:
        self._held.pop(output, None)
        try:
            with link.calls(within, output):
                link.write(output, value)
        except Unanswered as error:
            message = f"{error.message}; whether it took {value:g} V is not known"
            raise Unanswered(self._device.name, message, output) from None
        self._sent[output] = self._clock.now()
        self._held[output] = value

    # -- ramps and sines -------------------------------------------------------------------------------------------

    def _refuse_value(self, output: str, value: float) -> None:
        if not abs(value) <= 10.0 + 1e-9:
            raise self._error(f"cannot be set to {value:g} V", output)

    def _send_step(self, output: str, value: float, still: Still, *, last: bool) -> None:
        """Set a value, unless a command is in progress: the next step comes soon."""
        link = self._link
        if link is not None and self._turn.acquire(blocking=False):
            try:
                if still():
                    self._send(link, output, value, STEP)
            finally:
                self._turn.release()
        elif last:
            raise self._error("has not taken the end of the ramp yet", output)

    # -- lines -----------------------------------------------------------------------------------------------------

    def switch(self, output: str, *, on: bool) -> None:
        """Set a valve's line once; the line is then read to check it."""
        self._put_line(self._opened(), output, on=on)

    def is_on(self, output: str) -> bool:
        """Whether a valve's line is high."""
        self._known("valve output", output, self._options.valves)
        return self._level(output, CALL)

    def level(self, name: str) -> bool:
        """Whether an interlock's line is high."""
        self._known("input", name, self._options.levels)
        return self._level(name, CALL)

    def _put_line(self, link: Connection, line: str, *, on: bool) -> None:
        self._known("valve output", line, self._options.valves)
        until, lost = monotonic() + CALL, ""
        try:
            with link.calls(ANSWER, line):
                link.write(line, on)
        except Unanswered as error:
            lost = f"{error.message}, and "
        try:
            with link.calls(until - monotonic(), line):
                high = link.level(line)
        except Unanswered as error:
            message = f"{lost or 'was commanded, and '}whether it took {int(on)} is not known ({error.message})"
            raise Unanswered(self._device.name, message, line) from None
        if high != on:
            message = f"{lost or f'was commanded {int(on)} and '}its line is {'high' if high else 'low'}"
            raise self._error(message, line)

    def _level(self, line: str, within: float) -> bool:
        link = self._opened()
        with link.calls(within, line):
            return link.level(line)
