"""The mock bench's dump valve, and what goes wrong on order: each fault looks as it would at a bench."""

import math
import threading

import numpy as np
import pytest

from pmabench.base.errors import DeviceError
from tests.drivers.rig import Rig, record

CLOSED = {"valve": True, "preset": "bench", "noise": 0}


def filled(kPa=300, seconds=2.0, **options):
    """A rig with the dump valve closed and the muscle at pressure."""
    rig = Rig(record(**{**CLOSED, **options}))
    rig.mock.switch("dump_valve", on=True)
    rig.pressure(kPa)
    rig.wait(seconds)
    return rig


# -- the dump valve ----------------------------------------------------------------------------------------------


def test_a_dump_valve_that_is_not_energised_keeps_the_muscle_empty():
    rig = Rig(record(**CLOSED))
    rig.pressure(300)
    rig.wait(1.0)
    assert rig.array("pressure").max() == 0
    assert rig.mock.is_on("dump_valve") is False
    rig.mock.switch("dump_valve", on=True)
    rig.wait(0.0955)
    assert rig.array("pressure")[-1] == pytest.approx(300e3 * (1 - math.exp(-1)), rel=0.02)
    assert rig.mock.is_on("dump_valve") is True


def test_the_open_dump_valve_empties_the_muscle_whatever_the_regulator_does():
    rig = filled()
    rig.mock.switch("dump_valve", on=False)
    rig.pressure(500)
    rig.wait(0.1)
    assert rig.array("pressure")[-1] == pytest.approx(300e3 / math.e, rel=1e-6)
    rig.wait(1.0)
    assert rig.array("pressure")[-1] < 10
    assert rig.mock.read_back("pressure") == pytest.approx(500 * 65.535)


@pytest.mark.parametrize("sample", [40, 60, 200])
def test_the_valve_goes_back_in_time_too(sample):
    rig = filled(seconds=1.0)
    rig.wait(0.1)
    rig.mock.switch("dump_valve", on=False)
    rig.wait(0.9)
    before = rig.array("pressure")
    rig.back_to(1.0 + sample / 500)
    assert rig.mock.is_on("dump_valve") is (sample < 50)
    rig.wait(1.0 - sample / 500)
    expected = before if sample > 50 else np.where(np.arange(1001) > 550, 300e3, before)
    np.testing.assert_allclose(rig.array("pressure")[500:], expected[500:], rtol=1e-4, atol=1e-3)


def test_a_bench_without_a_valve_has_none_to_switch():
    rig = Rig(record())
    with pytest.raises(DeviceError, match='no valve "dump_valve"'):
        rig.mock.switch("dump_valve", on=True)
    with pytest.raises(DeviceError, match='no digital input "door"'):
        rig.mock.level("door")


def test_set_points_end_at_the_range_of_the_regulator():
    rig = filled(kPa=1200)
    assert rig.mock.read_back("pressure") == pytest.approx(65535)
    assert rig.array("pressure")[-1] == pytest.approx(1e6, rel=1e-6)
    rig.pressure(-50)
    assert rig.mock.read_back("pressure") == 0


# -- faults of the air -------------------------------------------------------------------------------------------


def test_a_dump_valve_that_is_stuck_does_not_vent():
    rig = filled(faults={"dump_stuck_at": 1.0})
    rig.mock.switch("dump_valve", on=False)
    rig.wait(1.0)
    assert rig.mock.is_on("dump_valve") is False
    assert rig.array("pressure")[-1] == pytest.approx(300e3)
    rig.pressure(0)
    rig.wait(1.0)
    assert rig.array("pressure")[-1] < 50


def test_a_stuck_regulator_takes_set_points_and_ignores_them_but_the_valve_still_vents():
    rig = filled(faults={"regulator_stuck_at": 1.5})
    rig.pressure(0)
    rig.wait(1.0)
    assert rig.mock.read_back("pressure") == 0
    assert rig.array("pressure")[-1] == pytest.approx(300e3)
    rig.mock.switch("dump_valve", on=False)
    rig.wait(1.0)
    assert rig.array("pressure")[-1] < 20
    rig.mock.switch("dump_valve", on=True)
    rig.wait(1.0)
    assert rig.array("pressure")[-1] == pytest.approx(300e3, rel=1e-3)


def test_a_slow_vent_takes_its_time():
    rig = filled(slow_vent=20)
    rig.mock.switch("dump_valve", on=False)
    rig.wait(2.0)
    assert rig.array("pressure")[-1] == pytest.approx(300e3 / math.e, rel=1e-6)


def test_a_lost_supply_empties_the_muscle_and_reads_zero():
    rig = filled(faults={"supply_lost_at": 1.5})
    assert rig.array("pressure")[-1] == pytest.approx(300e3 / math.e, rel=1e-3)
    supply = rig.array("supply")
    assert set(supply[:750]) == {690e3}
    assert set(supply[751:]) == {0.0}


def test_a_leak_keeps_the_pressure_below_the_set_point():
    rig = filled(leak=0.5)
    assert rig.array("pressure")[-1] == pytest.approx(300e3 / (1 + 0.5 * 0.0955), rel=1e-6)


def test_the_emergency_stop_opens_its_contact():
    rig = filled(faults={"e_stop_at": 2.5})
    assert rig.mock.level("e_stop") is True
    rig.wait(1.0)
    assert rig.mock.level("e_stop") is False
    assert rig.array("pressure")[-1] == pytest.approx(300e3)


# -- faults of sensors and links ---------------------------------------------------------------------------------


def test_a_sensor_may_be_off_by_slope_and_offset_and_sign():
    errors = {"pressure": {"factor": 1.02, "offset": 500.0}, "force": {"factor": -1, "at": 1.0}}
    right, wrong = filled(counts=True), filled(counts=True, errors=errors)
    count = 1e6 / 65535
    expected = 1.02 * (right.array("pressure") * count - 50e3) + 500
    np.testing.assert_allclose(wrong.array("pressure") * count - 50e3, expected, atol=1.01 * count)
    force, bad = (rig.array("force") * 2000 / 65535 - 50 for rig in (right, wrong))
    np.testing.assert_array_equal(bad[:500], force[:500])
    np.testing.assert_allclose(bad[500:], np.maximum(-force[500:], -50), atol=0.04)


def test_a_channel_may_stand_at_the_end_of_its_range():
    rig = filled(counts=True, errors={"pressure": {"end": "high", "at": 1.0}, "force": {"end": "low"}})
    assert set(rig.columns["pressure"][500:]) == {65535.0}
    assert rig.columns["pressure"][499] < 65535
    assert set(rig.columns["force"]) == {0.0}


def test_plugs_may_be_swapped():
    errors = {"pressure": {"reads": "force"}, "force": {"reads": "pressure"}}
    right, wrong = filled(counts=True), filled(counts=True, errors=errors)
    assert wrong.columns["pressure"] == right.columns["force"]
    assert wrong.columns["force"] == right.columns["pressure"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"errors": {"presure": {}}}, 'no input "presure"; did you mean "pressure"'),
        ({"errors": {"pressure": {"gain": 2}}}, 'errors.pressure.gain: unknown key "gain"'),
        ({"errors": {3: {}}}, 'no input "3"'),
        ({"built": {3: 1.0}}, 'has nothing called "3"'),
        ({"errors": {"pressure": 2}}, "errors.pressure: keys and values are expected here, not 2"),
        ({"errors": {"pressure": {"end": "top"}}}, 'errors.pressure.end: "top" is not known here'),
        ({"faults": {"mute_at": 1.0}}, "mock-realtime"),
        ({"idle": 50}, 'unknown key "idle"'),
        ({"slow_vent": 0}, "slow_vent"),
    ],
)
def test_hostile_options_are_refused_with_a_sentence(options, message):
    with pytest.raises(DeviceError, match=message):
        Rig(record(**options))


def test_a_burst_takes_the_pressure_away():
    rig = Rig(record(preset="bench", noise=0, faults={"burst_at": 1.0}))
    rig.pressure(300)
    rig.wait(2.0)
    P = rig.array("pressure")
    assert P[499] > 299e3
    assert P[525] < 300e3 * math.exp(-4)
    assert P[-1] < 1
    assert rig.array("displacement")[-1] < 10 / 5600
    rig.back_to(0.9)
    rig.wait(0.05)
    assert rig.array("pressure")[-1] > 299e3


def test_a_stuck_sensor_repeats_itself():
    rig = Rig(record(preset="bench", faults={"pressure_stuck_at": 0.5}))
    rig.pressure(300)
    rig.wait(2.0, block=0.05)
    assert len(set(rig.columns["pressure"][250:])) == 1
    assert len(set(rig.columns["pressure"][:250])) > 200


def test_nan_and_the_lowest_count():
    plain, counts = (Rig(record(counts=c, preset="bench", faults={"nan_at": 0.5})) for c in (False, True))
    for rig in (plain, counts):
        rig.wait(1.0)
    assert np.isnan(plain.array("force")[250:]).all()
    assert not np.isnan(plain.array("force")[:250]).any()
    assert set(counts.columns["pressure"][250:]) == {0.0}


def test_a_gap_loses_samples_and_goes_on():
    rig = Rig(record(faults={"gap_at": 0.5}))
    rig.wait(1.0)
    steps = np.diff(rig.time)
    assert sorted(set(steps)) == [2_000_000, 22_000_000]


def test_a_lost_link_fails_every_call():
    rig = Rig(record(faults={"lost_at": 0.5}))
    rig.wait(0.4)
    rig.clock.wait_until(0.5)
    for call in (rig.mock.collect, lambda: rig.pressure(0)):
        with pytest.raises(DeviceError, match="link lost"):
            call()


def test_a_hung_device_answers_nobody_until_it_is_closed():
    rig = Rig(record(faults={"hang_at": 0.5}))
    rig.clock.wait_until(0.6)
    caught = []

    def call():
        try:
            rig.mock.collect()
        except DeviceError as error:
            caught.append(error)

    thread = threading.Thread(target=call)
    thread.start()
    thread.join(0.1)
    assert thread.is_alive()
    rig.mock.close()
    thread.join(5)
    assert "closed while it did not answer" in str(caught[0])
