"""Ways in which a measurement can depart from the straight form, as forces at each segment; knows no interval.

Each way is a column: the change of F_L [N] that a departure of size 1 makes of each segment, at first order. Columns
are compared by `form` with what the fit leaves over. See docs/uncertainty.md, "Is the form right?".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.analysis.shared import skew
from pmabench.kinds.contraction_relaxation.drift import zero_drifts
from pmabench.kinds.contraction_relaxation.pooled import Solved, force_by_pressure
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.store.records import Array

MOST_PLACES = 40
"""Most trials before which a slip is looked for."""
GRID = 0.02
"""Period at which hysteresis and creep follow the contraction [s]."""
RADII = (0.3e-3, 1e-3, 3e-3, 8e-3)
"""Contraction over which a stop gives way [m]: those of a braid lie between."""
TIMES = ((0.5, 1.58), (5.0, 15.8), (50.0, 158.0))
"""Time constants of creep [s], two a decade."""
TYPICAL = 350e3
"""Pressure [Pa] by which what grows with pressure is scaled."""


@dataclass(frozen=True, eq=False)
class Way:
    """One way to depart, at one place or of one kind."""

    text: str
    """Completes `it fits that ...`, with `{size}` for the size that was found."""
    quantity: str
    """Of the size, for its unit."""
    column: Array
    """Change of F_L by size 1 [N per SI unit of the size], shape (n,)."""
    known: float = 0.0
    """Size [SI] that other lines of the budget hold already."""
    curved: Array | None = None
    """Second change of F_L by the size [N per square of it], shape (n,), of what may be large."""


@dataclass(frozen=True, eq=False)
class Cause:
    """Ways of one kind, of which at most one is expected at a time."""

    name: str
    """For the budget."""
    part: str
    """Field of `Parts` that it belongs to."""
    ways: tuple[Way, ...]


def causes(campaign: Campaign, segments: Segments, fit: Solved) -> tuple[Cause, ...]:
    """All causes that the channels of the campaign allow."""
    found = [make(campaign, segments, fit) for make in (_drift, _slip, _late, _bend, _hysteresis, _creep)]
    return tuple(cause for cause in found if cause.ways)


def order(campaign: Campaign) -> Array:
    """Place of each trial in the campaign by time, from -0.5 to 0.5, shape (trials,)."""
    started = {run.id: str(run.manifest.get("started_utc", "")) for run in campaign.runs}
    place = {run.id: number for number, run in enumerate(campaign.runs)}
    keys = [(started[t.run], place[t.run], float(t.t[0])) for t in campaign.trials]
    rank = np.empty(len(keys))
    rank[sorted(range(len(keys)), key=lambda i: keys[i])] = np.arange(len(keys))
    return np.asarray(rank / max(1, len(keys) - 1) - 0.5)


def allowed(campaign: Campaign, segments: Segments, known: Sequence[Cause]) -> Array:
    """What departures of known size may do to each segment, constant or growing over the campaign [N], shape (n, m)."""
    course = 2 * order(campaign)[segments.trial]
    columns: list[Array] = []
    for way in (way for cause in known for way in cause.ways if way.known):
        columns += [way.known * way.column, way.known * way.column * course]
        if way.curved is not None:
            columns.append(0.5 * way.known**2 * way.curved)
    return np.array(columns).reshape(-1, len(segments)).T


def _drift(campaign: Campaign, segments: Segments, fit: Solved) -> Cause:
    text = "the zero of the force cell drifted by {size} over the campaign"
    own = (Way(text, "force", order(campaign)[segments.trial], _zero_known(campaign)),) if campaign.cell else ()
    return Cause("drift of the force cell that weights and fit do not exclude", "drift", own)


def _zero_known(campaign: Campaign) -> float:
    """Largest drift of the zero of the cell [N] in the checks at the end of the runs."""
    return max((abs(drift) for run in campaign.runs for drift in zero_drifts(run, "force")), default=0.0)


def _slip(campaign: Campaign, segments: Segments, fit: Solved) -> Cause:
    """The end of the muscle, or its sensor, slipped between two trials: all later contractions are off by as much."""
    place = order(campaign)[segments.trial]
    K = fit.values("K", segments.pressure)
    later = np.unique(place)[1:]
    chosen = later[np.unique(np.linspace(0, len(later) - 1, min(MOST_PLACES, len(later))).round().astype(np.intp))]
    names = {float(p): campaign.name(i) for i, p in enumerate(order(campaign))}
    ways = tuple(
        Way(
            f"the mount or the displacement sensor slipped by {{size}} before trial {names[float(at)]}",
            "length",
            K * (place >= at),
        )
        for at in chosen
    )
    return Cause("slip of the mount that the fit does not exclude", "drift", ways)


def _late(campaign: Campaign, segments: Segments, fit: Solved) -> Cause:
    """A channel shifted in time, or behind a first-order filter: the same at first order."""
    bounds = {name: bound for names, bound in skew.causes(campaign.runs, campaign.channels).items() for name in names}
    slope = force_by_pressure(segments, fit)
    push = [slope * of(segments.P_mid, segments.dt) for of in (_rate, _second)]
    pull = [float(campaign.cell) * of(segments.F_mid, segments.dt) for of in (_rate, _second)]
    columns = {"pressure": push, **({"force": pull} if campaign.cell else {})}
    columns["displacement"] = [one - other for one, other in zip(pull, push, strict=True)]
    ways = tuple(
        Way(
            f"{name} is late by {{size}} against the other channels, or filtered with that time constant",
            "time",
            column,
            bounds.get(name, 0.0),
            curved,
        )
        for name, (column, curved) in columns.items()
    )
    return Cause("delay or filter of a channel that the fit does not exclude", "method", ways)


def _bend(campaign: Campaign, segments: Segments, fit: Solved) -> Cause:
    """K changes with x. A straight line's K is the slope in the middle of the contractions at that pressure."""
    x, P = segments.x @ segments.weights, segments.pressure
    line = np.column_stack((np.ones(len(P)), P / TYPICAL))
    middle = line @ np.linalg.lstsq(line, x, rcond=None)[0]
    bent = x * (x - 2 * middle)
    reach = float(np.ptp(x)) or 1.0
    text = "the force over contraction is bent: K changes by {size} over the contractions tested"
    kinds = ((bent, ""), (bent * P / TYPICAL, ", in proportion to pressure"))
    ways = tuple(Way(text + more, "stiffness", column / (2 * reach)) for column, more in kinds)
    return Cause("bend of the force over contraction that the fit does not exclude", "method", ways)


def _hysteresis(campaign: Campaign, segments: Segments, fit: Solved) -> Cause:
    """A friction that needs some contraction after each turn to reach its size; what F_c holds of it is taken off."""
    P = segments.pressure
    ways = []
    for radius, stop in zip(RADII, _followed(campaign, segments, RADII, _stop), strict=True):
        for column, more in ((stop, ""), (stop * P / TYPICAL, ", in proportion to pressure")):
            text = f"there is hysteresis of {{size}} that turns over {1e3 * radius:g} mm of contraction{more}"
            ways.append(Way(text, "force", column - float(np.mean(column * segments.way)) * segments.way))
    return Cause("hysteresis that the fit does not exclude", "method", tuple(ways))


def _creep(campaign: Campaign, segments: Segments, fit: Solved) -> Cause:
    """The muscle goes on contracting: a share of x per decade of time (two time constants)."""
    K = fit.values("K", segments.pressure)
    slow = [0.5 * K * one for one in _followed(campaign, segments, [t for pair in TIMES for t in pair], _lag)]
    pairs = [slow[2 * i] + slow[2 * i + 1] for i in range(len(TIMES))]
    every = Way("the muscle creeps by {size} of its contraction in a decade of time", "ratio", np.sum(pairs, axis=0))
    some = (
        Way(f"the muscle creeps by {{size}} of its contraction within about {pair[1]:g} s", "ratio", column)
        for pair, column in zip(TIMES, pairs, strict=True)
    )
    return Cause("creep that the fit does not exclude", "method", (every, *some))


def _rate(values: Array, dt: float) -> Array:
    """Slope of each row of `values` (n, s) over time [1/s]; its noise has nothing in common with that of the mean."""
    t = (np.arange(values.shape[1]) - 0.5 * (values.shape[1] - 1)) * dt
    return np.asarray(values @ t / (t @ t))


def _second(values: Array, dt: float) -> Array:
    """Second derivative of each row of `values` (n, s) over time [1/s^2], by a parabola."""
    t = (np.arange(values.shape[1]) - 0.5 * (values.shape[1] - 1)) * dt
    square = t**2 - np.mean(t**2)
    return np.asarray(2 * values @ square / (square @ square))


Follow = Callable[[Array, Array, Array, Array], Array]
"""Next value of what follows x, from parameters (k, 1), value before (k, trials), change of x and x (trials,)."""


def _stop(parameters: Array, before: Array, change: Array, x: Array) -> Array:
    """Friction of a stop by its size, from -1 to 1."""
    return np.asarray(np.clip(before + change / parameters, -1.0, 1.0))


def _lag(parameters: Array, before: Array, change: Array, x: Array) -> Array:
    """First-order lag of x [m]."""
    return np.asarray(before + (x - before) * -np.expm1(-GRID / parameters))


def _followed(campaign: Campaign, segments: Segments, parameters: Sequence[float], step: Follow) -> list[Array]:
    """What follows the contraction from the begin of each trial, at the middle of each segment; one (n,) each."""
    numbers = np.unique(segments.trial)
    begins = [campaign.samples[i].t[0] for i in numbers]
    middle = segments.t + 0.5 * segments.v.shape[1] * segments.dt
    ends = [middle[segments.trial == i].max() for i in numbers]
    grid = np.arange(0.0, max(end - begin for end, begin in zip(ends, begins, strict=True)) + 2 * GRID, GRID)
    x = np.empty((len(grid), len(numbers)))
    for column, (i, begin) in enumerate(zip(numbers, begins, strict=True)):
        samples = campaign.samples[i]
        x[:, column] = np.interp(grid, samples.t[samples.ok] - begin, samples.x[samples.ok])
    x -= x[0]
    values = np.empty((len(grid), len(parameters), len(numbers)))
    now, sizes = np.zeros(values.shape[1:]), np.array(parameters)[:, None]
    for row in range(len(grid)):
        now = step(sizes, now, x[row] - x[max(0, row - 1)], x[row])
        values[row] = now
    found = np.empty((len(parameters), len(segments)))
    for column, (i, begin) in enumerate(zip(numbers, begins, strict=True)):
        mine = segments.trial == i
        for place in range(len(parameters)):
            found[place, mine] = np.interp(middle[mine] - begin, grid, values[:, place, column])
    return list(found)
