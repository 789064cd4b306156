"""The arm of paper 2 end to end in virtual time by the command of docs/papers.md, row 32: run, process, report."""

import json
import re
import shlex
from pathlib import Path

import pytest

from tests.calls import call

ROOT = Path(__file__).resolve().parents[2]
TABLE_1 = {0.0: 84.333, 0.1: 84.0, 0.2: 75.5, 0.3: 66.0, 0.4: 57.0, 0.5: 47.0}


def test_the_command_of_the_row_gives_table_1(tmp_path):
    """Within 0.75 deg; fewer samples and pressures than the protocol has, so that it is soon done."""
    (command,) = re.findall(r"`pmabench (run arm-angle [^`]*)`", (ROOT / "docs" / "papers.md").read_text())
    few = ("sample_rate=25 Hz", "trial.hold=2.5 s", "trial.branches=up", "prepare.precondition.cycles=0",
           "trial.pressures=[0.8 bar, 1.2 bar, 1.6 bar, 2.2 bar, 3 bar, 5 bar]")  # fmt: skip
    sets = [part for text in few for part in ("--set", text)]
    call(*shlex.split(command), "--out", tmp_path / "runs", *sets)
    (run,) = (tmp_path / "runs").glob("2*")
    call("process", run)
    (found,) = (tmp_path / "analyses").rglob("analysis.json")
    estimates = json.loads(found.read_text())["estimates"]
    largest = {e["at"]["tip_mass"]: e["value"] * 57.29577951 for e in estimates if e["symbol"] == "alpha_max"}
    assert largest == pytest.approx(TABLE_1, abs=0.75)
    page = tmp_path / "report.html"
    call("report", run, "-o", page)
    text = page.read_text()
    assert "Bending angle of the arm" in text
    assert "largest angles less Table 1 of paper 2" in text


def test_check_refuses_a_load_that_paper_2_does_not_know():
    result = call("check", "arm-angle", "--bench", "mock-arm-ideal", "--specimen", "arm-30",
                  "--set", "sweep.matrix.load=[0.6 kg]", code=3)  # fmt: skip
    assert "holds from 0 to 0.5 kg" in " ".join(result.output.split())
