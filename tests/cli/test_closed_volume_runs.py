"""A closed volume end to end on the simulated muscle in virtual time: run, process, report (docs/papers.md, rows 38-40)."""

import json

import pytest

from tests.calls import call


def test_a_closed_muscle_shows_its_volume(tmp_path):
    """Papers digest 5.5: V from 62.8 cm3 at no contraction, 147.0 cm3 at 18 %."""
    sets = ("--set", "sweep.repeat.count=1", "--set", "trial.speed=6 mm/s", "--set", "prepare.precondition.cycles=0")
    bench = ("--bench", "mock-daerden-closed", "--specimen", "daerden-20-200")
    call("run", "closed-volume", *bench, "--yes", "--out", tmp_path / "runs", *sets)
    (run,) = (tmp_path / "runs").glob("2*")
    events = [json.loads(line) for line in (run / "events.jsonl").read_text().splitlines()]
    searches = [e["data"]["result"] for e in events if e["kind"] == "found"]
    switched = [(e["data"]["valve"], e["data"]["position"], e["t"]) for e in events if e["kind"] == "valve"]
    reported = [(way, result[at]) for result in searches for way, at in (("closed", "shut"), ("open", "opened"))]
    assert len(searches) == 2
    assert switched == [("isolation_valve", way, pytest.approx(t, abs=1e-3)) for way, t in reported]
    call("process", run)
    (found,) = (tmp_path / "analyses").rglob("analysis.json")
    reported = [e for e in json.loads(found.read_text())["estimates"] if e["symbol"] == "V"]
    ends = [e["value"] for e in reported if e["at"]["contraction"] == pytest.approx(0.036)]
    assert len(ends) == 4, "two pressures, two methods"
    assert ends == pytest.approx([147.03e-6] * 4, rel=2e-3)
    page = tmp_path / "report.html"
    call("report", run, "-o", page)
    assert "Volume over contraction" in page.read_text()


def test_check_refuses_a_room_without_pressure():
    result = call("check", "closed-volume", "--bench", "mock-daerden-closed", "--specimen", "daerden-20-200",
                  "--set", "trial.room={pressure: 0 kPa, uncertainty: 1 kPa}", code=3)  # fmt: skip
    assert "never with gauge pressure" in result.output
