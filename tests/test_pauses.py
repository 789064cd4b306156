"""A test in real time is run again where the machine paused while it failed, and only there."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.realtime
ROOT = Path(__file__).parents[1]
TEST = '''
import os, signal, time
import pytest
from tests.pauses import _KEPT

runs = []

def pause(request, seconds):
    """The process that would be woken is not; so it is on a machine that gives nobody time."""
    watcher = request.config.stash[_KEPT].watcher.pid
    time.sleep(0.3)  # it has begun
    os.kill(watcher, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(watcher, signal.SIGCONT)

@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    return tmp_path_factory.mktemp("shared")

@pytest.mark.realtime
def test_it(request, shared, tmp_path):
    runs.append(tmp_path)
    assert shared.exists() and tmp_path.exists()
    if PAUSED:
        pause(request, PAUSED)
    print("run", len(runs))
    assert len(runs) == GOOD
'''


@pytest.mark.parametrize(
    ("paused", "good", "runs", "passes"),
    [
        pytest.param(0.3, 1, 1, True, id="passes at once"),
        pytest.param(0.3, 3, 3, True, id="fails in two pauses"),
        pytest.param(0.3, 4, 3, False, id="fails each time"),
        pytest.param(0.0, 2, 1, False, id="fails without a pause"),
    ],
)
def test_a_test_is_run_again(tmp_path, paused, good, runs, passes):
    file = tmp_path / "test_it.py"
    file.write_text(TEST.replace("PAUSED", str(paused)).replace("GOOD", str(good)))
    command = [sys.executable, "-m", "pytest", "-p", "tests.pauses", "-n1", "-rA", f"--rootdir={tmp_path}"]
    ran = subprocess.run([*command, "-c/dev/null", file], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (ran.returncode == 0) is passes, ran.stdout
    assert re.findall(r"^run (\d)", ran.stdout, re.MULTILINE) == [str(number + 1) for number in range(runs)]
    noted = re.findall(
        r"^0\.\d\d s in run \d of test_it.py::test_it, which failed at .*: Assert", ran.stdout, re.MULTILINE
    )
    assert len(noted) == runs - 1
