"""The preset muscles against the printed tables of their sources (assumed for paper 0; Serres 2009)."""

import numpy as np
import pytest

from pmabench.model.curve import Curve
from pmabench.model.muscle import Friction
from pmabench.model.overrides import Overrides
from pmabench.model.presets import MUSCLES, preset

TABLE_5_1 = """
100  59 5.797 1.36 10.18 0.235 0.248 0.181
200 167 6.188 1.52 26.99 0.246 0.288 0.153
300 275 6.773 1.68 40.60 0.248 0.313 0.119
400 383 7.552 1.84 50.72 0.244 0.326 0.084
500 491 8.525 2.00 57.60 0.235 0.328 0.054
550 545 9.084 2.08 59.99 0.229 0.327 0.042
"""


@pytest.mark.parametrize("row", TABLE_5_1.strip().splitlines())
def test_paper0_is_the_printed_table(row):
    kPa, f_ce, stiffness, b_c, x, tau_c, tau_r, slope = map(float, row.split())
    muscle, P = MUSCLES["paper0"](), kPa * 1e3
    assert muscle.F_ce(P) == pytest.approx(f_ce, abs=0.5)
    assert muscle.K(P) / 1e3 == pytest.approx(stiffness, abs=5.1e-4)
    assert muscle.B_c(P) / 1e3 == pytest.approx(b_c, abs=5e-3)
    assert muscle.contraction(P) * 1e3 == pytest.approx(x, abs=5.1e-3)
    assert muscle.B_c(P) / muscle.K(P) == pytest.approx(tau_c, abs=5.1e-4)
    assert muscle.B_r(P) / muscle.K(P) == pytest.approx(tau_r, abs=5.1e-4)
    rate = (muscle.contraction(P + 50) - muscle.contraction(P - 50)) / 100
    assert rate * 1e6 == pytest.approx(slope, abs=5.1e-4)


def test_paper0_has_no_force_below_45_kPa():
    assert MUSCLES["paper0"]().F_ce(45.3e3) == 0
    assert MUSCLES["paper0"]().F_ce(46e3) == pytest.approx(1.08 * 46 - 49)


@pytest.mark.parametrize(
    ("kPa", "f_ce", "stiffness", "b_r"),
    [
        (150, 481.1, 27.885, 1.57),
        (314, 958.34, 22.6206, 1.57),
        (400, 1208.6, 24.16, 1.663),
        (550, 1645.1, 26.845, 2.17),
    ],
)
def test_serres2009_is_the_published_fit(kPa, f_ce, stiffness, b_r):
    muscle, P = MUSCLES["serres2009"](), kPa * 1e3
    assert muscle.F_ce(P) == pytest.approx(f_ce)
    assert muscle.K(P) / 1e3 == pytest.approx(stiffness, abs=1e-3)
    assert muscle.B_c(P) / 1e3 == pytest.approx(2.90)
    assert muscle.B_r(P) / 1e3 == pytest.approx(b_r, abs=1e-3)


def test_serres2009_contracts_as_computed_from_the_print_and_tapers_to_the_origin():
    muscle = MUSCLES["serres2009"]()
    assert muscle.contraction(550e3) * 1e3 == pytest.approx(61.3, abs=0.05)
    assert muscle.contraction(150e3) * 1e3 == pytest.approx(17.3, abs=0.06)
    assert muscle.F_ce(100e3) == pytest.approx(320.7, abs=0.1)
    assert muscle.F_ce(0.0) == 0
    below, above = muscle.F_ce(149.999e3), muscle.F_ce(150.001e3)
    assert above - below < 0.01


@pytest.mark.parametrize("name", MUSCLES)
def test_scalar_and_array_and_closure_agree(name):
    muscle, P = MUSCLES[name](), np.linspace(0, 700e3, 1001)
    for curve in (muscle.F_ce, muscle.K, muscle.B_c, muscle.B_r):
        function = curve.function()
        expected = [curve(float(p)) for p in P]
        np.testing.assert_allclose(curve.values(P), expected, rtol=1e-14)
        np.testing.assert_allclose([function(float(p)) for p in P], expected, rtol=1e-14)


def test_a_table_is_read_along_straight_lines():
    curve = Curve.through([100e3, 200e3, 400e3], [1.0, 3.0, 2.0])
    assert [curve(P) for P in (50e3, 100e3, 150e3, 300e3, 400e3, 500e3)] == pytest.approx([1, 1, 2, 2.5, 2, 2])
    assert curve.function()(300e3) == pytest.approx(2.5)


def test_a_curve_needs_as_many_pieces_as_it_says():
    with pytest.raises(ValueError, match="one piece more"):
        Curve(((1.0,),), (1e5,))


def test_ideal_has_the_dead_time_only_and_bench_has_everything():
    ideal, bench = preset("paper0", "ideal"), preset("paper0", "bench")
    assert (ideal.regulator.dead_time, ideal.regulator.lag) == (0.04, 0.0)
    assert ideal.muscle.friction.F_s == 0
    assert ideal.noise.displacement == 0
    assert (bench.regulator.dead_time, bench.regulator.lag) == (0.04, 0.0955)
    assert bench.muscle.friction == Friction(10.0, 6.0, 1e-3)
    assert (bench.noise.pressure, bench.noise.displacement, bench.noise.force) == (500.0, 2e-6, 0.3)


def test_overrides_make_the_variants_of_the_ultimate_gain_test():
    setup = preset("paper0", "bench", Overrides(b_relax="b_contract", friction=0, regulator_lag=0.22, noise=0))
    assert setup.muscle.B_r == setup.muscle.B_c
    assert setup.muscle.friction.F_s == setup.muscle.friction.F_c == 0
    assert setup.regulator.lag == 0.22
    assert setup.noise.force == 0


@pytest.mark.parametrize(
    ("plant", "kind", "changes"),
    [
        ("paper9", "ideal", {}),
        ("paper0", "perfect", {}),
        ("paper0", "bench", {"friction": -1}),
        ("paper0", "bench", {"F_c": 20.0}),
        ("paper0", "bench", {"b_relax": "b_other"}),
        ("paper0", "ideal", {"dead_band": 100.0}),
        ("paper0", "ideal", {"dead_time": -1.0}),
        ("paper0", "ideal", {"noise": -1.0}),
    ],
)
def test_what_cannot_be_is_refused(plant, kind, changes):
    with pytest.raises(ValueError, match=r"\w"):
        preset(plant, kind, Overrides(**changes))


def test_a_curve_takes_each_pressure_for_itself():
    """All of one piece, of several, none, and one that is no number: as each of them alone."""
    curve = Curve(((1.0,), (2.0, 1.0), (5.0,)), (10.0, 20.0))
    for P in ([11.0, 12.0], [1.0, 2.0], [25.0], [1.0, 10.0, 20.0], [], [1.0, np.nan, 15.0]):
        found = curve.values(np.array(P, dtype=np.float64))
        known = [(p, value) for p, value in zip(P, found, strict=True) if p == p]
        assert [value for _, value in known] == [curve(p) for p, _ in known]
