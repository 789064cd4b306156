"""Results are declared where they are produced: title, unit, headline; an undeclared one is an error, never dropped."""

from dataclasses import replace

import pytest

from pmabench.base.kind import Result
from pmabench.base.quantities import QUANTITIES
from pmabench.kinds.registry import all_kinds, kind_of
from pmabench.report.words import in_common
from pmabench.store.analyses.results import Analysis, Curve, Estimate

STIFF = Result("K", "stiffness", "stiffness", headline=True)
K = Estimate("K", 6.5e3, "N/m", "stiffness", "m", {"pressure": 3e5})


def analysis(*estimates, results=(STIFF,), curves=()):
    return Analysis("new-kind", ("r",), False, tuple(estimates), curves, results=results)


def test_what_is_declared_is_taken():
    assert analysis(K).results == (STIFF,)


def test_an_undeclared_estimate_is_an_error_that_names_it():
    with pytest.raises(ValueError, match="new-kind: not declared: q; declared are K. Add the result to the record"):
        analysis(K, replace(K, symbol="q"))


def test_an_undeclared_curve_is_an_error():
    line = Curve("q", "line", (K,), "pressure", (1e5, 3e5), 1.0, 0.0, "m")
    with pytest.raises(ValueError, match="not declared: q"):
        analysis(K, curves=(line,))


def test_an_undeclared_term_of_a_curve_is_an_error():
    line = Curve("K", "line", (replace(K, symbol="slope"),), "pressure", (1e5, 3e5), 1.0, 0.0, "m")
    with pytest.raises(ValueError, match="not declared: slope"):
        analysis(K, curves=(line,))


def test_another_unit_than_declared_is_an_error_except_for_terms():
    with pytest.raises(ValueError, match="K is declared as stiffness, and was given as pressure"):
        analysis(replace(K, quantity="pressure", unit="Pa"))
    analysis(replace(K, quantity="stiffness per pressure", unit="N/m/Pa", coordinate="slope"))
    area = Result("IAE", "integral of the absolute error", "", unit="m.s")
    with pytest.raises(ValueError, match=r"IAE is declared as m\.s, and was given as m"):
        analysis(Estimate("IAE", 1.0, "m", "", "m"), results=(area,))


def test_a_value_in_another_unit_than_that_of_its_quantity_is_an_error():
    with pytest.raises(ValueError, match="new-kind: K is given in N/mm; a stiffness is in N/m"):
        analysis(replace(K, value=6.5, unit="N/mm"))
    with pytest.raises(ValueError, match="K is given in N/m; a stiffness per pressure is in N/m/Pa"):
        analysis(replace(K, quantity="stiffness per pressure", coordinate="slope"))


def test_a_symbol_declared_twice_is_an_error():
    with pytest.raises(ValueError, match="declared twice in K, K"):
        analysis(K, results=(STIFF, replace(STIFF, title="bulk modulus")))


@pytest.mark.parametrize("kind", all_kinds())
def test_every_reduction_declares_titles_units_and_a_headline(kind):
    declared = kind_of(kind).results
    assert any(result.headline for result in declared)
    assert len({result.symbol for result in declared}) == len(declared)
    for result in declared:
        assert result.title
        assert result.quantity in QUANTITIES or result.unit


def test_one_coefficient_has_one_title_in_all_kinds():
    titles = {}
    for kind in all_kinds():
        for result in kind_of(kind).results:
            titles.setdefault((result.symbol, result.quantity), set()).add(result.title)
    assert {key: names for key, names in titles.items() if len(names) > 1} == {}


def test_orders_are_joined_without_breaking_one():
    assert in_common([["F_ce", "F_f"], ["F_ce", "K", "B_c"], ["K_u"], ["F_0", "K", "B_r"]]) == [
        "F_ce", "F_0", "K", "B_r", "B_c", "F_f", "K_u",
    ]  # fmt: skip
