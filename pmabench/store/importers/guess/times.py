"""Which column is the time, in which unit, and whether it counts from a day.

Pure functions of names and arrays.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.store.importers.guess.names import WORDS, value_of, words
from pmabench.store.importers.guess.proposal import Proposal
from pmabench.store.records import Array

SAMPLES = {"sample", "samples", "index", "idx", "n", "no", "nr", "number", "scan", "row", "record", "count", "x"}
"""Words of a column that counts the samples."""
COUNTS = (
    ("serial days", "d", 36_526.0, 54_789.0),
    ("matlab days", "d", 730_486.0, 748_749.0),
    ("epoch", "s", 0.94e9, 2.53e9),
    ("labview", "s", 3.03e9, 4.61e9),
    ("epoch", "ms", 0.94e12, 2.53e12),
    ("epoch", "us", 0.94e15, 2.53e15),
    ("epoch", "ns", 0.94e18, 2.53e18),
)
"""How written, unit, and the numbers of the years 2000 to 2050."""
LONGEST_STEP = {"d": 5e-5, "s": 10.0, "ms": 1e4, "us": 1e7, "ns": 1e10}
"""Median step of a recording that counts so, in that unit; days in longer steps may be seconds."""
UNLIKE_TIME = "is named or measured like a time"
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0}
"""In one unit of a time."""
USUAL = ("s", "ms", "us")
"""Units in which recorded times usually are."""
FASTEST, SLOWEST = 2e4, 2.0
"""Usual samples a second."""
SHORTEST = 2.0
"""A test of a muscle lasts at least so long [s]."""
BRIEF, RARE = 0.5, 0.5
"""A file that lasts less than this [s], or has fewer samples a second, is doubted: a muscle takes 0.1 s to fill."""


def usual_step(values: Array) -> float:
    """Median of the steps upward; 0 where there is none."""
    steps = np.diff(values)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


def counted(values: Array) -> tuple[str, str] | None:
    """How a column of numbers counts from a day, and in which unit; None where it is a plain number.

    An empty first text: it may be days or a plain number.
    """
    if len(values) < 2 or not np.isfinite(values).all():
        return None
    step = usual_step(values)
    for kind, unit, low, high in COUNTS:
        if low <= float(values.min()) and float(values.max()) <= high and 0 < step:
            if step <= LONGEST_STEP[unit]:
                return kind, unit
            if unit == "d" and step <= 1e-2:
                return "", unit
    return None


def choose(proposals: Sequence[Proposal]) -> None:
    """The column that rises: a named one where it does, else any."""

    def rises(values: Array) -> bool:
        if len(values) < 2 or not np.isfinite(values).all() or np.ptp(values) == 0:
            return False
        return float(np.mean(np.diff(values) >= 0)) > 0.99

    named = [p for p in proposals if p.role == "time"]
    good = [p for p in named if rises(p.values)]
    for proposal in named:
        if proposal not in good:
            proposal.role = "ignore"
            proposal.doubts.append(f"{UNLIKE_TIME}, but does not rise")
    if not good:
        good = [
            p for p in proposals if p.role == "ignore" and p.unit == "" and rises(p.values) and len(set(p.values)) > 9
        ]
        if good:
            good = good[:1]
            good[0].role = "time"
            good[0].reasons.append("the only column that rises from the first row to the last")
    good.sort(key=lambda p: float(np.mean(np.diff(p.values) == 0)) > 0.5)  # one that is too coarse comes last
    for proposal in good[1:]:
        proposal.role = "ignore"
        proposal.reasons.append(f'a second time; "{good[0].name[:40]}" is taken')
    if good and good[0].written == "number" and (count := counted(good[0].values)) is not None:
        good[0].written, good[0].unit = count
        good[0].reasons.append(f"its numbers are those of {good[0].written or 'serial days'} of our years")
    elif good and not good[0].unit and bool(np.all(np.diff(good[0].values) == 1.0)) and words(good[0].name) & SAMPLES:
        good[0].written = "index"
        good[0].reasons.append("rises by exactly 1 from row to row: it counts the samples")
    elif good and good[0].factor and good[0].unit in SECONDS and good[0].written == "number":
        good[0].written, good[0].period = "index", value_of(good[0].factor) * SECONDS[good[0].unit]
    elif good and not good[0].unit:
        _time_unit(good[0])
    elif good and good[0].unit in USUAL and good[0].written == "number":
        _said_time(good[0])


def _in_each_unit(time: Proposal) -> dict[str, tuple[float, float, str]]:
    """Unit that a time may have -> samples a second, how long the file lasts [s], and both in words."""
    step, many = usual_step(time.values), len(time.values)
    found = {unit: (1.0 / (step * SECONDS[unit]), step * many * SECONDS[unit]) for unit in USUAL}
    return {unit: (rate, lasts, f"{rate:.4g} samples a second, {lasts:.4g} s") for unit, (rate, lasts) in found.items()}


def _usual_units(time: Proposal, slowest: float) -> list[str]:
    """The units in which a time is that of a usual test, of so many samples a second at least, in words."""
    each = _in_each_unit(time).items()
    return [f"{unit}: {text}" for unit, (rate, lasts, text) in each if FASTEST >= rate >= slowest and lasts >= SHORTEST]


def _time_unit(time: Proposal) -> None:
    step = usual_step(time.values)
    for unit, (rate, _, _) in _in_each_unit(time).items():
        if FASTEST >= rate >= SLOWEST:
            time.unit = unit
            time.reasons.append(f"steps of {step:.4g}: in {unit} these are {rate:.4g} samples a second")
            _which_time(time)
            return
    time.unit = "s"
    time.doubts.append(f"steps of {step:.4g}: the unit of time is not given; s is taken")
    time.question = f'in which unit is "{time.name[:40]}"? Its steps of {step:.4g} are no usual sampling in s, ms or us'


def _said_time(time: Proposal) -> None:
    """Ask for the unit of a time where the given one makes the file an impossible test, another one a usual one."""
    rate, lasts, text = _in_each_unit(time)[time.unit]
    usual = _usual_units(time, 10 * SLOWEST)
    if usual and (lasts < BRIEF or rate < RARE):
        head = f'"{time.name[:40]}" is in {time.unit} by its name: {text} in all'
        time.question = f"{head}, which no test of a muscle has: which unit is it? {'; '.join(usual)}"


def _which_time(time: Proposal) -> None:
    """Ask for the unit of a time without one, where several are possible or its heading may mean another one."""
    possible = _usual_units(time, SLOWEST)
    text = "; ".join(possible)
    if bool(np.all(np.diff(time.values) == 1.0)):
        head = f'"{time.name[:40]}" rises by exactly 1: is it a time, or does it count the samples'
        time.question = f"{head} (then write {{is: time, written: index, period: 2 ms}} with their distance)? {text}"
    elif len(possible) > 1 or time.factor or time.strange or not (time.bare or words(time.name) & WORDS["time"]):
        head = f'in which unit is "{time.name[:40]}"? {text}{"; " if possible else ""}'
        time.question = f"{head}for any other write {{is: time, written: index, period: 0.1 ms}} with its length"
