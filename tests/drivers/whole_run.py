"""Whole runs through a bench's wires: emulators in one process, the program in others; who vents when what dies.

with WholeRun(tmp_path, "labjack", preset="bench") as run:
    run.carried_out(coefficients(500))
    found = run.coefficients()
The operator's hands are the control socket: what the run's record says was put on is put on. The emulator's log of what
was commanded is the judge of every vent.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import pandas as pd

from tests.drivers.common import until
from tests.drivers.emulated_bench import ask, emulate, own_bench

SPECIMEN = "mas-20-250-paper0"
LONGEST = 150.0
"""Longest that a run of these protocols takes on a machine that has much else to do [s]."""
TRIES = 3
BUSY = (
    "did not answer within",
    "no answer from",
    "has not answered yet",
    "Write timeout",
    "engine was silent",
    "stale",
    "has not asked",
    "no sample for",
    "no heartbeat for",
)
"""Ends of a run at which nothing is wrong but that processes were not given the time they need."""
HEAD = """\
schema: pmabench.protocol/1
kind: contraction-relaxation
name: {name}
source: made for this test
needs: {{free_end: weights}}
sample_rate: {rate} Hz
record: [pressure, displacement, force, pressure_command]
"""
ONE_STEP = """\
prepare: {precondition: {cycles: 1, pressure: 200 kPa, hold: 500 ms}}
sweep: {matrix: {load: [6 kg], pressure: [300 kPa]}, order: as-written, repeat: {count: 1, as: blocks}}
trial: {baseline: 200 ms, contract: {hold: 3 s}, relax: {by: 100 kPa, hold: 1 s, then: 0 kPa, hold_at_end: 1 s}}
"""
FOUR_TRIALS = """\
prepare: {precondition: {cycles: 1, pressure: 300 kPa, hold: 1 s}}
sweep: {matrix: {load: [6 kg, 16 kg], pressure: [300 kPa, 400 kPa]}, order: snake, repeat: {count: REPEATS, as: blocks}}
trial: {baseline: 200 ms, contract: {hold: 2 s}, relax: {by: 100 kPa, hold: 1 s, then: 0 kPa, hold_at_end: 1 s}}
"""
GUIDED = ("session", "self-test", "calibration", "setup")


def one_step(rate=50):
    """One contraction of 300 kPa under 6 kg, some 10 s."""
    return HEAD.format(name="one step up, one down", rate=rate) + ONE_STEP


def coefficients(rate, repeats=1):
    """Two loads at two pressures, some 35 s: the least from which K, B and F_ce come with small intervals."""
    four = FOUR_TRIALS.replace("REPEATS", str(repeats))
    return HEAD.format(name="two loads, two pressures", rate=rate) + four


def children(pid, word):
    """Processes that `pid` has started and whose command line has the word."""
    found = []
    for path in Path("/proc").iterdir():
        if path.name.isdecimal():
            try:
                parent = int((path / "stat").read_text().rsplit(")", 1)[1].split()[1])
                words = (path / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if parent == pid and word.encode() in words:
                found.append(int(path.name))
    return found


class WholeRun:
    """The emulators of a shipped bench, and a run of the program on it."""

    def __init__(self, tmp_path, bench, *changes, preset="ideal", session=False):
        self.folder, self.out, self.preset = tmp_path, tmp_path / "runs", preset
        self.path = own_bench(tmp_path, bench, *changes, session=session)
        self.changed = bool(changes)
        self.control = ""
        self.process = None
        self._began = 0.0
        self._guards: set[int] = set()
        self._ended = threading.Event()
        self._stack = ExitStack()

    def __enter__(self):
        truth = () if self.changed else ("--truth", self.path.stem)
        _process, said = self._stack.enter_context(emulate(self.path, "--preset", self.preset, *truth))
        self.control = said["control"]
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._kill()
        self._stack.close()

    def begin(self, protocol):
        """`pmabench run` of a protocol's text, in place of one that was begun before; its hands follow the record."""
        self._kill()
        for before in self.out.glob("*"):
            shutil.rmtree(before)
        file = self.folder / "protocol.yaml"
        file.write_text(protocol)
        given = [str(file), "--bench", str(self.path), "--specimen", SPECIMEN, "--yes", "--out", str(self.out)]
        self._began = time.monotonic()
        with (self.folder / "said.txt").open("w") as said:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "pmabench", "run", *given, "--no-color"],
                stdout=said,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env={**os.environ, "PMABENCH_STATE": str(self.folder / "state" / f"{self._began:.0f}")},
            )
        with suppress(OSError):  # a computer at a bench has nothing else to do
            os.setpriority(os.PRIO_PROCESS, self.process.pid, -5)
        threading.Thread(target=self._hands, args=(self.process,), daemon=True).start()

    def carried_out(self, protocol):
        """A whole run that ends well; what it said. 6: so few repeats may leave its own verdict open."""

        def once():
            self.begin(protocol)
            self.process.wait(LONGEST)
            return self.process.returncode in {0, 6}

        self._again(once)
        return self.said

    def pressurised(self, protocol, pressure=199e3):
        """A run that has commanded so much [Pa]."""

        def once():
            self.begin(protocol)
            assert until(lambda: self.over or any(value >= pressure for value in self.commanded()), 60), self.said
            return not self.over

        self._again(once)

    def _again(self, once):
        """Do it once, and again where a machine that has too much else to do has ended it: that is not looked at here."""
        for _ in range(TRIES - 1):
            if once():
                return
            assert any(word in self.said for word in BUSY), self.said
            print(f"again, since the machine is busy: {self.said.splitlines()[-2]}")
        assert once(), self.said

    def failed(self, code=None):
        """What the run said, after an end that is none of its own choice."""
        self.process.wait(LONGEST)
        said = self.said
        assert self.process.returncode not in {0, None}, said
        assert code is None or self.process.returncode == code, said
        assert "Traceback" not in said
        return said

    @property
    def said(self):
        return (self.folder / "said.txt").read_text()

    def _kill(self):
        """Nothing of the run is left."""
        if self.process is not None:
            pids = {self.process.pid, *self.guards()}
            for pid in pids:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            self.process.wait()
            self._guards.clear()

    # -- the emulator's side --------------------------------------------------------------------------------------

    def ask(self, **wanted):
        answer = ask(self.control, **wanted)
        assert answer["ok"], answer
        return answer

    def entries(self, kind):
        """The log's entries of a kind since the run was begun."""
        return [entry for entry in self.ask(log=kind)["entries"] if entry["t"] >= self._began]

    @property
    def over(self):
        return self.process.poll() is not None

    def commanded(self):
        """Every pressure that was commanded [Pa]."""
        return [entry["si"] for entry in self.entries("set")]

    def vented_after(self, moment, within=10.0):
        """What made the bench safe after a moment, first: (seconds, log entry). Fails unless all of it was done."""
        found = []

        def safe():
            found[:] = sorted(
                (entry["t"], kind, entry)
                for kind in ("set", "switch", "watchdog")
                for entry in self.entries(kind)
                if entry["t"] >= moment and (kind == "watchdog" or entry.get("si") == 0.0 or entry.get("on") is False)
            )
            return bool(found)

        assert until(safe, within), f"nothing vented within {within:g} s"
        t, kind, entry = found[0]
        return t - moment, {"kind": kind, **entry}

    # -- what dies ------------------------------------------------------------------------------------------------

    def guards(self):
        """The pid of the run's guard, also after its end."""
        self._guards.update(children(self.process.pid, "pmabench.guard"))
        return self._guards

    def signal(self, who, number):
        """A signal to `engine`, `guard` or `both`."""
        guards = self.guards()
        assert guards
        for pid in {"engine": [self.process.pid], "guard": guards, "both": [*guards, self.process.pid]}[who]:
            os.kill(pid, number)

    # -- hands ----------------------------------------------------------------------------------------------------

    def _hands(self, process):
        """Put on what the record says was put on."""
        done: dict[Path, int] = {}
        while not self._ended.wait(0.1) and process.poll() is None:
            for path in [*self.out.glob("*/events.jsonl"), *self.out.glob(".*/events.jsonl")]:
                *lines, _torn = path.read_text().split("\n")
                for line in lines[done.get(path, 0) :]:
                    event = json.loads(line)
                    if event["kind"] == "load":
                        self.ask(load={"force": event["data"]["force"], "mass": event["data"]["mass"]})
                done[path] = len(lines)

    # -- the record -----------------------------------------------------------------------------------------------

    @property
    def record(self):
        """The folder of the one run with trials."""
        folders = [path.parent for path in self.out.glob("[0-9]*/manifest.json")]
        [found] = [path for path in folders if json.loads((path / "manifest.json").read_text())["kind"] not in GUIDED]
        return found

    def stream(self, name):
        """A stream as a table."""
        return pd.read_parquet(self.record / "streams" / f"{name}.parquet")

    def events(self, kind):
        lines = (self.record / "events.jsonl").read_text().splitlines()
        return [event for event in map(json.loads, lines) if event["kind"] == kind]

    def coefficients(self):
        """(symbol, kPa) -> estimate of the primary method, as `pmabench process` gives them."""
        command = [sys.executable, "-m", "pmabench", "process", str(self.record), "--json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, check=False)
        assert done.returncode in {0, 6}, done.stderr
        [analysis] = json.loads(done.stdout)["analyses"]
        return {
            (e["symbol"], round(e["at"]["pressure"] / 1e3)): e
            for e in analysis["estimates"]
            if e["method"] == "measured-pressure" and "pressure" in e["at"]
        }
