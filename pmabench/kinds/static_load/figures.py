"""Figures of static load: the searches over time, and the pressures found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.analysis.results import Analysis, Trace
from pmabench.plotting import plots, time_plots
from pmabench.plotting.pictures import (
    Picture,
    bound,
    has,
    head,
    how_many,
    label,
    numbers,
    panel,
    picture,
    spread,
    unit_of,
)
from pmabench.plotting.plots import Panel
from pmabench.plotting.wording import clean, shown

PANELS = 6
"""Most panels."""


def lifts(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Pressure and contraction over time, with the pressures found."""
    able = [t for t in traces if has(t, "t", "pressure", "displacement")]
    if not able:
        return []
    chosen = spread(able, PANELS)
    names = {name: name for name in ("t", "pressure", "displacement")}
    panels = []
    for trace in chosen:
        base = panel(trace, names, head(trace))
        scale = unit_of(trace, "pressure").scale
        panels.append(Panel(base.title, base.columns, {k: v / scale for k, v in trace.marks.items() if k != "load"}))
    labels = {name: label(chosen[0], name) for name in names}
    caption = (
        "Above: pressure, rising until the load lifts off its support and falling until it sets down; dashed, the "
        f"pressures found. Below: contraction.{how_many(chosen, able)}"
    )
    alt = f"Pressure and contraction over time while loads lift off and set down: {'; '.join(p.title for p in panels)}."
    table = numbers([(head(t), t) for t in chosen], ("t", "pressure", "displacement"))
    draw = bound(time_plots.lifts, panels, labels)
    return [
        picture(draw, "Lift-off and set-down", caption, alt, table, wide=len(chosen) > 1, simulated=analysis.simulated)
    ]


def points(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Lift-off and set-down of every trial, with the lines of the analysis through them."""
    found = []
    for trace in (t for t in traces if has(t, "load", "lift", "set_down")):
        points = panel(trace, {"load": "load", "lift": "lift", "set_down": "set_down"}, "")
        curves = []
        for c in (c for c in analysis.curves if c.against == "pressure" and all(e.value is not None for e in c.terms)):
            x = np.linspace(*c.domain, 2)
            y = c.values(x)
            curves.append((clean(c.method, 40), x / shown("pressure").scale, y / shown("force").scale))
        labels = {"x": shown("pressure").label("P"), "y": shown("force").label("F_L")}
        count = len(np.unique(trace.columns["load"]))
        caption = "Each mark is one trial: friction holds the load down at lift-off and up at set-down."
        alt = f"{count} loads over the pressures at which they lift off and set down, with straight lines through them."
        draw = bound(plots.load_points, points, curves, labels)
        title = clean(trace.title, 90)
        table = numbers([("", trace)])
        found.append(picture(draw, title, caption, alt, table, wide=False, simulated=analysis.simulated))
    return found
