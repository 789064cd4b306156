"""Words, the table of loads and the figures of static load: what was found, shown; fits nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pmabench.analysis.results import Finding, Trace
from pmabench.base.quantities import show
from pmabench.kinds.static_load.points import PHASES, Points, pressure_of
from pmabench.store.records import RunData, TrialData

if TYPE_CHECKING:
    from pmabench.kinds.static_load.reduction import Line

LONGEST_TRACE = 1500
SHOWN = 3


def line_findings(line: Line) -> list[Finding]:
    """The line through the means, and whether the loads lie on it."""
    text = f"F_ce = {show(line.a, 'force', 4)} + {show(line.s, 'force per pressure', 5)} P"
    left = f"residual {show(line.rms, 'force', 2)} rms" if line.factor else "through two points"
    found = [Finding("note", f"{text}, {left}")]
    if line.lack > 3.0 and line.rms > 0.5:
        found.append(
            Finding(
                "doubt",
                f"the loads lie off the line {line.lack:.2g} times as far as their repeats scatter: F_ce(P) is no line"
                " over these pressures",
            )
        )
    return found


def of_place(points: Points, uncorrected: Line | None, line: Line) -> Finding:
    """Whether K x at set-down was taken off, with its size."""
    if uncorrected is None:
        text = "a lifted load hangs above its support when it breaks away again, and half of K x there is still in F_ce"
        return Finding("note", f"{text} (within the method part): a test of K processed together takes it off")
    middle = float(np.nanmean(0.5 * (points.lift + points.set_down)))
    off = show(line(middle) - uncorrected(middle), "force", 2)
    text = f"set-down broke away at a contraction of {show(points.place, 'length', 2)} on average"
    return Finding("note", f"{text}: half of K x there, {off} at {show(middle, 'pressure', 3)}, is taken off")


def table(points: Points) -> list[dict[str, float | int | None]]:
    """Per load: number of trials, mean and standard deviation of the pressures."""
    rows: list[dict[str, float | int | None]] = []
    for load in np.unique(points.load):
        row: dict[str, float | int | None] = {"load": float(load), "n": int((points.load == load).sum())}
        for name, values in (("lift", points.lift), ("set_down", points.set_down)):
            known = values[(points.load == load) & np.isfinite(values)]
            row[name] = float(known.mean()) if len(known) else None
            row[f"{name}_sd"] = float(known.std(ddof=1)) if len(known) > 1 else None
        rows.append(row)
    return rows


def traces(runs: Sequence[RunData], points: Points) -> tuple[Trace, ...]:
    """All points, and displacement over pressure of a few trials."""
    if not points.names:
        return ()
    traces = [
        Trace(
            name="static-load",
            figure="static",
            title="Pressure at which each load lifts and sets down",
            columns={"load": points.load, "lift": points.lift, "set_down": points.set_down},
            quantities={"load": "force", "lift": "pressure", "set_down": "pressure"},
        )
    ]
    trials = {trial.name: trial for run in runs for trial in run.trials}
    first = [points.names[int(np.flatnonzero(points.load == load)[0])] for load in np.unique(points.load)]
    for name in dict.fromkeys(first[round(i)] for i in np.linspace(0, len(first) - 1, SHOWN)):
        traces += _lift_trace(trials[name])
    return tuple(traces)


def _lift_trace(trial: TrialData) -> list[Trace]:
    if "pressure" not in trial.channels or "displacement" not in trial.channels or not len(trial.t):
        return []
    stride = -(-len(trial.t) // LONGEST_TRACE)
    marks = {phase: pressure_of(trial.found.get(phase) or {}) for phase in PHASES}
    return [
        Trace(
            name=f"lift-{trial.point['load']:.0f}N",
            figure="lift",
            title=f"{show(trial.point['load'], 'force', 4)}: lift and set-down",
            columns={
                "t": (trial.t - trial.t[0])[::stride],
                "pressure": trial.channels["pressure"][::stride],
                "displacement": trial.channels["displacement"][::stride],
            },
            quantities={"t": "time", "pressure": "pressure", "displacement": "length"},
            marks={"load": trial.point["load"], **{name: P for name, P in marks.items() if np.isfinite(P)}},
        )
    ]
