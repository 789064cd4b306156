"""What outlives a process: one owner, a latch that nothing but a written "safe" opens (S7, S9, P22, P24)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from pmabench.base.errors import DeviceError, RecordError
from pmabench.guard import station as module
from pmabench.guard.station import UNCLEAN, Station, root, stations


def test_a_bench_that_was_never_armed_is_not_latched():
    assert Station("new").latched() == ""
    assert Station("new").read("state") == {}
    assert list(stations()) == []


def test_the_name_of_a_bench_becomes_a_folder_inside():
    for name in ("../../etc", "a b/c", "..", "", "ü"):
        folder = Station(name).folder
        assert folder.parent == root()
        assert folder.name not in {"", ".", ".."}


def test_armed_and_tripped_latch_and_safe_does_not():
    station = Station("x")
    station.folder.mkdir(parents=True)
    station.note("armed", run="r")
    assert station.latched().startswith(UNCLEAN)
    station.note("tripped", why="burst")
    first = station.latched()
    assert first.startswith("burst, ")
    station.note("tripped", why="another")
    assert station.latched() == first, "the first reason stays"
    station.note("safe", why="reset")
    assert station.latched() == ""
    assert [json.loads(line)["what"] for line in (station.folder / "journal.jsonl").read_text().splitlines()] == [
        "armed", "tripped", "tripped", "safe",
    ]  # fmt: skip
    assert [s.folder for s in stations()] == [station.folder]
    (root() / "a file").write_text("")
    assert len(list(stations())) == 1


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"what": "arm', '{"what": "?"}', "{}", "\udcff"])
def test_a_state_that_cannot_be_read_latches(text):
    station = Station("x")
    station.folder.mkdir(parents=True)
    (station.folder / "state.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    assert station.latched().startswith(UNCLEAN)


def test_every_cut_of_a_state_latches():
    station = Station("x")
    station.folder.mkdir(parents=True)
    station.note("safe", why="reset")
    whole = (station.folder / "state.json").read_bytes()
    for length in range(len(whole)):
        (station.folder / "state.json").write_bytes(whole[:length])
        assert station.latched(), length


def test_a_state_that_cannot_be_written_is_told(monkeypatch):
    station = Station("x")
    with pytest.raises(RecordError, match="the state of the bench is not kept"):
        station.note("armed")


def test_a_folder_that_cannot_be_made_is_told(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PMABENCH_STATE", str(tmp_path / "file"))
    with pytest.raises(DeviceError, match="set PMABENCH_STATE"):
        Station("x").log()
    monkeypatch.setenv("PMABENCH_STATE", str(tmp_path / "good"))
    with Station("x").log() as log:
        log.write(b"x")


def test_a_file_goes_away_and_may_be_gone():
    station = Station("x")
    station.folder.mkdir(parents=True)
    station.write("guard", {"port": 1})
    assert station.read("guard") == {"port": 1}
    station.remove("guard")
    station.remove("guard")
    assert station.read("guard") == {}


HOLD = "from pmabench.guard.station import Station\nStation('x').take()\nprint('taken', flush=True)\ninput()"


def test_one_owner_until_it_is_gone_however_it_goes():
    holder = subprocess.Popen([sys.executable, "-c", HOLD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert holder.stdout.readline() == "taken\n"
    with pytest.raises(DeviceError, match="in use by another program"):
        Station("x").take()
    Station("x").write("guard", {"pid": holder.pid, "user": "ann", "since": "08:00:00"})
    with pytest.raises(DeviceError, match=f"in use by process {holder.pid} of ann since 08:00:00"):
        Station("x").take()
    holder.kill()
    holder.communicate()
    Station("x").take()


def test_where_the_state_is_kept(monkeypatch, tmp_path):
    monkeypatch.delenv("PMABENCH_STATE")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert root() == tmp_path / "pmabench"
    monkeypatch.delenv("XDG_STATE_HOME")
    assert root() == Path.home() / ".local" / "state" / "pmabench"
    monkeypatch.setattr(module.sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path))
    assert root() == tmp_path / "pmabench" / "state"
