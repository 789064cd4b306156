"""A USB-6215 behind NI-DAQmx as far as a bench needs it: tasks, one sample clock, outputs, lines; behind it the muscle.

Written from NI's description of tasks and errors and apart from the driver, so that each is a check of the other. Knows
no wire.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import floor
from time import monotonic

from pmabench.bench.interface import ChannelRecord, DeviceRecord
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.plant import RealPlant

AI = tuple(f"ai{number}" for number in range(16))
AO = ("ao0", "ao1")
DI = tuple(f"port0/line{line}" for line in range(4))
DO = tuple(f"port1/line{line}" for line in range(4))
SPANS = (0.2, 1.0, 5.0, 10.0)
FASTEST = 250e3
"""Samples a second over all inputs."""
TIMEBASE = 20e6
"""The sample clock is this, divided by a whole number [Hz]."""
BITS = 16
USUAL, RSE, NRSE, DIFF = -1, 10083, 10078, 10106
COMMIT, UNRESERVE = 3, 5
TICK = 0.02
"""Samples that fall due are taken at least so often [s]; each at its own time."""


class Refused(Exception):
    """An error of NI-DAQmx."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass
class Task:
    """A task as the server keeps it."""

    kind: str = ""
    """`ai`, `ao`, `di`, `do`."""
    names: list[str] = field(default_factory=list)
    spans: list[tuple[float, float]] = field(default_factory=list)
    terminals: list[int] = field(default_factory=list)
    rate: float = 0.0
    buffer: int = 0
    state: str = "verified"
    start: float = 0.0
    taken: int = 0
    read: int = 0
    waiting: deque[tuple[float, ...]] = field(default_factory=deque)
    overwritten: bool = False
    aborted: bool = False


class Board:
    """One device."""

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog) -> None:
        self.device, self._plant, self._log = device, plant, log
        self.lock = threading.RLock()
        self.tasks: dict[str, Task] = {}
        self._channels: dict[str, ChannelRecord] = {channel.input: channel for channel in device.channels}
        self._outputs = {output.output: output for output in device.outputs}
        self._valves = {valve.output: valve for valve in device.valves}
        self._interlocks = {lock.input: lock for lock in device.interlocks}
        self._levels = dict.fromkeys(DO, False)
        self.volts = dict.fromkeys(AO, 0.0)
        self._ended = threading.Event()
        threading.Thread(target=self._sample, name="emulated NI samples", daemon=True).start()

    def close(self) -> None:
        """Sample no more."""
        self._ended.set()

    # -- tasks ----------------------------------------------------------------------------------------------------

    def task(self, name: str) -> Task:
        """A task by its name."""
        if name not in self.tasks:
            raise Refused(-200088, "Task specified is invalid or does not exist.")
        return self.tasks[name]

    def channel(self, task: Task, kind: str, physical: str, known: Sequence[str]) -> str:
        """Put a physical channel into a task."""
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
        """An analogue input, with the narrowest range that holds `low` to `high`."""
        name = self.channel(task, "ai", physical, AI)
        fitting = [span for span in SPANS if span >= max(abs(low), abs(high))]
        if not fitting or terminal not in {USUAL, RSE, NRSE, DIFF} or (terminal == DIFF and AI.index(name) >= 8):
            raise Refused(-200077, "Requested value is not a supported value for this property.")
        task.spans.append((-fitting[0], fitting[0]))
        task.terminals.append(terminal)

    def reserve(self, task: Task) -> None:
        """Take what a task needs, or refuse."""
        for other in self.tasks.values():
            shared = task.kind == other.kind == "ai" or set(task.names) & set(other.names)
            if other is not task and other.state != "verified" and shared:
                raise Refused(-50103, "The specified resource is reserved.")

    def control(self, task: Task, action: int) -> None:
        """Commit or let go."""
        if action == COMMIT:
            self.reserve(task)
            task.state = "committed"
        elif action == UNRESERVE:
            task.state = "verified"
        else:
            raise Refused(-200077, "Requested value is not a supported value for this property.")

    def configure(self, task: Task, rate: float, buffer: int) -> None:
        """Set the sample clock; the rate becomes one that it can have."""
        if task.kind != "ai" or not rate > 0:
            raise Refused(-200077, "Requested value is not a supported value for this property.")
        if rate * len(task.names) > FASTEST:
            raise Refused(-200081, "Sample rate exceeds the maximum sample rate for the number of channels specified.")
        task.rate, task.buffer = TIMEBASE / floor(TIMEBASE / rate), buffer

    def start(self, task: Task) -> None:
        """Begin."""
        self.reserve(task)
        if task.kind == "ai" and not task.rate:
            raise Refused(-200077, "Requested value is not a supported value for this property.")
        task.state, task.start = "running", monotonic()
        task.taken = task.read = 0
        task.overwritten = task.aborted = False
        task.waiting.clear()

    def restart(self) -> None:
        """Outputs at 0 V and lines low as after power-on; tasks under way are aborted."""
        for name in AO:
            self._give(name, 0.0)
        for name in DO:
            self._drive(name, high=False)
        for task in self.tasks.values():
            task.aborted, task.state = task.state == "running", "verified"

    def change_set_point(self, value: float) -> bool:
        """Another program sets the first output that the bench uses [V]; whether there is one."""
        for name in list(self._outputs)[:1]:
            self._give(name, value)
        return bool(self._outputs)

    # -- samples ----------------------------------------------------------------------------------------------------

    def _sample(self) -> None:
        while not self._ended.wait(TICK):
            with self.lock:
                for task in self.tasks.values():
                    self.take(task)

    def take(self, task: Task) -> None:
        """Every sample that is due, each as it was at its time; those without room end the sampling."""
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
        channel = self._channels.get(name)
        volts = 0.0 if channel is None else float(channel.calibrated.to_raw(quantities.get(channel.name, 0.0)))
        step = 2 * span / 2**BITS
        return float(min(max(round(volts / step) * step, -span), span - step))

    def waiting(self, task: Task) -> int:
        """How many samples may be read."""
        self.take(task)
        if task.aborted:
            raise Refused(-88710, "A task has been aborted or a device has been removed from the system.")
        if task.overwritten:
            raise Refused(-200279, "The application is not able to keep up with the hardware acquisition.")
        return len(task.waiting)

    def fetch(self, task: Task, count: int) -> list[float]:
        """So many samples, one channel after the other."""
        if self.waiting(task) < count:
            raise Refused(-200284, "Some or all of the samples requested have not yet been acquired.")
        rows = [task.waiting.popleft() for _ in range(count)]
        task.read += count
        return [row[index] for index in range(len(task.names)) for row in rows]

    # -- outputs and lines -------------------------------------------------------------------------------------------

    def set_output(self, task: Task, volts: float, connection: int) -> None:
        """A voltage on the one output of a task."""
        [name], [(low, high)] = task.names, task.spans
        self.reserve(task)
        if not low <= volts <= high:
            raise Refused(-200561, "Attempted writing analog data that is too large or too small.")
        output = self._outputs.get(name)
        if output is not None:
            si = float(output.scale.to_si(volts))
            self._log.note("set", self.device.name, output=output.name, raw=volts, si=si, connection=connection)
        self._give(name, volts)

    def _give(self, name: str, volts: float) -> None:
        """Let an output give the nearest voltage that it can."""
        step = 20.0 / 2**BITS
        self.volts[name] = reached = round(volts / step) * step
        output = self._outputs.get(name)
        if output is not None and output.quantity == "pressure":
            self._plant.command(float(output.scale.to_si(reached)))

    def set_line(self, task: Task, connection: int, *, high: bool) -> None:
        """A level on the one line of a task."""
        [name] = task.names
        self.reserve(task)
        self._drive(name, high=high)
        valve = self._valves.get(name)
        if valve is not None:
            self._log.note("switch", self.device.name, valve=valve.name, on=high, connection=connection)

    def _drive(self, name: str, *, high: bool) -> None:
        """Drive a line high or low, and the valve at it."""
        self._levels[name] = high
        valve = self._valves.get(name)
        if valve is not None:
            self._plant.switch(on=high == (valve.energised == "closed"))

    def level(self, task: Task) -> bool:
        """The level of the one line of a task; an input that nobody wired is low."""
        [name] = task.names
        if name in self._levels:
            return self._levels[name]
        lock = self._interlocks.get(name)
        if lock is None:
            return False
        closed = self._plant.e_stop_high() if "stop" in lock.name else True
        return closed == (lock.safe == "high")
