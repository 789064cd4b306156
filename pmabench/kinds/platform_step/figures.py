"""Figures of steps of a platform: attitude with its reference, and the three pressures.

`measure`: the values of one trial, for the display.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.platform_step import MUSCLES
from pmabench.kinds.platform_step.reduction import course_of
from pmabench.plotting.chart import PAGE, Chart, small_multiples
from pmabench.plotting.looks import BLUE, BROWN, INK, PALETTE
from pmabench.plotting.pictures import Picture, curve, has, head, how_many, label, numbers, of_charts, spread
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

COLUMNS, MOST = 3, 6
UPPER, LOWER = 120.0, 90.0
SHOWN = ("t", "phi", "psi", "reference_phi", "reference_psi", *MUSCLES, "wanted_1", "wanted_2", "wanted_3")


def attitudes(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One trial of each attitude and chain."""
    able = [trace for trace in traces if has(trace, *SHOWN)]
    if not able:
        return []
    chosen = spread(able, MOST)
    caption = (
        "Above: attitude from the accelerometer without what its height adds, and the reference that it is to follow "
        "(dashed). Below: pressures of muscles 1 to 3, and what was wanted (dashed). The step is at 0 s."
        f"{how_many(chosen, able)}"
    )
    alt = f"Attitude and pressures over time: {'; '.join(map(head, chosen))}."
    table = numbers([(head(trace), trace) for trace in chosen], SHOWN[:8])
    rows = small_multiples(list(map(_charts, chosen)), COLUMNS, width=PAGE)
    return [of_charts(rows, "Attitude of the platform", caption, alt, table, simulated=analysis.simulated)]


def _charts(trace: Trace) -> list[Chart]:
    """Attitude, and pressures below, of one trial."""
    t = label(trace, "t")
    angles = [(axis, axis, color, False) for axis, color in (("phi", BLUE), ("psi", BROWN))]
    angles += [("reference" if axis == "phi" else "", f"reference_{axis}", INK, True) for axis in ("phi", "psi")]
    pressures = []
    for n, (name, color) in enumerate(zip(MUSCLES, PALETTE[2:], strict=False), start=1):
        pressures += [(f"muscle {n}", name, color, False), ("", f"wanted_{n}", color, True)]
    upper, lower = (
        [curve(trace, "t", name, word, color, width=0.8, dashed=dashed) for word, name, color, dashed in lines]
        for lines in (angles, pressures)
    )
    return [
        Chart(t, "phi, psi [deg]", upper, height=UPPER, title=head(trace), legend=True),
        Chart(t, "pressure [kPa]", lower, height=LOWER, legend=True, y_ticks=4),
    ]


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Time to within 1 deg, overshoot and end error."""
    try:
        one = course_of(run, trial)
    except NotUsable as reason:
        return [Measured("t_1", "time", None), Measured("OS_q", "angle", None)], [str(reason)]
    time = one.settled()
    doubts = [] if time is not None else ["it does not stay within 1 deg in the second half of the hold"]
    found = [Measured("t_1", "time", time), Measured("OS_q", "angle", one.overshoot, noise=one.noise)]
    return [*found, Measured("e_q", "angle", math.hypot(*one.ends()), noise=one.noise)], doubts
