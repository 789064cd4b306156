"""The plant of paper 1: contraction and time constants of the table, in both directions and both conventions of F_ce."""

import numpy as np
import pytest

from pmabench.model.overrides import Overrides
from pmabench.model.presets import preset
from pmabench.model.regulator import constant

BARS = (1, 2, 3, 4, 5, 6)
X0 = (33.0, 57.0, 65.9, 70.9, 73.9, 76.3)
XMAX = (24.3, 35.5, 38.9, 40.6, 41.6, 42.4)
TAU_C = (0.651, 0.526, 0.431, 0.379, 0.360, 0.355)
TAU_R = (0.379, 0.675, 0.946, 1.204, 1.367, 1.562)
"""[mm] and [s] at 1 .. 6 bar, computed from the printed polynomials; L = 5 N."""
DEAD = 0.04


def ideal(**changes):
    return preset("dmsp-40-305", "ideal", Overrides(**changes)).free(force=5.0, mass=0.5)


def time_constant(t, x, x_end, way):
    """From the moment at which 1 - 1/e of the way is gone; the moving mass shifts it by M / B, 30 us."""
    share = (x - x[0]) / (x_end - x[0])
    return float(np.interp(1 - np.exp(-1), share, t)) - t[0] - DEAD


@pytest.mark.parametrize(("bar", "x", "tau"), list(zip(BARS, X0, TAU_C, strict=True)))
def test_a_step_from_0_comes_to_x_with_d_over_s(bar, x, tau):
    plant, t = ideal(), np.arange(10001) / 1000
    plant.command(constant(0.0, bar * 1e5))
    found = plant.advance(10.0, t).x
    assert found[-1] * 1e3 == pytest.approx(x, abs=0.051)
    assert time_constant(t, found, found[-1], 1) == pytest.approx(tau, abs=1e-3)


@pytest.mark.parametrize(("bar", "tau"), list(zip(BARS, TAU_R, strict=True)))
def test_a_vent_takes_the_time_constant_of_the_pressure_before_it(bar, tau):
    plant, t = ideal(), 10.0 + np.arange(10001) / 1000
    plant.command(constant(0.0, bar * 1e5))
    plant.advance(10.0)
    plant.command(constant(10.0, 0.0))
    found = plant.advance(20.0, t).x
    end = -5.0 / plant.muscle.K(0.0)
    assert found[-1] == 0
    assert time_constant(t, found, end, -1) == pytest.approx(tau, abs=1e-3)


def test_each_vent_begins_anew():
    """6 bar to 3, then 3 to 0: the second one is as fast as from 3 bar, and the rest at 3 bar is where it belongs."""
    plant = ideal()
    plant.command(constant(0.0, 6e5))
    plant.advance(10.0)
    plant.command(constant(10.0, 3e5))
    plant.advance(30.0)
    assert plant.x * 1e3 == pytest.approx(65.9, abs=0.051)
    plant.command(constant(30.0, 0.0))
    t = 30.0 + np.arange(10001) / 1000
    found = plant.advance(40.0, t).x
    assert time_constant(t, found, -5.0 / plant.muscle.K(0.0), -1) == pytest.approx(0.946, abs=1e-3)


def test_a_snapshot_knows_the_vent_that_is_under_way():
    plant = ideal()
    plant.command(constant(0.0, 6e5))
    plant.advance(5.0)
    plant.command(constant(5.0, 0.0))
    plant.advance(5.5)
    snapshot, t = plant.snapshot(), 5.5 + np.arange(500) / 500
    first = plant.advance(6.5, t).x
    plant.restore(snapshot)
    plant.command(constant(5.5, 2e5))
    plant.advance(8.0)
    plant.command(constant(8.0, 0.0))
    plant.advance(9.0)
    plant.restore(snapshot)
    assert plant.advance(6.5, t).x.tolist() == first.tolist()


@pytest.mark.parametrize(("bar", "x"), list(zip(BARS, XMAX, strict=True)))
def test_f_ce_at_x_max_contracts_less(bar, x):
    plant = ideal(fce_eval="xmax")
    plant.command(constant(0.0, bar * 1e5))
    plant.advance(10.0)
    assert plant.x * 1e3 == pytest.approx(x, abs=0.06)


@pytest.mark.parametrize("fce_eval", ["x0", "xmax"])
def test_nothing_is_negative_below_1_bar_and_nothing_jumps(fce_eval):
    muscle, P = preset("dmsp-40-305", "ideal", Overrides(fce_eval=fce_eval)).muscle, np.linspace(0.0, 7e5, 70_001)
    for curve, least in (
        (muscle.F_ce, 0.0),
        (muscle.K, 2e4),
        (muscle.B_c, 1e4),
        (muscle.B_r, 1e4),
        (muscle.tau_r, 0.3),
    ):
        values = curve.values(P)
        assert values.min() >= least
        assert np.abs(np.diff(values)).max() < 2e-3 * values.max()


def test_f_ce_of_another_plant_has_one_convention():
    with pytest.raises(ValueError, match="fce_eval"):
        preset("paper0", "ideal", Overrides(fce_eval="xmax"))


def test_an_unknown_convention_is_refused():
    with pytest.raises(ValueError, match="x0 or xmax"):
        ideal(fce_eval="half")
