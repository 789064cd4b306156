"""`pmabench emulate --truth`, and who says that scales are not proven."""

import json
import os
import subprocess
import sys
from contextlib import contextmanager

import pytest
from pmabench_drivers.emulator import Emulator

from pmabench.bench.compile import mount_alone
from pmabench.bench.truth import read_truth
from pmabench.files.shipped import find_file
from tests.drivers.emulated_bench import emulate, own_bench
from tests.drivers.truth.rigs import pressurised


def probed(path, *options):
    command = [sys.executable, "-m", "pmabench", "bench", "probe", str(path), *options]
    wide = {**os.environ, "COLUMNS": "240"}  # no cell of the table is wrapped
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60, env=wide)
    assert done.returncode == 0, done.stderr
    return done.stdout


def believes_kg(tmp_path):
    """A copy of "wires" whose load cell is believed to show kg."""
    path = own_bench(tmp_path, "wires", ("range: [-50 N, 1950 N]", "range: [-400 N, 19000 N]"))
    shipped = (tmp_path / "calibrations").resolve()
    (tmp_path / "calibrations").unlink()
    (tmp_path / "calibrations").mkdir()
    for file in shipped.glob("WIRES-*.yaml"):
        text = file.read_text().replace(
            "[[-50 N, -50 N], [1950 N, 1950 N]]", "[[-50 N, -490.5 N], [1950 N, 19129.5 N]]"
        )
        (tmp_path / "calibrations" / file.name).write_text(text)
    return path


def force(path):
    """What the bench reads as force [N]."""
    rows = {row["channel"]: row for row in json.loads(probed(path, "--json"))["channels"]}
    return rows["force"]["value"]


@contextmanager
def loaded(path, truth=None):
    """The rig under pressure and load; the force that its muscle carries [N]."""
    emulator = Emulator(mount_alone(path).bench.devices, truth=truth, preset="ideal")
    try:
        yield pressurised(emulator)["force"]
    finally:
        emulator.close()


@pytest.mark.realtime
def test_a_truth_file_shows_a_wrong_scale_and_a_bench_that_is_its_own_truth_hides_it_and_says_so(tmp_path):
    path = believes_kg(tmp_path)
    with loaded(path, read_truth(find_file("truth", "wires"))) as true:
        assert force(path) == pytest.approx(9.81 * true, abs=0.2)
    with emulate(path, "--truth", "wires") as (_process, said):
        assert said["truth"].endswith("wires.yaml")
        assert "scales not proven" not in " ".join(probed(path).split())
    own = path.rename(tmp_path / "mine.yaml")
    with loaded(own) as true:
        assert force(own) == pytest.approx(true, abs=0.2)
    with emulate(own) as (_process, said):
        assert said["truth"] is None
        assert "SIMULATED, scales not proven" in " ".join(probed(own).split())
