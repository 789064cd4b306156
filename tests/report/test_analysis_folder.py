"""An analysis written and read is the same analysis, byte for byte; a damaged or hostile folder is one sentence."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pmabench.base.errors import InvalidFile
from pmabench.store.analyses.folder import file_names, read_analysis, runs_of, write_analysis
from pmabench.store.analyses.results import Trace

from . import samples


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.parametrize("analysis", samples.all_analyses(), ids=lambda a: a.kind)
def test_written_and_read_it_is_the_same(tmp_path, analysis):
    folder = write_analysis(analysis, tmp_path / "a")
    again = read_analysis(folder)
    assert again.estimates == analysis.estimates
    assert again.curves == analysis.curves
    assert again.dropped == analysis.dropped
    assert again.findings == analysis.findings
    assert again.runs == analysis.runs
    assert [t.name for t in again.traces] == [t.name for t in analysis.traces]
    for mine, theirs in zip(again.traces, analysis.traces, strict=True):
        assert list(mine.columns) == list(theirs.columns)
        for name in mine.columns:
            np.testing.assert_array_equal(mine.columns[name], theirs.columns[name])
    second = write_analysis(again, tmp_path / "b")
    assert contents(folder) == contents(second)


def test_a_second_analysis_leaves_nothing_of_the_first(tmp_path):
    write_analysis(samples.contraction(), tmp_path)
    write_analysis(samples.static_load(), tmp_path)
    assert sorted(p.name for p in (tmp_path / "traces").iterdir()) == ["lift-59N.parquet", "static-load.parquet"]


def test_names_of_traces_stay_inside_the_folder(tmp_path):
    names = ["../../up", "/etc/passwd", "..", "", "con", "A", "a", "x" * 300, "a/b\\c:d\x00"]
    columns = {"t": np.arange(3.0), "x": np.arange(3.0)}
    traces = tuple(Trace(name, "any", "t", columns, {}) for name in names)
    folder = write_analysis(replace(samples.static_load(), traces=traces), tmp_path / "in" / "a")
    outside = [p for p in tmp_path.rglob("*") if p.is_file() and not p.is_relative_to(folder)]
    assert outside == []
    assert [t.name for t in read_analysis(folder).traces] == [name.rstrip("\x00") for name in names]
    legal = file_names(names)
    assert len({name.casefold() for name in legal}) == len(names)
    assert all("/" not in name and not name.startswith(".") and name.lower() != "con" for name in legal)


def test_what_is_no_number_in_json_becomes_nothing(tmp_path):
    estimate = replace(samples.static_load().estimates[0], value=float("nan"))
    folder = write_analysis(replace(samples.static_load(), estimates=(estimate,), facts={"x": np.inf}), tmp_path)
    json.loads((folder / "analysis.json").read_text(), parse_constant=pytest.fail)
    assert read_analysis(folder).estimates[0].value is None


def changed(folder, change):
    data = json.loads((folder / "analysis.json").read_text())
    change(data)
    (folder / "analysis.json").write_text(json.dumps(data))


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.update(schema="pmabench.analysis/99"),
        lambda d: d.update(schema=3),
        lambda d: d.pop("estimates"),
        lambda d: d.update(estimates=[3]),
        lambda d: d.update(simulated="no"),
        lambda d: d["estimates"][0].update(value="7"),
        lambda d: d["estimates"][0].update(value=float("inf")),
        lambda d: d["estimates"][0].update(at=None),
        lambda d: d["curves"][0].update(domain=[1]),
        lambda d: d["traces"][0].update(file="../../secret.parquet"),
        lambda d: d["traces"][0].update(file="traces/none.parquet"),
        lambda d: d["traces"][0].update(columns=["nothing"]),
        lambda d: d.update(facts=7),
    ],
)
def test_a_changed_analysis_is_reported_in_one_sentence(tmp_path, change):
    folder = write_analysis(samples.static_load(), tmp_path)
    changed(folder, change)
    with pytest.raises(InvalidFile) as failure:
        read_analysis(folder)
    assert len(failure.value.problems) == 1


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe", b"[" * 100_000])
def test_what_is_no_analysis_is_reported(tmp_path, content):
    with pytest.raises(InvalidFile):
        read_analysis(tmp_path)
    (tmp_path / "analysis.json").write_bytes(content)
    with pytest.raises(InvalidFile):
        read_analysis(tmp_path)
    with pytest.raises(InvalidFile):
        runs_of(tmp_path)


def test_the_runs_of_an_analysis_are_found_where_process_and_demo_leave_them(tmp_path):
    analysis = samples.static_load()
    run = analysis.runs[0]
    for place in (tmp_path / "runs", tmp_path / "out" / "runs"):
        (place / run).mkdir(parents=True)
        (place / run / "manifest.json").write_text("{}")
    next_to = write_analysis(analysis, tmp_path / "runs" / "analyses" / run / analysis.kind)
    assert runs_of(next_to) == [tmp_path / "runs" / run]
    demo = write_analysis(analysis, tmp_path / "out" / "analyses" / run / analysis.kind)
    assert runs_of(demo) == [tmp_path / "out" / "runs" / run]
    lost = write_analysis(replace(analysis, runs=("../../etc", "gone")), tmp_path / "lost")
    assert runs_of(lost) == []
