"""Which figures an analysis has, with captions in plain words and alternative texts; draws through `plots`.

A trace of an unknown kind becomes a generic line plot, so a new reduction needs no entry here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pmabench.analysis.results import Analysis, Trace
from pmabench.report.figures import (
    characteristic_figures,
    coefficient_figures,
    loop_figures,
    motion_figures,
    plots,
    ramp_figures,
    time_plots,
)
from pmabench.report.figures.arm_figures import angles
from pmabench.report.figures.energy_figures import energy
from pmabench.report.figures.free_figures import lengths
from pmabench.report.figures.pictures import (
    Picture,
    bound,
    column,
    drawable,
    has,
    head,
    how_many,
    label,
    numbers,
    panel,
    picture,
    reach,
    spread,
    unit_of,
)
from pmabench.report.figures.plots import Array, Panel
from pmabench.report.figures.position_figures import positions, validations
from pmabench.report.figures.repeat_figures import repeats
from pmabench.report.figures.section_figures import sections
from pmabench.report.figures.volume_figures import volumes
from pmabench.report.words.wording import COLUMNS, clean, shown

OVERLAYS, SCATTERS, GENERIC = 6, 9, 6
"""Most panels of a figure (figures, for the generic ones); of more traces an even choice is shown."""
FRONT, FEW = 4, 2
"""Plots of the first page; and those of a report whose tests have none of its kinds."""


def front_pictures(analyses: Sequence[Analysis]) -> tuple[list[Picture], list[str]]:
    """The plots of the first page, and the names of the traces that are in them."""
    analyses = [drawable(analysis) for analysis in analyses]
    found = coefficient_figures.over_pressure(analyses)[: FRONT - 1]
    used: list[str] = []
    for analysis in analyses:
        if len(found) < FRONT and any(t.figure in loop_figures.TOGETHER for t in analysis.traces):
            found += loop_figures.together(analysis.traces, analysis.simulated)
            break
    for wanted, draw in (
        ("overlay", _overlays),
        ("growth", loop_figures.growth_alone),
        ("position", positions),
        ("validation", validations),
        ("isometric", _isometric),
    ):
        for analysis in analyses:
            traces = [t for t in analysis.traces if t.figure == wanted]
            if not traces or len(found) >= FRONT:
                continue
            hero = max(traces, key=_stroke)
            pictures = draw([hero], analysis.simulated)
            found += pictures[:1]
            used += [hero.name] if pictures and wanted == "overlay" and len(traces) > 2 else []
    for analysis in analyses if not found else ():
        found += kind_pictures(analysis)[: FEW - len(found)]
    return found, used


def _stroke(trace: Trace) -> float:
    """The largest displacement of a trace, to choose one for the first page."""
    values = np.abs(column(trace, "displacement")) if "displacement" in trace.columns else np.zeros(1)
    return float(np.max(values, where=np.isfinite(values), initial=0.0))


def kind_pictures(analysis: Analysis, without: Sequence[str] = ()) -> list[Picture]:
    """All further figures of an analysis; `without` names traces that are shown elsewhere."""
    analysis = drawable(analysis)
    found = coefficient_figures.others(analysis)
    traces = [t for t in analysis.traces if t.name not in without]
    left = {t.figure for t in traces} - {characteristic_figures.FIGURE}  # drawn over all tests together
    points = [t for t in traces if t.figure == "static"]
    left -= {"static"} if points else set()
    found += _static(points, analysis)
    for kinds, draw in DRAWN:
        mine = [t for t in traces if t.figure in kinds]
        left -= set(kinds)
        if mine:
            pictures = draw(mine, analysis.simulated)
            found += pictures
            if not pictures:
                found += _generic(mine, analysis.simulated)
    return found + energy(analysis) + _generic([t for t in traces if t.figure in left], analysis.simulated)


FREE_RUN = "the fitted muscle, run freely with the measured pressure"
CLOSED_FORM = "closed form of single steps with the polynomials of the first method, from the mean dead time on"


def _motions(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """Free runs of the fitted muscle, what they leave, and the same motion over the pressure."""
    found = _overlays(traces, simulated)
    return found + motion_figures.residuals(traces, simulated) + motion_figures.over_pressure(traces, simulated)


def _step_overlays(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """Steps up and steps down apart: each has its own damping."""
    ways = [[t for t in traces if t.name.startswith(f"step-{way}-")] for way in ("to", "from")]
    titles = ("Contraction, measured and closed form", "Relaxation, measured and closed form")
    return [p for mine, title in zip(ways, titles, strict=True) for p in _overlays(mine, simulated, CLOSED_FORM, title)]


def _overlays(
    traces: Sequence[Trace],
    simulated: bool,
    model: str = FREE_RUN,
    title: str = "Measured and modelled motion",
) -> list[Picture]:
    able = [t for t in traces if has(t, "t", "displacement", "model")]
    if not able:
        return []
    chosen = spread(able, OVERLAYS)
    names = {"t": "t", "measured": "displacement", "model": "model"}
    panels = [panel(t, names, head(t)) for t in chosen]
    unit = unit_of(chosen[0], "displacement").unit
    labels = {"t": label(chosen[0], "t"), "measured": f"contraction [{unit}]", "residual": f"diff. [{unit}]"}
    misfits = [_rms(p.columns["measured"] - p.columns["model"]) for p in panels]
    worst = int(np.argmax(misfits))
    title += f", {panels[0].title}" if len(chosen) == 1 else ""
    caption = (
        f"Grey: measured; red: {model}. Below: their difference, rms {reach(misfits)} {unit}.{how_many(chosen, able)}"
    )
    if any(not np.isfinite(p.columns["model"]).all() for p in panels):
        caption += " The model ends where the muscle moves at a pressure at which a coefficient is open."
    alt = (
        f"Contraction over time, measured and modelled, in {len(panels)} panel{'s' if len(panels) > 1 else ''}: "
        f"{'; '.join(p.title for p in panels)}. Root mean square difference {reach(misfits)} {unit}"
        + (f", largest at {panels[worst].title}." if len(panels) > 1 else ".")
    )
    table = numbers([(head(t), t) for t in chosen], ("t", "pressure", "displacement", "model"))
    return [
        picture(
            lambda: time_plots.overlay(panels, labels),
            title,
            caption,
            alt,
            table,
            wide=len(chosen) > 1,
            simulated=simulated,
        )
    ]


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0


def _isometric(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    able = [t for t in traces if has(t, "pressure", "force")]
    if not able:
        return []
    chosen = spread(able, SCATTERS)
    by_branch = all(has(t, "branch") for t in able)
    optional = {"fit": "fit", "group": "branch" if by_branch else "test"}
    panels = []
    for trace in chosen:
        names = {"x": "pressure", "measured": "force"} | {k: v for k, v in optional.items() if has(trace, v)}
        x = trace.marks.get("contraction")
        title = f"x = {x / shown('length').scale:.3g} {shown('length').unit}" if x is not None else head(trace)
        panels.append(panel(trace, names, title))
    labels = {"x": label(chosen[0], "pressure"), "y": label(chosen[0], "force")}
    caption = (
        f"Samples of every test ({'blue: filling, red: emptying' if by_branch else 'colours'}) at set contractions, "
        f"and the least-squares line through them where it was fitted.{how_many(chosen, able)}"
    )
    alt = f"Force over pressure at fixed contraction, with a straight line, for {'; '.join(p.title for p in panels)}."
    table = numbers([(p.title, t) for p, t in zip(panels, chosen, strict=True)], ("pressure", "force", "fit", "test"))
    draw = bound(plots.scatter_and_line, panels, labels)
    title = "Isometric force over pressure" + (f", {panels[0].title}" if len(chosen) == 1 else "")
    return [picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=simulated)]


def _lifts(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    able = [t for t in traces if has(t, "t", "pressure", "displacement")]
    if not able:
        return []
    chosen = spread(able, OVERLAYS)
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
    return [picture(draw, "Lift-off and set-down", caption, alt, table, wide=len(chosen) > 1, simulated=simulated)]


def _static(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
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


def _generic(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    found = []
    for trace in spread(list(traces), GENERIC):
        names = [name for name in trace.columns if has(trace, name)]
        if len(names) < 2:
            continue
        x, rest = names[0], names[1:9]
        data = panel(trace, {name: name for name in names}, clean(trace.title, 90)).columns
        columns = [(_word(name), _axis(trace, name, rest), data[name]) for name in rest]
        draw = bound(time_plots.lines, "", data[x], label(trace, x), columns)
        title = clean(trace.title, 120) or clean(trace.name, 80)
        ends = column(trace, x)[np.isfinite(column(trace, x))]
        told = ", ".join(_word(name) for name in rest)
        alt = f"{told} over {label(trace, x)}, from {ends.min():.4g} to {ends.max():.4g}."
        found.append(picture(draw, title, "", alt, numbers([("", trace)]), wide=True, simulated=simulated))
    return found


def _word(name: str) -> str:
    return COLUMNS.get(name) or clean(name, 40)


def _axis(trace: Trace, name: str, names: Sequence[str]) -> str:
    """Columns of one quantity share an axis, which has the name of the first."""
    quantity = trace.quantities.get(name, "")
    first = next(other for other in names if trace.quantities.get(other, "") == quantity)
    return shown(quantity).label(_word(first) if quantity else _word(name))


DRAWN: tuple[tuple[tuple[str, ...], Callable[[Sequence[Trace], bool], list[Picture]]], ...] = (
    (("lift",), _lifts),
    (("overlay",), _motions),
    (("step-overlay",), _step_overlays),
    (("loop", "pressure-loop"), loop_figures.loops),
    (("bode",), loop_figures.bode),
    (("oscillation", "growth"), loop_figures.oscillations),
    (("position",), positions),
    (("validation",), validations),
    (("isobaric", "mean-curve"), ramp_figures.loops),
    (("rubber",), ramp_figures.rubber),
    (("sine-pressure",), ramp_figures.sine_pressure),
    (("displacement-step",), ramp_figures.steps),
    (("isometric",), _isometric),
    (("section",), sections),
    (("volume",), volumes),
    (("free-contraction",), lengths),
    (("arm-angle",), angles),
    (("repeats",), repeats),
)
"""Kinds of traces -> how they are drawn; all others are drawn as lines."""
