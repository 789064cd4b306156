"""The list of runs is true, and needs and leaves nothing but the folders."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest

from pmabench.store.catalogue import catalogue
from pmabench.store.folder import open_json, sealed_json
from tests.store.runs import begin, closed, unclosed

COUNT = 200


@pytest.fixture(scope="module")
def parent(tmp_path_factory):
    """Two hundred closed runs, copies of one with their own ids and ends."""
    parent = tmp_path_factory.mktemp("runs")
    first = closed(tmp_path_factory.mktemp("one"), rows=20)
    manifest, seal = (open_json((first / name).read_bytes(), name) for name in ("manifest.json", "seal.json"))
    for data in (manifest, seal):
        del data["sha256"]
    for number in range(COUNT):
        folder = parent / f"20261121-{number:04d}_A017_static-load_{number:04x}"
        folder.mkdir()
        (folder / "manifest.json").write_bytes(sealed_json(manifest | {"id": folder.name}))
        status = ("finished", "failed", "aborted", "tripped", "error")[number % 5]
        (folder / "seal.json").write_bytes(sealed_json(seal | {"id": folder.name, "status": status}))
    return parent


def test_rows_say_what_the_folders_say(parent):
    rows = catalogue(parent)
    assert len(rows) == COUNT
    assert [row.id for row in rows] == sorted(row.id for row in rows)
    assert [row.status for row in rows[:5]] == ["finished", "failed", "aborted", "tripped", "error"]
    row = rows[7]
    assert (row.kind, row.specimen, row.bench, row.simulated) == ("contraction-relaxation", "MAS-20 A017", "rig", True)
    assert (row.trials_finished, row.trials_planned) == (1, 2)
    assert row.duration == pytest.approx(0.22)
    assert row.size > 5000
    assert (row.status, row.why) == ("aborted", "")
    assert json.loads(json.dumps(vars(row)))["id"] == row.id


def test_a_folder_that_may_not_be_read_hides_no_other(tmp_path, monkeypatch):
    """`lost+found`, or a run of a colleague: the list was empty, and a campaign would have begun anew."""
    folder = closed(tmp_path / "runs", rows=20)
    (tmp_path / "runs" / "lost+found").mkdir()
    stat = os.stat

    def refused(path, *arguments, **keywords):
        if "lost+found/" in os.fspath(path):
            raise PermissionError(13, "Permission denied", path)
        return stat(path, *arguments, **keywords)

    monkeypatch.setattr(os, "stat", refused)
    assert [row.folder for row in catalogue(tmp_path / "runs")] == [folder.name]


def test_rows_follow_what_happens_to_the_folders(tmp_path):
    folder = closed(tmp_path / "runs", rows=20)
    (row,) = catalogue(tmp_path / "runs")
    moved = folder.with_name("later")
    folder.rename(moved)
    assert catalogue(tmp_path / "runs") == [replace(row, folder="later")]
    unclosed(tmp_path / "runs")
    assert [each.status for each in catalogue(tmp_path / "runs")] == ["finished", "running"]
    raw = (moved / "seal.json").read_bytes()
    (moved / "seal.json").chmod(0o644)
    (moved / "seal.json").write_bytes(raw.replace(b"finished", b"aborted!"))
    assert [each.status for each in catalogue(tmp_path / "runs")] == ["damaged", "running"]
    shutil.rmtree(moved)
    (tmp_path / "runs" / "notes").mkdir()
    assert len(catalogue(tmp_path / "runs")) == 1


def test_a_row_says_why_a_run_did_not_finish(tmp_path):
    begin(tmp_path).close("tripped", "pressure 660 kPa is above its limit")
    (row,) = catalogue(tmp_path)
    assert (row.status, row.why) == ("tripped", "pressure 660 kPa is above its limit")
    assert catalogue(tmp_path) == [row]


def test_a_folder_without_runs_or_that_cannot_be_written_gives_no_error(tmp_path):
    assert catalogue(tmp_path / "nowhere") == []
    assert catalogue(tmp_path) == []
    assert not list(tmp_path.iterdir())


def test_listing_imports_nothing_heavy():
    program = "import sys, pmabench.store.catalogue as c; c.catalogue('.'); print(sorted(sys.modules))"
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60).stdout
    assert not {"numpy", "pandas", "pyarrow"} & set(eval(out))
