"""A folder of runs by the workers of a Dask scheduler: the same bytes as here, and sentences where that cannot be."""

import sys
from pathlib import Path

import pytest

import pmabench.analysis.many
from tests.benchmarks.archive import write_run
from tests.calls import call

RUNS = 6
pytestmark = [pytest.mark.realtime, pytest.mark.filterwarnings("default")]


@pytest.fixture(scope="module")
def scheduler():
    """A local scheduler with two workers, each a process."""
    import dask
    from distributed import LocalCluster

    with (
        dask.config.set({"distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 65536}),
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1") as cluster,
    ):
        yield cluster.scheduler_address


def test_two_workers_give_the_same_bytes(tmp_path, scheduler, monkeypatch):
    runs = tmp_path / "runs"
    folders = [write_run(runs, number) for number in range(RUNS)]
    bad = folders[2] / "seal.json"
    bad.chmod(0o644)
    bad.write_bytes(bad.read_bytes()[:-30])
    call("process", runs, "--out", tmp_path / "here", code=3)
    monkeypatch.chdir(tmp_path)
    reported = call("process", "runs", "--out", "there", "--cluster", scheduler, code=3).output
    assert f"recorded-step: {RUNS - 1} runs" in reported
    here, there = (
        {p.relative_to(out): p.read_bytes() for p in out.rglob("*") if p.is_file() and p.name[0] != "."}
        for out in (tmp_path / "here", tmp_path / "there")
    )
    assert len(here) == 7 * (RUNS - 1) + 2  # analysis, five tables and a trace of each; all runs as JSON and as CSV
    assert here == there


def test_without_the_extra_or_a_scheduler_a_sentence_says_so(tmp_path, monkeypatch):
    write_run(tmp_path / "runs", 0)
    monkeypatch.setattr(pmabench.analysis.many, "PATIENCE", 0.5)
    assert (
        "no Dask scheduler answers there"
        in call("process", tmp_path / "runs", "--cluster", "tcp://127.0.0.1:9", code=2).output
    )
    assert (
        "no Dask scheduler answers there" in call("process", tmp_path / "runs", "--cluster", "nowhere", code=2).output
    )
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert (
        "pip install 'pmabench[cluster]'"
        in call("process", tmp_path / "runs", "--cluster", "tcp://127.0.0.1:9", code=2).output
    )
    assert not Path(tmp_path / "analyses").exists()
