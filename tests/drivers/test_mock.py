"""The mock bench through the driver interface: what it samples, when, in which units, and what it refuses."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pmabench_drivers.mock import MockBench

from pmabench.base.clock import VirtualClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import (
    ChannelRecord,
    Device,
    DeviceRecord,
    Follower,
    Hands,
    Inputs,
    Load,
    Motion,
    Scale,
    Segment,
    SetPoint,
    Stream,
    Switch,
)
from tests.drivers.rig import COUNTS, Rig, record


def test_it_has_every_capability():
    mock = MockBench(record(), VirtualClock())
    for capability in (Device, Stream, SetPoint, Follower, Hands, Switch, Inputs, Motion):
        assert isinstance(mock, capability)
    assert mock.open().simulated


def test_samples_are_due_at_whole_multiples_of_the_period():
    rig = Rig(record(), rate=300.0)
    rig.wait(1.0, block=0.07)
    assert rig.time == [round(k * 1e9 / 300) for k in range(301)]


def test_nothing_is_due_twice_and_nothing_when_stopped():
    rig = Rig(record())
    rig.wait(0.1)
    assert len(rig.mock.collect().time) == 0
    rig.mock.stop()
    rig.clock.wait_until(0.2)
    block = rig.mock.collect()
    assert len(block.time) == 0
    assert set(block.columns) == set(rig.columns)
    rig.mock.start(1000.0)
    rig.clock.wait_until(0.21)
    assert list(rig.mock.collect().time) == [200_000_000 + k * 1_000_000 for k in range(11)]


@pytest.mark.parametrize("block", [1.0, 0.05, 0.002])
def test_a_step_on_the_ideal_bench_is_the_exponential_of_the_paper(block):
    rig = Rig(record())
    rig.mock.place(Load(58.86, 0.01))
    rig.wait(0.1)
    rig.pressure(300)
    rig.wait(3.0, block)
    t = np.array(rig.time) * 1e-9 - 0.14
    expected = np.where(t < 0, 0, (275 - 58.86) / 6773 * (1 - np.exp(-t / (1680 / 6773))))
    np.testing.assert_allclose(rig.array("displacement"), expected, atol=20e-6)
    assert rig.array("pressure")[t < -1e-9].max() == 0
    assert rig.array("pressure")[t > -1e-9].tolist() == pytest.approx([300e3] * int((t > -1e-9).sum()))
    assert rig.array("force")[-1] == pytest.approx(58.86, abs=1e-3)


def test_set_points_are_those_held_at_each_sample():
    rig = Rig(record())
    rig.wait(0.1)
    rig.pressure(200)
    rig.wait(0.1)
    rig.mock.follow("pressure", Segment("ramp", 0.2, 200 * 65.535, 100 * 65.535, 1000 * 65.535))
    assert rig.mock.read_back("pressure") == pytest.approx(200 * 65.535)
    rig.wait(0.2)
    t, P_set = np.array(rig.time) * 1e-9, rig.array("pressure_set")
    expected = np.where(t <= 0.1, 0, np.where(t <= 0.2, 200e3, np.maximum(100e3, 200e3 - 1e6 * (t - 0.2))))
    np.testing.assert_allclose(P_set, expected, atol=1e-3)
    arrived, held = rig.array("pressure")[20:], P_set[:-20]
    edge = np.isin(np.arange(len(held)), [50])  # commanded right after this sample: held at the next, arrives at this
    np.testing.assert_allclose(arrived[~edge], held[~edge], atol=1e-3)
    assert rig.mock.read_back("pressure") == pytest.approx(100 * 65.535)


def test_a_sine_is_followed_for_whole_cycles():
    rig = Rig(record())
    rig.pressure(200)
    rig.wait(1.0)
    rig.mock.follow("pressure", Segment("sine", 1.0, 200 * 65.535, amplitude=50 * 65.535, frequency=2.0, cycles=3))
    rig.wait(2.0)
    t = np.array(rig.time) * 1e-9 - 1.0
    expected = np.where((t >= 0) & (t < 1.5), 200e3 + 50e3 * np.sin(4 * math.pi * t), 200e3)
    np.testing.assert_allclose(rig.array("pressure_set"), expected, atol=1e-3)


def test_counts_are_rounded_and_end_at_the_range():
    rig = Rig(record(counts=True, preset="bench", noise=0))
    rig.pressure(300)
    rig.wait(3.0)
    for name in COUNTS:
        raw = rig.array(name)
        assert (raw == np.rint(raw)).all()
    x = rig.array("displacement")[-1] * 0.5e-6 - 5e-3
    assert 6773 * x == pytest.approx(275, abs=10)
    heavy = Rig(record(counts=True, plant="serres2009"))
    heavy.mock.place(Load(5000.0, 500.0))
    heavy.mock.write("pressure", 65535)
    heavy.wait(1.0)
    assert heavy.array("force")[-1] == 65535


def test_noise_and_resolution_are_those_of_the_bench():
    rig = Rig(record(preset="bench", seed=3))
    rig.wait(20.0)
    assert rig.array("pressure").std() == pytest.approx(500, rel=0.03)
    assert rig.array("displacement").std() == pytest.approx(2e-6, rel=0.03)
    assert rig.array("force").std() == pytest.approx(0.3, rel=0.03)
    assert set(rig.array("supply")) == {690e3}
    assert set(rig.array("pressure_set")) == {0.0}


def session(block, seed=1):
    rig = Rig(record(counts=True, preset="bench", seed=seed))
    rig.mock.place(Load(58.86, 8.0))
    for kPa in (200, 400, 0):
        rig.pressure(kPa)
        rig.wait(2.0, block)
    return rig


def test_the_same_seed_and_commands_give_identical_samples():
    one, two, other = session(1.0), session(1.0), session(1.0, seed=2)
    assert one.time == two.time
    assert one.columns == two.columns
    assert one.columns["force"] != other.columns["force"]


@pytest.mark.parametrize("block", [0.05, 0.002])
def test_the_size_of_the_blocks_makes_no_difference_but_in_the_last_digits(block):
    one, two = session(1.0), session(block)
    assert one.time == two.time
    for name, allowed in (("pressure", 0), ("force", 4), ("displacement", 4)):
        assert np.abs(one.array(name) - two.array(name)).max() <= allowed


# -- going back in time ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("sample", [1, 77, 250, 499])
def test_the_clock_taken_back_takes_the_plant_back(sample):
    """A crossing is seen a block later; what follows is as if nobody had gone past it."""
    straight, returned = (Rig(record(preset="bench")) for _ in range(2))
    for rig in (straight, returned):
        rig.mock.place(Load(58.86, 8.0))
        rig.pressure(400)
        rig.wait(1.0)
    straight.wait(sample / 500)
    returned.wait(1.0)
    returned.back_to(1.0 + sample / 500)
    for rig in (straight, returned):
        rig.pressure(0)
        rig.wait(2.0)
    assert returned.time == straight.time
    for name, allowed in (("displacement", 1e-6), ("pressure", 1e-3), ("force", 1e-2), ("pressure_set", 0)):
        np.testing.assert_allclose(returned.array(name), straight.array(name), atol=allowed)


def test_going_back_without_a_command_makes_the_same_samples_again():
    rig = Rig(record(preset="bench"))
    rig.pressure(400)
    rig.wait(2.0)
    before = rig.array("displacement")
    rig.back_to(1.3)
    rig.wait(0.7)
    np.testing.assert_allclose(rig.array("displacement"), before, atol=1e-7)
    assert rig.time == [k * 2_000_000 for k in range(1001)]


def test_going_back_undoes_later_commands_only():
    rig = Rig(record())
    rig.pressure(300)
    rig.wait(1.0)
    rig.pressure(100)
    rig.wait(0.5)
    rig.back_to(1.2)
    assert rig.mock.read_back("pressure") == pytest.approx(100 * 65.535)
    rig.back_to(0.9)
    assert rig.mock.read_back("pressure") == pytest.approx(300 * 65.535)
    rig.wait(0.2)
    assert rig.array("pressure")[-1] == pytest.approx(300e3)


def test_it_cannot_go_back_for_ever():
    rig = Rig(record())
    rig.wait(10.0)
    rig.clock.back_to(1.0)
    with pytest.raises(DeviceError, match="go back"):
        rig.mock.collect()


# -- the driven end ----------------------------------------------------------------------------------------------


def test_the_driven_end_follows_its_set_point():
    rig = Rig(record(actuator=True))
    rig.pressure(300)
    rig.mock.follow("displacement", Segment("ramp", 0.0, 0.0, 20.0, 10.0))
    rig.wait(3.0)
    assert rig.mock.read_back("displacement") == pytest.approx(20.0)
    rig.mock.follow("displacement", Segment("sine", 3.0, 20.0, amplitude=5.0, frequency=1.0, cycles=2))
    rig.wait(2.0)
    t = np.array(rig.time) * 1e-9
    after = t > 3.0
    x = 20e-3 + 5e-3 * np.sin(2 * math.pi * (t - 3))
    v = 10e-3 * math.pi * np.cos(2 * math.pi * (t - 3))
    np.testing.assert_allclose(rig.array("displacement")[after], x[after], atol=1e-9)
    np.testing.assert_allclose(rig.array("displacement_set")[after], x[after], atol=1e-9)
    force = 275 - 6773 * x - np.where(v > 0, 1680, 2120) * v
    np.testing.assert_allclose(rig.array("force")[after][:-1], force[after][:-1], atol=1e-6)


def test_the_driven_end_goes_back_in_time_too():
    rig = Rig(record(actuator=True))
    rig.mock.follow("displacement", Segment("ramp", 0.0, 0.0, 40.0, 10.0))
    rig.wait(2.0)
    rig.back_to(1.5)
    rig.mock.write("displacement", 15.0)
    rig.wait(1.0)
    assert rig.array("displacement").max() == pytest.approx(15e-3)


def test_the_actuator_has_limits_and_a_load_means_nothing_to_it():
    rig = Rig(record(actuator=True, actuator_high=0.03))
    rig.mock.place(Load(58.86, 8.0))
    with pytest.raises(DeviceError, match=r"plant\.displacement: .*stroke"):
        rig.mock.write("displacement", 40.0)


# -- refusals ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"presset": "ideal"}, 'unknown key "presset"; did you mean "preset"'),
        ({"preset": "idel"}, 'did you mean "ideal"'),
        ({"plant": 3}, "plant"),
        ({"seed": "one"}, "number"),
        ({"regulator_lag": math.nan}, "number"),
        ({"faults": {"burst": 1}}, 'did you mean "burst_at"'),
        ({"faults": 3}, "faults"),
    ],
)
def test_options_are_checked_before_opening(options, message):
    with pytest.raises(DeviceError, match=message):
        MockBench(record(**options), VirtualClock())


def test_all_mistakes_are_said_at_once_each_at_its_place():
    wrong = record(seed="one", presset="ideal", faults={"burst": 1, "nan_at": "soon"}, errors={"force": {"end": "top"}})
    wrong = replace(wrong, channels=(replace(wrong.channels[0], input="presure"),))
    places = {".".join(place) for place, _ in MockBench.check(wrong)}
    assert places == {
        *("options.seed", "options.presset", "options.faults.burst", "options.faults.nan_at"),
        *("options.errors.force.end", "channels.pressure.input"),
    }


@pytest.mark.parametrize("options", [{"regulator_lag": -1.0}, {"b_relax": "b_other"}, {"dead_band": 5.0}])
def test_values_that_cannot_be_are_refused_when_opened(options):
    with pytest.raises(DeviceError, match="plant: "):
        MockBench(record(**options), VirtualClock()).open()


def test_an_unknown_input_is_refused_with_the_nearest_one():
    channel = ChannelRecord("pressure", "pressure", "plant", "presure", "float64", "Pa", Scale(), 0, 1)
    with pytest.raises(
        DeviceError, match=r'plant: channels\.pressure\.input: no input "presure"; did you mean "pressure"'
    ):
        MockBench(DeviceRecord("plant", "", "", {}, (channel,)), VirtualClock()).open()


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_command_that_is_no_number_is_refused(value):
    rig = Rig(record())
    with pytest.raises(DeviceError, match="cannot be commanded"):
        rig.mock.write("pressure", value)


def test_unknown_outputs_and_segments_are_refused():
    rig = Rig(record())
    with pytest.raises(DeviceError, match="no output"):
        rig.mock.write("displacement", 1.0)
    with pytest.raises(DeviceError, match="cannot follow"):
        rig.mock.follow("pressure", Segment("square", 0.0, 0.0))
    with pytest.raises(DeviceError, match="rate above zero"):
        rig.mock.follow("pressure", Segment("ramp", 0.0, 0.0, 1.0, 0.0))
    with pytest.raises(DeviceError, match="Hz"):
        rig.mock.start(0.0)


def test_closing_twice_is_harmless_and_a_closed_bench_says_so():
    mock = MockBench(record(), VirtualClock())
    mock.open()
    mock.close()
    mock.close()
    mock.stop()
    with pytest.raises(DeviceError, match="not open"):
        mock.collect()
