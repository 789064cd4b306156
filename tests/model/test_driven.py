"""The driven-end plant against closed forms: force from the actuator's motion, limits of the actuator."""

import math

import numpy as np
import pytest

from pmabench.model.driven import Actuator, DrivenPlant
from pmabench.model.overrides import Overrides
from pmabench.model.presets import preset
from pmabench.model.regulator import constant, ramp, sine


def driven(kind="ideal", pressure=300e3, actuator=None, **changes):
    setup = preset("paper0", kind, Overrides(**changes))
    return DrivenPlant(setup.muscle, setup.regulator, actuator or Actuator(lag=setup.follow_lag), pressure=pressure)


def test_a_sine_gives_stiffness_and_the_damping_of_each_direction():
    plant = driven()
    plant.move(ramp(0.0, 0.0, 20e-3, 0.1))
    plant.advance(1.0)
    plant.move(sine(1.0, 20e-3, 8e-3, 0.5, 3))
    t = np.arange(501, 3500) / 500
    motion, w = plant.advance(8.0, t), math.pi
    x, v = 20e-3 + 8e-3 * np.sin(w * (t - 1)), 8e-3 * w * np.cos(w * (t - 1))
    damping = np.where(v > 0, 1.68e3, 2.12e3)
    np.testing.assert_allclose(motion.x, x, atol=1e-12)
    np.testing.assert_allclose(motion.x_set, x, atol=1e-12)
    np.testing.assert_allclose(motion.F, 275 - 6773 * x - damping * v, atol=1e-6)


def test_friction_opposes_motion_and_is_gone_at_rest():
    plant = driven("bench", follow_lag=0.0)
    plant.move(ramp(0.0, 0.0, 10e-3, 10e-3))
    motion = plant.advance(2.0, np.array([0.5, 1.5]))
    assert motion.F[0] == pytest.approx(275 - 6773 * 5e-3 - 1.68e3 * 10e-3 - 6.0)
    assert motion.F[1] == pytest.approx(275 - 67.73)


def test_a_follow_error_lags_a_ramp_by_speed_times_lag():
    plant = driven("bench")
    plant.move(ramp(0.0, 0.0, 40e-3, 20e-3))
    motion = plant.advance(1.0, np.array([1.0]))
    assert motion.x_set[0] - motion.x[0] == pytest.approx(20e-3 * 0.005)


def test_a_muscle_cannot_push():
    plant = driven(pressure=100e3)
    plant.move(ramp(0.0, 0.0, 40e-3, 10e-3))
    motion = plant.advance(4.0, np.arange(0, 2001) / 500)
    expected = 59 - 5797 * motion.x - 1.36e3 * 10e-3
    np.testing.assert_allclose(motion.F[1:], np.maximum(0, expected)[1:], atol=1e-9)
    assert expected.min() < -100


def test_a_step_is_driven_at_full_speed():
    plant = driven(actuator=Actuator(speed=0.1))
    plant.move(constant(0.0, 30e-3))
    motion = plant.advance(1.0, np.array([0.1, 0.2, 0.3, 0.5]))
    np.testing.assert_allclose(motion.x, [10e-3, 20e-3, 30e-3, 30e-3])
    assert motion.x_set.tolist() == [30e-3] * 4


def test_a_ramp_from_elsewhere_is_caught_up_with():
    plant = driven(actuator=Actuator(speed=0.1))
    plant.move(ramp(0.0, 18e-3, 38e-3, 10e-3))
    t = np.array([0.1, 0.2, 1.0, 3.0])
    np.testing.assert_allclose(plant.advance(3.0, t).x, [10e-3, 20e-3, 28e-3, 38e-3], atol=1e-9)


def test_a_sine_from_elsewhere_keeps_its_phase():
    plant = driven(actuator=Actuator(speed=0.1))
    plant.move(sine(0.0, 20e-3, 5e-3, 0.5, 2))
    t = np.array([0.1, 1.5, 2.25])
    expected = [10e-3, *(20e-3 + 5e-3 * np.sin(math.pi * t[1:]))]
    np.testing.assert_allclose(plant.advance(3.0, t).x, expected, atol=1e-9)


@pytest.mark.parametrize(
    "waves",
    [
        constant(0.0, 95e-3),
        ramp(0.0, 0.0, -20e-3, 1e-2),
        sine(0.0, 80e-3, 20e-3, 0.1, 1),
        sine(0.0, 20e-3, 10e-3, 20.0, 1),
    ],
)
def test_what_the_actuator_cannot_do_is_refused(waves):
    with pytest.raises(ValueError, match="actuator"):
        driven().move(waves)


def test_it_stalls_above_its_force_and_goes_on_when_asked():
    plant = driven(actuator=Actuator(force=200.0), pressure=300e3)
    plant.move(constant(0.0, 30e-3))
    plant.advance(1.0)
    plant.move(ramp(1.0, 30e-3, 0.0, 10e-3))
    motion = plant.advance(4.0, np.arange(501, 2001) / 500)
    held = motion.x[-1]
    assert 275 - 6773 * held + 2.12e3 * 10e-3 == pytest.approx(200.0, abs=0.2)
    assert motion.F[-1] < 200
    assert motion.x_set[-1] == 0
    plant.move(constant(4.0, 30e-3))
    assert plant.advance(5.0, np.array([5.0])).x[0] == pytest.approx(30e-3)


def test_pressure_follows_its_own_command():
    plant = driven("bench", pressure=0.0)
    plant.command(constant(0.0, 300e3))
    motion = plant.advance(1.0, np.array([0.04, 0.1355, 1.0]))
    np.testing.assert_allclose(motion.P, 300e3 * (1 - np.exp(-(motion.t - 0.04) / 0.0955)))
    assert motion.P_set.tolist() == [300e3] * 3
    assert motion.F[0] == 0


def test_a_snapshot_brings_everything_back():
    plant = driven("bench")
    plant.move(sine(0.0, 0.0, 5e-3, 1.0, 5))
    plant.advance(0.3)
    snapshot, t = plant.snapshot(), np.arange(151, 400) / 500
    first = plant.advance(0.8, t)
    plant.restore(snapshot)
    plant.move(constant(0.3, 20e-3))
    plant.command(constant(0.3, 0.0))
    plant.advance(0.8)
    plant.restore(snapshot)
    again = plant.advance(0.8, t)
    assert again.F.tolist() == first.F.tolist()
    assert plant.reading() == pytest.approx((again.x[-1], again.P[-1], again.F[-1]), rel=1e-2)


def test_an_impossible_actuator_is_refused():
    with pytest.raises(ValueError, match="stroke"):
        Actuator(low=1e-3)
