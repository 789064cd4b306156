"""`pmabench note` and what other commands say of it, as a user meets them."""

import json

from tests.cli.test_cli import call
from tests.store.runs import begin, closed, die, record


def test_a_note_is_taken_shown_and_verified(tmp_path):
    folder = closed(tmp_path)
    picture = tmp_path / "rig.jpg"
    picture.write_bytes(b"\xff\xd8 not a picture, but bytes")
    assert call("note", folder, "hose replaced", "--operator", "A. Meyer").stdout == f"note 1 of {folder}\n"
    excluding = ["--exclude", 1, "--because", "the table was hit", "--operator", "B. Ito"]
    said = call("note", folder, "--attach", picture, *excluding).stdout
    assert "left out: trial 1 (" in said
    text = call("runs", "show", folder).stdout
    assert "A. Meyer: hose replaced" in text
    assert "B. Ito: trial 1 is left out: the table was hit; [notes/0002/rig.jpg]" in text
    assert "trial 1      excluded" in text
    assert "trial 0" not in text
    shown = json.loads(call("runs", "show", folder, "--json").stdout)
    assert [(note["number"], note["exclude"]) for note in shown["notes"]] == [(1, None), (2, 1)]
    assert [(trial["trial"], trial["status"]) for trial in shown["trials"]] == [(1, "excluded"), (2, "failed")]
    stored = json.loads((folder / "notes" / "0002" / "note.json").read_text())
    assert stored["exclude"] == 0, "the record counts from 0, as it always did"
    assert "whole" in call("runs", "verify", folder).stdout
    (folder / "notes" / "0002" / "rig.jpg").unlink()
    assert "notes/0002/rig.jpg: is missing" in call("runs", "verify", folder, code=3).stdout


def test_a_note_that_cannot_be_taken_exits_with_a_sentence(tmp_path):
    folder = closed(tmp_path, rows=20)
    assert "says nothing" in call("note", folder, code=2).output
    assert "go together" in call("note", folder, "--exclude", 1, code=2).output
    assert "x>=1" in call("note", folder, "--exclude", 0, "--because", "x", code=2).output
    assert "has no trial 9" in call("note", folder, "--exclude", 9, "--because", "x", code=3).output
    assert "is not a run folder" in call("note", tmp_path, "x", code=3).output


def test_a_run_that_the_guard_vented_says_so(tmp_path):
    writer = begin(tmp_path)
    record(writer)
    die(writer)
    guard = {"vent": {"result": "confirmed", "actions": []}, "cause": "the engine died (signal 9)", "t": 4.1}
    (writer.folder / "guard.json").write_text(json.dumps(guard))
    text = call("runs", "show", writer.folder).stdout
    assert "the bench was vented after the program died: confirmed" in text
    assert "the engine died (signal 9)" in text


def test_process_lists_what_notes_leave_out(tmp_path):
    small = ["--set", "sweep.matrix.load=[6 kg]", "--set", "sweep.matrix.pressure=[200 kPa, 300 kPa, 400 kPa]"]
    bench = ["--bench", "mock", "--specimen", "mas-20-250-paper0", "--yes"]
    reported = call("run", "contraction-relaxation", *bench, *small, "--out", tmp_path / "runs", "--json").stdout
    folder = json.loads(reported)["run"]
    before = json.loads(call("process", folder, "--out", tmp_path / "before", "--json", code=6).stdout)
    call("note", folder, "--exclude", 2, "--because", "the table was hit", "--operator", "B. Ito")
    after = json.loads(call("process", folder, "--out", tmp_path / "after", "--json", code=6).stdout)
    assert before["excluded"] == []
    (entry,) = after["excluded"]
    assert (entry["trial"], entry["because"], entry["operator"]) == (2, "the table was hit", "B. Ito")
    dropped = after["analyses"][0]["dropped"]
    assert [(d["trial"].rpartition("/")[2], d["reason"]) for d in dropped] == [("2", "the trial is excluded")]
    assert before["analyses"][0]["dropped"] == []
    assert (
        "trial 2 is left out by B. Ito: the table was hit"
        in call("process", folder, "--out", tmp_path / "a", code=6).stdout
    )
