"""A folder of runs: each on its own, one table, nothing computed twice, no bad run stops another."""

import csv
import json
import shutil

import pytest

import pmabench.report.many
from pmabench.report.files.csv_files import csv_text
from pmabench.report.many import process_many, process_one, table_rows
from pmabench.store.analyses import folder as made_from
from pmabench.store.analyses.folder import runs_of
from pmabench.store.catalogue import tasks_below
from pmabench.store.since import fingerprint
from tests.benchmarks.archive import stiffness_and_damping, write_run
from tests.calls import call
from tests.store.runs import closed

RUNS = 3


def files_of(folder):
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in folder.rglob("*")
        if p.is_file() and not p.name.startswith(".")
    }


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """Runs in two folders, and what came out of them in one process."""
    lab = tmp_path_factory.mktemp("lab")
    for number in range(RUNS):
        write_run(lab / "runs" / ("2018" if number % 2 else "2019"), number)
    reported = json.loads(call("process", lab / "runs", "--json").stdout)
    return lab, reported


@pytest.fixture
def lab(archive, tmp_path):
    """A copy that may be harmed; not yet processed."""
    shutil.copytree(archive[0] / "runs", tmp_path / "runs")
    for path in (tmp_path / "runs").rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o644)
    return tmp_path


def test_the_analysis_of_a_run_of_a_folder_is_that_of_the_run_alone(archive, tmp_path):
    lab, _ = archive
    run = sorted((lab / "runs" / "2018").iterdir())[0]
    call("process", run, "--out", tmp_path)
    alone = files_of(tmp_path / "recorded-step")
    assert alone == files_of(lab / "analyses" / "each" / "2018" / run.name / "recorded-step")
    assert {"analysis.json", "coefficients.csv", "estimates.csv", "curves.csv", "dropped.csv", "findings.csv"} <= set(
        alone
    )


def test_each_run_is_its_own_analysis_and_the_table_has_what_is_behind_each(archive):
    lab, reported = archive
    assert (reported["computed"], reported["unchanged"], reported["failed"]) == (RUNS, 0, [])
    with (lab / "analyses" / "each" / "all-runs.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["K [N/mm]"]]
    assert len(rows) == RUNS
    for row in rows:
        number = int(row["run"].split("_")[0][-6:])
        K, B = stiffness_and_damping(number)
        assert float(row["K [N/mm]"]) == pytest.approx(K / 1e3, rel=0.15)  # the record is late by 0 to 30 ms or not
        assert float(row["B [N.s/mm]"]) == pytest.approx(B / 1e3, rel=0.3)
        assert (row["P before [kPa]"], row["P [kPa]"], row["specimen"]) == ("100.0", "300.0", f"MAS-20 A{number:03d}")
        assert (lab / "analyses" / "each" / row["analysis"] / "analysis.json").is_file()
    kept = json.loads((lab / "analyses" / "each" / "all-runs.json").read_text())
    assert kept["runs"] == reported["runs"]


def test_one_run_named_alone_gives_the_same_analysis(archive, tmp_path):
    lab, _ = archive
    run = next((lab / "runs" / "2018").iterdir())
    call("process", run, "--out", tmp_path / "alone")
    (each,) = (lab / "analyses" / "each" / "2018" / run.name).glob("*/")
    assert runs_of(each) == [run]
    alone = (tmp_path / "alone" / "recorded-step" / "analysis.json").read_bytes()
    assert alone == (lab / "analyses" / "each" / "2018" / run.name / "recorded-step" / "analysis.json").read_bytes()


def test_two_processes_give_the_same_bytes_and_one_bad_run_stops_no_other(archive, lab):
    bad = next((lab / "runs" / "2018").iterdir())
    (bad / "manifest.json").write_bytes((bad / "manifest.json").read_bytes()[:-20])
    reported = call("process", lab / "runs", "--jobs", "2", code=3).output
    assert "1 run could not be processed:" in reported
    assert "manifest.json  is damaged or was changed" in reported
    assert str(lab / "analyses" / "each" / "all-runs.csv") in reported
    whole, here = files_of(archive[0] / "analyses" / "each"), files_of(lab / "analyses" / "each")
    analyses = {name: content for name, content in whole.items() if "/" in name and bad.name not in name}
    assert {name: content for name, content in here.items() if "/" in name} == analyses
    assert here["all-runs.csv"].count(b"\n") == whole["all-runs.csv"].count(b"\n") * (RUNS - 1) // RUNS + 1


def counted(monkeypatch):
    """The runs that are really worked on, by folder name."""
    worked = []

    def one(things):
        worked.extend(thing["folder"] for thing in things)
        return [process_one(thing) for thing in things]

    monkeypatch.setattr(pmabench.report.many, "process_batch", one)
    return worked


def test_only_what_changed_is_computed_again(lab, monkeypatch):
    assert "had not changed" not in call("process", lab / "runs").output
    worked = counted(monkeypatch)
    before = files_of(lab / "analyses" / "each")
    reported = call("process", lab / "runs").output
    assert f"{RUNS} had not changed and were not computed again" in reported
    assert worked == []
    assert files_of(lab / "analyses" / "each") == before

    run = sorted((lab / "runs" / "2019").iterdir())[0]
    place = f"2019/{run.name}"
    call("note", run, "it slipped", "--exclude", "1", "--because", "slipped", "--operator", "A")
    reported = json.loads(call("process", lab / "runs", "--json", code=6).stdout)
    assert worked == [place]
    (entry,) = [entry for entry in reported["runs"] if entry["run"] == run.name]
    assert entry["excluded"][0]["because"] == "slipped"
    assert "nothing came out" in entry["verdicts"][0]

    worked.clear()
    (lab / "analyses" / "each" / place / "recorded-step" / "analysis.json").write_text("{}")
    call("process", lab / "runs", code=6)
    assert worked == [place]

    worked.clear()
    monkeypatch.setattr(made_from, "program", lambda: "another version")
    call("process", lab / "runs", code=6)
    assert len(worked) == RUNS

    worked.clear()
    call("process", lab / "runs", code=6)
    assert worked == []
    call("process", lab / "runs", "--fresh", code=6)
    assert len(worked) == RUNS


def test_other_options_are_another_result(lab):
    tasks, out = tasks_below([lab / "runs"]), lab / "out"

    def computed(value):
        return process_many(tasks, out, options={"recorded-step": {"any": value}}).count("computed")

    assert (computed(1.0), computed(1.0), computed(2.0)) == (RUNS, 0, RUNS)


def test_the_table_is_that_of_the_runs_that_are_there(lab):
    call("process", lab / "runs")
    table = [lab / "analyses" / "each" / f"all-runs.{suffix}" for suffix in ("csv", "json")]
    content = [path.read_bytes() for path in table]
    table[0].unlink()
    table[1].write_bytes(b"")
    call("process", lab / "runs")
    assert [path.read_bytes() for path in table] == content
    shutil.rmtree(next((lab / "runs" / "2018").iterdir()))
    call("process", lab / "runs")
    assert table[0].read_bytes() != content[0]


def test_a_stream_that_was_changed_in_place_is_not_taken_for_unchanged(lab):
    call("process", lab / "runs", "-q")
    stream = next((lab / "runs").rglob("*.parquet"))
    raw = bytearray(stream.read_bytes())
    raw[len(raw) // 2] ^= 1
    stream.write_bytes(raw)
    assert "was changed after it was written" in call("process", lab / "runs", code=3).output


def test_an_error_in_the_program_is_reported_with_its_run_and_stops_no_other(lab, monkeypatch):
    from pmabench.kinds.recorded_step import reduction as recorded_steps

    reduce = recorded_steps.reduce
    bad = sorted((lab / "runs" / "2018").iterdir())[0]

    def broken(runs, options=None):
        if runs[0].id == bad.name:
            raise ZeroDivisionError("float division by zero")
        return reduce(runs, options)

    monkeypatch.setattr(recorded_steps, "reduce", broken)
    reported = json.loads(call("process", lab / "runs", "--json", code=1).stdout)
    assert len(reported["runs"]) == RUNS - 1
    (failed,) = reported["failed"]
    assert failed["error"].startswith(str(bad))
    assert "please report it: ZeroDivisionError: float division by zero" in failed["error"]


def test_sessions_are_left_out_and_runs_that_others_continue_belong_to_those(tmp_path):
    from pmabench.store.chain import continued

    runs = tmp_path / "runs"
    first = closed(runs, "one")
    last = closed(runs, "two", continues=continued(first) | {"trials_done": [0]})
    closed(runs, "session", kind="session")
    alone = closed(runs / "deeper", "two")
    tasks = tasks_below([runs])
    assert [(task.place, [path.name for path in task.chain]) for task in tasks] == [
        ("deeper/two", ["two"]),
        ("session", ["session"]),
        ("two", ["one", "two"]),
    ]
    twice = tasks_below([runs / "deeper", alone, last])
    assert [task.place for task in twice] == ["two", "two-2"]
    many = process_many(tasks, tmp_path / "analyses")
    assert [state for _, state, _ in many.entries].count("skipped") == 1
    assert next(many.of("skipped"))["skipped"] == "is a run of kind session"


def test_a_run_that_is_not_closed_is_never_taken_as_unchanged(tmp_path):
    run = closed(tmp_path)
    assert fingerprint([run], "")
    assert fingerprint([run], "") != fingerprint([run], "other options")
    (run / "seal.json").rename(tmp_path / "seal.json")
    assert fingerprint([run], "") == ""


def test_symbols_that_mean_two_things_have_two_columns():
    entry = {"run": "r", "started": "", "specimen": "", "kind": "k", "simulated": False, "verdicts": [], "folder": "f"}
    H = {"symbol": "H", "coordinate": "", "at": {}, "value": 1e3, "half_width": None, "n": 3, "method": "m"}
    estimates = [H | {"quantity": "pressure", "unit": "Pa"}, H | {"quantity": "length", "unit": "m", "value": 1e-3}]
    rows, numbers = table_rows([entry | {"estimates": [estimates[0]]}, entry | {"estimates": [estimates[1]]}])
    assert [(row.get("H [kPa]"), row.get("H [mm]")) for row in rows] == [(1.0, None), (None, 1.0)]
    assert list(numbers) == ["H [mm]", "H half width 95 % [mm]", "H [kPa]", "H half width 95 % [kPa]"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--jobs", "2"), "give their folder, or --each"),
        (("--cluster", "tcp://127.0.0.1:1"), "give their folder, or --each"),
        (("--each", "--jobs", "2", "--cluster", "tcp://127.0.0.1:1"), "give one of the two"),
        (("--jobs", "0"), "0 is not in the range"),
    ],
)
def test_options_that_do_not_fit_are_refused(archive, options, says):
    run = next((archive[0] / "runs" / "2018").iterdir())
    assert says in call("process", run, *options, code=2).output


def test_what_is_no_run_is_reported_among_the_others(lab):
    (lab / "readme.txt").write_text("words")
    reported = call("process", "--each", lab / "runs", lab / "readme.txt", lab / "nowhere", code=3).output
    assert f"{lab / 'readme.txt'}  is not a run folder" in reported
    assert f"{lab / 'nowhere'}  is not a run folder: there is no such folder" in reported
    assert f"recorded-step: {RUNS} runs" in reported


def test_text_that_a_spreadsheet_or_a_terminal_would_act_on_is_inert(tmp_path):
    closed(tmp_path / "runs", specimen={"type": "=HYPERLINK(1)", "serial": "\x1b[2J"}, kind="\x1b]0;x\x07none")
    write_run(tmp_path / "runs", 1)
    reported = call("process", tmp_path / "runs", code=3).output
    assert "\x1b" not in reported
    assert "no reduction for runs of kind" in reported
    entry = json.loads((tmp_path / "analyses" / "each" / "all-runs.json").read_text())["runs"][0]
    rows, numbers = table_rows([entry | {"specimen": "=HYPERLINK(1)", "verdicts": ["@SUM(1)"]}])
    text = csv_text(rows, list(numbers))
    assert ",'=HYPERLINK(1)," in text
    assert "'@SUM(1)" in text
