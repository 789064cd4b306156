"""How long the guard's process takes until its drivers have tried to connect, and how much memory it holds then.

Asserted are the limits of the promise with room for a machine that is busy; the numbers are printed (`make bench`).
"""

import json
import os
import socket
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pmabench.guard.remote import exchange
from tests.engine.benches import mounted

ROOT = Path(__file__).resolve().parents[2]
STARTS = 10
BENCHES = {"mock-realtime": (0.150, 40e6), "wires": (0.350, 50e6), "labjack": (0.350, 50e6)}
"""Bench: within how long [s] and with how much memory [bytes]; the last two load pymodbus."""


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.parametrize("name", BENCHES)
def test_the_guard_starts_fast_and_small(tmp_path, benchmark, name):
    """Nobody answers at the addresses: what is timed ends with the answer that a device is not there."""
    starts = 2 if benchmark.disabled else STARTS
    within, room = BENCHES[name]
    made = json.loads(mounted(name).bench.to_json())
    listens, opened, memory = [], [], 0
    for number in range(starts):
        environment = {**os.environ, "PMABENCH_STATE": str(tmp_path / str(number))}
        given = {"bench": made, "start": time.monotonic(), "user": "test"}
        began = time.monotonic()
        guard = subprocess.Popen(
            [sys.executable, "-P", "-m", "pmabench.guard"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, cwd=ROOT, text=True,
        )  # fmt: skip
        try:
            guard.stdin.write(json.dumps(given) + "\n")
            guard.stdin.flush()
            here = json.loads(guard.stdout.readline())
            listens.append(time.monotonic() - began)
            answer = asked_to_open(here)
            opened.append(time.monotonic() - began)
            assert answer.get("error", {"type": "DeviceError"})["type"] == "DeviceError"
            memory = max(memory, resident(guard.pid))
        finally:
            guard.kill()
            guard.communicate()
    benchmark.pedantic(lambda: None, rounds=1)
    print(
        f"\nguard of {name}: listens after {told(listens)}, drivers loaded and asked after {told(opened)} "
        f"(medians of {starts}, longest in brackets), limit {1e3 * within:.0f} ms; "
        f"holds {memory / 1e6:.1f} MB, limit {room / 1e6:.0f} MB"
    )
    assert min(opened) < (within if not benchmark.disabled else 10 * within)
    assert memory < room


def told(times):
    """Median and longest of times [s]."""
    return f"{1e3 * statistics.median(times):.0f} ms ({1e3 * max(times):.0f})"


def asked_to_open(here):
    """What the guard answers when it is asked to open the devices."""
    with socket.create_connection(("127.0.0.1", here["port"])) as link:
        return exchange(link, {"do": "open"}, here["token"], 10.0)[0]


def resident(pid):
    """Memory of a process [bytes]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
