"""What the regulator did, and when: the pressure as it was gathered, whatever the diagnosis corrects for the fit.

A correction brings all channels behind one filter, or moves those that are in time to one that is late: that is right
for a fit of forces, and wrong for times since a command.
"""

from __future__ import annotations

from pmabench.kinds.contraction_relaxation.diagnosis.corrections import TIMES, in_samples
from pmabench.kinds.contraction_relaxation.diagnosis.verdict import Diagnosis
from pmabench.kinds.contraction_relaxation.segments import Campaign


def gathered(recorded: Campaign, diagnosis: Diagnosis) -> Campaign:
    """The campaign as recorded, corrected for what is wrong with the time of the pressure itself."""
    own = [one for one in diagnosis.reported.explanations if one.kind in TIMES and one.which == "pressure"]
    return in_samples(recorded, own)
