"""After a run that did not come to its end, the terminal says what to type; the lines can be typed as they are."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from tests.realtime import eventually, free_port

SHIPPED = Path(__file__).resolve().parents[2] / "fixtures" / "benches"
SPECIMEN = ["--specimen", "mas-20-250-paper0", "--yes"]
SHORT = [
    "--set",
    "prepare.precondition.cycles=0",
    "--set",
    "sweep.repeat.count=1",
    "--set",
    "sweep.matrix.load=[6 kg]",
    "--set",
    "sweep.matrix.pressure=[300 kPa]",
    "--set",
    "trial.contract.hold=2 s",
    "--set",
    "trial.relax.hold=1 s",
    "--set",
    "trial.relax.hold_at_end=1 s",
]


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A bench of one's own in real time, without a session and on a port of its own, and a state folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PMABENCH_STATE", str(tmp_path / "state"))
    bench = f"include: {SHIPPED / 'mock-realtime.yaml'}\n".replace(str(SHIPPED), os.path.relpath(SHIPPED, tmp_path))
    device = f"devices: {{plant: {{address: '127.0.0.1:{free_port()}', options: {{idle: 3}}}}}}\n"
    (tmp_path / "rig.yaml").write_text(f"{bench}schema: pmabench.bench/1\nname: a rig\nsession: null\n{device}")
    return tmp_path


def pmabench(*words, within=60.0):
    return subprocess.run(
        [sys.executable, "-m", "pmabench", *words], capture_output=True, text=True, timeout=within, check=False
    )


@pytest.mark.realtime
def test_after_a_takeover_the_bench_is_tripped_and_the_lines_lead_on(lab):
    """The program is stopped until the guard has taken over; what it says then is typed, and the run is finished."""
    command = [
        sys.executable,
        "-m",
        "pmabench",
        "run",
        "contraction-relaxation",
        "--bench",
        "rig.yaml",
        *SPECIMEN,
        *SHORT,
    ]
    with subprocess.Popen([*command, "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        eventually(lambda: any("trial-begin" in path.read_text() for path in Path("runs").glob("*/events.jsonl")), 60.0)
        run.send_signal(signal.SIGSTOP)
        time.sleep(1.5)
        run.send_signal(signal.SIGCONT)
        _, reported = run.communicate(timeout=60)
    assert run.returncode in {4, 5}, reported
    (folder,) = Path("runs").iterdir()
    assert "the bench is now tripped" in reported
    reset = next(line for line in reported.splitlines() if "--reset" in line).partition("pmabench ")[2]
    resume = next(line for line in reported.splitlines() if "--resume" in line).partition("pmabench ")[2]
    assert reset == "vent rig.yaml --reset --operator NAME --because TEXT"
    assert shlex.split(resume) == ["run", "--resume", str(folder)]
    refused = pmabench(*shlex.split(resume), "--yes", "-q")
    assert refused.returncode == 5
    assert "tripped" in refused.stderr
    assert pmabench(*shlex.split(reset)).returncode == 0
    done = pmabench(*shlex.split(resume), "--yes", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["status"] == "finished"
    assert "--resume" not in done.stderr


@pytest.mark.realtime
def test_continue_resets_the_bench_and_does_the_trials_that_are_left(lab):
    """The engine is killed, so the guard vents and trips the bench; one command leads back, and refuses without a person."""
    command = [
        sys.executable,
        "-m",
        "pmabench",
        "run",
        "contraction-relaxation",
        "--bench",
        "rig.yaml",
        *SPECIMEN,
        *SHORT,
    ]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as run:
        eventually(lambda: any("trial-begin" in path.read_text() for path in Path("runs").glob("*/events.jsonl")), 60.0)
        run.kill()
    eventually(lambda: any("the program ended" in path.read_text() or "safe" in path.read_text()
                           for path in (lab / "state").rglob("*") if path.is_file()), 30.0)  # fmt: skip
    refused = pmabench("continue")
    assert refused.returncode == 5
    assert "its bench is tripped" in refused.stderr
    assert "--reset --operator NAME --because TEXT" in refused.stderr
    done = pmabench("continue", "--operator", "Ann", "--because", "looked at it", "--yes", "--json")
    assert done.returncode == 0, done.stdout
    assert json.loads(done.stdout)["status"] == "finished"
    after = pmabench("continue")
    assert "pmabench process runs/" in after.stdout
    assert after.returncode == 0


def test_continue_says_what_happened_and_asks_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    empty = CliRunner().invoke(main, ["continue"])
    assert (empty.exit_code, "no run in this folder" in empty.stderr) == (3, True)
    monkeypatch.setattr("pmabench.cli.run._somebody", lambda _mounted: True)
    words = ["run", "contraction-relaxation", "--bench", "mock", *SPECIMEN[:2], *SHORT]
    CliRunner().invoke(main, words, input="")
    (folder,) = Path("runs").iterdir()
    reported = CliRunner().invoke(main, ["continue"])
    assert reported.exit_code == 0
    assert reported.stderr.splitlines()[0].startswith(
        f"SIMULATED  ABORTED  contraction-relaxation, runs/{folder.name[-4:]}: "
    )
    assert all(len(line) <= 80 for line in reported.stderr.splitlines()[:3])
    assert "0 of 1 trials are done" in reported.stderr
    assert f"not done; later:  pmabench run --resume {folder}" in reported.stderr
    assert len(list(Path("runs").glob("2*"))) == 1
    again = CliRunner().invoke(main, ["continue", "--yes"])
    assert again.exit_code == 0, again.output
    first = CliRunner().invoke(main, ["continue", str(folder)])
    assert "next    pmabench continue runs/" in first.stdout


def test_an_interrupted_run_names_how_to_go_on(tmp_path, monkeypatch):
    """In virtual time: the operator's terminal ends at the first prompt; no bench is tripped by that."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pmabench.cli.run._somebody", lambda _mounted: True)
    words = ["run", "contraction-relaxation", "--bench", "mock", *SPECIMEN[:2], *SHORT]
    reported = CliRunner().invoke(main, words, input="")
    (folder,) = Path("runs").iterdir()
    assert reported.exit_code == 130
    end = reported.stdout.splitlines()
    assert "SIMULATED  ABORTED  contraction-relaxation: 0 of 1 trial, " in reported.stdout
    assert end[-1] == "next    pmabench continue"
    assert f"record  runs/{folder.name[-4:]} " in end[-2]
    assert all(len(line) <= 80 for line in end[1:])
    assert "tripped" not in reported.output
    again = CliRunner().invoke(main, ["run", "--resume", str(folder), "--yes"])
    assert again.exit_code == 0, again.output
    assert "SIMULATED  FINISHED  contraction-relaxation: 1 of 1 trial, " in again.stdout
    assert "continue" not in again.output
    processed = CliRunner().invoke(main, shlex.split(again.stdout.splitlines()[-1].removeprefix("next    pmabench ")))
    assert "analysis  analyses/" in processed.output


def test_run_with_report_ends_with_results_and_a_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["run", "contraction-relaxation", "--bench", "mock", *SPECIMEN, *SHORT, "--report"]
    done = CliRunner().invoke(main, words)
    end = done.stdout.splitlines()
    (page,) = tmp_path.glob("2*.html")
    assert page.stat().st_size > 20_000
    assert end[-1] == f"report  {page}"
    assert any("K [N/mm]" in line for line in end)
    assert done.exit_code == 6  # one load and one pressure leave K open
    assert "NOT ACCEPTED" in done.stdout
