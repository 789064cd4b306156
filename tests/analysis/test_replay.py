"""The replay moves as pmabench.model's plant does, which integrates by LSODA from event to event."""

from __future__ import annotations

import numpy as np
import pytest

from pmabench.analysis.shared import simulated
from pmabench.analysis.shared.samples import Noise, Samples
from pmabench.kinds.contraction_relaxation.pooled import Fit
from pmabench.model.curve import Curve
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.plant import Plant
from pmabench.model.regulator import Regulator, constant

KNOTS = np.array([0.0, 200e3, 400e3, 600e3])
VALUES = {
    "F_ce": [0.0, 170.0, 380.0, 600.0],
    "K": [5.6e3, 6.2e3, 7.5e3, 9.7e3],
    "B_c": [1.2e3, 1.5e3, 1.8e3, 2.2e3],
    "B_r": [1.1e3, 1.8e3, 2.5e3, 3.1e3],
}


def fitted(F_c: float) -> Fit:
    theta = np.concatenate([*VALUES.values(), [F_c]])
    empty = np.empty(0)
    return Fit(theta, np.eye(len(theta)), np.empty((0, len(theta))), empty, True, KNOTS)


@pytest.mark.parametrize(("mass", "F_c"), [(0.5, 0.0), (0.05, 6.0), (40.0, 6.0)])
def test_replay_moves_like_the_plant(mass: float, F_c: float):
    curves = {name: Curve.through(KNOTS.tolist(), values) for name, values in VALUES.items()}
    muscle = Muscle("polygons", **curves, friction=Friction(F_s=F_c, F_c=F_c))
    plant = Plant(muscle, Regulator(dead_time=0.04, lag=0.0955), force=100.0, mass=mass)
    plant.command((*constant(0.1, 500e3), *constant(4.0, 300e3), *constant(7.0, 0.0)))
    t = np.arange(0, 10, 0.002)
    motion = plant.advance(float(t[-1]), t)
    again = simulated.run(fitted(F_c), motion.P[:, None], 0.002, np.array([100.0]), np.array([mass]), np.array([0.0]))
    assert np.abs(again.x[:, 0] - motion.x).max() < 30e-6
    moving = (np.abs(motion.v) > 5e-3) & (np.abs(np.gradient(motion.v, t)) < 0.5)
    assert np.abs(again.force[:, 0] - motion.F)[moving].max() < 0.5


def test_the_replay_rests_on_its_support():
    P = np.full((200, 1), 150e3)
    again = simulated.run(fitted(6.0), P, 0.002, np.array([200.0]), np.array([20.0]), np.array([0.0]))
    assert (again.x == 0.0).all()
    assert again.force[-1, 0] == pytest.approx(127.5)


def test_the_same_seed_shows_the_same_samples():
    t = np.arange(100) / 500
    samples = Samples(3, t, np.full(100, 3e5), np.zeros(100), np.zeros(100), np.ones(100, dtype=np.bool_), 50.0, 5.0)
    work = simulated.stretches([(samples, slice(10, 100)), (samples, slice(0, 50))], 0.002, 5)
    assert work.P.shape == (90, 2)
    run = simulated.run(fitted(0.0), work.P, work.dt, work.load, work.mass, work.x)
    noise = Noise(500.0, 2e-6, 0.3)
    first, other = simulated.measured(work, run, noise, True, 2)
    second, _ = simulated.measured(work, run, noise, True, 2)
    assert [len(s.t) for s in first] == [90, 50]
    assert np.array_equal(first[0].x, second[0].x)
    assert not np.array_equal(first[0].x, other[0].x)
    assert next(simulated.measured(work, run, noise, False, 1))[0].force is None
