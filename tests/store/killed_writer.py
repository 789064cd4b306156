"""Forks writers that record in real time and kills them; a program of its own, so that its forks disturb no test.

`python killed_writer.py FOLDER COUNT SEED` prints one JSON line per run: its folder, the rows and events that were
handed over a quarter of a second before the kill, and those handed over at all.
"""

import json
import mmap
import os
import random
import signal
import struct
import sys
import time
import warnings
from pathlib import Path

from tests.store.runs import begin, block

KEPT_AFTER = 0.25
GONE_ON = 15
"""What was handed over counts only where the writer went on so many times after it: a machine may stand still."""
AT_ONCE = 5
ENTRY = struct.Struct("dq")


def write_until_killed(parent, name, log):
    """Append a block of changing size every few milliseconds; note time and rows in memory that survives."""
    starter = os.getppid()
    writer = begin(parent, name)
    rng = random.Random(name)
    rows = entries = 0
    while os.getppid() == starter:
        size = rng.randint(1, 9)
        writer.append("daq", *block(rows, size))
        rows += size
        writer.event("mark", rows / 500, rows=rows)
        entries += 1
        ENTRY.pack_into(log, ENTRY.size * entries, time.monotonic(), rows)
        ENTRY.pack_into(log, 0, 0.0, entries)
        time.sleep(0.004)


def forked(work):
    """Process id of a child that does `work` and ends."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pid = os.fork()
    if pid == 0:
        try:
            work()
            os._exit(0)
        finally:
            os._exit(1)
    return pid


def start(parent, name):
    """A writer in a process of its own; returns when it has recorded something."""
    log = mmap.mmap(-1, 1 << 20)
    pid = forked(lambda: write_until_killed(parent, name, log))
    while not ENTRY.unpack_from(log, 0)[1]:
        if os.waitpid(pid, os.WNOHANG)[0]:
            raise RuntimeError(f"the writer {name} ended before it was killed")
        time.sleep(0.001)
    return pid, log


def kill(pid, log, name):
    """End a writer and tell what it had handed over."""
    killed = time.monotonic()
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    entries = [ENTRY.unpack_from(log, ENTRY.size * (k + 1)) for k in range(ENTRY.unpack_from(log, 0)[1])]
    sure = [rows for at, rows in entries[: max(0, len(entries) - GONE_ON)] if at <= killed - KEPT_AFTER]
    reported = {"name": name, "sure": max(sure, default=0), "events": len(entries), "most": entries[-1][1] + 9}
    print(json.dumps(reported), flush=True)


def main(parent, count, seed):
    """A few writers at once, each killed at an instant of its own."""
    rng = random.Random(seed)
    names = [f"run-{number:04d}" for number in range(count)]
    living = []
    while names or living:
        while names and len(living) < AT_ONCE:
            name = names.pop(0)
            living.append((time.monotonic() + rng.uniform(0.02, 0.7), *start(parent, name), name))
        living.sort()
        due, pid, log, name = living.pop(0)
        time.sleep(max(0.0, due - time.monotonic()))
        kill(pid, log, name)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
