"""Pressure that depends on the motion: against the library's chamber, a closed chamber, itself, and at its extremes."""

import itertools
import math

import numpy as np
import pytest

from pmabench.model.driven import Actuator
from pmabench.model.library import MODELS
from pmabench.model.overrides import Overrides
from pmabench.model.presets import preset
from pmabench.model.regulator import Wave, constant, ramp, sine

LOW, MIDDLE, HALF = -6e-3, 17e-3, 23e-3


def bench(position=0.0, **changes):
    return preset("daerden", "bench", Overrides(noise=0.0, follow_lag=0.0, **changes)).driven(
        Actuator(force=9000.0, speed=1.0), position=position
    )


def full_stroke(frequency, periods=2.0, **changes):
    """From -3 % to 20 % and back at 5 bar, from 2 s on; 4000 samples a period."""
    plant = bench(LOW, **changes)
    plant.command(constant(0.0, 5e5))
    plant.advance(2.0)
    plant.move((Wave(2.0, MIDDLE, amplitude=HALF, omega=2 * math.pi * frequency, phase=-math.pi / 2),))
    t = 2.0 + np.arange(round(4000 * periods) + 1) / 4000 / frequency
    return plant, plant.advance(float(t[-1]), t)


@pytest.mark.parametrize("frequency", [0.1, 1.0, 3.0])
def test_a_sine_gives_the_pressure_of_the_library(frequency):
    """`driven-chamber` integrates the same equation by LSODA."""
    _, motion = full_stroke(frequency)
    rows = slice(None, None, 40)
    expected = MODELS["driven-chamber"].evaluate({"time": motion.t[rows] - 2.0, "frequency": frequency})
    np.testing.assert_allclose(motion.P[rows], expected["pressure"], atol=10.0)


@pytest.mark.parametrize(
    ("frequency", "contracting", "expanding"), [(0.1, -2.8, 5.6), (1.0, -26.0, 60.0), (3.0, -72.0, 200.0)]
)
def test_the_error_is_small_contracting_and_large_expanding(frequency, contracting, expanding):
    """[kPa]; the reference plant's numbers, in the second period."""
    _, motion = full_stroke(frequency)
    error = (motion.P[4000:] - 5e5) / 1e3
    assert error.min() == pytest.approx(contracting, rel=0.03)
    assert error.max() == pytest.approx(expanding, rel=0.03)
    assert (error[motion.v[4000:] > 0].min(), error[motion.v[4000:] < 0].max()) == (error.min(), error.max())


def test_a_shut_valve_keeps_p_v_to_the_k():
    plant = bench()
    plant.command(constant(0.0, 3e5))
    plant.advance(3.0)
    plant.shut(shut=True)
    plant.command(constant(3.0, 0.0))
    plant.move(ramp(3.0, 0.0, 40e-3, 10e-3))
    motion = plant.advance(8.0, 3.0 + np.arange(1, 2501) / 500)
    V = MODELS["daerden-volume"].evaluate({"contraction": np.minimum(motion.x / 0.2, 0.2)})["volume"]
    expected = MODELS["closed-chamber"].evaluate({"volume": V, "volume_start": math.pi / 4 * 8e-5})["pressure"]
    np.testing.assert_allclose(motion.P, expected, atol=0.1)
    plant.shut(shut=False)
    assert plant.advance(10.0, np.array([10.0])).P[0] == pytest.approx(0.0, abs=1.0)


def test_samples_are_the_same_however_the_time_is_cut():
    def run(cuts):
        plant, t, F = bench(), np.arange(1, 1501) / 500, []
        edges = sorted({0, len(t), 250, 700, *cuts})
        for a, b in itertools.pairwise(edges):
            if a == 0:
                plant.command(constant(0.0, 5e5))
                plant.move(sine(0.0, 0.0, 5e-3, 3.0, 8))
            elif a == 250:
                plant.command(ramp(0.5, 5e5, 2e5, 4e5))
            elif a == 700:
                plant.supply.force(1.4, 0.0, 0.1)
            motion = plant.advance(float(t[b - 1]), t[a:b])
            F.append(np.stack([motion.P, 1e3 * motion.F]))
        return np.concatenate(F, axis=1)

    rng = np.random.default_rng(1)
    np.testing.assert_allclose(run(rng.integers(1, 1500, 300).tolist()), run([]), atol=1e-3)


@pytest.mark.parametrize("moment", [1.0, 1.0003, 1.00049])
def test_a_step_between_two_nodes_is_the_exponential_of_its_own_moment(moment):
    plant = bench(dead_time=0.0, regulator_lag=0.0)
    plant.command(constant(0.0, 1e5))
    plant.advance(moment)
    plant.command(constant(moment, 4e5))
    t = moment + np.array([1e-4, 1e-3, 5e-3, 2e-2])
    pace = 1.2 * 287 * 293 * 1e-7 / 62.832e-6
    expected = 4e5 - 3e5 * np.exp(-pace * (t - moment))
    np.testing.assert_allclose(plant.advance(2.0, t).P, expected, atol=5.0)


def test_a_stall_is_found_alike_in_one_stretch_and_in_many():
    def run(count):
        plant = preset("daerden", "bench", Overrides(noise=0.0)).driven(Actuator(force=1500.0), position=20e-3)
        plant.command(constant(0.0, 5e5))
        plant.advance(1.0)
        plant.move((*sine(1.0, 20e-3, 5e-3, 4.0, 4), Wave(2.0, 20e-3, slope=-0.1), Wave(2.25, -5e-3)))
        t = 1.0 + np.arange(1, 1001) / 500
        parts = [plant.advance(float(part[-1]), part) for part in np.split(t, count)]
        return np.concatenate([[motion.P, 1e3 * motion.F, 1e6 * motion.x] for motion in parts], axis=1)

    assert -5e3 < run(1)[2, -1] < 15e3
    np.testing.assert_allclose(run(1), run(500), atol=1e-3)


def test_a_snapshot_brings_the_air_back():
    plant, _ = full_stroke(1.0, 0.4)
    snapshot, t = plant.snapshot(), 2.4 + np.arange(500) / 500
    first = plant.advance(3.4, t)
    plant.restore(snapshot)
    plant.command(constant(2.4, 0.0))
    plant.shut(shut=True)
    plant.advance(3.0)
    plant.restore(snapshot)
    again = plant.advance(3.4, t)
    assert again.P.tolist() == first.P.tolist()
    assert plant.pressure == pytest.approx(again.P[-1], rel=1e-2)


@pytest.mark.parametrize("flow", [1e-12, 1.4e-8, 1e-3, 1e6])
def test_no_conductance_makes_it_diverge(flow):
    _, motion = full_stroke(3.0, conductance_fill=flow, conductance_vent=flow)
    assert np.isfinite(motion.P).all()
    assert motion.P.min() > -101325.0
    assert motion.P.max() < 2e6
    if flow >= 1e-3:
        np.testing.assert_allclose(motion.P, 5e5, atol=50.0)


def test_a_leak_empties_a_shut_muscle_and_is_made_up_for_by_an_open_one():
    plant = bench(leak=0.2)
    plant.command(constant(0.0, 3e5))
    plant.advance(1.0)
    assert plant.pressure == pytest.approx(3e5 / (1 + 0.2 * 62.832e-6 / (1.2 * 287 * 293 * 1e-7)), rel=1e-4)
    plant.shut(shut=True)
    P = plant.pressure
    assert plant.advance(3.0, np.array([3.0])).P[0] == pytest.approx(P * math.exp(-0.4), rel=1e-6)


def test_ideal_has_no_air_unless_asked():
    assert preset("daerden", "ideal").air is None
    assert preset("daerden", "ideal", Overrides(conductance_fill=1e-7)).air is not None
    assert preset("daerden", "bench", Overrides(conductance_fill=0.0, conductance_vent=0.0)).air is None
    with pytest.raises(ValueError, match="volume"):
        preset("paper0", "bench", Overrides(conductance_fill=1e-7))
