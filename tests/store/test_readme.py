"""Without pmabench a run is read with the lines of its README.txt, executed here as they are printed (R10)."""

import textwrap

import pytest

from pmabench.store.reader import read_stream
from tests.reliability.cases import cases
from tests.store.runs import begin, block, closed, die

CLOSED, LIVE = "Closed run, Python", "Running or interrupted run, Python"


def lines_after(folder, heading):
    """The indented lines under a heading, as they stand in the folder."""
    rest = (folder / "README.txt").read_text("utf-8").split(heading, 1)[1].split("\n\n", 2)
    return textwrap.dedent(rest[1])


def execute(folder, heading):
    names = {}
    exec(compile(lines_after(folder, heading), "README.txt", "exec"), names)
    return names


def test_a_closed_run_in_pandas(tmp_path, monkeypatch):
    folder = closed(tmp_path)
    monkeypatch.chdir(folder)
    frame = execute(folder, CLOSED)["frame"]
    truth = read_stream(folder)
    assert len(frame) == 2000
    for name in ("t", "pressure", "displacement", "force", "flags"):
        assert frame[name].tolist() == truth[name].tolist()


def test_a_run_under_way_gives_whole_batches_at_every_moment(tmp_path, monkeypatch, capsys, record_property):
    writer = begin(tmp_path)
    monkeypatch.chdir(writer.folder)
    seen = []
    rows = cases(100) * 15
    record_property("cases", rows // 15)
    for first in range(0, rows, 5):
        writer.append("daq", *block(first, 5), first * 2_000_000)
        if first % 3 == 0:
            names = execute(writer.folder, LIVE)
            seen.append(names["table"].num_rows)
            assert names["table"].column("pressure").to_pylist() == block(0, seen[-1])[1]["pressure"].tolist()
            assert names["end"] == b"0"
    die(writer)
    assert seen == sorted(seen)
    assert execute(writer.folder, LIVE)["table"].num_rows == rows


def test_a_finished_stream_says_that_it_has_ended(tmp_path, monkeypatch, capsys):
    writer = begin(tmp_path)
    writer.append("daq", *block(0, 50))
    writer._halt()
    writer._streams["daq"].finish()
    monkeypatch.chdir(writer.folder)
    names = execute(writer.folder, LIVE)
    assert (names["end"], names["table"].num_rows) == (b"1", 50)
    assert capsys.readouterr().out == ""
    writer._events.close()


@pytest.mark.parametrize("offset", [3000, 4000, 5000, 6000])
def test_an_altered_batch_stops_the_live_lines(tmp_path, monkeypatch, capsys, offset):
    writer = begin(tmp_path)
    for first in range(0, 200, 50):
        writer.append("daq", *block(first, 50))
        writer._streams["daq"].drain()
    die(writer)
    path = writer.folder / "streams" / "daq.arrows"
    raw = bytearray(path.read_bytes())
    raw[offset] ^= 4
    path.write_bytes(raw)
    monkeypatch.chdir(writer.folder)
    table = execute(writer.folder, LIVE)["table"]
    assert table.num_rows < 200
    assert table.column("force").to_pylist() == block(0, table.num_rows)[1]["force"].tolist()
    assert "not whole" in capsys.readouterr().out


def test_the_live_lines_are_about_ten(tmp_path):
    folder = closed(tmp_path, rows=2)
    assert len(lines_after(folder, LIVE).splitlines()) <= 16
    assert all(len(line) <= 118 for line in (folder / "README.txt").read_text("utf-8").splitlines())
