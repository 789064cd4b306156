"""The same run under two locales and time zones: every table, and the report, the same bytes."""

import locale
import os
import shutil
import subprocess
import time

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from tests.benchmarks.archive import write_run

GERMAN = "de_DE.UTF-8"
"""Writes 1.234,5 where it is asked to, and names months and days otherwise."""


@pytest.fixture
def world(tmp_path, monkeypatch):
    """Sets locale and time zone of this process; they are put back."""
    if shutil.which("localedef"):  # where the machine has the definition, whether or not it was installed
        subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", tmp_path / GERMAN], capture_output=True, check=False)
        monkeypatch.setenv("LOCPATH", str(tmp_path))
    before = locale.setlocale(locale.LC_ALL)

    def set_to(name, zone):
        os.environ["TZ"] = zone
        time.tzset()
        try:
            locale.setlocale(locale.LC_ALL, name)
        except locale.Error:
            return  # the time zone is tried all the same
        assert locale.localeconv()["decimal_point"] == ("," if name == GERMAN else ".")

    monkeypatch.setenv("TZ", "UTC")
    yield set_to
    locale.setlocale(locale.LC_ALL, before)
    monkeypatch.undo()
    time.tzset()


def tables(run, out):
    """What process and report write of a run, alone and as one of many."""
    for args in (
        ("process", run, "--out", out / "alone"),
        ("process", run, "--each", "--out", out / "many"),
        ("report", run, "-o", out / "report.html"),
    ):
        result = CliRunner().invoke(main, [str(arg) for arg in args], catch_exceptions=False)
        assert result.exit_code == 0, result.output
    return {
        path.relative_to(out).as_posix(): path.read_bytes()
        for path in out.rglob("*")
        if path.is_file() and not path.name.startswith(".")
    }


def test_tables_are_the_same_bytes_under_two_locales_and_time_zones(tmp_path, world):
    run = write_run(tmp_path / "runs", 5)
    world("C", "UTC")
    here = tables(run, tmp_path / "here")
    world(GERMAN, "Asia/Kolkata")
    there = tables(run, tmp_path / "there")
    assert {"alone/recorded-step/coefficients.csv", "many/all-runs.csv", "many/all-runs.json"} <= here.keys()
    assert [name for name in here.keys() | there.keys() if here.get(name) != there.get(name)] == []
