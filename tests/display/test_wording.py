"""Events of sessions as sentences, with the units that people read."""

import pytest

from pmabench.display.wording import event_text
from pmabench.store.records import Event

CHECKS = [
    {"name": "interlocks", "value": "e-stop closed", "limit": "all closed", "verdict": "ok", "hint": ""},
    {"name": "leak", "value": "", "limit": "", "verdict": "not measured", "hint": "no isolation valve"},
]
WRONG = {
    "name": "force at rest",
    "value": "40 N",
    "limit": "within 5 N",
    "verdict": "failed",
    "hint": "look at the cell",
}


@pytest.mark.parametrize(
    ("kind", "data", "reported", "level"),
    [
        ("session", {"skipped": {}, "shortened": []}, "session", "info"),
        (
            "session",
            {"skipped": {"warm-up": "warm already"}, "shortened": ["no self-test"]},
            "session: warm-up skipped because warm already; no self-test",
            "doubt",
        ),
        ("self-test", {"checks": CHECKS}, "self-test: 1 ok, 1 not measured", "info"),
        (
            "self-test",
            {"checks": [*CHECKS, WRONG]},
            "self-test: 1 ok, 1 not measured, 1 failed; force at rest: 40 N, look at the cell",
            "fault",
        ),
        ("warm-up", {"duration": 600.0, "pressure": 3e5}, "warm-up: cycles to 300 kPa for 10 min 00 s", "info"),
        (
            "zeros",
            {"channels": {"pressure": {"value": 1250.0, "noise": 3.0}, "displacement": {"value": -2e-5}}},
            "zeros taken: pressure 1.25 kPa, displacement -0.02 mm",
            "info",
        ),
        (
            "zero-check",
            {"channels": {"pressure": {"value": 1e3, "drift": -500.0, "limit": 5e3}}},
            "zeros have drifted by pressure -0.5 kPa",
            "info",
        ),
        (
            "proof-test",
            {"pressure": 5e4, "filled_in": 0.1921, "dump_valve_in": 0.0413, "vented_in": 0.08225},
            "proof test of the vent path: filled to 50 kPa in 0.19 s, gives way to the dump valve in 0.041 s, empty "
            "0.082 s after venting",
            "info",
        ),
    ],
)
def test_what_an_event_says(kind, data, reported, level):
    assert event_text(Event(1, 2.0, kind, data)) == (reported, level)


def test_every_coordinate_with_a_unit_is_shown_with_it():
    from pmabench.display.wording import POINT, point_text
    from pmabench.store.analyses.results import POINT_QUANTITIES

    counts = {"cycles", "side"}
    assert {*POINT_QUANTITIES} - {*POINT} - counts == {"displacement", "angle"}  # places in a trial, of no trial
    assert point_text({"step": 0.005, "start": 0.01, "from": 1e5}) == "step 5 mm, start 10 mm, from 100 kPa"
