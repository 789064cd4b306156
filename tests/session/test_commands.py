"""`devices`, `monitor`, `calibrate` as they are typed."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.calibrate import _reading
from pmabench.cli.main import main
from tests.engine.benches import ROOT

ARGUMENTS = ["--bench", "mock", "--specimen", "mas-20-250-paper0"]


@pytest.fixture
def call(tmp_path, monkeypatch):
    """Execute a command in the test's folder, without a terminal."""
    monkeypatch.chdir(tmp_path)

    def execute(*arguments, given=None):
        done = CliRunner().invoke(main, arguments, input=given)
        assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
        return done

    return execute


def test_every_driver_says_what_it_can(call, tmp_path):
    done = call("drivers", "list", "--json")
    drivers = {row["name"]: row for row in json.loads(done.stdout)["drivers"]}
    assert not any(row["problem"] for row in drivers.values())
    assert drivers["mock"]["verified"] == "a simulation"
    assert "watchdog" in drivers["mock-realtime"]["can"]
    assert "watchdog" not in drivers["mock"]["can"]
    assert drivers["modbus"]["verified"] == "emulator only"


def test_probe_and_monitor_command_nothing_and_leave_no_run(call, tmp_path):
    probed = json.loads(call("bench", "probe", "mock", "--json").stdout)
    watched = json.loads(call("monitor", "mock", "--json").stdout)
    assert probed["devices"]["plant"]["simulated"] is True
    for row in probed["channels"]:
        assert row["value"] == pytest.approx(watched["channels"][row["channel"]]["value"], abs=500)
    assert watched["channels"]["pressure"]["noise"] == pytest.approx(500, rel=0.3)  # Pa, of the simulated sensor
    assert watched["channels"]["pressure"]["rate"] == pytest.approx(100)
    assert not list(tmp_path.glob("runs"))


@pytest.mark.parametrize(
    ("typed", "read"),
    [(["400 kPa"], 4e5), (["four", "390 kPa"], 3.9e5), (["400 bar", "400 kPa"], 4e5), (["400 bar", "400 bar"], 4e7)],
)
def test_a_reading_in_another_unit_is_asked_again(typed, read):
    """Of points up to 500 kPa; at the end all readings were lost, with advice about loads."""
    left = iter(typed)
    assert _reading(lambda: next(left), "pressure", 4e5, 2.5e5) == read
    assert not list(left)


def test_monitor_prints_lines_where_there_is_no_terminal(call, tmp_path):
    done = call("monitor", "mock", "--seconds", "0.1")
    assert done.exit_code == 0
    assert done.stdout.count("pressure ") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["monitor", "mock", "--jog"], "--specimen"),
        (["monitor", "mock", "--jog", "--specimen", "mas-20-250-paper0"], "needs a terminal"),
        (["bench", "probe", "mock", "--self-test"], "--specimen"),
        (["bench", "probe", "mock", "--self-test", "--specimen", "mas-20-250-paper0"], "declares no self-test"),
        (["calibrate", "force", *ARGUMENTS, "--reference", "w", "--reference-uncertainty", "1 N", "--points", "0, 5"], "unit"),
        (["calibrate", "fource", *ARGUMENTS, "--reference", "w", "--reference-uncertainty", "1 N", "--points", "0 N, 5 N"], "cannot be calibrated"),
    ],
)  # fmt: skip
def test_wrong_use_is_a_sentence(call, tmp_path, arguments, said):
    done = call(*arguments)
    assert done.exit_code == 2
    assert said in done.stderr
    assert not list(tmp_path.glob("runs"))


def test_self_test_table_and_exit_code(call, tmp_path):
    bench = tmp_path / "bad.yaml"
    text = (ROOT / "fixtures" / "benches" / "mock-session.yaml").read_text()
    (tmp_path / "benches").symlink_to(ROOT / "fixtures" / "benches")
    bench.write_text(
        text.replace("include: mock.yaml", "include: benches/mock.yaml") + "devices: {plant: {options: {noise: 20}}}\n"
    )
    good = call(
        "bench",
        "probe",
        "mock-session",
        "--self-test",
        "--specimen",
        "mas-20-250-paper0",
        "--yes",
        "--json",
    )
    assert good.exit_code == 0
    assert {check["verdict"] for check in json.loads(good.stdout)["checks"]} == {"ok", "not measured"}
    bad = call("bench", "probe", "bad.yaml", "--self-test", "--specimen", "mas-20-250-paper0", "--yes")
    assert bad.exit_code == 6
    assert "noise of pressure: look at shield and ground of the wire to plant.pressure" in " ".join(bad.stdout.split())


def test_a_calibration_is_a_new_file_that_a_bench_takes(call, tmp_path):
    arguments = [
        "calibrate",
        "pressure",
        *ARGUMENTS,
        "--reference",
        "gauge 7",
        "--reference-uncertainty",
        "0.2 kPa",
        "--points",
        "0 kPa, 300 kPa, 600 kPa",
    ]
    first, second = (call(*arguments, "--yes", "--json") for _ in range(2))
    assert "650 kPa" in first.stderr
    assert "not between the points" in first.stderr
    files = [Path(json.loads(done.stdout)["file"]) for done in (first, second)]
    assert files[0] != files[1]
    assert all((tmp_path / file).is_file() for file in files)
    (tmp_path / "benches").symlink_to(ROOT / "fixtures" / "benches")
    bench = tmp_path / "mine.yaml"
    bench.write_text(
        "include: benches/mock.yaml\nname: mine\nlimits: {pressure: {command: 450 kPa, trip: 500 kPa, trip_low: null, action: vent}}\n"
        f"channels: {{pressure: {{device: plant, input: pressure, range: [0 count, 65535 count], calibration: {files[1].stem}}}}}\n"
    )
    done = call("bench", "probe", "mine.yaml", "--json")
    assert done.exit_code == 0, done.stderr
    without = call(*arguments, given="")
    assert without.exit_code == 2
    assert "no terminal" in without.stdout + without.stderr
    assert len(list((tmp_path / "calibrations").iterdir())) == 2


def test_process_leaves_guided_runs_out_with_a_note(call, tmp_path):
    call("calibrate", "pressure", *ARGUMENTS, "--reference", "g", "--reference-uncertainty", "1 kPa", "--points", "0 kPa, 300 kPa", "--yes")  # fmt: skip
    (guided,) = tmp_path.glob("runs/*")
    done = call("process", str(guided))
    assert done.exit_code == 3
    assert "is a run of kind calibration and no run with trials" in done.stderr
    call("run", "static-load", *ARGUMENTS, "--yes", "--set", "sweep.repeat.count=1")
    done = call("process", *(str(path) for path in sorted(tmp_path.glob("runs/*"))))
    assert done.exit_code == 0, done.stderr
    assert "is a run of kind calibration, skipped" in done.stderr
