"""The simulated arm: paper 2's angle for the load on its end, friction between both ways, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from pmabench_drivers.emulator import Emulator
from pmabench_drivers.emulator.plant import RealPlant

from pmabench.base.errors import UsageError
from pmabench.bench.compile import mount
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.compile import make_plan
from pmabench.model.driven import Actuator
from pmabench.model.overrides import Overrides
from pmabench.model.presets import preset
from pmabench.model.regulator import constant
from tests.engine.benches import ROOT

M = np.array(
    [
        [85.109, 68.4155, -915.4121, 2145.117, -1779.245],
        [-86.195, -69.7074, 940.9097, -2210.206, 1837.185],
        [1.047706, 0.1331478, -4.69328, 18.98427, -21.75253],
        [3.459321, 0.7990463, -24.19429, 84.25137, -67.01067],
    ]
)
"""Second eqs. 10 of paper 2: rows a [deg], b [deg], c [bar], d, in powers of the load [kg]."""


def formula(bar, kg):
    a, b, c, d = M @ kg ** np.arange(5)
    return a + b / (1 + (bar / c) ** d)


def angle_at(plant, t):
    return float(np.degrees(plant.advance(t, np.array([t])).x[0] / 0.03))


@pytest.mark.parametrize("kg", [0.0, 0.25, 0.5])
def test_it_comes_to_the_angle_of_its_load(kg):
    plant = preset("arm-30", "ideal").free(force=9.81 * kg, mass=0.5)
    for i, bar in enumerate((0.45, 1.0, 2.8, 5.0)):
        plant.command(constant(4.0 * i, bar * 1e5))
        assert angle_at(plant, 4.0 * i + 4.0) == pytest.approx(formula(bar, kg), abs=0.02)


def test_a_load_that_is_put_on_bends_it_less_and_going_back_in_time_takes_it_off():
    plant = preset("arm-30", "ideal").free()
    plant.command(constant(0.0, 3e5))
    assert angle_at(plant, 4.0) == pytest.approx(formula(3.0, 0.0), abs=0.02)
    before = plant.snapshot()
    plant.load(0.4 * 9.81, 0.5)
    assert angle_at(plant, 8.0) == pytest.approx(formula(3.0, 0.4), abs=0.02)
    plant.restore(before)
    assert angle_at(plant, 8.0) == pytest.approx(formula(3.0, 0.0), abs=0.02)


def test_friction_holds_both_ways_apart():
    """2 F_c / (K r): 0.382 deg."""
    plant = preset("arm-30", "bench").free()
    found = []
    for i, bar in enumerate((1.5, 5.0, 1.5)):
        plant.command(constant(8.0 * i, bar * 1e5))
        found.append(angle_at(plant, 8.0 * i + 8.0))
    assert found[2] - found[0] == pytest.approx(np.degrees(2 * 0.5 / (5e3 * 0.03)), abs=0.002)
    assert preset("arm-30", "bench", Overrides(friction=0.0)).muscle.friction.F_c == 0.0


def test_what_an_arm_cannot_be():
    arm = preset("arm-30")
    with pytest.raises(ValueError, match="known for 0 to 0.5 kg at its end, not for 0.6 kg"):
        arm.free(force=0.6 * 9.81)
    with pytest.raises(ValueError, match="nothing drives it"):
        arm.driven(Actuator())
    with pytest.raises(ValueError, match="it has one damping"):
        preset("arm-30", "bench", Overrides(b_relax="b_contract"))


def test_an_emulated_bench_with_an_angle_needs_the_arm():
    mounted = mount(ROOT / "fixtures" / "benches" / "labjack.yaml", ROOT / "fixtures" / "specimens" / "arm-30.yaml")
    devices = [
        replace(device, channels=tuple(replace(c, quantity="angle") for c in device.channels))
        for device in mounted.bench.devices
    ]
    with pytest.raises(UsageError, match='only the plant "arm-30" has one: give --plant arm-30'):
        Emulator(devices, plant="paper0")
    assert RealPlant("arm-30", "ideal").quantities()["angle"] == 0.0


def test_too_large_an_angle_ends_the_run_and_vents():
    """85 deg without load, of a limit of 60 deg."""
    mounted = mount(
        ROOT / "fixtures" / "benches" / "mock-arm-ideal.yaml", ROOT / "fixtures" / "specimens" / "arm-30.yaml"
    )
    settings = [("sweep.matrix.load", "[0 kg]"), ("sweep.repeat.count", "1"), ("prepare.precondition.cycles", "0")]
    plan = make_plan(ROOT / "protocols" / "arm-angle.yaml", mounted, settings)[0]
    trips = [replace(t, high=np.radians(60.0)) if t.channel == "angle" else t for t in mounted.bench.trips]
    outcome = run_plan(
        plan, replace(mounted, bench=replace(mounted.bench, trips=tuple(trips))), ConfirmedBeforehand(), out=None
    )
    assert outcome.exit_code == 5
    assert "angle" in outcome.why
    assert "60 deg" in outcome.why
