"""How late the sensors are, for times since a command: as gathered, whatever the diagnosis corrects for the fit.

A correction brings all channels behind one filter, or moves those that are in time to one that is late: that is right
for a fit of forces, and wrong for times since a command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

from pmabench.analysis.shared.samples import LAG_KNOWN, lag_of
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import TIMES, in_samples
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

    @classmethod
    def of(cls, recorded: Campaign, diagnosis: Diagnosis, channel: str) -> Late:
        """Of a channel; one that is ahead of the others is not late."""
        declared = [lag_of(run, channel) for run in recorded.runs]
        mine = [one for one in diagnosis.reported.explanations if one.kind in ("late", "lag") and one.which == channel]
        found, most = sum(one.sizes[0] for one in mine), max(declared)
        if most + found <= 0:
            return cls()
        errors = [NORMAL * one.error for one in diagnosis.of_fit if one.explanation in mine]
        known = LAG_KNOWN * most if diagnosis.reason else min(LAG_KNOWN * most, diagnosis.hidden.late(channel))
        return cls(most, found, hypot(known, most - min(declared), *errors), 0.5 / recorded.rate)

    def filter_in(self, lags: Sequence[float], errors: Sequence[float]) -> int | None:
        """Which of several lags of a step is that of a filter of the sensor; None for none."""
        off = [abs(T - self.lag) - NORMAL * error for T, error in zip(lags, errors, strict=True)]
        nearest = min(range(len(off)), key=off.__getitem__)
        reach = LAG_KNOWN * self.lag + self.unsure + self.half_sample
        return nearest if self.lag and len(lags) > 1 and off[nearest] <= reach else None


def gathered(recorded: Campaign, diagnosis: Diagnosis) -> tuple[Campaign, Late]:
    """The campaign as recorded, and how late its pressure is; corrected for a clock of the pressure, and where it comes
    to the muscle later than to the gauge.
    """
    late = Late.of(recorded, diagnosis, "pressure")
    own = [one for one in diagnosis.reported.explanations if one.kind in TIMES and one.which == "pressure"]
    return in_samples(recorded, [one for one in own if one.kind == "clock" or not late.lag]), late
