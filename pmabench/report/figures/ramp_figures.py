"""Figures of slow ramps at constant pressure: loops, mean curves, gap, the rubber's force; draws by `ramp_plots`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.analysis.results import Trace
from pmabench.report.figures import ramp_plots
from pmabench.report.figures.pictures import (
    Picture,
    bound,
    column,
    has,
    head,
    how_many,
    label,
    numbers,
    panel,
    picture,
    reach,
    spread,
)
from pmabench.report.figures.plots import Array, Panel
from pmabench.report.words.wording import shown

PANELS, SINES = 6, 4
SPEEDS = 4
"""Most panels of the figures of loops and of sines, and loops of a panel."""


def loops(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """The loops of each pressure, its speeds in colours, and the mean curve through them."""
    able = [t for t in traces if has(t, "displacement", "force")]
    groups: dict[str, list[Trace]] = {}
    for trace in (t for t in able if t.figure == "isobaric"):
        groups.setdefault(trace.name.rpartition("-")[0].removeprefix("isobaric-"), []).append(trace)
    if not groups:
        return []
    means = {t.name.removeprefix("mean-curve-"): t for t in able if t.figure == "mean-curve"}
    keys = [name for name, _ in sorted(groups.items(), key=lambda item: item[1][0].marks.get("pressure", 0.0))]
    kept = spread([groups[key][0] for key in keys], PANELS)
    chosen = [key for key in keys if groups[key][0] in kept]
    names = {"x": "displacement", "y": "force"}
    speed = shown("speed")
    panels, told = [], []
    for key in chosen:
        members = spread(groups[key], SPEEDS)
        lines = [(f"{t.marks['speed'] / speed.scale:.3g} {speed.unit}", panel(t, names, "")) for t in members]
        mean = panel(means[key], names, "") if key in means else None
        panels.append((head(groups[key][0]), lines, mean))
        told += [(f"{head(t)}, {name}", t) for t, (name, _) in zip(members, lines, strict=True)]
    first = groups[chosen[0]][0]
    labels = {"x": label(first, "displacement"), "y": label(first, "force")}
    gaps = [t.marks["H"] for key in chosen for t in groups[key] if "H" in t.marks]
    caption = (
        "The last cycle at each speed, and in black the mean of its branches, taken to speed 0: what a model without "
        f"hysteresis is to give. Gap at mid stroke, expanding minus contracting: {reach(gaps)} N."
        f"{how_many(kept, [groups[key][0] for key in keys])}"
    )
    alt = (
        f"{labels['y']} over {labels['x']} as loops at {', '.join(title for title, *_ in panels)}, with the mean curve."
    )
    draw = bound(ramp_plots.loops, panels, labels)
    table = numbers(told, ("displacement", "force"))
    return [
        picture(draw, "Isobaric loops", caption, alt, table, wide=len(panels) > 1, simulated=simulated),
        *_means([means[key] for key in chosen if key in means], simulated),
    ]


def _means(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """Mean curves and gaps of all pressures, over contraction."""
    able = [t for t in traces if has(t, "displacement", "force", "gap")]
    if len(able) < 2:
        return []
    panels = [panel(t, {"x": "displacement", "y": "force", "gap": "gap"}, head(t)) for t in able]
    unit = shown("force").unit
    labels = {"x": label(able[0], "displacement"), "y": f"mean force [{unit}]", "gap": f"gap [{unit}]"}
    caption = (
        "Above: mean of the branches at each pressure. Below: the gap between them at the lowest speed; it closes at "
        "the ends of the stroke, where one branch turns into the other."
    )
    alt = f"Mean force and gap over contraction at {', '.join(p.title for p in panels)}."
    draw = bound(ramp_plots.means, panels, labels)
    table = numbers([(p.title, t) for p, t in zip(panels, able, strict=True)], ("displacement", "force", "gap"))
    title = "Mean curves and gap over contraction"
    return [picture(draw, title, caption, alt, table, wide=False, simulated=simulated)]


def rubber(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """The force without pressure beside the fitted rubber term."""
    found = []
    for trace in (t for t in traces if has(t, "displacement", "force", "model")):
        data = panel(trace, {"x": "displacement", "y": "force", "model": "model"}, "")
        off = float(np.sqrt(np.mean((data.columns["y"] - data.columns["model"]) ** 2)))
        labels = {"x": label(trace, "displacement"), "y": label(trace, "force")}
        caption = (
            "Marks: mean of the branches without pressure. Red: F_e = A ε (ε − B1)/(ε + B2) (paper 3, eq. 8), rms "
            f"difference {off:.2g} {shown('force').unit}."
        )
        alt = f"Force over contraction without pressure, measured and fitted, apart by {off:.2g} N rms."
        draw = bound(ramp_plots.marks_and_line, data, labels)
        table = numbers([("", trace)])
        found.append(
            picture(draw, "Force of the rubber at 0 kPa", caption, alt, table, wide=False, simulated=simulated)
        )
    return found


def sine_pressure(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """Force along sines, measured and modelled with set and measured pressure, above the error of the pressure."""
    able = [t for t in traces if has(t, "displacement", "force", "set", "measured", "error")]
    able = [t for t in able if "frequency" in t.marks]
    chosen = spread(sorted(able, key=lambda t: (t.marks.get("pressure", 0.0), t.marks["frequency"])), SINES)
    if not chosen:
        return []
    names = {"x": "displacement", "y": "force", "set": "set", "model": "measured", "error": "error"}
    panels = [panel(t, names, head(t)) for t in chosen]
    error = shown("pressure").label("P − set P")
    labels = {"x": label(chosen[0], "displacement"), "y": label(chosen[0], "force"), "error": error}
    worst = [float(np.nanmax(np.abs(p.columns["error"]))) for p in panels]
    caption = (
        "Above: the last cycle, and the static model of the slowest sines with the set pressure as input and with the "
        "measured one, damping and friction of the harmonics added. Below: error of the pressure, at most "
        f"{reach(worst)} {shown('pressure').unit}.{how_many(chosen, able)}"
    )
    alt = f"Force and pressure error over contraction along sines at {'; '.join(p.title for p in panels)}."
    draw = bound(ramp_plots.sine_pressure, panels, labels)
    table = numbers([(p.title, t) for p, t in zip(panels, chosen, strict=True)])
    title = "Force with set and with measured pressure"
    return [picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=simulated)]


def steps(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """Displacement, force and pressure over time around steps of displacement."""
    able = [t for t in traces if has(t, "t", "force", "displacement")]
    chosen = spread(able, SINES)
    if not chosen:
        return []
    panels = []
    for trace in chosen:
        names = {"t": "t", "x": "displacement", "y": "force"} | ({"P": "pressure"} if has(trace, "pressure") else {})
        base = _around(trace, names)
        scale = shown("force").scale
        marks = {name: value / scale for name, value in trace.marks.items() if name in ("before", "peak", "relaxed")}
        panels.append(Panel(head(trace), base, marks))
    labels = {
        "t": label(chosen[0], "t"),
        "x": label(chosen[0], "displacement"),
        "y": label(chosen[0], "force"),
        "P": shown("pressure").label("pressure"),
    }
    caption = (
        "Around the last step of a trial. Dashed: force before the step, at its peak and relaxed; the rest after the "
        f"step is longer than what is drawn.{how_many(chosen, able)}"
    )
    alt = (
        f"Contraction, force and pressure over time around steps of displacement: {'; '.join(p.title for p in panels)}."
    )
    draw = bound(ramp_plots.steps, panels, labels)
    table = numbers([(p.title, t) for p, t in zip(panels, chosen, strict=True)])
    title = "Steps of displacement"
    return [picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=simulated)]


def _around(trace: Trace, names: dict[str, str]) -> dict[str, Array]:
    """The columns from shortly before the step until its motion is well over: six times as long as it takes."""
    x = column(trace, "displacement")
    moving = np.flatnonzero(np.abs(x - x[-1]) > 0.05 * np.ptp(x))
    t = column(trace, "t")
    end = float(t[moving[-1]]) if len(moving) else float(t[-1])
    rows = (t >= -end) & (t <= max(6 * end, end + 0.1))
    return {new: column(trace, old)[rows] for new, old in names.items()}
