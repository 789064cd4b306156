"""The seeded bugs still fit the code, and the parts name tests that exist; what they find is found on demand."""

from pathlib import Path

import pytest

from tests.reliability.__main__ import PAGE, _rows, page
from tests.reliability.bugs import BUGS
from tests.reliability.parts import PARTS

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name.replace(" ", "-"))
def test_a_bug_can_be_seeded_where_it_says(bug):
    text = (ROOT / bug.file).read_text("utf-8")
    assert text.count(bug.old) == 1, f"{bug.file}: the text to be changed stands there {text.count(bug.old)} times"
    assert bug.old != bug.new
    if bug.file.endswith(".py"):
        compile(text.replace(bug.old, bug.new), bug.file, "exec")
    for test in bug.tests:
        assert (ROOT / test.partition("::")[0]).exists(), test


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_a_part_names_tests_that_exist(part):
    for test in part.tests:
        name, _, function = test.partition("::")
        assert (ROOT / name).exists(), test
        assert f"def {function.partition('[')[0]}(" in (ROOT / name).read_text("utf-8") if function else True, test


def test_names_of_parts_are_used_once():
    assert len({part.name for part in PARTS}) == len(PARTS)
    assert len({bug.name for bug in BUGS}) == len(BUGS)


def test_the_page_has_a_row_for_every_part_and_says_which_were_not_run():
    text = PAGE.read_text("utf-8")
    assert text == page(_rows()), "docs/reliability.md is written by `make reliability PART=...`"
    shown = [line.split(" | ")[0].removeprefix("| ") for line in text.splitlines() if line.startswith("| ")]
    assert shown[2:] == [part.name for part in PARTS]


def test_a_part_that_was_not_run_is_said_to_be_so():
    done = PARTS[0].name
    lines = page({done: f"| {done} | run |"}).splitlines()
    assert f"| {done} | run |" in lines
    assert sum("| not run yet |" in line for line in lines) == len(PARTS) - 1
