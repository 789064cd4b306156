"""Faults that are in no list of the diagnosis: nothing is accepted under a wrong name, or far from the truth.

`pytest -s -m study tests/analysis/test_foreign_faults.py` prints what is said of each at all amounts.
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from pmabench.kinds.reduce import reduce_runs, verdicts
from tests.analysis.foreign_faults import CASES, campaign, truth
from tests.analysis.judged import as_run
from tests.analysis.test_judged import FAR, Value, compared
from tests.judge.campaign import slope

SEEDS = 3
NEAR = {"bent-sensor": {"sensor"}, "eccentric": {"sensor"}}
"""Fault -> what comes near it; of all others every name is wrong."""


@dataclass(frozen=True)
class Said:
    """What the reduction says of a campaign."""

    names: frozenset[str]
    state: str
    accepted: bool
    values: tuple[Value, ...]

    @property
    def far(self) -> list[Value]:
        """Values that are further from the truth than an interval may be wrong by."""
        return [value for value in self.values if value.score > FAR]


def said(fault: str, amount: float, seed: int) -> Said:
    """The reduction of a campaign whose displacement sensor comes without a statement of its uncertainty."""
    run = as_run(campaign(fault, amount, seed), sensor=0.0)
    analyses = reduce_runs([run], {"replays": 2})
    form = analyses[0].facts["form"]
    names = frozenset(one["cause"] for one in form["explanations"])
    values, _ = compared(analyses[0], truth("clean", 1.0, seed), slope("clean", 1.0, seed))
    return Said(names, form["state"], not verdicts([run], analyses), values)


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "amount"), [
    ("bent-sensor", 0.5), ("dead-band", 5.0), ("pulley-friction", 0.01), ("eccentric", 0.3e-3),
])  # fmt: skip
def test_what_nobody_looks_for_is_not_accepted(fault: str, amount: float):
    one = said(fault, amount, 300)
    assert not one.accepted
    assert one.state == "withheld" or fault == "eccentric", "a small one looks like a bend, whose K is not accepted"


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "amount", "symbol"), [("eccentric", 0.1e-3, "K"), ("backlash", 0.1e-3, "F_c")])
def test_an_error_of_the_displacement_sensor_that_no_test_sees_is_in_the_interval(
    fault: str, amount: float, symbol: str
):
    one = said(fault, amount, 300)
    of_symbol = [value for value in one.values if value.symbol == symbol]
    assert of_symbol, "the value is reported"
    assert max(value.error for value in of_symbol) > 5e-3, "the fault moves it"
    assert one.far == []


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_no_wrong_name_is_accepted_at_any_amount():
    found = {(*case, seed): said(*case, seed) for case in CASES for seed in range(SEEDS)}
    for (fault, amount, seed), one in found.items():
        reported = ", ".join(sorted(one.names)) or "-"
        print(f"\n{fault:16s}{amount:10.3g} seed {seed}: {one.state}, accepted {one.accepted}, {reported}", end="")
    assert {case for case, one in found.items() if case[0] in ("eccentric", "backlash") and one.far} == set()
    wrong = {case for case, one in found.items() if one.accepted and one.names - NEAR.get(case[0], set())}
    assert wrong == set()
