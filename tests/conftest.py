"""Generated cases are the same at every run; what outlives a process lies in a folder of the test, not the user's."""

import os
import subprocess
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

import pmabench.cli.main  # noqa: F401  (sets the number of BLAS threads before numpy is loaded, as for a user)

settings.register_profile("same", derandomize=True, deadline=None, print_blob=True)
settings.load_profile("same")

os.environ["PMABENCH_STATE"] = tempfile.mkdtemp(prefix="pmabench-state-")


@pytest.fixture(autouse=True)
def _own_state(tmp_path, monkeypatch):
    """Locks and latches of one test are not those of another, nor is its terminal's width that of a person."""
    monkeypatch.setenv("PMABENCH_STATE", str(tmp_path / "state"))
    monkeypatch.delenv("COLUMNS", raising=False)  # of the terminal that the tests were started from


DRIVERS = (
    "alicat", "can", "dataq", "festo", "festo_cmmt", "ild1420", "labjack", "ni", "serial_line_daq", "serial_rig", "wires",
)  # fmt: skip
WHOLE_RUNS = "tests/drivers/test_whole_runs.py"
"""The parameter `rig` of its tests begins with the name of a driver's folder: they belong to that rig."""
RIGS = (
    *(f"tests/drivers/{name}/" for name in DRIVERS),
    "tests/drivers/truth/",
    "tests/clients/",
    "tests/outside/test_locks.py",
    "tests/outside/test_strangers.py",
    "tests/session/test_realtime.py",
    "tests/session/test_wrong_wires.py",
    "tests/benchmarks/test_cluster.py",
)
"""Where tests over a wire, a whole session, and a cluster, wait in real time."""


def commit_number():
    """The hash of the commit as a number: what it chooses gets its turn, and all of it with `make reliability`."""
    asked = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    )
    return int(asked.stdout.strip() or "0", 16)


def _rig_of_this_commit():
    """One of the rigs; `PMABENCH_RIG` names another one."""
    return os.environ.get("PMABENCH_RIG") or RIGS[commit_number() % len(RIGS)]


def _rig_of(item):
    """The rig that a test belongs to; None where it belongs to none."""
    if WHOLE_RUNS in item.nodeid:
        return f"tests/drivers/{item.callspec.params['rig'].partition('-')[0]}/"
    return next((rig for rig in RIGS if rig in item.nodeid), None)


def pytest_collection_modifyitems(config, items):
    """The whole suite takes one rig over its wire, and leaves out studies; whoever names a file gets all of it."""
    if config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return
    chosen = _rig_of_this_commit()
    left_out = []
    for item in items:
        rig = _rig_of(item)
        waits = item.get_closest_marker("realtime") is not None and rig is not None
        if (waits and (rig != chosen or item.get_closest_marker("slow"))) or item.get_closest_marker("study"):
            left_out.append(item)
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in set(left_out)]
