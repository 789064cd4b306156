"""What `report` and `export` take: runs, analysis folders, folders of these; what is none is told with what to give."""

import shutil

import pytest

from tests.benchmarks.archive import write_run
from tests.calls import call


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Two runs of one specimen, each with its analysis."""
    lab = tmp_path_factory.mktemp("lab")
    for number in (0, 20):
        call("process", write_run(lab / "runs", number))
    return lab


def test_a_folder_of_analyses_means_all_in_it(lab, tmp_path):
    one, two = sorted((lab / "analyses").iterdir())
    call("report", lab / "analyses", "-o", tmp_path / "folder.html")
    call("report", one / "recorded-step", two / "recorded-step", "-o", tmp_path / "each.html")
    assert (tmp_path / "folder.html").read_bytes() == (tmp_path / "each.html").read_bytes()
    call("export", one, "--format", "json", "-o", tmp_path / "folder.json")
    call("export", one / "recorded-step", "--format", "json", "-o", tmp_path / "each.json")
    assert (tmp_path / "folder.json").read_bytes() == (tmp_path / "each.json").read_bytes()


def test_among_runs_a_folder_of_analyses_is_skipped_and_that_is_said(lab, tmp_path):
    reported = call("report", *(lab / "runs").iterdir(), lab / "analyses", "-o", tmp_path / "a.html")
    assert "analyses: holds analyses, skipped" in reported.stderr


def test_two_analyses_of_one_run_are_not_one_report(lab, tmp_path):
    one = sorted((lab / "analyses").iterdir())[0] / "recorded-step"
    shutil.copytree(one, tmp_path / "again" / "recorded-step")
    reported = call("report", one, tmp_path / "again", "-o", tmp_path / "a.html", code=2)
    assert "are analyses of the same runs: give one of the two" in reported.output


@pytest.mark.parametrize("command", [("report",), ("recalibrate", "--skew", "pressure=1 ms")])
def test_a_folder_of_runs_is_distinguished_from_a_run(lab, tmp_path, command):
    target = ("-o", tmp_path / "a.html") if command[0] == "report" else ()
    reported = call(*command, lab / "runs", *target, code=3)
    assert "is a folder of runs: name those in it, for instance with /*" in reported.output
