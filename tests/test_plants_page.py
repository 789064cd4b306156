"""A muscle that is not shipped, written with docs/plants.md alone: simulated, tested, its coefficients come back."""

import json
import math
import shlex
from itertools import pairwise
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from pmabench.store.reader import open_run
from tests.pages import FILE, ROOT, Command, commands, execute, write_files

PAGE = ROOT / "docs" / "plants.md"
FILES = dict(FILE.findall(PAGE.read_text("utf-8")))
COMMANDS = [command.line for command in commands(PAGE)]
FORCE = [(60, 0), (100, 30), (200, 101), (300, 170), (400, 235), (500, 295)]
"""The page's muscle, written out here: kPa, N; N/mm; N.s/mm."""


def force(P):
    for (low, start), (high, end) in pairwise(FORCE):
        if low <= P <= high:
            return start + (end - start) * (P - low) / (high - low)
    return 0.0


TRUTH = {
    "F_ce": (1.0, force),
    "K": (1e3, lambda P: 3.1 - 5e-4 * P + 9e-6 * P * P),
    "B_c": (1e3, lambda P: 0.62 + 0.11 * (P - 250) / 150),
    "B_r": (1e3, lambda P: 0.55 if P < 250 else 0.25 + 0.0012 * P),
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    write_files(PAGE, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def call(line, *more):
    return execute(Command("docs/plants.md", shlex.join([*shlex.split(line), *more])))


def command(word):
    return next(line for line in COMMANDS if line.startswith(f"pmabench {word}"))


def estimates():
    found = {}
    for path in Path("analyses").glob("*/*/analysis.json"):
        for e in json.loads(path.read_text())["estimates"]:
            if e["value"] is not None and "pressure" in e["at"] and not e["coordinate"]:
                found[e["symbol"], e["method"], round(e["at"]["pressure"] / 1e3)] = e["value"]
    return found


def assert_within(found, relative, pressures):
    """Each coefficient at each pressure at which it is identifiable; at least so many."""
    for symbol, (unit, truth) in TRUTH.items():
        seen = [P for name, method, P in found if (name, method) == (symbol, "measured-pressure")]
        assert len(seen) >= pressures, f"{symbol}: {seen}"
        for P in seen:
            value = found[symbol, "measured-pressure", P] / unit
            assert value == pytest.approx(truth(P), rel=relative), f"{symbol} at {P} kPa"


def test_the_muscle_is_what_model_simulate_shows(folder):
    columns = {c["name"]: c["values"] for c in json.loads(call(command("model simulate"), "--json"))["columns"]}
    K = TRUTH["K"][1](500)
    assert columns["displacement"][-1] * 1e3 == pytest.approx(295 / K, rel=1e-4)
    dead = 0.03
    tau = TRUTH["B_c"][1](500) / K
    i = next(i for i, t in enumerate(columns["time"]) if t > dead + tau)
    moved = columns["displacement"][i] * 1e3 * K / 295
    assert moved == pytest.approx(1 - math.exp(-(columns["time"][i] - dead) / tau), abs=0.02), "M = 0.5 kg is felt"


def test_check_names_the_plant(folder):
    line = command("check")
    assert "silicone 12-200 (muscle.yaml), simulated" in call(line)
    assert json.loads(call(line, "--json"))["plants"] == {"plant": "silicone 12-200 (muscle.yaml)"}


def test_a_few_trials_bring_its_coefficients_back_and_the_run_keeps_the_file(folder):
    line = command("run contraction-relaxation").replace("1 kg, 3 kg, 6 kg, 10 kg, 15 kg", "1 kg, 10 kg")
    call(line, "--set", "sweep.matrix.pressure=[200 kPa, 350 kPa, 500 kPa]", "-q")
    (run,) = Path("runs").iterdir()
    assert (run / "muscle.yaml").read_text() == FILES["muscle.yaml"]
    (folder / "muscle.yaml").write_text(FILES["muscle.yaml"].replace("stop: 60 mm", "stop: 50 mm"))
    call("pmabench runs verify runs")
    refused = CliRunner().invoke(main, ["run", "--resume", str(run), "--yes"])
    assert refused.exit_code == 3
    assert "the bench is not what it was in this run" in refused.output
    open_run(run)
    call("pmabench process runs/*")
    assert_within(estimates(), 1e-3, 1)


def test_the_muscle_with_hysteresis_and_creep_is_what_its_commands_show(folder):
    """Sine of 10 mm about 17 mm at 300 kPa, by hand: 2 H 0.85 and (B_c + B_r) 2 pi 0.1 Hz 10 mm, less 5 ms of lag."""
    lifted = json.loads(call(command("model simulate real"), "--json"))["columns"]
    assert max(lifted[3]["values"]) * 1e3 == pytest.approx(39.2, abs=0.1)
    driven = next(line for line in COMMANDS if "--drive" in line)
    columns = {c["name"]: c["values"] for c in json.loads(call(driven, "--json"))["columns"]}
    speed = 2 * math.pi * 0.1 * 10
    K = (0.334 * (244.7 - 0.1115 * 300) * math.exp(-0.334 * 17 / 2.5) + 0.083 * 300) / 2.5
    gap = 2 * 20 * 0.85 + (1.6 + 1.15) * speed - K * 2 * 5e-3 * speed
    assert columns["force"][5] - columns["force"][10] == pytest.approx(gap, abs=0.1)


@pytest.mark.slow
def test_the_page_as_it_is_brings_its_coefficients_back(folder):
    for line in COMMANDS:
        call(line)
    found = estimates()
    assert_within(found, 1e-3, 6)
    assert_of_static_load(found)


def assert_of_static_load(found):
    at = [P for symbol, method, P in found if (symbol, method) == ("F_ce", "static-mean")]
    assert len(at) >= 6
    for P in at:
        assert found["F_ce", "static-mean", P] == pytest.approx(force(P), abs=2.5)


@pytest.mark.slow
def test_with_friction_lag_and_noise_it_comes_back_within_the_tolerances_of_the_presets(folder):
    (folder / "bench.yaml").write_text(FILES["bench.yaml"].replace("preset: ideal", "preset: bench"))
    call(command("run contraction-relaxation"))
    call("pmabench process runs/*")
    assert_within(estimates(), 0.02, 6)
