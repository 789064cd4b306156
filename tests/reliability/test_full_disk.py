"""A disk that is filled at any instant of a run leaves a sealed record with the cause and the result of the vent (R13)."""

import contextlib
import errno
import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from tests.reliability.mounts import ISOLATED, fast_folder, need_loop_mounts, need_tmpfs

ROOT = Path(__file__).parents[2]
INSTANTS = ("armed", "trial-begin", "command", "vent", "end", "turn", "seal")
"""Right before an event is written, before a stream becomes Parquet, before the seal is written."""
SPARE = 60
"""Seconds for the processes of a test to start."""


@pytest.fixture(scope="module", params=["mock", pytest.param("mock-realtime", marks=pytest.mark.realtime)])
def ended(request):
    """What each run left whose disk, a small tmpfs, was filled at an instant; `greedy`: whatever is freed is taken."""
    need_tmpfs()
    return request.param, _reported(request.param, "tmpfs", *INSTANTS, "greedy trial-begin", "greedy vent", "state")


def _reported(*arguments):
    with fast_folder() as folder:
        program = [sys.executable, "-m", "tests.reliability.test_full_disk", str(folder), *arguments]
        state = {**os.environ, "PMABENCH_STATE": str(folder / "state")}
        done = subprocess.run(
            [*ISOLATED, *program], cwd=ROOT, env=state, capture_output=True, text=True, check=False, timeout=240
        )
    assert done.returncode == 0, done.stderr
    return {reported["instant"]: reported for reported in map(json.loads, done.stdout.splitlines())}


@pytest.mark.timeout(240 + SPARE)
def test_it_is_sealed_with_the_cause_and_the_result_of_the_vent(ended, record_property):
    bench, runs = ended
    record_property("cases", len(runs))
    assert len(runs) == len(INSTANTS) + 3
    for instant, reported in runs.items():
        assert reported["sealed"], (bench, instant, reported)
        assert reported["damage"] == [], (bench, instant)
        assert reported["end"]["vent"]["result"] == "confirmed", (bench, instant)
        assert reported["listed"] == [reported["status"], reported["why"]], (bench, instant)
        if instant != "seal":
            assert (reported["status"], reported["exit_code"]) == ("error", 7), (bench, instant, reported)
            assert reported["why"].startswith("cannot write"), (bench, instant)
            assert reported["why"].count("No space left on device") == 1, (bench, instant, reported["why"])
        assert reported["hidden"] == [], (bench, instant)


@pytest.mark.timeout(240 + SPARE)
def test_a_disk_that_is_full_only_when_the_seal_is_written_costs_nothing(ended):
    reported = ended[1]["seal"]
    assert (reported["status"], reported["exit_code"], reported["why"]) == ("finished", 0, "")


@pytest.mark.timeout(240 + SPARE)
def test_the_last_events_are_there_where_nobody_takes_their_room(ended):
    for instant, reported in ended[1].items():
        if not instant.startswith("greedy"):
            assert reported["events"][-1] == "end", instant
            assert "vent" in reported["events"], instant


@pytest.mark.slow
@pytest.mark.timeout(240 + SPARE)
def test_the_room_holds_on_ext4_too():
    need_loop_mounts()
    runs = _reported("mock", "ext4", *INSTANTS, "greedy vent")
    for instant, reported in runs.items():
        assert reported["sealed"], reported
        assert reported["end"]["vent"]["result"] == "confirmed", instant
        assert reported["damage"] == [], instant


@pytest.mark.timeout(SPARE)
def test_a_run_without_room_for_its_end_does_not_begin():
    need_tmpfs()
    reported = _reported("mock", "tmpfs", "before")["before"]
    assert reported["error"].startswith("cannot write")
    assert "No space left on device" in reported["error"]
    assert reported["left"] == []
    assert reported["commanded"] == 0


# -- in a process of its own, which may mount -----------------------------------------------------------------------


def main(folder, name, kind, instants):
    """One run for each instant, each on a disk of its own."""
    for number, instant in enumerate(instants):
        place = folder / f"disk-{number}"
        place.mkdir()
        mount(place, kind)
        with contextlib.ExitStack() as stack:
            print(json.dumps({"instant": instant, **filled_at(stack, place, name, instant)}), flush=True)
        subprocess.run(["umount", "-l", place], check=True)


def mount(place, kind):
    """A disk of two megabytes (ext4: eight) at `place`."""
    if kind == "tmpfs":
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "none", place], check=True)
        return
    image = place.with_suffix(".image")
    image.write_bytes(bytes(8 << 20))
    subprocess.run(["mkfs.ext4", "-qF", "-m", "0", "-O", "^has_journal", image], check=True)
    subprocess.run(["mount", "-o", "loop", image, place], check=True)


def filled_at(stack, place, name, instant):
    """What a run leaves whose disk is filled at an instant."""
    from pmabench.base.errors import RecordError
    from pmabench.engine.operator import ConfirmedBeforehand
    from pmabench.engine.run import run_plan
    from pmabench.protocol.plan import Hold, Record, Set
    from tests.engine.benches import mounted, plan
    from tests.ports import free_port

    steps = (Record("t", True, 0), Set("h", "pressure", 2e5), Hold("h", 0.5), Set("h", "pressure", 1e5))
    test = plan(*steps, Hold("h", 0.2), Record("t", False, 0))
    if instant == "before":
        commanded = []
        fill(place)
        stack.callback(patched("pmabench.guard.guard.Guard", "_write", lambda *_: commanded.append(1)))
        try:
            run_plan(test, mounted(name), ConfirmedBeforehand(), out=place / "runs")
        except RecordError as error:
            left = [path.name for path in (place / "runs").rglob("*")]
            return {"error": str(error), "left": left, "commanded": len(commanded)}
        return {}
    if instant == "state":
        os.environ["PMABENCH_STATE"] = str(place / "state")
    greedy, instant = instant.startswith("greedy"), instant.removeprefix("greedy ")
    begin = fill_on(stack, place) if greedy else lambda: fill(place)
    bench = mounted(name)
    if name == "mock-realtime":  # on a port of its own: others may serve the shipped one
        device = replace(bench.bench.devices[0], address=f"127.0.0.1:{free_port()}")
        bench = replace(bench, bench=replace(bench.bench, devices=(device,)))
    fill_before(stack, "trial-begin" if instant == "state" else instant, begin)
    outcome = run_plan(test, bench, ConfirmedBeforehand(), out=place / "runs")
    if name == "mock-realtime":
        time.sleep(0.2)
    return looked_at(outcome, place / "runs")


def looked_at(outcome, runs):
    """The run as programs see it: its seal, the list, what `verify` finds."""
    from pmabench.store.catalogue import catalogue
    from pmabench.store.folder import read_seal
    from pmabench.store.reader import open_run
    from pmabench.store.verify import verify

    folder = outcome.folder
    seal = read_seal(folder)
    (row,) = catalogue(runs)
    run = open_run(folder)
    return {
        "sealed": seal is not None,
        "end": seal and seal["end"],
        "status": run.status,
        "why": run.manifest["why"],
        "exit_code": outcome.exit_code,
        "listed": [row.status, row.why],
        "damage": [str(finding) for finding in verify(folder)],
        "events": [event.kind for event in run.events],
        "hidden": [path.name for path in folder.rglob(".*")],
    }


def patched(owner, name, act):
    """Let `act` be called before a function of the project; gives what puts it back."""
    from importlib import import_module

    try:
        place = import_module(owner)
    except ModuleNotFoundError:
        module, _, attribute = owner.rpartition(".")
        place = getattr(import_module(module), attribute)
    whole = getattr(place, name)

    def before(*args, **kwargs):
        act(*args)
        return whole(*args, **kwargs)

    setattr(place, name, before)
    return lambda: setattr(place, name, whole)


def fill_before(stack, instant, begin):
    """Fill the disk right before an instant."""
    if instant == "seal":
        stack.callback(patched("pmabench.store.seal", "write_into_room", lambda *_: begin()))
    elif instant == "turn":
        stack.callback(patched("pmabench.store.seal", "_turn", lambda *_: begin()))
    else:
        what = ("pmabench.store.writer.RunWriter", "_event")
        stack.callback(patched(*what, lambda _writer, kind, *_: begin() if kind == instant else None))


def fill(place):
    """Take all room of a disk."""
    with (place / "filled").open("ab", buffering=0) as file:
        for size in (65536, 4096, 1):
            with contextlib.suppress(OSError):
                while file.write(b"x" * size):
                    pass


def fill_on(stack, place):
    """As `fill`, and whatever is freed after that is taken at once, by a thread; gives what begins it."""
    ended, begun = threading.Event(), threading.Event()

    def take():
        handle = os.open(place / "filled", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        while not ended.is_set():
            try:
                os.write(handle, b"x" * 4096)
            except OSError as error:
                assert error.errno == errno.ENOSPC
                begun.set()
                time.sleep(0.0001)
        os.close(handle)

    thread = threading.Thread(target=take)

    def begin():
        if not thread.ident:
            thread.start()
            begun.wait()

    def end():
        ended.set()
        if thread.ident:
            thread.join()

    stack.callback(end)
    return begin


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3], sys.argv[4:])
