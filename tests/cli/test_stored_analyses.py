"""`report`, `compare` and `export` use what `process` stored, as long as it is what they would compute."""

import json
import os
import shutil

import pytest

import pmabench.kinds.reduce
import pmabench.report.document.content
from pmabench.store.analyses import folder as made_from
from pmabench.store.analyses.folder import read_analysis, write_analysis
from tests.benchmarks.archive import write_run
from tests.calls import call


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A run, processed."""
    lab = tmp_path_factory.mktemp("lab")
    write_run(lab / "runs", 1)
    call("process", the_run(lab))
    return lab


@pytest.fixture
def lab(recorded, tmp_path):
    """A copy that may be changed."""
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    for path in (tmp_path / "runs").rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o644)
    return tmp_path


@pytest.fixture
def reduced(monkeypatch):
    """The runs that are reduced, a list for each time."""
    found, reduce = [], pmabench.kinds.reduce.reduce_runs

    def counted(runs, options=None):
        if runs:
            found.append([run.id for run in runs])
        return reduce(runs, options)

    monkeypatch.setattr(pmabench.kinds.reduce, "reduce_runs", counted)
    return found


def the_run(lab):
    (run,) = (lab / "runs").iterdir()
    return run


def record_of(lab):
    return lab / "analyses" / the_run(lab).name / made_from.RECORD


def test_the_record_says_which_inputs_options_and_code(lab):
    record = json.loads(record_of(lab).read_text())
    assert set(record) == {"schema", "key", "program", "options", "runs", "analyses", "entry"}
    assert list(record["runs"]) == [the_run(lab).name]
    assert (record["options"], list(record["analyses"])) == ({}, ["recorded-step"])


def test_nothing_is_computed_twice_and_the_bytes_are_the_same(lab, reduced):
    run, computed = the_run(lab), lab / "computed.html"
    call("report", run, "--fresh", "-o", computed)
    assert len(reduced) == 1
    reported = call("report", run, "-o", lab / "stored.html")
    assert (reported.stderr, len(reduced)) == ("", 1)
    assert (lab / "stored.html").read_bytes() == computed.read_bytes()
    for form, name in (("json", "a.json"), ("latex", "a.tex")):
        call("export", run, "--format", form, "-o", lab / f"fresh-{name}", "--fresh")
        call("export", run, "--format", form, "-o", lab / name)
        assert (lab / name).read_bytes() == (lab / f"fresh-{name}").read_bytes()
    assert len(reduced) == 3
    compared = [call("compare", run, run, "--json", *fresh).stdout for fresh in ((), ("--fresh",))]
    assert compared[0] == compared[1]
    assert len(reduced) == 5


def test_what_was_processed_as_one_of_a_folder_is_used_too(lab, reduced):
    shutil.rmtree(lab / "analyses")
    call("process", lab / "runs")
    assert len(reduced) == 1
    call("report", the_run(lab), "-o", lab / "r.html")
    assert len(reduced) == 1


def test_the_same_report_once_more_is_a_copy_of_the_page(lab, monkeypatch):
    run = the_run(lab)
    call("report", run, "-o", lab / "one.html", "--title", "T")

    def never(*_args, **_options):
        raise AssertionError("the page is made once more")

    with monkeypatch.context() as patched:
        patched.setattr(pmabench.report.document.content, "content_of", never)
        again = call("report", run, "-o", lab / "two.html", "--title", "T", "--json")
        assert json.loads(again.stdout)["path"] == str(lab / "two.html")
        assert (lab / "two.html").read_bytes() == (lab / "one.html").read_bytes()
        for other in (("--title", "another"), ("--title", "T", "--fresh"), ("--title", "T", "--customer", "C")):
            with pytest.raises(AssertionError, match="once more"):
                call("report", run, "-o", lab / "three.html", *other)
    page = next(lab.glob("analyses/*/.report.kept"))
    raw = bytearray(page.read_bytes())
    raw[-100] ^= 1
    page.write_bytes(raw)
    call("report", run, "-o", lab / "two.html", "--title", "T")
    assert (lab / "two.html").read_bytes() == (lab / "one.html").read_bytes()


def test_what_came_to_a_run_since_is_in_the_copy(lab):
    run = the_run(lab)
    (run / "added.txt").write_text("x")
    call("process", run)
    first, again = (json.loads(call("report", run, "-o", lab / "r.html", "--json").stdout) for _ in range(2))
    assert first["since"][run.name]["added"][0]["name"] == "added.txt"
    assert again == first
    assert "added.txt" in call("report", run, "-o", lab / "r.html").stderr


@pytest.mark.parametrize("change", ["note", "added", "version"])
def test_a_changed_run_or_program_is_computed_again(lab, reduced, monkeypatch, change):
    run = the_run(lab)
    if change == "note":
        call("note", run, "it slipped", "--exclude", "1", "--because", "slipped", "--operator", "A")
    elif change == "added":
        (run / "added.txt").write_text("x")
    else:
        monkeypatch.setattr(made_from, "program", lambda: "another version")
    call("report", run, "-o", lab / "r.html")
    assert reduced == [[run.name]]


def test_a_stream_that_was_changed_is_refused_whatever_was_stored(lab):
    run = the_run(lab)
    call("report", run, "-o", lab / "r.html")
    stream = next(run.rglob("*.parquet"))
    raw, times = bytearray(stream.read_bytes()), stream.stat()
    raw[len(raw) // 2] ^= 1
    stream.write_bytes(raw)
    os.utime(stream, ns=(times.st_atime_ns, times.st_mtime_ns))  # as a disk that forgets would leave it
    for command in (("report", run, "-o", lab / "r.html"), ("compare", run, run)):
        assert "was changed after it was written" in call(*command, code=3).output


def test_other_options_are_not_used_and_the_user_is_informed(lab, reduced):
    run, place = the_run(lab), record_of(lab).parent
    options = {"recorded-step": {"mass": 7.85}}
    made_from.keep(place, made_from.key_of([run], options), [run], options, [place / "recorded-step"])
    reported = call("report", run, "-o", lab / "r.html").stderr
    assert f"{place} was made with other options (mass): it is not used" in reported
    assert len(reduced) == 1


@pytest.mark.parametrize("damage", ["record", "name", "analysis", "replaced"])
def test_a_damaged_analysis_is_not_used_and_the_user_is_informed(lab, reduced, damage):
    run, record = the_run(lab), record_of(lab)
    analysis = record.parent / "recorded-step" / "analysis.json"
    if damage == "record":
        record.write_bytes(record.read_bytes()[:-20])
        why = f"{record} is damaged"
    elif damage == "name":
        record.write_text(json.dumps(json.loads(record.read_text()) | {"analyses": {"../../runs": "x"}}))
        why = f"{record.parent} was changed after it was written"
    elif damage == "analysis":
        analysis.write_text("{}")
        why = f"{record.parent} was changed after it was written"
    else:
        read = read_analysis(analysis.parent)
        write_analysis(read, analysis.parent)
        analysis.write_text("{}")
        content = json.loads(record.read_text())
        content["analyses"] = {"recorded-step": made_from.stamp(analysis.parent)}
        record.write_text(json.dumps(content))
        why = "analysis.json"
    reported = call("report", run, "-o", lab / "r.html").stderr
    assert why in reported
    assert "it is not used, and its runs are processed again" in reported
    assert len(reduced) == 1
