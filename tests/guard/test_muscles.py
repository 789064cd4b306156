"""Several muscles on one bench: the guard checks each pressure against its own limit, vents and confirms every one."""

from dataclasses import replace

import pytest

from pmabench.base.errors import LimitRefused
from pmabench.bench.interface import SafeAction, TripRecord
from tests.guard.rig import CHANNEL, DEVICE, OUTPUT, VALVE, armed, bench, opened

NAMES = ("pressure_1", "pressure_2")
HIGHEST = {"pressure_1": 600e3, "pressure_2": 400e3}
OUTPUTS = tuple(replace(OUTPUT, name=name, output=name, high=HIGHEST[name]) for name in NAMES)
SAFE = (
    *(SafeAction("set", name, 0.0, 0.2) for name in NAMES),
    SafeAction("open", "dump_valve", 0.0, 0.2),
    *(SafeAction("confirm", name, 20e3, 1.0) for name in NAMES),
)
PAIR = bench(
    replace(
        DEVICE,
        channels=tuple(replace(CHANNEL, name=name, input=name) for name in NAMES),
        outputs=OUTPUTS,
        valves=(VALVE,),
    ),
    trips=tuple(TripRecord(name, None, HIGHEST[name] + 50e3, 0.0, "vent") for name in NAMES),
    safe_state=SAFE,
)


def test_each_pressure_has_its_own_limit():
    guard, rig = armed(PAIR)
    guard.set("pressure_1", 500e3)
    with pytest.raises(LimitRefused, match="500 kPa for pressure_2 is outside"):
        guard.set("pressure_2", 500e3)
    with pytest.raises(LimitRefused, match="pressure_2"):
        guard.ramp("pressure_2", 0.0, 500e3, 50e3)
    assert [reported[1] for reported in rig.values("write", "follow")] == ["pressure_1"]


def test_a_pair_without_a_trip_on_its_second_muscle_is_not_armed():
    guard, _rig = opened(replace(PAIR, trips=PAIR.trips[:1]))
    with pytest.raises(LimitRefused, match="no trip limit on pressure_2"):
        guard.arm()


def test_the_safe_state_sends_both_down_before_it_asks_or_waits_for_anything():
    guard, rig = armed(PAIR)
    guard.set("pressure_1", 300e3)
    guard.set("pressure_2", 300e3)
    rig.reported.clear()
    vent = guard.safe_state(lambda: dict.fromkeys(NAMES, 5e3))
    assert rig.reported[:3] == [("write", "pressure_1", 0.0), ("write", "pressure_2", 0.0), ("switch", "v", False)]
    assert vent.confirmed
    assert vent.actions[-2:] == (
        "confirm pressure_1: 5 kPa, below 20 kPa",
        "confirm pressure_2: 5 kPa, below 20 kPa",
    )


@pytest.mark.parametrize("stays", NAMES)
def test_one_of_two_muscles_that_does_not_vent_is_no_confirmed_vent(stays):
    guard, _rig = armed(PAIR)
    guard.set("pressure_1", 300e3)
    guard.set("pressure_2", 300e3)
    vent = guard.safe_state(lambda: {**dict.fromkeys(NAMES, 5e3), stays: 300e3})
    assert not vent.confirmed
    assert vent.result == "commanded"
    assert any(text.startswith(f"confirm {stays}: 300 kPa, not below 20 kPa") for text in vent.actions)


def test_one_muscle_that_is_not_measured_is_no_confirmed_vent():
    guard, _rig = armed(PAIR)
    assert guard.safe_state(lambda: {"pressure_1": 5e3}).result == "commanded"
