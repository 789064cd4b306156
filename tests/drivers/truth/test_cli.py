"""`pmabench emulate --truth` and `--wrong`, and who says that scales are not proven."""

import json
import os
import subprocess
import sys

import pytest

from pmabench.base.errors import UsageError
from pmabench.cli.emulate import _in_si
from tests.drivers.emulated_bench import emulate, own_bench


@pytest.mark.parametrize(
    ("text", "si"),
    [
        ("offset:displacement=12 mm", 0.012),
        ("offset:force=-50 N", -50.0),
        ("offset:output.pressure=0.6 bar", 60e3),
        ("offset:t7.AIN0=60", 60.0),
    ],
)
def test_an_offset_has_its_unit(text, si):
    assert float(_in_si(text).partition("=")[2]) == pytest.approx(si)
    assert _in_si(text).partition("=")[0] == text.partition("=")[0]


@pytest.mark.parametrize("text", ["scale:force=0.5", "swap:pressure=force", "sign", "offset:force"])
def test_anything_else_stays_as_it_is(text):
    assert _in_si(text) == text


def test_an_offset_in_no_unit_that_is_measured_is_refused():
    with pytest.raises(UsageError, match='as "12 mm", not "3 kg"'):
        _in_si("offset:force=3 kg")


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


@pytest.mark.realtime
def test_a_truth_file_shows_a_wrong_scale_and_a_bench_that_is_its_own_truth_hides_it_and_says_so(tmp_path):
    path = believes_kg(tmp_path)
    pulls = ("--preset", "ideal", "--wrong", "offset:force=100 N")
    with emulate(path, *pulls, "--truth", "wires") as (_process, said):
        assert said["truth"].endswith("wires.yaml")
        assert force(path) == pytest.approx(981.0, abs=0.2)
        assert "scales not proven" not in " ".join(probed(path).split())
    own = path.rename(tmp_path / "mine.yaml")
    with emulate(own, *pulls) as (_process, said):
        assert (said["truth"], said["wrong"]) == (None, ["force: is 100 too high [SI]"])
        assert force(own) == pytest.approx(100.0, abs=0.2)
        assert "SIMULATED, scales not proven" in " ".join(probed(own).split())
