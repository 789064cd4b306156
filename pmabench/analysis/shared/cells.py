"""Trials by operating point, whatever their order; computes nothing."""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.store.records import RunData, TrialData

Members = list[tuple[RunData, TrialData]]


def by_point(members: Sequence[tuple[RunData, TrialData]]) -> list[tuple[dict[str, float], Members]]:
    """Operating points [SI] in rising order, each with its runs and trials in the order that they came."""
    groups: dict[tuple[tuple[str, float], ...], Members] = {}
    for run, trial in members:
        key = tuple(sorted((name, round(value, 9)) for name, value in trial.point.items()))
        groups.setdefault(key, []).append((run, trial))
    return [(dict(key), group) for key, group in sorted(groups.items())]
