"""The same raw samples and options give the same analysis, byte by byte, whatever the process is like (R4)."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from pmabench.store.analyses.folder import RECORD
from tests.reliability.cases import cases

ROOT = Path(__file__).parents[2]
TESTS = {
    "contraction-relaxation": ["sweep.matrix.load=[6 kg, 16 kg]", "sweep.matrix.pressure=[200 kPa, 300 kPa]"],
    "static-load": ["sweep.repeat.count=1"],
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    parent = tmp_path_factory.mktemp("raw") / "runs"
    for protocol, settings in TESTS.items():
        small = [part for setting in settings for part in ("--set", setting)]
        bench = ["--bench", "mock", "--specimen", "mas-20-250-paper0", "--yes"]
        done = CliRunner().invoke(main, ["run", protocol, *bench, *small, "--out", str(parent)], catch_exceptions=False)
        assert done.exit_code in (0, 6), done.output
    return sorted(parent.glob("2*"))


def analysed(runs, out, seed, threads):
    """All bytes of an analysis that a process of its own made, with another order of hashes and other threads."""
    environment = {**os.environ, "PYTHONHASHSEED": str(seed), "OPENBLAS_NUM_THREADS": threads, "TZ": f"UTC{seed}"}
    command = [sys.executable, "-m", "pmabench", "process", *map(str, runs), "--out", str(out)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 6), done.stderr
    files = (path for path in out.rglob("*") if path.is_file() and path.name != RECORD)  # it has the times of files
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in files}


@pytest.mark.slow
def test_the_same_raw_gives_the_same_bytes(tmp_path, runs, record_property):
    first = analysed(runs, tmp_path / "first", 0, "1")
    assert any(name.endswith("analysis.json") for name in first)
    assert len(first) > 10
    count = cases(1)
    record_property("cases", count)
    for number in range(1, count + 1):
        copies = [Path(shutil.copytree(run, tmp_path / f"copy-{number}" / run.name)) for run in runs]
        again = analysed(copies, tmp_path / f"again-{number}", number, "1")
        assert {name for name in first if again.get(name) != first[name]} == set()
        assert again.keys() == first.keys()
