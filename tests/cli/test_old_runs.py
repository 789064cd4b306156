"""Old files through the command line: imported, flagged, processed; bad ones refused, and nothing left behind."""

import json
import os
from pathlib import Path

import pytest

from tests.calls import call

OLD = Path(__file__).resolve().parents[2] / "fixtures" / "old-runs"


def test_isometric_files_become_runs_and_lines(tmp_path):
    files = sorted((OLD / "isometric").glob("*.csv"))
    made = json.loads(call("import", *files, "--map", OLD / "isometric.yaml", "--out", tmp_path, "--json").stdout)[
        "runs"
    ]
    assert len(made) == len(files)
    data = json.loads(call("process", *[run["run"] for run in made], "--out", tmp_path / "a", "--json").stdout)
    slopes = [e for e in data["analyses"][0]["estimates"] if e["symbol"] == "m" and e["value"] is not None]
    assert slopes
    assert data["analyses"][0]["simulated"] is False
    assert all(e["unit"] == "N/Pa" for e in slopes)


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"", "empty"), (b"\x00\x01\x02" * 400, "text"), (b"1,2\n1,2\n", "column"), (b"1.0,2.0,3.0\n1.0,2", "")],
)
def test_bad_files_are_one_sentence_and_leave_nothing(tmp_path, content, says):
    first = sorted((OLD / "isometric").glob("*.csv"))[0]
    bad = tmp_path / first.name
    bad.write_bytes(content)
    out = tmp_path / "runs"
    text = call("import", bad, "--map", OLD / "isometric.yaml", "--out", out, code=3).output
    assert says in text
    assert first.name in text
    assert "Traceback" not in text
    assert not out.exists()


@pytest.mark.parametrize("name", ["10mm_13cm_Unkinked_Test1.csv", "notes.txt"])
@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda path: None, "there is no such file"),
        (lambda path: path.mkdir(), "is a folder; give the files in it"),
        (lambda path: path.touch(), "is empty"),
        (lambda path: os.mkfifo(path), "is not a file"),
    ],
)
def test_what_is_no_file_of_data_is_reported_whatever_its_name(tmp_path, name, make, says):
    make(tmp_path / name)
    text = call("import", tmp_path / name, "--map", OLD / "isometric.yaml", "--out", tmp_path / "o", code=3).output
    assert f"{tmp_path / name}  {says}" in text
    assert len(text.splitlines()) == 1


def test_a_name_that_fits_no_form_is_still_reported(tmp_path):
    first = sorted((OLD / "isometric").glob("*.csv"))[0]
    other = tmp_path / "other.csv"
    other.write_bytes(first.read_bytes())
    text = call("import", other, "--map", OLD / "isometric.yaml", "--out", tmp_path / "o", code=3).output
    assert '"other", fits none of the forms in the map' in text


def test_quiet_import_prints_the_folders_and_nothing_else(tmp_path):
    first = sorted((OLD / "isometric").glob("*.csv"))[0]
    out = call("import", first, "--map", OLD / "isometric.yaml", "--out", tmp_path, "-q").output
    assert [Path(line).parent for line in out.splitlines()] == [tmp_path]
