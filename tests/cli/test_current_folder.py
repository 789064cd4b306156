"""`python -m pmabench` imports nothing that lies in the current folder; a driver of one's own is installed or named."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
IMPORTED = "import pathlib\npathlib.Path(__file__).with_suffix('.imported').touch()\n"
DRIVER = "from pmabench_drivers.mock import MockBench as Mine\n"


@pytest.fixture
def lab(tmp_path):
    """A folder as it may come from anywhere: a bench that names a driver in it, and files named like modules."""
    shutil.copytree(ROOT / "fixtures" / "benches", tmp_path / "benches")
    bench = (tmp_path / "benches" / "mock.yaml").read_text()
    assert "driver: mock" in bench
    (tmp_path / "benches" / "mine.yaml").write_text(bench.replace("driver: mock", 'driver: "planted:Mine"'))
    (tmp_path / "planted.py").write_text(IMPORTED + DRIVER)
    for name in ("click", "json", "numpy", "pmabench_drivers"):
        (tmp_path / f"{name}.py").write_text(IMPORTED)
    return tmp_path


def check(lab, *how, **environment):
    bench = ["--bench", "benches/mine.yaml", "--specimen", "mas-20-250-paper0"]
    return subprocess.run(
        [*how, "check", "contraction-relaxation", *bench],
        cwd=lab,
        env={**os.environ, "PYTHONPATH": "", **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


PROGRAMS = {
    "module": [sys.executable, "-m", "pmabench"],
    "safe": [sys.executable, "-P", "-m", "pmabench"],
    "script": [str(Path(sys.executable).with_name("pmabench"))],
}


@pytest.mark.parametrize("how", PROGRAMS)
def test_nothing_in_the_current_folder_is_imported(lab, how):
    done = check(lab, *PROGRAMS[how])
    assert list(lab.rglob("*.imported")) == []
    assert done.returncode == 3, done.stderr
    assert "install its package, or name its folder in PYTHONPATH" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("how", ["module", "script"])
def test_a_driver_is_found_in_a_folder_that_is_named(lab, how):
    (lab / "mine").mkdir()
    (lab / "planted.py").rename(lab / "mine" / "planted.py")
    done = check(lab, *PROGRAMS[how], PYTHONPATH=str(lab / "mine"))
    assert done.returncode == 0, done.stderr
    assert [path.name for path in lab.rglob("*.imported")] == ["planted.imported"]
