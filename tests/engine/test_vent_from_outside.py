"""`pmabench vent` from a second terminal, whatever the owner of the bench does (S10); one owner (S9); the latch (S7)."""

import json
import os
import shutil
import signal
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import pytest

from pmabench.store.reader import open_run
from tests.engine.forked import Forks
from tests.engine.realtime_rig import Run, act_at, assert_safe_since, served, table, vent
from tests.realtime import eventually
from tests.reliability.cases import cases

pytestmark = pytest.mark.realtime
GENEROUS = 3.0
TIMES = defaultdict(list)


@pytest.fixture(scope="module")
def forks():
    with Forks() as parent:
        yield parent
    table("vent from a second terminal: from the start of its process to the first safe command", TIMES)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    with served(tmp_path_factory.mktemp("plant")) as (bench, plant):
        yield bench, plant


def stop(*whom):
    def act(run):
        for name in whom:
            os.kill({"engine": run.pid, "guard": run.guard["pid"]}[name], signal.SIGSTOP)

    return act


def kill_guard(run):
    """Both, so that nobody is left who would vent by himself; the device's watchdog has not bitten yet."""
    for pid in (run.pid, run.guard["pid"]):
        os.kill(pid, signal.SIGKILL)


OWNERS = {
    # what happens to the owner, kind of step, exit codes of the run, who vented
    "running": (lambda run: None, "hold", {130}, "its guard"),
    "waiting for an operator": (lambda run: None, "ask", {130}, "its guard"),
    "engine stopped": (stop("engine"), "hold", {4, 130}, "its guard"),
    "engine killed": (lambda run: os.kill(run.pid, signal.SIGKILL), "hold", {-9}, None),
    "guard stopped": (stop("guard"), "hold", {4, 5}, "the devices, opened here: the guard does not answer"),
    "both stopped": (stop("guard", "engine"), "hold", {4, 5}, "the devices, opened here: the guard does not answer"),
    "both killed": (kill_guard, "hold", {-9}, "the devices, opened here: the guard does not answer"),
}


@pytest.mark.parametrize("owner", OWNERS)
def test_a_vent_succeeds_whatever_the_owner_does(owner, forks, lab, tmp_path, record_property):
    act, kind, codes, way = OWNERS[owner]
    bench, plant = lab
    count = cases(1)
    record_property("cases", count)
    for number in range(count):
        run = Run(forks, bench, plant, tmp_path / str(number), kind, thinks=True)
        done = None
        try:
            if kind == "ask":
                eventually(lambda run=run: (run.said("step") or 0) >= 1)
                time.sleep(0.3)
            else:
                run.in_step()
            guard = run.guard
            # from the cause on: a guard may have vented before its owner's end is seen here
            moment = act_at(lambda act=act, run=run: act(run))
            done = vent(run.state, "--json")
            TIMES[owner].append(assert_safe_since(plant, moment))
            assert TIMES[owner][-1] < GENEROUS
            assert done.returncode == 0, done.stdout + done.stderr
            reported = json.loads(done.stdout)["benches"]
            assert [(item["bench"], item["result"]) for item in reported] == [(bench.name, "confirmed")]
            assert way is None or reported[0]["way"] == way
            for pid in (guard["pid"], run.pid):
                if "stopped" in owner:
                    os.kill(pid, signal.SIGCONT)
            code = run.end()
            assert code in codes, run.lines()
            assert_safe_since(plant, moment)
            if code == 130:
                assert "vent by" in run.said("why")
                assert open_run(run.said("folder")).status == "aborted"
        finally:
            run.kill_rest()
        left = eventually(lambda run=run: run.bench_state if run.bench_state.get("what") != "armed" else None)
        assert left["what"] == ("safe" if code == 130 and "stopped" not in owner else left["what"])
        assert "stopped" not in owner or owner == "engine stopped" or left["what"] == "tripped"


def never_used(bench, plant, folder):
    """Path of a bench file of another name with the same device."""
    shutil.copytree(Path(bench.path).parent, folder / "benches")
    path = folder / "benches" / "bench.yaml"
    path.write_text(
        "include: mock-realtime.yaml\nname: never used before\ndevices:\n"
        f'  plant: {{driver: mock-realtime, address: "{plant.device.address}", watchdog: 1 s, '
        f"options: {{start: false, idle: 60, log: {plant.log}}}}}\n"
    )
    return str(path)


def test_another_bench_file_with_the_device_goes_to_the_guard_that_has_it(forks, lab, tmp_path):
    bench, plant = lab
    run = Run(forks, bench, plant, tmp_path / "run", "hold", thinks=True)
    try:
        run.in_step()
        moment = time.monotonic()
        done = vent(run.state, never_used(bench, plant, tmp_path), "--json")
        assert_safe_since(plant, moment)
        assert done.returncode == 0, done.stdout + done.stderr
        (reported,) = json.loads(done.stdout)["benches"]
        assert (reported["bench"], reported["result"]) == ("never used before", "confirmed")
        assert reported["way"] == f'its guard (of "{bench.name}", which has its devices)'
        assert run.end() == 130, run.lines()
        assert "vent by" in run.said("why")
    finally:
        run.kill_rest()


def test_nobody_at_the_bench(lab, tmp_path, forks):
    """After a clean run its saved bench is enough; before any run the bench file is."""
    bench, plant = lab
    run = Run(forks, bench, plant, tmp_path, "short")
    assert run.end() == 0, run.lines()
    run.guard_gone()
    moment = time.monotonic()
    done = vent(run.state, bench.name)
    TIMES["nobody, from the saved bench"].append(assert_safe_since(plant, moment))
    assert done.returncode == 0, done
    assert run.bench_state["what"] == "safe", "a clean bench that was vented is not latched"
    moment = time.monotonic()
    done = vent(tmp_path / "other-state", never_used(bench, plant, tmp_path))
    TIMES["nobody, from YAML"].append(assert_safe_since(plant, moment))
    assert done.returncode == 0, done
    assert "confirmed" in done.stdout


def test_two_starts_at_once_have_one_owner(forks, lab, tmp_path, record_property):
    bench, plant = lab
    count = cases(3)
    record_property("cases", count)
    for number in range(count):
        folder = tmp_path / str(number)
        moment = time.monotonic()
        runs = [Run(forks, bench, plant, folder, "short") for _ in range(2)]
        codes = sorted(run.end() for run in runs)
        if codes != [0, 0]:  # both, where one was over before the other began
            assert codes == [0, 4], [run.lines() for run in runs]
            loser = next(run for run in runs if run.said("error"))
            assert "in use by" in loser.said("error")
        owners = {line["pid"] for line in plant.commands("write", "follow", "switch") if line["t"] >= moment}
        assert len(owners) == codes.count(0)


def test_a_dump_valve_that_does_not_open_and_a_stuck_regulator_latch(forks, tmp_path):
    """A failed safe state is told, and nothing runs before a reset after a confirmed vent (S7)."""
    with served(tmp_path) as (bench, plant):
        quick = tuple(replace(a, within=0.6) if a.do == "confirm" else a for a in bench.safe_state)
        bench = replace(bench, safe_state=quick)
        run = Run(forks, bench, plant, tmp_path / "run", "hold")
        try:
            run.in_step()
            plant.inject("dump_stuck")
            plant.inject("regulator_stuck")
            act_at(lambda: os.kill(run.pid, signal.SIGTERM))
            assert run.end() == 5, run.lines()
        finally:
            run.kill_rest()
        assert run.said("vent") == "commanded"
        assert open_run(run.said("folder")).status == "aborted"
        assert run.bench_state["what"] == "tripped"
        run.guard_gone()
        reset = vent(run.state, bench.name, "--reset", "--operator", "me", "--because", "I hope")
        assert reset.returncode == 5, reset
        assert "reset" not in reset.stdout
        again = Run(forks, bench, plant, run.folder, "short")
        assert again.end() == 5
        assert "is tripped" in again.said("error")
        again.guard_gone()
        plant.clear("dump_stuck")
        plant.clear("regulator_stuck")
        reset = vent(run.state, bench.name, "--reset", "--operator", "me", "--because", "valve mended")
        assert reset.returncode == 0, reset
        last = Run(forks, bench, plant, run.folder, "short")
        assert last.end() == 0, last.lines()
