"""Samples of one start: fetched in a thread of their own, numbered, timed by their number over the rate, looked at."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from time import monotonic

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block
from pmabench_drivers.ni_daq.connection import Connection
from pmabench_drivers.ni_daq.options import Input
from pmabench_drivers.shared.link import Unanswered
from pmabench_drivers.shared.pace import Pace
from pmabench_drivers.shared.polling import JOIN, Cycle, Samples

CALL = 0.17
"""Longest time of a look [s]."""
LOOK = 50.0
"""Waiting samples are fetched so often [Hz]."""
PATIENCE = 0.25
"""So long no sample may come before `collect` says so [s]."""
SLIP = 0.1
"""More than this the samples of a whole second may not be later than they were [s]."""
BEYOND = 1.2
"""No converter gives more than so many times its range."""


class Sampling:
    """From one start to its end; what an earlier start left under way cannot touch it."""

    def __init__(
        self, device: str, names: Sequence[str], inputs: Sequence[Input], link: Connection, rate: float, clock: Clock
    ) -> None:
        self._device, self._inputs, self._link, self._rate, self._clock = device, inputs, link, rate, clock
        self._samples = Samples(names)
        self._cycle = Cycle(f"ni-daq {device}", self._fetch, clock)
        self._number = 0
        self._unsure = True
        """Whether the device is asked which sample comes next."""
        self._pace = Pace(SLIP)
        self._failure = self._unheard = ""
        self.lost = 0
        """Samples that were taken and never came; each is a gap in the times."""

    def begin(self, start: float) -> None:
        """Fetch from now on; `start` is the time of sample 0 [s, bench time]."""
        self.start = start
        self._heard = monotonic()
        self._cycle.start(LOOK)

    def end(self) -> None:
        """Fetch no more; harmless when repeated."""
        self._cycle.stop(JOIN)

    def collect(self) -> Block:
        """What came since the last call; once all of it is handed out, an error where nothing more comes."""
        block = self._samples.take()
        if len(block.time):
            return block
        why = self._failure or (str(self._cycle.broken) if self._cycle.broken else "")
        if why:
            raise DeviceError(self._device, f"sampling broke off: {why}")
        silent = monotonic() - self._heard
        if silent > max(PATIENCE, 3 / self._rate):
            because = f": {self._unheard}" if self._unheard else ""
            raise DeviceError(self._device, f"no sample for {silent:.2f} s{because}")
        return block

    def _fetch(self) -> None:
        """Everything that waits, in the fetching thread."""
        if self._failure:
            return
        try:
            with self._link.calls(CALL):
                if self._unsure:
                    self._find_place(self._link.position())
                columns = self._link.read()
        except Unanswered as error:  # what was asked for may be gone: the next look finds out how much
            self._unsure, self._unheard = True, error.message
            return
        except DeviceError as error:
            self._failure = error.message
            return
        self._unheard = ""
        if columns:
            self._keep(columns)

    def _find_place(self, position: int) -> None:
        """The device says which sample comes next; those before it that did not come are a gap."""
        if position < self._number:
            raise DeviceError(self._device, f"is at sample {position} after {self._number}: it began again")
        self.lost += position - self._number
        self._number, self._unsure = position, False

    def _keep(self, columns: list[array[float]]) -> None:
        now, first = self._clock.now(), self._number
        self._number += len(columns[0])
        for item, column in zip(self._inputs, columns, strict=True):
            strange = [value for value in column if not abs(value) <= BEYOND * item.span]
            if strange:
                self._failure = f"{item.name} gives {strange[0]:g} V at a range of {item.span:g} V"
                return
        behind = self._pace.behind(self.start + (self._number - 1) / self._rate, now)
        if behind:
            late = "late" if behind > 0 else "early"
            self._failure = f"samples come {abs(behind):.2f} s too {late} for {self._rate:g} Hz"
            return
        self._heard = monotonic()
        origin, host = round(self.start * 1e9), round(now * 1e9)
        for number, values in enumerate(zip(*columns, strict=True), first):
            self._samples.append(origin + round(number * 1e9 / self._rate), values, host)
