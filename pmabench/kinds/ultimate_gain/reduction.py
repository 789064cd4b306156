"""Reduction of ultimate-gain runs: K_u and T_u of each set-point, refused where the loop does not oscillate as a sine.

Trials of steps without a loop are reduced in `open_loop`, those with a relay in `relay_gain`; here are those with
a rising gain, and what all say together.

Per level of gain the mean ln of the ratio of successive swings; a line through the last levels, K_u where it is 0.
Knows the samples and what the search wrote down; not how the bench is built.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis import tuning
from pmabench.analysis.shared import skew, student
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.base.quantities import show
from pmabench.kinds.ultimate_gain import RESULTS, open_loop, relay_gain
from pmabench.kinds.ultimate_gain import ways as gain_ways
from pmabench.kinds.ultimate_gain.levels import TrialFound, examine
from pmabench.kinds.ultimate_gain.open_loop import steps_of
from pmabench.kinds.ultimate_gain.relay_levels import search_of
from pmabench.kinds.ultimate_gain.ways import GainCell
from pmabench.model.loop import Loop
from pmabench.store.analyses.results import Analysis, Dropped, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

KIND = "ultimate-gain"
NO_LEVELS = "no levels of gain are recorded: no column holds them, but run.json of an exported run does"
METHOD = "gain-steps"
CHANNELS = ("pressure", "displacement")
LONGEST_TRACE = 1500
USED = ("finished", "failed")
"""Trials with one of these statuses are looked at; a search that found nothing is a failed trial, and says why."""
ALONE = "one trial: the repeats part is the scatter about its own line, and repeated tests may scatter more"


@dataclass(frozen=True)
class _Cell(GainCell[TrialFound]):
    """All trials at one operating point."""

    @property
    def skew(self) -> float:
        """Bound of the time between pressure and displacement [s]: the loop's dead time holds all of it."""
        return skew.apart(self.runs, CHANNELS)

    @property
    def seen(self) -> Loop | None:
        """The loop behind the first trial that tells one."""
        return next((self.found[i].loop for i in self.good if self.found[i].loop is not None), None)

    @property
    def loop(self) -> Loop | None:
        """The same, where the skew leaves its dead time something."""
        return self.seen if self.seen is not None and self.skew <= skew.WIDE * self.seen.dead_time else None


def name_of(trial: TrialData) -> str:
    """`run/index`, as parents are named."""
    return trial.name


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Ultimate gain K_u [Pa/m] and period T_u [s] of every set-point, and the settings that the tuning rules give.

    ln(ratio) of successive swings is fitted against K_p by a line over the last levels; K_u is its zero, T_u the
    periods' line at the same place (Ziegler and Nichols 1942). The line's bias is found by replay with the loop that
    the levels themselves identify, and taken off.

    `options`: `loop` = {"gain" [m/Pa], "dead_time" [s], "lags" [s, ...]}, a linear model from elsewhere that K_u and
    T_u are held against.
    """
    options = options or {}
    cells, relays, steps, dropped = _cells(runs)
    estimates: list[Estimate] = []
    findings: list[Finding] = []
    traces: list[Trace] = []
    loops: list[dict[str, Any]] = []
    settings: list[dict[str, Any]] = []

    def settle(K_u: Estimate, T_u: Estimate, loop: Loop | None, apart: float) -> None:
        """Settings and the loop of one operating point; the first way there counts."""
        if K_u.value is None or T_u.value is None or any(entry["at"] == dict(K_u.at) for entry in settings):
            return
        if loop is not None:
            lags = [lag.real if not lag.imag else [lag.real, lag.imag] for lag in map(complex, loop.lags)]
            fact = {"gain": loop.gain, "dead_time": loop.dead_time, "lags": lags, "skew": apart}
            loops.append({"at": dict(K_u.at), **fact})
        settings.extend(tuning.facts(tuning.tune(K_u, T_u, loop=loop), K_u.at))
        if "loop" in options:
            given = options["loop"]
            model = Loop(float(given["gain"]), float(given["dead_time"]), tuple(float(lag) for lag in given["lags"]))
            findings.append(tuning.plausibility(T_u.value, model, K_u.value))

    for found in [*map(_of_steps, steps), *map(_of_levels, cells), *map(_of_relay, relays)]:
        estimates += found.estimates
        findings += found.findings
        traces += found.traces
        dropped += found.dropped
        settle(found.estimates[0], found.estimates[1], found.loop, found.apart)
    findings += gain_ways.findings(estimates, loops)
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates,
        dropped=dropped,
        findings=findings,
        traces=traces,
        facts={
            "options": dict(options),
            "trials": sum(map(len, [c.good for c in cells] + [c.good for c in relays] + [c.good for c in steps])),
            "cells": len(cells) + len(relays) + len(steps),
            "loops": loops,
            "tuning": settings,
            "levels": [level for cell in cells for level in _level_facts(cell)],
            "relay": [level for relay in relays for level in relay_gain.facts(relay)],
            "open_loop": [trial for stepped in steps for trial in open_loop.facts(stepped)],
        },
    )


@dataclass(frozen=True)
class _Found:
    """What one way says of one operating point; the first two estimates are K_u and T_u."""

    estimates: Sequence[Estimate]
    findings: Sequence[Finding]
    traces: Sequence[Trace]
    dropped: Sequence[Dropped]
    loop: Loop | None
    apart: float
    """Time that the clocks of the channels may be apart [s]."""


def _of_steps(cell: open_loop.StepsCell) -> _Found:
    apart = skew.apart(cell.runs, CHANNELS)
    return _Found(cell.estimates, open_loop.findings(cell), open_loop.traces(cell), cell.dropped, cell.loop, apart)


def _of_levels(cell: _Cell) -> _Found:
    K_u, T_u = _estimates(cell)
    return _Found((K_u, T_u), _findings(cell, K_u, T_u), _traces(cell, K_u), cell.dropped, cell.loop, cell.skew)


def _level_facts(cell: _Cell) -> list[dict[str, Any]]:
    trials = zip(cell.trials, cell.found, strict=True)
    return [{"trial": name_of(trial), **level.to_dict()} for trial, found in trials for level in found.levels]


def _of_relay(cell: relay_gain.RelayCell) -> _Found:
    apart = skew.apart(cell.runs, CHANNELS)
    return _Found(cell.estimates, relay_gain.findings(cell), relay_gain.traces(cell), cell.dropped, cell.loop, apart)


def _cells(
    runs: Sequence[RunData],
) -> tuple[list[_Cell], list[relay_gain.RelayCell], list[open_loop.StepsCell], list[Dropped]]:
    dropped: list[Dropped] = []
    stepped: list[tuple[RunData, TrialData]] = []
    relays: list[tuple[RunData, TrialData]] = []
    rising: list[tuple[RunData, TrialData]] = []
    for run in runs:
        for trial in run.trials:
            if trial.status not in USED:
                dropped.append(Dropped(name_of(trial), trial.point, f"the trial is {trial.status}"))
            elif _search(trial) is None and search_of(trial) is None and not steps_of(trial):
                dropped.append(Dropped(name_of(trial), trial.point, NO_LEVELS))
            elif "displacement" not in trial.channels:
                dropped.append(Dropped(name_of(trial), trial.point, "the displacement is not recorded"))
            elif steps_of(trial) and "pressure" not in trial.channels:
                dropped.append(Dropped(name_of(trial), trial.point, "the pressure is not recorded"))
            elif steps_of(trial):
                stepped.append((run, trial))
            elif search_of(trial) is not None:
                relays.append((run, trial))
            else:
                rising.append((run, trial))
    cells = _Cell.all_of(rising, lambda run, trial: examine(run, trial, _search(trial) or {}))
    return cells, relay_gain.cells(relays), open_loop.cells(stepped), dropped


def _search(trial: TrialData) -> Mapping[str, Any] | None:
    """What the search wrote down."""
    return next((found for found in trial.found.values() if found.get("levels")), None)


def _estimates(cell: _Cell) -> tuple[Estimate, Estimate]:
    """K_u and T_u of one set-point: the mean of its trials, with intervals in parts."""
    good = [cell.found[i] for i in cell.good]
    parents = tuple(name_of(cell.trials[i]) for i in cell.good)
    if not good:
        note = "; ".join(dict.fromkeys(reason for found in cell.found for reason in found.refused))
        everyone = tuple(name_of(trial) for trial in cell.trials)
        return (
            Estimate("K_u", None, "Pa/m", "gain", METHOD, cell.at, note=note, trials=everyone),
            Estimate("T_u", None, "s", "time", METHOD, cell.at, note=note, trials=everyone),
        )
    doubts = "; ".join(dict.fromkeys(doubt for found in good for doubt in found.doubts))
    scales = Scales.of(cell.runs)
    pressure = _pressure(scales)

    def estimate(symbol: str, unit: str, quantity: str, scaled: tuple[str, ...]) -> Estimate:
        values = np.array([getattr(found, symbol) for found in good])
        within = np.array([getattr(found, f"half_{symbol}") for found in good])
        replayed = [getattr(found, f"bias_{symbol}") for found in good]
        known = [bias for bias in replayed if bias is not None]
        value = float(values.mean())
        repeats = sqrt(float(np.mean(within**2)) / len(good))
        if len(good) > 1:
            between = float(student.ppf(0.975, len(good) - 1)) * float(values.std(ddof=1)) / sqrt(len(good))
            repeats = max(repeats, between)
        friction = max(found.friction for found in good) * value if symbol == "K_u" else 0.0
        bias = float(np.mean(known)) if known else None
        return Estimate(
            symbol=symbol,
            value=value,
            unit=unit,
            quantity=quantity,
            method=METHOD,
            at=cell.at,
            parts=Parts(
                repeats=repeats,
                method=None if bias is None else sqrt(bias**2 + friction**2),
                calibration=scales.part(dict.fromkeys(scaled, value)),
            ),
            n=len(good),
            bias=bias,
            corrected=bias is not None,
            note=sentences(
                doubts,
                ALONE if len(good) == 1 else "",
                "" if bias is not None else "no method part: the loop behind it could not be identified and replayed",
                scales.lack(scaled),
            ),
            trials=parents,
        )

    return estimate("K_u", "Pa/m", "gain", (pressure, "displacement")), estimate("T_u", "s", "time", ())


def _pressure(scales: Scales) -> str:
    """The channel that tells the scale of the commanded pressure: its own, else that of the measured pressure."""
    return "pressure_command" if "pressure_command" in scales.gains else "pressure"


def _findings(cell: _Cell, K_u: Estimate, T_u: Estimate) -> list[Finding]:
    where = show(cell.at["setpoint"], "length") if "setpoint" in cell.at else "this operating point"
    lines = []
    said = [("fault", reason) for found in cell.found for reason in found.refused]
    said += [("doubt", doubt) for found in cell.found for doubt in found.doubts]
    for level, text in dict.fromkeys(said):
        lines.append(Finding(level, f"{said.count((level, text))} of {len(cell.found)} trials at {where}: {text}"))
    if K_u.value is not None and T_u.value is not None:
        loop = cell.loop
        text = f"at {where} the loop oscillates at K_u = {show(K_u.value, 'gain', 4)}, T_u = {T_u.value:.4g} s"
        if loop is not None:
            apart = f" +- {skew.milliseconds(cell.skew)} (clocks)" if cell.skew else ""
            lags = " and ".join(f"{complex(lag).real:.3g} s" for lag in loop.lags)
            text += (
                f"; seen from there the plant has {loop.gain * 1e6:.4g} mm/kPa,"
                f" dead time {loop.dead_time * 1e3:.3g} ms{apart} and lags {lags}"
            )
        elif cell.seen is not None:
            between = skew.milliseconds(cell.skew)
            text += f"; the plant is not reported: pressure and displacement may be {between} apart, its dead time is "
            text += skew.milliseconds(cell.seen.dead_time)
        lines.append(Finding("note", text))
    return lines


def _traces(cell: _Cell, K_u: Estimate) -> list[Trace]:
    """The oscillation nearest to K_u, and the growth plot, of the first trial with a value (else the first)."""
    index = cell.good[0] if cell.good else 0
    trial, found = cell.trials[index], cell.found[index]
    if not found.levels:
        return []
    name = "-".join(f"{value:g}" for value in (cell.at.get("setpoint", 0.0), cell.at.get("load", 0.0)))
    where = show(cell.at.get("setpoint", 0.0), "length")
    at = next((i for i, level in enumerate(found.levels) if level is found.nearest), len(found.levels) - 1)
    shown = found.levels[max(0, at - 1) : at + 2]
    mask = (trial.t >= shown[0].t0) & (trial.t <= shown[-1].t1)
    if not mask.any():
        return []
    columns: dict[str, Array] = {
        "t": trial.t[mask] - trial.t[mask][0],
        "displacement": trial.channels["displacement"][mask],
    }
    quantities = {"t": "time", "displacement": "length", "pressure_command": "pressure"}
    columns["pressure_command"] = _command(trial, found, mask)
    stride = -(-int(mask.sum()) // LONGEST_TRACE)
    marks = {} if K_u.value is None else {"K_u": K_u.value}
    measured = [level for level in found.levels if level.swinging is not None]
    traces = [
        Trace(
            f"oscillation-{name}",
            "oscillation",
            f"Oscillation nearest to the ultimate gain, set-point {where}",
            {key: column[::stride] for key, column in columns.items()},
            quantities,
            {"setpoint": cell.at.get("setpoint", 0.0), **marks},
        )
    ]
    if measured:
        gains = np.array([level.gain for level in measured])
        slope, start = found.line
        traces.append(
            Trace(
                f"growth-{name}",
                "growth",
                f"Growth per half period, set-point {where}",
                {
                    "gain": gains,
                    "log_ratio": np.array([level.log_ratio for level in measured]),
                    "fit": start + slope * gains,
                    "period": np.array([level.period for level in measured]),
                    "used": np.array([float(level in found.used) for level in measured]),
                },
                {"gain": "gain", "log_ratio": "count", "fit": "count", "period": "time", "used": "count"},
                marks,
            )
        )
    return traces


def _command(trial: TrialData, found: TrialFound, mask: NDArray[np.bool_]) -> Array:
    """The command [Pa], as recorded, else worked out from the law u = bias + K_p (aim - x) of each level."""
    if "pressure_command" in trial.channels:
        return np.asarray(trial.channels["pressure_command"][mask])
    t, x = trial.t[mask], trial.channels["displacement"][mask]
    command = np.full(len(t), np.nan)
    for level in found.levels:
        at = (t >= level.t0) & (t <= level.t1)
        command[at] = found.bias + level.gain * (level.aim - x[at])
    return command


def of_open_loops(runs: Sequence[RunData]) -> Analysis:
    """What steps without a loop give alone; what other trials of the runs say is in the findings."""
    reduced = reduce(runs)
    return replace(reduced, estimates=tuple(e for e in reduced.estimates if e.method == open_loop.METHOD))
