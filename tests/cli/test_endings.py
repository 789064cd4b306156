"""Endings on a terminal of 80 columns: at most 25 lines, three findings, and a next command that works as printed."""

import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from pmabench.cli.outcome import _end
from pmabench.engine.run import Outcome
from pmabench.guard.safe import UNANSWERED, Vent
from tests.guard.rig import BENCH

OF = ("--specimen", "mas-20-250-paper0")
SHORT = (
    "--set",
    "sweep.repeat.count=1",
    "--set",
    "sweep.matrix.load=[6 kg]",
    "--set",
    "sweep.matrix.pressure=[300 kPa]",
)
BENCHES = Path(__file__).resolve().parents[2] / "fixtures" / "benches"


def call(*words, code=0, **options):
    done = CliRunner().invoke(main, [str(word) for word in words], **options)
    assert done.exit_code == code, done.output
    return done.stdout


def next_of(out):
    """The words of the command after `next`, which may go on over lines that end in a backslash."""
    lines = out.rpartition("hands are out: ")[2].splitlines()  # a pipe does not show the Enter after a prompt
    assert len(lines) <= 25
    assert all(len(line) <= 80 for line in lines), max(lines, key=len)
    assert sum(line.startswith("!") for line in lines) <= 3
    command = out[out.rindex("next    ") + 8 :].replace("\\\n", " ")
    words = shlex.split(command)
    assert words[0] == "pmabench"
    return words[1:]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_dry_run_leads_to_the_cheaper_protocol_and_that_to_the_run():
    few = ("--set", "sweep.repeat.count=1", "--set", "sweep.matrix.load=[6 kg, 56 kg]")
    words = next_of(call("check", "contraction-relaxation", "--bench", "labjack", *OF, *few, "--simulate"))
    assert words[-3:] == ["--drop-idle", "-o", "moving.yaml"]
    call(*words)
    words = next_of(call("check", "moving.yaml", "--bench", "mock", *OF, "--simulate"))
    assert words[:2] == ["run", "moving.yaml"]
    call(*words, "--yes", "--set", "sweep.repeat.count=1", "--set", "sweep.zip={load: [6 kg], pressure: [300 kPa]}")


def test_a_dry_run_that_trips_says_so():
    tripping = ("--set", "trial.contract.hold=1 s", "--bench", "here.yaml")
    shutil.copytree(BENCHES / "calibrations", "calibrations")
    shutil.copy(BENCHES / "mock.yaml", "mock.yaml")
    Path("here.yaml").write_text(
        "include: mock.yaml\nschema: pmabench.bench/1\nname: a\nlimits: {contraction: {trip: 4 %}}\n"
    )
    out = call("check", "contraction-relaxation", *tripping, *OF, *SHORT[:4], "--simulate", code=5)
    assert out.startswith("SIMULATED  TRIPPED  contraction-relaxation: ")
    assert "next    change the protocol" in out
    end = call("run", "contraction-relaxation", *tripping, *OF, *SHORT[:4], "--yes", code=5)
    assert next_of(end) == ["continue"]


def test_a_record_that_was_deleted_meanwhile_is_not_called_one_to_go_on_with(tmp_path):
    """It was printed with its rows and with a command that continues it."""
    over = Outcome(
        "error", "cannot write it", 7, Vent("confirmed", ()), tmp_path / "runs" / "gone_1a2b", 9.0, 10, (), {}
    )
    text = " ".join(_end(over, replace(BENCH, realtime=False), "step", 1))
    assert "it was moved or deleted during the run; bring it back" in text
    assert "rows" not in text
    assert "continue" not in text


@pytest.mark.parametrize(("left", "says"), [((), ""), ((UNANSWERED,), "; a command may still come: shut the supply")])
def test_a_vent_after_which_a_command_may_come_is_no_plain_vented(left, says):
    """A set-point that was held up for 5.5 s filled the muscle to 400 kPa after "vented"."""
    over = Outcome("error", "no answer", 4, Vent("confirmed", left), None, 9.0, 10, (), {})
    words = " ".join(_end(over, replace(BENCH, realtime=False), "step", 1)).split()
    assert " ".join(words) == f"ERROR step: 0 of 1 trial, 9 s; vented{says} no answer"


def test_a_campaign_names_its_runs_and_processes_them():
    runs = "runs:\n  - {protocol: contraction-relaxation, set: {sweep.matrix.load: [6 kg], sweep.repeat.count: 1}}\n"
    head = "schema: pmabench.campaign/1\nname: c\nspecimen: mas-20-250-paper0\nbenches: {weights: mock}\n"
    Path("c.yaml").write_text(head + runs)
    words = next_of(call("campaign", "c.yaml", "--yes"))
    assert words[:1] == ["process"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code in {0, 6}, done.output
    assert next_of(done.stdout)[0] == "report"


def test_a_campaign_that_is_aborted_goes_on_by_the_command_that_it_prints(monkeypatch):
    monkeypatch.setattr("pmabench.cli.run._somebody", lambda _mounted: True)
    runs = "runs:\n  - {protocol: contraction-relaxation, set: {sweep.matrix.load: [6 kg], sweep.matrix.pressure: [300 kPa], sweep.repeat.count: 1}}\n"
    head = "schema: pmabench.campaign/1\nname: c\nspecimen: mas-20-250-paper0\nbenches: {weights: mock}\n"
    Path("c.yaml").write_text(head + runs)
    words = next_of(call("campaign", "c.yaml", code=130, input=""))
    assert words == ["campaign", "c.yaml", "--out", "runs", "--resume"]
    call(*words, "--yes")
