"""A free end that moves air through the mock: valves, a clogged silencer, samples that are taken again, its options."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pmabench_drivers.mock import MockBench

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Load, ValveRecord
from tests.drivers.rig import Rig, record

V0 = math.pi / 4 * 0.02**2 * 0.25
"""Of a braid of 20 mm by 250 mm [m3]."""


def air(valve=False, **options):
    given = {"preset": "bench", "noise": 0.0, "dead_time": 0.0, **options}
    return record(valve=valve, plant="paper0-air", **given)


def volume(x):
    left = 1 - x / 0.25
    return V0 * left * (5.59891 - 4.59891 * left**2)


def test_behind_a_shut_isolation_valve_a_load_presses_the_air_together():
    device = air()
    rig = Rig(replace(device, valves=(ValveRecord("isolation valve", "plant", "isolation_valve"),)))
    rig.mock.switch("isolation_valve", on=True)
    rig.pressure(300)
    rig.wait(3.0)
    rig.mock.switch("isolation_valve", on=False)
    before, x_before = rig.array("pressure")[-1], rig.array("displacement")[-1]
    rig.pressure(0)
    rig.mock.place(Load(force=150.0, mass=15.0))
    rig.wait(3.0)
    held, x = rig.array("pressure")[-1], rig.array("displacement")[-1]
    assert x < x_before - 5e-3
    assert held == pytest.approx((before + 101325) * (volume(x_before) / volume(x)) ** 1.2 - 101325, rel=1e-4)
    rig.mock.switch("isolation_valve", on=True)
    rig.wait(3.0)
    assert rig.array("pressure")[-1] == pytest.approx(0.0, abs=1.0)


def test_an_open_dump_valve_empties_whatever_is_commanded():
    rig = Rig(air(valve=True))
    rig.mock.switch("dump_valve", on=True)
    rig.pressure(400)
    rig.wait(3.0)
    assert rig.array("pressure")[-1] == pytest.approx(400e3, rel=1e-3)
    rig.mock.switch("dump_valve", on=False)
    rig.wait(1.5)
    assert rig.array("pressure")[-1] < 100.0


def test_a_clogged_silencer_lets_out_more_slowly():
    """The regulator takes longer by the factor, and so does the air."""
    times = []
    for slow in (1.0, 4.0):
        rig = Rig(air(slow_vent=slow))
        rig.mock.place(Load(force=1000.0, mass=50.0))
        rig.pressure(400)
        rig.wait(3.0)
        rig.pressure(0)
        rig.wait(6.0)
        times.append(np.flatnonzero(rig.array("pressure")[1500:] < 200e3)[0] / 500)
    assert times[1] / times[0] == pytest.approx(4.0, rel=0.05)


def test_taken_back_in_time_it_gives_the_same_again():
    def run(back):
        rig = Rig(air(noise=1.0))
        rig.pressure(400)
        rig.wait(0.5, 0.1)
        if back:
            rig.pressure(100)
            rig.wait(0.4, 0.05)
            rig.back_to(0.5)
        rig.pressure(250)
        rig.wait(1.0, 0.02 if back else 0.1)
        return [rig.array(name) for name in ("pressure", "displacement", "force")]

    for again, once, apart in zip(run(back=True), run(back=False), (2.0, 1e-7, 5e-3), strict=True):
        np.testing.assert_allclose(again, once, rtol=0, atol=apart)


@pytest.mark.parametrize("option", [{"hysteresis": 3.0}, {"fce_eval": "x0"}])
def test_an_option_that_it_has_no_use_for_is_refused_when_it_is_opened(option):
    with pytest.raises(DeviceError, match=f"{next(iter(option))} is (not )?for the"):
        Rig(record(plant="paper0-air", **option))
    given = {"plant": "paper0-air", "conductance_fill": 1e-7, "polytropic": 1.0, "natural_frequency": 3.0}
    assert not MockBench.check(record(**given))
