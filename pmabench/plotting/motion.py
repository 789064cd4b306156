"""Figures of driven and free motion: overlays, loops, values over frequency, growth over gain.

Also of isometric tests: force over pressure at fixed contractions, with fitted lines.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from math import pi

import numpy as np

from pmabench.plotting.chart import (
    BLUE,
    BROWN,
    FAINT,
    GAP,
    INK,
    MARKS,
    PAGE,
    PALETTE,
    QUIET,
    Array,
    Chart,
    Level,
    Series,
    closed,
    small_multiples,
)
from pmabench.plotting.pictures import (
    Picture,
    column,
    crosses,
    curve,
    has,
    head,
    label,
    of_traces,
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
OF_MODEL = (("displacement", "measured", FAINT, 3.0), ("model", "model", BROWN, 1.3))
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
    unit = unit_of(chosen[0], "displacement").unit
    misfits = [_rms(column(t, "displacement") - column(t, "model")) for t in chosen]
    title += f", {head(chosen[0])}" if len(chosen) == 1 else ""
    caption = f"Measured, and {model}. Below: their difference, rms {reach(misfits)} {unit}.{also}"
    if any(not np.isfinite(column(t, "model")).all() for t in chosen):
        caption += " The model ends where the muscle moves at a pressure at which a coefficient is open."
    rows = small_multiples([_overlaid(t) for t in chosen], 3, common="")
    return [of_traces(rows, title, caption, analysis, chosen, able, columns)]


def _overlaid(trace: Trace) -> tuple[Chart, Chart]:
    """Measured and model over time with their difference below."""
    t, unit = label(trace, "t"), unit_of(trace, "displacement").unit
    y, model = (curve(trace, "t", name, word, color, width=width) for name, word, color, width in OF_MODEL)
    away = column(trace, "displacement") - column(trace, "model")
    apart = (Series("", column(trace, "t"), away, QUIET, width=0.9),)
    upper = Chart(t, f"contraction [{unit}]", (y, model), height=UPPER, title=head(trace), legend=True)
    return upper, Chart(t, f"difference [{unit}]", apart, height=LOWER, y_ticks=3)


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
        modelled = all(has(t, "model") for t in chosen)
        titles = [_frequency(t) for t in chosen]
        labels = label(chosen[0], first), label(chosen[0], second)
        where = clean(chosen[0].title.partition(", ")[2], 60)
        title = _title(first, second, where)
        each = " at each frequency" if any("frequency" in t.marks for t in chosen) else ""
        lacking = ". No model is drawn: stiffness, damping and friction are not all known here."
        model = ", and as model the fitted muscle along the same motion." if modelled else lacking
        caption = f"The last measured cycle{each}{model}"
        if width := [t.marks["width"] for t in chosen if "width" in t.marks]:
            unit = shown("force")
            caption += f" Width at mid stroke {reach([w / unit.scale for w in width])} {unit.unit}."
        charts = []
        said = len(titles) == 1 and "frequency" not in chosen[0].marks  # in the title of the figure
        for trace, head_of, theirs in zip(chosen, titles, crosses(chosen, first, second), strict=True):
            lines = [closed(curve(trace, first, second, "measured", FAINT, width=3.0))]
            lines += [closed(curve(trace, first, "model", "model", BROWN))] if modelled else []
            charts.append(Chart(*labels, (*lines, *theirs), title="" if said else head_of, legend=True))
        rows = small_multiples(charts, 4)
        found.append(of_traces(rows, title, caption, analysis, chosen, titles=titles))
    return found


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
    titles = [clean(t.title.partition(", ")[2] or t.title, 40) for t in able]
    series: dict[str, list[Series]] = {"K": [], "B": [], "phase": []}
    damping, stiffness = shown("damping"), shown("stiffness")
    for n, (trace, title) in enumerate(zip(able, titles, strict=True)):
        color = PALETTE[n % len(PALETTE)]
        f, speed = (np.asarray(trace.columns[name]) for name in ("frequency", "speed"))
        if all(name in trace.marks for name in ("K", "B", "F_c")) and len(f) > 1:
            fine = np.geomspace(f.min(), f.max(), 60)
            fast = np.interp(fine, f, speed / f) * fine
            loss = trace.marks["B"] * fast + 4 * trace.marks["F_c"] / pi
            phase = np.degrees(np.arctan2(loss, trace.marks["K"] * fast / (2 * pi * fine)))
            K = np.full(60, trace.marks["K"] / stiffness.scale)
            for name, y in (("K", K), ("B", loss / fast / damping.scale), ("phase", phase)):
                series[name].append(Series("", fine, y, color, width=0.9, said=title))
        B = np.asarray(trace.columns["loss"]) / speed / damping.scale
        for name, y in (("K", column(trace, "stiffness")), ("B", B), ("phase", column(trace, "phase"))):
            series[name].append(Series(title, f, y, color, MARKS[n % len(MARKS)]))
    fitted = any(not one.mark for one in series["B"])
    caption = (
        "Left: stiffness K = −Re(F/x). Middle: loss per speed, −Im(F/x)/ω, which tends to B where viscous damping "
        "rules and rises at low frequency where Coulomb friction does. Right: phase of force before displacement. "
    ) + ("Lines: the fitted K, B and F_c." if fitted else "No line is known.")
    names = ("frequency", "stiffness", "loss", "speed", "phase", "width")
    labels = stiffness.label("K"), damping.label("loss per speed"), "phase [deg]"
    charts = [_over_frequency(y_label, mine) for y_label, mine in zip(labels, series.values(), strict=True)]
    rows, title = small_multiples(charts, 3, common="", width=PAGE), "Stiffness, damping and phase over frequency"
    return [of_traces(rows, title, caption, analysis, able, columns=names, titles=titles)]


def _over_frequency(y_label: str, series: Sequence[Series]) -> Chart:
    """Marks and lines over frequency on a logarithmic axis with a tick at each frequency."""
    values = np.concatenate([one.y[np.isfinite(one.y)] for one in series])
    middle = float(values.max() + values.min()) / 2
    half = NARROW / 2 * abs(middle)
    flat = float(np.ptp(values)) < 2 * half
    ends = None, None, middle - half if flat else None, middle + half if flat else None
    at = tuple(sorted({float(f) for one in series if one.mark for f in one.x}))
    return Chart("frequency [Hz]", y_label, tuple(series), legend=True, x_ticks=at, log=True, ends=ends)


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
    rows: list[list[Chart | None]] = []
    named: list[tuple[str, Trace]] = []
    for swing, growth in list(pairs.values())[:ROWS]:
        left = right = None
        if swing is not None and has(swing, "t", "displacement"):
            left = _swings(swing)
            named.append((f"swings, {_setpoint(swing)}", swing))
        if growth is not None:
            named.append((f"growth, {_setpoint(growth)}", growth))
            if has(growth, "gain", "log_ratio", "used"):
                right = _growth(growth)
        rows.append([left, right])
    if not any(map(any, rows)):
        return []
    caption = "Left: contraction at the gain levels around K_u; dashed, the set-point. Right: growth. " + _GROWTH
    if len(pairs) > ROWS:
        caption += f" {ROWS} of {len(pairs)} operating points are shown."
    title = "Sustained oscillation and ultimate gain" + (f", {_setpoint(named[0][1])}" if len(rows) == 1 else "")
    columns = []
    for place, width in enumerate((WIDER, PAGE - GAP - WIDER)):
        known = [one for row in rows if (one := row[place])]
        columns.append(iter(small_multiples(known, 1, common="", width=width) if known else []))
    found = [[next(of)[0] for one, of in zip(row, columns, strict=True) if one] for row in rows if any(row)]
    names, shown_traces = zip(*named, strict=True)
    return [of_traces(found, title, caption, analysis, shown_traces, titles=names)]


def _swings(swing: Trace) -> Chart:
    """Oscillation over time at the gains around the ultimate one."""
    line, scale = curve(swing, "t", "displacement", "", BLUE, width=0.9), unit_of(swing, "displacement").scale
    levels = tuple(Level(value / scale) for name, value in swing.marks.items() if name == "setpoint")
    labels, title = (label(swing, "t"), label(swing, "displacement")), f"Swings near K_u, {_setpoint(swing)}"
    return Chart(*labels, (line,), title=title, levels=levels)


def _growth(growth: Trace) -> Chart:
    """Logarithm of the ratio of successive swings over gain; line through the filled points, its zero is K_u."""
    gain, ratio = column(growth, "gain"), column(growth, "log_ratio")
    used = column(growth, "used") > 0.5
    series = [Series("", gain[at], ratio[at], BLUE, "o", hollow=open) for at, open in ((~used, True), (used, False))]
    if has(growth, "fit") and used.any():
        near = gain >= np.min(gain[used])
        series.append(Series("", gain[near], column(growth, "fit")[near], BROWN))
    levels = [Level(0.0, dashed=False)]
    if "K_u" in growth.marks:
        K_u = growth.marks["K_u"] / unit_of(growth, "gain").scale
        levels.append(Level(K_u, f"K_u = {K_u:.4g}", BROWN, upright=True))
    labels = label(growth, "gain"), "ln(growth) per half period"
    return Chart(*labels, tuple(series), title="Growth", levels=tuple(levels))


PANELS, FEW = 9, 40
"""Most panels, and marks of a group."""


def isometric(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Force over pressure at each contraction."""
    able = [t for t in traces if has(t, "pressure", "force")]
    if not able:
        return []
    chosen = spread(able, PANELS)
    by_branch = all(has(t, "branch") for t in able)
    length = shown("length")
    at = [t.marks.get("contraction") for t in chosen]
    titles = [
        head(t) if x is None else f"x = {x / length.scale:.3g} {length.unit}" for t, x in zip(chosen, at, strict=True)
    ]
    caption = (
        f"Samples of every test at set contractions{' (blue dots: filling, brown triangles: emptying)' * by_branch}, "
        "and the least-squares line through them where it was fitted."
    )
    theirs = crosses(chosen, "pressure", "force")
    group = "branch" if by_branch else "test"
    rows = small_multiples([_scattered(*one, group) for one in zip(chosen, titles, theirs, strict=True)], 3)
    title = "Isometric force over pressure" + (f", {titles[0]}" if len(chosen) == 1 else "")
    return [of_traces(rows, title, caption, analysis, chosen, able, ("pressure", "force", "fit", "test"), titles)]


def _scattered(trace: Trace, title: str, theirs: Sequence[Series], group: str) -> Chart:
    """Samples of force over pressure by a column, with the fitted line as far as there are such forces.

    The first group as dots, others as some of their samples in another shape.
    """
    x, y = column(trace, "pressure"), column(trace, "force")
    member = column(trace, group) if has(trace, group) else np.zeros(len(x))
    series = []
    for n, one in enumerate(np.unique(member)):
        rows = np.flatnonzero(member == one)
        rows, mark = (rows, ".") if n == 0 else (rows[:: -(-len(rows) // FEW)], "vsD<^"[(n - 1) % 5])
        series.append(Series("", x[rows], y[rows], PALETTE[n % len(PALETTE)], mark, hollow=n > 0))
    fit = column(trace, "fit") if has(trace, "fit") else np.full(len(x), np.nan)
    known = np.flatnonzero(np.isfinite(x) & (fit >= np.nanmin(y)) & (fit <= np.nanmax(y)))
    if len(known):
        ends = known[[np.argmin(x[known]), np.argmax(x[known])]]
        series.append(Series("fit", x[ends], fit[ends], INK))
    return Chart(label(trace, "pressure"), label(trace, "force"), (*series, *theirs), title=title, legend=True)


HEIGHTS = 64.0, 104.0, 84.0
"""Of the lines of `courses` [pt]."""


def courses(
    stacks: Sequence[tuple[str, Sequence[Series], Sequence[Level]]], labels: Sequence[str]
) -> list[list[Chart]]:
    """Rows of (title, lines over time below each other, levels of the second): `labels` of time and of the lines."""
    made = []
    for title, lines, levels in stacks:
        parts = zip(lines, labels[1:], HEIGHTS, strict=False)
        charts = [Chart(labels[0], name, (line,), height=high, y_ticks=3) for line, name, high in parts]
        charts[0], charts[1] = replace(charts[0], title=title), replace(charts[1], levels=tuple(levels), y_ticks=4)
        made.append(charts)
    return small_multiples(made, 4, common="y")
