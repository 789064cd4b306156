"""K_u and T_u of open-loop steps, by set-point: the fitted loop's own, and what friction and bends say against them.

Knows the trials' samples and commands; not how the closed loop finds the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np

from pmabench.analysis.results import Estimate, Finding, Parts, Trace
from pmabench.analysis.shared import skew, student
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import weighed
from pmabench.base.quantities import show
from pmabench.kinds.ultimate_gain.cell import GainCell
from pmabench.kinds.ultimate_gain.open_loop import StepsFound, examine, samples_of, steps_of
from pmabench.model.loop import Loop, ultimate
from pmabench.store.records import Array, RunData, TrialData

METHOD = "open-loop"
LONGEST_TRACE = 1500
DAMPING = 0.25
"""Share of the difference between the two directions' K_u and T_u by which their mean may be off."""
ALONE = "one trial: the repeats part is the scatter between its cycles"


@dataclass(frozen=True)
class StepsCell(GainCell[StepsFound]):
    """All trials of steps at one operating point."""

    @property
    def loop(self) -> Loop | None:
        """The loop of the first trial that has one."""
        return next((self.found[i].loop for i in self.good), None)

    @property
    def estimates(self) -> list[Estimate]:
        """K_u and T_u."""
        return [_estimate(self, "K_u", "Pa/m", "gain"), _estimate(self, "T_u", "s", "time")]


def cells(members: Sequence[tuple[RunData, TrialData]]) -> list[StepsCell]:
    """The trials by operating point, each examined."""
    return StepsCell.all_of(members, examine)


def _estimate(cell: StepsCell, symbol: str, unit: str, quantity: str) -> Estimate:
    good = [cell.found[i] for i in cell.good]
    truths = [ultimate(found.loop) for found in good if found.loop is not None]
    if not truths:
        note = "; ".join(dict.fromkeys(reason for found in cell.found for reason in found.refused))
        parents = tuple(trial.name for trial in cell.trials)
        return Estimate(symbol, None, unit, quantity, METHOD, cell.at, note=note, trials=parents)
    name, place = ("gain", 0) if symbol == "K_u" else ("period", 1)
    values = np.array([getattr(truth, name) for truth in truths])
    value = float(values.mean())
    halves = []
    for found in good:
        each = np.array([getattr(cycle, name) for cycle in found.cycles])
        if len(each) > 1:
            halves.append(float(student.ppf(0.975, len(each) - 1)) * float(each.std(ddof=1)) / sqrt(len(each)))
    repeats = float(np.sqrt(np.mean(np.square(halves)) / len(good))) if len(halves) == len(good) else None
    if len(values) > 1:
        between = float(student.ppf(0.975, len(values) - 1)) * float(values.std(ddof=1)) / sqrt(len(values))
        repeats = max(between, repeats or 0.0)
    damping = DAMPING * max(found.spans[place] for found in good)
    bent = max(found.bent for found in good) ** 2 / 2 if symbol == "K_u" else 0.0
    scales = Scales.of(cell.runs)
    pressure = "pressure_command" if "pressure_command" in scales.gains else "pressure"
    scaled = (pressure, "displacement") if symbol == "K_u" else ()
    told = Estimate(
        symbol,
        value,
        unit,
        quantity,
        METHOD,
        cell.at,
        parts=Parts(
            repeats=repeats,
            method=value * sqrt(damping**2 + bent**2),
            calibration=scales.part(dict.fromkeys(scaled, value)),
            skew=_skew(cell, name),
        ),
        n=len(good),
        note=sentences(
            *(doubt for found in good for doubt in found.doubts),
            ALONE if len(good) == 1 else "",
            "the method part is what unlike lags in the two directions and the bend of the steps are worth",
            scales.lack(scaled),
        ),
        trials=tuple(cell.trials[i].name for i in cell.good),
    )
    worst = max((found.sided for found in good), key=lambda one: one.half)
    return weighed(told, [replace(worst, half=worst.half * value)])


def _skew(cell: StepsCell, name: str) -> float:
    """Half width by clocks: pressure and displacement may be so far apart, and the dead time holds all of it."""
    late = skew.apart(cell.runs, ("pressure", "displacement"))
    if late <= 0 or cell.loop is None:
        return 0.0
    later = ultimate(replace(cell.loop, dead_time=cell.loop.dead_time + late))
    return abs(float(getattr(later, name)) - float(getattr(ultimate(cell.loop), name)))


def findings(cell: StepsCell) -> list[Finding]:
    """What speaks against the trials, what the fitted loop is, and what friction leaves of it."""
    where = show(cell.at["setpoint"], "length") if "setpoint" in cell.at else "this operating point"
    said = [("fault", reason) for found in cell.found for reason in found.refused]
    said += [("doubt", doubt) for found in cell.found for doubt in found.doubts]
    lines = [
        Finding(level, f"{said.count((level, text))} of {len(cell.found)} trials of steps at {where}: {text}")
        for level, text in dict.fromkeys(said)
    ]
    known = next((cell.found[i] for i in cell.good), None)
    if known is not None and known.loop is not None and known.moved is not None:
        loop, truth = known.loop, ultimate(known.loop)
        lags = ", ".join(f"{complex(lag).real:.3g} s" for lag in loop.lags)
        up, down = known.moved.tau
        lines.append(
            Finding(
                "note",
                f"at {where} the steps give {loop.gain * 1e6:.4g} mm/kPa, dead time {loop.dead_time * 1e3:.3g} ms "
                f"(half a sample period in it) and lags {lags}, that of the muscle {up:.3g} s contracting and "
                f"{down:.3g} s relaxing: it would oscillate at K_u = {show(truth.gain, 'gain', 4)}, "
                f"T_u = {truth.period:.4g} s",
            )
        )
    return lines


def traces(cell: StepsCell) -> list[Trace]:
    """Command, pressure and displacement of the last cycle of the first trial, and the fitted displacement."""
    index = cell.good[0] if cell.good else 0
    trial, found = cell.trials[index], cell.found[index]
    steps = steps_of(trial)
    if len(steps) < 4:
        return []
    begin = steps[-4].t - 0.2
    t, x, P = samples_of(trial, steps, 1 / cell.runs[index].rate)
    mask = t >= begin
    stride = max(1, -(-int(mask.sum()) // LONGEST_TRACE))
    columns: dict[str, Array] = {"t": t[mask] - begin, "displacement": x[mask]}
    if found.moved is not None:
        columns["model"] = found.moved.fitted(t, P, steps)[mask]
    columns["pressure"] = P[mask] + steps[3].value
    kinds = {"displacement": "length", "model": "length", "t": "time"}
    at = "-".join(f"{value:g}" for value in (cell.at.get("setpoint", 0.0), cell.at.get("load", 0.0)))
    return [
        Trace(
            f"open-loop-{at}",
            "open-loop",
            f"Open-loop steps, set-point {show(cell.at.get('setpoint', 0.0), 'length')}",
            {name: column[::stride] for name, column in columns.items()},
            {name: kinds.get(name, "pressure") for name in columns},
            {"setpoint": cell.at.get("setpoint", 0.0)},
        )
    ]


def facts(cell: StepsCell) -> list[dict[str, Any]]:
    """Every trial as plain data."""
    return [{"trial": trial.name, **found.to_dict()} for trial, found in zip(cell.trials, cell.found, strict=True)]
