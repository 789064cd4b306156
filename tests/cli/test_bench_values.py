"""`bench read` and `bench set` as they are typed: one value with its raw one; an output by hand, vented after."""

import json

import pytest
from click.testing import CliRunner

from pmabench.bench.compile import mount_alone
from pmabench.cli.main import main
from pmabench.files.shipped import find_file
from pmabench.guard.safe import STAYS
from pmabench.store.reader import open_run

SPECIMEN = ["--specimen", "mas-20-250-paper0"]


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def call(*arguments):
    done = CliRunner().invoke(main, ["bench", *arguments])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done


def test_a_value_and_what_the_device_gave_for_it(tmp_path):
    scale = next(c.scale for c in mount_alone(find_file("bench", "mock")).bench.channels if c.name == "pressure")
    newest = json.loads(call("read", "mock", "pressure", "--json").stdout)
    assert newest["raw"] == round(newest["raw"])  # a count of the converter
    assert newest["value"] == pytest.approx(newest["raw"] * scale.slope + scale.offset)
    assert (newest["unit"], newest["samples"], newest["noise"]) == ("Pa", 1, None)
    mean = json.loads(call("read", "mock", "pressure", "--json", "--for", "2 s", "--rate", "500 Hz").stdout)
    assert mean["samples"] == 1000
    assert mean["noise"] == pytest.approx(500, rel=0.1)  # Pa, of the simulated sensor
    assert abs(mean["value"]) < 4 * 500 / 1000**0.5 + 1e3 * scale.slope  # a vented muscle
    assert not list(tmp_path.glob("runs"))


def test_an_output_is_held_for_its_time_recorded_and_vented(tmp_path):
    done = call("set", "mock", "pressure", "50 kPa", *SPECIMEN, "--for", "4 s", "--yes", "--json")
    outcome = json.loads(done.stdout)
    assert (done.exit_code, outcome["status"], outcome["vent"]["result"]) == (0, "finished", "confirmed")
    run = open_run(tmp_path / outcome["run"])
    assert run.kind == "setup"
    commands = [(e.t, e.data["value"]) for e in run.events if e.kind == "command" and e.data["phase"] == "jog"]
    assert [value for _, value in commands] == [50e3]
    assert "confirmed beforehand" in next(e for e in run.events if e.kind == "answer").data["answer"]
    assert next(e for e in run.events if e.kind == "vent").t - commands[0][0] == pytest.approx(4.0 + STAYS, abs=0.25)


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["read", "mock", "pressur"], 2, 'did you mean "pressure"'),
        (["read", "mock", "pressure", "--for", "2"], 2, "--for"),
        (["read", "mock", "pressure", "--rate", "0 Hz"], 2, "above zero"),
        (["set", "mock", "pressure", "50 kPa", *SPECIMEN], 2, "no terminal"),
        (["set", "mock", "pressure", "50", *SPECIMEN, "--yes"], 2, "unit"),
        (["set", "mock", "force", "50 N", *SPECIMEN, "--yes"], 2, "is not there; known here: pressure"),
        (["set", "mock", "dump_valve", "1", *SPECIMEN, "--yes"], 2, "is a valve"),
        (["set", "mock", "pressure", "100.1 kPa", *SPECIMEN, "--yes", "--for", "1 s"], 5, "0 kPa to 100 kPa"),
        (["set", "mock", "pressure", "-1 kPa", *SPECIMEN, "--yes", "--for", "1 s"], 2, "No such option"),
        (["set", "mock", *SPECIMEN, "--yes", "--for", "1 s", "--", "pressure", "-1 kPa"], 5, "0 kPa to 100 kPa"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_a_sentence_and_moves_nothing(tmp_path, arguments, code, said):
    done = call(*arguments)
    assert (done.exit_code, said in done.stderr) == (code, True), done.stderr
    assert not list(tmp_path.glob("runs"))
