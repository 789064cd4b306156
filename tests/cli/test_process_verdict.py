"""`process` ends with 6 and a sentence where nothing came out, with and without an `accept` in the protocol."""

import json
import shlex
from pathlib import Path

from tests.calls import call

OLD = Path(__file__).resolve().parents[2] / "fixtures" / "old-runs"


def test_a_file_of_which_nothing_enters_a_fit_exits_6(tmp_path):
    name = "10mm_13cm_Kinked4mm_Test10.csv"
    files = [OLD / "isometric" / "rewritten" / name, OLD / "isometric" / name]
    reported = call("import", *files, "--map", OLD / "isometric.yaml", "--out", tmp_path, "--json").stdout
    rewritten, good = (entry["run"] for entry in json.loads(reported)["runs"])
    result = call("process", rewritten, "--out", tmp_path / "a", "-v", code=6)
    (line,) = [line for line in result.output.splitlines() if line.startswith("NOT ACCEPTED")]
    assert "isometric: nothing came out" in line
    assert "no whole counts" in line
    verdict, last = result.output.splitlines()[-2:]
    assert last == line
    assert verdict.startswith("No result: no coefficient came out; 1 reason")
    assert (tmp_path / "a" / "isometric" / "analysis.json").exists()
    brief = call("process", rewritten, "--out", tmp_path / "a", code=6).output.splitlines()
    assert brief[1].startswith("NO RESULT")
    assert any(reported.startswith("!  not accepted: isometric: nothing came out") for reported in brief)
    reported = call("process", good, "--out", tmp_path / "b").output.splitlines()
    assert reported[1].startswith(("NO DOUBT", "USABLE WITH CARE"))
    (start,) = [n for n, line in enumerate(reported) if line.startswith("next ")]  # a long command takes several lines
    command = (
        " ".join(reported[start:])
        .replace(" \\ ", " ")
        .partition("pmabench ")[2]
        .replace("report.html", str(tmp_path / "report.html"))
    )
    call(*shlex.split(command))
    assert (tmp_path / "report.html").stat().st_size > 10_000
