"""Figures of steps of a platform: attitude with its reference, and the three pressures."""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.kinds.platform_step import MUSCLES
from pmabench.plotting.chart import PAGE, Chart, small_multiples
from pmabench.plotting.looks import BLUE, BROWN, INK, PALETTE
from pmabench.plotting.pictures import Picture, curve, has, head, how_many, label, numbers, of_charts, spread
from pmabench.store.analyses.results import Analysis, Trace

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
