"""After a power cut every run opens with whole batches, loses at most two seconds, and a closed run is whole (R1)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.reliability.cases import cases
from tests.reliability.mounts import ISOLATED, fast_folder, need_loop_mounts

ROOT = Path(__file__).parents[2]
CUTS = cases(50)


@pytest.mark.slow
@pytest.mark.timeout(60 + 2 * CUTS)
def test_a_power_cut_at_any_instant_loses_at_most_two_seconds(record_property):
    need_loop_mounts()
    with fast_folder() as folder:
        command = [*ISOLATED, sys.executable, "-m", "tests.reliability.power_cuts", str(folder), str(CUTS), "20261121"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    reported = [json.loads(line) for line in done.stdout.splitlines()]
    wrong = [what for entry in reported for what in entry["wrong"]]
    record_property("cases", len(reported))
    record_property("failures", sum(bool(entry["wrong"]) for entry in reported))
    assert len(reported) == CUTS
    assert not wrong, "\n".join(wrong[:10])
