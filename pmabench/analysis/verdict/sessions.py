"""Scatter between sessions as a part of the intervals of an analysis of all sessions.

Trials of one session share mounting, zeros and temperature, so their scatter alone underestimates the interval of a
mean over sessions. Where the sessions together do not have the form of one muscle, values are means of theirs.
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
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts

CHANCE = 0.05
"""Significance level of the F test between sessions."""
NAME = "scatter between sessions"
WITHIN = 3
"""Degrees of freedom of the interval of a single trial, from its cycles [1]."""
CLEARER = 2.0
"""What joined sessions miss their form by beyond noise, over the worst of them by itself: less is a fault of each."""


def with_sessions(together: Analysis, alone: Sequence[Analysis]) -> Analysis:
    """The analysis of all sessions with the scatter between sessions in its intervals; `alone` has one per session.

    The half width is by Student's t over the values of the sessions, where these differ by more than repeats (F test).
    Values of a single session are not changed. A value that is withheld because the sessions do not fit together, while
    each of them gives it, is the mean of theirs; the `state` of the form is then `sessions`.
    """
    values = [{_key(e): e for e in one.estimates if e.value is not None and not e.withheld} for one in alone]
    made, apart, differ = [], list[str](), _differ(together, alone)
    for e in together.estimates:
        each = [mine[_key(e)] for mine in values if _key(e) in mine]
        if differ and e.withheld and len(each) == len(alone):
            made.append(_mean(e, each))
            continue
        half, before = _between(each), e.parts.repeats
        if e.value is None or before is None or half is None or half <= before:
            made.append(e)
            continue
        made.append(weighed(e, [Doubt(NAME, "repeats", sqrt(half**2 - before**2), False)]))
        apart.append(f"{e.symbol} (+- {show(half, e.quantity, 2)})")
    found, facts, kept = [], together.facts, list(together.findings)
    if differ:
        facts = {**facts, "form": {**facts["form"], "state": "sessions"}}
        kept = [one for one in kept if not one.text.startswith("form: ")]
        text = f"the {len(alone)} sessions do not fit one muscle, and each by itself does: values are means of theirs, "
        text += "with intervals by Student's t over sessions. Look at mounting, temperature and wear"
        found.append(Finding("doubt", text))
    if apart:
        text = f"{len(apart)} values differ between the {len(alone)} sessions by more than repeats of one session do, "
        text += f"which is in their intervals: {', '.join(apart[:3])}{', ...' if len(apart) > 3 else ''}"
        found.append(Finding("note", text))
    return replace(together, estimates=tuple(made), findings=(*kept, *found), facts=facts)


def _differ(together: Analysis, alone: Sequence[Analysis]) -> bool:
    """Whether each session has the form of the model by itself, and all of them together clearly have not."""
    whole, *each = (one.facts.get("form", {}) for one in (together, *alone))
    if whole.get("state") != "withheld" or any(form.get("state") != "sound" for form in each):
        return False
    return bool(whole["ratio_before"] ** 2 - 1 >= CLEARER * max(form["ratio"] ** 2 - 1 for form in each))


def _mean(e: Estimate, each: Sequence[Estimate]) -> Estimate:
    """A value of all sessions; what they share is not made smaller by their number."""
    mean, half = student.mean_with_half([one.value or 0.0 for one in each])

    def typical(cause: str) -> float | None:
        halves = [part for one in each if (part := getattr(one.parts, cause)) is not None]
        return float(np.mean(halves)) if halves else None

    parts = Parts(
        max(half or 0.0, (typical("repeats") or 0.0) / sqrt(len(each))),
        typical("method"), typical("calibration"), typical("skew") or 0.0, typical("drift") or 0.0,
    )  # fmt: skip
    note = f"mean of {len(each)} sessions, each by itself: they differ"
    return replace(e, value=mean, parts=parts, withheld=False, note=note)


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
