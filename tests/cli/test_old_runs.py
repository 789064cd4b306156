"""Old files through the command line: imported, flagged, processed; bad ones refused, and nothing left behind."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main

OLD = Path(__file__).resolve().parents[2] / "fixtures" / "old-runs"


def call(*args, code=0):
    result = CliRunner().invoke(main, [str(arg) for arg in args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


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
