"""How long the guard's process takes until its drivers have tried to connect, and how much memory it holds then.

Both are compared with an interpreter that imports a few modules of the standard library, started in turn with it.
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
BENCHES = {"mock-realtime": (10, 3.3), "wires": (14, 4.0), "labjack": (14, 4.0)}
"""Bench: how many times the time and the memory of a bare interpreter at most; the last two load pymodbus."""
BARE = "import json, selectors, socket, pathlib; print(open('/proc/self/statm').read().split()[1])"


@pytest.mark.realtime
@pytest.mark.alone
@pytest.mark.slow
@pytest.mark.parametrize("name", BENCHES)
def test_the_guard_starts_fast_and_small(tmp_path, benchmark, name):
    """Nobody answers at the addresses: what is timed ends with the answer that a device is not there."""
    starts = 2 if benchmark.disabled else STARTS
    slower, larger = BENCHES[name]
    made = json.loads(mounted(name).bench.to_json())
    listens, opened, alone, memory, bare = [], [], [], 0, 0
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
            with socket.create_connection(("127.0.0.1", here["port"])) as link:  # without it the guard ends
                answer = exchange(link, {"do": "open"}, here["token"], 10.0)[0]
                opened.append(time.monotonic() - began)
                memory = max(memory, resident(guard.pid))
            assert answer.get("error", {"type": "DeviceError"})["type"] == "DeviceError"
        finally:
            guard.kill()
            guard.communicate()
        began = time.monotonic()
        done = subprocess.run([sys.executable, "-P", "-c", BARE], capture_output=True, text=True, check=True)
        alone.append(time.monotonic() - began)
        bare = int(done.stdout) * os.sysconf("SC_PAGE_SIZE")
    benchmark.pedantic(lambda: None, rounds=1)
    print(
        f"\nguard of {name}: listens after {reported(listens)}, drivers loaded and asked after {reported(opened)} "
        f"(medians of {starts}, longest in brackets), a bare interpreter {reported(alone)}: {min(opened) / min(alone):.1f} "
        f"times, at most {slower}; holds {memory / 1e6:.1f} MB, {memory / bare:.1f} times, at most {larger}"
    )
    assert min(opened) < slower * min(alone)
    assert 0 < memory < larger * bare


def reported(times):
    """Median and longest of times [s]."""
    return f"{1e3 * statistics.median(times):.0f} ms ({1e3 * max(times):.0f})"


def resident(pid):
    """Memory of a process [bytes]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
