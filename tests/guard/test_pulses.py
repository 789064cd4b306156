"""Valves that open in pulses: times, aims, never both of a muscle; and which benches with them are not armed."""

import math
from dataclasses import replace

import pytest

from pmabench.base.errors import LimitRefused
from pmabench.bench.interface import AimRecord, CompiledBench, SafeAction, TripRecord, ValveRecord
from pmabench.guard.guard import State
from tests.guard.rig import CHANNEL, DEVICE, armed, bench, opened

PRESSURES = ("pressure_1", "pressure_2")
SUPPLY = ValveRecord("supply_valve", "dac", "s", energised="open", safe="closed")
DUMP = ValveRecord("dump_valve", "dac", "d")
PAIRS = tuple(
    ValveRecord(f"{kind}_{i}", "dac", f"{kind[0]}{i}", "open", "closed", 0.02, f"{other}_{i}")
    for i in (1, 2)
    for kind, other in (("fill", "exhaust"), ("exhaust", "fill"))
)
SAFE = (
    SafeAction("close", "supply_valve", 0.0, 0.2),
    SafeAction("open", "dump_valve", 0.0, 0.2),
    *(SafeAction("confirm", name, 20e3, 1.0) for name in PRESSURES),
)
PULSED = bench(
    replace(
        DEVICE,
        channels=tuple(replace(CHANNEL, name=name, input=name) for name in PRESSURES),
        outputs=(),
        valves=(SUPPLY, DUMP, *PAIRS),
    ),
    trips=tuple(TripRecord(name, None, 650e3, 0.0, "vent") for name in PRESSURES),
    safe_state=SAFE,
    aims=(
        AimRecord("pressure_1", "pressure", 20e3, 550e3, "b:1:1"),
        AimRecord("pressure_2", "pressure", 20e3, 300e3, "b:2:2"),
        AimRecord("tilt", "angle", 0.0, math.radians(20), "b:3:3"),
    ),
    together="platform",
)
AIMS = {"pressure_1": 250e3, "pressure_2": 250e3, "tilt": 0.1}


def test_pulses_go_to_the_device_as_they_are():
    guard, rig = armed(PULSED)
    guard.steer(AIMS, {"fill_1": 0.00734, "exhaust_2": 0.02})
    assert rig.reported == [("pulse", "f1", 0.00734), ("pulse", "e2", 0.02)]


def test_while_armed_the_supply_is_on_and_all_other_valves_are_shut():
    guard, rig = opened(PULSED)
    guard.arm("run")
    assert rig.on == {"s": True, "d": True, "f1": False, "e1": False, "f2": False, "e2": False}
    guard.valves(closed=False)
    assert (rig.on["s"], rig.on["d"], rig.on["f1"]) == (False, False, False)


WRONG = {
    "a pressure above the limit of muscle 2 only": ({**AIMS, "pressure_2": 310e3}, {"fill_2": 0.01}, "310 kPa .*b:2:2"),
    "too low": ({**AIMS, "pressure_1": 10e3}, {"exhaust_1": 0.01}, "outside 20 kPa"),
    "no number": ({**AIMS, "pressure_1": math.nan}, {"fill_1": 0.01}, "outside"),
    "too steep": ({**AIMS, "tilt": math.radians(21)}, {"fill_1": 0.01}, "21 deg for tilt is outside .*b:3:3"),
    "an aim without a limit": ({**AIMS, "pressure_3": 2e5}, {"fill_1": 0.01}, 'no limit for "pressure_3"'),
    "no valve": (AIMS, {"fill_3": 0.01}, 'no valve "fill_3"'),
    "a valve that is switched": (AIMS, {"dump_valve": 0.01}, "does not open in pulses"),
    "too long": (AIMS, {"fill_1": 0.021}, "at most 0.02 s"),
    "for no time": (AIMS, {"fill_1": 0.0}, "cannot be opened for 0.0 s"),
    "for nan": (AIMS, {"fill_1": math.nan}, "cannot be opened for nan s"),
    "both at once": (AIMS, {"fill_1": 0.01, "exhaust_1": 0.01}, "air would blow through"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_outside_is_refused_and_nothing_is_opened(name):
    aims, pulses, says = WRONG[name]
    guard, rig = armed(PULSED)
    with pytest.raises(LimitRefused, match=says):
        guard.steer(aims, {"fill_2" if "fill_1" in pulses else "fill_1": 0.01} | pulses)
    assert rig.reported == []


def test_a_valve_opens_after_its_counterpart_has_shut_and_not_before():
    guard, rig = armed(PULSED)
    guard.steer(AIMS, {"fill_1": 0.005})
    guard.clock.wait_until(0.004)
    with pytest.raises(LimitRefused, match='"exhaust_1" is not opened while "fill_1" is open'):
        guard.steer(AIMS, {"exhaust_1": 0.005})
    guard.steer(AIMS, {"exhaust_2": 0.005})
    guard.clock.wait_until(0.005)
    guard.steer(AIMS, {"exhaust_1": 0.005})
    assert [reported[1] for reported in rig.reported] == ["f1", "e2", "e1"]


def test_before_the_bench_is_proven_aims_are_low():
    guard, _rig = armed(PULSED)
    guard.state = State.SETUP
    with pytest.raises(LimitRefused, match="250 kPa for pressure_1 is outside 20 kPa to 100 kPa"):
        guard.steer(AIMS, {"fill_1": 0.005})


def test_nothing_opens_once_the_safe_state_has_begun():
    guard, rig = armed(PULSED)
    vent = guard.safe_state(lambda: dict.fromkeys(PRESSURES, 5e3))
    assert vent.confirmed
    assert [reported for reported in rig.reported if reported[0] == "switch"][:2] == [
        ("switch", "s", False),
        ("switch", "d", False),
    ]
    with pytest.raises(LimitRefused, match="the bench is safe"):
        guard.steer(AIMS, {"fill_1": 0.005})


def test_supervision_asks_for_the_valves_that_stay_as_they_were_switched():
    guard, rig = armed(PULSED)
    for number in range(20):
        guard.supervision.look(0.5 * number)
    assert {reported[1] for reported in rig.values("is_on")} == {"s", "d"}


UNSAFE = {
    "no shut-off": ({"safe_state": SAFE[1:]}, "does not shut the supply first"),
    "dumps before the shut-off": ({"safe_state": (SAFE[1], SAFE[0], *SAFE[2:])}, "does not shut the supply first"),
    "a fill valve is no shut-off": (
        {"safe_state": (replace(SAFE[0], target="fill_1"), *SAFE[1:])}, "does not shut the supply first"),
    "no dump": ({"safe_state": (SAFE[0], *SAFE[2:])}, "opens no dump"),
    "an exhaust is no dump": ({"safe_state": (SAFE[0], replace(SAFE[1], target="exhaust_1"), *SAFE[2:])},
                              "opens no dump"),
    "a dump after a wait": ({"safe_state": (SAFE[0], SafeAction("hold", "", 0.0, 1.0), *SAFE[1:])}, "opens no dump"),
    "one pressure is not confirmed": ({"safe_state": SAFE[:3]}, "does not confirm that pressure_2"),
    "one pressure without a trip": ({"trips": PULSED.trips[:1]}, "no trip limit on pressure_2"),
    "no watch on all together": ({"together": ""}, "no watch compares"),
    "limits that are none": ({"aims": (replace(PULSED.aims[0], low=6e5), *PULSED.aims[1:])}, "make no sense"),
    "a limit that is no number": ({"aims": (replace(PULSED.aims[0], low=math.nan), *PULSED.aims[1:])}, "no sense"),
    "no upper limit": ({"aims": (replace(PULSED.aims[0], high=math.inf), *PULSED.aims[1:])}, "make no sense"),
    "a wait before the shut-off": ({"safe_state": (SafeAction("hold", "", 0.0, 1.0), *SAFE)}, "shut the supply first"),
}  # fmt: skip


@pytest.mark.parametrize("name", UNSAFE)
def test_a_bench_whose_air_cannot_be_taken_off_is_not_armed(name):
    changes, says = UNSAFE[name]
    guard, rig = opened(replace(PULSED, **changes))
    with pytest.raises(LimitRefused, match=says):
        guard.arm("run")
    assert rig.values("switch", "pulse") == []


@pytest.mark.parametrize(
    "changes",
    [{"never_with": ""}, {"never_with": "fill_1"}, {"longest": math.inf}, {"longest": -1.0}],
    ids=["no counterpart", "not each other's", "no longest time", "a time below zero"],
)
def test_a_valve_without_longest_time_or_counterpart_is_not_armed(changes):
    valves = tuple(replace(v, **changes) if v.name == "fill_2" else v for v in (*PAIRS, SUPPLY, DUMP))
    guard, _rig = opened(replace(PULSED, devices=(replace(PULSED.devices[0], valves=valves),)))
    with pytest.raises(LimitRefused, match="needs a longest time and the other valve of its muscle"):
        guard.arm("run")


def test_a_compiled_bench_goes_through_json_with_its_pulses():
    assert CompiledBench.from_json(PULSED.to_json()) == PULSED
