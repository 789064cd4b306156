"""A bench in real time for tests of guard and engine: its plant serves on a free port and writes down what it is told.

The plant's log, on CLOCK_MONOTONIC, is the judge: what was commanded, and how long after the cause.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from pmabench.bench.interface import Block, ChannelRecord, CompiledBench, DeviceRecord, Identity, Scale
from pmabench.protocol.plan import Ask, Follow, Hold, Plan, Ramp, Record, Set, WaitUntil
from tests.engine.benches import STEPS, mounted, plan
from tests.engine.forked import Forks
from tests.realtime import PlantServer, eventually, plant_server

SAMPLED = STEPS["seek sampled"][0]
KINDS: dict[str, tuple[Any, ...]] = {
    "set": tuple(step for n in range(3000) for step in (Set("s", "pressure", 1e5 + 1e3 * (n % 100)), Hold("s", 0.02))),
    "hold": (Set("h", "pressure", 3e5), Hold("h", 60.0)),
    "ramp": (Ramp("r", "pressure", 0.0, 3e5, 5e3),),
    "follow": (Set("f", "pressure", 3e5), Follow("f", "pressure", 3e5, 5e4, 0.5, 30)),
    "wait-until": (Set("w", "pressure", 3e5), WaitUntil("w", "displacement", "above", 0.2, 0.1, 60.0, "flag")),
    "ask": (Ask("load", "put it on", "vented", (58.86, 8.0)), Hold("a", 60.0)),
    "seek scripted": (replace(STEPS["seek scripted"][0], parameters={**STEPS["seek scripted"][0].parameters, "approach_rate": 0.0}),),
    "seek sampled": (replace(SAMPLED, parameters={**SAMPLED.parameters, "duration": 60.0}),),
    "short": (Set("h", "pressure", 2e5), Hold("h", 0.3)),
}  # fmt: skip
"""Steps of every kind, long enough to be interrupted."""
PRESSED = {"hold": 1e5, "follow": 1e5, "wait-until": 1e5}
"""Where the cause waits for a pressure in the muscle [Pa]."""


def plan_of(kind: str) -> Plan:
    """A recorded trial of one kind of step."""
    return plan(Record("t", True, 0), *KINDS[kind], Record("t", False, 0))


def bench(**changes: Any) -> CompiledBench:
    """The shipped bench in real time without its proof test, under a name of its own."""
    made = mounted("mock-realtime").bench
    return replace(made, proof=None, **changes)


@contextmanager
def served(
    tmp_path: Path, made: CompiledBench | None = None, **options: Any
) -> Iterator[tuple[CompiledBench, PlantServer]]:
    """The bench, and its plant that serves."""
    made = made or bench()
    with plant_server(tmp_path, made.devices[0], **options) as plant:
        yield replace(made, devices=(plant.device,)), plant


class Reader:
    """A device that only measures, for the engine: answers until its file exists, and then hangs."""

    def __init__(self, device: DeviceRecord, clock: Any) -> None:
        self._flag, self._clock = Path(device.address), clock

    def open(self) -> Identity:
        return Identity("test", "reader", "1", "0", simulated=True)

    def close(self) -> None:
        pass

    def start(self, rate: float) -> float:
        return rate

    def stop(self) -> None:
        pass

    def collect(self) -> Block:
        while self._flag.exists():
            time.sleep(0.05)
        return Block([int(self._clock.now() * 1e9)], {"supply": [6e5]})


def with_reader(made: CompiledBench, flag: Path) -> CompiledBench:
    """The bench with such a device."""
    channel = ChannelRecord("supply", "pressure", "gauge", "in", "float64", "Pa", Scale(), -1e5, 1e6)
    reader = DeviceRecord("gauge", "tests.engine.realtime_rig:Reader", str(flag), channels=(channel,))
    return replace(made, devices=(*made.devices, reader))


class Run:
    """One run under way, with a state folder of its own."""

    def __init__(
        self, forks: Forks, made: CompiledBench, plant: PlantServer, folder: Path, kind: str = "hold", **job: Any
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.plant, self.folder, self.kind, self.bench = plant, folder, kind, made
        self.state = folder / "state"
        self.reported = folder / f"reported-{time.monotonic_ns()}"
        self._forks = forks
        job = {
            "state": str(self.state),
            "reported": str(self.reported),
            "out": str(folder / "runs"),
            "kind": kind,
            **job,
        }
        self.began = time.monotonic()
        self.pid = forks.run(bench=json.loads(made.to_json()), **job)

    def lines(self) -> list[dict[str, Any]]:
        """What the run has said so far."""
        text = self.reported.read_text() if self.reported.exists() else ""
        return [json.loads(line) for line in text.split("\n")[:-1] if line.startswith("{")]

    def said(self, what: str) -> Any:
        """The newest of what it said under a name, or None."""
        return next((line[what] for line in reversed(self.lines()) if what in line), None)

    def in_step(self) -> None:
        """Wait until the step is under way."""
        last = len(KINDS[self.kind]) if self.kind != "set" else 5
        eventually(lambda: (self.said("step") or 0) >= last or self.said("status") or self.said("error"))
        assert self.said("status") is None, self.lines()
        assert self.said("error") is None, self.lines()
        if self.kind in PRESSED:
            eventually(lambda: self.plant.state()["pressure"] > PRESSED[self.kind] or self.said("status"))
            assert self.said("status") is None, self.lines()

    @property
    def guard(self) -> dict[str, Any]:
        """Where its guard listens."""
        return json.loads(next(self.state.glob("*/guard.json")).read_text())

    @property
    def bench_state(self) -> dict[str, Any]:
        """What the state folder says of the bench; empty where nothing."""
        found = list(self.state.glob("*/state.json"))
        return json.loads(found[0].read_text()) if found else {}

    def end(self) -> int:
        """Wait for its end; the exit code."""
        return self._forks.reap(self.pid)

    def guard_gone(self) -> None:
        """Wait until nobody holds the bench."""
        eventually(lambda: not list(self.state.glob("*/guard.json")))

    def kill_rest(self) -> None:
        """Whatever still lives of it is killed."""
        for path in self.state.glob("*/guard.json"):
            with suppress(OSError, ValueError):
                os.kill(json.loads(path.read_text())["pid"], signal.SIGKILL)
        with suppress(OSError):
            os.kill(self.pid, signal.SIGKILL)


def vent(state: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """`pmabench vent` from another terminal."""
    environment = {**os.environ, "PMABENCH_STATE": str(state)}
    command = [sys.executable, "-m", "pmabench", "vent", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=120)


def safe_commands(plant: PlantServer, since: float) -> list[dict[str, Any]]:
    """What took the pressure away since a moment, whoever did it."""
    return [line for line in plant.commands() if line["t"] >= since and _is_safe(line)]


def _is_safe(line: Mapping[str, Any]) -> bool:
    return (
        line["do"] == "watchdog"
        or (line["do"] == "write" and line["output"] == "pressure" and line["si"] == 0.0)
        or (line["do"] == "follow" and line["output"] == "pressure" and line["target"] == 0.0)
        or (line["do"] == "switch" and not line["on"])
    )


def assert_safe_since(plant: PlantServer, since: float) -> float:
    """The bench was made safe after `since`, and nothing was pressurised again; how long it took [s]."""
    found = eventually(lambda: safe_commands(plant, since))
    first = found[0]["t"]
    for line in plant.commands("write", "follow", "switch"):
        if line["t"] > first:
            assert _is_safe(line), f"commanded after the bench was made safe: {line}"
    eventually(lambda: plant.state()["pressure"] < 20e3)
    return first - since


def act_at(act: Callable[[], Any]) -> float:
    """Let the cause happen; when it did [s]."""
    moment = time.monotonic()
    act()
    return moment


def table(title: str, rows: Mapping[str, list[float]]) -> None:
    """Times [s] as milliseconds: number, median, 99th percentile, longest."""
    print(f"\n{title}")
    for name, times in rows.items():
        ordered = sorted(times)
        if ordered:
            p99 = ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))]
            median = ordered[len(ordered) // 2]
            print(f"  {name:38} n={len(ordered):4} median {1e3 * median:7.1f}  p99 {1e3 * p99:7.1f}  "
                  f"longest {1e3 * ordered[-1]:7.1f} ms")  # fmt: skip
