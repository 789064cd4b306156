"""Noise: its size, and that it belongs to the sample and not to the way of fetching it."""

import numpy as np
import pytest

from pmabench.model.motion import Noise, NoiseSource


def test_noise_is_standard_normal_and_white():
    values = NoiseSource(1, 0).samples(0, 200_000)
    assert abs(values.mean()) < 0.01
    assert values.std() == pytest.approx(1, abs=0.01)
    assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 0.01


def test_a_sample_has_the_same_noise_however_it_is_fetched():
    whole = NoiseSource(7, 2).samples(100, 5000)
    source = NoiseSource(7, 2)
    pieces = [source.samples(k, min(333, 5100 - k)) for k in range(100, 5100, 333)]
    assert np.concatenate(pieces).tolist() == whole.tolist()
    assert source.one(1500) == whole[1400]
    assert source.samples(100, 5).tolist() == whole[:5].tolist()


def test_seed_and_sensor_make_a_difference():
    draws = {tuple(NoiseSource(seed, sensor).samples(0, 3)) for seed in (1, 2) for sensor in (0, 1)}
    assert len(draws) == 4


@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1, 2**32, 2**70 + 3])
def test_the_noise_of_a_seed_is_that_of_numpys_generator_for_it(seed):
    """So a run can be repeated with any version, and with a seed of any size."""
    third = np.random.default_rng((seed, 5, 2)).standard_normal(1024)
    assert NoiseSource(seed, 5).samples(2 * 1024, 1024).tolist() == third.tolist()


def test_noise_is_scaled_as_a_whole():
    assert Noise(500.0, 2e-6, 0.3).scaled(2.0) == Noise(1000.0, 4e-6, 0.6)
    with pytest.raises(ValueError, match="negative"):
        Noise().scaled(-1.0)
