"""Figures of driven and free motion: overlays, loops, values over frequency, growth over gain.

Also of isometric tests: force over pressure at fixed contractions, with fitted lines.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from math import pi

import numpy as np

from pmabench.plotting.chart import GAP, PAGE, Array, Chart, Level, Series, closed, small_multiples
from pmabench.plotting.looks import BLUE, BROWN, FAINT, INK, MARKS, PALETTE, QUIET
from pmabench.plotting.pictures import (
    Panel,
    Picture,
    has,
    head,
    how_many,
    label,
    numbers,
    of_charts,
    panel,
    published,
    reach,
    spread,
    unit_of,
)
from pmabench.plotting.wording import clean, shown
from pmabench.store.analyses.results import Analysis, Trace

LOOPS, ROWS, MOST = 8, 4, 6
"""Most loops of a figure, rows of a figure of oscillations, and figures of loops."""
NAMES = ("t", "pressure", "displacement", "model")
WIDER = 320.0
"""Width of swings over time, left of their growth [pt]."""
UPPER, LOWER = 112.0, 70.0
"""Heights of a panel, and of what is below it [pt]."""
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
    caption = f"Measured, and {model}. Below: their difference, rms {reach(misfits)} {unit}.{also}"
    caption += how_many(chosen, able)
    if any(not np.isfinite(p.columns["model"]).all() for p in panels):
        caption += " The model ends where the muscle moves at a pressure at which a coefficient is open."
    alt = (
        f"Contraction over time, measured, and {model}, in {len(panels)} panel{'s' if len(panels) > 1 else ''}: "
        f"{'; '.join(p.title for p in panels)}. Root mean square difference {reach(misfits)} {unit}"
        + (f", largest at {panels[worst].title}." if len(panels) > 1 else ".")
    )
    table = numbers([(head(t), t) for t in chosen], columns)
    rows = small_multiples([_overlaid(one, label(chosen[0], "t"), unit) for one in panels], 3, common="")
    return [of_charts(rows, title, caption, alt, table, simulated=analysis.simulated)]


def _overlaid(one: Panel, t_label: str, unit: str) -> tuple[Chart, Chart]:
    """Measured and model over time with their difference below; columns t, measured, model."""
    t, y, model = (one.columns[name] for name in ("t", "measured", "model"))
    lines = (Series("measured", t, y, FAINT, width=3.0), Series("model", t, model, BROWN))
    apart = (Series("", t, y - model, QUIET, width=0.9),)
    upper = Chart(t_label, f"contraction [{unit}]", lines, height=UPPER, title=one.title, legend=True)
    return upper, Chart(t_label, f"difference [{unit}]", apart, height=LOWER, y_ticks=3)


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
        model = ", and as model the fitted muscle along the same motion." if "model" in names else lacking
        caption = f"The last measured cycle{each}{model}"
        if width := [t.marks["width"] for t in chosen if "width" in t.marks]:
            unit = shown("force")
            caption += f" Width at mid stroke {reach([w / unit.scale for w in width])} {unit.unit}."
        alt = f"{labels['y']} over {labels['x']} as closed loops at {', '.join([p.title for p in panels])}"
        alt += f", {where}." if where else "."
        alt += " Loops grow wider as the frequency rises where damping acts." if len(chosen) > 1 else ""
        table = numbers([(_frequency(t), t) for t in chosen])
        if len(panels) == 1 and "frequency" not in chosen[0].marks:
            panels = [replace(panels[0], title="")]  # it is in the title of the figure
        charts = [_loop(one, theirs, labels) for one, theirs in zip(panels, published(panels), strict=True)]
        rows = small_multiples(charts, 4)
        found.append(of_charts(rows, title, caption, alt, table, simulated=analysis.simulated))
    return found


def _loop(one: Panel, theirs: Sequence[Series], labels: dict[str, str]) -> Chart:
    """A closed curve of y over x, measured and model; columns x, measured, model."""
    looks = (("measured", {"color": FAINT, "width": 3.0}), ("model", {"color": BROWN}))
    x = closed(one.columns["x"])
    lines = [Series(name, x, closed(one.columns[name]), **look) for name, look in looks if name in one.columns]
    return Chart(labels["x"], labels["y"], (*lines, *theirs), title=one.title, legend=True)


def _axes(trace: Trace) -> tuple[str, str]:
    return ("pressure", "displacement") if trace.figure == "pressure-loop" else ("displacement", "force")


def _frequency(trace: Trace) -> str:
    return f"{trace.marks['frequency']:.4g} Hz" if "frequency" in trace.marks else head(trace)


NARROW = 0.06
"""Least range of an axis over frequency, as a share of the middle value."""


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
    charts = [_against_frequency(panels, name, labels) for name in ("K", "B", "phase")]
    rows = small_multiples(charts, 3, common="", width=PAGE)
    return [of_charts(rows, title, caption, alt, table, simulated=analysis.simulated)]


def _against_frequency(panels: Sequence[Panel], name: str, labels: dict[str, str]) -> Chart:
    """A column over frequency on a logarithmic axis; fitted lines from the columns `frequency fit`, `<name> fit`."""
    series = []
    for n, one in enumerate(panels):
        color, at = PALETTE[n % len(PALETTE)], one.columns
        if f"{name} fit" in at:
            series.append(Series("", at["frequency fit"], at[f"{name} fit"], color, width=0.9))
        series.append(Series(one.title, at["frequency"], at[name], color, MARKS[n % len(MARKS)]))
    values = np.concatenate([one.y[np.isfinite(one.y)] for one in series])
    middle = float(values.max() + values.min()) / 2
    half = NARROW / 2 * abs(middle)
    low, high = (middle - half, middle + half) if float(np.ptp(values)) < 2 * half else (None, None)
    ticks = tuple(sorted({float(f) for one in panels for f in one.columns["frequency"]}))
    return Chart(
        labels["frequency"],
        labels[name],
        tuple(series),
        legend=True,
        x_ticks=ticks,
        log=True,
        ends=(None, None, low, high),
    )


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
    charts = [
        (_swings(left, labels) if left else None, _growth(right, labels) if right else None) for left, right in rows
    ]
    title = "Sustained oscillation and ultimate gain" + (f", {_setpoint(named[0][1])}" if len(rows) == 1 else "")
    columns = []
    for column, width in zip(zip(*charts, strict=True), (WIDER, PAGE - GAP - WIDER), strict=True):
        known = [one for one in column if one]
        columns.append(iter(small_multiples(known, 1, common="", width=width) if known else []))
    found = [[next(of)[0] for one, of in zip(row, columns, strict=True) if one] for row in charts if any(row)]
    return [of_charts(found, title, caption, alt, numbers(named), simulated=analysis.simulated)]


def _swings(swing: Panel, labels: dict[str, str]) -> Chart:
    """Oscillation over time at the gains around the ultimate one."""
    line = Series("", swing.columns["t"], swing.columns["measured"], BLUE, width=0.9)
    levels = tuple(Level(value) for name, value in swing.marks.items() if name == "setpoint")
    return Chart(labels["t"], labels["measured"], (line,), title=swing.title, levels=levels)


def _growth(growth: Panel, labels: dict[str, str]) -> Chart:
    """Logarithm of the ratio of successive swings over gain; line through the filled points, its zero is K_u."""
    gain, ratio = growth.columns["gain"], growth.columns["log_ratio"]
    used = growth.columns["used"] > 0.5
    series = [
        Series("", gain[~used], ratio[~used], BLUE, "o", hollow=True),
        Series("", gain[used], ratio[used], BLUE, "o"),
    ]
    if "fit" in growth.columns and used.any():
        near = gain >= np.min(gain[used])
        series.append(Series("", gain[near], growth.columns["fit"][near], BROWN))
    levels = [Level(0.0, dashed=False)]
    levels += [Level(growth.marks["K_u"], growth.title, BROWN, upright=True)] if "K_u" in growth.marks else []
    return Chart(labels["gain"], labels["log_ratio"], tuple(series), title="Growth", levels=tuple(levels))


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
        f"Samples of every test{' (blue: filling, brown: emptying)' if by_branch else ''} at set contractions, "
        f"and the least-squares line through them where it was fitted.{how_many(chosen, able)}"
    )
    alt = f"Force over pressure at fixed contraction, with a straight line, for {'; '.join(p.title for p in panels)}."
    table = numbers([(p.title, t) for p, t in zip(panels, chosen, strict=True)], ("pressure", "force", "fit", "test"))
    charts = [_scattered(one, theirs, labels) for one, theirs in zip(panels, published(panels), strict=True)]
    title = "Isometric force over pressure" + (f", {panels[0].title}" if len(chosen) == 1 else "")
    return [of_charts(small_multiples(charts, 3), title, caption, alt, table, simulated=analysis.simulated)]


def _scattered(one: Panel, theirs: Sequence[Series], labels: dict[str, str]) -> Chart:
    """Samples of y over x, coloured by group, with the fitted line; columns x, measured, fit, group."""
    x, y = one.columns["x"], one.columns["measured"]
    group = one.columns.get("group", np.zeros(len(x)))
    series = [
        Series("", x[group == member], y[group == member], PALETTE[n % len(PALETTE)], ".")
        for n, member in enumerate(np.unique(group))
    ]
    fit = one.columns.get("fit", np.full(len(x), np.nan))
    known = np.flatnonzero(np.isfinite(fit) & np.isfinite(x))
    if len(known):
        ends = known[[np.argmin(x[known]), np.argmax(x[known])]]
        series.append(Series("fit", x[ends], fit[ends], INK))
    return Chart(labels["x"], labels["y"], (*series, *theirs), title=one.title, legend=True)
