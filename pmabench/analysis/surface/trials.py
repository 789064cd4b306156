"""Rows of pressure, contraction and force at an even, low rate, from trials of slow tests.

A kind of test names one of these functions in its record, by how the length is set. Each takes run, trial and rate
[Hz], and returns a `Record`, or the reason as text where the trial has no rows.
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
"""Rows per second [Hz], at which stops and creep are computed."""
FEW = 4
"""Fewest samples of a row for its speed to be their slope; with fewer it is from the neighbouring rows."""


@dataclass(frozen=True, eq=False)
class Record:
    """Rows of one trial in the order of time; arrays of shape (n,), SI."""

    name: str
    group: str
    """Group of trials that are left out together, for instance `isobaric-ramp, pressure 300 kPa`."""
    t: Array
    P: Array
    x: Array
    F: Array
    v: Array
    """Speed of contraction [m/s]."""
    used: NDArray[np.bool_]
    """Mask of rows that are fitted; the others only update the internal states."""
    by_hand: bool = False
    """Whether the length was set by hand, so that the force of the trial has a constant error."""
    goes_on: bool = False
    """Whether it follows the record before it on the same muscle, whose internal states continue."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of successive records, shape (n,), SI."""

    P: Array
    x: Array
    v: Array
    F: Array
    used: NDArray[np.bool_]
    of: NDArray[np.int64]
    """Index of the record of each row."""

    @classmethod
    def of_records(cls, records: Sequence[Record]) -> Rows:
        """All rows of records, in order."""
        P, x, v, F = (np.concatenate([getattr(r, name) for r in records]) for name in ("P", "x", "v", "F"))
        used = np.concatenate([r.used for r in records])
        return cls(P, x, v, F, used, np.repeat(np.arange(len(records)), [len(r.t) for r in records]))


def rows_of(
    t: Array, P: Array, x: Array, F: Array, usable: NDArray[np.bool_], rate: float = RATE
) -> tuple[Array, Array, Array, Array, Array]:
    """Time, pressure, contraction, force and speed at `rate` [Hz] as means of samples, shape (n,), SI.

    Samples have shape (m,); only `usable` ones with finite values count. Rows without one are left out.
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
"""Fewest rows of a trial."""
CONSTANT = 0.03
"""Relative change below which a pressure counts as constant."""
HELD = 0.5e-3
"""Change below which a contraction counts as constant [m]."""
GRAVITY = 9.80665


def driven(run: RunData, trial: TrialData, rate: float) -> Record | str:
    """Rows of a trial whose end is moved or held by an actuator, with force and displacement recorded."""
    if lacks := _lacking(trial, "pressure", "displacement", "force"):
        return lacks
    return _record(run, trial, rate, on_time(run, trial, "displacement"), on_time(run, trial, "force"))


def _lacking(trial: TrialData, *channels: str) -> str:
    lacks = " and ".join(name for name in channels if name not in trial.channels)
    return lacks and f"{lacks} was not recorded"


def by_hand(run: RunData, trial: TrialData, rate: float) -> Record | str:
    """Rows of a trial at a length set by hand: the contraction of its point where no displacement was recorded."""
    if lacks := _lacking(trial, "pressure", "force"):
        return lacks
    if "displacement" in trial.channels:
        return driven(run, trial, rate)
    if "contraction" not in trial.point:
        return "neither the contraction nor the length that was set is known"
    x = np.full(trial.t.shape, trial.point["contraction"])
    return _record(run, trial, rate, x, on_time(run, trial, "force"), by_hand=True)


def hanging(run: RunData, trial: TrialData, rate: float) -> Record | str:
    """Rows of a trial with a hanging weight: force of the cell, else load plus inertia."""
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
    """The constant quantity of a trial as text: load, contraction or pressure with its value; else the trial's name."""
    for name, quantity in (("load", "force"), ("contraction", "length"), ("pressure", "pressure")):
        if name in trial.point:
            return f"{name} {show(trial.point[name], quantity, 3)}"
    if np.ptp(P) <= CONSTANT * abs(float(np.median(P))):
        return f"pressure {show(round(float(np.median(P)), -3), 'pressure', 3)}"
    if np.ptp(x) <= HELD:
        return f"contraction {show(round(float(np.median(x)), 4), 'length', 3)}"
    return trial.name
