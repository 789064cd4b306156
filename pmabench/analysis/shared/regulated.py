"""Whether the measured pressure is at its command at rest: a regulator and a gauge that disagree.

The record does not say which of the two is off. Values over the measured pressure are right with a correct gauge,
whatever the regulator does; so both are held in their intervals, and nothing is withheld.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot, inf, isfinite

import numpy as np

from pmabench.analysis.shared.changes import Change
from pmabench.analysis.shared.trials import grouped
from pmabench.store.records import Array, RunData, TrialData

PRESSURE, SENT = "pressure", "pressure_command"
LASTS = 1.0
"""Least time of a constant command [s]."""
REST, SAME = 2e-3, 2e-3
"""Change of pressure and command, as a share of the highest command, that counts as none [1]."""
HIGH = 0.2
"""Share of the highest command below which a zero, or a regulator that does not vent, would count as a scale [1]."""
REGULATES = 0.01
"""Error of a regulator that is usual, as a share of the highest command [1]."""
MORE = 1.2
"""Factor on the difference: at the end of a curve a value changes by less than elsewhere, and its error does not."""
OTHER = 0.3
"""Difference from which on gauge and command are in other units [1]."""
RATE = 40.0
"""Samples a second that are looked at."""
WINDOW = 0.5
"""Length of the parts of a trial that are looked at as a whole [s]."""


def regulated(run: RunData) -> Change | None:
    """The change of the pressure's scale that brings the gauge to its command at rest; None where they agree.

    They agree within what is declared for the gauge and the usual error of a regulator.
    """
    every = max(1, round(run.rate / RATE)) if isfinite(run.rate) else 1
    sent = [t.channels[SENT][::every] for t in run.trials if SENT in t.channels and PRESSURE in t.channels]
    top = max((float(np.nanmax(one)) for one in sent if np.isfinite(one).any()), default=0.0)
    rests = [rest for trial in run.trials for rest in _rests(trial, top, every)]
    if not rests:
        return None
    levels = grouped(rests, lambda rest: round(rest[0] / top, 2))
    share = float(np.median([np.median([P / level for level, P in alike]) for alike in levels.values()])) - 1
    highest, info = max(level for level, _ in rests), run.channels.get(PRESSURE)
    declared = hypot(info.offset_uncertainty, info.gain_uncertainty * highest) if info else 0.0
    if abs(share) * highest <= declared + REGULATES * top:
        return None
    if abs(share) > OTHER:
        text = (
            f"{run.id}: at rest the pressure reads {1 + share:.2g} times its command: the unit of one of them is wrong"
        )
        return Change(PRESSURE, 0.0, 0.0, 0.0, text)
    text = (
        f"{run.id}: at rest the pressure reads {share:+.1%} off its command: the gauge or the regulator is off. "
        "Intervals hold either. Compare the gauge with another one"
    )
    return Change(PRESSURE, 1 / (1 + MORE * share) - 1, 0.0, 0.0, text, "gauge against command", inf, throughout=True)


def _rests(trial: TrialData, top: float, every: int) -> Iterator[tuple[float, float]]:
    """Command and mean pressure [Pa] at the end of each constant command, at rest; of one in `every` samples."""
    if trial.status != "finished" or not {PRESSURE, SENT} <= set(trial.channels):
        return
    P, sent = trial.channels[PRESSURE][::every], trial.channels[SENT][::every]
    good = trial.usable[::every] & np.isfinite(P) & np.isfinite(sent)
    t, P, sent = trial.t[::every][good], P[good], sent[good]
    for begin, end in _constant(t, sent, SAME * top):
        quarter = (t[begin:end] > 0.25 * t[begin] + 0.75 * t[end - 1]).nonzero()[0] + begin
        before, after = np.array_split(quarter, 2)
        if sent[begin] > HIGH * top and len(after) and abs(P[before].mean() - P[after].mean()) < REST * top:
            yield float(sent[quarter].mean()), float(P[quarter].mean())


def _constant(t: Array, sent: Array, same: float) -> Iterator[tuple[int, int]]:
    """First sample, and one past the last, of each stretch of `LASTS` and more with a command within `same` [Pa]."""
    if len(t) < 2 or not LASTS <= t[-1] - t[0] < WINDOW * len(t) or np.any(np.diff(t) < 0):
        return  # too short, fewer samples than windows, or times that go back
    starts = np.unique(np.searchsorted(t, np.arange(t[0], t[-1], WINDOW)))
    low, high = np.minimum.reduceat(sent, starts).tolist(), np.maximum.reduceat(sent, starts).tolist()
    ends = [*starts[1:].tolist(), len(t)]
    first, least, most = 0, inf, -inf
    for n, end in enumerate(ends):
        if max(most, high[n]) - min(least, low[n]) > same:
            if n > first and t[ends[n - 1] - 1] - t[starts[first]] >= LASTS:
                yield int(starts[first]), ends[n - 1]
            first, least, most = n, inf, -inf
        least, most = min(least, low[n]), max(most, high[n])
        if end == len(t) and most - least <= same and t[-1] - t[starts[first]] >= LASTS:
            yield int(starts[first]), end
