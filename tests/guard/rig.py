"""A device with every capability, whose calls can be made to fail or to hang; and a bench around it."""

from __future__ import annotations

import math
import threading
from array import array
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

from pmabench.base.clock import RealClock, VirtualClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import (
    Block,
    ChannelRecord,
    CompiledBench,
    DeviceRecord,
    Identity,
    InterlockRecord,
    OutputRecord,
    SafeAction,
    Scale,
    TripRecord,
    ValveRecord,
)
from pmabench.guard.guard import Guard


class Rig:
    """Writes down what it is told; `wrong` maps a call's name to what it raises, or to an Event that it waits for."""

    made: ClassVar[dict[str, Rig]] = {}

    def __init__(self, device: DeviceRecord, clock: Any) -> None:
        self.device, self.clock = device, clock
        self.reported: list[tuple[Any, ...]] = []
        self.at: dict[str, Callable[[float], float]] = {}
        """What each output holds over bench time [device units]."""
        self.on: dict[str, bool] = {}
        self.reports: dict[str, float | str] = {"watchdog": 1.0, "uptime": 5.0, "serial": "1", "fault": 0.0}
        self.ignores: bool | str = False
        """Whether it acknowledges commands and carries none out; "both ways": nor those of the second way."""
        self.wrong: dict[str, Any] = dict(device.options.get("wrong", {}))
        self.reads: dict[str, float] = {channel.name: 0.0 for channel in device.channels}
        self.late = 0.0
        """How late samples come [s]."""
        self.high = True
        self.promised: float | None = None
        Rig.made[device.name] = self

    def _note(self, what: str, *how: Any) -> None:
        wrong = self.wrong.get(what)
        if isinstance(wrong, threading.Event):
            wrong.wait(20.0)
        elif isinstance(wrong, str):
            raise DeviceError(self.device.name, wrong)
        elif wrong is not None:
            raise wrong
        self.reported.append((what, *how))

    def open(self) -> Identity:
        self._note("open")
        return Identity("test", "rig", "1", "0", simulated=True)

    def close(self) -> None:
        self._note("close")

    def write(self, output: str, value: float) -> None:
        self._note("write", output, value)
        if not self.ignores:
            self.at[output] = lambda _now: value

    def read_back(self, output: str) -> float:
        self._note("read_back", output)
        return self.at[output](self.clock.now())

    def follow(self, output: str, segment: Any) -> None:
        self._note("follow", output, segment)
        if not self.ignores:
            self.at[output] = partial(followed, segment)

    def place(self, load: Any) -> None:
        self._note("place", load.force, load.mass)

    def switch(self, output: str, *, on: bool) -> None:
        self._note("switch", output, on)
        if not self.ignores:
            self.on[output] = on

    def pulse(self, output: str, seconds: float) -> None:
        self._note("pulse", output, seconds)

    def is_on(self, output: str) -> bool:
        self._note("is_on", output)
        return self.on[output]

    def held(self) -> dict[str, float | str]:
        self._note("held")
        return dict(self.reports)

    def halt(self, output: str) -> None:
        self._note("halt", output)

    def level(self, name: str) -> bool:
        self._note("level", name)
        return self.high

    def arm_watchdog(self, seconds: float) -> float:
        self._note("arm_watchdog", seconds)
        return seconds if self.promised is None else self.promised

    def feed_watchdog(self) -> None:
        self._note("feed_watchdog")

    def disarm_watchdog(self) -> None:
        self._note("disarm_watchdog")

    def rescue(self, output: str, value: float) -> None:
        self._note("rescue", output, value)
        if self.ignores != "both ways":
            self.at[output], self.on[output] = (lambda _now: value), bool(value)

    def start(self, rate: float) -> float:
        self._note("start", rate)
        return rate

    def stop(self) -> None:
        self._note("stop")

    def collect(self) -> Block:
        self._note("collect")
        moment = array("q", [int((self.clock.now() - self.late) * 1e9)])
        return Block(moment, {name: array("d", [value]) for name, value in self.reads.items()})

    def values(self, *kinds: str) -> list[tuple[Any, ...]]:
        """What it was told of some kinds."""
        return [reported for reported in self.reported if reported[0] in kinds]


class Quiet(Rig):
    """The same, reporting nothing of itself."""

    held = None


def followed(segment: Any, now: float) -> float:
    """Where a segment is at a moment [device units], by its definition in the interface."""
    t = max(now - segment.start, 0.0)
    if segment.kind == "ramp":
        way = segment.target - segment.origin
        return segment.origin + math.copysign(min(segment.rate * t, abs(way)), way)
    return segment.origin + segment.amplitude * math.sin(
        2 * math.pi * segment.frequency * min(t, segment.cycles / segment.frequency)
    )


class Plain:
    """A device that can be opened and closed, and nothing else."""

    def __init__(self, device: DeviceRecord, clock: Any) -> None:
        pass

    def open(self) -> Identity:
        return Identity("test", "plain", "1", "0")

    def close(self) -> None:
        pass


DRIVER = f"{__name__}:Rig"
OUTPUT = OutputRecord(
    "pressure", "pressure", "dac", "p", Scale(600e3 / 4000, 0.0), 1.0, 0.0, 0.0, 600e3, "a:1:1", "b:2:2"
)
DRIVE = OutputRecord("displacement", "length", "dac", "x", Scale(1e-3, 0.0), 0.0, 0.0, 0.0, 50e-3, rate=20e-3)
CHANNEL = ChannelRecord("pressure", "pressure", "dac", "p", "float64", "Pa", Scale(), -1e5, 1e6)
VALVE = ValveRecord("dump_valve", "dac", "v")
E_STOP = InterlockRecord("e-stop", "dac", "in0")
DEVICE = DeviceRecord(
    "dac", DRIVER, channels=(CHANNEL,), outputs=(OUTPUT, DRIVE), valves=(VALVE,), interlocks=(E_STOP,), watchdog=1.0
)
SAFE = (
    SafeAction("stop", "displacement", 0.0, 0.2),
    SafeAction("set", "pressure", 0.0, 0.2),
    SafeAction("open", "dump_valve", 0.0, 0.2),
    SafeAction("confirm", "pressure", 20e3, 1.0),
)
BENCH = CompiledBench(
    name="rig",
    simulated=True,
    realtime=False,
    free_end="actuator",
    devices=(DEVICE,),
    trips=(TripRecord("pressure", None, 650e3, 0.0, "vent"),),
    safe_state=SAFE,
    hands_below=20e3,
)


def bench(device: DeviceRecord | None = None, **changes: Any) -> CompiledBench:
    """The bench with changes; `device` in place of its only one."""
    return (
        replace(BENCH, devices=(device or DEVICE,), **changes)
        if "devices" not in changes
        else replace(BENCH, **changes)
    )


def opened(made: CompiledBench | None = None, **options: Any) -> tuple[Guard, Rig]:
    """A guard with its devices open, and the rig behind it."""
    clock = RealClock() if options.get("threads") else VirtualClock()
    guard = Guard(made or BENCH, clock, **options)
    guard.open()
    return guard, Rig.made["dac"]


def armed(made: CompiledBench | None = None, **options: Any) -> tuple[Guard, Rig]:
    """The same, armed, and nothing noted yet."""
    guard, rig = opened(made, **options)
    guard.arm("run")
    rig.reported.clear()
    return guard, rig
