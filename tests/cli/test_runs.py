"""`runs list`, `show`, `verify`, and `process` and `report`, of runs that came to something after they were closed."""

import json
import os
import re
from pathlib import Path

import pytest

from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.session import ensure
from pmabench.store.chain import continued
from tests.cli.test_cli import call
from tests.engine.benches import mounted
from tests.store.runs import begin, closed, die, record
from tests.store.test_chain import forget_writer, write

GUARD = {"vent": {"result": "confirmed", "actions": []}, "cause": "the engine has gone", "t": 4.1}
SOURCES = {"protocol": "contraction-relaxation", "bench": "mock", "specimen": "mas-20-250-paper0"}


@pytest.fixture
def touched(tmp_path):
    """A closed run with two things added, and a late report of the guard."""
    folder = closed(tmp_path / "runs", rows=200)
    (folder / ".DS_Store").write_bytes(b"\0" * 40)
    os.mkfifo(folder / "tube")
    late_report(folder)
    return folder


def late_report(folder, **changes):
    late = Path(f"{folder}.late")
    late.mkdir()
    (late / "guard.json").write_text(json.dumps(GUARD | changes))


@pytest.mark.timeout(60)
def test_verify_shows_what_was_added_from_what_is_damaged(touched):
    text = call("runs", "verify", touched).stdout
    assert text.splitlines()[0] == f"{touched}: whole, 2 added, 1 late"
    assert "  .DS_Store: was added after the run was closed\n" in text
    assert "  tube: was added after the run was closed; it is a FIFO\n" in text
    assert "  run.late/guard.json: came after the run was closed; no seal protects it\n" in text
    reported = json.loads(call("runs", "verify", touched, "--json").stdout)
    assert reported["runs"] == {str(touched): []}
    assert len(reported["added"][str(touched)]) == 2
    assert reported["late"] == {str(touched): ["guard.json"]}
    both = call("runs", "verify", touched, f"{touched}.late").stdout
    assert both == text, "runs/* names the late folder too"
    (touched / "plan.json").unlink()
    text = call("runs", "verify", touched, code=3).stdout
    assert text.splitlines()[0] == f"{touched}: 1 finding, 2 added, 1 late"
    assert "  plan.json: is missing\n" in text


def test_verify_goes_on_after_what_is_no_run(tmp_path):
    (tmp_path / "runs" / "a-note.txt").parent.mkdir()
    (tmp_path / "runs" / "a-note.txt").write_text("no run")
    (tmp_path / "runs" / "empty").mkdir()
    last = closed(tmp_path / "runs", "whole", rows=200)
    text = call("runs", "verify", *sorted((tmp_path / "runs").iterdir()), code=3).stdout
    assert "a-note.txt: 1 finding\n" in text
    assert "empty: is not a run folder: no manifest.json in it" in text
    assert text.rstrip().endswith(f"{last}: whole")


def test_a_run_folder_that_was_emptied_is_reported_by_process(tmp_path):
    name = "20261121-1432_MAS20-A017_contraction-relaxation_7f3a"
    (tmp_path / "runs" / name / "streams").mkdir(parents=True)
    text = call("process", tmp_path / "runs", code=3).output
    assert "1 run could not be processed" in text
    assert f"{name}  is not a run folder: no manifest.json in it" in text


@pytest.mark.timeout(60)
def test_show_and_list_say_it_in_one_sentence_each(touched):
    text = call("runs", "show", touched).stdout
    assert "added to the folder after the run was closed, and not used: .DS_Store, tube\n" in text
    assert "written next to the run after it was closed: guard.json\n" in text
    assert "the guard vented once more after the run was closed: confirmed (the engine has gone)\n" in text
    since = json.loads(call("runs", "show", touched, "--json").stdout)["since"]
    assert [entry["name"] for entry in since["added"]] == [".DS_Store", "tube"]
    assert (since["late"], since["guard"]) == (["guard.json"], GUARD)
    text = call("runs", "list", touched.parent).stdout
    assert "finished* " in text
    assert "* run: added to the folder after the run was closed, and not used: .DS_Store, tube\n" in text
    (row,) = json.loads(call("runs", "list", touched.parent, "--json").stdout)["runs"]
    assert (row["added"], row["late"]) == ([".DS_Store", "tube"], ["guard.json"])


@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", ["events.jsonl", "plan.json", "streams/daq.parquet", "streams/other.parquet"])
def test_watch_opens_no_fifo(tmp_path, name):
    folder = closed(tmp_path, rows=200)
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)
    assert "finished" in call("watch", folder, "--plain").stdout


@pytest.mark.timeout(120)
def test_process_and_report_take_the_sealed_part_and_say_so(tmp_path):
    small = ["--set", "sweep.matrix.load=[6 kg]", "--set", "sweep.matrix.pressure=[200 kPa, 300 kPa]"]
    bench = ["--bench", "mock", "--specimen", "mas-20-250-paper0", "--yes"]
    run = json.loads(call("run", "contraction-relaxation", *bench, *small, "--out", tmp_path / "runs", "--json").stdout)
    folder = Path(run["run"])
    before = json.loads(call("process", folder, "--out", tmp_path / "before", "--json", code=6).stdout)
    assert before["since"] == {}
    (folder / "guard.json").write_text(json.dumps(GUARD))
    os.mkfifo(folder / "streams" / "tube.parquet")
    after = json.loads(call("process", folder, "--out", tmp_path / "after", "--json", code=6).stdout)
    assert after["analyses"] == before["analyses"]
    assert [entry["name"] for entry in after["since"][folder.name]["added"]] == ["guard.json", "streams/tube.parquet"]
    sentence = "added to the folder after the run was closed, and not used: guard.json, streams/tube.parquet"
    late_report(folder)
    everything = sorted(folder.parent.iterdir())
    assert sentence in call("process", *everything, "--out", tmp_path / "text", code=6).stdout
    many = call("process", tmp_path / "runs", "--out", tmp_path / "many", code=6).stdout
    assert "2 added and 1 late files since it was closed, not used" in many
    reported = call("report", *everything, "-o", tmp_path / "page.html")
    assert sentence in reported.stderr
    assert sentence in (tmp_path / "page.html").read_text()


def test_a_changed_byte_is_refused_whatever_else_was_added(touched):
    path = touched / "events.jsonl"
    path.chmod(0o644)
    path.write_bytes(path.read_bytes().replace(b"58.8", b"58.9", 1))
    for command in ("show", "verify"):
        assert "events.jsonl" in call("runs", command, touched, code=3).output


def test_an_interrupted_run_names_the_command_that_goes_on_with_it(tmp_path):
    made = {"sources": SOURCES, "trials_planned": 4}
    first = write(tmp_path / "my runs", "one", [(0, "finished"), (1, None)], **made)
    command = f"pmabench run --resume '{first}'"
    assert f"  to go on     {command}\n" in call("runs", "show", first).stdout
    assert f"one was interrupted; to go on with it: {command}\n" in call("runs", "list", first.parent).stdout
    assert json.loads(call("runs", "show", first, "--json").stdout)["resume"] == command
    second = write(first.parent, "two", [(1, "finished"), (2, "finished")], continued(first), "aborted", **made)
    assert "  continued    by two\n" in call("runs", "show", first).stdout
    assert "to go on" not in call("runs", "list", first.parent).stdout, "one is continued, two was ended by a person"
    shown = json.loads(call("runs", "show", second, "--json").stdout)
    assert (shown["resume"], shown["continued_by"]) == (f"pmabench run --resume '{second}'", "")
    rows = json.loads(call("runs", "list", first.parent, "--json").stdout)["runs"]
    assert [row["resume"] for row in rows] == ["", f"pmabench run --resume '{second}'"]


@pytest.mark.parametrize(
    ("made", "end"),
    [
        ({"trials_planned": 2}, "aborted"),
        ({"sources": SOURCES, "trials_planned": 2}, "finished"),
        ({"sources": SOURCES, "trials_planned": 0}, "aborted"),
    ],
)
def test_a_run_that_cannot_be_gone_on_with_names_no_command(tmp_path, made, end):
    folder = begin(tmp_path, **made)
    folder = folder.close(end)
    shown = call("runs", "show", folder).stdout
    assert "to go on" not in shown


def test_a_run_whose_vent_event_a_full_disk_took_shows_the_vent_of_the_seal(tmp_path):
    writer = begin(tmp_path)
    writer.close("error", "cannot write", vent={"result": "confirmed", "actions": []})
    assert "  vent         confirmed\n" in call("runs", "show", writer.folder).stdout


def test_a_guard_next_to_a_dead_run_is_shown_as_its_own(tmp_path):
    writer = begin(tmp_path)
    record(writer)
    die(writer)
    forget_writer(writer.folder)
    late_report(writer.folder, cause="the engine died (signal 9)")
    text = call("runs", "show", writer.folder).stdout
    assert "the bench was vented after the program died: confirmed" in text
    assert "the engine died (signal 9)" in text


def test_list_gives_the_name_that_commands_take_on_80_columns(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    closed(tmp_path / "runs", "20261130-0720_MAS-20-250N-AA-MC-K-MOCK-P0_contraction-relaxation_6afd", rows=200)
    listed = call("runs", "list").stdout
    assert "runs/6afd" in listed
    assert max(map(len, listed.splitlines())) <= 80


def test_a_session_is_shown_with_its_zeros_and_self_test(tmp_path):
    ready = ensure(mounted("mock-session"), ConfirmedBeforehand(), tmp_path / "runs", skip_warm_up="a test")
    run = tmp_path / "runs" / ready.in_session["run"]
    shown = call("runs", "show", run).stdout
    assert re.search(r"trials +0 of 0 finished; [1-9][0-9,]* rows", shown)
    assert re.search(r"self-test +\d+ .*ok", shown)
    assert re.search(r"zeros taken +pressure .* kPa, force .* N", shown)
    assert "nothing: a run of kind session has no trials to process" in call("continue", run).stdout
