"""The driven plant of paper 3: forces of the table, the loop's gap and its branches, samples however time is cut."""

import itertools

import numpy as np
import pytest

from pmabench.model.driven import Actuator
from pmabench.model.overrides import Overrides
from pmabench.model.presets import preset
from pmabench.model.regulator import constant, ramp, sine


def daerden(kind="ideal", pressure=5e5, **changes):
    plant = preset("daerden", kind, Overrides(**changes)).driven(Actuator(force=3000.0, speed=1.0))
    plant.command(constant(0.0, pressure))
    return plant


def loop(plant, frequency, pressure=5e5):
    """x, v, P and F of the second of two periods from -3 % to 20 %."""
    plant.move(constant(0.0, 17e-3))
    plant.advance(2.0)
    plant.move(sine(2.0, 17e-3, 23e-3, frequency, 3))
    t = 2.0 + (1.0 + np.arange(4001) / 4000) / frequency
    return plant.advance(t[-1], t)


def branch(motion, way, eps):
    rows = np.flatnonzero(way * motion.v > 0)
    rows = rows[np.argsort(motion.x[rows])]
    return np.interp(eps, motion.x[rows] / 0.2, motion.F[rows])


def test_forces_at_5_bar_are_those_of_the_table():
    plant = daerden(friction=0.0)
    plant.advance(0.05)
    for eps, force in ((-0.03, 2061), (0.0, 1288), (0.05, 942), (0.10, 700), (0.20, 320)):
        plant.move(constant(plant.time, eps * 0.2))
        plant.advance(plant.time + 1.0)
        assert plant.reading()[2] == pytest.approx(force, abs=0.6)


def test_the_gap_at_5_bar_is_60_newtons_and_expanding_is_above():
    motion = loop(daerden(), 0.01)
    eps = np.linspace(0.0, 0.17, 18)
    contracting, expanding = branch(motion, 1, eps), branch(motion, -1, eps)
    np.testing.assert_allclose(expanding - contracting, 60.0, atol=0.5)
    mean = 0.5 * (contracting + expanding)
    np.testing.assert_allclose(mean[[0, 5, 10]], [1287.9, 933.0, 699.8], rtol=0.01)


def test_the_loop_knows_no_rate():
    slow, fast = (branch(loop(daerden(), f), 1, np.linspace(0.0, 0.15, 7)) for f in (0.01, 1.0))
    np.testing.assert_allclose(slow, fast, atol=0.2)


def test_without_pressure_the_rubber_pulls_600_newtons_at_3_percent():
    plant = daerden(pressure=0.0, hysteresis=0.0)
    plant.move(ramp(0.0, 0.0, -6e-3, 1e-3))
    assert plant.advance(7.0, np.array([6.5])).F[0] == pytest.approx(600.0, abs=0.1)


def test_samples_are_the_same_however_the_time_is_cut():
    def run(cuts):
        plant = daerden("bench")
        plant.move(sine(0.0, 0.0, 5e-3, 1.3, 4))
        t = np.arange(1, 2001) / 500
        edges = [0, *cuts, len(t)]
        return np.concatenate([plant.advance(t[b - 1], t[a:b]).F for a, b in itertools.pairwise(edges)])

    np.testing.assert_allclose(run(sorted({7, 8, 9, 333, 500, 501, 1777})), run([]), atol=1e-9)


def test_a_snapshot_brings_the_branch_back():
    plant = daerden()
    plant.move(sine(0.0, 0.0, 5e-3, 1.0, 5))
    plant.advance(0.3)
    snapshot, t = plant.snapshot(), np.arange(151, 400) / 500
    first = plant.advance(0.8, t)
    plant.restore(snapshot)
    plant.move(constant(0.3, 20e-3))
    plant.advance(0.8)
    plant.restore(snapshot)
    again = plant.advance(0.8, t)
    assert again.F.tolist() == first.F.tolist()
    assert plant.reading()[2] == pytest.approx(again.F[-1], rel=1e-2)


def test_a_stall_keeps_the_branch():
    plant = preset("daerden", "ideal").driven(Actuator(force=1500.0, speed=1.0), position=20e-3)
    plant.command(constant(0.0, 5e5))
    plant.advance(0.1)
    plant.move(ramp(0.1, 20e-3, -6e-3, 5e-3))
    motion = plant.advance(8.0, np.arange(51, 4000) / 500)
    held = motion.x[-1]
    assert -6e-3 < held < 0
    mean = plant.muscle.pull(np.array(5e5), np.array(held))
    assert mean + 30.0 == pytest.approx(1500.0, abs=1.0)
    assert plant.reading()[2] == pytest.approx(mean + 30.0, abs=0.1)


def test_the_actuator_goes_no_further_than_the_formulas_hold():
    with pytest.raises(ValueError, match="stroke"):
        daerden().move(constant(0.0, -8e-3))


@pytest.mark.parametrize("changes", [{"F_s": 3.0}, {"F_c": 0.0}, {"b_relax": "b_contract"}])
def test_what_it_has_no_use_for_is_refused(changes):
    with pytest.raises(ValueError, match="no friction"):
        daerden(**changes)


def test_a_hysteresis_for_another_muscle_is_refused():
    with pytest.raises(ValueError, match="hysteresis"):
        preset("paper0", "ideal", Overrides(hysteresis=3.0))


def test_it_has_no_free_end():
    with pytest.raises(ValueError, match="driven"):
        preset("daerden", "ideal").free()
