"""Files of more rows than fit into memory: read in pieces, inspected in parts, and the run is the same as in one."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pmabench.base.errors import InvalidFile
from pmabench.store.importers import long, table
from pmabench.store.importers.prepare import prepare
from pmabench.store.importers.table import read_table
from pmabench.store.reader import open_run
from tests.importing import import_files, read_map
from tests.store import long_text

ROOT = Path(__file__).resolve().parents[2]
MEMORY = 500e6


@pytest.fixture
def small_parts(monkeypatch):
    monkeypatch.setattr(long, "PART", 7_000)
    monkeypatch.setattr(long, "BEFORE", 300)
    monkeypatch.setattr(long, "STRETCHES", 3_000)
    monkeypatch.setattr(table, "KEPT", 100_000)
    monkeypatch.setattr("pmabench.store.importers.table.PIECE", 50_000)


def made(tmp_path, rows=40_000, damage=None):
    path = tmp_path / "log.csv"
    long_text.write(path, 1e3)
    lines = path.read_text().split("\n")[: rows + 1]
    for row, text in (damage or {}).items():
        lines[row + 1] = text(lines[row + 1].split(","))
    path.write_text("\n".join(lines) + "\n")
    long_text.write_map(tmp_path / "log.yaml")
    return path, read_map(tmp_path / "log.yaml")


def spiked(fields):
    return ",".join([fields[0], "9999.0", *fields[2:]])


def test_a_file_that_is_inspected_in_parts_gives_the_run_that_it_gives_in_one(tmp_path, small_parts, monkeypatch):
    rows = [3_000, 6_999, 7_000, 7_001, 13_990, 25_000]
    path, rules = made(tmp_path, damage=dict.fromkeys(rows, spiked))
    parts = prepare(path, rules)
    (run,) = import_files([path], tmp_path / "log.yaml", tmp_path / "parts")
    monkeypatch.setattr(long, "PART", 10**9)
    whole = prepare(path, rules)
    assert len(parts.t) < len(whole.t) == len(parts.table) == 40_000
    assert np.flatnonzero(parts.flags).tolist() == np.flatnonzero(whole.flags).tolist() == rows
    (found,) = [f for f in parts.findings if f.index == 3_000]
    assert (found.channel, found.count) == ("pressure", len(rows))
    assert "row 3001" in found.text
    assert parts.table.line(found.index) == 3_002
    assert len(parts.parts) == len(whole.parts) == 2
    for a, b in zip(parts.parts, whole.parts, strict=True):
        assert (a.begin, a.end) == pytest.approx((b.begin, b.end), abs=0.05)
    (again,) = import_files([path], tmp_path / "log.yaml", tmp_path / "whole")
    for name in ("pressure", "force", "supply"):
        one, two = (np.concatenate([trial.channels[name] for trial in open_run(r.path).trials]) for r in (run, again))
        assert abs(len(one) - len(two)) < 100
    assert run.flagged == again.flagged


def test_the_steps_of_a_command_are_found_at_their_very_row_in_a_long_file(tmp_path, small_parts, monkeypatch):
    path = tmp_path / "steps.csv"
    levels = np.repeat([100, 300, 200, 400, 100], 5_001)
    k = np.arange(len(levels))
    rows = [f"{0.002 * i:.3f},{level},{level},{0.1 * level:.3f}" for i, level in zip(k, levels, strict=True)]
    path.write_text("t,c,p,x\n" + "\n".join(rows) + "\n")
    (tmp_path / "map.yaml").write_text(
        "schema: pmabench.map/1\nname: x\nsource: x\nkind: recorded-step\nfile: {delimiter: comma, header: first line}\n"
        "columns:\n  t: {is: time, unit: s}\n  c: {is: pressure_command, unit: kPa}\n  p: {is: pressure, unit: kPa}\n"
        "  x: {is: displacement, unit: mm}\n"
        "sampling: {rate: [400 Hz, 600 Hz], gap: 10 ms}\ntrials: {by: step, smallest: 50 kPa, lead: 100 ms}\n"
        "specimen: {type: X}\n"
    )
    found = prepare(path, read_map(tmp_path / "map.yaml"))
    assert len(found.t) < len(found.table)
    commands = [command for part in found.parts for command in part.commands]
    assert [command["t"] for command in commands] == pytest.approx([0.002 * 5_001 * n for n in (1, 2, 3, 4)])
    assert [command["within"] for command in commands] == pytest.approx([0.002] * 4)


def test_columns_come_back_from_disk_as_they_were_put(monkeypatch):
    rng = np.random.default_rng(3)
    pieces = [{"a": rng.standard_normal(n), "b": rng.standard_normal(n)} for n in (5, 900, 0, 77)]
    for kept in (10**9, 1000):
        monkeypatch.setattr(table, "KEPT", kept)
        columns = table.Columns()
        for piece in pieces:
            columns.append(piece)
        assert {file._rolled for file in columns._files.values()} == {kept == 1000}
        assert (columns.rows, list(columns)) == (982, ["a", "b"])
        for name in ("a", "b"):
            expected = np.concatenate([piece[name] for piece in pieces])
            assert np.array_equal(columns[name], expected)
            assert np.array_equal(columns.part(400, 950)[name], expected[400:950])


@pytest.mark.parametrize("piece", [7, 64, 1000, 4_000_000])
def test_pieces_of_any_size_give_the_same_rows(tmp_path, monkeypatch, piece):
    monkeypatch.setattr("pmabench.store.importers.table.PIECE", piece)
    rows = "".join(f"{k},5;{k};{2 * k}\r\n" for k in range(99))
    text = "t;p;f\r\n\r\n# é: a pause\r\n" + rows
    path = tmp_path / "old.csv"
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    (tmp_path / "map.yaml").write_text(
        "schema: pmabench.map/1\nname: x\nsource: x\nkind: isometric\n"
        'file: {delimiter: semicolon, header: first line, decimal: comma, blank_lines: skip, comment: "#"}\n'
        "columns:\n  t: {is: time, unit: s}\n  p: {is: pressure, unit: kPa}\n  f: {is: force, unit: N}\n"
        "sampling: {rate: [0.1 Hz, 10 Hz], gap: 10 s}\ntrials: {by: file}\nspecimen: {type: X}\n"
    )
    rules = read_map(tmp_path / "map.yaml")
    table = read_table(path, rules.file.file, ["t", "p", "f"])
    assert table.columns["t"].tolist() == [k + 0.5 for k in range(99)]
    assert [table.line(0), table.line(98)] == [4, 102]
    path.write_bytes(text.replace("50;100", "50;1OO").encode())
    with pytest.raises(InvalidFile) as caught:
        read_table(path, rules.file.file, ["t", "p", "f"])
    assert [problem.line for problem in caught.value.problems] == [54]


def imported(path, out):
    command = [sys.executable, "-m", "tests.store.long_text", str(path), str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.study
def test_the_memory_of_an_import_does_not_grow_with_the_file(tmp_path):
    """Where the numbers alone are 88 MB more, the memory is not."""
    reported = []
    for size in (60e6, 160e6):
        path = tmp_path / f"{size:.0f}.csv"
        rows = long_text.write(path, size)
        long_text.write_map(path.with_suffix(".yaml"))
        reported.append(imported(path, tmp_path / "out"))
        assert reported[-1]["rows"] == rows
        assert reported[-1]["trials"] == rows // long_text.PER_CYCLE
    print(reported)
    assert max(each["memory"] + each["of_child"] for each in reported) < 1.3 * MEMORY
    assert max(each["memory"] for each in reported) < MEMORY
    assert reported[1]["memory"] - reported[0]["memory"] < 60e6
