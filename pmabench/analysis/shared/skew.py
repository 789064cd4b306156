"""Effect of streams with separate clocks on a result: bounds of the time between their channels.

A stream's clock is known within +-u over the whole run (95 %, `ClockInfo.uncertainty`) by a straight line over time.
Its remaining error is a straight line too, between two extremes: constant u, and from -u to u.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from pmabench.analysis.shared.calibration import listed, sentences
from pmabench.analysis.shared.samples import lag_open
from pmabench.store.analyses.results import Estimate, Finding, without_value
from pmabench.store.records import Array, RunData, TrialData

WIDE = 0.25
"""Share of a coefficient above which its skew part withholds it, where that also exceeds all other parts."""
REFUSED = "not identifiable in time"
EQUAL, ARRIVALS, STAMPED = "stated equal", "host arrivals", "stamped by the computer"
"""`ClockInfo.how`."""
NO_JITTER = 1e-6
"""Scatter below which arrivals are taken to be the device's own time stamps [s]."""


def apart(runs: Iterable[RunData], channels: Sequence[str]) -> float:
    """Bound of the time between any two of the channels [s], the largest of all runs; 0 within one stream."""
    known = [(run, [name for name in channels if name in run.channels]) for run in runs]
    return round(max((run.skew(*pair) for run, names in known for pair in combinations(names, 2)), default=0.0), 9)


def off(runs: Iterable[RunData], channel: str) -> float:
    """Bound of the time between a channel and the commands [s], the largest of all runs.

    It includes the time that a device took to answer to a command.
    """
    bounds = [0.0]
    for run in (one for one in runs if channel in one.channels):
        clock = run.clocks.get(run.channels[channel].stream)
        taken = (command.data.get("late", 0.0) for trial in run.trials for command in trial.commands)
        bounds.append(max(taken, default=0.0) + (clock.uncertainty if clock is not None else 0.0))
    return round(max(bounds), 9)


def late(run: RunData, channel: str) -> float:
    """Uncertainty of the time between a channel and the commands [s], from the lag of its sensor and its clock."""
    return lag_open(run, channel) + off([run], channel)


def causes(runs: Iterable[RunData], channels: Sequence[str]) -> dict[tuple[str, ...], float]:
    """Channels that share a clock -> bound of its error [s]; empty where all channels share one in every run."""
    found: dict[tuple[str, ...], float] = {}
    for run in runs:
        names = [name for name in channels if name in run.channels]
        streams = {run.channels[name].stream for name in names}
        for stream in streams if len(streams) > 1 else ():
            group = tuple(name for name in names if run.channels[name].stream == stream)
            found[group] = max(found.get(group, 0.0), run.clocks[stream].uncertainty)
    return {group: bound for group, bound in found.items() if bound >= 1e-9}


def courses(trials: Sequence[TrialData]) -> Array:
    """Both extreme courses of a clock's error over its bound at each trial, shape (2, trials)."""
    place = np.zeros(len(trials))
    for run in {trial.run for trial in trials}:
        mine = np.array([trial.run == run for trial in trials])
        begins = np.array([trial.t[0] for trial in trials])[mine]
        place[mine] = 2.0 * (begins - begins.min()) / max(float(np.ptp(begins)), 1e-9) - 1.0
    return np.array([np.ones(len(trials)), place])


def milliseconds(skew: float) -> str:
    """A time [s] as text in ms."""
    return f"{1e3 * skew:.3g} ms"


def settled(estimate: Estimate, between: str, skew: float) -> Estimate:
    """The estimate, without a value where its skew part is too large.

    `between` names the channels, `skew` is the bound of the time between them [s].
    """
    part, value = estimate.parts.skew, estimate.value
    if value is None or part <= WIDE * abs(value):
        return estimate
    rest = replace(estimate.parts, skew=0.0, repeats=estimate.parts.repeats or 0.0).combined or 0.0
    if part <= rest:
        return estimate
    worth = f"worth {part / abs(value):.0%} of it" if value else "worth more than it"
    why = f"{REFUSED}: {between} may be {milliseconds(skew)} apart, {worth}"
    return without_value(estimate, sentences(why, estimate.note))


def findings(
    runs: Sequence[RunData], channels: Sequence[str], skew: float, estimates: Iterable[Estimate]
) -> list[Finding]:
    """Findings about values withheld for the `skew` between channels [s], and about clocks without a bound."""
    said = []
    none = [e.symbol for e in estimates if e.value is None and e.note.startswith(REFUSED)]
    if none:
        text = f"{listed(list(dict.fromkeys(none)))} withheld: {listed(channels)} may be {milliseconds(skew)} apart"
        text += " in time; record them with one device, or with clocks that are known better"
        said.append(Finding("doubt", text))
    loose: set[str] = set()
    for run in runs:
        for pair in combinations([name for name in channels if name in run.channels], 2):
            clocks = {run.channels[name].stream: run.clocks.get(run.channels[name].stream) for name in pair}
            # only said to be that of the run, or its stamps are the arrivals themselves
            unbounded = [c is None or c.how == EQUAL or (c.how == ARRIVALS and c.uncertainty < NO_JITTER)
                         for c in clocks.values()]  # fmt: skip
            loose |= {*pair} if len(clocks) > 1 and any(unbounded) else set()
    if loose:
        names = listed(sorted(loose))
        text = f"{names} come from different devices, and nothing bounds the time between them: clocks are stated equal"
        said.append(Finding("doubt", f"{text}, or samples are stamped as they come in, however long they took"))
    return said
