"""Trials of a controller: the samples of its loop; how well it followed a path, overall and at each place.

Evaluates trials along a path; steps are evaluated in `reduction`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import Scales, changes, of_one_channel
from pmabench.analysis.shared.samples import NotUsable, count_of, fresh, lag_of, noise_of
from pmabench.analysis.shared.signals import SURE, Smooth, smooth
from pmabench.analysis.shared.skew import late
from pmabench.analysis.shared.trials import grouped, mean_of_trials, point_of, thinned
from pmabench.base.quantities import show
from pmabench.model.pid import ReferencePath
from pmabench.store.analyses.results import Estimate, Finding, Trace
from pmabench.store.records import Array, RunData, TrialData

CHANNEL = "displacement"
ALONE = "one run: no repeats part"
LONGEST_TRACE = 4000
ALONE_METHOD, AHEAD = "along a path", "along a path, with feed-forward"
FEWEST_ON_PATH = 50
"""Fewest samples of a path."""
OF_PATHS = {"e_rms": ("m", "length"), "e_max": ("m", "length"), "OS": ("1", "ratio")}
"""Symbol -> unit and quantity."""


def rows_of(trial: TrialData, law: Mapping[str, Any]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """The usable samples before the loop began, and those of the loop; of a polled displacement those that are new."""
    x = trial.channels[CHANNEL]
    known = np.asarray(trial.usable & np.isfinite(x) & fresh(x))
    before, over = trial.t < float(law["t0"]) - 1e-6, trial.t > float(law["t1"]) + 1e-6
    return known & before, known & ~before & ~over


@dataclass(frozen=True, eq=False)
class Tracked:
    """One trial along a path; arrays of shape (n,) over `t` [s from the first sample of the loop]."""

    run: RunData
    trial: TrialData
    path: ReferencePath
    method: str
    """`AHEAD` with feed-forward, else `ALONE_METHOD`."""
    t: Array
    wanted: Array
    x: Array
    """As read [m]."""

    def values(self, more: float = 0.0, gain: float = 0.0, later: float = 0.0) -> dict[str, float]:
        """Each measure, for a displacement `more` [m] and a share `gain` larger, from a sensor `later` [s]."""
        x = smooth(self.t, self.x * (1 + gain) + more, lag_of(self.run, CHANNEL) + later)
        noise, errors = noise_of(self.x), (x.against(self.wanted, sign) for sign in (1.0, -1.0))
        return {
            "e_rms": sqrt(max(0.0, float(np.mean((x.y - self.wanted) ** 2)) - (x.gain * noise) ** 2)),
            "e_max": max(error.peak(noise) for error in errors),
            "OS": max(self._overshoots(x, noise), default=0.0),
        }

    def _overshoots(self, x: Smooth, noise: float) -> list[float]:
        """Overshoot of each move beyond its place until the next one starts, relative to the move; 0 if it does not
        overshoot.
        """
        found = []
        ends = [*self.path.starts[1:], np.inf]
        moves = zip(self.path.places, self.path.places[1:], self.path.starts, ends, strict=False)
        for before, place, start, end in moves:
            inside = (self.t >= start) & (self.t < end)
            way = place - before
            if inside.any() and way:
                beyond = x.part(inside).against(place, np.sign(way)).peak(noise)
                found.append(max(0.0, beyond / abs(way)))
        return found

    def unsure(self) -> dict[str, float]:
        """Half width of each measure due to noise, counts and the timing of the displacement."""
        in_time = changes(self.values(), self.values(later=late(self.run, CHANNEL)))
        ways = np.abs(np.diff(self.path.places))
        rest = SURE * noise_of(self.x) * smooth(self.t, self.x, lag_of(self.run, CHANNEL)).gain
        rest += 0.5 * count_of(self.run, self.trial, CHANNEL)
        peaks = {"e_rms": 0.0, "e_max": rest, "OS": rest / float(ways[ways > 0].min(initial=np.inf))}
        return {name: hypot(peaks[name], in_time[name]) for name in peaks}


def tracked(run: RunData, trial: TrialData, law: Mapping[str, Any]) -> Tracked:
    """A trial along a path; raises `NotUsable`."""
    _, ok = rows_of(trial, law)
    if ok.sum() < FEWEST_ON_PATH:
        raise NotUsable(f"fewer than {FEWEST_ON_PATH} samples of the path can be used")
    path, t = ReferencePath(**law["path"]), trial.t[ok] - float(law["t0"])
    wanted = np.array([path.place(float(now)) for now in t])
    method = AHEAD if law.get("feedforward") else ALONE_METHOD
    return Tracked(run, trial, path, method, t, wanted, trial.channels[CHANNEL][ok])


def _of_paths(members: Sequence[Tracked]) -> list[Estimate]:
    """Root mean square and largest error [m], and the largest overshoot over its move [1], of one operating point."""
    scales = Scales.of([one.run for one in members])
    each, unsure = [one.values() for one in members], [one.unsure() for one in members]
    # an overshoot cannot be negative, so half the difference between both ends would be too small
    by_scale = of_one_channel(members[0].values, each[0], scales, CHANNEL)
    method, at, names = members[0].method, dict(members[0].trial.point), tuple(one.trial.name for one in members)
    lacking = scales.lack((CHANNEL,), (CHANNEL,))
    found = []
    for symbol, kind in OF_PATHS.items():
        values, open_ = ([one[symbol] for one in several] for several in (each, unsure))
        scale = None if by_scale is None else by_scale[symbol]
        found.append(mean_of_trials(symbol, kind, method, at, names, values, max(open_), scale, ALONE, lacking))
    return found


def _off_paths(cells: Sequence[Sequence[Tracked]]) -> list[Finding]:
    """The errors, one sentence for each way of controlling."""
    lines = []
    for method in dict.fromkeys(members[0].method for members in cells):
        mine = [one.values() for members in cells if members[0].method == method for one in members]
        rms, most, over = (max(one[name] for one in mine) for name in ("e_rms", "e_max", "OS"))
        text = f"{method}: off by at most {show(most, 'length', 3)}, {show(rms, 'length', 3)} rms"
        lines.append(Finding("note", f"{text}; overshoot {100 * over:.2g} % of the move"))
    return lines


def _path_trace(one: Tracked) -> Trace:
    """The path and where the muscle was."""
    setpoint, load = one.trial.point.get("setpoint", 0.0), one.trial.point.get("load", 0.0)
    columns = {"t": one.t, "displacement": one.x, "model": one.wanted}
    if "pressure_command" in one.trial.channels:
        begin = float(one.trial.found["position"]["t0"])
        columns["pressure_command"] = np.interp(one.t + begin, one.trial.t, one.trial.channels["pressure_command"])
    return Trace(
        f"path-{setpoint * 1e3:g}-{load:g}{'-ahead' if one.method == AHEAD else ''}",
        "path",
        f"{show(setpoint, 'length')}, {show(load, 'force')}: {one.method}",
        thinned(columns, LONGEST_TRACE),
        {"t": "time", "displacement": "length", "model": "length", "pressure_command": "pressure"},
        {"setpoint": setpoint},
    )


def along_paths(trials: Sequence[Tracked]) -> tuple[list[Estimate], list[Finding], list[Trace]]:
    """All trials along paths."""
    cells = grouped(trials, lambda one: (one.method, one.path.places, tuple(one.path.times), point_of(one.trial)))
    every = list(cells.values())
    found = [estimate for members in every for estimate in _of_paths(members)]
    return found, _off_paths(every), [_path_trace(members[0]) for members in every]
