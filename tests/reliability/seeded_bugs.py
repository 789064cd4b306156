"""Each seeded bug, in a copy of the tree, makes one of its tests fail; on demand only (`make reliability PART=bugs`)."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.reliability.bugs import BUGS
from tests.reliability.cases import VARIABLE

ROOT = Path(__file__).resolve().parents[2]
PASSED, FAILED = 0, 1


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """The files of the tree, without what was made from them."""
    folder = tmp_path_factory.mktemp("copy") / "tree"
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
    for name in names:
        if name and (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def run(folder, tests):
    """How pytest ends in a tree: 0 passed, 1 failed."""
    environment = {
        **os.environ,
        "PYTHONPATH": f"{folder}{os.pathsep}{folder / 'drivers'}",
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    environment.pop(VARIABLE, None)
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--timeout=300", *tests]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, "\n".join(done.stdout.splitlines()[-15:])


@pytest.fixture(scope="module")
def sound(copy):
    """Tests that pass in the copy as it is: only those can tell a bug."""
    known = {}

    def check(tests):
        if tests not in known:
            known[tests] = run(copy, tests)
        return known[tests]

    return check


@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name.replace(" ", "-"))
def test_a_seeded_bug_is_caught(copy, sound, bug):
    code, said = sound(bug.tests)
    assert code == PASSED, f"without the bug: {said}"
    path = copy / bug.file
    text = path.read_text("utf-8")
    path.write_text(text.replace(bug.old, bug.new), "utf-8")
    try:
        code, said = run(copy, bug.tests)
    finally:
        path.write_text(text, "utf-8")
    assert code == FAILED, f"{bug.name}: not caught by {' '.join(bug.tests)}\n{said}"
