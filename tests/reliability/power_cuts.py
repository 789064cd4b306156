"""Cuts the power of a recorder: copies a mounted disk image while runs are written to it, and looks at the copies.

`python power_cuts.py FOLDER COUNT SEED` prints one JSON line per cut. Needs root and loop mounts. The image is copied
while the writer stands still, so that the copy is what the disk held at one instant; what the operating system had not
yet handed to the disk is not in it. Each copy is mounted, which replays its journal, as after a power cut.
"""

import json
import mmap
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pmabench.store.folder
from pmabench.store.folder import MANIFEST
from pmabench.store.reader import open_run, read_stream
from pmabench.store.seal import close_interrupted
from pmabench.store.verify import verify
from tests.store.killed_writer import forked
from tests.store.runs import begin, block

SURVIVES = 2.0
"""What was handed over so long before a cut [s] is on the disk."""
GONE_ON = 100
"""... where the writer went on so many times after that: a machine may stand still."""
SIZE = 32 << 20
CUTS_PER_IMAGE = 40
ENTRY = struct.Struct("dqqq")
CREATED, ROWS, CLOSING, CLOSED = range(4)


def main(folder, count, seed):
    """Images one after another, each with a writer that is cut off `CUTS_PER_IMAGE` times."""
    rng = random.Random(seed)
    done = 0
    while done < count:
        cuts = min(CUTS_PER_IMAGE, count - done)
        with Disk(folder / "disk.img", folder / "disk") as disk:
            log = mmap.mmap(-1, 16 << 20)
            pid = forked(partial(write_runs, disk.place / "runs", log, rng.random()))
            try:
                for _ in range(cuts):
                    time.sleep(rng.uniform(0.0, 0.25))
                    done += 1
                    print(json.dumps({"cut": done, "wrong": cut(disk, pid, log, folder)}), flush=True)
            finally:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)


class Disk:
    """A small ext4 file system in a file, mounted."""

    def __init__(self, image, place, *, made=True):
        self.image, self.place, self.made = image, place, made

    def __enter__(self):
        self.place.mkdir(exist_ok=True)
        if self.made:
            self.image.unlink(missing_ok=True)
            with self.image.open("wb") as file:
                file.truncate(SIZE)
            subprocess.run(["mkfs.ext4", "-qF", self.image], check=True, capture_output=True)
        subprocess.run(["mount", "-o", "loop", self.image, self.place], check=True, capture_output=True)
        return self

    def __exit__(self, *_):
        subprocess.run(["umount", self.place], check=True, capture_output=True)


def write_runs(parent, log, seed):
    """One run after another until killed, each noted in memory that survives; old ones go, so that the disk holds."""
    pmabench.store.folder._boot = lambda: "before the cut"
    rng = random.Random(seed)
    entries = 0

    def note(kind, run, rows=0):
        nonlocal entries
        entries += 1
        ENTRY.pack_into(log, ENTRY.size * entries, time.monotonic(), kind, run, rows)
        ENTRY.pack_into(log, 0, 0.0, entries, 0, 0)

    starter, run = os.getppid(), 0
    while os.getppid() == starter:
        if run > 3:
            shutil.rmtree(parent / f"run-{run - 4}")
        writer = begin(parent, f"run-{run}")
        note(CREATED, run)
        rows = 0
        ends = time.monotonic() + rng.choice((0.1, 0.5, 4.0))
        while time.monotonic() < ends and os.getppid() == starter:
            size = rng.randint(1, 9)
            writer.append("daq", *block(rows, size))
            rows += size
            note(ROWS, run, rows)
            time.sleep(0.004)
        note(CLOSING, run, rows)
        writer.close("finished")
        note(CLOSED, run, rows)
        run += 1


def cut(disk, pid, log, folder):
    """What is wrong on the disk after a cut now; empty: nothing."""
    os.kill(pid, signal.SIGSTOP)
    cut_at = time.monotonic()
    entries = [ENTRY.unpack_from(log, ENTRY.size * (k + 1)) for k in range(ENTRY.unpack_from(log, 0)[1])]
    shutil.copyfile(disk.image, folder / "cut.img")
    os.kill(pid, signal.SIGCONT)
    with Disk(folder / "cut.img", folder / "cut", made=False) as after:
        return look(after.place / "runs", entries, cut_at)


def look(parent, entries, cut_at):
    """Holds every run on the disk against what its writer had handed over."""
    newest = entries[-1][2] if entries else 0
    wrong = []
    for run in range(max(0, newest - 2), newest + 2):
        reported = [entry for entry in entries if entry[2] == run]
        kinds = {entry[1] for entry in reported}
        folder = parent / f"run-{run}"
        if not (folder / MANIFEST).exists():
            if CREATED in kinds:
                wrong.append(f"{folder.name}: its folder is gone")
            continue
        before = reported[: max(0, len(reported) - GONE_ON)]
        sure = max((entry[3] for entry in before if entry[0] <= cut_at - SURVIVES), default=0)
        most = reported[-1][3] if CLOSED in kinds or CLOSING in kinds else 10**9
        if CLOSED in kinds:
            sure = most
        try:
            wrong += [f"{folder.name}: {what}" for what in examine(folder, sure, most, CLOSED in kinds)]
        except Exception as error:
            wrong.append(f"{folder.name}: {type(error).__name__}: {error}")
    return wrong


def examine(folder, sure, most, closed):
    """Sentences about one run."""
    opened = open_run(folder)
    if closed and opened.status != "finished":
        yield f"was closed and is {opened.status}"
    if not closed and opened.status not in ("interrupted", "finished"):
        yield f"was not closed and is {opened.status}"
    samples = opened.status == "finished" or any((folder / "streams").glob("daq.*ar*"))
    kept = read_stream(folder, raw=True) if samples and "pressure" in opened.channels else None
    rows = 0 if kept is None else len(kept)
    if not sure <= rows <= most:
        yield f"has {rows} rows; {sure} were handed over {SURVIVES:g} s before the cut, {most} at all"
    if kept is not None:
        time_ns, raw, flags = block(0, rows)
        same = kept["time_ns"].tolist() == time_ns.tolist() and kept["flags"].tolist() == flags.tolist()
        if not same or any(kept[name].tolist() != raw[name].tolist() for name in raw):
            yield "holds a wrong value"
    if opened.status == "interrupted":
        close_interrupted(folder)
        again = 0 if kept is None else len(read_stream(folder, raw=True))
        if again != rows:
            yield f"had {rows} rows and has {again} since it was closed as interrupted"
    findings = verify(folder)
    if findings:
        yield f"is closed, but {findings[0]}"


if __name__ == "__main__":
    pmabench.store.folder._boot = lambda: "after the cut"  # the machine starts anew
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
