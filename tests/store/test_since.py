"""A sealed run stays what it was: what came later is named and not read, and only changed bytes are damage (R12)."""

import json
import os
import shutil
import socket
from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.store import since
from pmabench.store.catalogue import catalogue
from pmabench.store.chain import continued
from pmabench.store.notes import add_note
from pmabench.store.reader import open_run, read_stream
from pmabench.store.since import fingerprint, late_files
from pmabench.store.verify import verify
from tests.store.runs import begin, closed, record
from tests.store.test_chain import write

GUARD = {"vent": {"result": "confirmed", "actions": []}, "cause": "the engine has gone", "t": 4.1}
QUICK = pytest.mark.timeout(20)
"""A reader that opens a FIFO waits for ever."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = closed(tmp_path_factory.mktemp("whole"), rows=200)
    add_note(folder, "a note", operator="N")
    return folder


@pytest.fixture
def run(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "runs" / "run")


def _socket(path):
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


ADDED = {
    "guard.json": (lambda path: path.write_text(json.dumps(GUARD)), ""),
    ".DS_Store": (lambda path: path.write_bytes(b"\0" * 40), ""),
    "streams/.DS_Store": (lambda path: path.write_bytes(b"\0" * 40), ""),
    "Thumbs.db": (lambda path: path.write_bytes(b"\0" * 40), ""),
    "protocol.yaml~": (lambda path: path.write_text("an editor's copy"), ""),
    "streams/extra.parquet": (lambda path: path.write_bytes(b"x"), ""),
    "streams/daq.arrows": (lambda path: path.write_bytes(b"x"), ""),
    "export": (lambda path: shutil.copytree(path.parent / "streams", path), "a folder"),
    "tube": (os.mkfifo, "a FIFO"),
    "streams/tube.parquet": (os.mkfifo, "a FIFO"),
    "notes/zero": (lambda path: path.symlink_to("/dev/zero"), "a link"),
    "zero": (lambda path: path.symlink_to("/dev/zero"), "a link"),
    "socket": (_socket, "a socket"),
    "notes/0001/tube": (os.mkfifo, "a FIFO"),
}


@QUICK
@pytest.mark.parametrize("name", ADDED)
def test_what_was_added_is_named_and_the_sealed_part_is_read(run, whole, name):
    add, kind = ADDED[name]
    add(run / name)
    (finding,) = verify(run)
    assert (finding.file, finding.added) == (name, True)
    assert kind in finding.message or name == "notes/zero"
    read = open_run(run)
    assert [(entry.name, entry.what) for entry in read.since.added] == [(name, kind or "a file")]
    assert name in read.since.sentences[0]
    assert [trial.status for trial in read.trials] == [trial.status for trial in open_run(whole).trials]
    assert read_stream(run).equals(read_stream(whole))
    assert catalogue(run.parent)[0].status == "finished"
    assert add_note(run, "one more").number == 2


def test_a_run_that_nobody_touched_has_nothing_to_say(whole):
    assert verify(whole) == []
    assert open_run(whole).since.sentences == []
    assert catalogue(whole.parent)[0].added == ()


@QUICK
def test_the_list_sees_what_is_added_and_taken_away_although_it_remembers_closed_runs(run):
    assert catalogue(run.parent)[0].added == ()
    (run / "streams" / "x.txt").write_text("x")
    assert catalogue(run.parent)[0].added == ("streams/x.txt",)
    (run / "streams" / "x.txt").unlink()
    assert catalogue(run.parent)[0].added == ()
    late = Path(f"{run}.late")
    late.mkdir()
    (late / "guard.json").write_text(json.dumps(GUARD))
    (row,) = catalogue(run.parent)
    assert (row.id, row.late) == ("run", ("guard.json",))


@QUICK
@pytest.mark.parametrize("place", ["manifest.json", "events.jsonl", "streams/daq.parquet", "plan.json", "seal.json"])
@pytest.mark.parametrize("instead", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), Path.mkdir])
def test_a_sealed_file_that_became_something_else_is_damage_and_is_not_opened(run, place, instead):
    (run / place).unlink()
    instead(run / place)
    assert place in {finding.file for finding in verify(run) if not finding.added}
    with pytest.raises(InvalidFile) as caught:
        open_run(run)
    assert len(str(caught.value).splitlines()) == 1
    catalogue(run.parent)
    fingerprint([run], "")


@QUICK
def test_a_file_that_grew_without_end_is_damage_at_once(run):
    (run / "streams" / "daq.parquet").chmod(0o644)
    os.truncate(run / "streams" / "daq.parquet", 1 << 40)
    assert str(verify(run)[0]) == "streams/daq.parquet: was changed: its sha256 does not fit"
    with pytest.raises(InvalidFile, match="was changed after it was written"):
        open_run(run)


def test_a_folder_behind_a_link_is_no_part_of_the_run(run, whole):
    shutil.rmtree(run / "streams")
    (run / "streams").symlink_to(whole / "streams")
    found = verify(run)
    assert "streams" in {finding.file for finding in found if finding.added}
    assert "streams/daq.parquet" in {finding.file for finding in found if not finding.added}
    with pytest.raises(InvalidFile, match="links are not followed"):
        open_run(run)


@QUICK
def test_an_open_run_with_a_fifo_in_it_is_verified_closed_and_read(tmp_path):
    folder = write(tmp_path, "one", [(0, "finished"), (1, None)])
    os.mkfifo(folder / "tube")
    os.mkfifo(folder / "streams" / "other.arrows")
    (folder / ".DS_Store").write_bytes(b"1")
    assert "tube: is a FIFO, which no run contains" in [str(finding) for finding in verify(folder)]
    assert open_run(folder).status == "interrupted"
    continued(folder)
    (folder / ".DS_Store").write_bytes(b"2")
    assert {finding.file for finding in verify(folder) if finding.added} == {
        "tube",
        "streams/other.arrows",
        ".DS_Store",
    }
    assert [finding for finding in verify(folder) if not finding.added] == []


def test_a_guard_that_reports_next_to_a_dead_run_is_taken_into_it_when_it_is_sealed(tmp_path):
    folder = write(tmp_path, "one", [(0, "finished"), (1, None)])
    late = Path(f"{folder}.late")
    late.mkdir()
    (late / "guard.json").write_text(json.dumps(GUARD))
    assert open_run(folder).manifest["guard"] == GUARD
    continued(folder)
    assert verify(folder) == []
    assert not late.exists()
    assert open_run(folder).manifest["guard"] == GUARD
    assert open_run(folder).since.sentences == []


def test_a_guard_that_reports_after_the_seal_changes_nothing(run):
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    key = fingerprint([run], "")
    late = Path(f"{run}.late")
    late.mkdir()
    (late / "guard.json").write_text(json.dumps(GUARD))
    assert verify(run) == []
    read = open_run(run)
    assert read.since.as_data() == {"added": [], "late": ["guard.json"], "guard": GUARD, "altered": []}
    assert "guard" not in read.manifest, "that would say that the program had died"
    assert any("confirmed (the engine has gone)" in sentence for sentence in read.since.sentences)
    assert fingerprint([run], "") != key, "what `process` says of it is not taken from before"
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


@QUICK
@pytest.mark.parametrize("harm", ["fifo", "link", "rubbish", "long", "list", "file"])
def test_a_late_report_that_cannot_be_read_harms_nothing(run, harm):
    late = Path(f"{run}.late")
    if harm == "file":
        late.write_text("x")
        assert open_run(run).since.late == ()
        return
    late.mkdir()
    path = late / "guard.json"
    if harm == "fifo":
        os.mkfifo(path)
    elif harm == "link":
        path.symlink_to("/dev/zero")
    else:
        path.write_text({"rubbish": "{", "long": " " * 2_000_000 + "{}", "list": "[1]"}[harm])
    assert late_files(run) == ["guard.json"]
    assert open_run(run).since.guard == {}
    assert verify(run) == []


def test_a_seal_that_names_files_elsewhere_reads_none_of_them(tmp_path):
    from pmabench.store.folder import open_json, sealed_json

    folder = closed(tmp_path, rows=20)
    seal = open_json((folder / "seal.json").read_bytes(), "")
    del seal["sha256"]
    (tmp_path / "secret").write_text("x")
    seal["files"]["../secret"] = {"sha256": "00" * 32, "bytes": 1}
    (folder / "seal.json").chmod(0o644)
    (folder / "seal.json").write_bytes(sealed_json(seal))
    assert ["../secret: cannot be read: its name leads out of the folder"] == [str(f) for f in verify(folder)]
    forged = begin(tmp_path, "other")
    record(forged, 20)
    for entry in ({"bytes": 1}, {"sha256": "x", "bytes": "many"}, "text"):
        seal["files"]["protocol.yaml"] = entry
        (folder / "seal.json").write_bytes(sealed_json(seal))
        with pytest.raises(InvalidFile, match="does not say the sha256 and the bytes"):
            open_run(folder)
    forged.close("finished")


def test_what_python_and_templates_compile_on_the_way_is_no_other_program(tmp_path, monkeypatch):
    """The first report on a fresh installation writes compiled templates: results made before it are still used."""
    monkeypatch.setattr(since, "_extensions", lambda: [tmp_path])

    def program():
        since.program.cache_clear()
        return since.program()

    try:
        before = program()
        compiled = tmp_path / "templates/__pycache__"
        compiled.mkdir(parents=True)
        (compiled / "__jinja2_1.cache").write_bytes(b"compiled")
        (compiled / "rule.cpython-311.pyc").write_bytes(b"compiled")
        assert program() == before
        (tmp_path / "rule.py").write_text("x = 1\n")
        assert program() != before
    finally:
        since.program.cache_clear()
