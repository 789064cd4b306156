"""Every page that lists commands does what it says: each is executed in the order written, where no hand is needed."""

import re
import shutil

import pytest

from tests.pages import ROOT, Command, commands, execute, pages, write_files

ELSEWHERE = {"docs/plants.md": "tests/test_plants_page.py, which also looks at the numbers"}
"""Pages that another test executes by the same runner."""


def name(page):
    return str(page.relative_to(ROOT))


TO_RUN = [page for page in pages() if any(not c.by_hand for c in commands(page)) and name(page) not in ELSEWHERE]


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The runs of `campaign demo` and their analyses, made once."""
    folder = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("PMABENCH_STATE", str(folder / "state"))
        execute(Command("the demo", "pmabench campaign demo --yes -q", "", {}))
        execute(Command("the demo", "pmabench process runs/* -q", "", {}))
    return folder


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", TO_RUN, ids=name)
def test_a_page_can_be_typed_from_top_to_bottom(page, tmp_path, monkeypatch, request):
    write_files(page, tmp_path)
    if any(command.after_demo for command in commands(page)):
        shutil.copytree(request.getfixturevalue("demo"), tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PMABENCH_STATE", str(tmp_path / "state"))
    for command in commands(page):
        if not command.by_hand:
            execute(command)


def test_the_models_of_the_papers_can_be_typed(tmp_path, monkeypatch):
    """The rows under "Models", and the settings by K_u and T_u: commands within the table."""
    page = ROOT / "docs" / "papers.md"
    write_files(page, tmp_path)
    monkeypatch.chdir(tmp_path)
    done = 0
    for number, row in enumerate(page.read_text("utf-8").splitlines(), 1):
        told = row.split(" | ")[3] if row.count(" | ") == 4 else ""
        for line in re.findall(r"`(pmabench (?:model|cascade|tune --ku) [^`]*)`", told):
            if "--pace" not in line:  # 25 s by the clock; tests/cli/test_cascade.py looks at paces
                execute(Command(f"docs/papers.md:{number}", line, "", {}))
                done += 1
    assert done >= 15, "the rows are still there"


def test_a_command_that_fails_is_found(tmp_path, monkeypatch):
    """The runner can fail: a wrong option, and a placeholder that stands for nothing."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssertionError, match="page:1: pmabench model lst"):
        execute(Command("page:1", "pmabench model lst", "", {}))
    with pytest.raises(AssertionError, match="nothing matches"):
        execute(Command("page:1", "pmabench process RUN", "", {"RUN": "runs/*"}))


def test_what_needs_a_hand_says_why():
    for page in pages():
        for command in commands(page):
            assert not command.by_hand or len(command.by_hand.split()) >= 3, command.place
