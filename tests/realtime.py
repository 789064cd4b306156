"""A real-time plant for tests: the server as a process of its own on a free port, killed when the test ends.

with plant_server(tmp_path, device) as plant, opened(plant.device) as client:
    client.write("pressure", 100.0)
    plant.inject("hang")
    plant.commands("write")      # from the server's log: what was really commanded, and when
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
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pmabench_drivers.mock.client import Link, MockClient, parse_address

from pmabench.base.clock import RealClock
from pmabench.bench.interface import DeviceRecord
from tests.ports import free_port

CLIENT = "pmabench_drivers.mock.client:MockClient"
WITHIN = 20.0
"""How long something that must happen is waited for [s], on a machine that has much else to do."""


def eventually(what: Callable[[], Any], within: float = WITHIN) -> Any:
    """What `what` gives as soon as it is true."""
    end = time.monotonic() + within
    while True:
        found = what()
        if found:
            return found
        assert time.monotonic() < end, f"not within {within:g} s"
        time.sleep(0.005)


def read_log(path: Path) -> list[dict[str, Any]]:
    """The whole lines of a server's log."""
    text = path.read_text() if path.exists() else ""
    return [json.loads(line) for line in text.split("\n")[:-1]]


class PlantServer:
    """A server under way: `device` is the record that a client opens, `address` where, `log` the judge's file."""

    def __init__(self, device: DeviceRecord, log: Path) -> None:
        self.device, self.address, self.log = device, device.address, log
        self._link: Link | None = None

    def ask(self, do: str, **fields: Any) -> dict[str, Any]:
        """A question of role `control`."""
        by = time.monotonic() + WITHIN
        if self._link is None:
            self._link = Link("control", parse_address("control", self.address), WITHIN)
            self._link.ask("hello", by, role="control", pid=os.getpid())
        return self._link.ask(do, by, **fields)[0]

    def inject(self, fault: str, after: float | None = 0.0) -> None:
        """Let a fault happen `after` seconds from now: `hang`, `lost`, `dead`, `mute`, `burst`, `nan`, `e_stop` ..."""
        self.ask("inject", fault=fault, after=after)

    def clear(self, fault: str) -> None:
        """The fault is over."""
        self.ask("inject", fault=fault, after=None)

    def disturb(self, channel: str, error: Mapping[str, Any] | None) -> None:
        """Give a sensor an error (`SensorError`), or none."""
        self.ask("inject", errors={channel: error})

    def state(self) -> dict[str, Any]:
        """How the plant really stands: `pressure` [Pa], `setpoints`, `energised`, `watchdog`, `fired`."""
        return self.ask("state")

    def commands(self, *kinds: str) -> list[dict[str, Any]]:
        """The lines of the log, all or those of some kinds (`write`, `follow`, `switch`, `watchdog` ...)."""
        return [line for line in read_log(self.log) if not kinds or line["do"] in kinds]

    def close(self) -> None:
        """Hang up."""
        if self._link is not None:
            self._link.close()


def with_service(device: DeviceRecord, tmp_path: Path, **options: Any) -> tuple[DeviceRecord, Path]:
    """The record with a free port, the client as its driver, a log in `tmp_path`, and options on top."""
    port = free_port()
    log = tmp_path / f"plant-{port}.jsonl"
    options = {**device.options, "start": False, "idle": 60.0, "log": str(log), **options}
    return replace(device, driver=CLIENT, address=f"127.0.0.1:{port}", options=options), log


@contextmanager
def plant_server(tmp_path: Path, device: DeviceRecord, **options: Any) -> Iterator[PlantServer]:
    """The server of one device, with options on top of the record's own; it answers when the block begins."""
    device, log = with_service(device, tmp_path, **options)
    command = [sys.executable, "-m", "pmabench_drivers.mock.server", "--address", device.address]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    plant = PlantServer(device, log)
    try:
        process.stdin.write(json.dumps(asdict(device)))
        process.stdin.close()
        eventually(lambda: process.poll() is not None or any(line["do"] == "serve" for line in read_log(log)))
        assert process.poll() is None, process.stderr.read()
        yield plant
    finally:
        plant.close()
        process.kill()
        process.wait()
        process.stderr.close()


@contextmanager
def opened(device: DeviceRecord) -> Iterator[MockClient]:
    """An open client, closed when the block ends."""
    client = MockClient(device, RealClock())
    client.open()
    try:
        yield client
    finally:
        client.close()


@contextmanager
def ended(log: Path) -> Iterator[None]:
    """Whatever server wrote `log` (a client may have started it) is killed when the block ends."""
    try:
        yield
    finally:
        for line in read_log(log):
            if line["do"] == "serve":
                with suppress(ProcessLookupError):
                    os.kill(line["pid"], signal.SIGKILL)
