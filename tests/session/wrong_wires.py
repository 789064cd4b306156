"""Wrong bench files tried over the wires of emulated rigs; the emulators keep the scales of the right file.

`python -m tests.session.wrong_wires [RIG[:PATTERN] ...]` prints the matrix of rig and fault; a pattern picks faults.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import threading
from contextlib import contextmanager
from pathlib import Path

from tests.drivers.emulated_bench import ask, emulate, own_bench
from tests.drivers.whole_run import BUSY, TRIES
from tests.session.wrong_benches import RIGS, SESSION, faults_of, plain

SPECIMEN = "mas-20-250-paper0"
LONGEST = 180.0
"""Longest that a self-test takes on a machine that has much else to do [s]."""
HANDS_LINE = "hands: {below: 20 kPa}\n"
NAMED, FOUND, NOT_CHECKED, MISSED = "named", "found, wire not named", "not checked", "missed"
INVALID_FILE = 3
"""Exit code of a file that `check` refuses."""
REFUSED, BY_DRIVER = "refused by check", "refused by the device's driver"


class Rig:
    """Emulators of a right bench file, and the self-test of any other file on them."""

    def __init__(self, folder, path, control):
        self.folder, self.path, self.control = folder, path, control
        self.count = 0

    def faults(self):
        return faults_of(self.path.stem, plain(self.path))

    def tried(self, fault, load=0.0):
        """What comes of a fault: one of the words above, and all that was said."""
        self.count += 1
        code, said = self.probe(fault.wrong_file(self.path, self.folder / f"wrong-{self.count}"), load)
        if code == 0:
            what = fault.name.split(":")[0].removesuffix(" exchanged")
            said_so = any(what in line and line.rstrip().endswith(NOT_CHECKED) for line in said.splitlines())
            return (NOT_CHECKED if said_so else MISSED), said
        if any(terminal in said for terminal in fault.terminals):
            return NAMED, said
        if code == INVALID_FILE:
            return REFUSED, said
        devices = {terminal.split(".")[0] for terminal in fault.terminals}
        return (BY_DRIVER if any(said.startswith(f"{device}.") for device in devices) else FOUND), said

    def probe(self, path, load=0.0):
        """`pmabench bench probe --self-test` of a file: exit code and all that it said; `load` [N] is on before.

        Again where a machine that has too much else to do has ended it.
        """
        for _ in range(TRIES):
            code, said = self._once(path, load)
            if code == 0 or not any(word in said for word in (*BUSY, "did not answer")):
                break
        return code, said

    def _once(self, path, load):
        ask(self.control, load={"force": load, "mass": load / 9.81 + 2.0})
        self.count += 1
        out, state = self.folder / f"runs-{self.count}", self.folder / f"state-{self.count}"
        command = [
            sys.executable,
            "-m",
            "pmabench",
            "bench",
            "probe",
            str(path),
            "--self-test",
            "--specimen",
            SPECIMEN,
        ]
        process = subprocess.Popen(
            [*command, "--yes", "--no-color", "--out", str(out)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "PMABENCH_STATE": str(state), "COLUMNS": "500"},
            start_new_session=True,
        )
        over = threading.Event()
        hands = threading.Thread(target=self._hands, args=(out, over))
        hands.start()
        try:
            said, _ = process.communicate(timeout=LONGEST)
        finally:
            process.kill()
            over.set()
            hands.join()
        return process.returncode, said

    def _hands(self, out, over):
        """Put on what the record says was put on."""
        done = 0
        while not over.wait(0.05):
            for path in [*out.glob("*/events.jsonl"), *out.glob(".*/events.jsonl")]:
                *lines, _torn = path.read_text().split("\n")
                for event in map(json.loads, lines[done:]):
                    if event["kind"] == "load":
                        ask(self.control, load={key: event["data"][key] for key in ("force", "mass")})
                done = len(lines)


@contextmanager
def emulated_rig(folder, name, *, seed=1):
    """A rig on ports of its own."""
    session = f"session: {json.dumps(SESSION)}\n"
    changes = (
        []
        if "\nsession:" in own_bench(folder, name, session=True).read_text()
        else [(HANDS_LINE, HANDS_LINE + session)]
    )
    path = own_bench(folder, name, *changes, session=True)
    with emulate(path, "--preset", "bench", "--seed", str(seed)) as (_process, said):
        yield Rig(folder, path, said["control"])


def main(names):
    """The matrix, a line for each fault; 1 where one is missed or its wire is not named."""
    bad = 0
    for wanted in names or RIGS:
        name, _, pattern = wanted.partition(":")
        with tempfile.TemporaryDirectory() as folder, emulated_rig(Path(folder), name) as rig:
            code, said = rig.probe(rig.path)
            print(f"{name:10}  {'right bench':50}  {'passes' if code == 0 else 'FALSE ALARM'}", flush=True)
            bad += code != 0
            if code:
                print(said)
            for fault in [fault for fault in rig.faults() if re.search(pattern, fault.name)]:
                word, said = rig.tried(fault)
                print(f"{name:10}  {fault.name:50}  {word}", flush=True)
                bad += word in {FOUND, MISSED}
                if word in {FOUND, MISSED}:
                    print(said)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
