"""Every cause of an end, in every kind of step, in real time: vented once, and recorded truthfully (S3, S4, S5, R8).

With every commit each cause once, the kinds of steps taking turns; on demand every cause with every kind.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections import defaultdict
from functools import partial
from pathlib import Path

import pytest

from pmabench.store.reader import open_run
from tests.engine.forked import Forks, limit_file_size
from tests.engine.realtime_rig import KINDS, Run, act_at, assert_safe_since, served, table, vent, with_reader
from tests.realtime import eventually
from tests.reliability.cases import VARIABLE

pytestmark = pytest.mark.realtime
GENEROUS = 3.0
STEPS = [kind for kind in KINDS if kind != "short"]
TIMES = defaultdict(list)


@pytest.fixture(scope="module")
def forks():
    with Forks() as parent:
        yield parent
    table("time from the cause to the first safe command", TIMES)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    with served(tmp_path_factory.mktemp("plant"), slow_vent=1.5) as (bench, plant):
        yield bench, plant


def signals(*numbers):
    def act(run):
        for place, number in enumerate(numbers):
            if place:
                time.sleep(0.06)
            os.kill(run.pid, number)

    return act


def fault(name):
    return lambda run: run.plant.inject(name)


def touch(job):
    return lambda run: (run.folder / job).touch()


def no_more_bytes(run):
    streams = (run.folder / "runs").glob("*/streams/*")
    limit_file_size(run.pid, max((path.stat().st_size for path in streams), default=0))


def fill_disk(run):
    with (run.folder / "filler").open("wb", buffering=0) as filler:
        for size in (1 << 16, 512, 1):
            try:
                while True:
                    filler.write(b"\0" * size)
            except OSError:
                continue


CAUSES = {
    # name: what happens, status, exit codes, outcome of the vent, what its record says
    "exception in a step": (touch("raise"), "error", {1}, "confirmed", "ZeroDivisionError"),
    "Ctrl-C": (signals(signal.SIGINT), "aborted", {130}, "confirmed", "Ctrl-C"),
    "Ctrl-C again in the vent": (signals(*[signal.SIGINT] * 4), "aborted", {130}, "confirmed", "Ctrl-C"),
    "SIGTERM": (signals(signal.SIGTERM), "aborted", {143}, "confirmed", "SIGTERM"),
    "SIGTERM, then all others": (
        signals(signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGTERM), "aborted", {143}, "confirmed", "SIGTERM",
    ),
    "SIGHUP": (signals(signal.SIGHUP), "aborted", {129}, "confirmed", "SIGHUP"),
    "interlock opens": (fault("e_stop"), "tripped", {5}, "confirmed", 'the interlock "e-stop" is open'),
    "link lost": (fault("lost"), "error", {5}, "failed", "plant"),
    "device hangs": (fault("hang"), "error", {5}, None, "answer"),
    "value that is none": (fault("nan"), "tripped", {5}, None, "pressure"),
    "pressure bursts": (fault("burst"), "tripped", {5}, "confirmed", "pressure"),
    "file size limit": (no_more_bytes, "error", {7}, "confirmed", "too large"),
    "disk full": (fill_disk, "error", {7}, "confirmed", "No space"),
    "record fails": (touch("fail"), "error", {7}, "confirmed", "seeded by the test"),
    "vent from another terminal": (lambda run: vent(run.state), "aborted", {130}, "confirmed", "vent by"),
}  # fmt: skip


def pairs():
    if VARIABLE in os.environ:
        return [(cause, kind) for cause in CAUSES for kind in STEPS]
    return [(cause, STEPS[place % len(STEPS)]) for place, cause in enumerate(CAUSES)]


@pytest.fixture
def folder(request, tmp_path):
    """A folder for the run; a disk of 1 MB of its own where it is to be full."""
    if "disk full" not in request.node.name:
        yield tmp_path
        return
    small = tmp_path / "small"
    small.mkdir()
    mount = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", small], capture_output=True, check=False)
    if mount.returncode:
        pytest.skip("not run: mounting needs root")
    yield small
    eventually(lambda: not subprocess.run(["umount", small], capture_output=True, check=False).returncode)


@pytest.mark.parametrize(("cause", "kind"), pairs())
def test_every_way_out_vents_and_is_recorded(cause, kind, forks, lab, folder):
    act, status, codes, vented, why = CAUSES[cause]
    if cause == "pressure bursts" and kind not in {"hold", "follow", "wait-until"}:
        kind = "hold"
    bench, plant = lab
    state = {"state": str(folder.parent / f"{folder.name}-state")} if cause == "disk full" else {}
    job = {"raises": str(folder / "raise"), "fails": str(folder / "fail"), "thinks": False, **state}
    run = Run(forks, bench, plant, folder, kind, **job)
    try:
        run.in_step()
        if cause == "pressure bursts":
            eventually(lambda: plant.state()["pressure"] > 2e5)
        time.sleep(0.15)
        moment = act_at(lambda: act(run))
        if cause == "link lost":
            code = run.end()
            plant.clear("lost")
        else:
            TIMES[cause].append(assert_safe_since(plant, moment))
            assert TIMES[cause][-1] < GENEROUS
            code = run.end()
    finally:
        run.kill_rest()
        for name in ("lost", "hang", "nan", "burst", "e_stop"):
            plant.clear(name)
        eventually(lambda: plant.state()["pressure"] < 5e3)  # what a burst hid comes back and has to leave
    reported = run.lines()
    if code < 0:  # the last of several signals came when the run was over, vented and closed
        assert "others" in cause or "again" in cause, reported
        assert open_run(run.said("folder")).status == status
        return
    assert (run.said("status"), code) == (status, code), reported
    assert code in codes, reported
    assert why in run.said("why"), reported
    if vented is not None:
        assert run.said("vent") == vented, reported
    if cause in {"disk full", "file size limit", "record fails"}:
        assert open_run(run.said("folder")).status != "finished"
        return
    kept = open_run(run.said("folder"))
    assert kept.status == status
    kinds = [event.kind for event in kept.events]
    assert kinds.count("vent") == 1
    assert kinds.index("vent") > kinds.index("armed")
    assert kept.events[kinds.index("vent")].data["result"] == run.said("vent")
    if "trial-begin" in kinds:
        assert next(event for event in kept.events if event.kind == "trial-end").data["status"] == "interrupted"


def test_a_normal_end_vents(forks, lab, tmp_path):
    bench, plant = lab
    for name in ("selectors", "secrets", "socket", "json", "pmabench"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('a file of the lab, not of the guard')")
    moment = time.monotonic()
    run = Run(forks, bench, plant, tmp_path, "short", cwd=str(tmp_path))
    assert run.end() == 0, run.lines()
    pressed = max(line["t"] for line in plant.commands("write") if line["si"] > 0)
    assert pressed > moment
    assert_safe_since(plant, pressed + 1e-6)
    kept = open_run(run.said("folder"))
    assert (kept.status, [e.data["result"] for e in kept.events if e.kind == "vent"]) == ("finished", ["confirmed"])
    assert run.bench_state["what"] == "safe"


def test_a_folder_that_takes_nothing_is_refused_before_anything_is_commanded(forks, lab, tmp_path):
    bench, plant = lab
    moment = time.monotonic()
    (tmp_path / "runs").write_text("a file where the folder should be")
    run = Run(forks, bench, plant, tmp_path, "short")
    assert run.end() in {3, 7}, run.lines()
    assert "runs" in run.said("error")
    assert not [line for line in plant.commands("write", "follow", "switch") if line["t"] > moment]


@pytest.mark.parametrize("count", [1, 3])
def test_ctrl_c_while_hands_are_asked_for(count, forks, lab, tmp_path):
    bench, plant = lab
    run = Run(forks, bench, plant, tmp_path, "ask", thinks=True)
    try:
        eventually(lambda: (run.said("step") or 0) >= 1)
        time.sleep(0.3)
        moment = act_at(partial(signals(*[signal.SIGINT] * count), run))
        TIMES["Ctrl-C at a prompt"].append(assert_safe_since(plant, moment))
        assert run.end() == 130, run.lines()
    finally:
        run.kill_rest()
    assert (run.said("status"), run.said("vent")) == ("aborted", "confirmed")


def test_a_reading_that_hangs_in_the_engine(forks, lab, tmp_path):
    """The program says that it lives while it waits; the reading's own deadline ends the run. Nothing latches."""
    bench, plant = lab
    flag = tmp_path / "hang"
    run = Run(forks, with_reader(bench, flag), plant, tmp_path, "hold")
    try:
        run.in_step()
        moment = act_at(flag.touch)
        TIMES["reading hangs in the engine"].append(assert_safe_since(plant, moment))
        assert run.end() == 4, run.lines()
    finally:
        run.kill_rest()
    assert (run.said("status"), run.said("vent")) == ("error", "confirmed")
    assert "gauge" in run.said("why"), run.lines()
    assert run.bench_state["what"] == "safe"


def test_the_program_as_a_lab_starts_it(lab, tmp_path):
    """The whole program, from YAML to the exit code, once."""
    bench, plant = lab
    device = plant.device
    shutil.copytree(Path(bench.path).parent, tmp_path / "benches")
    (tmp_path / "benches" / "bench.yaml").write_text(
        f"include: mock-realtime.yaml\nname: whole program\nsession: null\n"
        f'devices:\n  plant: {{driver: mock-realtime, address: "{device.address}", watchdog: 1 s, '
        f"options: {{start: false, idle: 60, slow_vent: 1.5, log: {plant.log}}}}}\n"
        "proof: {pressure: 20 kPa, below: 15 kPa, within: 5 s}\n"
    )
    environment = {**os.environ, "PMABENCH_STATE": str(tmp_path / "state")}
    command = [sys.executable, "-m", "pmabench", "run", "contraction-relaxation", "--bench", str(tmp_path / "benches" / "bench.yaml"),
               "--specimen", "mas-20-250-paper0", "--out", str(tmp_path / "runs"), "--yes", "-q"]  # fmt: skip
    program = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    began = time.monotonic()
    eventually(
        lambda: program.poll() is not None or [w for w in plant.commands("switch") if w["t"] > began and w["on"]]
    )
    assert program.poll() is None, program.stdout.read()
    time.sleep(0.5)
    moment = act_at(lambda: program.send_signal(signal.SIGINT))
    TIMES["Ctrl-C to `pmabench run`"].append(assert_safe_since(plant, moment))
    said, _ = program.communicate(timeout=30)
    assert program.returncode == 130, said
    assert "aborted: ended by Ctrl-C" in said
    assert "vent confirmed" in said
