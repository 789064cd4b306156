"""Failing to record fails the run and loses nothing that was written: full disks, limits, read-only folders, errors (R8)."""

import json
import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pmabench.store.folder import MANIFEST
from pmabench.store.reader import open_run, read_stream
from pmabench.store.verify import verify
from tests.reliability.cases import cases
from tests.reliability.mounts import ISOLATED, fast_folder, need_tmpfs
from tests.store.runs import block

ROOT = Path(__file__).parents[2]
CALLS = [
    ("write", "EIO"),
    ("write", "ENOSPC"),
    ("fsync", "EIO"),
    ("fdatasync", "EIO"),
    ("rename", "EIO"),
    ("openat", "ENOSPC"),
    ("mkdir", "ENOSPC"),
]
STEP = 1 if cases(0) else 11
"""Every call fails once on demand, every eleventh with each commit."""
FULL = cases(6)


def what_is_wrong(folder, how, most):
    """Sentences about a run whose recorder ended so; `most` rows were handed over."""
    if how not in ("finished", "reported"):
        yield f"the recorder {how}"
    if not (folder / MANIFEST).exists():
        if how != "reported":
            yield "there is no run, and nobody heard of it"
        elif folder.exists():
            yield "half a folder was left behind"
        return
    run = open_run(folder)
    kept = read_stream(folder, raw=True) if "pressure" in run.channels else None
    rows = 0 if kept is None else len(kept)
    raw = block(0, rows)[1]
    if kept is not None and any(kept[name].tolist() != raw[name].tolist() for name in raw):
        yield "a value is wrong"
    if run.status == "finished" or how == "finished":
        if rows != most or run.status != "finished":
            yield f"is {run.status} with {rows} of {most} rows; its recorder {how}"
        yield from (str(finding) for finding in verify(folder))
    elif run.status not in ("error", "running", "interrupted"):
        yield f"was reported as incomplete, and is {run.status}"
    elif run.status == "error":
        yield from (str(finding) for finding in verify(folder))


@pytest.mark.slow
@pytest.mark.parametrize(("call", "error"), CALLS, ids=lambda value: str(value))
def test_a_call_that_fails_is_reported_or_nothing_is_missing(tmp_path, record_property, call, error):
    if shutil.which("strace") is None or not _traceable():
        pytest.skip("not run: strace (to let calls of the operating system fail)")
    program = [sys.executable, "-m", "tests.reliability.faulty_writer"]
    command = [*program, str(tmp_path), call, error, "1", str(STEP)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=280)
    assert done.returncode == 0, done.stderr
    reported = [json.loads(line) for line in done.stdout.splitlines()]
    wrong = []
    for entry in reported:
        found = list(what_is_wrong(Path(entry["parent"]) / "run", entry["how"], 400))
        if call in ("fsync", "fdatasync") and entry["failed"] and entry["how"] != "reported":
            found.append("a sync failed and nobody heard of it")
        wrong += [f"{call} {entry['number']}: {what}" for what in found]
    record_property("cases", len(reported))
    assert reported[0]["failed"]
    assert (reported[-1]["failed"], reported[-1]["how"]) == (False, "finished")
    assert not wrong, "\n".join(wrong)


def _traceable():
    return subprocess.run(["strace", "-o", "/dev/null", "true"], capture_output=True, check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.timeout(60 + FULL)
def test_a_full_disk_ends_the_run_and_keeps_what_was_written(record_property):
    need_tmpfs()
    with fast_folder() as folder:
        command = [*ISOLATED, sys.executable, "-m", "tests.reliability.test_disk_faults", str(folder), str(FULL)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    reported = [json.loads(line) for line in done.stdout.splitlines()]
    record_property("cases", len(reported))
    assert len(reported) == FULL + 1
    assert [entry for entry in reported if entry["wrong"]] == []
    assert all(entry["reported"] for entry in reported)


def fill_disks(folder, count):
    """Records on a small tmpfs until it is full, with blocks of another size each time; then on a read-only one."""
    from pmabench.base.errors import RecordError
    from tests.store.runs import begin

    place = folder / "small"
    place.mkdir()
    rng = random.Random(5)
    for number in range(count):
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "none", place], check=True)
        (place / "filled").write_bytes(bytes(rng.randrange(0, 800_000)))
        rows, reported, size = 0, 0, rng.randint(200, 3000)
        try:
            writer = begin(place)
            try:
                while rows < 200_000:
                    writer.append("daq", *block(rows, size))
                    rows += size
                    writer.event("mark", rows / 500, rows=rows)
            finally:
                writer.close("error", "the disk is full")
        except RecordError as error:
            reported = error.exit_code
        wrong = list(what_is_wrong(place / "run", "reported", rows))
        print(json.dumps({"case": number, "reported": reported == 7, "wrong": wrong}), flush=True)
        subprocess.run(["umount", place], check=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "none", place], check=True)
    reported = 0
    try:
        begin(place)
    except RecordError as error:
        reported = error.exit_code if "Read-only file system" in str(error) else 0
    print(
        json.dumps({"case": "read-only", "reported": reported == 7, "wrong": [str(p) for p in place.iterdir()]}),
        flush=True,
    )
    subprocess.run(["umount", place], check=True)


if __name__ == "__main__":
    fill_disks(Path(sys.argv[1]), int(sys.argv[2]))
