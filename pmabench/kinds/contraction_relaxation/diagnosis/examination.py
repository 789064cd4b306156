"""The steps of a diagnosis: cell against weights, rounds of explanations, words and what intervals owe to them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.samples import Samples
from pmabench.kinds.contraction_relaxation.diagnosis.cell import readings, weighed
from pmabench.kinds.contraction_relaxation.diagnosis.columns import zero_known
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import forces_of, in_samples
from pmabench.kinds.contraction_relaxation.diagnosis.rounds import explained
from pmabench.kinds.contraction_relaxation.diagnosis.search import Search
from pmabench.kinds.contraction_relaxation.diagnosis.spread import Spread
from pmabench.kinds.contraction_relaxation.diagnosis.verdict import Diagnosis, name
from pmabench.kinds.contraction_relaxation.diagnosis.words import named
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.store.records import Array


@dataclass(frozen=True, eq=False)
class Examined:
    """A campaign with what was found in it."""

    search: Search
    diagnosis: Diagnosis
    spread: Spread | None
    """What the correction does to intervals; None without one."""

    def corrected(self, segments: Segments) -> Segments:
        """Segments of corrected samples without the forces that the muscle has beyond the straight form."""
        state = self.diagnosis.reported
        return segments.pulled(-forces_of(self.search.followed, segments, state.straight, state.explanations))


def examined(
    recorded: Campaign, knots: Array, segments_of: Callable[[Sequence[Samples]], Segments], segments: Segments
) -> Examined:
    """The diagnosis of a campaign with these first knots [Pa]; `segments` are those of its samples as recorded."""
    gain = Scales.of(recorded.runs).gains.get("force", 0.0)
    weights = weighed(readings(recorded), {"drift": zero_known(recorded), "gain": gain})
    search = Search(in_samples(recorded, weights.found), segments_of, knots, weights.drift is None)
    rounds = explained(search, search.fitted(()))
    after, names = rounds.after, [recorded.name(i) for i in range(len(recorded.trials))]
    known = weighed(readings(search.campaign)) if weights.found else weights
    of_cell = tuple(
        named(one, np.array([errors, -errors]), after.test.fit, 0.0)
        for one, errors in zip(weights.found, weights.errors, strict=True)
    )
    spread = Spread(search, rounds.before, after, segments, rounds.undecided(search), weights.unsure, 1.0)
    change = after.test.fit.theta - after.test.fit.again(segments, after.test.expected).theta
    diagnosis = Diagnosis(known, rounds, of_cell, name(after, spread.sizes(), names), change)
    if not of_cell and not diagnosis.reported.explanations:
        return Examined(search, diagnosis, None)
    return Examined(search, diagnosis, replace(spread, state=diagnosis.reported, factor=diagnosis.factor))
