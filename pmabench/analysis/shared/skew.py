"""Effect of streams with separate clocks on a result: how far their channels may be apart in time; knows no test.

A stream's clock is known within +-u over the whole run (95 %, `ClockInfo.uncertainty`), by a straight line of time. So
what is left of its error is a straight line, too, and lies between two: u all the time, and from -u to u.
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
"""A coefficient is withheld where the skew alone is worth more than this share of it, and more than all else."""
REFUSED = "not identifiable in time"
EQUAL, ARRIVALS, STAMPED = "stated equal", "host arrivals", "stamped by the computer"
"""`ClockInfo.how`."""
NO_JITTER = 1e-6
"""Arrivals that scatter less than this about a device's own stamps [s] are those stamps."""


def apart(runs: Iterable[RunData], channels: Sequence[str]) -> float:
    """Bound of the time between any two of the channels [s], the largest of several runs; 0 in one stream."""
    known = [(run, [name for name in channels if name in run.channels]) for run in runs]
    return round(max((run.skew(*pair) for run, names in known for pair in combinations(names, 2)), default=0.0), 9)


def off(runs: Iterable[RunData], channel: str) -> float:
    """Bound of the time between a channel and the commands, which have the time of the run [s].

    A device that takes its time to answer had a command at some time before that.
    """
    bounds = [0.0]
    for run in (one for one in runs if channel in one.channels):
        clock = run.clocks.get(run.channels[channel].stream)
        taken = (command.data.get("late", 0.0) for trial in run.trials for command in trial.commands)
        bounds.append(max(taken, default=0.0) + (clock.uncertainty if clock is not None else 0.0))
    return round(max(bounds), 9)


def late(run: RunData, channel: str) -> float:
    """What is open of the time between a channel and the commands [s]: the filter of its sensor, and its clock."""
    return lag_open(run, channel) + off([run], channel)


def causes(runs: Iterable[RunData], channels: Sequence[str]) -> dict[tuple[str, ...], float]:
    """Channels that share a clock -> how far that may be off [s]; empty where all channels share one in every run."""
    found: dict[tuple[str, ...], float] = {}
    for run in runs:
        names = [name for name in channels if name in run.channels]
        streams = {run.channels[name].stream for name in names}
        for stream in streams if len(streams) > 1 else ():
            group = tuple(name for name in names if run.channels[name].stream == stream)
            found[group] = max(found.get(group, 0.0), run.clocks[stream].uncertainty)
    return {group: bound for group, bound in found.items() if bound >= 1e-9}


def courses(trials: Sequence[TrialData]) -> Array:
    """Both extreme courses of a clock's error over its bound, at each trial; shape (2, trials)."""
    place = np.zeros(len(trials))
    for run in {trial.run for trial in trials}:
        mine = np.array([trial.run == run for trial in trials])
        begins = np.array([trial.t[0] for trial in trials])[mine]
        place[mine] = 2.0 * (begins - begins.min()) / max(float(np.ptp(begins)), 1e-9) - 1.0
    return np.array([np.ones(len(trials)), place])


def milliseconds(skew: float) -> str:
    """A time [s] in ms, for people."""
    return f"{1e3 * skew:.3g} ms"


def settled(estimate: Estimate, between: str, skew: float) -> Estimate:
    """The estimate, or the same without a value where its skew part does not allow one.

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
    """What has no value for the `skew` between the channels [s], and where nothing bounds it."""
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
