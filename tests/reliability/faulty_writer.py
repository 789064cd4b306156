"""A recorder whose n-th call of the operating system fails; a program of its own.

`python faulty_writer.py FOLDER CALL ERROR FIRST STEP` records one run after another into FOLDER/CALL-N with the N-th
CALL on it failing (strace), N = FIRST, FIRST + STEP ... until none failed any more. One JSON line per run: its folder,
whether a call failed, and how the recorder ended: `finished`, `reported` (RecordError), or what else was raised.
"""

import ctypes
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from pmabench.base.errors import RecordError
from tests.store.killed_writer import forked
from tests.store.runs import begin, block, record

MAY_BE_TRACED = 0x59616D61
"""prctl: any process of the same user may trace this one, also where the system is strict (Yama)."""
OUTCOMES = {0: "finished", 7: "reported"}


def write_run(parent, ready, gate):
    """One run, as an engine writes it: when told of a failure it ends the run."""
    ctypes.CDLL(None).prctl(MAY_BE_TRACED, ctypes.c_ulong(-1), 0, 0, 0)
    os.write(ready, b"x")
    os.read(gate, 1)
    try:
        writer = begin(parent)
        try:
            record(writer, 200)
            for first in range(200, 400, 20):
                writer.append("daq", *block(first, 20))
                time.sleep(0.01)
        except RecordError:
            try:
                writer.close("error", "the record failed")
            finally:
                os._exit(7)
        writer.close("finished")
    except RecordError:
        os._exit(7)
    os._exit(0)


def attempt(parent, call, error, number):
    """One run with the `number`-th `call` failing."""
    parent.mkdir()
    (entry, gate), (reported, ready) = os.pipe(), os.pipe()
    pid = forked(lambda: write_run(parent, ready, entry))
    os.read(reported, 1)
    log = parent.with_suffix(".strace")
    places = [argument for name in _files(parent) for argument in ("-P", str(name))]
    inject = f"inject={call}:error={error}:when={number}"
    options = ["-f", "-qq", "-o", str(log), "-e", f"trace={call}", "-e", inject, *places]
    tracer = subprocess.Popen(["strace", *options, "-p", str(pid)], stderr=subprocess.PIPE)
    while "TracerPid:\t0" in Path(f"/proc/{pid}/status").read_text():
        if tracer.poll() is not None:
            raise RuntimeError(tracer.stderr.read().decode())
        time.sleep(0.002)
    os.write(gate, b"x")
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    tracer.wait(10)
    tracer.stderr.close()
    for pipe in (entry, gate, reported, ready):
        os.close(pipe)
    failed = "(INJECTED)" in log.read_text()
    how = OUTCOMES.get(status, f"ended with {status}")
    print(json.dumps({"parent": str(parent), "failed": failed, "how": how, "number": number}), flush=True)
    return failed


def _files(parent):
    """What strace watches: every file and folder that a run will consist of."""
    run = parent / "run"
    names = ["manifest.json", "events.jsonl", "seal.json", "streams/daq.arrows", "streams/daq.json", "plan.json"]
    names += ["streams/daq.parquet", "README.txt", "protocol.yaml", "calibrations/P-0231.yaml"]
    for name in names:
        path = run / name
        yield path
        yield path.with_name(f".{path.name}.part")
    yield from (parent, run, run / "streams", run / "calibrations")


def main(parent, call, error, first, step):
    """Until no call failed any more."""
    number = first
    while attempt(parent / f"{call}-{number}", call, error, number):
        number += step


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5]))
