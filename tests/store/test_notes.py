"""Notes are appended beside a run, whole or not at all, and no change of them goes unnoticed (R3)."""

import json
import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile, RecordError, UsageError
from pmabench.store.folder import sha256_of
from pmabench.store.notes import add_note, read_notes
from pmabench.store.reader import open_run
from pmabench.store.verify import verify
from tests.store.runs import begin, block, closed, die, record


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "photo of the rig.JPG"
    path.write_bytes(bytes(range(256)) * 40)
    return path


@pytest.fixture
def noted(tmp_path, picture):
    """A closed run with three notes."""
    folder = closed(tmp_path)
    add_note(folder, "the hose was replaced", operator="A. Meyer")
    add_note(folder, attach=[picture, picture], operator="A. Meyer")
    add_note(folder, exclude=0, because="the table was hit", operator="B. Ito")
    return folder


def test_notes_say_who_when_and_what_and_keep_the_files(noted, picture):
    first, second, third = read_notes(noted)
    assert (first.number, first.text, first.operator, first.exclude) == (1, "the hose was replaced", "A. Meyer", None)
    assert first.utc.endswith("+00:00")
    assert second.files == ("notes/0002/photo-of-the-rig.JPG", "notes/0002/photo-of-the-rig-2.JPG")
    assert all((noted / name).read_bytes() == picture.read_bytes() for name in second.files)
    assert (third.exclude, third.because) == (0, "the table was hit")
    assert open_run(noted).notes == (first, second, third)
    assert verify(noted) == []


def test_each_note_carries_the_hash_of_the_one_before(noted):
    notes = [json.loads((noted / "notes" / f"{n:04d}" / "note.json").read_bytes()) for n in (1, 2, 3)]
    assert notes[0]["before"] == sha256_of(noted / "manifest.json")
    assert notes[1]["before"] == sha256_of(noted / "notes" / "0001" / "note.json")
    assert notes[2]["before"] == sha256_of(noted / "notes" / "0002" / "note.json")
    assert json.loads((noted / "notes.json").read_bytes())["last"] == sha256_of(noted / "notes" / "0003" / "note.json")


def test_the_sealed_part_is_not_touched(tmp_path, picture):
    folder = closed(tmp_path)
    before = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.rglob("*") if path.is_file()}
    add_note(folder, "x", attach=[picture])
    assert {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in before} == before


def test_an_excluded_trial_says_so_and_others_do_not(noted):
    assert [trial.status for trial in open_run(noted).trials] == ["excluded", "failed"]
    assert [trial.status for trial in open_run(noted, honour_notes=False).trials] == ["finished", "failed"]


def test_an_open_run_takes_notes_and_can_be_closed_after(tmp_path):
    writer = begin(tmp_path)
    record(writer)
    add_note(writer.folder, "while it runs", exclude=1, because="slipped")
    assert [trial.status for trial in open_run(writer.folder).trials] == ["finished", "excluded"]
    folder = writer.close("finished")
    assert verify(folder) == []
    add_note(folder, "after it")
    assert [note.text for note in read_notes(folder)] == ["while it runs", "after it"]
    assert verify(folder) == []


def test_a_dead_run_takes_notes(tmp_path):
    writer = begin(tmp_path)
    writer.append("daq", *block(0, 10))
    die(writer)
    add_note(writer.folder, "the mains failed")
    assert read_notes(writer.folder)[0].text == "the mains failed"


def test_every_changed_byte_of_notes_is_found(noted):
    rng = random.Random(3)
    paths = sorted(path for path in [*noted.glob("notes/*/*"), noted / "notes.json"] if path.is_file())
    assert len(paths) == 6
    for path in paths:
        raw = path.read_bytes()
        path.chmod(0o644)
        for _ in range(30):
            damaged = bytearray(raw)
            damaged[rng.randrange(len(raw))] ^= rng.randrange(1, 256)
            path.write_bytes(damaged)
            assert verify(noted), path
            with pytest.raises(InvalidFile) as caught:
                open_run(noted)
            assert len(str(caught.value).splitlines()) == 1
        path.write_bytes(raw)
    assert verify(noted) == []


def _remove_last(folder):
    shutil.rmtree(folder / "notes" / "0003")


def _remove_first(folder):
    shutil.rmtree(folder / "notes" / "0001")


def _close_up(folder):
    _remove_first(folder)
    for old in ("0002", "0003"):
        (folder / "notes" / old).rename(folder / "notes" / f"{int(old) - 1:04d}")


def _swap(folder):
    one, two, aside = (folder / "notes" / name for name in ("0001", "0002", "x"))
    one.rename(aside), two.rename(one), aside.rename(two)


def _remove_all(folder):
    shutil.rmtree(folder / "notes")


def _remove_head(folder):
    (folder / "notes.json").unlink()


def _old_head(folder):
    head = (folder / "notes.json").read_bytes()
    for text in ("four", "five"):
        add_note(folder, text)
    (folder / "notes.json").write_bytes(head)


def _remove_picture(folder):
    (folder / "notes" / "0002" / "photo-of-the-rig.JPG").unlink()


def _add_file(folder):
    (folder / "notes" / "0002" / "more.txt").write_text("x")


def _add_next_to(folder):
    (folder / "notes" / "remark.txt").write_text("x")


def _of_another_run(folder):
    other = closed(folder.parent, "other", rows=20)
    shutil.copytree(folder / "notes", other / "notes")
    shutil.copy(folder / "notes.json", other / "notes.json")
    return other


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (_remove_last, "notes.json: counts 3 notes; there are 2: notes were removed"),
        (_remove_first, "notes/0002: comes where note 0001 should be: a note was removed or renamed"),
        (_close_up, "notes/0001/note.json: does not follow the note before it: notes were changed or moved"),
        (_swap, "notes/0001/note.json: does not follow the note before it: notes were changed or moved"),
        (_remove_all, "notes.json: counts 3 notes; there are 0: notes were removed"),
        (_remove_head, "notes.json: is missing; there are 3 notes"),
        (_old_head, "notes.json: does not fit the notes: notes or the manifest were changed"),
        (_remove_picture, "notes/0002/photo-of-the-rig.JPG: is missing"),
        (_of_another_run, "notes/0001/note.json: does not follow the note before it: notes were changed or moved"),
    ],
)
def test_removed_and_moved_notes_are_found(noted, harm, says):
    folder = harm(noted) or noted
    assert [str(finding) for finding in verify(folder)] == [says]
    with pytest.raises(InvalidFile, match="`pmabench runs verify` says more"):
        open_run(folder)
    with pytest.raises(InvalidFile):
        add_note(folder, "on top of that")


@pytest.mark.parametrize(
    ("add", "says"),
    [
        (_add_file, "notes/0002/more.txt: was added to the note"),
        (_add_next_to, "notes/remark.txt: was put among the notes; it is none"),
    ],
)
def test_what_was_put_among_the_notes_is_named_and_harms_none(noted, add, says):
    add(noted)
    (finding,) = verify(noted)
    assert (str(finding), finding.added) == (says, True)
    assert [entry.name for entry in open_run(noted).since.added] == [says.partition(":")[0]]
    assert add_note(noted, "on top of that").number == 4


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, "says nothing"),
        ({"text": "  "}, "says nothing"),
        ({"exclude": 0}, "go together"),
        ({"text": "x", "because": "why"}, "go together"),
        ({"text": "x" * 100_001}, "longer than 100000 characters"),
    ],
)
def test_a_note_that_says_nothing_or_half_is_refused(tmp_path, given, says):
    folder = closed(tmp_path, rows=20)
    with pytest.raises(UsageError, match=says):
        add_note(folder, **given)
    assert read_notes(folder) == ()


def test_what_cannot_be_noted_is_reported_in_a_sentence(tmp_path):
    folder = closed(tmp_path, rows=20)
    with pytest.raises(InvalidFile, match="has no trial 8 to exclude; it has trials 1 to 2"):
        add_note(folder, exclude=7, because="x")
    with pytest.raises(InvalidFile, match="cannot be attached: it is no file"):
        add_note(folder, attach=[tmp_path])
    with pytest.raises(InvalidFile, match="is not a run folder"):
        add_note(tmp_path, "x")
    assert verify(folder) == []


def test_where_a_note_cannot_be_written_nothing_is_left(tmp_path, monkeypatch, picture):
    folder = closed(tmp_path, rows=20)
    add_note(folder, "first")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pmabench.store.notes.os.fsync", full)
    with pytest.raises(RecordError, match=r"cannot write .*: No space left on device") as caught:
        add_note(folder, "second", attach=[picture])
    assert caught.value.exit_code == 7
    monkeypatch.undo()
    assert [note.text for note in read_notes(folder)] == ["first"]
    assert verify(folder) == []
    assert sorted(path.name for path in (folder / "notes").iterdir()) == ["0001"]


def test_two_programs_note_at_once_and_both_are_kept(tmp_path):
    folder = closed(tmp_path, rows=20)
    program = "import sys, pathlib; from pmabench.store.notes import add_note\nfor k in range(15): add_note(pathlib.Path(sys.argv[1]), f'{sys.argv[2]}{k}')"
    running = [subprocess.Popen([sys.executable, "-c", program, str(folder), name]) for name in "ab"]
    assert [process.wait(60) for process in running] == [0, 0]
    assert sorted(note.text for note in read_notes(folder)) == sorted(f"{name}{k}" for name in "ab" for k in range(15))
    assert verify(folder) == []


@pytest.mark.slow
def test_a_note_that_is_killed_anywhere_is_there_whole_or_not_at_all(tmp_path, picture, record_property):
    folder = closed(tmp_path / "runs", rows=20)
    add_note(folder, "first")
    command = [sys.executable, "-m", "tests.store.killed_note", str(folder), str(picture), str(tmp_path / "copies")]
    (tmp_path / "copies").mkdir()
    root = Path(__file__).parents[2]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True, timeout=120)
    reported = [json.loads(line) for line in done.stdout.splitlines()]
    record_property("cases", len(reported))
    assert len(reported) > 20
    seen = set()
    for entry in reported:
        run = Path(entry["run"])
        texts = [note.text for note in read_notes(run)]
        assert texts in (["first"], ["first", "seen afterwards"])
        assert verify(run) == []
        seen.add(len(texts))
        add_note(run, "later")
        assert [note.text for note in read_notes(run)] == [*texts, "later"]
        assert verify(run) == []
    assert reported[-1]["ended"]
    assert seen == {1, 2}
