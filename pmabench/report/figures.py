"""Which figures an analysis has, with captions in plain words and alternative texts; draws through `plots`.

A trace of an unknown kind becomes a generic line plot, so a new reduction needs no entry here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from pmabench.analysis.results import Analysis, Trace
from pmabench.report import coefficient_figures, plots, time_plots
from pmabench.report.pictures import Picture, column, label, numbers, panel, picture, spread, unit_of, usable
from pmabench.report.plots import Panel
from pmabench.report.wording import clean, shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OVERLAYS, LOOPS, ROWS, SCATTERS, GENERIC = 6, 8, 4, 9, 6
"""Most panels of a figure (figures, for the generic ones); of more traces an even choice is shown."""
FRONT = 4


def front_pictures(analyses: Sequence[Analysis]) -> tuple[list[Picture], list[str]]:
    """The plots of the first page, and the names of the traces that are in them."""
    found = coefficient_figures.over_pressure(analyses)[: FRONT - 1]
    used: list[str] = []
    for wanted, draw in (
        ("overlay", _overlays),
        ("growth", _growth_alone),
        ("loop", _loops),
        ("isometric", _isometric),
    ):
        for analysis in analyses:
            traces = [t for t in analysis.traces if t.figure == wanted and usable(t)]
            if not traces or len(found) >= FRONT:
                continue
            hero = max(traces, key=lambda t: float(np.nanmax(np.abs(t.columns.get("displacement", np.zeros(1))))))
            pictures = draw([hero], analysis.simulated)
            found += pictures[:1]
            used += [hero.name] if pictures and wanted == "overlay" and len(traces) > 2 else []
    return found, used


def kind_pictures(analysis: Analysis, without: Sequence[str] = ()) -> list[Picture]:
    """All further figures of an analysis; `without` names traces that are shown elsewhere."""
    found = coefficient_figures.others(analysis)
    traces = [t for t in analysis.traces if usable(t) and t.name not in without]
    left = {t.figure for t in traces}
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
    return found + _generic([t for t in traces if t.figure in left], analysis.simulated)


def _has(trace: Trace, *names: str) -> bool:
    return all(name in trace.columns for name in names)


def _head(trace: Trace) -> str:
    """What a panel is headed: the title up to its colon."""
    return clean(trace.title.partition(":")[0], 60)


def _shown_of(shown_traces: Sequence[Trace], all_traces: Sequence[Trace]) -> str:
    return f" {len(shown_traces)} of {len(all_traces)} are shown." if len(shown_traces) < len(all_traces) else ""


def _overlays(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    able = [t for t in traces if _has(t, "t", "displacement", "model")]
    if not able:
        return []
    chosen = spread(able, OVERLAYS)
    names = {"t": "t", "measured": "displacement", "model": "model"}
    panels = [panel(t, names, _head(t)) for t in chosen]
    unit = unit_of(chosen[0], "displacement").unit
    labels = {"t": label(chosen[0], "t"), "measured": f"contraction [{unit}]", "residual": f"diff. [{unit}]"}
    misfits = [float(np.sqrt(np.nanmean((p.columns["measured"] - p.columns["model"]) ** 2))) for p in panels]
    worst = int(np.argmax(misfits))
    title = "Measured and modelled motion" + (f", {panels[0].title}" if len(chosen) == 1 else "")
    caption = (
        "Grey: measured; red: the fitted muscle, run freely with the measured pressure. Below: their difference, "
        f"rms {_range(misfits)} {unit}.{_shown_of(chosen, able)}"
    )
    alt = (
        f"Contraction over time, measured and modelled, in {len(panels)} panel{'s' if len(panels) > 1 else ''}: "
        f"{'; '.join(p.title for p in panels)}. Root mean square difference {_range(misfits)} {unit}"
        + (f", largest at {panels[worst].title}." if len(panels) > 1 else ".")
    )
    table = numbers([(_head(t), t) for t in chosen], ("t", "pressure", "displacement", "model"))
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


def _range(values: Sequence[float]) -> str:
    low, high = (f"{value:.2g}" if value < 99 else f"{value:.0f}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _loops(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    groups: dict[str, list[Trace]] = {}
    for trace in traces:
        first, second = ("pressure", "displacement") if trace.figure == "pressure-loop" else ("displacement", "force")
        if _has(trace, first, second):
            groups.setdefault(re.sub(r"-[^-]*$", "", trace.name), []).append(trace)
    found = []
    for members in list(groups.values())[:GENERIC]:
        chosen = spread(sorted(members, key=lambda t: t.marks.get("frequency", 0.0)), LOOPS)
        first, second = (
            ("pressure", "displacement") if chosen[0].figure == "pressure-loop" else ("displacement", "force")
        )
        names = {"x": first, "measured": second} | ({"model": "model"} if all(_has(t, "model") for t in chosen) else {})
        panels = [panel(t, names, _frequency(t)) for t in chosen]
        labels = {"x": label(chosen[0], first), "y": label(chosen[0], second)}
        where = clean(chosen[0].title.partition(", ")[2], 60)
        title = f"Loops of {second} over {first}".replace("displacement", "contraction") + (
            f", {where}" if where else ""
        )
        caption = "Grey: the last measured cycle at each frequency; red: the fitted muscle along the same motion."
        width = [t.marks["width"] for t in chosen if "width" in t.marks]
        if width:
            unit = shown("force")
            caption += f" Width at mid stroke {_range([w / unit.scale for w in width])} {unit.unit}."
        alt = (
            f"{labels['y']} over {labels['x']} as closed loops at {', '.join(p.title for p in panels)}"
            f"{f', {where}' if where else ''}. Loops grow wider as the frequency rises where damping acts."
        )
        table = numbers([(_frequency(t), t) for t in chosen])
        draw = _bound(plots.loops, panels, labels)
        found.append(picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=simulated))
    return found


def _bound(draw: Callable[..., Figure], *arguments: object) -> Callable[[], Figure]:
    return lambda: draw(*arguments)


def _frequency(trace: Trace) -> str:
    return f"{trace.marks['frequency']:.4g} Hz" if "frequency" in trace.marks else _head(trace)


def _bode(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    able = [t for t in traces if _has(t, "frequency", "stiffness", "loss", "speed", "phase")][:6]
    if not able:
        return []
    panels = []
    for trace in able:
        title = clean(trace.title.partition(", ")[2] or trace.title, 40)
        base = panel(trace, {"frequency": "frequency", "K": "stiffness", "phase": "phase"}, title)
        damping = shown("damping")
        speed, f = np.asarray(trace.columns["speed"]), np.asarray(trace.columns["frequency"])
        columns = dict(base.columns) | {"B": np.asarray(trace.columns["loss"]) / speed / damping.scale}
        if all(name in trace.marks for name in ("K", "B", "F_c")) and len(f) > 1:
            fine = np.geomspace(f.min(), f.max(), 60)
            fast = np.interp(fine, f, speed / f) * fine
            loss = trace.marks["B"] * fast + 4 * trace.marks["F_c"] / pi
            amplitude = fast / (2 * pi * fine)
            columns |= {
                "frequency fit": fine,
                "K fit": np.full(60, trace.marks["K"] / shown("stiffness").scale),
                "B fit": loss / fast / damping.scale,
                "phase fit": np.degrees(np.arctan2(loss, trace.marks["K"] * amplitude)),
            }
        panels.append(Panel(title, columns, dict(trace.marks)))
    labels = {
        "frequency": "frequency [Hz]",
        "K": shown("stiffness").label("K"),
        "B": shown("damping").label("loss per speed"),
        "phase": "phase [deg]",
    }
    caption = (
        "Left: stiffness K = −Re(F/x). Middle: loss per speed, −Im(F/x)/ω, which tends to B where viscous damping "
        "rules and rises at low frequency where Coulomb friction does. Right: phase of force before displacement. "
        "Lines: the fitted K, B and F_c."
    )
    alt = f"Stiffness, loss per speed and phase over frequency for {'; '.join(p.title for p in panels)}."
    names = ("frequency", "stiffness", "loss", "speed", "phase", "width")
    table = numbers([(p.title, t) for p, t in zip(panels, able, strict=True)], names)
    title = "Stiffness, damping and phase over frequency"
    draw = _bound(plots.against_frequency, panels, labels, ("K", "B", "phase"))
    return [picture(draw, title, caption, alt, table, wide=True, simulated=simulated)]


def _growth_panel(trace: Trace) -> Panel | None:
    if not _has(trace, "gain", "log_ratio", "used"):
        return None
    names = {"gain": "gain", "log_ratio": "log_ratio", "used": "used"} | ({"fit": "fit"} if _has(trace, "fit") else {})
    base = panel(trace, names, "")
    unit = unit_of(trace, "gain")
    if "K_u" not in base.marks:
        return base
    K_u = base.marks["K_u"] / unit.scale
    return Panel(f"K_u = {K_u:.4g}", base.columns, {"K_u": K_u})


def _growth_alone(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """The growth plot by itself, for the first page."""
    growth = _growth_panel(traces[0])
    if growth is None:
        return []
    labels = {"gain": label(traces[0], "gain"), "log_ratio": "ln(growth) per half period"}

    def draw() -> Figure:
        figure = plots.blank(plots.HALF, 2.55)
        time_plots.growth_axes(figure.add_subplot(plots.grid(figure, 1, 1, left=0.6)[0]), growth, labels)
        return figure

    table = numbers([("", traces[0])])
    title = f"Growth of the oscillation over gain, {_setpoint(traces[0])}"
    caption, alt = (
        _GROWTH,
        f"Logarithm of the ratio of successive swings over gain, rising through zero at {growth.title}.",
    )
    return [picture(draw, title, caption, alt, table, wide=False, simulated=simulated)]


_GROWTH = (
    "Each point is one level of gain: the mean logarithm of the ratio of successive swings. Below 0 the swings die "
    "out, above they grow. The line is fitted to the filled points; its zero is K_u."
)


def _setpoint(trace: Trace) -> str:
    return clean(trace.title.rpartition(", ")[2] or trace.title, 60)


def _oscillations(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    pairs: dict[str, list[Trace | None]] = {}
    for trace in traces:
        place = 0 if trace.figure == "oscillation" else 1
        pairs.setdefault(trace.name.partition("-")[2], [None, None])[place] = trace
    rows, told = [], []
    labels = {
        "t": "time [s]",
        "measured": "contraction [mm]",
        "gain": "gain",
        "log_ratio": "ln(growth) per half period",
    }
    for swing, growth in list(pairs.values())[:ROWS]:
        left = right = None
        if swing is not None and _has(swing, "t", "displacement"):
            scale = unit_of(swing, "displacement").scale
            base = panel(swing, {"t": "t", "measured": "displacement"}, f"Swings near K_u, {_setpoint(swing)}")
            marks = {k: v / scale for k, v in swing.marks.items() if k == "setpoint"}
            left = Panel(base.title, base.columns, marks)
            labels |= {"t": label(swing, "t"), "measured": label(swing, "displacement")}
            told.append((f"swings, {_setpoint(swing)}", swing))
        if growth is not None:
            right = _growth_panel(growth)
            labels["gain"] = label(growth, "gain")
            told.append((f"growth, {_setpoint(growth)}", growth))
        rows.append((left, right))
    if not any(left or right for left, right in rows):
        return []
    caption = "Left: contraction at the gain levels around K_u; dashed, the set-point. Right: growth. " + _GROWTH
    if len(pairs) > ROWS:
        caption += f" {ROWS} of {len(pairs)} operating points are shown."
    gains = [right.title for _, right in rows if right is not None and right.title]
    alt = (
        f"Oscillation over time, and growth per half period over gain, for {len(rows)} set-points. {'; '.join(gains)}."
    )
    draw = _bound(time_plots.oscillations, rows, labels)
    table = numbers(told)
    return [
        picture(draw, "Sustained oscillation and ultimate gain", caption, alt, table, wide=True, simulated=simulated)
    ]


def _isometric(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    able = [t for t in traces if _has(t, "pressure", "force")]
    if not able:
        return []
    chosen = spread(able, SCATTERS)
    optional = {"fit": "fit", "group": "test"}
    panels = []
    for trace in chosen:
        names = {"x": "pressure", "measured": "force"} | {k: v for k, v in optional.items() if _has(trace, v)}
        x = trace.marks.get("contraction")
        title = f"x = {x / shown('length').scale:.3g} {shown('length').unit}" if x is not None else _head(trace)
        panels.append(panel(trace, names, title))
    labels = {"x": label(chosen[0], "pressure"), "y": label(chosen[0], "force")}
    caption = (
        "Samples of every test (colours) at set contractions x, and the least-squares line F = m P + c where it was "
        f"fitted.{_shown_of(chosen, able)}"
    )
    alt = f"Force over pressure at fixed contraction, with a straight line, for {'; '.join(p.title for p in panels)}."
    table = numbers([(p.title, t) for p, t in zip(panels, chosen, strict=True)], ("pressure", "force", "fit", "test"))
    draw = _bound(plots.scatter_and_line, panels, labels)
    title = "Isometric force over pressure" + (f", {panels[0].title}" if len(chosen) == 1 else "")
    return [picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=simulated)]


def _lifts(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    able = [t for t in traces if _has(t, "t", "pressure", "displacement")]
    if not able:
        return []
    chosen = spread(able, OVERLAYS)
    names = {name: name for name in ("t", "pressure", "displacement")}
    panels = []
    for trace in chosen:
        base = panel(trace, names, _head(trace))
        scale = unit_of(trace, "pressure").scale
        panels.append(Panel(base.title, base.columns, {k: v / scale for k, v in trace.marks.items() if k != "load"}))
    labels = {name: label(chosen[0], name) for name in names}
    caption = (
        "Above: pressure, rising until the load lifts off its support and falling until it sets down; dashed, the "
        f"pressures found. Below: contraction.{_shown_of(chosen, able)}"
    )
    alt = f"Pressure and contraction over time while loads lift off and set down: {'; '.join(p.title for p in panels)}."
    table = numbers([(_head(t), t) for t in chosen], ("t", "pressure", "displacement"))
    draw = _bound(time_plots.lifts, panels, labels)
    return [picture(draw, "Lift-off and set-down", caption, alt, table, wide=len(chosen) > 1, simulated=simulated)]


def _static(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Lift-off and set-down of every trial, with the lines of the analysis through them."""
    found = []
    for trace in (t for t in traces if _has(t, "load", "lift", "set_down")):
        points = panel(trace, {"load": "load", "lift": "lift", "set_down": "set_down"}, "")
        curves = []
        for c in (c for c in analysis.curves if c.against == "pressure" and all(e.value is not None for e in c.terms)):
            x = np.linspace(*c.domain, 2)
            y = np.polyval([e.value or 0.0 for e in reversed(c.terms)], x)
            curves.append((clean(c.method, 40), x / shown("pressure").scale, y / shown("force").scale))
        labels = {"x": shown("pressure").label("P"), "y": shown("force").label("F_L")}
        count = len(np.unique(trace.columns["load"]))
        caption = "Each mark is one trial: friction holds the load down at lift-off and up at set-down."
        alt = f"{count} loads over the pressures at which they lift off and set down, with straight lines through them."
        draw = _bound(plots.load_points, points, curves, labels)
        title = clean(trace.title, 90)
        table = numbers([("", trace)])
        found.append(picture(draw, title, caption, alt, table, wide=False, simulated=analysis.simulated))
    return found


def _generic(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    found = []
    for trace in spread(list(traces), GENERIC):
        names = [name for name in trace.columns if np.isfinite(trace.columns[name]).any()]
        if len(names) < 2:
            continue
        x, rest = names[0], names[1:9]
        data = panel(trace, {name: name for name in names}, clean(trace.title, 90)).columns
        columns = [(clean(name, 40), _axis(trace, name), data[name]) for name in rest]
        draw = _bound(time_plots.lines, "", data[x], label(trace, x), columns)
        title = clean(trace.title, 120) or clean(trace.name, 80)
        ends = column(trace, x)[np.isfinite(column(trace, x))]
        told = ", ".join(clean(name, 40) for name in rest)
        alt = f"{told} over {label(trace, x)}, from {ends.min():.4g} to {ends.max():.4g}."
        found.append(picture(draw, title, "", alt, numbers([("", trace)]), wide=True, simulated=simulated))
    return found


def _axis(trace: Trace, name: str) -> str:
    """Columns of one quantity share an axis."""
    quantity = trace.quantities.get(name, "")
    return shown(quantity).label(clean(quantity or name, 30))


DRAWN: tuple[tuple[tuple[str, ...], Callable[[Sequence[Trace], bool], list[Picture]]], ...] = (
    (("lift",), _lifts),
    (("overlay",), _overlays),
    (("loop", "pressure-loop"), _loops),
    (("bode",), _bode),
    (("oscillation", "growth"), _oscillations),
    (("isometric",), _isometric),
)
"""Kinds of traces -> how they are drawn; all others are drawn as lines."""
