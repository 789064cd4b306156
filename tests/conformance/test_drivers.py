"""Every driver that is installed keeps the promises of a driver.

The whole suite tries one in twelve over its wire (conftest.py); `pytest tests/conformance` and `make reliability
PART=hostile` try all.
"""

import pytest

from pmabench.bench.driver_options import drivers
from pmabench.conformance import FAILED, run, subject
from pmabench.conformance.suite import CHECKS
from tests.conformance.mutants import shipped
from tests.reliability.cases import cases

QUICK = ("interface", "imports", "options")


def broken(driver, hostile, checks):
    results = run(subject(driver), hostile=hostile, only=checks)
    return [f"{result.check}: {result.why}" for result in results if result.verdict == FAILED]


@pytest.mark.parametrize("driver", sorted(drivers()))
def test_without_being_opened(driver):
    assert not broken(driver, 0, QUICK)


def test_a_driver_without_an_emulator_is_never_opened():
    assert "has no emulator, and nothing else is tried" in broken("mock", 0, ["life"])[0]


@pytest.mark.realtime
@pytest.mark.parametrize("driver", shipped())
def test_over_its_wire(driver, record_property):
    count = cases(150)
    record_property("cases", count)
    assert not broken(driver, count, [*(name for name in CHECKS if name not in QUICK), "hostile answers"])
