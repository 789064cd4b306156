"""One trial of a slow test as rows of pressure, contraction and force at an even, low rate.

A kind of test names the function that makes them in its record, by how the length is set. Each takes run, trial and
rate [Hz], and gives a `Record` or a sentence that says why the trial has no rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.imported import unusable_because
from pmabench.analysis.shared.samples import on_time
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

RATE = 25.0
"""Rows a second [Hz]: stops and creep are computed at this rate, and slow tests have nothing faster."""
FEW = 4
"""Samples of a row from which its speed is the slope of a line through them; with fewer, of the rows around it."""


@dataclass(frozen=True, eq=False)
class Record:
    """Rows of one trial in the order of time; arrays of shape (n,), SI."""

    name: str
    group: str
    """What it shares with others that are left out together: `isobaric-ramp, pressure 300 kPa`."""
    t: Array
    P: Array
    x: Array
    F: Array
    v: Array
    """Speed of contraction [m/s]."""
    used: NDArray[np.bool_]
    """Rows that count; the others, where the muscle is slack, only pass on what it remembers."""
    by_hand: bool = False
    """The length was set by hand, so that the force of the whole trial is off by a constant."""
    goes_on: bool = False
    """Follows the record before it on the same muscle: what the muscle remembers then goes on."""


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of several records, one after the other; shape (n,), SI."""

    P: Array
    x: Array
    v: Array
    F: Array
    used: NDArray[np.bool_]
    of: NDArray[np.int64]
    """Which record each row is of."""

    @classmethod
    def of_records(cls, records: Sequence[Record]) -> Rows:
        """All rows of records in their order."""
        P, x, v, F = (np.concatenate([getattr(r, name) for r in records]) for name in ("P", "x", "v", "F"))
        used = np.concatenate([r.used for r in records])
        return cls(P, x, v, F, used, np.repeat(np.arange(len(records)), [len(r.t) for r in records]))


def rows_of(
    t: Array, P: Array, x: Array, F: Array, usable: NDArray[np.bool_], rate: float = RATE
) -> tuple[Array, Array, Array, Array, Array]:
    """Time, pressure, contraction, force and speed at `rate` [Hz], means over the samples of each row, shape (n,), SI.

    Of samples of shape (m,), of which only `usable` ones with finite values count; a row without one is left out.
    """
    good = usable & np.isfinite(t) & np.isfinite(P) & np.isfinite(x) & np.isfinite(F)
    t, P, x, F = t[good], P[good], x[good], F[good]
    if not len(t):
        return t, P, x, F, t
    row = np.floor((t - t[0]) * rate + 1e-6).astype(np.int64)
    _, starts, count = np.unique(row, return_index=True, return_counts=True)

    def mean(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, starts) / count)

    at = mean(t)
    places = mean(x)
    off = t - np.repeat(at, count)
    power = np.add.reduceat(off * off, starts)
    line = np.add.reduceat(off * x, starts) / np.maximum(power, 1e-300)
    around = np.gradient(places, at) if len(at) > 1 else np.zeros(len(at))
    return at, mean(P), places, mean(F), np.where(count >= FEW, line, around)


FEWEST = 25
"""Rows of a trial."""
CONSTANT = 0.03
"""Change, as a share of the value, below which a pressure counts as held."""
HELD = 0.5e-3
"""Change below which a contraction counts as held [m]."""
GRAVITY = 9.80665


def driven(run: RunData, trial: TrialData, rate: float) -> Record | str:
    """Rows of a trial whose free end is moved or held by an actuator, with a load cell and a gauge of the length."""
    if lacks := _lacking(trial, "pressure", "displacement", "force"):
        return lacks
    return _record(run, trial, rate, on_time(run, trial, "displacement"), on_time(run, trial, "force"))


def _lacking(trial: TrialData, *channels: str) -> str:
    lacks = " and ".join(name for name in channels if name not in trial.channels)
    return lacks and f"{lacks} was not recorded"


def by_hand(run: RunData, trial: TrialData, rate: float) -> Record | str:
    """Rows of a trial at a length that somebody set: the one of its operating point, where no gauge was recorded."""
    if lacks := _lacking(trial, "pressure", "force"):
        return lacks
    if "displacement" in trial.channels:
        return driven(run, trial, rate)
    if "contraction" not in trial.point:
        return "neither the contraction nor the length that was set is known"
    x = np.full(trial.t.shape, trial.point["contraction"])
    return _record(run, trial, rate, x, on_time(run, trial, "force"), by_hand=True)


def hanging(run: RunData, trial: TrialData, rate: float) -> Record | str:
    """Rows of a trial with a weight on the muscle: the force of the cell, else load and inertia of what hangs there."""
    if "force" in trial.channels:
        return driven(run, trial, rate)
    if lacks := _lacking(trial, "pressure", "displacement"):
        return lacks
    if "load" not in trial.point:
        return "neither the force nor the load is known"
    load = trial.point["load"]
    found = _record(run, trial, rate, on_time(run, trial, "displacement"), np.full(trial.t.shape, load))
    if isinstance(found, Record):
        found.F[:] += trial.point.get("mass", load / GRAVITY) * np.gradient(found.v, found.t)
    return found


def _record(run: RunData, trial: TrialData, rate: float, x: Array, F: Array, *, by_hand: bool = False) -> Record | str:
    P = on_time(run, trial, "pressure")
    rows = rows_of(trial.t, P, x, F, trial.usable, rate)
    if len(rows[0]) < FEWEST:
        return f"fewer than {FEWEST} rows of {1 / rate:.2g} s can be used (flagged: {unusable_because(trial)})"
    group = trial.name if by_hand else f"{run.kind}, {_held(trial, rows[1], rows[2])}"
    return Record(trial.name, group, *rows, np.ones(len(rows[0]), dtype=bool), by_hand)


def _held(trial: TrialData, P: Array, x: Array) -> str:
    """What stays the same throughout a trial, in words: its load, its pressure or its length; else the trial itself."""
    for name, quantity in (("load", "force"), ("contraction", "length"), ("pressure", "pressure")):
        if name in trial.point:
            return f"{name} {show(trial.point[name], quantity, 3)}"
    if np.ptp(P) <= CONSTANT * abs(float(np.median(P))):
        return f"pressure {show(round(float(np.median(P)), -3), 'pressure', 3)}"
    if np.ptp(x) <= HELD:
        return f"contraction {show(round(float(np.median(x)), 4), 'length', 3)}"
    return trial.name
