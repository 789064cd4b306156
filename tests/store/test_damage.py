"""No damage makes a wrong number: torn and altered live files are cut, closed runs are refused and verify tells (R3)."""

import random
import shutil

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.store.folder import decode_lines
from pmabench.store.livestream import LiveReader, pa
from pmabench.store.notes import add_note
from pmabench.store.reader import open_run, read_stream
from pmabench.store.verify import verify
from tests.reliability.cases import cases
from tests.store.runs import begin, block, closed, die, record, unclosed


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """Bytes of a live stream of a dozen batches, and of its events."""
    writer = begin(tmp_path_factory.mktemp("live"))
    for number in range(12):
        writer.append("daq", *block(number * 20, 20))
        writer._streams["daq"].drain()
    record(writer, 200)
    die(writer)
    return (writer.folder / "streams" / "daq.arrows").read_bytes(), (writer.folder / "events.jsonl").read_bytes()


def samples(raw):
    """All bytes of all columns that a reader believes, whether it saw an end mark, and what it complains of."""
    try:
        reader = LiveReader(pa.py_buffer(raw))
    except ValueError as error:
        return b"", False, str(error)
    believed = b"".join(column.to_numpy().tobytes() for batch in reader for column in batch.columns)
    return believed, reader.ended, reader.fault


def test_a_live_stream_cut_anywhere_gives_whole_batches_only(live, record_property):
    raw, _ = live
    truth, ended, fault = samples(raw)
    assert (ended, fault) == (False, "stops after batch 14 without its end mark")
    assert len(truth) == (12 * 20 + 200) * (8 + 4 + 4 + 8 + 2)
    lengths = range(0, len(raw), max(1, len(raw) // cases(400)))
    record_property("cases", len(lengths))
    for length in lengths:
        believed, ended, fault = samples(raw[:length])
        assert truth.startswith(believed)
        assert fault
        assert not ended


def test_a_live_stream_with_any_bit_flipped_gives_no_wrong_number(live):
    raw, _ = live
    truth = samples(raw)[0]
    rng = random.Random(7)
    for _ in range(1500):
        damaged = bytearray(raw)
        damaged[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
        assert truth.startswith(samples(bytes(damaged))[0])


def test_a_live_stream_with_zeroed_or_foreign_pages_gives_no_wrong_number(live):
    raw, _ = live
    truth = samples(raw)[0]
    rng = random.Random(8)
    for number in range(600):
        at = rng.randrange(len(raw))
        page = bytes(512) if number % 2 else raw[(other := rng.randrange(len(raw))) : other + 512]
        assert truth.startswith(samples(raw[:at] + page + raw[at + len(page) :])[0])


def test_events_cut_or_altered_anywhere_give_whole_lines_only(live):
    _, raw = live
    truth = decode_lines(raw)
    assert (len(truth.lines), truth.fault) == (11, "")
    for length in range(len(raw)):
        lines = decode_lines(raw[:length]).lines
        assert lines == truth.lines[: len(lines)]
    rng = random.Random(9)
    for _ in range(1500):
        damaged = bytearray(raw)
        damaged[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
        journal = decode_lines(bytes(damaged))
        assert journal.lines == truth.lines[: len(journal.lines)]
        assert journal.fault


@pytest.mark.parametrize("change", [lambda a, b, c: [a, c], lambda a, b, c: [b, a, c], lambda a, b, c: [a, a, b, c]])
def test_a_missing_moved_or_doubled_event_is_found(live, change):
    first, second, third, *_ = live[1].splitlines(keepends=True)
    journal = decode_lines(b"".join(change(first, second, third)))
    assert journal.fault
    assert len(journal.lines) <= 1


def test_a_dead_run_with_a_torn_tail_opens_as_far_as_it_is_whole(tmp_path):
    folder = unclosed(tmp_path)
    stream, events = folder / "streams" / "daq.arrows", folder / "events.jsonl"
    raw, lines = stream.read_bytes(), events.read_bytes()
    stream.write_bytes(raw[:-100])
    events.write_bytes(lines[:-3])
    run = open_run(folder)
    assert [trial.status for trial in run.trials] == ["finished", "failed"]
    assert len(run.trials[0].t) == 1000
    assert len(run.trials[1].t) < 1000
    found = [str(finding) for finding in verify(folder)]
    assert any("batch" in line and "torn" in line for line in found)
    assert any("events.jsonl: line 11 is torn" in line for line in found)
    stream.write_bytes(raw[: len(raw) // 3])
    assert open_run(folder).trials[0].status == "interrupted", "its end is told, its samples are not all there"
    stream.write_bytes(b"")
    assert [len(trial.t) for trial in open_run(folder).trials] == [0, 0]
    events.unlink()
    assert open_run(folder).trials == ()


@pytest.fixture(scope="module")
def sealed(tmp_path_factory):
    return closed(tmp_path_factory.mktemp("sealed"))


def test_verify_finds_every_changed_byte_in_every_kind_of_file(tmp_path, record_property):
    writer = begin(tmp_path)
    record(writer)
    (writer.folder / "guard.json").write_text('{"vent": {"result": "confirmed", "actions": []}, "cause": "", "t": 1.0}')
    folder = writer.close("finished")
    picture = tmp_path / "rig.jpg"
    picture.write_bytes(bytes(range(200)))
    add_note(folder, "a note", attach=[picture], operator="N")
    rng = random.Random(10)
    assert verify(folder) == []
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    assert len(files) == 13
    each = -(-cases(130) // len(files))
    record_property("cases", each * len(files))
    for path in files:
        raw = path.read_bytes()
        path.chmod(0o644)
        for _ in range(each):
            damaged = bytearray(raw)
            damaged[rng.randrange(len(raw))] ^= rng.randrange(1, 256)
            path.write_bytes(damaged)
            found = verify(folder)
            assert path.relative_to(folder).as_posix() in {finding.file for finding in found}
            assert all(len(str(finding).splitlines()) == 1 for finding in found)
        path.write_bytes(raw)
    assert verify(folder) == []


def test_a_changed_closed_run_is_refused_not_read(sealed):
    rng = random.Random(11)
    for name in ("manifest.json", "seal.json", "events.jsonl", "plan.json", "streams/daq.parquet"):
        path = sealed / name
        raw = path.read_bytes()
        for _ in range(15):
            damaged = bytearray(raw)
            damaged[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
            path.write_bytes(damaged)
            with pytest.raises(InvalidFile) as caught:
                open_run(sealed)
            assert len(str(caught.value).splitlines()) == 1
        path.write_bytes(raw)
    assert open_run(sealed).status == "finished"


def test_added_missing_swapped_and_linked_files_are_found(tmp_path, sealed):
    def copy(name):
        return shutil.copytree(sealed, tmp_path / name)

    assert verify(copy("moved")) == [], "a copied run is as good as the first"
    added = copy("added")
    (added / "streams" / "extra.parquet").write_bytes(b"x")
    assert [str(finding) for finding in verify(added)] == ["streams/extra.parquet: was added after the run was closed"]
    missing = copy("missing")
    (missing / "protocol.yaml").unlink()
    assert [str(finding) for finding in verify(missing)] == ["protocol.yaml: is missing"]
    swapped = copy("swapped")
    (swapped / "protocol.yaml").unlink()
    (swapped / "README.txt").rename(swapped / "protocol.yaml")
    assert {finding.file for finding in verify(swapped)} == {"protocol.yaml", "README.txt"}
    linked = copy("linked")
    (linked / "protocol.yaml").unlink()
    (linked / "protocol.yaml").symlink_to(sealed / "protocol.yaml")
    assert [str(finding) for finding in verify(linked)] == ["protocol.yaml: is a link, which no run contains"]
    unsealed = copy("unsealed")
    (unsealed / "seal.json").unlink()
    assert "seal.json: is missing" in str(verify(unsealed)[0])


def test_a_gap_that_no_flag_shows_of_is_found_and_a_flagged_one_is_not(tmp_path):
    def run(name, flag):
        writer = begin(tmp_path, name)
        writer.event("trial-begin", 0.0, trial=0, point={}, repeat=0, reference=False)
        writer.append("daq", *block(0, 100))
        time_ns, raw, flags = block(150, 100)
        flags[0] |= flag
        writer.append("daq", time_ns, raw, flags)
        writer.event("trial-end", 0.5, trial=0, status="finished")
        return writer.close("finished")

    assert verify(run("reported", 1)) == []
    (finding,) = verify(run("silent", 0))
    assert str(finding) == "streams/daq: 0.102 s without a sample after t = 0.198 s, and no flag says so"


def test_what_is_not_a_run_is_refused_in_one_sentence(tmp_path):
    (tmp_path / "file").write_text("x")
    (tmp_path / "empty").mkdir()
    (tmp_path / "blank").mkdir()
    (tmp_path / "run_1a2b.late").mkdir()
    (tmp_path / "blank" / "manifest.json").write_bytes(b"")
    said = {
        "nothing": "is not a run folder: there is no such folder",
        "file": "is not a run folder: no manifest.json in it",
        "empty": "is not a run folder: no manifest.json in it",
        "blank": "is empty",
        "run_1a2b.late": "the guard reported late; the run is run_1a2b, next to it",
    }
    for name, sentence in said.items():
        for read in (open_run, read_stream):
            with pytest.raises(InvalidFile, match=sentence) as caught:
                read(tmp_path / name)
            assert len(str(caught.value).splitlines()) == 1
            assert caught.value.exit_code == 3


def test_a_run_of_a_newer_schema_is_refused_by_name(tmp_path, sealed):
    newer = shutil.copytree(sealed, tmp_path / "newer")
    text = (newer / "manifest.json").read_text().replace("pmabench.run/1", "pmabench.run/2")
    (newer / "manifest.json").write_text(text)
    with pytest.raises(
        InvalidFile, match=r"written by a newer pmabench \(pmabench.run/2\); this one reads pmabench.run/1"
    ):
        open_run(newer)
