"""Powers of the load of an arm's angle (paper 2's 20 numbers) against the independent simulator: right, or withheld."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from pmabench.kinds.arm_angle import reduction
from pmabench.store.analyses.results import Analysis, Estimate
from tests.analysis.judged_forms import as_run, as_trials
from tests.judge import arm

MASSES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
"""[kg], as in paper 2."""


def reduced(cause: str, size: float, seed: int, *, off: float = 0.0) -> Analysis:
    """Six loads; `off` [rad] is what the arm with 0.3 kg bends more than the powers of the load say."""
    loads = {mass: arm.by_powers(mass) for mass in MASSES}
    a, *others = loads[0.3]
    loads[0.3] = (a + off, *others)
    settings: dict[str, object] = {"preload": arm.PRELOAD, "angle": "measured", "compare": "nothing"}
    return reduction.reduce(
        [as_run("arm-angle", as_trials(arm.campaign(cause, size, seed, loads)), arm.RATE, settings)]
    )


def powers(analysis: Analysis) -> dict[str, Estimate]:
    return {e.coordinate: e for e in analysis.estimates if e.method == "logistic-loads"}


def bare(estimates: Iterable[Estimate]) -> bool:
    """Whether no value has an interval."""
    return all(e.parts.combined is None and (e.value is None or "no repeats part" in e.note) for e in estimates)


def test_the_powers_are_those_of_the_arm_and_have_no_intervals():
    """a_0 within half the gap of friction and the scatter of the trials; high powers mean something together only."""
    found = powers(reduced("clean", 0.0, 1))
    assert len(found) == 20
    assert bare(found.values())
    assert found["a_0"].value == pytest.approx(arm.POWERS["a"][0] - arm.GAP / 2, abs=2e-3)
    assert found["c_0"].value == pytest.approx(arm.POWERS["c"][0], rel=5e-3)


def test_a_load_that_is_off_the_powers_withholds_them_and_nothing_else():
    analysis = reduced("clean", 0.0, 1, off=0.03)
    assert all(e.withheld and "off the powers of the load" in e.note for e in powers(analysis).values())
    assert not [e for e in analysis.estimates if e.withheld and e.method != "logistic-loads"]


def test_an_arm_that_creeps_has_no_powers():
    """The angle goes on by 6 %."""
    found = powers(reduced("creep", 1.0, 1))
    assert all(e.withheld and "the angle is not at rest" in e.note for e in found.values())


def test_a_cable_that_slips_withholds_the_powers_with_the_coefficients_of_its_load():
    found = powers(reduced("slip", 1.0, 1))
    assert all(e.withheld and "slips" in e.note for e in found.values())
