"""Generated cases are the same at every run; what outlives a process lies in a folder of the test, not the user's.

The whole suite takes only some of the tests that wait in real time, chosen by the hash of the commit, and no study;
whoever names a file gets all of it. The end of the log lists what was chosen.
"""

import gc
import os
import re
import subprocess
import tempfile
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import settings

import pmabench.cli.main  # noqa: F401  (sets the number of BLAS threads before numpy is loaded, as for a user)
from tests.browser import CHROMIUM, NOT_RUN, Browser

pytest_plugins = ["tests.pauses"]

settings.register_profile("same", derandomize=True, deadline=None, print_blob=True)
settings.load_profile("same")

_STATE = tempfile.TemporaryDirectory(prefix="pmabench-state-")
os.environ["PMABENCH_STATE"] = _STATE.name
os.environ.pop("PYTHONUNBUFFERED", None)  # what processes print waits in a buffer, as it does for most users


@pytest.fixture(autouse=True)
def _own_state(tmp_path, monkeypatch):
    """Locks and latches of one test are not those of another, nor is its terminal's width that of a person."""
    monkeypatch.setenv("PMABENCH_STATE", str(tmp_path / "state"))
    monkeypatch.delenv("COLUMNS", raising=False)  # of the terminal that the tests were started from


DRIVERS = (
    "alicat", "can", "dataq", "festo", "festo_cmmt", "ild1420", "labjack", "ni", "serial_line_daq", "serial_rig", "wires",
)  # fmt: skip
OF_ALL_RIGS = ("tests/drivers/test_whole_runs.py", "tests/drivers/test_promises.py")
"""The parameter `rig` of their tests begins with the name of a driver's folder: they belong to that rig."""
LONG = "test_coefficients_come_back"
LONG_WITH = {
    "wires": "tests/outside/test_strangers.py",
    "alicat": "tests/drivers/truth/",
    "dataq": "tests/clients/",
    "festo": "tests/drivers/ild1420/",
    "labjack": "tests/drivers/festo/",
    "ni": "tests/drivers/dataq/",
}
"""A driver's longest test, a minute or more -> with which other rig, a short one, it is taken, so that no commit waits long."""
RIGS = (
    *(f"tests/drivers/{name}/" for name in DRIVERS),
    "tests/drivers/truth/test_every_rig.py",
    "tests/drivers/truth/",
    "tests/clients/",
    "tests/outside/test_locks.py",
    "tests/outside/test_strangers.py",
    "tests/session/test_realtime.py",
    "tests/session/test_wrong_wires.py",
    "tests/benchmarks/test_cluster.py",
)
"""Where tests over a wire, a whole session, and a cluster, wait in real time: every commit takes one of these."""
CONFORMANCE = "tests/conformance/"
FOUND = ("test_in_a_shipped_driver_it_is_found", "test_in_the_example_driver_it_is_found_and_named")
"""Of these, which need not be alone: a check that must fail fails on a busy machine too."""
SHARES = {"test_in_a_shipped_driver_it_is_found": 72}
SHARE = 12
"""Of the tests of `CONFORMANCE` that wait in real time, every commit takes one in so many; `SHARES` names exceptions."""
SLOW = 140
"""Of the slow tests over a wire every commit takes one in so many, whatever its rig: together they take half an hour."""
IN_REAL_TIME = re.compile(r"^pytestmark = .*\brealtime\b", re.MULTILINE)
"""A file whose tests all wait in real time."""
LONGEST = (
    "tests/test_pages.py", "tests/cli/test_process_json.py", "tests/test_site.py", "tests/test_characterisation.py",
    "tests/analysis/test_diagnosis.py", "tests/analysis/test_judged_second.py", "tests/conformance/test_suite.py",
    "tests/reliability/test_power_cut.py", "tests/test_structure.py",
)  # fmt: skip
"""Files with tests of many seconds: one that began last would keep one core busy, and no other."""
CHOSEN = (*RIGS, *OF_ALL_RIGS, CONFORMANCE, "tests/outside/test_faults.py")


def _commit():
    """The hash that chooses: of this commit, or the one that `PMABENCH_COMMIT` names, to repeat what a log shows."""
    named = os.environ.get("PMABENCH_COMMIT", "")
    command = ["git", "rev-parse", "--verify", "-q", named or "HEAD"]
    asked = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return asked.stdout.strip() or named or "0"


os.environ["PMABENCH_COMMIT"] = COMMIT = _commit()  # the processes of xdist have it from the one that starts them


def commit_number():
    """That hash as a number; all that it chooses from is run by `make reliability`."""
    return int(COMMIT, 16)


def _whole_suite(config):
    """Whether no file was named on the command line; a worker of xdist has it from the process that started it."""
    given = getattr(config, "workerinput", None)
    return given["whole_suite"] if given else config.args_source is pytest.Config.ArgsSource.TESTPATHS


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node):
    node.workerinput["whole_suite"] = _whole_suite(node.config)


def pytest_ignore_collect(collection_path, config):
    """Files without a test that is asked for need not be imported: all of theirs are in real time, or none is."""
    wanted = config.option.markexpr
    if not wanted.startswith(("realtime", "not realtime")) or not collection_path.match("test_*.py"):
        return None
    text = collection_path.read_text("utf-8")
    if wanted.startswith("not realtime"):
        return True if IN_REAL_TIME.search(text) else None
    return True if "realtime" not in text or _otherwise(collection_path.as_posix(), text, config) else None


def _otherwise(path, text, config):
    """Whether all tests of a file that are in real time run in another stage of `make pytest`, or at other commits."""
    stage, rigs = config.option.markexpr, [rig for rig in (*RIGS, *OF_ALL_RIGS) if rig in path]
    if stage == "realtime and singly":
        return "mark.singly" not in text
    if stage.startswith("realtime and not alone"):
        return bool(rigs)
    if stage != "realtime and alone":
        return False
    if rigs:
        return _whole_suite(config) and not {*rigs} & {RIGS[commit_number() % len(RIGS)], *OF_ALL_RIGS}
    return "mark.alone" not in text and (CONFORMANCE not in path or any(name in text for name in FOUND))


def _rig_of(item):
    """The rig that a test belongs to; None where it belongs to none."""
    if any(module in item.nodeid for module in OF_ALL_RIGS):
        driver = item.callspec.params["rig"].partition("-")[0]
        own = f"tests/drivers/{driver}/"
        return LONG_WITH.get(driver, own) if item.originalname == LONG else own
    return next((rig for rig in RIGS if rig in item.nodeid), None)


def _taken(waiting):
    """The tests among `waiting`, which are in real time, that this commit takes."""
    places = Counter()
    for item in waiting:
        if CONFORMANCE in item.nodeid:
            share = SHARES.get(item.originalname, SHARE)
            taken = places[share] % share == commit_number() % share
            places[share] += 1
        else:
            rig = _rig_of(item)
            taken = rig is None or rig == RIGS[commit_number() % len(RIGS)]
            if rig is not None and item.get_closest_marker("slow"):
                taken = places["slow"] % SLOW == commit_number() % SLOW
                places["slow"] += 1
        if taken:
            yield item


@pytest.hookimpl(tryfirst=True)  # before `-m` looks at the markers
def pytest_collection_modifyitems(config, items):
    waiting = [item for item in items if item.get_closest_marker("realtime")]
    for item in waiting:
        exact = _rig_of(item) or (CONFORMANCE in item.nodeid and item.originalname not in FOUND)
        if exact and not item.get_closest_marker("singly"):
            item.add_marker("alone")  # answers within milliseconds are asserted in many of them
    if not _whole_suite(config):
        return
    left_out = set(waiting) - set(_taken(waiting))
    left_out |= {item for item in items if item.get_closest_marker("study")}
    config.hook.pytest_deselected(items=list(left_out))
    items[:] = [item for item in items if item not in left_out]
    items.sort(key=lambda item: not item.nodeid.startswith(LONGEST))  # the longest begin first, others fill the rest


def pytest_collection_finish():
    """What was imported and collected stays to the end: the garbage collector need not look through it each time.

    Nor for every 700 new objects: arrays and records go by their count of references.
    """
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """One Chromium for all tests of a session; each page in it has its own storage."""
    if CHROMIUM is None:
        pytest.skip(NOT_RUN)
    with Browser(tmp_path_factory.mktemp("browser") / "profile") as opened:
        yield opened


def pytest_unconfigure():
    """What modules locked or latched while they were collected goes with the tests."""
    _STATE.cleanup()


def pytest_terminal_summary(terminalreporter, config):
    """Which tests were run because the commit's hash chose them."""
    ran = [
        report.nodeid
        for reports in terminalreporter.stats.values()
        for report in reports
        if getattr(report, "when", "") in {"setup", "call"} and "realtime" in report.keywords
    ]
    chosen = sorted({name for name in ran if any(part in name for part in CHOSEN)})
    if chosen and _whole_suite(config):
        terminalreporter.section(f"chosen by commit {COMMIT}; PMABENCH_COMMIT={COMMIT} chooses the same")
        for name in chosen:
            terminalreporter.line(name)
