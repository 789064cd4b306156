"""`run --quiet` prints its result, the folder, and where it did not finish why; nothing else."""

import shutil
from pathlib import Path

from tests.cli.test_cli import call

SMALL = ["--set", "sweep.matrix.load=[6 kg]", "--set", "sweep.matrix.pressure=[300 kPa]"]
BENCH = ["--bench", "mock-session", "--specimen", "mas-20-250-paper0", "--yes", "--quiet"]


def test_a_run_that_finishes_prints_its_folder_alone(tmp_path):
    done = call("run", "contraction-relaxation", *BENCH, *SMALL, "--out", tmp_path / "runs")
    assert done.stderr == ""
    (line,) = done.stdout.splitlines()
    assert (Path(line) / "seal.json").is_file()


def test_a_run_that_does_not_finish_says_why(tmp_path):
    files = shutil.copytree(Path(__file__).parents[2] / "fixtures", tmp_path / "fixtures")
    bench = files / "benches" / "low.yaml"
    bench.write_text("include: mock.yaml\nname: low\nlimits: {contraction: {trip: 5 %, action: vent}}\n")
    reported = ["--bench", bench, *BENCH[2:]]
    done = call("run", "contraction-relaxation", *reported, *SMALL, "--out", tmp_path / "runs", code=5)
    (line,) = done.stderr.splitlines()
    assert line.startswith("tripped: displacement ")
    assert line.endswith("; vent confirmed")
    assert len(done.stdout.splitlines()) == 1
