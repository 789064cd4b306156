"""A campaign ends with the worst exit code of its runs, and stops after the first that the next must not follow."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from pmabench.cli import run as run_module
from pmabench.cli.campaign import severity
from pmabench.cli.main import main
from pmabench.store.folder import open_json, sealed_json

LIFTS = "{sweep.matrix.load: [6 kg], sweep.repeat.count: 1, prepare.precondition.cycles: 0}"
NEVER = LIFTS.replace("{", "{trial.search.up_to: 60 kPa, ")
TRIPS = """schema: pmabench.bench/1
include: mock.yaml
name: trips at 10 mm
limits: {contraction: {trip: 4 %}}
"""


def campaign(tmp_path, *runs):
    lines = [f"  - {{protocol: static-load, bench: {bench}, set: {changes}}}" for bench, changes in runs]
    head = "schema: pmabench.campaign/1\nname: c\nspecimen: mas-20-250-paper0\nbenches: {weights: mock}\nruns:\n"
    path = tmp_path / "c.yaml"
    path.write_text(head + "\n".join(lines) + "\n")
    return path


def run(path, out):
    return CliRunner().invoke(main, ["campaign", str(path), "--yes", "--out", str(out), "--json"])


@pytest.mark.parametrize(
    ("codes", "done", "worst"),
    [
        ([0, 0, 0], 3, 0),
        ([0, 6, 0], 3, 6),
        ([6, 0, 4, 0], 3, 4),
        ([0, 5, 0], 2, 5),
        ([6, 130, 0], 2, 130),
        ([6, 143, 0], 2, 143),
        ([7, 0], 1, 7),
        ([1, 0], 1, 1),
    ],
)
def test_it_goes_on_after_a_failed_verdict_only(tmp_path, monkeypatch, codes, done, worst):
    left = iter(codes)

    def execute(*_args, **_kwargs):
        code = next(left)
        return SimpleNamespace(folder=tmp_path, status="x", why="y", exit_code=code, vent=None, bench_seconds=1.0, rows=1,
                               trials_failed=())  # fmt: skip

    monkeypatch.setattr(run_module, "execute", execute)
    result = run(campaign(tmp_path, *[("mock", LIFTS)] * len(codes)), tmp_path / "o")
    assert result.exit_code == worst
    assert [run["exit_code"] for run in json.loads(result.stdout)["runs"]] == codes[:done]


def test_the_worst_is_a_vent_not_confirmed_or_a_trip_then_a_lost_record_then_a_device():
    ranked = sorted([0, 6, 129, 143, 130, 4, 7, 5], key=severity)
    assert ranked[0] == 0
    assert ranked[1] == 6
    assert ranked[-3:] == [4, 7, 5]
    assert severity(99) > severity(5)


def test_on_the_bench_a_failed_search_is_passed_over_and_a_trip_ends_it(tmp_path):
    fixtures = run_module.__file__.rsplit("/pmabench/", 1)[0] + "/fixtures/benches"
    bench = tmp_path / "trips.yaml"
    bench.write_text(TRIPS.replace("mock.yaml", "here.yaml"))
    shutil.copy(f"{fixtures}/mock.yaml", tmp_path / "here.yaml")
    (tmp_path / "calibrations").symlink_to(f"{fixtures}/calibrations")
    high = LIFTS.replace("{", "{trial.search.moved: 20 mm, ")
    path = campaign(tmp_path, ("mock", NEVER), ("mock", LIFTS), ("trips.yaml", high), ("mock", LIFTS))
    result = run(path, tmp_path / "o")
    outcomes = [(run["status"], run["exit_code"]) for run in json.loads(result.stdout)["runs"]]
    assert outcomes == [("failed", 6), ("finished", 0), ("tripped", 5)]
    assert result.exit_code == 5
    assert "the campaign ends here: tripped" in result.stderr


def test_quiet_campaigns_print_folders_and_why_they_ended(tmp_path):
    path = campaign(tmp_path, ("mock", NEVER), ("mock", LIFTS))
    result = CliRunner().invoke(main, ["campaign", str(path), "--yes", "--out", str(tmp_path / "o"), "-q"])
    assert result.exit_code == 6
    assert result.stderr == ""
    assert sorted(result.stdout.splitlines()) == sorted(str(folder) for folder in (tmp_path / "o").glob("2*"))


def test_what_was_done_in_an_earlier_sitting_counts_and_is_processed(tmp_path):
    path, out = campaign(tmp_path, ("mock", LIFTS), ("mock", LIFTS)), tmp_path / "o"
    assert run(path, out).exit_code == 0
    again = CliRunner().invoke(main, ["campaign", str(path), "--yes", "--out", str(out), "--resume"])
    assert "2 of 2 runs came to their end" in again.output
    advised = again.output.partition("pmabench process")[2]
    assert all(folder.name.rpartition("_")[2] in advised for folder in out.glob("2*"))


def test_a_run_of_another_plan_is_not_dropped_without_a_word(tmp_path):
    """A changed campaign file began the test anew, and nothing said that an interrupted run was left."""
    out = tmp_path / "o"
    assert run(campaign(tmp_path, ("mock", LIFTS), ("mock", LIFTS)), out).exit_code == 0
    first, second = sorted(
        out.glob("2*"), key=lambda folder: json.loads((folder / "manifest.json").read_text())["campaign"]["number"]
    )
    seal = second / "seal.json"
    seal.write_bytes(sealed_json({**open_json(seal.read_bytes(), seal), "status": "interrupted"}))
    other = campaign(tmp_path, ("mock", LIFTS), ("mock", LIFTS.replace("6 kg", "11 kg")))
    again = CliRunner().invoke(main, ["campaign", str(other), "--yes", "--out", str(out), "--resume"])
    assert again.exit_code == 0, again.output
    assert f"finished already, in {first.name}" in again.output
    assert f"{second.name} (interrupted) is of another plan" in again.output
    assert "pmabench continue" in again.output


@pytest.mark.parametrize("version", ["now", "older"])
def test_a_bench_that_is_wired_wrongly_ends_it_and_what_is_left_is_done_later(tmp_path, version):
    """Under pressure the displacement falls: the next run would be pressurised on the same bench."""
    fixtures = Path(run_module.__file__).parents[2] / "fixtures" / "benches"
    text = (fixtures / "mock.yaml").read_text().replace("seed: 1}", "seed: 1, errors: {displacement: {factor: -1}}}")
    (tmp_path / "wrong.yaml").write_text(text)
    (tmp_path / "calibrations").symlink_to(fixtures / "calibrations")
    path = campaign(tmp_path, *[("wrong.yaml", LIFTS)] * 3)
    result = run(path, tmp_path / "o")
    (only,) = json.loads(result.stdout)["runs"]
    assert (only["status"], only["exit_code"], result.exit_code) == ("error", 4, 4)
    assert "the displacement falls" in only["why"]
    if version == "older":  # it took the falling displacement for a verdict
        seal = Path(only["run"]) / "seal.json"
        seal.write_bytes(sealed_json({**open_json(seal.read_bytes(), seal), "status": "failed"}))
    went_on = CliRunner().invoke(main, ["continue", str(only["run"]), "--json"])
    assert f"pmabench run --resume {only['run']}" in went_on.stderr
    assert "0 of 1 trials are done" in went_on.stderr
    assert "process" not in went_on.output
    again = CliRunner().invoke(
        main, ["campaign", str(path), "--yes", "--out", str(tmp_path / "o"), "--json", "--resume"]
    )
    (tried,) = json.loads(again.stdout)["runs"]
    assert tried["exit_code"] == 4
    assert tried["run"] != only["run"]
