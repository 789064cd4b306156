"""The muscle of paper 3 through the mock: a shut valve, a clogged silencer, the options that belong to it."""

from dataclasses import replace

import numpy as np
import pytest
from pmabench_drivers.mock import MockBench

from pmabench.base.clock import VirtualClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import ValveRecord
from tests.drivers.rig import Rig, record

QUICK = {"preset": "bench", "noise": 0.0, "dead_time": 0.0, "regulator_lag": 0.0, "follow_lag": 0.0}
PACE = 1.2 * 287 * 293 * 0.5e-7 / 62.832e-6
"""k r T C_vent / V at no contraction [1/s]."""


def daerden(**options):
    return record(actuator=True, plant="daerden", actuator_force=9000, **{**QUICK, **options})


def isolated(**options):
    device = daerden(**options)
    valve = ValveRecord("isolation valve", "plant", "isolation_valve")
    return replace(device, valves=(*device.valves, valve))


def test_behind_a_shut_isolation_valve_the_air_is_only_pressed_together():
    rig = Rig(isolated())
    rig.mock.switch("isolation_valve", on=True)
    rig.pressure(300)
    rig.wait(1.0)
    rig.mock.switch("isolation_valve", on=False)
    rig.pressure(0)
    rig.mock.write("displacement", 20.0)
    rig.wait(1.0)
    held, x = rig.array("pressure")[-1], rig.array("displacement")[-1]
    eps = x / 0.2
    volume = (5.5988 - 4.5988 * (1 - eps) ** 2.6) * (1 - eps)
    assert eps == pytest.approx(0.1)
    assert held == pytest.approx(401325 / volume**1.2 - 101325, rel=1e-4)
    rig.mock.switch("isolation_valve", on=True)
    rig.wait(1.0)
    assert rig.array("pressure")[-1] == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize("slow", [1.0, 4.0])
def test_a_clogged_silencer_lets_out_less_air(slow):
    rig = Rig(daerden(slow_vent=slow))
    rig.pressure(400)
    rig.wait(0.5)
    rig.pressure(100)
    rig.wait(0.02)
    t = np.array(rig.time[-11:]) * 1e-9 - 0.5
    expected = 100e3 + 300e3 * np.exp(-PACE / slow * t)
    np.testing.assert_allclose(rig.array("pressure")[-11:], expected, atol=20.0)


def test_taken_back_in_time_it_gives_the_same_again():
    def run(back):
        rig = Rig(daerden(noise=1.0))
        rig.pressure(400)
        rig.wait(0.5, 0.1)
        rig.mock.write("displacement", 15.0)
        rig.wait(0.5, 0.1)
        if back:
            rig.mock.write("displacement", 5.0)
            rig.wait(0.5, 0.05)
            rig.back_to(1.0)
        rig.mock.write("displacement", 10.0)
        rig.wait(0.5, 0.02 if back else 0.1)
        return np.array([rig.array("pressure"), rig.array("force")])

    np.testing.assert_allclose(run(back=True), run(back=False), rtol=0, atol=1e-3)


@pytest.mark.parametrize("free_end", [{}, {"free_end": "weights"}])
def test_it_needs_a_driven_end(free_end):
    with pytest.raises(DeviceError, match="free_end: actuator"):
        MockBench(record(plant="daerden", **free_end), VirtualClock())


@pytest.mark.parametrize(
    ("plant", "option"),
    [
        ("daerden", {"F_s": 3.0}),
        ("daerden", {"fce_eval": "x0"}),
        ("paper0", {"hysteresis": 3.0}),
        ("dmsp-40-305", {"conductance_fill": 1e-7}),
        ("contractor-30", {"F_c": 3.0}),
        ("serres2009", {"fce_eval": "x0"}),
        ("serres2009", {"creep": 0.0}),
        ("daerden", {"hysteresis_x": 0.0}),
        ("real", {"F_c": 3.0}),
        ("real", {"hysteresis": 3.0}),
    ],
)
def test_an_option_that_a_plant_has_no_use_for_is_refused_when_it_is_opened(plant, option):
    with pytest.raises(DeviceError, match=f"{next(iter(option))} is (not )?for the"):
        Rig(record(actuator=True, plant=plant, **option))


def test_rubber_that_relaxes_is_of_a_driven_end():
    with pytest.raises(DeviceError, match="relaxes is for a driven end"):
        Rig(record(plant="contractor-30", relaxes=0.02))


@pytest.mark.parametrize("plant", ["joint", "platform"])
def test_a_joint_and_a_platform_have_none_of_them(plant):
    with pytest.raises(DeviceError, match=f"options.noise: the plant {plant} has no use for it"):
        MockBench(record(plant=plant, preset="bench", noise=0.0), VirtualClock())
