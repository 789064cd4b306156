"""`pmabench watch` as it is typed."""

import json
import os
import subprocess
import sys
import time

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from tests.display.recorded import Recorded

POINTS = [(58.86, 3e5), (107.91, 3e5)]


def pmabench(*args):
    return CliRunner().invoke(main, ["watch", *map(str, args)])


@pytest.fixture
def ended(tmp_path):
    run = Recorded(tmp_path / "runs", POINTS, name="first")
    run.load()
    run.trial(0)
    run.trial(1, factor=1.3)
    return run.close()


def test_a_run_that_has_ended_is_reported_in_plain_lines(ended):
    reported = pmabench(ended)
    assert reported.exit_code == 0
    lines = reported.output.splitlines()
    assert lines[0] == "SIMULATED contraction-relaxation, MAS-20 TEST-1: first"
    assert lines[1] == "0:00 armed: rig"
    trials = [line for line in lines if line.startswith("trial ")]
    assert trials[0].startswith(
        "trial 1 of 2 (load 58.86 N, pressure 300 kPa): x_inf 31.59 mm (expected 31.59), tau 0.2500 s"
    )
    assert trials[0].endswith("; ok")
    assert trials[1].endswith("; DOUBT: x_inf 30% above expected (24.6 mm)")
    assert lines[-1] == "finished; 2 of 2 trials, 1 in doubt; 5,200 rows; vent confirmed"
    assert "\x1b" not in reported.output


def test_json_is_one_object(ended):
    reported = json.loads(pmabench(ended, "--json").output)
    assert (reported["schema"], reported["status"], reported["rows"]) == ("pmabench.watch/1", "finished", 5200)
    assert [trial["doubts"] for trial in reported["trials"]] == [[], ["x_inf 30% above expected (24.6 mm)"]]
    assert reported["trials"][0]["numbers"][1]["value"] == pytest.approx(0.25, rel=1e-3)


def test_quiet_shows_how_it_ended_only(ended):
    reported = pmabench(ended, "-q").output
    assert reported == "finished; 2 of 2 trials, 1 in doubt; 5,200 rows; vent confirmed\n"


def test_of_a_folder_the_newest_run_is_meant(ended, tmp_path):
    run = Recorded(tmp_path / "runs", POINTS, name="second")
    run.trial(0)
    run.close()
    os.utime(ended / "manifest.json", (1.0, 1.0))
    assert "TEST-1: second" in pmabench(tmp_path / "runs").output


@pytest.mark.parametrize(("name", "why"), [("nowhere", "there is no such run"), ("empty", "holds no run")])
def test_what_is_no_run_is_said(tmp_path, name, why):
    (tmp_path / "empty").mkdir()
    reported = pmabench(tmp_path / name)
    assert reported.exit_code == 3
    assert why in reported.output
    assert "--wait" in reported.output


def test_it_waits_follows_and_ends_by_itself(tmp_path):
    """In a process of its own, while the run is written here."""
    command = [sys.executable, "-m", "pmabench", "watch", str(tmp_path / "runs"), "--wait"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as watching:
        assert watching.stderr.readline().startswith("no run in")
        run = Recorded(tmp_path / "runs", POINTS)
        first = watching.stdout.readline()
        assert first.startswith("SIMULATED contraction-relaxation")
        run.trial(0)
        while not watching.stdout.readline().startswith("trial 1 of 2"):
            pass
        assert watching.poll() is None
        run.trial(1)
        run.close("aborted", "ended by Ctrl-C")
        lines = watching.stdout.read().splitlines()
        assert watching.wait(60) == 0
    assert any(line.startswith("trial 2 of 2") for line in lines)
    assert lines[-1] == "aborted: ended by Ctrl-C; 2 of 2 trials; 5,200 rows; vent confirmed"


def test_a_reader_that_leaves_ends_it_quietly(tmp_path):
    run = Recorded(tmp_path / "runs", POINTS)
    command = [sys.executable, "-m", "pmabench", "watch", str(run.folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as watching:
        watching.stdout.readline()
        watching.stdout.close()
        end = time.monotonic() + 60.0
        while watching.poll() is None and time.monotonic() < end:
            run.writer.event("note", run.t, text="x")
            time.sleep(0.1)
        assert watching.poll() == 0
        assert watching.stderr.read() == ""
    run.close()


def test_a_signal_ends_it_with_its_own_code(tmp_path):
    run = Recorded(tmp_path / "runs", POINTS)
    command = [sys.executable, "-m", "pmabench", "watch", str(run.folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as watching:
        watching.stdout.readline()
        watching.terminate()
        assert watching.wait(60) == 143
        assert watching.stderr.read() == "ended by SIGTERM\n"
    run.close()


def test_of_a_folder_the_test_that_follows_a_session_is_watched_too(tmp_path):
    runs = tmp_path / "runs"
    session = Recorded(runs, POINTS, name="0", kind="session", trials_planned=0)
    command = [sys.executable, "-m", "pmabench", "watch", str(runs)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as watching:
        assert "session" in watching.stdout.readline()
        session.close()
        while not watching.stdout.readline().startswith("finished; 0 of 0"):
            pass
        time.sleep(1.0)  # what a run does between its session and its test
        assert watching.poll() is None
        run = Recorded(runs, POINTS, name="1", trials_planned=2)
        run.trial(0)
        run.trial(1)
        run.close()
        reported = watching.communicate(timeout=60)[0].splitlines()
    heads = [line for line in reported if "TEST-1: " in line]
    ends = [line.partition(" trials")[0] for line in reported if line.startswith("finished; ")]
    assert [line[-1] for line in heads] == ["1"]
    assert ends == ["finished; 2 of 2"]
    assert watching.returncode == 0


def test_one_run_that_is_named_is_watched_alone(tmp_path):
    first = Recorded(tmp_path, POINTS, name="1", kind="session", started_utc="2026-11-23T10:00:00.000+00:00").close()
    Recorded(tmp_path, POINTS, name="2", started_utc="2026-11-23T10:01:00.000+00:00").close()
    assert "TEST-1: 2" not in pmabench(first).output


def test_a_session_that_ended_long_ago_is_not_waited_for(tmp_path):
    session = Recorded(tmp_path, POINTS, name="1", kind="session").close()
    (session / "seal.json").chmod(0o644)
    os.utime(session / "seal.json", (0, 0))
    begin = time.monotonic()
    assert "TEST-1: 1" in pmabench(tmp_path).output
    assert time.monotonic() - begin < 9.0
