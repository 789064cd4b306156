"""What is not armed: benches that cannot be made safe, devices that say something else, limits that are none (P4, P21)."""

import json
import math
from dataclasses import replace

import pytest

from pmabench.base.clock import VirtualClock
from pmabench.base.errors import DeviceError, LimitRefused
from pmabench.bench.interface import CompiledBench, DeviceRecord, ProofTest, SafeAction, Scale, TripRecord
from pmabench.guard.guard import Guard, State
from tests.guard.rig import BENCH, DEVICE, DRIVE, OUTPUT, SAFE, Plain, Rig, armed, bench, opened

NONE = [math.nan, math.inf, -math.inf]


def refused(made, match):
    guard, rig = opened(made)
    with pytest.raises(LimitRefused, match=match):
        guard.arm()
    assert guard.state is State.DISARMED
    assert rig.values("write", "switch", "follow") == []


@pytest.mark.parametrize("value", NONE)
@pytest.mark.parametrize("key", ["low", "high", "safe", "rate", "resolution"])
def test_a_limit_that_is_no_number_is_not_armed(key, value):
    refused(bench(replace(DEVICE, outputs=(replace(OUTPUT, **{key: value}), DRIVE))), '"pressure" make no sense')


@pytest.mark.parametrize(
    "wrong",
    [{"low": 600e3, "high": 0.0}, {"low": 0.0, "high": 0.0}, {"scale": Scale(0.0, 0.0)}, {"scale": Scale(math.nan)},
     {"scale": Scale(1.0, math.inf)}, {"rate": -1.0}, {"resolution": -1.0}, {"safe": 700e3}, {"safe": -1.0}],
)  # fmt: skip
def test_limits_that_contradict_each_other_are_not_armed(wrong):
    refused(bench(replace(DEVICE, outputs=(replace(OUTPUT, **wrong), DRIVE))), "make no sense")


@pytest.mark.parametrize("value", NONE)
@pytest.mark.parametrize("key", ["setup_pressure", "stop_rate", "hands_below", "hands_at_pressure"])
def test_a_pressure_of_the_bench_that_is_no_number_is_not_armed(key, value):
    refused(bench(**{key: value}), "is no number")


@pytest.mark.parametrize("value", NONE)
@pytest.mark.parametrize("key", ["low", "high", "delay", "window"])
def test_a_trip_limit_that_is_no_number_is_not_armed(key, value):
    trip = replace(BENCH.trips[0], **{key: value})
    refused(bench(trips=(BENCH.trips[0], trip)), 'the trip limit on "pressure" is no number')


@pytest.mark.parametrize(
    "trips",
    [(), (TripRecord("force", None, 1.0, 0.0, "vent"),), (TripRecord("pressure", None, None, 0.2, "vent", kind="stale"),),
     (TripRecord("pressure", None, 650e3, 0.0, "warn"),), (TripRecord("pressure", -1e3, None, 0.0, "vent"),)],
)  # fmt: skip
def test_a_bench_that_nothing_ends_above_a_pressure_is_not_armed(trips):
    refused(bench(trips=trips), "no trip limit on pressure")


@pytest.mark.parametrize(
    "action",
    [SafeAction("set", "presure", 0.0, 0.2), SafeAction("open", "pressure", 0.0, 0.2), SafeAction("stop", "nothing", 0.0, 1.0),
     SafeAction("set", "pressure", math.nan, 0.2), SafeAction("ramp", "pressure", 0.0, 1.0, 0.0),
     SafeAction("ramp", "pressure", 0.0, 1.0, math.inf), SafeAction("hold", "", 0.0, math.nan),
     SafeAction("confirm", "pressure", math.nan, 1.0), SafeAction("confirm", "pressure", 20e3, math.inf)],
)  # fmt: skip
def test_a_safe_state_that_cannot_work_is_not_armed(action):
    refused(bench(safe_state=(*SAFE, action)), "makes no sense")


def test_a_safe_state_beyond_the_limits_is_not_armed():
    refused(bench(safe_state=(SafeAction("ramp", "pressure", 700e3, 1.0, 1e3),)), "beyond its limits")


def test_the_same_bench_through_json_is_refused_too():
    text = BENCH.to_json().replace("600000.0", "NaN")
    refused(CompiledBench.from_json(text), "make no sense")
    assert json.loads(BENCH.to_json())["name"] == CompiledBench.from_json(BENCH.to_json()).name


def test_a_sound_bench_is_armed_in_order():
    guard, rig = opened()
    guard.arm("run")
    assert rig.reported[1:] == [
        ("arm_watchdog", 1.0), ("level", "in0"), ("write", "p", 0.0), ("read_back", "p"), ("write", "x", 0.0),
        ("read_back", "x"), ("switch", "v", True), ("held",),
    ]  # fmt: skip
    assert guard.state is State.RUNNING
    assert guard.run == "run"


@pytest.mark.parametrize("reported", [0.0, 2.0, math.nan, -1.0])
def test_a_watchdog_that_says_another_time_is_not_armed(reported):
    guard, rig = opened()
    rig.promised = reported
    with pytest.raises(DeviceError, match="watchdog says"):
        guard.arm()
    assert rig.values("write") == []


def test_an_output_that_holds_something_else_is_not_armed():
    guard, rig = opened()
    rig.read_back = lambda output: 40.0
    with pytest.raises(DeviceError, match="holds 40 after 0 was sent"):
        guard.arm()
    assert guard.state is State.DISARMED


def test_an_open_interlock_is_not_armed():
    guard, rig = opened()
    rig.high = False
    with pytest.raises(LimitRefused, match=r'the interlock "e-stop" is open \(dac.in0\)'):
        guard.arm()
    assert rig.values("write") == []


PLAIN = f"{Plain.__module__}:Plain"


@pytest.mark.parametrize(
    ("left", "match"),
    [(("outputs",), "takes no set-points"), (("watchdog",), "has no watchdog"), (("interlocks",), "no digital inputs"),
     (("valves",), "switches no valves")],
)  # fmt: skip
def test_a_device_that_cannot_do_what_the_bench_says_is_not_armed(left, match):
    empty = {"outputs": (), "valves": (), "interlocks": (), "watchdog": 0.0, "channels": ()}
    plain = replace(DEVICE, driver=PLAIN, **{key: value for key, value in empty.items() if key not in left})
    guard = Guard(bench(plain, safe_state=()), VirtualClock())
    guard.open()
    with pytest.raises(DeviceError, match=match):
        guard.arm()


def test_it_is_armed_once():
    guard, _ = armed()
    with pytest.raises(LimitRefused, match="running: it cannot be armed"):
        guard.arm()
    guard.safe_state(dict)
    with pytest.raises(LimitRefused, match="safe: it cannot be armed"):
        guard.arm()


def test_before_the_proof_only_low_pressure_passes():
    guard, rig = armed(bench(proof=ProofTest(50e3, 20e3, 1.0), setup_pressure=100e3))
    assert guard.state is State.SETUP
    guard.set("pressure", 100e3)
    for command in (
        lambda: guard.set("pressure", 101e3),
        lambda: guard.ramp("pressure", 0.0, 200e3, 1e3),
        lambda: guard.ramp("pressure", 200e3, 0.0, 1e3),
        lambda: guard.sine("pressure", 90e3, 20e3, 1.0, 1.0),
    ):
        with pytest.raises(LimitRefused, match="not proven yet"):
            command()
    guard.set("displacement", 40e-3)
    guard.release()
    guard.set("pressure", 300e3)
    assert [value for _, name, value in rig.values("write") if name == "p"] == [666.0, 2000.0]
    with pytest.raises(LimitRefused, match="cannot be released"):
        guard.release()


@pytest.mark.parametrize("driver", ["tests.guard.rig:Nothing", "no_such:Rig"])
def test_a_driver_that_is_none_is_reported(driver):
    with pytest.raises(DeviceError, match="cannot be loaded"):
        Guard(bench(DeviceRecord("dac", driver)), VirtualClock()).open()


def test_a_class_that_is_no_device_is_reported():
    with pytest.raises(DeviceError, match="does not implement"):
        Guard(bench(DeviceRecord("dac", f"{__name__}:NoDevice")), VirtualClock()).open()


class NoDevice:
    def __init__(self, device, clock):
        pass


def test_devices_that_are_open_are_closed_when_another_does_not_open():
    other = DeviceRecord("other", DEVICE.driver, options={"wrong": {"open": "no answer"}})
    guard = Guard(bench(devices=(DEVICE, other)), VirtualClock())
    with pytest.raises(DeviceError, match="other: no answer"):
        guard.open()
    assert Rig.made["dac"].reported == [("open",), ("close",)]
    assert guard.devices == {}
