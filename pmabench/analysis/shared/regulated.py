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
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

PRESSURE, SENT = "pressure", "pressure_command"
LASTS = 1.0
"""Least time of a constant command [s]."""
REST, SAME = 2e-3, 2e-3
"""Change of pressure and command, as a share of the highest command, that counts as none [1]."""
HIGH = 0.2
"""Share of the highest command below which a zero, or a regulator that does not vent, would count as a scale [1]."""
EMPTY = 0.002
"""Share of the highest command up to which it is 0 [1]."""
REGULATES = 0.01
"""Error of a regulator that is usual, as a share of the highest command [1]."""
AT_ONE = 0.02
"""The same at a single one of several pressures, where a hold may have been too short."""
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
    every, top = _top(run)
    rests = [rest for trial in run.trials for rest in _rests(trial, top, every) if rest[0] > HIGH * top]
    if not rests:
        return None
    levels = grouped(rests, lambda rest: round(rest[0] / top, 2))
    off = {alike[0][0]: float(np.median([P / level for level, P in alike])) - 1 for alike in levels.values()}
    share, where = float(np.median(list(off.values()))), ""
    highest, info = max(level for level, _ in rests), run.channels.get(PRESSURE)
    declared = hypot(info.offset_uncertainty, info.gain_uncertainty * highest) if info else 0.0
    if abs(share) * highest <= declared + REGULATES * top:
        level = max(off, key=lambda one: abs(off[one]) * one)
        share, where = off[level], f" of {show(level, 'pressure')}"
        if abs(share) * level <= declared + AT_ONE * top:
            return None
    elif abs(share) > OTHER:
        text = (
            f"{run.id}: at rest the pressure reads {1 + share:.2g} times its command: the unit of one of them is wrong"
        )
        return Change(PRESSURE, 0.0, 0.0, 0.0, text)
    text = (
        f"{run.id}: at rest the pressure reads {share:+.1%} off its command{where}: the gauge or the regulator is off. "
        "Intervals hold either. Compare the gauge with another one"
    )
    gain, offset = (0.0, -MORE * share * level) if where else (1 / (1 + MORE * share) - 1, 0.0)
    return Change(PRESSURE, gain, offset, 0.0, text, "gauge against command", inf, throughout=True)


def vented(run: RunData) -> Change | None:
    """The change of the pressure's zero that brings the gauge to 0 where 0 is commanded; None where it reads it.

    Of several rests the one nearest to 0 counts: the others may not have come to it.
    """
    every, top = _top(run)
    reads = [P for trial in run.trials for sent, P in _rests(trial, top, every) if abs(sent) <= EMPTY * top]
    if not reads or min(reads) <= 0 <= max(reads):
        return None
    level, info = min(reads, key=abs), run.channels.get(PRESSURE)
    if abs(level) <= max(info.offset_uncertainty if info else 0.0, REST * top):
        return None
    text = (
        f"{run.id}: vented, the gauge reads {show(level, PRESSURE, 2)}: its zero, or a regulator that does not vent. "
        "Intervals hold both. Vent the muscle and take the zero of the gauge"
    )
    return Change(PRESSURE, 0.0, -level, 0.0, text, "zero of the gauge", inf, throughout=True)


def _top(run: RunData) -> tuple[int, float]:
    """One in how many samples is looked at, and the highest command [Pa]; 0 without one."""
    every = max(1, round(run.rate / RATE)) if isfinite(run.rate) else 1
    sent = [t.channels[SENT][::every] for t in run.trials if SENT in t.channels and PRESSURE in t.channels]
    return every, max((float(np.nanmax(one)) for one in sent if np.isfinite(one).any()), default=0.0)


def _rests(trial: TrialData, top: float, every: int) -> Iterator[tuple[float, float]]:
    """Command and mean pressure [Pa] at the end of each constant command, at rest; of one in `every` samples."""
    if trial.status != "finished" or not {PRESSURE, SENT} <= set(trial.channels):
        return
    P, sent = trial.channels[PRESSURE][::every], trial.channels[SENT][::every]
    good = trial.usable[::every] & np.isfinite(P) & np.isfinite(sent)
    t, P, sent = (values if good.all() else values[good] for values in (trial.t[::every], P, sent))
    for begin, end in _constant(t, sent, SAME * top):
        last = begin + int(np.searchsorted(t[begin:end], 0.25 * t[begin] + 0.75 * t[end - 1], side="right"))
        half = (last + end + 1) // 2  # of the last quarter
        if half < end and abs(P[last:half].mean() - P[half:end].mean()) < REST * top:
            yield float(sent[last:end].mean()), float(P[last:end].mean())


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
