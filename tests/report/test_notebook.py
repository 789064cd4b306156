"""The Python face: tables with units in their heads, equal to the record; the notebook in docs/ runs as it stands."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pmabench
from pmabench.base.errors import InvalidFile, UsageError
from pmabench.store import reader
from tests.store.runs import closed

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "notebook.ipynb"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return closed(tmp_path_factory.mktemp("run"))


def test_tables_are_what_the_record_holds(folder):
    run, record = pmabench.open_run(folder), reader.open_run(folder)
    assert (run.id, run.kind, run.status, run.simulated) == (record.id, record.kind, record.status, record.simulated)
    assert list(run.trials.index) == [trial.number for trial in record.trials]
    first = record.trials[0]
    samples = run.trial(1)
    np.testing.assert_array_equal(samples["t [s]"], first.t)
    np.testing.assert_array_equal(samples["pressure [Pa]"], first.channels["pressure"])
    for name, value in first.point.items():
        (head,) = [c for c in run.trials.columns if c.startswith(f"{name} [")]
        assert run.trials.loc[1, head] == value
    stream = run.stream(run.streams[0])
    assert "pressure [Pa]" in stream.columns
    assert {"t [s]", "flags"} <= set(stream.columns)
    assert "time [ns]" in run.stream(raw=True).columns
    assert len(run.events) == len(record.events)


def test_of_several_attempts_at_a_trial_the_finished_one_is_used(folder):
    run = pmabench.open_run(folder)
    first, *others = run.data.trials
    assert first.status == "finished"
    failed = replace(first, t=first.t + 60.0, status="superseded", attempt=2)
    again = replace(run, data=replace(run.data, trials=(first, failed, *others)))
    np.testing.assert_array_equal(again.trial(1)["t [s]"], first.t)


def test_what_is_not_there_is_reported(folder, tmp_path):
    run = pmabench.open_run(folder)
    with pytest.raises(UsageError, match="has no trial 99"):
        run.trial(99)
    with pytest.raises(InvalidFile, match="no stream"):
        run.stream("nowhere")
    with pytest.raises(InvalidFile):
        pmabench.open_run(tmp_path)
    with pytest.raises(UsageError, match="no run is given"):
        pmabench.process()
    with pytest.raises(AttributeError, match="no attribute 'open_door'"):
        pmabench.open_door  # noqa: B018


def test_the_notebook_runs(tmp_path, monkeypatch):
    import matplotlib as mpl

    mpl.use("Agg")
    monkeypatch.chdir(tmp_path)
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    names: dict = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [], "the notebook is kept without outputs"
            exec("".join(cell["source"]), names)
    import matplotlib.pyplot as plt

    plt.close("all")
    found = names["found"]
    frame = found.to_frame()
    K = frame[(frame["symbol"] == "K") & frame["frequency [Hz]"].isna()].iloc[0]
    # K(300 kPa) of the simulated muscle paper0: 5.6 + 1.0e-3 P + 9.7e-6 P^2 N/mm
    assert K["value"] == pytest.approx(1e3 * (5.6 + 0.3 + 9.7e-6 * 300**2), rel=0.01)
    assert K["low95"] < K["value"] < K["high95"]
    assert K["unit"] == "N/m"
    assert (tmp_path / "report.html").stat().st_size > 50_000
    assert len(found.trace(found.analyses[0].traces[0].name)) > 10
    with pytest.raises(UsageError, match="no trace"):
        found.trace("x")
