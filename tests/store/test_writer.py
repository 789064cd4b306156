"""The folder exists before anything moves; the record is whole, or the failure to write it is told (R1, R3, R8)."""

import contextlib
import errno
import json
import os
import re
import resource
import shutil
import stat
import threading
import time
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pmabench.base.errors import RecordError
from pmabench.store import seal
from pmabench.store.folder import AppendFile, check_name, open_json, run_name, status_of
from pmabench.store.reader import open_run, read_stream
from pmabench.store.seal import close_interrupted
from pmabench.store.verify import verify
from pmabench.store.writer import FLUSH_EVERY, RunWriter
from tests.store.runs import COLUMNS, MANIFEST, SNAPSHOTS, begin, block, closed, die, record, unclosed


def test_names_sort_as_time_and_are_legal_everywhere():
    when = datetime(2026, 11, 21, 15, 32, tzinfo=timezone(timedelta(hours=1)))
    assert re.fullmatch(
        r"20261121-1432_MAS20-A017_contraction-relaxation_[0-9a-f]{4}",
        run_name(when, "MAS20-A017", "contraction-relaxation", False),
    )
    odd = run_name(when.astimezone(UTC), "../Ä µ/\n_x y", "", True)
    assert re.fullmatch(r"[A-Za-z0-9._-]+", odd)
    assert "_SIMULATED_" in odd
    assert odd.count("_") == 4


@pytest.mark.parametrize("name", ["../x", "/abs", "a/../b", "a//b", "", ".hidden", "a b", "nul\0", "line\n", "-x", "ä"])
def test_no_file_is_written_outside_the_run(tmp_path, name):
    with pytest.raises(RecordError):
        check_name(name)
    with pytest.raises(RecordError):
        RunWriter.create(tmp_path, "run", {}, {name: b""})
    assert not list(tmp_path.iterdir())


def test_folder_manifest_and_snapshots_are_there_before_the_first_command(tmp_path):
    writer = begin(tmp_path / "runs" / "new")
    manifest = open_json((writer.folder / "manifest.json").read_bytes(), "")
    assert manifest["schema"] == "pmabench.run/1"
    assert manifest["id"] == "run"
    assert manifest["simulated"] is True
    assert manifest["trials_planned"] == 2
    assert manifest["started_utc"].endswith("+00:00")
    assert {"python", "pmabench", "numpy", "pyarrow"} <= manifest["versions"].keys()
    for name, content in SNAPSHOTS.items():
        assert (writer.folder / name).read_bytes() == content
    assert status_of(manifest, None) == "running"
    die(writer)


def test_a_name_that_is_taken_gets_a_number(tmp_path):
    first, second = closed(tmp_path, rows=2), closed(tmp_path, rows=2)
    assert [first.name, second.name] == ["run", "run-2"]
    assert open_run(second).id == "run-2"
    assert verify(first) == verify(second) == []


def test_a_closed_run_is_read_only_sealed_and_holds_no_live_file(tmp_path):
    folder = closed(tmp_path)
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    sealed = {"manifest.json", "README.txt", "events.jsonl", "streams/daq.json", "streams/daq.parquet", *SNAPSHOTS}
    assert names == sealed | {"seal.json"}
    assert {stat.S_IMODE((folder / name).stat().st_mode) for name in names} == {0o444}
    seal = open_json((folder / "seal.json").read_bytes(), "")
    assert seal["files"].keys() == sealed
    assert (seal["status"], seal["end"]) == ("finished", {"vent": {"result": "confirmed"}})
    assert (seal["trials_finished"], seal["trials_planned"]) == (1, 2)
    assert seal["streams"]["daq"]["rows"] == 2000
    assert verify(folder) == []


def test_raw_samples_come_back_byte_for_byte(tmp_path):
    rng = np.random.default_rng(5)
    counts = np.concatenate(([-(2**31), 2**31 - 1, 0, -1], rng.integers(-(2**31), 2**31 - 1, 5000))).astype(np.int32)
    bits = rng.integers(0, 2**63, len(counts), dtype=np.uint64)
    bits[:4] = [0x7FF8000000000001, 0x8000000000000000, 1, 0x7FF0000000000000]
    volts = bits.view(np.float64)
    stamps = np.sort(rng.integers(-(2**62), 2**62, len(counts)))
    flags = rng.integers(0, 2**16, len(counts)).astype(np.uint16)
    writer = begin(tmp_path)
    for part in np.array_split(np.arange(len(counts)), 7):
        raw = {"pressure": counts[part], "displacement": counts[part][::-1], "force": volts[part]}
        writer.append("daq", stamps[part], raw, flags[part])
    folder = writer.close("finished")
    table = pq.read_table(folder / "streams" / "daq.parquet")
    assert [str(kind) for kind in table.schema.types] == ["int64", "int32", "int32", "double", "uint16"]
    for name, given in (("time_ns", stamps), ("pressure", counts), ("force", volts), ("flags", flags)):
        assert table.column(name).to_numpy().tobytes() == given.tobytes()
    field = table.schema.field("pressure").metadata
    assert (field[b"unit"], field[b"si_unit"], field[b"slope"], field[b"offset"]) == (
        b"count",
        b"Pa",
        b"0.25",
        b"-500.0",
    )
    assert json.loads(field[b"calibration"])["id"] == "P-0231"
    assert json.loads(table.schema.metadata[b"pmabench"])["schema"] == "pmabench.stream/1"
    frame = read_stream(folder, raw=True)
    assert frame["force"].to_numpy().tobytes() == volts.tobytes()


def test_samples_are_on_disk_within_a_quarter_second_without_another_call(tmp_path):
    writer = begin(tmp_path)
    assert FLUSH_EVERY <= 0.25
    writer.append("daq", *block(0, 25))
    for _ in range(100):  # a machine that stands still must not make this red
        time.sleep(FLUSH_EVERY)
        if len(read_stream(writer.folder)) == 25:
            break
    assert len(read_stream(writer.folder)) == 25
    die(writer)


def test_what_was_appended_may_be_changed_afterwards(tmp_path):
    writer = begin(tmp_path)
    time_ns, raw, flags = block(0, 10)
    writer.append("daq", time_ns, raw, flags)
    time_ns[:], raw["pressure"][:], flags[:] = -1, -1, 9
    folder = writer.close("finished")
    assert read_stream(folder, raw=True)["pressure"].tolist() == block(0, 10)[1]["pressure"].tolist()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"pressure": np.array([2**31])}, "pressure: a value does not fit int32"),
        ({"pressure": np.array([0.5])}, "pressure: a value does not fit int32"),
        ({"pressure": np.array([np.nan])}, "pressure: a value does not fit int32"),
        ({"force": np.zeros(2)}, "unequal length"),
        ({"extra": np.zeros(1)}, "differ in extra"),
    ],
)
def test_samples_that_do_not_fit_are_refused_not_bent(tmp_path, change, says):
    writer = begin(tmp_path)
    time_ns, raw, flags = block(0, 1)
    with pytest.raises(RecordError, match=says):
        writer.append("daq", time_ns, raw | change, flags)
    writer.append("daq", time_ns, raw, flags)
    assert len(read_stream(writer.close("finished"))) == 1


def test_a_second_stream_keeps_its_own_clock(tmp_path):
    writer = begin(tmp_path)
    writer.open_stream("gauge", [dict(COLUMNS[2], name="supply", quantity="pressure")], 10.0)
    writer.append("gauge", [5, 100_000_005], {"supply": [1.0, 2.0]}, [0, 1])
    writer.append("daq", *block(0, 100))
    folder = writer.close("finished")
    assert read_stream(folder, "gauge", raw=True)["time_ns"].tolist() == [5, 100_000_005]
    assert set(open_run(folder).channels) == {"pressure", "displacement", "force", "supply"}
    assert verify(folder) == []


@pytest.mark.parametrize("status", ["interrupted", "", "ok"])
def test_a_status_outside_the_list_is_refused(tmp_path, status):
    writer = begin(tmp_path)
    with pytest.raises(ValueError, match="is not one of finished, failed, aborted, tripped, error"):
        writer.close(status)
    writer.close("aborted", "by the operator")
    with pytest.raises(RecordError, match="closed"):
        writer.event("late", 1.0)


def test_where_no_folder_can_be_made_nothing_is_left(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(RecordError, match=r"cannot write .*file.*: Not a directory") as caught:
        RunWriter.create(tmp_path / "file" / "runs", "run", MANIFEST, SNAPSHOTS)
    assert caught.value.exit_code == 7
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def append_blocks(writer, most, size, sent=None):
    """Append block after block, at most `most`, at a pace that the writer's thread can follow; notes rows in `sent`."""
    for first in range(0, most * size, size):
        if sent is not None:
            sent.append(size)
        writer.append("daq", *block(first, size))
        time.sleep(0.001)


class _FileSizeLimit:
    """No file of this process may grow beyond `size` bytes, as on a full disk: short writes, then an error."""

    def __init__(self, size):
        self.size = size

    def __enter__(self):
        self.before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (self.size, self.before[1]))

    def __exit__(self, *_):
        resource.setrlimit(resource.RLIMIT_FSIZE, self.before)


def test_a_disk_that_is_full_at_the_start_leaves_no_folder(tmp_path):
    with _FileSizeLimit(100), pytest.raises(RecordError, match="File too large"):
        RunWriter.create(tmp_path / "runs", "run", MANIFEST, SNAPSHOTS)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("limit", [8_000, 20_001, 33_333])
def test_a_disk_that_fills_up_ends_the_run_and_keeps_what_was_written(tmp_path, limit):
    writer = begin(tmp_path)
    with _FileSizeLimit(limit):
        with pytest.raises(RecordError, match=r"daq\.arrows: File too large") as caught:
            append_blocks(writer, 5000, 2)
        assert caught.value.exit_code == 7
        with pytest.raises(RecordError):
            writer.event("vent", 1.0, result="confirmed")
        with pytest.raises(RecordError, match=r"daq\.arrows: File too large"):
            writer.close("finished", vent={"result": "confirmed"})
    run = open_run(writer.folder)
    assert run.status == "error"
    assert [event.kind for event in run.events] == ["vent", "end"]
    raw = read_stream(writer.folder, raw=True)
    assert 0 < len(raw) < 10_000
    assert raw["pressure"].tolist() == block(0, len(raw))[1]["pressure"].tolist()
    assert verify(writer.folder) == []


def test_where_not_even_the_seal_can_be_written_the_run_is_that_of_a_dead_writer(tmp_path):
    writer = begin(tmp_path)
    record(writer)
    with _FileSizeLimit(50), pytest.raises(RecordError, match="File too large"):
        writer.close("finished")
    assert not (writer.folder / "seal.json").exists()
    _forget_writer(writer.folder / "manifest.json")
    assert open_run(writer.folder).status == "interrupted"
    assert [len(trial.t) for trial in open_run(writer.folder).trials] == [1000, 1000]
    assert verify(close_interrupted(writer.folder)) == []


def test_nothing_is_lost_when_space_comes_back_before_the_end(tmp_path):
    writer = begin(tmp_path)
    sent = []
    with _FileSizeLimit(8_000), pytest.raises(RecordError):
        append_blocks(writer, 1000, 100, sent)
    folder = writer.close("error", "the disk was full for a while")
    assert read_stream(folder, raw=True)["pressure"].tolist() == block(0, sum(sent))[1]["pressure"].tolist()
    assert verify(folder) == []


def test_events_that_cannot_be_written_are_kept_for_the_next_try(tmp_path):
    writer = begin(tmp_path)
    with _FileSizeLimit(10), pytest.raises(RecordError, match=r"events\.jsonl: File too large"):
        writer.event("armed", 0.0)
    folder = writer.close("error", "disk")
    assert [event.kind for event in open_run(folder).events] == ["armed", "end"]


def fail(_file):
    raise OSError(errno.EIO, "Input/output error")


@pytest.mark.parametrize("move", [lambda folder: folder.rename(folder.with_name("elsewhere")), shutil.rmtree])
def test_a_folder_that_is_moved_or_deleted_fails_the_run(tmp_path, monkeypatch, move):
    monkeypatch.setattr("pmabench.store.writer.SYNC_EVERY", 0.01)
    writer = begin(tmp_path)
    writer.append("daq", *block(0, 5))
    move(writer.folder)
    writer._threads[1].join(60)
    with pytest.raises(RecordError, match="No such file or directory"):
        writer.append("daq", *block(5, 5))
    with pytest.raises(RecordError):
        writer.close("error", "disk")


def test_a_failed_sync_fails_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr("pmabench.store.writer.SYNC_EVERY", 0.0)
    writer = begin(tmp_path)
    monkeypatch.setattr(AppendFile, "sync", fail)
    with pytest.raises(RecordError, match="Input/output error"):
        append_blocks(writer, 1000, 1)
    monkeypatch.undo()
    writer.close("error", "Input/output error")


def test_a_failed_sync_that_nobody_heard_of_fails_the_end(tmp_path, monkeypatch):
    monkeypatch.setattr("pmabench.store.writer.SYNC_EVERY", 0.0)
    writer = begin(tmp_path)
    writer.append("daq", *block(0, 5))
    monkeypatch.setattr(AppendFile, "sync", fail)
    writer._threads[1].join(60)
    monkeypatch.undo()
    with pytest.raises(RecordError, match="Input/output error"):
        writer.close("finished")
    assert (open_run(writer.folder).status, verify(writer.folder)) == ("error", [])


def test_events_that_cannot_be_synced_at_the_end_fail_the_run(tmp_path, monkeypatch):
    writer = begin(tmp_path)
    monkeypatch.setattr(writer._events, "sync", lambda: fail(None))
    with pytest.raises(RecordError, match=r"events\.jsonl: Input/output error"):
        writer.close("finished")
    assert (open_run(writer.folder).status, verify(writer.folder)) == ("error", [])


def test_a_folder_that_cannot_be_listed_is_not_sealed_with_files_left_out(tmp_path, monkeypatch):
    writer = begin(tmp_path)
    record(writer)
    real = os.scandir
    with monkeypatch.context() as patch:
        patch.setattr("os.scandir", lambda place: fail(None) if str(place) == str(writer.folder) else real(place))
        with pytest.raises(RecordError, match="Input/output error"):
            writer.close("finished")
    assert not (writer.folder / "seal.json").exists()


def test_an_end_mark_that_cannot_be_written_fails_the_run(tmp_path, monkeypatch):
    writer = begin(tmp_path)
    record(writer)
    monkeypatch.setattr(writer._events, "write", lambda _piece: fail(None))
    with pytest.raises(RecordError, match=r"events\.jsonl: Input/output error"):
        writer.close("finished")
    assert (open_run(writer.folder).status, verify(writer.folder)) == ("error", [])


def test_a_slow_sync_holds_up_no_sample(tmp_path, monkeypatch):
    released = threading.Event()
    monkeypatch.setattr("pmabench.store.writer.SYNC_EVERY", 0.0)
    monkeypatch.setattr(AppendFile, "sync", lambda _file: released.wait(60))
    writer = begin(tmp_path)
    writer.append("daq", *block(0, 25))
    for _ in range(100):
        time.sleep(FLUSH_EVERY)
        if len(read_stream(writer.folder)) == 25:
            break
    assert len(read_stream(writer.folder)) == 25
    monkeypatch.undo()
    released.set()
    die(writer)


@pytest.mark.parametrize("part", ["write", "sync"])
def test_a_disk_that_hangs_fails_the_run(tmp_path, monkeypatch, part):
    released = threading.Event()
    if part == "sync":
        monkeypatch.setattr("pmabench.store.writer.SYNC_EVERY", 0.0)
        monkeypatch.setattr(AppendFile, "sync", lambda _file: released.wait(60))
    writer = begin(tmp_path)
    monkeypatch.setattr("pmabench.store.writer.STALLED", 0.05)
    hang = writer._streams["daq"]._lock if part == "write" else contextlib.nullcontext()
    with hang, pytest.raises(RecordError, match="the disk took nothing"):
        append_blocks(writer, 1000, 1)
    monkeypatch.undo()
    released.set()
    writer.close("error", "hung")


def test_where_samples_can_wait_a_slow_disk_ends_nothing(tmp_path, monkeypatch):
    released = threading.Event()
    monkeypatch.setattr("pmabench.store.writer.SYNC_EVERY", 0.0)
    monkeypatch.setattr(AppendFile, "sync", lambda _file: released.wait(60))
    writer = begin(tmp_path)
    writer.waits = True
    monkeypatch.setattr("pmabench.store.writer.STALLED", 0.05)
    append_blocks(writer, 200, 1)  # 0.2 s
    monkeypatch.undo()
    released.set()
    writer.close("finished")
    assert open_run(writer.folder).status == "finished"


def test_samples_of_a_trial_are_written_before_its_end(tmp_path, monkeypatch):
    monkeypatch.setattr("pmabench.store.writer.FLUSH_EVERY", 60.0)
    writer = begin(tmp_path)
    record(writer)
    assert [len(trial.t) for trial in open_run(writer.folder).trials] == [1000, 1000]
    writer.close("finished")


def test_a_dead_run_is_closed_as_interrupted_with_all_that_is_whole(tmp_path):
    folder = unclosed(tmp_path)
    with pytest.raises(RecordError, match="still being written by process"):
        close_interrupted(folder)
    manifest = folder / "manifest.json"
    _forget_writer(manifest)
    with (folder / "streams" / "daq.arrows").open("ab") as live:
        live.write(b"\xff\xff\xff\xff\x10\x01\x00\x00torn")
    assert open_run(folder).status == "interrupted"
    before = read_stream(folder)
    assert close_interrupted(folder) == folder
    run = open_run(folder)
    assert run.status == "interrupted"
    assert read_stream(folder).equals(before)
    assert (folder / "streams" / "daq.arrows").exists(), "the torn tail is kept"
    assert verify(folder) == []
    close_interrupted(folder)
    assert verify(folder) == []


@pytest.mark.parametrize("what", ["time_ns", "pressure", "force", "flags", "a column", "a group", "rows", ""])
def test_samples_that_the_disk_returns_otherwise_stay_in_the_live_file(tmp_path, monkeypatch, what):
    """One bit of the last row, a lost column, group or row: the file that was written first remains; nothing: the other."""
    honest = seal._row_groups

    def returned(path):
        tables = list(honest(path))
        last = tables.pop()
        if what == "rows":
            last = last.slice(0, len(last) - 1)
        elif what == "a column":
            last = last.drop_columns(["flags"])
        elif what in last.column_names:
            values = last[what].to_numpy().copy()
            values[-1:].view(np.uint8)[0] ^= 1
            last = last.set_column(last.column_names.index(what), last.schema.field(what), pa.array(values))
        return [*tables, *([] if what == "a group" else [last])]

    monkeypatch.setattr(seal, "GROUP", 700)
    monkeypatch.setattr(seal, "_row_groups", returned)
    writer = begin(tmp_path)
    record(writer)
    writer.close("finished")
    streams = {path.name for path in (writer.folder / "streams").iterdir()}
    assert streams == {"daq.json", "daq.arrows" if what else "daq.parquet"}
    monkeypatch.undo()
    assert read_stream(writer.folder, raw=True)["force"].tolist() == block(0, 2000)[1]["force"].tolist()


class _Died(BaseException):
    """The program ends here."""


@pytest.mark.parametrize(
    "place",
    [
        "seal._is_copy",
        "seal.span_of",
        "folder.decode_lines",
        "folder.sha256_of",
        "seal.write_into_room",
        "seal._write_all",
    ],
)
def test_a_program_that_dies_while_it_closes_loses_nothing(tmp_path, monkeypatch, place):
    writer = begin(tmp_path)
    record(writer)

    def die_here(*_):
        raise _Died

    monkeypatch.setattr(f"pmabench.store.{place}", die_here)
    with pytest.raises(_Died):
        writer.close("finished")
    monkeypatch.undo()
    (writer.folder / "streams" / ".daq.parquet.part").write_bytes(b"half")
    _forget_writer(writer.folder / "manifest.json")
    run = open_run(writer.folder)
    assert run.status == "interrupted"
    assert [len(trial.t) for trial in run.trials] == [1000, 1000]
    close_interrupted(writer.folder)
    assert verify(writer.folder) == []
    assert read_stream(writer.folder, raw=True)["pressure"].tolist() == block(0, 2000)[1]["pressure"].tolist()


def _forget_writer(path):
    from pmabench.store.folder import sealed_json

    data = open_json(path.read_bytes(), path)
    del data["sha256"]
    path.write_bytes(sealed_json(data | {"writer": {}}))
