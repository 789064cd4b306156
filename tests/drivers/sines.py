"""Sine runs of the rigs whose actuator holds the free end, and what is judged of them."""

import json
import subprocess
import sys
import time

from tests.drivers.common import until
from tests.drivers.whole_run import LONGEST

SINES = """\
schema: pmabench.protocol/1
kind: sinusoidal-displacement
name: sines at one pressure
source: made for this test
needs: {free_end: actuator}
sample_rate: 50 Hz
record: [pressure, displacement, force, pressure_command, displacement_command]
prepare: {precondition: {cycles: 1, pressure: 300 kPa, hold: 500 ms}}
sweep: {matrix: {pressure: [300 kPa], frequency: FREQUENCIES}, order: as-written, repeat: {count: 3, as: blocks}}
trial: {mean: 10 mm, amplitude: 5 mm, cycles: 6, at_least: 6 s, discard: 1, settle: 1 s, approach: 20 mm/s}
"""
TRUE = {"K": 6773.0, "B": 1900.0}
"""Reference plant 5.1 at 300 kPa: K = 5.6 + 1e-3 P + 9.7e-6 P^2, B the mean of 1.2 + 1.6e-3 P and 1.1 + 3.4e-3 P."""


def sines(*frequencies):
    return SINES.replace("FREQUENCIES", f"[{', '.join(f'{f:g} Hz' for f in frequencies)}]")


def pooled(run):
    """Symbol -> estimate at 300 kPa from all frequencies, as `pmabench process` gives it."""
    command = [sys.executable, "-m", "pmabench", "process", str(run.record), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, check=False)
    assert done.returncode in {0, 6}, done.stderr
    [analysis] = json.loads(done.stdout)["analyses"]
    return {
        e["symbol"]: e
        for e in analysis["estimates"]
        if e["method"] in {"sine-harmonic", "sine-mean"} and "frequency" not in e["at"] and not e["coordinate"]
    }


def dying(run, act):
    """Under pressure and in motion `act` happens: the time when."""
    for _ in range(3):
        run.pressurised(sines(0.5))
        if until(lambda: run.over or len(run.entries("move")) > 100, 60) and not run.over:
            break
    assert not run.over, run.said
    moment = time.monotonic()
    act(run)
    return moment


def stopped_after(run, drive, moment, within):
    """The drive has stopped and the bench is vented within a time of a moment [s], and both stay so."""

    def stops():
        found = [e for kind in ("halt", "watchdog") for e in run.entries(kind) if e["t"] >= moment]
        return [e["t"] for e in found if e["device"] == drive]

    assert until(stops, within)
    first = min(stops())
    took, entry = run.vented_after(moment)
    print(f"drive stopped after {1e3 * (first - moment):.0f} ms, {entry['kind']} after {1e3 * took:.0f} ms")
    assert max(first - moment, took) < within
    time.sleep(0.5)
    assert not [e for e in run.entries("move") if e["t"] > first + 0.05]
