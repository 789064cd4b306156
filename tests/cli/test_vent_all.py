"""`pmabench vent` without a bench: none waits for another, one with a guard goes first, and a failure hides none."""

import os
import socket
import threading
from types import SimpleNamespace

import pytest

from pmabench.base.errors import DeviceError, LimitRefused
from pmabench.base.system import try_lock
from pmabench.cli import vent
from pmabench.cli.vent import Vented
from pmabench.guard.station import Station, folder_name, root

PATIENCE = 30.0


class Bench:
    """Where a bench keeps its state: only whether a guard is there is asked."""

    def __init__(self, name, guard):
        self.name, self._guard = name, guard

    def read(self, _what):
        return {"port": 1} if self._guard else {}


def reported(name):
    return Vented(name, "here", "confirmed", ("set pressure: sent",), 0.0)


def test_a_bench_that_hangs_holds_no_other_up(monkeypatch):
    vented = threading.Event()
    began = []

    def one(_ui, station, _saved, _began):
        began.append(station.name)
        if station.name == "live":
            vented.set()
        assert vented.wait(PATIENCE), "the bench in use waited for the dead one"
        yield reported(station.name)

    monkeypatch.setattr(vent, "_vent", one)
    found = [(Bench("dead", guard=False), {}), (Bench("live", guard=True), {})]
    assert [item.bench for item in vent._all_at_once(None, found, 0.0)] == ["dead", "live"]
    assert began[0] == "live"


def test_what_fails_is_raised_after_all_others_were_vented(monkeypatch, capsys):
    def one(_ui, station, _saved, _began):
        if station.name == "a":
            yield reported("another on the way")
            raise DeviceError("plant", "its driver cannot be loaded")
        yield reported(station.name)

    monkeypatch.setattr(vent, "_vent", one)
    with pytest.raises(DeviceError, match="cannot be loaded"):
        vent._all_at_once(None, [(Bench("a", guard=False), {}), (Bench("b", guard=False), {})], 0.0)
    assert "another on the way: confirmed, by here\n  set pressure: sent\nb: confirmed" in capsys.readouterr().out


def saved(name, *ports):
    return {"name": name, "devices": [{"address": f"127.0.0.1:{port}", "options": {}} for port in ports]}


@pytest.fixture
def in_use(monkeypatch, tmp_path):
    """A bench "first rig" with a guard and two devices, which are locked; the test may end the locks."""
    monkeypatch.setenv("PMABENCH_STATE", str(tmp_path))
    first = Station("first rig")
    first.folder.mkdir(parents=True)
    first.write("guard", {"port": 1, "token": "ab" * 32})
    first.write("bench", saved("first rig", 5020, 5021))
    locks = []
    for port in (5020, 5021):
        path = root() / f"{folder_name(f'127.0.0.1:{port} unit 1')}.device"
        path.write_text('the bench "first rig", process 7\n')
        locks.append(try_lock(path))
    yield locks
    for lock in locks:
        os.close(lock)


@pytest.mark.parametrize(
    ("ports", "answers", "asked", "way"),
    [
        ((5020,), True, ["first rig"], 'its guard (of "first rig", which has its devices)'),
        ((5020,), False, ["first rig", "direct first rig"], 'opened (of "first rig", which has its devices)'),
        ((5020, 5022), True, ["first rig", "direct second rig"], "opened"),
        ((5022,), True, ["direct second rig"], "opened"),
    ],
)
def test_the_guard_of_another_bench_that_has_the_devices_vents_them(monkeypatch, in_use, ports, answers, asked, way):
    """Nobody else can reach them; what that bench has not is vented afterwards, and both are reported."""
    reached = []

    def by_guard(_ui, station, about, _began):
        if not station.read("guard"):
            return None
        reached.append(about["name"])
        return Vented(about["name"], "its guard", "confirmed", (), 0.0) if answers else None

    def directly(_station, about, _began):
        reached.append(f"direct {about['name']}")
        return Vented(about["name"], "opened", "confirmed", (), 0.0)

    monkeypatch.setattr(vent, "_by_guard", by_guard)
    monkeypatch.setattr(vent, "_directly", directly)
    *before, vented = vent._vent(None, Station("second rig"), saved("second rig", *ports), 0.0)
    assert reached == asked
    assert (vented.bench, vented.way) == ("second rig", way)
    assert [item.bench for item in before] == [name for name in asked[:-1] if asked[-1] == "direct second rig"]


def test_an_error_of_another_bench_hinders_no_vent(monkeypatch, in_use):
    noted = []

    def directly(_station, about, _began):
        if about["name"] == "first rig":
            raise DeviceError("plant", "its driver cannot be loaded")
        return reported(about["name"])

    monkeypatch.setattr(vent, "_by_guard", lambda *_: None)
    monkeypatch.setattr(vent, "_directly", directly)
    ui = SimpleNamespace(note=noted.append)
    assert list(vent._vent(ui, Station("second rig"), saved("second rig", 5020), 0.0)) == [reported("second rig")]
    assert ["cannot be loaded" in text for text in noted] == [True]
    Station("first rig").write("bench", {"devices": [{"where": "of another version"}]})
    assert list(vent._vent(ui, Station("second rig"), saved("second rig", 5020), 0.0)) == [reported("second rig")]


def test_no_host_name_of_another_bench_is_looked_up_before_a_vent(monkeypatch, in_use):
    """That takes seconds without a name server; what was looked up when that bench was armed is kept."""
    first = Station("first rig")
    first.write("bench", {"name": "first rig", "devices": [{"address": "rig.lab:5020", "options": {}}]})
    first.write("state", {"devices": ["127.0.0.1:5020 unit 1"]})
    asked = []
    monkeypatch.setattr(socket, "gethostbyname", lambda host: asked.append(host) or host)
    monkeypatch.setattr(vent, "_by_guard", lambda _ui, s, about, _: reported("first") if s.read("guard") else None)
    (vented,) = vent._vent(None, Station("second rig"), saved("second rig", 5020), 0.0)
    assert 'of "first"' in vented.way
    assert asked == ["127.0.0.1"]


def test_a_bench_is_not_reset_while_a_program_has_its_device(monkeypatch, in_use):
    monkeypatch.setattr(vent, "ENDS_WITHIN", 0.0)
    second = Station("second rig")
    second.folder.mkdir(parents=True)
    second.note("tripped", why="burst")
    with pytest.raises(LimitRefused, match='127.0.0.1:5021 unit 1 is in use by the bench "first rig", process 7'):
        vent._reset(second, saved("second rig", 5021), "me", "looked")
    assert second.latched().startswith("burst")
    os.close(in_use.pop())
    assert vent._reset(second, saved("second rig", 5021), "me", "looked").startswith("burst")
    assert second.latched() == ""
