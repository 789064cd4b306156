"""The part of a USB-6215 behind NI-DAQmx that a bench needs: tasks, one sample clock, outputs, lines, on the muscle.

Written from NI's description of tasks and errors and separately from the driver, so that each checks the other. Uses no
connection.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import floor
from time import monotonic

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.faults import CommandLog
from pmabench_drivers.emulator.plant import RealPlant, Wiring

AI = tuple(f"ai{number}" for number in range(16))
AO = ("ao0", "ao1")
DI = tuple(f"port0/line{line}" for line in range(4))
DO = tuple(f"port1/line{line}" for line in range(4))
SPANS = (0.2, 1.0, 5.0, 10.0)
FASTEST = 250e3
"""Samples a second over all inputs."""
TIMEBASE = 20e6
"""The rate of the sample clock is this, divided by a whole number [Hz]."""
BITS = 16
USUAL, RSE, NRSE, DIFF = -1, 10083, 10078, 10106
COMMIT, UNRESERVE = 3, 5
TICK = 0.02
"""Longest interval for taking due samples [s]; each is taken for its own time."""


BUFFERS = ((100.0, 1_000), (10e3, 10_000), (1e6, 100_000))
"""Highest rate [Hz] for a buffer of a number of samples, for a continuous task, unless more are requested."""


class Refused(Exception):
    """An error of NI-DAQmx."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass
class Task:
    """A task as the server stores it."""

    kind: str = ""
    """`ai`, `ao`, `di`, `do`."""
    names: list[str] = field(default_factory=list)
    spans: list[tuple[float, float]] = field(default_factory=list)
    rate: float = 0.0
    """Rate of its sample clock [Hz]."""
    buffer: int = 0
    state: str = "verified"
    start: float = 0.0
    taken: int = 0
    read: int = 0
    waiting: deque[tuple[float, ...]] = field(default_factory=deque)
    overwritten: bool = False
    aborted: bool = False

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return self.state != "running"


class Board:
    """One device."""

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog) -> None:
        self.device, self._plant, self._log = device, plant, log
        self.model = plant.model("USB-6215")
        self.lock = threading.RLock()
        self.tasks: dict[str, Task] = {}
        self._wiring = Wiring(device, plant, log)
        self._levels = dict.fromkeys(DO, False)
        self.volts = dict.fromkeys(AO, 0.0)
        self._ended = threading.Event()
        threading.Thread(target=self._sample, name="emulated NI samples", daemon=True).start()

    def close(self) -> None:
        """Stop sampling."""
        self._ended.set()

    # -- tasks ----------------------------------------------------------------------------------------------------

    def task(self, name: str) -> Task:
        """A task by its name."""
        if name not in self.tasks:
            raise Refused(-200088, "Task specified is invalid or does not exist.")
        return self.tasks[name]

    def add(self, task: Task, kind: str, physical: str, known: Sequence[str]) -> str:
        """Add a physical channel to a task; returns its name."""
        device, _, name = physical.partition("/")
        if device != self.device.address:
            raise Refused(-200220, "Device identifier is invalid.")
        if name not in known:
            raise Refused(-200170, "Physical channel specified does not exist on this device.")
        if task.kind not in {"", kind}:
            raise Refused(-200559, "Specified channels cannot be added to the task: they are of another type.")
        if name in task.names:
            raise Refused(-200489, "Specified channel cannot be added to the task more than once.")
        task.kind = kind
        task.names.append(name)
        return name

    def add_input(self, task: Task, physical: str, terminal: int, low: float, high: float) -> None:
        """Add an analogue input, with the narrowest range that includes `low` to `high`."""
        fitting = [span for span in SPANS if span >= max(abs(low), abs(high))]
        upper = physical.partition("/")[2] in AI[8:]
        if not fitting or terminal not in {USUAL, RSE, NRSE, DIFF} or (terminal == DIFF and upper):
            raise Refused(-200077, "Requested value is not a supported value for this property.")
        self.add(task, "ai", physical, AI)
        task.spans.append((-fitting[0], fitting[0]))

    def reserve(self, task: Task) -> None:
        """Reserve the resources of a task, or refuse."""
        for other in self.tasks.values():
            shared = task.kind == other.kind == "ai" or set(task.names) & set(other.names)
            if other is not task and other.state != "verified" and shared:
                raise Refused(-50103, "The specified resource is reserved.")

    def control(self, task: Task, action: int) -> None:
        """Commit or unreserve a task."""
        if action == COMMIT:
            self.reserve(task)
            task.state = "committed"
        elif action == UNRESERVE:
            task.state = "verified"
        else:
            raise Refused(-200077, "Requested value is not a supported value for this property.")

    def configure(self, task: Task, rate: float, samples: int) -> None:
        """Set the sample clock to the lowest possible rate from `rate` up; the buffer is at least NI-DAQmx's own."""
        if task.kind != "ai" or not rate > 0:
            raise Refused(-200077, "Requested value is not a supported value for this property.")
        if rate * len(task.names) > FASTEST:
            raise Refused(-200081, "Sample rate exceeds the maximum sample rate for the number of channels specified.")
        task.rate = TIMEBASE / floor(TIMEBASE / rate)
        task.buffer = max(samples, next(size for most, size in BUFFERS if rate <= most))

    def start(self, task: Task) -> None:
        """Start a task."""
        self.reserve(task)
        task.state, task.start = "running", monotonic()
        task.taken = task.read = 0
        task.overwritten = task.aborted = False
        task.waiting.clear()

    def restart(self) -> None:
        """Reset to power-on: outputs at 0 V, lines low, running tasks aborted; the server stays."""
        with self.lock:
            for name in AO:
                self._wiring.give(name, self._reached(name, 0.0))
            for name in DO:
                self._levels[name] = False
                self._wiring.drive(name, on=False)
            for task in self.tasks.values():
                task.aborted, task.state = task.state == "running", "verified"

    def change_set_point(self, value: float) -> bool:
        """Set the first output that the bench uses [V], as another program would; returns whether there is one."""
        with self.lock:
            if name := self._wiring.first_output:
                self._wiring.give(name, self._reached(name, value))
            return bool(name)

    # -- samples ----------------------------------------------------------------------------------------------------

    def _sample(self) -> None:
        while not self._ended.wait(TICK):
            with self.lock:
                for task in self.tasks.values():
                    self.take(task)

    def take(self, task: Task) -> None:
        """Take every sample that is due, each for its time; a full buffer ends the sampling."""
        if task.kind != "ai" or task.state != "running":
            return
        due = floor((monotonic() - task.start) * task.rate)
        while task.taken < due and not task.overwritten:
            if len(task.waiting) >= task.buffer:
                task.overwritten = True
                break
            task.taken += 1
            quantities = self._plant.at(task.start + task.taken / task.rate)
            pairs = zip(task.names, task.spans, strict=True)
            task.waiting.append(tuple(self._volts(name, span[1], quantities) for name, span in pairs))

    def _volts(self, name: str, span: float, quantities: dict[str, float]) -> float:
        volts = self._wiring.raw(name, quantities, calibrated=True)
        step = 2 * span / 2**BITS
        return float(min(max(round(volts / step) * step, -span), span - step))

    def waiting(self, task: Task) -> int:
        """Number of samples that can be read."""
        self.take(task)
        if task.aborted:
            raise Refused(-88710, "A task has been aborted or a device has been removed from the system.")
        if task.overwritten:
            raise Refused(-200279, "The application is not able to keep up with the hardware acquisition.")
        return len(task.waiting)

    def fetch(self, task: Task, count: int) -> list[float]:
        """Read `count` samples, grouped by channel."""
        if self.waiting(task) < count:
            raise Refused(-200284, "Some or all of the samples requested have not yet been acquired.")
        rows = [task.waiting.popleft() for _ in range(count)]
        task.read += count
        return [row[index] for index in range(len(task.names)) for row in rows]

    # -- outputs and lines -------------------------------------------------------------------------------------------

    def set_output(self, task: Task, volts: float, connection: int, *, start: bool) -> None:
        """Set the output of a task on demand."""
        name = self._written(task, start=start)
        low, high = task.spans[0]
        if not low <= volts <= high:
            raise Refused(-200561, "Attempted writing analog data that is too large or too small.")
        self._wiring.set(name, volts, reached=self._reached(name, volts), connection=connection)

    def _written(self, task: Task, *, start: bool) -> str:
        """The one channel of a task that is written to."""
        self.reserve(task)
        if len(task.names) != 1:
            raise Refused(-200524, "Write cannot be performed: the number of channels in the data is another.")
        if not start and task.state != "running":
            raise Refused(-200846, "Write cannot be performed when auto start is false and the task is not running.")
        return task.names[0]

    def _reached(self, name: str, volts: float) -> float:
        """The nearest voltage that an output can give, to which it is set."""
        step = 20.0 / 2**BITS
        self.volts[name] = round(volts / step) * step
        return self.volts[name]

    def set_line(self, task: Task, connection: int, *, high: bool, start: bool) -> None:
        """Set the line of a task."""
        name = self._written(task, start=start)
        self._levels[name] = high
        self._wiring.switch(name, on=high, connection=connection)

    def level(self, name: str) -> bool:
        """The level of a line; an input that is not wired is low."""
        return self._levels[name] if name in self._levels else self._wiring.level(name)
