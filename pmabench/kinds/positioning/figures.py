"""Figures of held positions: the approach with its reference, and the error over the whole hold.

`measure`: the values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.positioning.reduction import Tracked, measured
from pmabench.plotting import pictures, plots
from pmabench.plotting.motion import overlays
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DASHED = (0, (4, 3))
COLUMNS = 3
MOST = 12
"""Most set-points or steps in a figure."""
APPROACH = 2.0
"""Time of the approach in the upper panel [s]."""


def positions(traces: Sequence[Trace], analysis: Analysis) -> list[pictures.Picture]:
    """Reference, measured and simulated position of every set-point."""
    able = [t for t in traces if pictures.has(t, "t", "displacement", "setpoint") and "setpoint" in t.marks]
    if not able:
        return []
    chosen = pictures.spread(able, MOST)
    modelled = all(pictures.has(t, "model") for t in chosen)
    names = {"t": "t", "setpoint": "setpoint", "measured": "displacement"} | ({"model": "model"} if modelled else {})
    panels = []
    for trace in chosen:
        base = pictures.panel(trace, names, pictures.head(trace))
        aim = trace.marks["setpoint"] / pictures.unit_of(trace, "displacement").scale
        panels.append(replace(base, marks={**base.marks, "setpoint": aim}))
    unit = pictures.unit_of(chosen[0], "displacement").unit
    labels = {
        "t": pictures.label(chosen[0], "t"),
        "measured": f"contraction [{unit}]",
        "error": f"x − set-point [{unit}]",
    }
    caption = (
        "Above: the approach from rest; dashed: reference, grey: measured"
        + ("; brown: the same loop simulated around the model" if modelled else "")
        + ". Below: distance from the set-point over the whole hold, on one scale; blue: measured"
        + ("; brown: simulated" if modelled else "")
        + ". The dotted line begins the window of steady-state error and limit cycle."
        + pictures.how_many(chosen, able)
    )
    alt = (
        f"Position over time in closed loop, reference, measured{' and simulated' if modelled else ''}, and the "
        f"distance from the set-point, at {'; '.join(p.title for p in panels)}."
    )
    table = pictures.numbers(
        [(pictures.head(t), t) for t in chosen], ("t", "setpoint", "displacement", "model", "pressure_command")
    )
    draw = pictures.bound(held, panels, APPROACH, labels)
    return [
        pictures.picture(draw, "Positions in closed loop", caption, alt, table, wide=True, simulated=analysis.simulated)
    ]


def paths(traces: Sequence[Trace], analysis: Analysis) -> list[pictures.Picture]:
    """Wanted and measured place along each path."""
    mine = [trace for trace in traces if trace.figure == "path"]
    return overlays(mine, analysis, "the place that was wanted", "Along a path", most=MOST, columns=())


def held(panels: Sequence[plots.Panel], approach: float, labels: dict[str, str]) -> Figure:
    """Above: reference, measured and simulated position up to `approach` [s]; below: measured and simulated distance
    from the set-point over the whole hold, with a common scale for all panels.

    Columns t, setpoint, measured, and model if simulated; marks `setpoint`, `window`.
    """
    columns = min(COLUMNS, len(panels))
    rows = ceil(len(panels) / columns)
    figure = plots.blank(plots.FULL, 0.5 + 2.75 * rows)
    outer = plots.grid(figure, rows, columns, top=0.5, left=0.58, across=0.5, down=0.6)
    reach = max(_reach(one) for one in panels)
    for i, one in enumerate(panels):
        inner = outer[i].subgridspec(2, 1, height_ratios=(1.5, 1), hspace=0.42)
        upper, lower = figure.add_subplot(inner[0]), figure.add_subplot(inner[1])
        _approach(upper, one, approach)
        _distance(lower, one, reach)
        upper.set_title(one.title)
        if i % columns == 0:
            upper.set_ylabel(labels["measured"])
            lower.set_ylabel(labels["error"])
            figure.align_ylabels([upper, lower])
        lower.set_xlabel(labels["t"])
    plots.legend_above(figure, 3)
    return figure


def _approach(axes: Axes, panel: plots.Panel, until: float) -> None:
    early = panel.columns["t"] <= until
    t = panel.columns["t"][early]
    axes.plot(t, panel.columns["measured"][early], color=plots.FAINT, linewidth=2.6, label="measured")
    if "model" in panel.columns:
        axes.plot(t, panel.columns["model"][early], color=plots.BROWN, linewidth=1.0, label="simulated")
    axes.step(
        t,
        panel.columns["setpoint"][early],
        where="post",
        color=plots.INK,
        linewidth=0.8,
        linestyle=DASHED,
        label="reference",
    )
    axes.set_xlim(min(0.0, float(t[0])) if len(t) else 0.0, until)
    plots.few_ticks(axes, y=5)


def _distance(axes: Axes, panel: plots.Panel, reach: float) -> None:
    """Distance from the set-point; the approach leaves the frame."""
    after = panel.columns["t"] >= 0
    t, aim = panel.columns["t"][after], panel.marks["setpoint"]
    axes.axhline(0, color=plots.INK, linewidth=0.8, linestyle=DASHED)
    axes.plot(t, panel.columns["measured"][after] - aim, color=plots.BLUE, linewidth=0.8)
    if "model" in panel.columns:
        axes.plot(t, panel.columns["model"][after] - aim, color=plots.BROWN, linewidth=0.7, alpha=0.8)
    if panel.marks.get("window", 0.0) > 0:
        axes.axvline(panel.marks["window"], color=plots.QUIET, linewidth=0.7, linestyle=(0, (1, 2)))
    axes.set_ylim(-reach, reach)
    axes.set_xlim(0, float(t[-1]) if len(t) else 1.0)
    plots.few_ticks(axes, y=4)


def _reach(panel: plots.Panel) -> float:
    """Largest error inside the window, plus a margin, in display units."""
    late = panel.columns["t"] >= panel.marks.get("window", 0.0)
    away: plots.Array = np.abs(panel.columns["measured"][late] - panel.marks["setpoint"])
    known = away[np.isfinite(away)]
    least = 1e-3 * abs(panel.marks["setpoint"])
    return 1.5 * max(float(known.max()) if len(known) else 0.0, least)


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Steady-state error and overshoot of a held position, and its limit cycle where it hunts; errors along a path."""
    try:
        one = measured(run, trial)
    except NotUsable as reason:
        on_path = (trial.found.get("position") or {}).get("path")
        wanted = {"e_rms": "length"} if on_path else {"e_ss": "ratio", "OS": "ratio"}
        return [Measured(symbol, quantity, None) for symbol, quantity in wanted.items()], [str(reason)]
    if isinstance(one, Tracked):
        values = one.values()
        return [Measured("e_rms", "length", values["e_rms"]), Measured("OS", "ratio", values["OS"])], []
    response = one.response
    found = [Measured(symbol, "ratio", one.values[symbol]) for symbol in ("e_ss", "OS")]
    doubts = [] if response.settling is not None else ["it does not settle in the band"]
    cycle = response.cycle
    if cycle is not None:
        found += [Measured("x_pp", "length", cycle.size), Measured("T_c", "time", cycle.period)]
        what = "stick-slip limit cycle" if cycle.sticks else "it oscillates"
        doubts.append(f"{what}: {show(cycle.size, 'length', 3)} peak to peak, {cycle.period:.3g} s")
    return found, doubts
