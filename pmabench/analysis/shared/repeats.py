"""The repeats of one operating point over each other in time: what a figure of repeatability shows; fits nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.analysis.results import POINT_QUANTITIES, Trace
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

FIGURE = "repeats"
POINTS = 360
MOST = 8
"""Most repeats."""
HIDDEN = frozenset(("side", "mass", "cycles"))
"""Coordinates that need no word in the title."""

Point = tuple[tuple[str, float], ...]


def traces(channel: str, runs: Sequence[RunData]) -> list[Trace]:
    """The repeats of the operating point that has most of them, of several the middle one; none without repeats.

    `channel` is the one in which they differ over time; empty for kinds of test whose trials have no common course.

    Columns `t` [s] since the trial's first command and `repeat 1` ... [m] or [N], in the order of recording.
    """
    groups: dict[Point, list[TrialData]] = {}
    for run in sorted(runs, key=lambda run: str(run.manifest.get("started_utc", ""))):
        for trial in run.trials:
            usable = trial.status == "finished" and not trial.reference and not trial.again
            if usable and channel in trial.channels and np.isfinite(trial.channels[channel][trial.usable]).sum() > 1:
                point = tuple((name, float(f"{at:.6g}")) for name, at in sorted(trial.point.items()))
                groups.setdefault(point, []).append(trial)
    most = max((len(group) for group in groups.values()), default=0)
    if most < 2:
        return []
    points = sorted(point for point, group in groups.items() if len(group) == most)
    point = points[len(points) // 2]
    chosen = groups[point][:MOST]
    samples = [_values(trial, channel) for trial in chosen]
    end = min(float(t[-1]) for t, _ in samples)
    begin = max(float(t[0]) for t, _ in samples)
    if not end > begin:
        return []
    grid = np.linspace(begin, end, POINTS)
    columns = {f"repeat {n}": _means(grid, t, y) for n, (t, y) in enumerate(samples, 1)}
    known = [(name, at) for name in POINT_QUANTITIES for samples, at in point if name == samples and name not in HIDDEN]
    where = ", ".join(f"{name.replace('_', ' ')} {show(at, POINT_QUANTITIES[name], 4)}" for name, at in known)
    quantity = "force" if channel == "force" else "length"
    return [
        Trace(
            name=FIGURE,
            figure=FIGURE,
            title=f"{where or 'one operating point'}: {len(chosen)} repeats over each other",
            columns={"t": grid, **columns},
            quantities={"t": "time", **dict.fromkeys(columns, quantity)},
            marks=dict(point),
        )
    ]


def _values(trial: TrialData, channel: str) -> tuple[Array, Array]:
    """Time since the first command [s] and the usable samples of a channel."""
    use = trial.usable & np.isfinite(trial.channels[channel])
    start = min((c.t for c in trial.commands if c.t >= trial.t[0] - 1e-9), default=float(trial.t[0]))
    return trial.t[use] - start, trial.channels[channel][use]


def _means(grid: Array, t: Array, y: Array) -> Array:
    """Means of y about each point of an even grid, shape (n,): noise of single samples is no scatter of repeats."""
    step = grid[1] - grid[0]
    place = np.floor((t - grid[0]) / step + 0.5).astype(int)
    inside = (place >= 0) & (place < len(grid))
    count = np.bincount(place[inside], minlength=len(grid))
    total = np.bincount(place[inside], y[inside], len(grid))
    return np.where(count > 0, total / np.maximum(count, 1), np.interp(grid, t, y))
