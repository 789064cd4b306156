"""Sentences and figures of static load; fits nothing.

`measure`: values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pmabench.analysis.shared.trials import thinned
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.static_load.points import PHASES, Points, pressure_of, pressures_of
from pmabench.plotting import pictures
from pmabench.plotting.chart import BLUE, BROWN, GREEN, INK, QUIET, Chart, Level, Series, small_multiples
from pmabench.plotting.wording import clean, shown
from pmabench.store.analyses.results import Analysis, Finding, Trace
from pmabench.store.records import RunData, TrialData

if TYPE_CHECKING:
    from pmabench.kinds.static_load.line import Line, Mean

SHOWN = 3


def line_findings(line: Line) -> list[Finding]:
    """The line through the means, and whether the loads fit it."""
    text = f"F_ce = {show(line.a, 'force', 4)} + {show(line.s, 'force per pressure', 5)} P"
    left = f"residual {show(line.rms, 'force', 2)} rms" if line.factor else "through two points"
    found = [Finding("note", f"{text}, {left}")]
    if line.lack > 3.0 and line.rms > 0.5:
        text = f"the loads lie off the line {line.lack:.2g} times as far as their repeats scatter: F_ce(P) is no line"
        found.append(Finding("doubt", f"{text} over these pressures"))
    return found


def of_place(mean: Mean) -> Finding:
    """Whether K x at set-down was corrected, and its size."""
    points = mean.points
    if not mean.carried:
        text = "a lifted load hangs above its support when it breaks away again, and half of K x there is still in F_ce"
        text += " (within the method part): lift it by 2 mm and more, and record its way down"
        return Finding("note", f"{text}; or process a test of K together, which takes it off")
    text = f"set-down broke away at a contraction of {show(points.place, 'length', 2)} on average"
    if mean.kept is not None:
        return Finding("note", f"{text}: lift and set-down are carried to x = 0")
    middle = float(np.nanmean(0.5 * (points.lift + points.set_down)))
    off = show(mean.line(middle) - mean.before(middle), "force", 2)
    return Finding("note", f"{text}: lift and set-down are carried to x = 0, {off} at {show(middle, 'pressure', 3)}")


def of_hysteresis(mean: Mean) -> Finding:
    """Correction for the braid's hysteresis, or why there is none."""
    if mean.kept is None:
        if mean.why:
            return Finding("doubt", f"F_ce is withheld: {mean.why}")
        text = "no load was raised, so that hysteresis of the braid does not show: the interval of F_ce holds more than"
        text += (
            " the half difference for it; raise the loads by 10 mm and more before they set down (trial.search.stroke)"
        )
        return Finding("note", text)
    force = mean.kept.force[mean.kept.on]
    least, most = (show(float(one), "force", 2) for one in (force.min(), force.max()))
    text = "a load that is raised comes down at less pressure than it went up, most in the middle: "
    return Finding("note", f"{text}{least} to {most} of hysteresis are in lift and set-down alike, and taken off F_ce")


def traces(runs: Sequence[RunData], points: Points) -> tuple[Trace, ...]:
    """All points, and displacement over pressure of a few trials."""
    if not points.names:
        return ()
    columns = {"load": points.load, "lift": points.lift, "set_down": points.set_down}
    quantities = {"load": "force", "lift": "pressure", "set_down": "pressure"}
    title = "Pressure at which each load lifts and sets down"
    traces = [Trace("static-load", "static", title, columns, quantities)]
    trials = {trial.name: trial for run in runs for trial in run.trials}
    first = [points.names[int(np.flatnonzero(points.load == load)[0])] for load in np.unique(points.load)]
    for name in dict.fromkeys(first[round(i)] for i in np.linspace(0, len(first) - 1, SHOWN)):
        traces += _lift_trace(trials[name])
    return tuple(traces)


def _lift_trace(trial: TrialData) -> list[Trace]:
    if "pressure" not in trial.channels or "displacement" not in trial.channels or not len(trial.t):
        return []
    load, found = trial.point["load"], zip(PHASES, pressures_of(trial), strict=True)
    columns = {"t": trial.t - trial.t[0], **{name: trial.channels[name] for name in ("pressure", "displacement")}}
    quantities = {"t": "time", "pressure": "pressure", "displacement": "length"}
    marks = {"load": load, **{name: P for name, P in found if np.isfinite(P)}}
    title = f"{show(load, 'force', 4)}: lift and set-down"
    return [Trace(f"lift-{load:.0f}N", "lift", title, thinned(columns), quantities, marks)]


PANELS = 6
"""Most panels."""
OVER_TIME = ("t", "pressure", "displacement")


@pictures.of_some("Lift-off and set-down", PANELS, *OVER_TIME, columns=OVER_TIME)
def lifts(traces: Sequence[Trace]) -> pictures.Drawn:
    """Pressure and contraction over time, with the pressures found."""
    caption = (
        "Above: pressure, rising until the load lifts off its support and falling until it sets down; dashed, the "
        "pressures found. Below: contraction."
    )
    return small_multiples([_lift(trace) for trace in traces], 3, common=""), caption


def _lift(trace: Trace) -> tuple[Chart, Chart]:
    """Pressure over time with the pressures found, and contraction below."""
    t, scale = pictures.label(trace, "t"), shown("pressure").scale
    levels = tuple(
        Level(trace.marks[name] / scale, f"{name} {trace.marks[name] / scale:.4g}", color)
        for name, color in (("lift", BROWN), ("set-down", GREEN))
        if name in trace.marks
    )
    pressure, moved = (
        (pictures.label(trace, name), [pictures.curve(trace, "t", name, "", color, width=1.0)])
        for name, color in (("pressure", BLUE), ("displacement", QUIET))
    )
    upper = Chart(t, *pressure, height=104.0, title=pictures.head(trace), levels=levels)
    return upper, Chart(t, *moved, height=88.0, y_ticks=3)


def points(traces: Sequence[Trace], analysis: Analysis) -> list[pictures.Picture]:
    """Lift-off and set-down of every trial, with the lines of the analysis through them."""
    found = []
    for trace in (t for t in traces if pictures.has(t, "load", "lift", "set_down")):
        load, lift, set_down = (pictures.column(trace, name) for name in ("load", "lift", "set_down"))
        series = []
        able = [c for c in analysis.curves if c.against == "pressure" and all(e.value is not None for e in c.terms)]
        for n, c in enumerate(able):
            x = np.linspace(*c.domain, 2)
            y, color = c.values(x) / shown("force").scale, (INK, BROWN, GREEN)[n % 3]
            series.append(Series(clean(c.method, 40), x / shown("pressure").scale, y, color, width=1.0, dashed=n > 0))
        series.append(Series("lift-off", lift, load, BROWN, "^", hollow=True))
        series.append(Series("set-down", set_down, load, GREEN, "v", hollow=True))
        caption = "Each mark is one trial: friction holds the load down at lift-off and up at set-down."
        labels = shown("pressure").label("P"), shown("force").label("F_L")
        charts = [[Chart(*labels, tuple(series), height=180.0, legend=True)]]
        found.append(pictures.of_traces(charts, clean(trace.title, 90), caption, analysis, [trace]))
    return found


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Pressures at which the load lifts and sets down, their mean, and half the difference."""
    doubts: list[str] = []
    found: list[float | None] = []
    for phase in PHASES:
        result = trial.found.get(phase)
        value = pressure_of(result or {})
        found.append(value if np.isfinite(value) else None)
        if result is None:
            doubts.append(f"{phase} was not looked for")
        elif found[-1] is None:
            doubts.append(f"{phase}: {result.get('reason') or 'nothing found'}")
    lift, down = found
    load, middle, half = trial.point.get("load"), None, None
    predicted = expected.lifts(load) if expected is not None and load is not None else None
    if lift is not None and down is not None:
        middle, half = 0.5 * (lift + down), 0.5 * (lift - down)
        if half < 0:
            doubts.append("it sets down at a higher pressure than it lifts")
    return [
        Measured("lift", "pressure", lift, noise=1e3),
        Measured("set-down", "pressure", down, noise=1e3),
        Measured("mean", "pressure", middle, predicted, tolerance=3e3, noise=1e3),
        Measured("half", "pressure", half, noise=2e3),
    ], doubts
