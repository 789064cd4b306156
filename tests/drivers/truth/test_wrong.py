"""A rig that is wrong in one thing: what its plant shows then, and which wishes are refused; no wire."""

import time
from dataclasses import replace

import pytest
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.truth import apply, wired

from pmabench.base.errors import UsageError
from pmabench.bench.interface import Scale
from pmabench.bench.truth import read_truth
from pmabench.files.shipped import find_file
from tests.drivers.truth.raw import CLIENTS
from tests.drivers.truth.rigs import pressurised, records


def near(value):
    return pytest.approx(value, rel=1e-4, abs=1e-6)


def rig(tmp_path, name, *wrong):
    return apply(wired(records(tmp_path, name), read_truth(find_file("truth", name))), wrong)


def seen(tmp_path, name, *wrong, device=0):
    """What is true under 200 kPa and 60 N, what the device shows, and the device's view of the plant."""
    _wired, errors, said = rig(tmp_path, name, *wrong)
    plant = RealPlant(preset="ideal", driven=name == "can")
    view = plant.seen(errors[device])

    class Emulated:
        pass

    Emulated.plant = plant
    true = pressurised(Emulated)
    assert len(said) == len(wrong)
    return true, view.quantities(), view


def test_nothing_wrong_shows_the_plant(tmp_path):
    true, shown, _view = seen(tmp_path, "labjack")
    assert shown == near(true)


@pytest.mark.parametrize(
    ("wrong", "what", "shown_for"),
    [
        ("scale:force=0.5", "force", lambda true: 0.5 * true),
        ("scale:pressure", "pressure", lambda true: 2 * true),
        ("scale", "force", lambda true: 2 * true),
        ("sign:displacement", "displacement", lambda true: -true),
        ("offset:force=50", "force", lambda true: true + 50.0),
        ("offset:displacement", "displacement", lambda true: true + 0.012),
        ("offset:t7.AIN0=60e3", "pressure", lambda true: true + 60e3),
        # a transmitter of -0.5 to 9.5 bar in whose place one of -0.5 to 19.5 bar is: half the signal above -0.5 bar
        ("range:pressure", "pressure", lambda true: -50e3 + (true + 50e3) / 2),
    ],
)
def test_a_sensor_is_wrong_and_no_other(tmp_path, wrong, what, shown_for):
    true, shown, _view = seen(tmp_path, "labjack", wrong)
    assert shown.pop(what) == near(shown_for(true.pop(what)))
    assert shown == near(true)


def test_errors_add_up(tmp_path):
    true, shown, _view = seen(tmp_path, "labjack", "scale:force=0.5", "offset:force=10")
    assert shown["force"] == near(0.5 * true["force"] + 10.0)


def test_a_regulator_of_half_the_range_does_half_and_what_is_looped_back_is_the_command(tmp_path):
    _true, _shown, view = seen(tmp_path, "labjack", "scale:output.pressure=0.5")
    view.command(3e5)
    time.sleep(0.01)
    assert view._plant.quantities()["pressure_command"] == pytest.approx(1.5e5)
    assert view.quantities()["pressure_command"] == pytest.approx(3e5)


def test_a_drive_that_runs_the_other_way_shows_its_own_way_and_another_device_the_true_one(tmp_path):
    true, shown, view = seen(tmp_path, "can", "sign:output.displacement", device=1)
    assert true["displacement"] == pytest.approx(0.02)
    assert shown["displacement"] == pytest.approx(-0.02)
    view.drive(0.005)
    time.sleep(0.01)
    assert view._plant.quantities()["displacement_command"] == pytest.approx(-0.005)
    assert view.quantities()["displacement_command"] == pytest.approx(0.005)
    other, shown_there, _view = seen(tmp_path, "can", "sign:output.displacement", device=0)
    assert shown_there["displacement"] == near(other["displacement"])


def test_swapped_plugs_take_their_sensors_along_and_leave_the_terminals_counts(tmp_path):
    record = rig(tmp_path, "festo", "swap:displacement=force")[0][0].record
    there = {channel.name: channel for channel in record.channels}
    assert (there["displacement"].input, there["force"].input) == ("ai3.2", "ai3.1")
    # 60 N are 0.3 V of the 2 kN cell at 10 V, and 960 counts of 32000 at 10 V, in whichever terminal
    assert there["force"].scale.to_raw(60.0) == pytest.approx(960.0)
    assert there["displacement"].scale.to_raw(0.045) == pytest.approx(16000.0)


def test_a_plug_is_in_an_empty_terminal(tmp_path):
    record = rig(tmp_path, "labjack", "swap:output.pressure=t7.DAC1", "swap:force=t7.AIN5")[0][0].record
    assert [output.output for output in record.outputs] == ["DAC1"]
    assert {channel.name: channel.input for channel in record.channels}["force"] == "AIN5"


def test_a_valve_and_a_contact_that_work_the_other_way_round(tmp_path):
    record = rig(tmp_path, "labjack", "sign:dump_valve", "sign:e-stop")[0][0].record
    assert [valve.energised for valve in record.valves] == ["open"]
    assert [lock.safe for lock in record.interlocks] == ["low"]


@pytest.mark.parametrize(
    ("name", "wrong", "why"),
    [
        ("labjack", "scal:force", 'did you mean "scale"'),
        ("labjack", "scale:forc", 'did you mean "force"'),
        ("labjack", "scale:force=much", 'a number is expected, not "much"'),
        ("labjack", "scale:force=0", "out of all range"),
        ("labjack", "scale:force=nan", "out of all range"),
        ("labjack", "scale:dump_valve", "measured or commanded in numbers"),
        ("labjack", "swap:force", "say with what"),
        ("labjack", "swap:force=force", "fit into each other's terminals"),
        ("labjack", "swap:force=e-stop", "fit into each other's terminals"),
        ("wires", "swap:force=displacement", "fit into each other's terminals"),
        ("wires", "swap", "no two sensors of this rig fit"),
    ],
)
def test_a_wish_that_cannot_be_is_refused_in_a_sentence(tmp_path, name, wrong, why):
    with pytest.raises(UsageError) as refused:
        rig(tmp_path, name, wrong)
    assert why in str(refused.value)


@pytest.mark.parametrize("name", CLIENTS)
def test_of_the_bench_only_names_and_places_are_used(tmp_path, name):
    """Every scale, sign, terminal and valve of the bench file is wrong, and its options are gone: the rig is the same."""
    truth = read_truth(find_file("truth", name))
    right = records(tmp_path, name)
    wrong = [
        replace(
            device,
            driver="pmabench_drivers.mock:MockBench",
            options={key: value for key, value in device.options.items() if key in {"server", "stream_port"}},
            channels=tuple(replace(c, scale=Scale(-3.0 * c.scale.slope, 7.0), input="x") for c in device.channels),
            outputs=tuple(replace(o, scale=Scale(5.0 * o.scale.slope, 1.0), output="y") for o in device.outputs),
            valves=tuple(replace(valve, energised="open") for valve in device.valves),
            interlocks=(),
        )
        for device in right
    ]
    found = wired(wrong, truth)
    assert found == wired(right, truth)
    assert [item.record.address for item in found] == [device.address for device in right]


def test_a_device_that_the_truth_does_not_know_is_refused(tmp_path):
    [device] = records(tmp_path, "labjack")
    with pytest.raises(UsageError, match='says nothing of the device "t8"'):
        wired([replace(device, name="t8")], read_truth(find_file("truth", "labjack")))
