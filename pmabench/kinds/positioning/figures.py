"""Figures of held positions: the approach with its reference, and the error over the whole hold.

`measure`: the values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.positioning.reduction import Tracked, measured
from pmabench.plotting.chart import BROWN, FAINT, INK, PAGE, QUIET, Chart, Level, Series, small_multiples
from pmabench.plotting.motion import overlays
from pmabench.plotting.pictures import Drawn, Picture, column, has, head, label, of_some, unit_of
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

COLUMNS = 3
MOST = 12
"""Most set-points or steps in a figure."""
UPPER, LOWER = 100.0, 74.0
APPROACH = 2.0
"""Time of the approach in the upper panel [s]."""


TABLE = ("t", "setpoint", "displacement", "model", "pressure_command")


@of_some("Positions in closed loop", MOST, "t", "displacement", "setpoint", marks=("setpoint",), columns=TABLE)
def positions(traces: Sequence[Trace]) -> Drawn:
    """Reference, measured and simulated position of every set-point."""
    modelled = all(has(t, "model") for t in traces)
    simulated = " and simulated" if modelled else ""
    caption = (
        f"Above: the approach from rest, measured{simulated}. Below: distance from the set-point over the whole hold, "
        "on one scale. The upright line begins the window of steady-state error and limit cycle."
        f"{' The simulation is the same loop around the model.' if modelled else ''}"
    )
    reach = max(map(_reach, traces))
    pairs = [_charts(trace, reach, modelled=modelled) for trace in traces]
    return small_multiples(pairs, COLUMNS, common="", one_x=False, width=PAGE), caption


def paths(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Wanted and measured place along each path."""
    mine = [trace for trace in traces if trace.figure == "path"]
    return overlays(mine, analysis, "the place that was wanted", "Along a path", most=MOST, columns=())


def _charts(trace: Trace, reach: float, *, modelled: bool) -> list[Chart]:
    """The approach, up to `APPROACH`, and below the distance from the set-point over the whole hold, up to `reach`."""
    names = ("t", "displacement", "setpoint", *["model"] * modelled)
    found = {name: column(trace, name) for name in names}
    t, unit = found["t"], unit_of(trace, "displacement")
    early, after, aim = t <= APPROACH, t >= 0, trace.marks["setpoint"] / unit.scale
    window = trace.marks.get("window", 0.0)
    near = [Series("measured", t[early], found["displacement"][early], FAINT, width=2.6)]
    far = [Series("measured", t[after], found["displacement"][after] - aim, FAINT, width=2.0)]
    if modelled:
        near.append(Series("simulated", t[early], found["model"][early], BROWN, width=1.0))
        far.append(Series("simulated", t[after], found["model"][after] - aim, BROWN, width=0.7))
    near.append(Series("reference", t[early], found["setpoint"][early], INK, width=0.8, dashed=True))
    levels = (Level(0.0, color=INK), *[Level(window, color=QUIET, upright=True)] * (window > 0))
    begin, end = min(0.0, float(np.nanmin(t))), max(APPROACH, float(np.nanmax(t)))
    return [
        Chart(
            label(trace, "t"), f"contraction [{unit.unit}]", tuple(near), height=UPPER,
            ends=(begin, APPROACH, None, None), title=head(trace), legend=True, y_ticks=4,
        ),
        Chart(
            label(trace, "t"), f"x − set-point [{unit.unit}]", tuple(far), height=LOWER,
            ends=(0.0, end, -reach, reach), levels=levels, legend=True, y_ticks=3,
        ),
    ]  # fmt: skip


def _reach(trace: Trace) -> float:
    """Largest error inside the window, plus a margin, in display units."""
    late = trace.columns["t"] >= trace.marks.get("window", 0.0)
    aim = trace.marks["setpoint"]
    away = np.abs(np.asarray(trace.columns["displacement"])[late] - aim)
    known = away[np.isfinite(away)]
    largest = max(float(known.max()) if len(known) else 0.0, 1e-3 * abs(aim))
    return 1.5 * largest / unit_of(trace, "displacement").scale


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Steady-state error and overshoot of a held position, and its limit cycle where it hunts; errors along a path."""
    try:
        one = measured(run, trial)
    except NotUsable as reason:
        on_path = (trial.found.get("position") or {}).get("path")
        wanted = {"e_rms": "length"} if on_path else {"e_ss": "ratio", "OS": "ratio"}
        return [Measured(symbol, quantity, None) for symbol, quantity in wanted.items()], [str(reason)]
    if isinstance(one, Tracked):
        values = one.values()
        return [Measured("e_rms", "length", values["e_rms"]), Measured("OS", "ratio", values["OS"])], []
    response = one.response
    found = [Measured(symbol, "ratio", one.values[symbol]) for symbol in ("e_ss", "OS")]
    doubts = [] if response.settling is not None else ["it does not settle in the band"]
    cycle = response.cycle
    if cycle is not None:
        found += [Measured("x_pp", "length", cycle.size), Measured("T_c", "time", cycle.period)]
        what = "stick-slip limit cycle" if cycle.sticks else "it oscillates"
        doubts.append(f"{what}: {show(cycle.size, 'length', 3)} peak to peak, {cycle.period:.3g} s")
    return found, doubts
