"""Scatter between sessions as a part of the intervals of an analysis of all sessions.

Trials of one session share mounting, zeros and temperature, so their scatter alone underestimates the interval of a
mean over sessions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from pmabench.analysis.shared import student
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.trials import six_digits
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Analysis, Estimate, Finding

CHANCE = 0.05
"""Significance level of the F test between sessions."""
NAME = "scatter between sessions"
WITHIN = 3
"""Degrees of freedom of the interval of a single trial, from its cycles [1]."""


def with_sessions(together: Analysis, alone: Sequence[Analysis]) -> Analysis:
    """The analysis of all sessions with the scatter between sessions in its intervals; `alone` has one per session.

    The half width is by Student's t over the values of the sessions, where these differ by more than repeats (F test).
    Values of a single session are not changed.
    """
    values = [{_key(e): e for e in one.estimates if e.value is not None and not e.withheld} for one in alone]
    made, apart = [], list[str]()
    for e in together.estimates:
        half = _between([mine[_key(e)] for mine in values if _key(e) in mine])
        before = e.parts.repeats
        if e.value is None or before is None or half is None or half <= before:
            made.append(e)
            continue
        made.append(weighed(e, [Doubt(NAME, "repeats", sqrt(half**2 - before**2), False)]))
        apart.append(f"{e.symbol} (+- {show(half, e.quantity, 2)})")
    if not apart:
        return together
    text = (
        f"{len(apart)} values differ between the {len(alone)} sessions by more than repeats of one session do, which "
        f"is in their intervals: {', '.join(apart[:3])}{', ...' if len(apart) > 3 else ''}"
    )
    return replace(together, estimates=tuple(made), findings=(*together.findings, Finding("note", text)))


def _key(e: Estimate) -> tuple[object, ...]:
    return e.symbol, e.method, e.coordinate, six_digits(e.at)


def _between(each: Sequence[Estimate]) -> float | None:
    """95 % half width of the mean of the sessions' values; None for one session or an insignificant difference."""
    known = [(one.value or 0.0, one.parts.repeats, one.n - 1 if one.n > 1 else WITHIN) for one in each]
    if len(known) < 2 or not all(half for _, half, _ in known):
        return None
    numbers, halves, freedoms = zip(*known, strict=True)
    within = float(np.mean((np.array(halves) / student.ppf(0.975, np.array(freedoms))) ** 2))
    from scipy.special import fdtrc

    share = fdtrc(len(numbers) - 1, sum(freedoms), float(np.var(numbers, ddof=1)) / within)
    return student.mean_with_half(numbers)[1] if share <= CHANCE else None
