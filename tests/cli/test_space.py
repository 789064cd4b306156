"""The disk must hold twice what a run may record: `run` refuses before anything moves, `check` warns."""

import json
import shutil
from types import SimpleNamespace

import pytest

from tests.cli.test_cli import MOCK, SMALL, call


@pytest.fixture
def disk(monkeypatch):
    """A disk with so much free, told for the folder that is asked about."""
    asked = []

    def with_free(count):
        def usage(place):
            asked.append(place)
            return SimpleNamespace(total=10**12, used=0, free=count)

        monkeypatch.setattr(shutil, "disk_usage", usage)
        return asked

    return with_free


def needed():
    return json.loads(call("check", "contraction-relaxation", *MOCK, *SMALL, "--json").stdout)["bytes"]


def test_a_run_that_may_not_fit_is_refused_before_it_begins(disk, tmp_path):
    count, out = needed(), tmp_path / "not" / "yet"
    asked = disk(2 * count - 1)
    reported = call("run", "contraction-relaxation", *MOCK, *SMALL, "--yes", "--out", out, code=7).output
    assert "are free, and" in reported
    assert "twice what the run may record" in reported
    assert asked[-1] == tmp_path, "where the folder would be made"
    assert not out.exists()


def test_a_run_that_fits_twice_goes_on(disk, tmp_path):
    disk(2 * needed())
    call("run", "contraction-relaxation", *MOCK, *SMALL, "--yes", "--out", tmp_path)


def test_check_warns_and_is_content_otherwise(disk, tmp_path):
    count = needed()
    check = ("check", "contraction-relaxation", *MOCK, *SMALL, "--out", tmp_path)
    disk(2 * count - 1)
    assert "`run` refuses: " in call(*check).stdout
    assert str(tmp_path) in json.loads(call(*check, "--json").stdout)["disk"]
    disk(2 * count)
    assert "`run` refuses" not in call(*check).stdout
    assert json.loads(call(*check, "--json").stdout)["disk"] == ""
