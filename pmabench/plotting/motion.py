"""Figures of driven and free motion: overlays, loops, values over frequency, growth over gain; drawn by `plots`.

Also of isometric tests: force over pressure at fixed contractions, with fitted lines.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import pi

import numpy as np

from pmabench.plotting import plots, time_plots
from pmabench.plotting.chart import COLUMN, GAP, PAGE, Chart, Series, with_common_sides
from pmabench.plotting.pictures import (
    Picture,
    bound,
    has,
    head,
    how_many,
    label,
    numbers,
    of_charts,
    panel,
    picture,
    reach,
    spread,
    unit_of,
)
from pmabench.plotting.plots import BROWN, FAINT, QUIET, Array, Panel
from pmabench.plotting.wording import clean, shown
from pmabench.store.analyses.results import Analysis, Trace

LOOPS, ROWS, MOST = 8, 4, 6
"""Most loops of a figure, rows of a figure of oscillations, and figures of loops."""
NAMES = ("t", "pressure", "displacement", "model")
UPPER, LOWER = 104.0, 66.0
"""Heights of a panel, and of the difference below it [pt]."""
SHORT = 20
"""Letters of titles with which three panels fit side by side, and not two."""
OVERLAYS = 6
"""Most panels of measured and modelled motion."""
FREE_RUN = "the fitted muscle, run freely with the measured pressure"


def overlays(
    traces: Sequence[Trace], analysis: Analysis, model: str = FREE_RUN, title: str = "Measured and modelled motion",
    *, most: int = OVERLAYS, also: str = "", columns: Sequence[str] = NAMES,
) -> list[Picture]:  # fmt: skip
    """Contraction over time, measured and of a `model` in words, and their difference below.

    At `most` so many panels; `also` ends the caption, `columns` are those in the table, all if none are named.
    """
    able = [t for t in traces if has(t, "t", "displacement", "model")]
    if not able:
        return []
    chosen = spread(able, most)
    names = {"t": "t", "measured": "displacement", "model": "model"}
    panels = [panel(t, names, head(t)) for t in chosen]
    unit = unit_of(chosen[0], "displacement").unit
    misfits = [_rms(p.columns["measured"] - p.columns["model"]) for p in panels]
    worst = int(np.argmax(misfits))
    title += f", {panels[0].title}" if len(chosen) == 1 else ""
    caption = f"Grey: measured; brown: {model}. Below: their difference, rms {reach(misfits)} {unit}.{also}"
    caption += how_many(chosen, able)
    if any(not np.isfinite(p.columns["model"]).all() for p in panels):
        caption += " The model ends where the muscle moves at a pressure at which a coefficient is open."
    alt = (
        f"Contraction over time, measured, and {model}, in {len(panels)} panel{'s' if len(panels) > 1 else ''}: "
        f"{'; '.join(p.title for p in panels)}. Root mean square difference {reach(misfits)} {unit}"
        + (f", largest at {panels[worst].title}." if len(panels) > 1 else ".")
    )
    table = numbers([(head(t), t) for t in chosen], columns)
    rows = _overlaid(panels, label(chosen[0], "t"), unit, simulated=analysis.simulated)
    return [of_charts(rows, title, caption, alt, table, simulated=analysis.simulated, still=True)]


def _overlaid(panels: Sequence[Panel], t_label: str, unit: str, *, simulated: bool) -> list[list[Chart]]:
    """Measured and model over time with their difference below, in small multiples; columns t, measured, model."""
    columns = 1 if len(panels) == 1 else 3 if max(len(one.title) for one in panels) < SHORT else 2
    width = COLUMN if columns == 1 else (PAGE - GAP * (columns - 1)) / columns
    pairs = []
    for n, one in enumerate(panels, 1):
        t, y, model = (one.columns[name] for name in ("t", "measured", "model"))
        lines = (Series("", t, y, FAINT, width=3.0), Series("", t, model, BROWN))
        apart = (Series("", t, y - model, QUIET, width=0.9),)
        name = "contraction" if columns == 1 else f"{one.title}: x"
        stamp = "SIMULATED" if simulated and n == min(columns, len(panels)) else ""
        upper = Chart(t_label, f"{name} [{unit}]", lines, width, UPPER, "", stamp=stamp, x_named=False)
        pairs.append(
            with_common_sides((upper, Chart(t_label, f"difference [{unit}]", apart, width, LOWER, "", y_ticks=3)))
        )
    rows = [pairs[i : i + columns] for i in range(0, len(pairs), columns)]
    return [[pair[n] for pair in row] for row in rows for n in (0, 1)]


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0


def _title(first: str, second: str, where: str) -> str:
    words = f"Loops of {second} over {first}".replace("displacement", "contraction")
    return f"{words}, {where}" if where else words


def loops(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Loops at each frequency, one figure for each operating point."""
    groups: dict[str, list[Trace]] = {}
    for trace in traces:
        if has(trace, *_axes(trace)):
            groups.setdefault(re.sub(r"-[^-]*$", "", trace.name), []).append(trace)
    found = []
    for members in list(groups.values())[:MOST]:
        chosen = spread(sorted(members, key=lambda t: t.marks.get("frequency", 0.0)), LOOPS)
        first, second = _axes(chosen[0])
        names = {"x": first, "measured": second} | ({"model": "model"} if all(has(t, "model") for t in chosen) else {})
        panels = [panel(t, names, _frequency(t)) for t in chosen]
        labels = {"x": label(chosen[0], first), "y": label(chosen[0], second)}
        where = clean(chosen[0].title.partition(", ")[2], 60)
        title = _title(first, second, where)
        each = " at each frequency" if any("frequency" in t.marks for t in chosen) else ""
        lacking = ". No model is drawn: stiffness, damping and friction are not all known here."
        model = "; brown: the fitted muscle along the same motion." if "model" in names else lacking
        caption = f"Grey: the last measured cycle{each}{model}"
        if width := [t.marks["width"] for t in chosen if "width" in t.marks]:
            unit = shown("force")
            caption += f" Width at mid stroke {reach([w / unit.scale for w in width])} {unit.unit}."
        alt = f"{labels['y']} over {labels['x']} as closed loops at {', '.join([p.title for p in panels])}"
        alt += f", {where}." if where else "."
        alt += " Loops grow wider as the frequency rises where damping acts." if len(chosen) > 1 else ""
        table = numbers([(_frequency(t), t) for t in chosen])
        draw = bound(plots.loops, panels, labels)
        found.append(picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=analysis.simulated))
    return found


def _axes(trace: Trace) -> tuple[str, str]:
    return ("pressure", "displacement") if trace.figure == "pressure-loop" else ("displacement", "force")


def _frequency(trace: Trace) -> str:
    return f"{trace.marks['frequency']:.4g} Hz" if "frequency" in trace.marks else head(trace)


def bode(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Stiffness, loss per speed and phase over frequency, for all operating points."""
    able = [t for t in traces if has(t, "frequency", "stiffness", "loss", "speed", "phase")]
    able = [t for t in able if np.all(t.columns["frequency"] > 0) and np.all(t.columns["speed"] > 0)][:6]
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
    labels = {"frequency": "frequency [Hz]", "phase": "phase [deg]"}
    labels |= {"K": shown("stiffness").label("K"), "B": shown("damping").label("loss per speed")}
    caption = (
        "Left: stiffness K = −Re(F/x). Middle: loss per speed, −Im(F/x)/ω, which tends to B where viscous damping "
        "rules and rises at low frequency where Coulomb friction does. Right: phase of force before displacement. "
    ) + ("Lines: the fitted K, B and F_c." if any("B fit" in p.columns for p in panels) else "No line is known.")
    alt = f"Stiffness, loss per speed and phase over frequency for {'; '.join(p.title for p in panels)}."
    names = ("frequency", "stiffness", "loss", "speed", "phase", "width")
    table = numbers([(p.title, t) for p, t in zip(panels, able, strict=True)], names)
    title = "Stiffness, damping and phase over frequency"
    draw = bound(plots.against_frequency, panels, labels, ("K", "B", "phase"))
    return [picture(draw, title, caption, alt, table, wide=True, simulated=analysis.simulated)]


def _growth_panel(trace: Trace) -> Panel | None:
    if not has(trace, "gain", "log_ratio", "used"):
        return None
    names = {"gain": "gain", "log_ratio": "log_ratio", "used": "used"} | ({"fit": "fit"} if has(trace, "fit") else {})
    base = panel(trace, names, "")
    unit = unit_of(trace, "gain")
    if "K_u" not in base.marks:
        return base
    K_u = base.marks["K_u"] / unit.scale
    return Panel(f"K_u = {K_u:.4g}", base.columns, {"K_u": K_u})


_GROWTH = (
    "Each point is one level of gain: the mean logarithm of the ratio of successive swings. Below 0 the swings die "
    "out, above they grow. The line is fitted to the filled points; its zero is K_u."
)


def _setpoint(trace: Trace) -> str:
    return clean(trace.title.rpartition(", ")[2] or trace.title, 60)


def oscillation(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """The first set-point alone, for the first page."""
    setpoint = traces[0].name.partition("-")[2]
    return oscillations([t for t in analysis.traces if t.name.partition("-")[2] == setpoint], analysis)


def oscillations(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Oscillations near the ultimate gain and their growth over gain, one row for each set-point."""
    pairs: dict[str, list[Trace | None]] = {}
    for trace in traces:
        place = 0 if trace.figure == "oscillation" else 1
        pairs.setdefault(trace.name.partition("-")[2], [None, None])[place] = trace
    rows, named = [], []
    labels = {"t": "time [s]", "measured": "contraction [mm]", "gain": "gain"}
    labels["log_ratio"] = "ln(growth) per half period"
    for swing, growth in list(pairs.values())[:ROWS]:
        left = right = None
        if swing is not None and has(swing, "t", "displacement"):
            scale = unit_of(swing, "displacement").scale
            base = panel(swing, {"t": "t", "measured": "displacement"}, f"Swings near K_u, {_setpoint(swing)}")
            marks = {k: v / scale for k, v in swing.marks.items() if k == "setpoint"}
            left = Panel(base.title, base.columns, marks)
            labels |= {"t": label(swing, "t"), "measured": label(swing, "displacement")}
            named.append((f"swings, {_setpoint(swing)}", swing))
        if growth is not None:
            right = _growth_panel(growth)
            labels["gain"] = label(growth, "gain")
            named.append((f"growth, {_setpoint(growth)}", growth))
        rows.append((left, right))
    if not any(left or right for left, right in rows):
        return []
    caption = "Left: contraction at the gain levels around K_u; dashed, the set-point. Right: growth. " + _GROWTH
    if len(pairs) > ROWS:
        caption += f" {ROWS} of {len(pairs)} operating points are shown."
    gains = [right.title for _, right in rows if right is not None and right.title]
    alt = f"Oscillation over time, and growth per half period over gain, for {len(rows)} set-points."
    alt += f" {'; '.join(gains)}."
    draw = bound(time_plots.oscillations, rows, labels)
    title = "Sustained oscillation and ultimate gain" + (f", {_setpoint(named[0][1])}" if len(rows) == 1 else "")
    return [picture(draw, title, caption, alt, numbers(named), wide=True, simulated=analysis.simulated)]


PANELS = 9
"""Most panels."""


def isometric(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Force over pressure at each contraction."""
    able = [t for t in traces if has(t, "pressure", "force")]
    if not able:
        return []
    chosen = spread(able, PANELS)
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
    return [picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=analysis.simulated)]
