"""Figure of single steps next to paper 1's closed form."""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.analysis.results import Analysis, Trace
from pmabench.plotting.motion import overlays
from pmabench.plotting.pictures import (
    Picture,
)

CLOSED_FORM = "closed form of single steps with the polynomials of the first method, from the mean dead time on"


def step_overlays(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Steps up and steps down apart: each has its own damping."""
    ways = [[t for t in traces if t.name.startswith(f"step-{way}-")] for way in ("to", "from")]
    titles = ("Contraction, measured and closed form", "Relaxation, measured and closed form")
    return [p for mine, title in zip(ways, titles, strict=True) for p in overlays(mine, analysis, CLOSED_FORM, title)]
