"""Runs beside busy processes: none may end by itself. `python -m tests.outside.busy [--minutes M] [--load N] ...`.

`--first` runs at a time with real-time priority, `--ordinary` runs without it, again and again until the time is over,
beside `--load` processes that never rest. Each is ended by SIGTERM after `LASTS`; an end before that is spurious.
Prints the hours of runs, the spurious ends by reason, and how long each SIGTERM took to reach the device. Nothing else
with real-time priority may run on the machine meanwhile: that starves the runs without it.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.outside.campaign import safe_lines
from tests.outside.harness import Run, eventually, regulator, write_bench

LASTS = 240.0
"""Length of one run [s]."""
PROTOCOLS = ("steps", "ramps", "holds")
HARDWARE = 50
"""Real-time priority of the regulator: a device has a processor to itself."""
ORDINARY = ("setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice")
"""Takes the right to real-time priority from a program and its children."""


@dataclass
class Seen:
    """What came of the runs of one kind."""

    name: str
    prefix: tuple[str, ...]
    seconds: float = 0.0
    runs: int = 0
    ends: list[str] = field(default_factory=list)
    """Reasons of runs that ended by themselves."""
    vents: list[float] = field(default_factory=list)
    """From SIGTERM to what the device executed [s]."""

    def __str__(self) -> str:
        ms = [1e3 * value for value in self.vents]
        vents = f"SIGTERM to vent median {statistics.median(ms):.0f}, longest {max(ms):.0f} ms" if ms else "no vent"
        first = (
            f"{self.name}: {self.runs} runs, {self.seconds / 3600:.2f} h under way, "
            f"{len(self.ends)} spurious ends; {vents}"
        )
        return "\n".join([first, *(f"  {reason[:150]}" for reason in self.ends)])


@contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes that never rest."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def one_run(seen: Seen, number: int, folder: Path, lasts: float) -> None:
    """One run on a regulator of its own, from its first pressure on for `lasts` seconds."""
    protocol = PROTOCOLS[number % len(PROTOCOLS)]
    with regulator(folder) as device:
        os.sched_setscheduler(device.pid, os.SCHED_RR, os.sched_param(HARDWARE))
        bench = write_bench(folder / "bench", "outside", device.address, watched=True)
        going = Run(bench, protocol, folder / "state", device, prefix=seen.prefix)
        try:
            going.pressurised()
            began = time.monotonic()
            while time.monotonic() < began + lasts and going.process.poll() is None:
                time.sleep(0.2)
            seen.runs += 1
            seen.seconds += time.monotonic() - began
            if going.process.poll() is not None:
                outcome = going.end()
                if outcome["exit_code"]:
                    seen.ends.append(f"{protocol}, after {time.monotonic() - began:.0f} s: {outcome['why']}")
                return
            moment = time.monotonic()
            going.process.send_signal(signal.SIGTERM)
            seen.vents.append(eventually(lambda: safe_lines(device, moment), so="SIGTERM vents")[0]["t"] - moment)
            going.end(60.0)
        finally:
            going.kill()


def again(seen: Seen, offset: int, until: float, folder: Path, lasts: float) -> None:
    """One run after the other until the time is over."""
    number = offset
    while time.monotonic() < until:
        try:
            one_run(seen, number, folder / f"{number}", lasts)
        except (AssertionError, subprocess.TimeoutExpired) as error:  # it did not begin, or did not vent
            seen.ends.append(f"{type(error).__name__}: {error}")
        number += 1


def campaign(minutes: float, load: int, first: int, ordinary: int, folder: Path) -> list[Seen]:
    """Runs with and without real-time priority side by side."""
    found = [Seen("with real-time priority", ()), Seen("without", ORDINARY)]
    until = time.monotonic() + 60 * minutes
    with busy(load), ThreadPoolExecutor(first + ordinary) as pool:
        jobs = [
            pool.submit(again, seen, slot, until, folder / f"{kind}-{slot}", min(LASTS, 60 * minutes))
            for kind, (seen, count) in enumerate(zip(found, (first, ordinary), strict=True))
            for slot in range(count)
        ]
        for job in jobs:
            job.result()
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--load", type=int, default=8, help="processes that never rest")
    parser.add_argument("--first", type=int, default=2, help="runs at a time with real-time priority")
    parser.add_argument("--ordinary", type=int, default=2, help="runs at a time without it")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for seen in campaign(asked.minutes, asked.load, asked.first, asked.ordinary, Path(folder)):
            print(seen, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
