"""A gauge against its command at rest, level by level: closed forms of steps to constant pressures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pmabench.analysis.shared.regulated import regulated
from pmabench.store.records import Array, RunData
from tests.analysis.judged_forms import as_run
from tests.analysis.test_polled_channels import trial

RATE, LEVELS = 100.0, (200e3, 300e3, 400e3, 500e3)


def levels(gauge: Callable[[Array], Array], declared: float = 1.5e3) -> RunData:
    """Steps of 4 s to each pressure through a lag of 0.1 s, as the gauge reads them with 300 Pa of noise."""
    t, rng, trials = np.arange(0, 4, 1 / RATE), np.random.default_rng(8), []
    for number, P in enumerate(LEVELS):
        sent = np.where(t < 0.5, 0.0, P)
        true = np.where(t < 0.5, 0.0, P * -np.expm1(-(t - 0.5) / 0.1))
        read = gauge(true) + 300 * rng.standard_normal(len(t))
        trials.append(trial(t, {"pressure": read, "pressure_command": sent}, {"pressure": P}, number))
    return as_run("validation", trials, RATE, {}, {"pressure": {"offset_uncertainty": declared}})


@pytest.mark.parametrize("gauge", [lambda P: P, lambda P: 1.008 * P, lambda P: P + 4e3, lambda P: np.minimum(P, 495e3)])
def test_a_regulator_is_off_by_as_much_as_is_usual(gauge: Callable[[Array], Array]) -> None:
    assert regulated(levels(gauge)) is None


@pytest.mark.parametrize("share", [-0.06, 0.06])
def test_a_scale_is_seen_at_all_levels(share: float) -> None:
    found = regulated(levels(lambda P: (1 + share) * P))
    assert found is not None
    assert f"{share:+.1%} off its command: " in found.text
    assert abs(found.gain) > abs(share) / 1.1


def test_one_level_of_four_that_is_off_is_said_and_held() -> None:
    """A gauge that ends at 450 kPa is 10 % off at 500 kPa alone, which a median over levels does not see."""
    found = regulated(levels(lambda P: np.minimum(P, 450e3)))
    assert found is not None
    assert "-10.0% off its command of 500 kPa" in found.text
    assert 450e3 + found.offset > 500e3


@pytest.mark.parametrize("reads", [120e3, 290e3])
def test_one_level_that_is_far_off_is_held_and_does_not_widen_the_others_by_its_share(reads: float) -> None:
    """40 % off at 200 kPa was called a wrong unit and held nowhere; 20 % of it was 100 kPa at 500 kPa."""
    found = regulated(levels(lambda P: np.where(np.abs(P - 200e3) < 2e3, reads, P)))
    assert found is not None
    assert "of 200 kPa" in found.text
    assert found.gain == 0.0
    assert found.offset == pytest.approx(1.2 * (200e3 - reads), rel=0.02)
