"""Every branch of the guard's code is taken by its tests; see `tests.guard.branches`."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.reliability.cases import VARIABLE

ROOT = Path(__file__).resolve().parents[2]


# its tests wait for threads: a process that runs only when nothing else does would not wake in time
@pytest.mark.realtime
@pytest.mark.singly
@pytest.mark.slow
def test_every_branch_of_the_guard_is_taken(record_property):
    environment = {**os.environ, VARIABLE: "300"}
    command = [sys.executable, "-m", "tests.guard.branches", "--timeout=250"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    reported = re.search(r"(\d+) conditional jumps, (\d+) places left out", done.stdout)
    assert reported, done.stdout[-3000:] + done.stderr[-3000:]
    record_property("cases", int(reported[1]))
    assert int(reported[1]) > 200
    assert done.returncode == 0, "\n".join(
        line for line in done.stdout.splitlines() if re.match(r"\w+\.py:|FAILED", line)
    )
