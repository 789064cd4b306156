"""Sessions that do not fit one muscle when they are joined, while each by itself does: means of their values.

Knows analyses and their estimates, no samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from pmabench.analysis.shared.student import mean_with_half
from pmabench.analysis.shared.trials import six_digits
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.values import METHOD, curve, name_of
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, without_value

CLEARER = 2.0
"""What is missed by the joined sessions beyond noise, over what the worst of them misses by itself: a fault that each
of them has alone is missed as much in all."""


def of_each(joined: Analysis, alone: Sequence[Analysis], orders: dict[str, tuple[int, ...]]) -> Analysis | None:
    """The analysis with the means of the sessions' values, Student's t over them; None where they do not each have the
    form of the model, or do no better than joined. `orders`: of the curves of each symbol.
    """
    forms = [one.facts.get("form", {"state": "withheld"}) for one in alone]
    if len(alone) < 2 or any(form["state"] == "withheld" for form in forms):
        return None
    missed = max(form["ratio"] ** 2 - 1 for form in forms)
    whole = joined.facts["form"]
    if whole["ratio_before"] ** 2 - 1 < CLEARER * missed:
        return None
    found: dict[tuple[object, ...], list[Estimate]] = {}
    for one in alone:
        for e in one.estimates:
            found.setdefault((e.symbol, e.method, e.coordinate, six_digits(e.at)), []).append(e)
    estimates = [_mean(mine, len(alone)) for mine in found.values()]
    mine = [e for e in estimates if e.method == METHOD and e.value is not None and set(e.at) == {"pressure"}]
    curves = [
        curve([e for e in mine if e.symbol == symbol], order) for symbol, each in orders.items() for order in each
    ]
    said = dict.fromkeys(finding for one in alone for finding in one.findings if finding.level != "note")
    total = {name: sum(one.facts[name] for one in alone) for name in ("trials", "trials_used")}
    return replace(
        joined,
        estimates=tuple(estimates),
        curves=tuple(one for one in curves if one is not None),
        dropped=tuple(one for each in alone for one in each.dropped),
        findings=(Finding("doubt", _differ(whole["ratio_before"], alone, list(found.values()))), *said),
        traces=tuple({trace.name: trace for one in alone for trace in one.traces}.values()),
        facts={**alone[0].facts, **total, "sessions": len(alone), "joined": whole},
        refusals=tuple(dict.fromkeys(why for one in alone for why in one.refusals)),
    )


def _mean(each: Sequence[Estimate], sessions: int) -> Estimate:
    """One value of all sessions; what they share is not made smaller by their number."""
    known = [e for e in each if e.value is not None]
    if len(known) < sessions:
        why = next((e.note for e in each if e.value is None), "") or f"{len(known)} of {sessions} sessions give it"
        return without_value(each[0], f"sessions differ, and not all of them give it: {why}")
    mean, half = mean_with_half([e.value or 0.0 for e in known])

    def typical(cause: str) -> float | None:
        halves = [part for e in known if (part := getattr(e.parts, cause)) is not None]
        return float(np.mean(halves)) if halves else None

    parts = Parts(
        max(half or 0.0, (typical("repeats") or 0.0) / sqrt(len(known))),
        typical("method"), typical("calibration"), typical("skew") or 0.0, typical("drift") or 0.0,
    )  # fmt: skip
    return replace(
        known[0], value=mean, parts=parts, n=sum(e.n for e in known), bias=None, corrected=False, budget=(),
        trials=tuple(dict.fromkeys(name for e in known for name in e.trials)),
        note=f"mean of {sessions} sessions, each by itself: they differ",
    )  # fmt: skip


def _differ(ratio: float, alone: Sequence[Analysis], found: Sequence[Sequence[Estimate]]) -> str:
    """In words what the sessions differ by most, by their own intervals."""
    apart = {}
    for each in found:
        halves = [e.parts.repeats for e in each if e.value is not None and e.parts.repeats]
        values = [e.value for e in each if e.value is not None]
        if each[0].method == METHOD and len(halves) == len(values) == len(alone):
            apart[float(np.ptp(values)) / float(np.sqrt(np.mean(np.square(halves))))] = each
    text = f"the {len(alone)} sessions do not fit one muscle (joined they are missed by {ratio:.3g} times the noise), "
    text += "and each by itself does: values are means of theirs, with intervals by Student's t over sessions"
    if apart:
        most = apart[max(apart)]
        name = name_of(most[0].symbol, most[0].at.get("pressure"))
        each_of = " and ".join(show(e.value or 0.0, e.quantity, 4) for e in most)
        text += f". Most apart is {name}: {each_of}"
    return f"{text}. Look at mounting, temperature and wear, or reduce the sessions apart"
