"""Every page that lists commands does what it says: each is executed in the order written, where no hand is needed."""

import fcntl
import json
import os
import re
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.conftest import commit_number
from tests.pages import BUSY, ROOT, Command, Desk, commands, execute, in_real_time, pages, write_files

ELSEWHERE = {"docs/plants.md": "tests/test_plants_page.py, which also looks at the numbers"}
"""Pages that another test executes by the same runner."""
BY_HAND = {
    "docs/many-runs.md": 1,  # a cluster of one's own; tests/benchmarks/test_cluster.py has one
}
"""How many commands of a page only a person can do; of all others none."""
ALWAYS = ("README.md", "CONTRIBUTING.md", "docs/first-day.md", "docs/old-runs.md")
"""What a newcomer types first; of the other pages each commit takes some, and `make studies` all."""
DEVICE = re.compile("docs/(devices|driver)")
TURNS, TURNS_OF_DEVICES = 4, 6
SHOWN = {
    "CONTRIBUTING.md": (
        "our-device",
        "353.4",
        "Gentle PI",
        "Our logger, by its first bytes",
        "c [mm]",
        "creep at constant pressure and load",
    )
}
"""What the commands of a page must show, on the terminal or in the report."""
NUMBERS = {"docs/straight.md": ("followed/positioning", {"e_rms": 1e-3, "e_max": 1e-3, "OS": 1e-2})}
"""Analysis behind a table of a page whose rows are methods: its columns, and their units [SI]."""
TRIES = 3
KILLED = Command(
    "a run that is killed",
    "pmabench run contraction-relaxation --bench mock-realtime --specimen mas-20-250-paper0",
    {
        "until": "contraction-relaxation.*armed",
        "end": "kill",
        "add": '--yes --set sweep.repeat.count=1 --skip-warm-up --because "a test"',
    },
)


def name(page):
    return str(page.relative_to(ROOT))


def marked(page):
    """A page that waits for processes is tested in real time; some pages are typed at some commits only."""
    waits = any(in_real_time(command) for command in commands(page))
    turn = PAGES.index(page) - commit_number()
    left_out = name(page) not in ALWAYS and turn % (TURNS_OF_DEVICES if DEVICE.match(name(page)) else TURNS)
    marks = [pytest.mark.realtime] * waits + [pytest.mark.study] * bool(left_out)
    return pytest.param(page, id=name(page), marks=marks)


PAGES = [page for page in pages() if any(not c.by_hand for c in commands(page)) and name(page) not in ELSEWHERE]
TO_RUN = [marked(page) for page in PAGES]


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The runs of `campaign demo` and their analyses, made once for all workers; `PMABENCH_DEMO` names a demo's folder."""
    if made := os.environ.get("PMABENCH_DEMO"):
        return Path(made)
    shared = tmp_path_factory.getbasetemp()
    folder = (shared.parent if "PYTEST_XDIST_WORKER" in os.environ else shared) / "demo"
    with locked(folder.with_suffix(".lock")), pytest.MonkeyPatch.context() as patch:
        if not folder.exists():
            folder.mkdir()
            patch.chdir(folder)
            patch.setenv("PMABENCH_STATE", str(folder / "state"))
            execute(Command("the demo", "pmabench campaign demo --yes -q"))
            execute(Command("the demo", "pmabench process runs/* -q"))
    return folder


def test_static_load_in_the_demo_is_right_within_3_per_mille_and_half_a_newton(demo):
    """F_ce = 1.08 N/kPa P - 49 N is the plant's; K x of a load that hangs above its support is taken off."""
    (path,) = demo.glob("analyses/*/static-load/analysis.json")
    mean = [
        e for e in json.loads(path.read_text())["estimates"] if e["method"] == "static-mean" and "pressure" in e["at"]
    ]
    assert len(mean) == 10
    for e in mean:
        true = 1.08e-3 * e["at"]["pressure"] - 49.0
        assert abs(e["value"] - true) < 0.003 * true + 0.5
        assert e["corrected"]
        assert abs(e["value"] - true) < e["parts"]["method"]


@contextmanager
def locked(path):
    """Until others are done with it."""
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@pytest.fixture
def alone():
    """Nobody else emulates a shipped bench on this machine meanwhile: its addresses are those of its file."""
    with locked(Path(tempfile.gettempdir()) / f"pmabench-pages-{os.getuid()}.lock"):
        yield


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", TO_RUN)
def test_a_page_can_be_typed_from_top_to_bottom(page, tmp_path, monkeypatch, request):
    to_type = [command for command in commands(page) if not command.by_hand]
    before = {command.note.get("after") for command in to_type}
    demo = request.getfixturevalue("demo") if "demo" in before else None
    if any(in_real_time(command) for command in to_type):
        request.getfixturevalue("alone")
    for folder in (tmp_path / str(attempt) for attempt in range(TRIES)):
        monkeypatch.setenv("PMABENCH_STATE", str(folder / "state"))
        if demo:
            shutil.copytree(demo, folder, ignore=shutil.ignore_patterns("report.html"))
        else:
            folder.mkdir()
        write_files(page, folder)
        monkeypatch.chdir(folder)
        try:
            printed = type_all([KILLED, *to_type] if "kill" in before else to_type)
            break
        except AssertionError as error:
            if folder.name == str(TRIES - 1) or not any(word in str(error) for word in BUSY):
                raise
            print(f"again, since the machine is busy: {error}")
    if name(page) in SHOWN:
        printed += Path("report.html").read_text("utf-8")
        assert [text for text in SHOWN[name(page)] if text not in printed] == []
    if name(page) in NUMBERS:
        folder, columns = NUMBERS[name(page)]
        assert_table_is_what_came_out(page, Path(folder) / "analysis.json", columns)


def assert_table_is_what_came_out(page, analysis, columns):
    """Each cell `VALUE ± HALF UNIT` of the rows that are named as a method: to half of the last digit."""
    found = {(e["method"], e["symbol"]): e for e in json.loads(analysis.read_text())["estimates"]}
    seen = 0
    for row in page.read_text("utf-8").splitlines():
        method, *cells = row.strip("| ").split(" | ")
        for symbol, cell in zip(columns, cells if (method, "e_rms") in found else (), strict=False):
            e, unit = found[method, symbol], columns[symbol]
            value, half = re.match(r"([\d.]+) ± ([\d.]+) ", cell).groups()
            digit = 0.51 * 10.0 ** -len(value.partition(".")[2])
            assert e["value"] / unit == pytest.approx(float(value), abs=digit), f"{method}: {cell}"
            assert (e["ci95"][1] - e["value"]) / unit == pytest.approx(float(half), abs=digit), f"{method}: {cell}"
            seen += 1
    assert seen == len(columns) * len({method for method, _ in found})


def type_all(to_type):
    with Desk() as desk:
        return "\n".join(desk.execute(command) for command in to_type)


def rows():
    """The rows of docs/papers.md with a command: place, the cell of commands, what came out."""
    for number, row in enumerate((ROOT / "docs" / "papers.md").read_text("utf-8").splitlines(), 1):
        cells = row.strip("| ").split(" | ")
        if len(cells) == 5 and "`pmabench " in cells[3]:
            yield f"docs/papers.md:{number}", cells[3], cells[4]


ROWS = list(rows())
AT_THE_BENCH = [row for row in ROWS if "`pmabench run " in row[1]]
CHOSEN = commit_number() % len(AT_THE_BENCH)
OF_ROWS = {"with": "RUN = runs/2*, ARM = runs/2*arm-of*, SINGLE = runs/2*_contractor-30*"}


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(row, id=row[0], marks=(pytest.mark.slow, *((pytest.mark.study,) if i != CHOSEN else ())))
        for i, row in enumerate(AT_THE_BENCH)
    ],
)
def test_a_test_of_the_papers_can_be_typed(row, tmp_path, monkeypatch):
    """One of them at each commit, all of them in the studies: what is run can be processed and reported."""
    place, cell, _ = row
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fixtures").symlink_to(ROOT / "fixtures")
    done = []
    for text in re.findall(r"`([^`]*)`", cell):
        if text.startswith("pmabench "):
            line = re.sub(r" S( |$)", r" --specimen mas-20-250-paper0\1", text)
        elif text in {"process", "report"} and done:
            line = f"pmabench {text} RUN" + (" -o report.html" if text == "report" else "")
        else:
            continue
        accepted = (0, 6) if "pmabench process" in line else (0,)
        execute(Command(place, line, OF_ROWS), accepted)
        done.append(line)
    assert any(path.name != "state" for path in Path("runs").iterdir())


def test_a_row_names_only_runs_that_it_made():
    """At each commit, of the rows that are not run at this one: each word in capitals is one of `OF_ROWS`."""
    known = set(Command("", "", OF_ROWS).placeholders())
    typed = {(place, word) for place, cell, _ in AT_THE_BENCH for word in re.findall(r"`pmabench [^`]*`", cell)}
    words = {(place, word) for place, line in typed for word in re.findall(r"(?<![-/\w])[A-Z]{2,}(?![-/\w])", line)}
    assert {word for _, word in words} >= {"RUN", "ARM"}
    assert [(place, word) for place, word in sorted(words) if word not in known] == []


def test_the_models_of_the_papers_can_be_typed(tmp_path, monkeypatch):
    """The rows under "Models", and the settings by K_u and T_u: commands within the table."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fixtures").symlink_to(ROOT / "fixtures")
    done = 0
    for place, cell, _ in ROWS:
        for line in re.findall(r"`(pmabench (?:model|cascade|tune --ku) [^`]*)`", cell):
            if "--pace" not in line:  # 25 s by the clock; tests/cli/test_cascade.py looks at paces
                assert "DIFFERS" not in execute(Command(place, line))
                done += 1
    assert done >= 15, "the rows are still there"


@pytest.mark.parametrize("row", [row for row in ROWS if "`pmabench check " in row[1]], ids=lambda row: row[0])
def test_what_the_papers_refuse_is_refused(row, tmp_path, monkeypatch):
    place, cell, came_out = row
    monkeypatch.chdir(tmp_path)
    line = re.search(r"`(pmabench check [^`]*)`", cell)[1]
    code = 3 if "exit 3" in came_out else 0
    execute(Command(place, re.sub(r" S( |$)", r" --specimen mas-20-250-paper0\1", line)), (code,))


def test_a_command_that_fails_is_found(tmp_path, monkeypatch):
    """The runner can fail: a wrong option, and a placeholder that nothing replaces."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssertionError, match="page:1: pmabench model lst"):
        execute(Command("page:1", "pmabench model lst"))
    with pytest.raises(AssertionError, match="nothing matches"):
        execute(Command("page:1", "pmabench process RUN", {"with": "RUN = runs/*"}))


@pytest.mark.realtime
def test_a_program_that_ends_too_early_and_a_wrong_line_are_found(tmp_path, monkeypatch, alone):
    """The runner can fail where programs go on: no such text, and a line that the emulator does not know."""
    monkeypatch.chdir(tmp_path)
    with Desk() as desk, pytest.raises(AssertionError, match="ended, no 'trial 1'"):
        desk.execute(Command("page:1", "pmabench watch runs", {"until": "trial 1"}))
    with Desk() as desk:
        desk.execute(Command("page:1", "pmabench emulate wires"))
        with pytest.raises(AssertionError, match="page:2: lood 6 kg"):
            desk.execute(Command("page:2", "lood 6 kg", {"typed": "emulate"}))


def test_only_what_is_listed_needs_a_hand_and_says_why():
    found = {}
    for page in pages():
        by_hand = [command for command in commands(page) if command.by_hand]
        assert all(len(command.by_hand.split()) >= 3 for command in by_hand), name(page)
        if by_hand:
            found[name(page)] = len(by_hand)
    assert found == BY_HAND
