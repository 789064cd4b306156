"""Paper 1 end to end: protocol file, engine, record, reduction, against the printed S and D of the simulated muscle."""

from __future__ import annotations

from math import pi, radians, sin, tan

import pytest

from pmabench.kinds.contraction_relaxation.paper1 import DRIVEN, METHODS
from pmabench.report.document.tables import polynomials_table
from pmabench.store.analyses.folder import read_analysis, write_analysis
from tests.test_characterisation import analysed

TABLE = {
    1.0: (26.65, 17.35, 10.09),
    1.5: (27.39, 16.12, 15.79),
    2.0: (30.99, 16.29, 20.93),
    2.5: (35.51, 16.80, 28.33),
    3.0: (40.22, 17.35, 38.05),
    3.5: (45.00, 18.00, 49.00),
    4.0: (49.89, 18.90, 60.08),
    4.5: (54.88, 20.10, 70.87),
    5.0: (59.85, 21.53, 81.84),
    5.5: (64.68, 23.06, 94.10),
    6.0: (69.59, 24.71, 108.70),
}
"""bar: S [N/mm], D of contraction and of relaxation [N.s/mm], computed from paper 1's printed polynomials."""
WHOLE_BARS = ("sweep.matrix.pressure", "[1 bar, 2 bar, 3 bar, 4 bar, 5 bar, 6 bar]")
PROTOCOL, SPECIMEN = "contraction-relaxation-paper1", "dmsp-40-305"


def off(analysis, symbol, method):
    """Relative distance to the table by pressure [bar]."""
    column = ("K", "B_c", "B_r").index(symbol)
    return {
        e.at["pressure"] / 1e5: e.value / (1e3 * TABLE[round(e.at["pressure"] / 1e5, 1)][column]) - 1
        for e in analysis.estimates
        if (e.symbol, e.method) == (symbol, method) and e.value is not None
    }


@pytest.fixture(scope="module")
def ideal(tmp_path_factory):
    return analysed(tmp_path_factory.mktemp("ideal"), PROTOCOL, "mock-dmsp-ideal", SPECIMEN)


def test_the_table_comes_back_within_1_percent(ideal):
    assert ideal.facts["trials_used"] == 22
    for symbol, bound in (("K", 1e-3), ("B_c", 1e-3), ("B_r", 1e-2)):
        found = off(ideal, symbol, METHODS["x0"])
        assert len(found) == 11
        assert max(map(abs, found.values())) < bound, symbol


def test_the_load_is_half_of_the_muscles_weight_and_enters_S(ideal):
    """F_ce - L = S x_max with L = 5 N of 885 N at 1 bar: left out, S would be 0.57 % too high."""
    step = next(s for s in ideal.facts["steps"] if s["to"] == 1e5)
    assert step["load"] == pytest.approx(0.5 * 1.0194 * 9.81)
    theta = radians(26.5)
    force = pi * 0.020**2 * 1e5 * (3 / tan(theta) ** 2 - 1 / sin(theta) ** 2)
    K = next(e for e in ideal.estimates if (e.symbol, e.method) == ("K", METHODS["x0"]) and e.at["pressure"] == 1e5)
    assert K.value == pytest.approx((force - step["load"]) / step["x_max"], rel=2e-4)


def test_strokes_and_time_constants_are_those_of_the_digest(ideal):
    up = [s for s in ideal.facts["steps"] if s["from"] == 0]
    assert [1e3 * s["x_max"] for s in up[::2]] == pytest.approx([33.0, 57.0, 65.9, 70.9, 73.9, 76.3], abs=0.06)
    assert [s["tau"] for s in up[::2]] == pytest.approx([0.651, 0.526, 0.431, 0.379, 0.360, 0.355], abs=1.5e-3)


def test_analysis_folder_and_table_keep_the_polynomials(ideal, tmp_path):
    assert read_analysis(write_analysis(ideal, tmp_path / "a")).curves == ideal.curves
    table = polynomials_table([ideal])
    assert {"1", "z", "z²", "z⁶"} <= set(table.columns)
    assert table["method"][0] == "paper-1-x0; z = (P − 350) / 165.83, 100 to 600 kPa"


def test_a_muscle_and_a_reduction_of_one_convention(tmp_path):
    """With F_ce frozen at x_max in both, S comes back; the other convention is named and far off."""
    settings = [("reduction.F_ce_at", "xmax"), WHOLE_BARS]
    analysis = analysed(tmp_path, PROTOCOL, "mock-dmsp-ideal", SPECIMEN, settings, fce_eval="xmax")
    assert analysis.estimates[0].method == METHODS["xmax"]
    for symbol, bound in (("K", 2e-3), ("B_c", 2e-3), ("B_r", 1.5e-2)):
        assert max(map(abs, off(analysis, symbol, METHODS["xmax"]).values())) < bound, symbol
    assert min(off(analysis, "K", METHODS["x0"]).values()) > 0.3


def test_behind_a_slow_regulator_the_measured_pressure_gives_D_and_paper_1_is_reported_as_high(tmp_path):
    analysis = analysed(tmp_path, PROTOCOL, "mock-dmsp", SPECIMEN, [WHOLE_BARS])
    papers, driven = off(analysis, "B_c", METHODS["x0"]), off(analysis, "B_c", DRIVEN)
    assert len(papers) == len(driven) == 6
    assert min(papers.values()) > 0.10
    assert max(map(abs, driven.values())) < 0.05
    assert max(map(abs, off(analysis, "K", DRIVEN).values())) < 0.02
    assert any("B_c +1" in f.text and "takes the pressure for a step" in f.text for f in analysis.findings)
    for e in analysis.estimates:
        if (e.symbol, e.method) == ("B_c", METHODS["x0"]):
            P = e.at["pressure"] / 1e5
            assert e.bias / e.value == pytest.approx(1 - (1 + driven[P]) / (1 + papers[P]), rel=1e-3)
