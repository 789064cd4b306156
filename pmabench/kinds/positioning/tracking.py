"""How well a controller followed a path: the error over the whole path, and what it goes beyond each place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.isometric_lines import spread
from pmabench.base.quantities import show
from pmabench.model.reference_path import ReferencePath
from pmabench.store.analyses.results import Dropped, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

ALONE_METHOD, AHEAD = "along a path", "along a path, with feed-forward"
ALONE = "one run: no repeats part"
FEWEST = 50
"""Samples of a path."""
LONGEST_TRACE = 4000
MEASURES = {"e_rms": ("m", "length"), "e_max": ("m", "length"), "OS": ("1", "ratio")}
"""Symbol -> unit and quantity."""


@dataclass(frozen=True, eq=False)
class Tracked:
    """One trial along a path; arrays of shape (n,) over `t` [s from the first sample of the loop]."""

    run: RunData
    trial: TrialData
    path: ReferencePath
    ahead: bool
    """Whether a feed-forward was added."""
    t: Array
    wanted: Array
    x: Array

    @property
    def method(self) -> str:
        """How it was controlled."""
        return AHEAD if self.ahead else ALONE_METHOD

    def values(self, more: float = 0.0, gain: float = 0.0) -> dict[str, float]:
        """Each measure, of a displacement that is `more` [m] and a share `gain` larger."""
        x = self.x * (1 + gain) + more
        error = x - self.wanted
        return {
            "e_rms": float(np.sqrt(np.mean(error**2))),
            "e_max": float(np.abs(error).max()),
            "OS": max(self._overshoots(x), default=0.0),
        }

    def _overshoots(self, x: Array) -> list[float]:
        """What each move goes beyond its place until the next one begins, over the move; none is 0."""
        found = []
        ends = [*self.path.starts[1:], np.inf]
        moves = zip(self.path.places, self.path.places[1:], self.path.starts, ends, strict=False)
        for before, place, start, end in moves:
            inside = (self.t >= start) & (self.t < end)
            way = place - before
            if inside.any() and way:
                found.append(max(0.0, float(((x[inside] - place) / way).max())))
        return found


def tracked(run: RunData, trial: TrialData, law: Mapping[str, Any]) -> Tracked | str:
    """A trial along a path, or why it is not used."""
    begin, x = float(law["t0"]), trial.channels["displacement"]
    ok = trial.usable & np.isfinite(x) & (trial.t >= begin - 1e-6) & (trial.t <= float(law["t1"]) + 1e-6)
    if ok.sum() < FEWEST:
        return f"fewer than {FEWEST} samples of the path can be used"
    path = ReferencePath(**law["path"])
    t = trial.t[ok] - begin
    wanted = np.array([path.place(float(now)) for now in t])
    return Tracked(run, trial, path, bool(law.get("feedforward")), t, wanted, x[ok])


def estimates(members: Sequence[Tracked]) -> list[Estimate]:
    """Root mean square and largest error [m], and the largest overshoot over its move [1], of one operating point."""
    scales = Scales.of([one.run for one in members])
    gain, offset = scales.gains.get("displacement", 0.0), scales.offsets.get("displacement", 0.0)
    each = [one.values() for one in members]
    ways = ((offset, 0.0), (0.0, gain))
    shifted = [(members[0].values(more, share), members[0].values(-more, -share)) for more, share in ways]
    lacking = scales.lack(("displacement",), ("displacement",))
    several = len(members) > 1
    found = []
    for symbol, (unit, quantity) in MEASURES.items():
        values = np.array([one[symbol] for one in each])
        scale = hypot(*(0.5 * (up[symbol] - down[symbol]) for up, down in shifted))
        parts = Parts(spread(values), calibration=scale if offset > 0 or gain > 0 else None)
        mean, method, at = float(values.mean()), members[0].method, dict(members[0].trial.point)
        note = sentences("" if several else ALONE, lacking)
        names = tuple(one.trial.name for one in members)
        found.append(Estimate(symbol, mean, unit, quantity, method, at, parts, len(values), note=note, trials=names))
    return found


def findings(cells: Sequence[Sequence[Tracked]]) -> list[Finding]:
    """How far it was off, each way of controlling in one sentence."""
    lines = []
    for method in dict.fromkeys(members[0].method for members in cells):
        mine = [one.values() for members in cells if members[0].method == method for one in members]
        rms, most = (max(one[name] for one in mine) for name in ("e_rms", "e_max"))
        over = 100 * max(one["OS"] for one in mine)
        text = (
            f"{method}: off by at most {show(most, 'length', 3)}, {show(rms, 'length', 3)} rms; overshoot {over:.2g} %"
        )
        lines.append(Finding("note", f"{text} of the move"))
    return lines


def trace(one: Tracked) -> Trace:
    """The path and where the muscle was."""
    rows = slice(None, None, max(1, -(-len(one.t) // LONGEST_TRACE)))
    setpoint, load = one.trial.point.get("setpoint", 0.0), one.trial.point.get("load", 0.0)
    columns = {"t": one.t, "displacement": one.x, "model": one.wanted}
    if "pressure_command" in one.trial.channels:
        begin = float(one.trial.found["position"]["t0"])
        columns["pressure_command"] = np.interp(one.t + begin, one.trial.t, one.trial.channels["pressure_command"])
    return Trace(
        f"path-{setpoint * 1e3:g}-{load:g}{'-ahead' if one.ahead else ''}",
        "path",
        f"{show(setpoint, 'length')}, {show(load, 'force')}: {one.method}",
        {name: column[rows] for name, column in columns.items()},
        {"t": "time", "displacement": "length", "model": "length", "pressure_command": "pressure"},
        {"setpoint": setpoint},
    )


def reduced(
    pairs: Sequence[tuple[RunData, TrialData, Mapping[str, Any]]],
) -> tuple[list[Estimate], list[Finding], list[Trace], list[Dropped]]:
    """All trials along paths, given with what their law wrote down."""
    dropped: list[Dropped] = []
    cells: dict[tuple[object, ...], list[Tracked]] = {}
    for run, trial, law in pairs:
        one = tracked(run, trial, law)
        if isinstance(one, str):
            dropped.append(Dropped(trial.name, trial.point, one))
            continue
        point = tuple(sorted((name, round(value, 9)) for name, value in trial.point.items()))
        cells.setdefault((one.method, one.path.places, tuple(one.path.times), point), []).append(one)
    every = list(cells.values())
    found = [estimate for members in every for estimate in estimates(members)]
    return found, findings(every), [trace(members[0]) for members in every], dropped
