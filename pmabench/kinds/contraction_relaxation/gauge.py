"""How late the sensors are, for times since a command: as gathered, whatever the diagnosis corrects for the fit.

A correction brings all channels behind one filter, or moves those that are in time to one that is late: that is right
for a fit of forces, and wrong for times since a command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

from pmabench.analysis.shared.samples import LAG_KNOWN, lag_of
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import in_samples
from pmabench.kinds.contraction_relaxation.diagnosis.verdict import Diagnosis
from pmabench.kinds.contraction_relaxation.intervals import NORMAL
from pmabench.kinds.contraction_relaxation.segments import Campaign


@dataclass(frozen=True)
class Late:
    """How much later than what it measures a sensor reads."""

    declared: float = 0.0
    """Taken off the samples as a delay [s]."""
    found: float = 0.0
    """More than that, by the diagnosis [s]."""
    unsure: float = 0.0
    """Half width of their sum [s]."""
    half_sample: float = 0.0
    """A digital filter is earlier than one of first order by that [s]."""

    @property
    def lag(self) -> float:
        """In all [s]."""
        return self.declared + self.found

    def filter_in(self, lags: Sequence[float], errors: Sequence[float]) -> int | None:
        """Which of several lags of a step is that of a filter of the sensor; None for none."""
        off = [abs(T - self.lag) - NORMAL * error for T, error in zip(lags, errors, strict=True)]
        nearest = min(range(len(off)), key=off.__getitem__)
        reach = LAG_KNOWN * self.lag + self.unsure + self.half_sample
        return nearest if self.lag and len(lags) > 1 and off[nearest] <= reach else None


def in_order(recorded: Campaign, diagnosis: Diagnosis) -> dict[str, Late]:
    """How late pressure and displacement are.

    The diagnosis sees the time between the two: nothing reads ahead, so one that seems to has the other late.
    """
    declared = {channel: [lag_of(run, channel) for run in recorded.runs] for channel in ("pressure", "displacement")}
    mine = [one for one in diagnosis.reported.explanations if one.kind in ("late", "lag") and one.which in declared]
    sizes = {
        name: max(lags) + sum(one.sizes[0] for one in mine if one.which == name) for name, lags in declared.items()
    }
    ahead = {name: max(0.0, -size) for name, size in sizes.items()}
    errors = [NORMAL * one.error for one in diagnosis.of_fit if one.explanation in mine]
    found = {}
    for name, other in zip(declared, reversed(declared), strict=True):
        lag, most = max(0.0, sizes[name]) + ahead[other], max(declared[name])
        known = LAG_KNOWN * most if diagnosis.reason else min(LAG_KNOWN * most, diagnosis.hidden.late(name))
        unsure = hypot(known, most - min(declared[name]), *errors) if lag else 0.0
        found[name] = Late(most, lag - most, unsure, 0.5 / recorded.rate)
    return found


def gathered(recorded: Campaign, diagnosis: Diagnosis) -> tuple[Campaign, dict[str, Late]]:
    """The campaign as recorded, with a clock of the pressure corrected, and how late pressure and displacement are."""
    clocks = [one for one in diagnosis.reported.explanations if one.kind == "clock" and one.which == "pressure"]
    return in_samples(recorded, clocks), in_order(recorded, diagnosis)
