"""Every fault of the table is found by the check that names it: in the example driver, and in every shipped one.

The whole suite tries one in `SHARE` (conftest.py); `pytest tests/conformance/test_mutants.py` and `make reliability
PART=mutants` try all; that the table is whole is in `test_suite.py`.
"""

import pytest

from pmabench.conformance import FAILED, run
from tests.conformance.faults import MUTANTS
from tests.conformance.mutants import EXAMPLE, cases, mutated, shipped

pytestmark = pytest.mark.realtime  # all of them, so that no other process compiles every bench to collect this file


def result(name, driver):
    """What the check that must find it says of a driver with the fault."""
    [found] = run(mutated(name, driver), hostile=60, only=[MUTANTS[name].found_by])
    return found


@pytest.mark.parametrize(("name", "driver"), list(cases([EXAMPLE])))
def test_in_the_example_driver_it_is_found_and_named(name, driver):
    found = result(name, driver)
    if MUTANTS[name].says not in found.why:  # a busy computer was late with something else, which is said first
        found = result(name, driver)
    assert (found.verdict, MUTANTS[name].says in found.why) == (FAILED, True), found.why


@pytest.mark.parametrize(("name", "driver"), list(cases(shipped())))
def test_in_a_shipped_driver_it_is_found(name, driver, record_property):
    found = result(name, driver)
    record_property("why", found.why)  # in the report of the harness
    assert found.verdict == FAILED, found.why
