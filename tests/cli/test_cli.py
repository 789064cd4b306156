"""The command line as a user meets it: exit codes, one JSON object, sentences, and nothing left behind."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pmabench.cli.main import COMMANDS
from pmabench.store.analyses.folder import RECORD
from tests.calls import call

ROOT = Path(__file__).resolve().parents[2]
SMALL = ["--set", "sweep.matrix.load=[6 kg, 16 kg]", "--set", "sweep.matrix.pressure=[200 kPa, 300 kPa]"]
MOCK = ["--bench", "mock", "--specimen", "mas-20-250-paper0"]


def test_help_lists_every_command_from_the_table():
    text = call("--help").output
    for name, (_, line, _) in COMMANDS.items():
        assert re.search(rf"^  {name}\s", text, re.MULTILINE), name
        assert line.split()[0] in text


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_of_its_own(name):
    assert "Usage:" in call(name, "--help").output


@pytest.mark.parametrize(("name", "instead"), [("x.pdf", "--pdf x.pdf"), ("x.XLSX", "--xlsx x.XLSX"), ("x.csv", "")])
def test_a_page_is_not_written_under_the_name_of_another_format(name, instead, tmp_path, monkeypatch):
    """`report -o x.pdf` wrote HTML that no reader of PDF opens."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    said = " ".join(call("report", "run", "-o", name, code=2).output.split())
    assert "would be a page of HTML: name it x.html" in said
    assert instead in said
    assert not (tmp_path / name).exists()


def test_a_wrong_command_gets_the_nearest():
    assert 'did you mean "check"' in call("chek", code=2).output


def test_check_says_length_rows_and_limits():
    data = json.loads(call("check", "contraction-relaxation", *MOCK, *SMALL, "--json", "--plan").stdout)
    assert data["schema"] == "pmabench.check/1"
    assert data["trials"] == 8
    assert data["commands"]["pressure"]["highest"] == 400e3
    assert data["commands"]["pressure"]["limits"][1] == 600e3
    assert data["plan"]["steps"][0]["step"] == "ask"
    text = call("check", "contraction-relaxation", *MOCK, *SMALL, "--plan").stdout
    assert "nothing was sent to a bench" in text
    assert "600 kPa" in text


def test_check_simulates():
    data = json.loads(call("check", "contraction-relaxation", *MOCK, *SMALL, "--simulate", "--json").stdout)
    assert data["simulated"]["status"] == "finished"
    assert 0.03 < data["simulated"]["measured"]["displacement"]["highest"] < 0.05


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("kind: static-load\nschema: pmabench.protocol/1\n", "is missing"),
        ("", "is empty"),
        ("a: [", "not readable as YAML"),
        (b"\x00\xff\xfe", "not text in UTF-8"),
    ],
)
def test_bad_protocols_exit_3_in_text_and_json(tmp_path, text, says):
    path = tmp_path / "p.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert says in call("check", path, *MOCK, code=3).output
    data = json.loads(call("check", path, *MOCK, "--json", code=3).stdout)
    assert data["schema"] == "pmabench.error/1"
    assert data["exit_code"] == 3
    assert says in data["error"]


def test_problems_of_protocol_bench_and_specimen_come_together(tmp_path):
    for name in ("p", "b", "s"):
        (tmp_path / f"{name}.yaml").write_text("nonsense: 1\n")
    out = call(
        "check", tmp_path / "p.yaml", "--bench", tmp_path / "b.yaml", "--specimen", tmp_path / "s.yaml", code=3
    ).output
    for name in ("p.yaml", "b.yaml", "s.yaml"):
        assert name in out


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("protocols/static-load.yaml", {"bench", "specimen"}),
        ("fixtures/benches/mock.yaml", {"protocol", "specimen"}),
        ("fixtures/specimens/mas-20-250-paper0.yaml", {"bench", "protocol"}),
        ("fixtures/maps/aarl-10mm.yaml", {"bench", "protocol", "specimen"}),
    ],
)
def test_a_file_of_another_kind_is_reported_once_and_nothing_else_of_it(file, said):
    path = ROOT / file
    out = call("check", path, "--bench", path, "--specimen", path, code=3).output
    lines = [line for line in out.splitlines() if " file is expected" in line]
    assert {re.search(r"where a (\w+) file is expected", line)[1] for line in lines} == said
    assert all(re.search(r"\.yaml:\d+:9  is a \w+ file", line) for line in lines)
    assert len(out.splitlines()) == len(said) + 1
    kind = file.split("/")[-2].removesuffix("s")
    own = {"benche": "bench"}.get(kind, kind)
    assert f"is a {own} file (pmabench.{own}/1)" in out


def test_a_file_of_a_later_version_says_which_is_read(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text("schema: pmabench.protocol/7\nkind: x\n")
    out = call("check", path, *MOCK, code=3).output
    assert "version 7 of the protocol file; this pmabench reads version 1" in out
    assert len(out.splitlines()) == 1


def test_an_unknown_name_gets_the_nearest_shipped_one():
    assert 'did you mean "static-load"' in call("check", "static-lod", *MOCK, code=3).output


def test_a_refused_run_leaves_nothing_behind(tmp_path):
    out = tmp_path / "runs"
    call("run", "contraction-relaxation", *MOCK, "--out", out, "--yes", "--set", "sample_rate=500", code=3)
    assert not out.exists()


def test_without_a_terminal_hands_need_yes(tmp_path):
    assert "--yes" in call("run", "contraction-relaxation", *MOCK, *SMALL, "--out", tmp_path, code=2).output


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs")
    data = json.loads(call("run", "contraction-relaxation", *MOCK, *SMALL, "--out", out, "--yes", "--json").stdout)
    assert data["status"] == "finished"
    assert data["vent"]["result"] == "confirmed"
    return Path(data["run"])


def test_a_run_is_listed_shown_and_whole(run_folder):
    rows = json.loads(call("runs", "list", run_folder.parent, "--json").stdout)["runs"]
    assert [row["id"] for row in rows] == [run_folder.name]
    assert "SIMULATED" in run_folder.name
    shown = json.loads(call("runs", "show", run_folder, "--json").stdout)
    assert len(shown["trials"]) == 8
    assert json.loads(call("runs", "verify", run_folder, "--json").stdout)["runs"] == {str(run_folder): []}
    assert "whole" in call("runs", "verify", run_folder).stdout
    assert run_folder.name[:40] in call("runs", "list", run_folder.parent).stdout.replace("\n", "")


def test_process_and_report_never_touch_the_run(run_folder, tmp_path):
    before = {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()}
    data = json.loads(call("process", run_folder, "--out", tmp_path / "a", "--json").stdout)
    assert data["analyses"][0]["simulated"] is True
    symbols = {(e["symbol"], e["method"]) for e in data["analyses"][0]["estimates"]}
    for symbol in ("K", "B_c", "F_ce"):
        assert (symbol, "measured-pressure") in symbols
    report = tmp_path / "r.html"
    call("report", run_folder, "-o", report)
    text = report.read_text()
    assert "SIMULATED" in text
    assert not re.search(r"""(?:src|href)\s*=\s*["']?(?:https?:)?//""", text)
    call("report", tmp_path / "a" / "contraction-relaxation", "-o", tmp_path / "again.html")
    assert {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()} == before


def test_process_and_report_import_no_heavy_library_that_they_do_not_need(run_folder, tmp_path):
    """scipy, pandas and pydantic take longer to import than these runs to process."""
    heavy = ["scipy", "pandas", "pydantic"]
    for command in (["process", "--out", str(tmp_path / "a")], ["report", "-o", str(tmp_path / "r.html")]):
        code = (
            "import sys\nfrom pmabench.cli.main import main\ntry:\n    main()\n"
            f"finally:\n    print([name for name in {heavy} if name in sys.modules], file=sys.stderr)"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, *command, str(run_folder), "-q"], capture_output=True, text=True, check=False
        )
        assert done.returncode in (0, 6), done.stderr
        assert done.stderr.splitlines()[-1] == "[]"


def test_process_twice_gives_the_same_bytes(run_folder, tmp_path):
    for name in ("a", "b"):
        call("process", run_folder, "--out", tmp_path / name, "-q")
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file())
    files.remove(Path(RECORD))  # it has the times of the files
    assert files
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file


@pytest.mark.parametrize("name", ["runs", "lab"])
def test_all_runs_can_be_named_at_once_wherever_analyses_lie(tmp_path, name):
    out = tmp_path / name
    call("run", "sinusoidal-displacement", "--bench", "mock-actuator", "--specimen", "mas-20-250-paper0", "--out", out,
         "--set", "sweep.repeat.count=1", "--set", "sweep.matrix.frequency=[1 Hz, 3 Hz]", "-q")  # fmt: skip
    first = call("process", *sorted(out.glob("*")), "-q").stdout
    again = call("process", *sorted(out.glob("*"), reverse=True))
    place = tmp_path if name == "runs" else out
    (folder,) = (place / "analyses").glob("*/sinusoidal-displacement")
    assert first.splitlines() == [str(folder)]
    assert ("analyses: holds analyses, skipped" in again.stderr) == (name == "lab")
    assert f"{folder}: holds analyses, skipped" in call("process", folder, *out.glob("2*")).stderr
    assert "give run folders" in call("process", place / "analyses", code=3).output
    report = call("report", *sorted(out.glob("*")), "-o", tmp_path / "r.html")
    assert ("holds analyses, skipped" in report.stderr) == (name == "lab")


def test_process_of_what_is_no_run_exits_3(tmp_path):
    (tmp_path / "x").mkdir()
    out = call("process", tmp_path / "x", tmp_path / "absent", code=3).output
    assert "2 problems" in out
    assert not (tmp_path / "analyses").exists()


def test_tune_never_prints_the_papers_misprints():
    data = json.loads(call("tune", "--ku", "7.1", "--tu", "9 s", "--rule", "Ziegler-Nichols", "--json").stdout)
    by_form = {row["form"]: row["gains"] for row in data["settings"]}
    assert by_form["PI"]["K_p"]["value"] == pytest.approx(3.195)
    assert by_form["PI"]["T_i"]["value"] == pytest.approx(7.5)
    assert by_form["PI"]["K_i"]["value"] == pytest.approx(0.426)
    assert by_form["PID"]["T_d"]["value"] == pytest.approx(1.125)
    text = call("tune", "--ku", "7.1", "--tu", "9 s").output
    assert "2.195" not in text
    assert "without a unit" in text


@pytest.mark.parametrize("columns", ["40", "60", "80"])
def test_no_number_is_cut_in_a_narrow_terminal(run_folder, tmp_path, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", columns)
    tune = ["tune", "--ku", "7.1 bar/cm", "--tu", "9 s"]
    shown = call(*tune).output
    for value in ("35.5 kPa/mm", "31.95 kPa/mm", "4.26 kPa/(mm·s)", "47.92 kPa·s/mm", "1.125 s"):
        assert value in shown
    narrow = call("process", run_folder, "--out", tmp_path / "a").output
    monkeypatch.setenv("COLUMNS", "300")
    wide = call("process", run_folder, "--out", tmp_path / "b").output
    numbers = re.findall(r"[\d.]+ ± [\d.]+", wide)
    assert len(numbers) > 5
    assert sorted(re.findall(r"[\d.]+ ± [\d.]+", narrow)) == sorted(numbers)
    monkeypatch.setenv("COLUMNS", columns)
    assert "600 kPa" in call("check", "contraction-relaxation", *MOCK).output
    assert "8/8" in call("runs", "list", run_folder.parent).output


def test_tune_says_what_cannot_be():
    out = call(
        "tune", "--ku", "7.1 bar/cm", "--tu", "9 s", "--dead-time", "40 ms", "--lag", "0.22 s", "--lag", "0.25 s"
    ).output
    assert "impossible for a linear loop" in out


def test_tune_refuses_what_is_no_gain():
    assert "no unit of gain" in call("tune", "--ku", "7 kPa", "--tu", "9 s", code=2).output
    assert "give --ku and --tu" in call("tune", "--ku", "7 kPa/mm", code=2).output


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["--lag", "-1 s"], "--lag is for --dead-time"),
        (["--dead-time", "40 ms", "--lag", "-1 s"], "a time is not below zero|no time that can be"),
        (["--dead-time", "nan"], "no time that can be"),
        (["--dead-time", "0 s"], "no ultimate gain"),
        (["--ku", "nan"], "no gain that can be"),
        (["--ku", "-7 bar/cm"], "no gain that can be"),
        (["--tu", "0 s"], "no time that can be"),
        (["--analysis", "x"], "give --ku and --tu"),
    ],
)
def test_tune_refuses_what_cannot_be_in_a_sentence(args, says):
    assert re.search(says, call("tune", "--ku", "7.1 bar/cm", "--tu", "9 s", *args, code=2).output)


def test_schemas_that_cannot_be_written_exit_7(tmp_path):
    (tmp_path / "file").touch()
    assert "no schemas can be written here" in call("schema", "--all", "--out", tmp_path / "file" / "x", code=7).output
    assert "say which" in call("schema", "--all", code=2).output


def test_a_folder_or_device_where_a_file_is_expected(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    for path, says in ((tmp_path, "is a folder"), ("/dev/null", "is no file"), (tmp_path / "fifo", "is no file")):
        assert says in call("check", path, *MOCK, code=3).output
    assert "is a pipe" in call("report", tmp_path, "-o", tmp_path / "fifo", code=2).output
    for out, says, code in (
        (__file__, "is a file", 2),
        (f"{__file__}/a", "no folder", 7),
        ("/dev/null", "no folder", 7),
    ):
        assert says in call("run", "contraction-relaxation", *MOCK, *SMALL, "--yes", "--out", out, code=code).output
    assert "names no bench" in call("check", "static-load", "--bench", "", "--specimen", "x", code=3).output
    assert "File name too long" in call("check", "a" * 5000, *MOCK, code=3).output


def test_quiet_is_results_and_errors_only(tmp_path):
    assert call("check", "contraction-relaxation", *MOCK, *SMALL, "-q").output == ""
    hazards = call(
        "check", "static-load-hands-at-pressure", "--bench", "mock-hands-at-pressure", *MOCK[2:], "-q"
    ).output
    assert hazards.startswith("HAZARD: ")
    assert hazards.count("\n") == 1
    assert "unknown kind" in call("check", "static-load", *MOCK, "--set", "kind=x", "-q", code=3).output
    assert "taken" not in call("tune", "--ku", "7", "--tu", "9", "-q").output
    assert call("schema", "--all", "--out", tmp_path, "-q").output == ""


def test_quiet_run_and_report_print_results_only(run_folder, tmp_path):
    again = call("run", "contraction-relaxation", *MOCK, *SMALL[:2], "--set", "sweep.matrix.pressure=[200 kPa]", "--out",
                 tmp_path, "--yes", "-q")  # fmt: skip
    assert again.stderr == ""
    assert again.stdout.splitlines()[-1] == str(next(tmp_path.glob("2*")))
    report = call("report", run_folder, "-o", tmp_path / "r.html", "-q")
    assert report.output == f"{tmp_path / 'r.html'}\n"
    assert call("runs", "verify", run_folder, "-q").output == ""


def test_schema_prints_json():
    assert json.loads(call("schema", "bench").stdout)["title"] == "BenchFile"
