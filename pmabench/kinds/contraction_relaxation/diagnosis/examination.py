"""The steps of a diagnosis: cell against weights, rounds of explanations, words and what intervals owe to them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pmabench.analysis.shared.samples import Samples
from pmabench.kinds.contraction_relaxation.diagnosis.cell import Weighed, readings, weighed
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import in_samples
from pmabench.kinds.contraction_relaxation.diagnosis.rounds import Rounds, Search, explained
from pmabench.kinds.contraction_relaxation.diagnosis.spread import Spread
from pmabench.kinds.contraction_relaxation.diagnosis.verdict import Diagnosis, name
from pmabench.kinds.contraction_relaxation.diagnosis.words import named
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.store.records import Array


def diagnosed(
    recorded: Campaign, knots: Array, segments_of: Callable[[Sequence[Samples]], Segments]
) -> tuple[Search, Weighed, Rounds]:
    """The cell against the weights, and explanations of what a fit leaves over."""
    weights = weighed(readings(recorded))
    search = Search(in_samples(recorded, weights.found), segments_of, knots, weights.drift is None)
    return search, weights, explained(search, search.fitted(()))


def described(
    search: Search, weights: Weighed, rounds: Rounds, as_recorded: Segments
) -> tuple[Diagnosis, Spread | None]:
    """The diagnosis, and what the correction does to intervals; None without one."""
    after, names = rounds.after, [search.campaign.name(i) for i in range(len(search.campaign.trials))]
    known = weights if not weights.found else weighed(readings(search.campaign))
    if not weights.found and not after.explanations:
        return Diagnosis(known, rounds, (), (), np.zeros(len(after.test.fit.theta))), None
    spread = Spread(search, after, as_recorded, rounds.undecided, 1.0)
    errors = {"drift": weights.drift, "gain": weights.gain}
    of_cell = tuple(
        named(one, np.array([[error[1]], [-error[1]]]), after.test.fit, 0.0)
        for one in weights.found
        if (error := errors[one.kind]) is not None
    )
    change = after.test.fit.theta - after.test.fit.again(as_recorded, after.test.expected).theta
    diagnosis = Diagnosis(known, rounds, of_cell, name(after, spread.sizes(), names), change)
    return diagnosis, replace(spread, factor=diagnosis.factor)
