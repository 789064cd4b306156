"""`pmabench vent` without a bench: none waits for another, one with a guard goes first, and a failure hides none."""

import threading

import pytest

from pmabench.base.errors import DeviceError
from pmabench.cli import vent
from pmabench.cli.vent import Vented

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
        return reported(station.name)

    monkeypatch.setattr(vent, "_vent", one)
    found = [(Bench("dead", guard=False), {}), (Bench("live", guard=True), {})]
    assert [item.bench for item in vent._all_at_once(None, found, 0.0)] == ["dead", "live"]
    assert began[0] == "live"


def test_what_fails_is_raised_after_all_others_were_vented(monkeypatch, capsys):
    def one(_ui, station, _saved, _began):
        if station.name == "a":
            raise DeviceError("plant", "its driver cannot be loaded")
        return reported(station.name)

    monkeypatch.setattr(vent, "_vent", one)
    with pytest.raises(DeviceError, match="cannot be loaded"):
        vent._all_at_once(None, [(Bench("a", guard=False), {}), (Bench("b", guard=False), {})], 0.0)
    assert "b: confirmed" in capsys.readouterr().out
