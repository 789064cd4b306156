"""Beside 0, 2 and 8 busy processes: how late 500 Hz samples are, and how long a vent takes. Printed, with -s.

Both with real-time priority, where this machine allows it, and without. A vent is timed from the end of the engine's
link to the guard (what `kill -9` of the engine leaves) to the write at the device. `PMABENCH_VENTS` is how many are
timed for each line; a percentile for which there are too few is not printed.
"""

import json
import os
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmabench.base.system import ENGINE, ordinary, real_time
from pmabench.bench.interface import SafeAction
from pmabench.guard.remote import exchange
from tests.guard.rig import BENCH, DEVICE, OUTPUT

ROOT = Path(__file__).resolve().parents[2]
BUSY = "while True: pass"
ORDINARY = "import os; os.sched_setscheduler = lambda *_: 0\n"
"""Takes the means to ask for priority from a program."""
GUARD = "import runpy; runpy.run_module('pmabench.guard', run_name='__main__')"


@contextmanager
def busy(count):
    """So many processes that never rest."""
    others = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def line(times):
    """Percentiles of times [s] in ms, as far as there are enough."""
    ms = 1e3 * np.asarray(times)
    reported = f"n={len(ms):5}  median {np.median(ms):7.2f}"
    for part in (99.0, 99.9):
        if len(ms) >= 100 / (100 - part):
            reported += f"  p{part:g} {np.percentile(ms, part):7.2f}"
    return f"{reported}  longest {ms.max():7.2f} ms"


def lateness(seconds, *, first):
    """How late each sample of a 500 Hz loop is [s], in an interpreter of its own."""
    script = str(Path(__file__).with_name("sampling.py"))
    code = ("" if first else ORDINARY) + (
        f"import runpy, sys; sys.argv = [{script!r}, 'absolute', '{seconds}']; "
        f"sys.path[:0] = {[str(ROOT), str(ROOT / 'drivers')]!r}; "
        f"from pmabench.base.system import real_time; real_time({ENGINE}); runpy.run_path({script!r}, run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    times = np.array(json.loads(done.stdout)["times"])
    late = times - times[0] - np.arange(len(times)) / 500.0
    return late - np.minimum.accumulate(late[::-1])[::-1]


def vent_time(folder, *, first):
    """From the end of the engine's link to the write of the safe value [s], with a guard of its own."""
    log = folder / "log"
    log.write_text("")
    device = replace(
        DEVICE, driver="tests.benchmarks.stamping:Stamping", options={"log": str(log)}, outputs=(OUTPUT,), valves=(),
        interlocks=(), watchdog=0.0, channels=(),
    )  # fmt: skip
    bench = replace(BENCH, name="busy", devices=(device,), safe_state=(SafeAction("set", "pressure", 0.0, 0.2),))
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'drivers'}", "PMABENCH_STATE": str(folder / "state")}
    code = ("" if first else ORDINARY) + GUARD
    guard = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    )
    real_time(ENGINE)  # this side is not what is measured
    try:
        guard.stdin.write(json.dumps({"bench": json.loads(bench.to_json()), "start": time.monotonic()}) + "\n")
        guard.stdin.flush()
        here = json.loads(guard.stdout.readline())
        with socket.create_connection(("127.0.0.1", here["port"])) as link:
            for do, data in (("open", {}), ("arm", {"run": ""}), ("set", {"name": "pressure", "value": 3e5})):
                answer, _ = exchange(link, {"do": do, "at": time.monotonic(), **data}, here["token"], 5.0)
                assert "error" not in answer, answer
            began = time.monotonic()
    finally:
        ordinary()
        guard.communicate()
        (folder / "state" / "busy" / "state.json").unlink()
    written = [json.loads(text) for text in log.read_text().splitlines()]
    moment, value = next(entry for entry in written if entry[0] >= began)
    assert value == 0.0
    return moment - began


@pytest.mark.study
@pytest.mark.parametrize("load", [0, 2, 8])
def test_next_to_busy_processes(benchmark, tmp_path, load):
    seconds = 1 if benchmark.disabled else 20
    vents = int(os.environ.get("PMABENCH_VENTS", "3" if benchmark.disabled else "100"))
    allowed = not real_time(ENGINE)
    ordinary()
    benchmark.pedantic(lambda: None, rounds=1)
    print(f"\n{load} busy processes on {os.cpu_count()} cores")
    for first in (True, False) if allowed else (False,):
        name = "real-time priority" if first else "ordinary priority "
        with busy(load):
            print(f"  samples, {name}: {line(lateness(seconds, first=first))}")
            print(f"  vents,   {name}: {line([vent_time(tmp_path, first=first) for _ in range(vents)])}")
