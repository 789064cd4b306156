"""The sentence of a value that is withheld for a departure: the limit that it names is the one that was applied."""

import pytest

from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.store.analyses.results import Estimate, Parts


def of(value: float, unit: str, quantity: str, half: float, most: float | None = None, scale: float | None = None):
    doubt = Doubt("drift", "drift", half, True, "the cell drifts", *([] if most is None else [most]))
    return weighed(Estimate("H", value, unit, quantity, "any", parts=Parts(0.1)), [doubt], scale)


@pytest.mark.parametrize(("most", "limit"), [(None, "2 %"), (0.25, "25 %"), (0.5, "50 %")])
def test_the_limit_is_that_of_the_departure(most: float | None, limit: str):
    """H is withheld above a half of it, and the sentence said 2 %."""
    share = most or 0.02
    kept, withheld = (of(6.0, "N", "force", part * share * 6.0, most) for part in (0.99, 1.01))
    assert kept.value == 6.0
    assert kept.parts.drift > 0.9 * share * 6.0
    assert withheld.withheld
    assert f"(an effect above {limit} is not left to an interval)" in withheld.note


def test_where_a_value_may_be_0_the_limit_is_no_share_of_it():
    withheld = of(1e-3, "rad", "angle", 0.03, scale=1.0)
    assert withheld.withheld
    assert "(an effect above 1.1 deg is not left to an interval)" in withheld.note
    assert of(1e-3, "rad", "angle", 0.01, scale=1.0).value == 1e-3


def test_a_departure_with_a_lower_limit_withholds_though_a_larger_one_does_not():
    """The largest effect alone was asked for its reason."""
    doubts = [Doubt("drift", "drift", 2.0, True, "a drift", 0.5), Doubt("bend", "method", 1.0, True, "a bend")]
    assert "a bend" in weighed(Estimate("H", 6.0, "N", "force", "any", parts=Parts(0.1)), doubts).note
