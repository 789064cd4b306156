"""Long files: read in pieces of any size, in memory as their rows need it, and refused beyond the largest number."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.store.importers.table import read_table
from tests.importing import import_files, read_map
from tests.store import long_text

ROOT = Path(__file__).resolve().parents[2]


def memory(rows):
    """Most that an import of six columns may take [bytes]."""
    return 200e6 + 300.0 * rows


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
def test_the_memory_of_an_import_is_that_of_its_rows(tmp_path):
    path = tmp_path / "log.csv"
    rows = long_text.write(path, 160e6)
    long_text.write_map(path.with_suffix(".yaml"))
    found = imported(path, tmp_path / "out")
    print(found)
    assert found["rows"] == rows
    assert found["trials"] == rows // long_text.PER_CYCLE
    assert found["memory"] < memory(rows)
    assert found["of_child"] < memory(0)


def test_more_rows_than_the_largest_number_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("pmabench.store.importers.table.MOST_ROWS", 90_000)
    long_text.write(tmp_path / "log.csv", 1e3)
    long_text.write_map(tmp_path / "log.yaml")
    with pytest.raises(InvalidFile, match="has more than 90,000 rows: part it, or keep every other row or fewer"):
        import_files([tmp_path / "log.csv"], tmp_path / "log.yaml", tmp_path / "runs")
