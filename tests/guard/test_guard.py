"""Nothing outside limits is ever commanded (S1), and the safe state is run once, in order, whatever fails (S3, S5)."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmabench.base.clock import VirtualClock
from pmabench.base.errors import DeviceError, LimitRefused
from pmabench.bench.interface import CompiledBench, DeviceRecord, Identity, OutputRecord, SafeAction, Scale, TripRecord
from pmabench.guard.guard import Guard, State


class Recording:
    """A device that writes down what it is told."""

    broken: tuple[str, ...] = ()

    def __init__(self, device, clock):
        self.reported: list[tuple[str, str, float]] = []
        self.holds: dict[str, float] = {}

    def open(self):
        return Identity("test", "recording", "1", "0", simulated=True)

    def close(self):
        self.reported.append(("close", "", 0.0))

    def write(self, output, value):
        if output in self.broken:
            raise DeviceError("dac", "does not answer", output)
        self.reported.append(("write", output, value))
        self.holds[output] = value

    def read_back(self, output):
        return self.holds[output]

    def follow(self, output, segment):
        ends = [segment.origin - abs(segment.amplitude), segment.origin + abs(segment.amplitude)]
        if segment.kind == "ramp":
            ends.append(segment.target)
        self.reported.extend(("follow", output, end) for end in ends)


class OneBroken(Recording):
    broken = ("displacement",)


def output(name="pressure", slope=600e3 / 4095, offset=0.0, resolution=1.0, **changes):
    record = OutputRecord(
        name, "pressure", "dac", name, Scale(slope, offset), resolution, 0.0, 0.0, 600e3, "a:1:1", "b:2:2"
    )
    return replace(record, **changes)


def bench(*outputs, driver="Recording", **changes):
    made = CompiledBench(
        name="test bench",
        simulated=True,
        realtime=False,
        free_end="weights",
        devices=(DeviceRecord("dac", f"{__name__}:{driver}", outputs=outputs or (output(),)),),
        trips=(TripRecord("pressure", None, 650e3, 0.0, "vent"),),
        safe_state=(SafeAction("set", "pressure", 0.0, 0.2), SafeAction("confirm", "pressure", 20e3, 1.0)),
        hands_below=20e3,
    )
    return replace(made, **changes)


def armed(made=None):
    guard = Guard(made or bench(), VirtualClock())
    guard.open()
    guard.arm()
    return guard


def reported(guard):
    return guard.devices["dac"].reported


def test_arming_drives_every_output_to_its_safe_value_first():
    guard = Guard(bench(), VirtualClock())
    guard.open()
    with pytest.raises(LimitRefused, match="disarmed"):
        guard.set("pressure", 1000.0)
    guard.arm()
    assert reported(guard) == [("write", "pressure", 0.0)]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 600e3 + 1, -1.0, 1e308])
def test_a_value_outside_is_refused_and_nothing_is_sent(value):
    guard = armed()
    before = list(reported(guard))
    with pytest.raises(LimitRefused):
        guard.set("pressure", value)
    with pytest.raises(LimitRefused):
        guard.ramp("pressure", 0.0, value, 1000.0)
    with pytest.raises(LimitRefused):
        guard.sine("pressure", value, 10.0, 1.0, 1.0)
    assert reported(guard) == before


def test_the_limit_and_who_set_it_are_named():
    with pytest.raises(LimitRefused, match=r"700 kPa for pressure is outside 0 kPa \(a:1:1\) to 600 kPa \(b:2:2\)"):
        armed().set("pressure", 700e3)


def test_a_sine_is_checked_at_its_crests():
    with pytest.raises(LimitRefused):
        armed().sine("pressure", 550e3, 100e3, 1.0, 3)


@settings(max_examples=500, deadline=None)
@given(
    value=st.floats(0.0, 600e3),
    slope=st.one_of(st.floats(1e-3, 1e5), st.floats(-1e5, -1e-3)),
    offset=st.floats(-1e5, 1e5),
    resolution=st.one_of(st.just(0.0), st.floats(1e-3, 50.0)),
)
def test_the_value_that_the_device_gets_lies_inside_after_rounding(value, slope, offset, resolution):
    record = output(slope=slope, offset=offset, resolution=resolution)
    guard = armed(bench(record, safe_state=()))
    reported(guard).clear()
    try:
        guard.set("pressure", value)
    except LimitRefused:
        assert not reported(guard)
        return
    sent = reported(guard)[-1][2] * slope + offset
    assert -resolution * abs(slope) - 1e-3 <= sent <= 600e3 * (1 + 2e-9)
    assert sent <= value + 1e-6 * (abs(value) + 2 * resolution * abs(slope)) + 1e-3, "rounded away from the safe side"


@settings(max_examples=500, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from(["set", "ramp", "sine"]), st.floats(), st.floats(), st.floats(), st.floats()),
        max_size=8,
    )
)
def test_no_sequence_of_hostile_commands_gets_past(commands):
    guard = armed()
    for kind, a, b, c, d in commands:
        try:
            if kind == "set":
                guard.set("pressure", a)
            elif kind == "ramp":
                guard.ramp("pressure", a, b, c)
            else:
                guard.sine("pressure", a, b, c, d)
        except LimitRefused:
            continue
    slope = 600e3 / 4095
    for _, _, raw in reported(guard):
        assert -1e-3 <= raw * slope <= 600e3 * (1 + 1e-8)


@pytest.mark.parametrize(
    "changes", [{"low": 600e3}, {"high": math.nan}, {"high": math.inf}, {"low": 700e3}, {"scale": Scale(0.0, 0.0)}]
)
def test_limits_that_make_no_sense_do_not_arm(changes):
    guard = Guard(bench(output(**changes)), VirtualClock())
    guard.open()
    with pytest.raises(LimitRefused, match="not armed"):
        guard.arm()
    assert guard.state is State.DISARMED


def test_no_trip_limit_on_pressure_does_not_arm():
    guard = Guard(bench(trips=()), VirtualClock())
    guard.open()
    with pytest.raises(LimitRefused, match="no trip limit"):
        guard.arm()


def falling(guard, values):
    readings = iter(values)

    def measure():
        guard.clock.wait_until(guard.clock.now() + 0.1)
        return {"pressure": next(readings)}

    return measure


def test_the_vent_is_confirmed_by_the_measured_pressure():
    guard = armed()
    guard.set("pressure", 300e3)
    vent = guard.safe_state(falling(guard, [200e3, 50e3, *[10e3] * 9]))
    assert vent.confirmed
    assert reported(guard)[-1] == ("write", "pressure", 0.0)
    assert guard.state is State.SAFE


def test_a_vent_that_is_not_confirmed_is_commanded_only():
    guard = armed()
    assert guard.safe_state(falling(guard, [200e3] * 99)).result == "commanded"


def test_a_measurement_that_fails_does_not_stop_the_vent():
    guard = armed()
    guard.set("pressure", 300e3)

    def measure():
        raise DeviceError("adc", "does not answer")

    assert guard.safe_state(measure).result == "commanded"
    assert reported(guard)[-1] == ("write", "pressure", 0.0)


def test_a_failed_action_does_not_stop_the_next():
    both = (output("displacement"), output())
    actions = (SafeAction("set", "displacement", 0.0, 0.2), SafeAction("set", "pressure", 0.0, 0.2))
    guard = Guard(bench(*both, driver="OneBroken", safe_state=actions), VirtualClock())
    guard.open()
    guard.state = State.RUNNING
    vent = guard.safe_state(dict)
    assert vent.result == "failed"
    assert reported(guard)[-1] == ("write", "pressure", 0.0)


def test_after_the_safe_state_nothing_is_commanded_and_a_second_call_only_repeats_it():
    guard = armed()
    first = guard.safe_state(falling(guard, [0.0]))
    with pytest.raises(LimitRefused, match="safe"):
        guard.set("pressure", 1000.0)
    assert guard.safe_state(dict) is first
    assert guard.safe_state(dict, tripped=True) is first
    assert guard.state is State.TRIPPED


def test_closing_twice_is_harmless():
    guard = armed()
    guard.close()
    guard.close()


def test_a_driver_that_is_not_there_is_a_device_error():
    record = DeviceRecord("dac", "no_such_module:Nothing")
    with pytest.raises(DeviceError, match="cannot be loaded"):
        Guard(bench(devices=(record,)), VirtualClock()).open()


def test_a_driven_end_starts_where_it_is():
    guard = armed(bench(output("displacement", rate=1e5), output()))
    with pytest.raises(LimitRefused, match="cannot jump"):
        guard.ramp("displacement", 300e3, 0.0, 1e4)
    guard.ramp("displacement", 0.0, 300e3, 1e4)
    with pytest.raises(LimitRefused, match="cannot jump"):
        guard.sine("displacement", 300e3, 1e3, 0.5, 2)  # it is not there yet
    guard.clock.wait_until(guard.clock.now() + 30.0)
    guard.sine("displacement", 300e3, 1e3, 0.5, 2)
    guard.clock.wait_until(guard.clock.now() + 4.0)
    with pytest.raises(LimitRefused, match="cannot jump"):
        guard.sine("displacement", 100e3, 1e3, 0.5, 2)


def test_a_safe_state_beyond_the_limits_does_not_arm():
    guard = Guard(bench(safe_state=(SafeAction("set", "pressure", 900e3, 0.2),)), VirtualClock())
    guard.open()
    with pytest.raises(LimitRefused, match="beyond its limits"):
        guard.arm()
