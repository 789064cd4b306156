"""What outlives a process: one owner, a latch that nothing but a written "safe" opens (S7, S9, P22, P24)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from pmabench.base.errors import DeviceError, RecordError
from pmabench.base.system import try_lock
from pmabench.bench.interface import place
from pmabench.guard import station as module
from pmabench.guard.remote import _log
from pmabench.guard.station import UNCLEAN, Station, folder_name, root, stations


def test_a_bench_that_was_never_armed_is_not_latched():
    assert Station("new").latched() == ""
    assert Station("new").read("state") == {}
    assert list(stations()) == []


def test_the_name_of_a_bench_becomes_a_folder_inside():
    for name in ("../../etc", "a b/c", "..", "", "ü"):
        folder = Station(name).folder
        assert folder.parent == root()
        assert folder.name not in {"", ".", ".."}


def test_a_reset_is_noted_where_something_was_tripped_and_nowhere_else():
    """A reset of a bench that was not tripped ended its session."""
    from pmabench.cli.vent import _reset

    station = Station("not tripped")
    station.folder.mkdir(parents=True)
    station.note("safe", why="end of the run")
    before = station.read("state")
    assert _reset(station, {}, "A", "to be sure") == ""
    assert station.read("state") == before
    station = Station("was tripped")
    station.folder.mkdir()
    station.note("tripped", why="the emergency stop")
    assert "emergency stop" in _reset(station, {}, "A", "looked at")
    assert (station.read("state")["why"], station.latched()) == ("reset", "")


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


def test_a_state_that_cannot_be_written_is_reported(monkeypatch):
    station = Station("x")
    with pytest.raises(RecordError, match="the state of the bench is not kept"):
        station.note("armed")


def test_a_folder_that_cannot_be_made_is_reported(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PMABENCH_STATE", str(tmp_path / "file"))
    with pytest.raises(DeviceError, match="set PMABENCH_STATE"):
        _log(Station("x"))
    monkeypatch.setenv("PMABENCH_STATE", str(tmp_path / "good"))
    with _log(Station("x")) as log:
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


# -- which bench, which device (S14) ----------------------------------------------------------------------------------


def test_every_name_has_a_folder_of_its_own_in_any_script():
    names = [
        "банк-1",
        "банк-2",
        "東",
        "西",
        "ü",
        "u",
        "ue",
        "Rig",
        "rig",
        "rig ",
        "rig.",
        "",
        "a/b",
        "a-b",
        "a b",
        "é",
        "e\u0301",
    ]
    folders = [folder_name(name) for name in names]
    assert len({folder.lower() for folder in folders}) == len(names)
    assert all(folder not in {"", ".", ".."} and "/" not in folder and len(folder) < 100 for folder in folders)
    assert folder_name("x" * 500 + "1") != folder_name("x" * 500 + "2")
    assert folder_name("our-rig_2.b") == "our-rig_2.b", "what is plain stays readable"


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [(("127.0.0.1:502", {}), ("localhost:502", {}), True), (("127.0.0.1:502", {}), ("127.0.0.1:503", {}), False),
     (("127.0.0.1:502", {"unit_id": 1}), ("127.0.0.1:502", {"map": {"unit_id": 2}}), False),
     (("127.0.0.1:502", {"unit_id": 1}), ("127.0.0.1:502", {"map": {}}), True),
     (("Dev1", {"server": "127.0.0.1:31763"}), ("Dev1", {}), False), (("Dev1", {}), ("Dev1", {"terminals": 1}), True),
     (("slcan:socket://127.0.0.1:1", {}), ("slcan:socket://127.0.0.1:2", {}), False), (("nobody.invalid:1", {}), ("nobody.invalid:1", {}), True)],
)  # fmt: skip
def test_one_device_has_one_place_however_it_is_written(one, other, same):
    assert (place(*one) == place(*other)) is same


def test_a_serial_port_is_known_behind_its_links(tmp_path):
    (tmp_path / "ttyUSB0").write_text("")
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB0")
    assert place(str(tmp_path / "by-id"), {}) == place(str(tmp_path / "ttyUSB0"), {}) == str(tmp_path / "ttyUSB0")
    assert place("", {}) == ""


TAKES = (
    "from pmabench.guard.station import Station\nstation = Station('one')\nstation.take()\n"
    "station.take_device('127.0.0.1:502 unit 1')\nstation.note('armed')\nprint('taken', flush=True)\ninput()"
)


def test_a_device_belongs_to_one_bench_at_a_time_and_a_latch_to_all_who_have_it():
    holder = subprocess.Popen([sys.executable, "-c", TAKES], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert holder.stdout.readline() == "taken\n"
    two = Station("二")
    two.take()
    two.take_device("127.0.0.1:503 unit 1")
    with pytest.raises(DeviceError, match=r"two of its devices are one, 127.0.0.1:503 unit 1"):
        two.take_device("127.0.0.1:503 unit 1")
    with pytest.raises(DeviceError, match=rf'is in use by the bench "one", process {holder.pid}'):
        two.take_device("127.0.0.1:502 unit 1")
    holder.kill()
    holder.communicate()
    Station("one").write("bench", {"name": "one"})
    with pytest.raises(DeviceError, match='belongs to the bench "one" too, which is tripped.*vent "one" --reset'):
        Station("three").take_device("127.0.0.1:502 unit 1")
    assert two.latched() == "", "no latch is shared"
    Station("one").note("safe", why="reset")
    assert Station("one").read("state")["devices"] == ["127.0.0.1:502 unit 1"]
    two.note("safe", why="end")
    assert Station("二").read("state")["devices"] == ["127.0.0.1:503 unit 1"]
    assert try_lock(root() / f"{folder_name('somewhere')}.device") is not None
    with pytest.raises(DeviceError, match="is in use by another program"):
        two.take_device("somewhere")


def test_a_folder_of_an_earlier_version_keeps_its_latch():
    before = root() / "Our-rig"
    before.mkdir(parents=True)
    (before / "bench.json").write_text('{"name": "Our rig"}')
    (before / "state.json").write_text('{"what": "tripped", "why": "burst", "since": "then"}')
    other = Station("Our-rig")
    other.take()
    assert other.latched() == ""
    station = Station("Our rig")
    station.take()
    assert station.latched() == "burst, then"
    assert not before.exists()
