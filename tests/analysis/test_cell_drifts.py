"""Cells whose zero drifts, but not evenly with time, by the independent simulator: the weights show the course.

As long as only a straight line was taken off, a cell that warms up was said to be creep of the muscle, and the campaign
accepted with values up to two half widths off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.reduce import reduce_runs, verdicts
from tests.analysis.judged import as_run
from tests.analysis.test_judged import compared, named
from tests.judge.campaign import DURATION, STARTS, campaign, slope, truth

Course = Callable[[np.ndarray], np.ndarray]
COURSES: dict[str, Course] = {
    "warms up": lambda share: -np.expm1(-4 * share),
    "root of time": np.sqrt,
    "there and back": lambda share: 0.5 * np.sin(2 * np.pi * share),
}
"""Change of the zero by the share of the campaign that is over; of size 1."""


def drifted(course: Course, size: float, seed: int):
    """The analysis of a clean campaign whose cell drifted by `size` [N], what speaks against it, its values."""
    trials = campaign("clean", 0.0, seed)
    moved = [replace(one, force=one.force + size * course(one.t / (STARTS[-1] + DURATION))) for one in trials]
    run = as_run(moved)
    analyses = reduce_runs([run])
    values, withheld = compared(analyses[0], truth("clean", 0.0, seed), slope("clean", 0.0, seed))
    return analyses[0], verdicts([run], analyses), values, withheld


@pytest.mark.slow
@pytest.mark.parametrize("size", [4.0, 12.0])
@pytest.mark.parametrize("course", COURSES)
def test_a_drift_of_any_smooth_course_is_named_and_taken_off(course: str, size: float):
    analysis, against, values, withheld = drifted(COURSES[course], size, 701)
    assert named(analysis) == ("drift",)
    assert (against, withheld) == ([], 0)
    assert max(value.score for value in values) <= 1.0
    assert max(value.half for value in values if value.symbol == "K") <= 0.005


@pytest.mark.slow
@pytest.mark.parametrize("seed", [702, 703])
def test_a_zero_that_walks_is_not_accepted(seed: int):
    steps = np.random.default_rng(seed).normal(0.0, 1.0, 2001)
    walk = np.cumsum(steps) / np.sqrt(2000)
    _, against, values, _ = drifted(lambda share: np.interp(share, np.linspace(0.0, 1.0, 2001), walk), 12.0, seed)
    assert against
    assert all(value.score <= 2.0 for value in values)
