"""A writer that is killed loses at most a quarter of a second and leaves no wrong number (R1, R2)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from pmabench.store.catalogue import catalogue
from pmabench.store.reader import open_run, read_stream
from pmabench.store.seal import close_interrupted
from pmabench.store.verify import verify
from tests.reliability.cases import cases
from tests.store.runs import block

pytestmark = pytest.mark.slow
KILLS = cases(100)


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    parent = tmp_path_factory.mktemp("killed")
    root = Path(__file__).parents[2]
    command = [sys.executable, "-m", "tests.store.killed_writer", str(parent), str(KILLS), "20261121"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True, timeout=60 + KILLS)
    return parent, [json.loads(line) for line in done.stdout.splitlines()]


def test_every_survivor_opens_and_loses_at_most_a_quarter_of_a_second(killed, record_property):
    parent, reported = killed
    assert len(reported) == KILLS
    record_property("cases", KILLS)
    assert any(run["sure"] > 0 for run in reported), "some were killed late enough to have lost something"
    for run in reported:
        kept = read_stream(parent / run["name"], raw=True)
        assert run["sure"] <= len(kept) <= run["most"], run
        time_ns, raw, flags = block(0, len(kept))
        assert kept["time_ns"].tolist() == time_ns.tolist()
        assert kept["pressure"].tolist() == raw["pressure"].tolist()
        assert kept["force"].tolist() == raw["force"].tolist()
        assert kept["flags"].tolist() == flags.tolist()
        events = [event.data["rows"] for event in open_run(parent / run["name"]).events]
        assert len(events) >= run["events"], "an event is on disk when `event` returns"


def test_every_survivor_is_listed_as_interrupted_and_can_be_closed(killed):
    parent, reported = killed
    rows = catalogue(parent)
    assert {row.status for row in rows} == {"interrupted"}
    assert len(rows) == KILLS
    for run in reported[:: max(1, KILLS // 20)]:
        folder = parent / run["name"]
        assert any("interrupted" in str(finding) for finding in verify(folder))
        before = read_stream(folder)
        close_interrupted(folder)
        assert verify(folder) == []
        assert read_stream(folder).equals(before)
    assert {row.status for row in catalogue(parent)} == {"interrupted"}
