"""Possible departures of a measurement from the straight form, as forces at each segment; knows no interval.

Each is a column: the first-order change of F_L [N] at each segment by a departure of size 1. The columns are compared
with the residual of the fit. See docs/uncertainty.md, "Is the form right?".
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.simulated import BLOCK
from pmabench.kinds.contraction_relaxation.intervals import zero_drifts
from pmabench.kinds.contraction_relaxation.pooled import Fit, force_by_pressure
from pmabench.kinds.contraction_relaxation.segments import Campaign, Gate, Kept, Segments
from pmabench.store.records import Array

MOST_PLACES = 40
"""Most trials before which a slip is tried."""
GONE = 1e-16
"""A first-order lag that keeps less than this share from one row to the next is treated as having no memory."""
STROKE = 1e-6
"""Contractions that differ by less are taken as equal [m]."""
GRID = 0.008
"""Time step at which hysteresis and creep are computed from the contraction [s]."""
RADII = (0.3e-3, 1e-3, 3e-3, 8e-3)
"""Contraction over which a friction element of the hysteresis model yields [m]; those of a braid lie between these."""
TIMES = (0.16, 0.5, 1.6, 5.0, 16.0, 50.0, 160.0, 500.0)
"""Time constants of creep [s], two per decade, up to the length of a campaign: creep goes on in later trials."""
TYPICAL = 350e3
"""Reference pressure [Pa] of departures that grow in proportion to pressure."""
LOADED = 250.0
"""Reference force [N] of departures that grow in proportion to the load."""
BY_LOAD, BY_WAY = "by time and load", "by way"
FINER: Mapping[str, str] = {"creep": BY_LOAD, "hysteresis": BY_WAY}
"""Finest variant of a cause. Tried only where the cause was found, and a form that is the same at all loads, or in
both directions, is not enough: hysteresis loops of braids are not symmetric (Liu et al. 2017, Strojniski vestnik
63(1)).
"""
STEEP = 0.15
"""Decay length of the steep part of K, as a share of the tested contractions: for a fluidic muscle of 20 mm K is nearly
straight beyond three contractions, and its force falls with exp(-x / 3 % of the length).
"""
WHEELS = (6e-3, 8e-3, 11e-3, 15e-3, 20e-3)
"""Radii of an encoder's measuring wheel [m]; on larger ones an eccentricity error is nearly straight over a stroke."""
PHASES = (0.0, 0.25, 0.5, 0.75)
"""Wheel angle at the start of the stroke [half turns]; the other half turn only changes the sign."""
UNDECLARED = 0.05e-3
"""Assumed hysteresis of a displacement sensor [m] where its record gives none."""


def order(campaign: Campaign) -> Array:
    """Chronological rank of each trial in the campaign, scaled from -0.5 to 0.5, shape (trials,)."""
    started = {run.id: str(run.manifest.get("started_utc", "")) for run in campaign.runs}
    place = {run.id: number for number, run in enumerate(campaign.runs)}
    keys = [(started[t.run], place[t.run], float(t.t[0])) for t in campaign.trials]
    rank = np.empty(len(keys))
    rank[sorted(range(len(keys)), key=lambda i: keys[i])] = np.arange(len(keys))
    return np.asarray(rank / max(1, len(keys) - 1) - 0.5)


def course(campaign: Campaign) -> Callable[[int], Array]:
    """Share of the campaign elapsed, 0 to 1, at each sample of trial `i`; time between runs does not count.

    Where the times of trials overlap, as in files of single trials, the rank from `order` is used instead.
    """
    place = order(campaign)
    rank = np.argsort(place)
    begun, last = 0.0, ""
    offsets, ends = np.zeros(len(place)), 0.0
    for i in rank:
        t, run = campaign.samples[i].t, campaign.trials[i].run
        if run != last:
            begun, last = ends - float(t[0]), run
        offsets[i] = begun
        if float(t[0]) + begun < ends - 1e-9:
            return lambda i: np.full(len(campaign.samples[i].t), 0.5 + place[i])
        ends = float(t[-1]) + begun
    return lambda i: np.asarray((campaign.samples[i].t + offsets[i]) / ends)


def drift(campaign: Campaign, segments: Segments) -> Array:
    """Cell zero that drifts by +1 N over the campaign, in proportion to time; shape (n,)."""
    shares = course(campaign)
    found = np.empty(len(segments))
    for i in np.unique(segments.trial):
        mine = segments.trial == i
        found[mine] = np.interp(segments.t[mine], campaign.samples[i].t, shares(i))
    return found


def clock(campaign: Campaign) -> Array:
    """Time error at each trial of a clock that gains 1 s per run, from -0.5 s to 0.5 s; shape (trials,)."""
    return np.asarray(0.5 * skew.courses(campaign.trials)[1])


def slip(campaign: Campaign, segments: Segments, fit: Fit, first: int) -> Array:
    """Slip of a mount or the sensor: from trial number `first` on, contractions read 1 m less; shape (n,)."""
    place = order(campaign)
    return np.asarray(-fit.values("K", segments.pressure) * (place[segments.trial] >= place[first]))


def slip_places(campaign: Campaign, segments: Segments) -> list[int]:
    """Trial numbers before which a slip is tried, in chronological order.

    Not at the first of a session: a muscle that was mounted anew, and zeros that were taken anew, look alike.
    """
    place, day = order(campaign), campaign.sessions
    inside = sorted(np.unique(segments.trial).tolist(), key=lambda i: place[i])
    later = [now for before, now in pairwise(inside) if day[now] == day[before]]
    chosen = np.unique(np.linspace(0, len(later) - 1, min(MOST_PLACES, len(later))).round().astype(np.intp))
    return [later[i] for i in chosen]


def late(segments: Segments, fit: Fit, cell: bool) -> dict[str, tuple[Array, Array]]:
    """Channel -> first and second derivative of F_L by its delay, or by a filter's time constant, (n,) each."""
    slope = force_by_pressure(segments, fit)
    push = [slope * of(segments.P_mid, segments.dt) for of in (_rate, _second)]
    pull = [float(cell) * of(segments.F_mid, segments.dt) for of in (_rate, _second)]
    found = {"pressure": (push[0], push[1]), "displacement": (pull[0] - push[0], pull[1] - push[1])}
    return found | ({"force": (-pull[0], pull[1])} if cell else {})


@dataclass(frozen=True)
class Span:
    """Tested contractions: a straight line over pressure fitted to all segments, and their range [m]."""

    line: Array
    reach: float

    @classmethod
    def of(cls, segments: Segments) -> Span:
        """From the segments of a fit."""
        x, P = segments.contraction, segments.pressure
        line = np.linalg.lstsq(np.column_stack((np.ones(len(P)), P / TYPICAL)), x, rcond=None)[0]
        reach = float(np.ptp(x))
        return cls(np.asarray(line), reach if reach > STROKE else 1.0)

    def middle(self, P: Array) -> Array:
        """Contraction [m] near the middle of those tested at pressures [Pa], where K of a bent curve is defined."""
        return np.asarray(self.line[0] + self.line[1] * P / TYPICAL)


def bent(which: str, x: Array, P: Array, K: Array, span: Span) -> Array:
    """Extra force of the muscle at contractions x [m] and pressures P [Pa] per size of a bend; shape (n, sizes).

    Over the tested contractions K falls: `as K`, in proportion to K; `line`, by 1 N/m, and by 1 N/m in proportion to
    pressure; `steep`, additionally by 1 N/m near zero contraction (see `STEEP`), and the same in proportion to
    pressure. K remains the slope at the middle, F_ce the force at zero contraction.
    """
    middle = span.middle(P)
    shape = x * (x - 2 * middle) / (2 * span.reach)
    if which == "as K":
        return np.asarray(K * shape)[:, None]
    shapes = [shape]
    if which == "steep":
        length = STEEP * span.reach
        shapes.append(np.exp(-middle / length) * x + length * np.expm1(-np.maximum(x, -length) / length))
    return np.column_stack([column for one in shapes for column in (one, one * P / TYPICAL)])


def bend(which: str, followed: Followed, segments: Segments, fit: Fit) -> Array:
    """`bent` at each segment."""
    P = segments.pressure
    return bent(which, segments.contraction, P, fit.values("K", P), Span.of(segments))


def bent_sensor(followed: Followed, segments: Segments, fit: Fit) -> Array:
    """K and B both fall in proportion over the tested contractions, as they seem to where the displacement sensor is
    nonlinear; shape (n, 1).
    """
    x, P, span = segments.contraction, segments.pressure, Span.of(segments)
    by_speed = fit.damping(segments) * segments.v.mean(axis=1) * (x - span.middle(P)) / span.reach
    return np.asarray(bent("as K", x, P, fit.values("K", P), span) + by_speed[:, None])


def off_straight(segments: Segments, fit: Fit, radius: float, phase: float) -> Array:
    """Sinusoidal error of 1 m of the displacement sensor, as of an encoder on an eccentric wheel of `radius` [m];
    `phase` in half turns; shape (n,).
    """
    x, P = segments.contraction, segments.pressure
    damping = fit.damping(segments) * segments.v.mean(axis=1)
    angle, begin = x / radius + np.pi * phase, np.pi * phase
    return np.asarray(fit.values("K", P) * (np.sin(angle) - np.sin(begin)) + damping * np.cos(angle) / radius)


def play(segments: Segments, fit: Fit) -> Array:
    """Backlash: the displacement sensor reads 1 m too little while the muscle contracts, too much while it relaxes;
    (n,).
    """
    return np.asarray(-fit.values("K", segments.pressure) * segments.way)


def hysteresis(followed: Followed, segments: Segments, fit: Fit) -> Array:
    """Hysteresis of 1 N that develops over some contraction after each reversal: for each of `RADII` constant, and in
    proportion to pressure; shape (n, 8). The part that F_c describes is subtracted.
    """
    return _less_friction(followed.stops(segments).T, segments)


def _less_friction(stops: Iterable[Array], segments: Segments) -> Array:
    """Each of the forces (n,), and the same in proportion to pressure, minus the part that F_c describes; shape (n,
    columns).
    """
    both = [column for stop in stops for column in (stop, stop * segments.pressure / TYPICAL)]
    return np.column_stack([float(np.mean(one * segments.way)) * segments.way - one for one in both])


def hysteresis_by_way(followed: Followed, segments: Segments, fit: Fit) -> Array:
    """`hysteresis` in contraction only, then in relaxation only; shape (n, 16). The part that F_ce describes, the
    middle of both branches, is subtracted as well.
    """
    found = []
    for way in (1.0, -1.0):
        rows = segments.way == way
        stops = followed.stops(segments).T * rows
        found.append(_less_friction([stop - 0.5 * (stop.sum() / max(1, rows.sum())) for stop in stops], segments))
    return np.hstack(found)


def creep(which: str, followed: Followed, segments: Segments, fit: Fit) -> Array:
    """Creep by the whole contraction per decade of time, shape (n, sizes): `by time` for each of `TIMES`, `by decade`
    for pairs of them, `even` for all of them together.
    """
    parts = 0.5 * fit.values("K", segments.pressure)[:, None] * followed.slow(segments)
    if which == "by decade":
        parts = parts[:, 0::2] + parts[:, 1::2]
    return np.asarray(parts.sum(axis=1, keepdims=True) if which == "even" else parts)


def creep_by_load(followed: Followed, segments: Segments, fit: Fit) -> Array:
    """`creep` by time, the same at every load, and in proportion to the load; shape (n, 16)."""
    even = creep("by time", followed, segments, fit)
    return np.hstack((even, even * (segments.force / LOADED)[:, None]))


OF_MUSCLE: Mapping[str, Mapping[str, Callable[[Followed, Segments, Fit], Array]]] = {
    "bend": {which: partial(bend, which) for which in ("as K", "line", "steep")},
    "sensor": {"": bent_sensor},
    "hysteresis": {"": hysteresis, BY_WAY: hysteresis_by_way},
    "creep": {which: partial(creep, which) for which in ("even", "by decade", "by time")} | {BY_LOAD: creep_by_load},
}
"""Property of a muscle -> variant -> its columns; `sensor` is either the muscle or the displacement sensor."""


def allowed(campaign: Campaign, segments: Segments, fit: Fit) -> Array:
    """Effect on each segment of departures whose bounds are known, constant or growing over the campaign [N], shape (n,
    m).
    """
    course = 2 * order(campaign)[segments.trial]
    columns: list[Array] = []
    zero = zero_known(campaign)
    if zero:
        rank = zero * order(campaign)[segments.trial]
        columns += [rank, rank * course]
    bounds = clock_bounds(campaign)
    for name, (column, curved) in late(segments, fit, campaign.cell).items() if bounds else ():
        bound = bounds.get(name, 0.0)
        columns += [bound * column, bound * column * course, 0.5 * bound**2 * curved] if bound else []
    return np.array(columns).reshape(-1, len(segments)).T


def zero_known(campaign: Campaign) -> float:
    """Largest drift of the zero of the cell [N] in the checks at the end of the runs; 0 without cell."""
    drifts = (abs(drift) for run in campaign.runs for drift in zero_drifts(run, "force"))
    return max(drifts, default=0.0) if campaign.cell else 0.0


def sensor_known(campaign: Campaign) -> float:
    """Uncertainty of the displacement's zero from its calibration [m]; 0 where none is given."""
    return Scales.of(campaign.runs).offsets.get("displacement", 0.0)


def clock_bounds(campaign: Campaign) -> dict[str, float]:
    """Channel -> largest error of its clock [s]; empty where all channels share one clock."""
    return {name: bound for names, bound in skew.causes(campaign.runs, campaign.channels).items() for name in names}


def _rate(values: Array, dt: float) -> Array:
    """Slope over time [1/s] of each row of `values` (n, s); its noise is uncorrelated with that of the mean."""
    t = (np.arange(values.shape[1]) - 0.5 * (values.shape[1] - 1)) * dt
    return np.asarray(values @ t / (t @ t))


def _second(values: Array, dt: float) -> Array:
    """Second derivative of each row of `values` (n, s) over time [1/s^2], by a parabola."""
    t = (np.arange(values.shape[1]) - 0.5 * (values.shape[1] - 1)) * dt
    square = t**2 - np.mean(t**2)
    return np.asarray(2 * values @ square / (square @ square))


@dataclass(frozen=True, eq=False)
class Followed:
    """Friction elements (`RADII`) and lags (`TIMES`) driven by the contraction of each trial, over its time."""

    begins: Array
    """Start times of the trials [s], shape (trials,)."""
    column: NDArray[np.intp]
    """Index of each trial on the last axis of `x`, shape (trials,); trials that did not lift share the last one."""
    x: Array
    """Contraction since the start of each trial at time steps of `GRID` [m], shape (steps, trials that lifted + 1)."""
    left: Array
    """State that is left at each trial's start from those before, shape (radii + times, trials that lifted + 1)."""
    kept: Kept = field(default_factory=Kept)

    @classmethod
    def of(cls, campaign: Campaign) -> Followed:
        """Computed from rest at the start of the campaign: slow lags decay until the next trial, a strained braid stays
        strained.
        """
        begins = np.array([samples.t[0] for samples in campaign.samples])
        lifted = [i for i, samples in enumerate(campaign.samples) if np.any(samples.x[samples.ok] > Gate.lift)]
        column = np.full(len(begins), len(lifted))
        column[lifted] = np.arange(len(lifted))
        longest = max((float(campaign.samples[i].t[-1] - begins[i]) for i in lifted), default=0.0)
        grid = np.arange(0.0, longest + 2 * GRID, GRID)
        x = np.zeros((len(grid), len(lifted) + 1))
        for place, samples in enumerate(campaign.samples[i] for i in lifted):
            x[:, place] = np.interp(grid, samples.t[samples.ok] - samples.t[0], samples.x[samples.ok])
        x -= x[0]
        return cls(begins, column, x, _left(campaign, column, x))

    def stops(self, segments: Segments) -> Array:
        """Mean over each segment of the friction elements' states, shape (n, radii)."""
        return self._means(segments)[:, : len(RADII)]

    def slow(self, segments: Segments) -> Array:
        """Mean over each segment of the contraction behind a lag of each of `TIMES` [m], shape (n, times)."""
        return self._means(segments)[:, len(RADII) :]

    def _means(self, segments: Segments) -> Array:
        def means() -> Array:
            length = segments.v.shape[1] * segments.dt
            row = (segments.t - self.begins[segments.trial] - 0.5 * GRID) / GRID
            begin, end = self._sums(np.array((row, row + length / GRID)), self.column[segments.trial])
            return np.asarray((end - begin) * GRID / length)

        return np.asarray(self.kept.of("means", (segments.t, segments.trial), means))

    def _sums(self, row: Array, trial: NDArray[np.intp]) -> Array:
        """Running sums over time steps of the friction elements' states, -1 to 1, and the lagged contractions [m], at
        fractional time steps `row` (2, n); shape (2, n, radii + times).

        A block of steps at a time: only those asked for are kept, since all would be the largest array of a reduction.
        """
        left = np.clip(row.astype(np.intp), 0, len(self.x) - 2)
        share = np.clip(row - left, 0.0, 1.0)[..., None]
        wanted, trials = np.array((left, left + 1)).ravel(), np.tile(trial, 2 * len(row))
        order = np.argsort(wanted, kind="stable")
        found = np.empty((len(wanted), len(self.left)))
        state, total, parts = self.left.copy(), np.zeros_like(self.left), len(RADII)
        stops, slow = state[:parts], state[parts:]
        above, below, decay = np.ones(stops.shape), -np.ones(stops.shape), np.tile(KEEP, slow.shape[1])
        for first in range(0, len(self.x), BLOCK):
            sums = _inputs(self.x, first, first + BLOCK)
            for input in sums:
                slow *= decay
                state += input
                np.minimum(np.maximum(stops, below, out=stops), above, out=stops)
                total += state
                input[...] = total
            here = order[slice(*np.searchsorted(wanted[order], (first, first + BLOCK)))]
            found[here] = sums[wanted[here] - first, :, trials[here]]
        before, after = found.reshape(2, *row.shape, -1)
        return np.asarray((1 - share) * before + share * after)


KEEP = np.exp(-GRID / np.array(TIMES))[:, None]
"""Decay of each lag in a time step."""
NOW = 1 - (1 - KEEP) * np.array(TIMES)[:, None] / GRID
"""Share of a lag's input that counts in the same time step: exact for a piecewise linear contraction."""


def _inputs(x: Array, first: int, last: int) -> Array:
    """Input of friction elements and lags at time steps from `first` up to `last`, from contractions `x` (steps, k);
    shape (steps, radii + times, k).
    """
    at, parts = x[first:last], len(RADII)
    before = x[np.maximum(np.arange(first - 1, first - 1 + len(at)), 0)]
    inputs = np.empty((len(at), parts + len(TIMES), x.shape[1]))
    np.divide((at - before)[:, None, :], np.array(RADII)[:, None], out=inputs[:, :parts])
    np.multiply(at[:, None, :], NOW, out=inputs[:, parts:])
    inputs[:, parts:] += (1 - KEEP - NOW) * before[:, None, :]
    return inputs


def _left(campaign: Campaign, column: NDArray[np.intp], x: Array) -> Array:
    """`Followed.left` from its `column` and `x`."""
    parts, times = len(RADII), np.array(TIMES)
    left, stops = np.zeros((parts + len(times), x.shape[1])), np.zeros((parts, x.shape[1]))
    for first in range(0, len(x), BLOCK):
        for row in _inputs(x, first, first + BLOCK)[:, :parts]:
            stops += row
            np.minimum(np.maximum(stops, -1.0, out=stops), 1.0, out=stops)
    weights = KEEP ** np.arange(len(x) - 1, -1, -1)
    lifted = [(n, i) for n, i in enumerate(np.argsort(order(campaign)).tolist()) if column[i] < x.shape[1] - 1]
    for (n, i), (m, after) in pairwise(lifted):
        pause = _pause(campaign, i, after)
        if np.isfinite(pause):
            own, to = column[i], column[after]
            rows = min(len(x) - 1, round(float(np.ptp(campaign.samples[i].t)) / GRID)) + 1
            moved = np.einsum("kn,nk->k", weights[:, -rows:], _inputs(x[:, own : own + 1], 0, rows)[:, parts:, 0])
            kept = moved + left[parts:, own] * KEEP[:, 0] ** rows
            left[parts:, to] = kept * np.exp((GRID - pause) / times)  # the first time step subtracts one GRID
            if m == n + 1:  # a trial in between that did not lift strains the braid by an unknown amount
                left[:parts, to] = stops[:, own]
    return left


def lagged(values: Array, constant: float) -> Array:
    """Rows of `values` (n, ...) after a first-order filter with a time constant in rows; exact for piecewise linear
    values.

    Recursion by doubling: each pass adds what twice as many earlier rows contribute. scipy.signal has this filter, but
    importing it takes longer than a reduction.
    """
    keep = float(np.exp(-1 / constant))
    now = 1 - (1 - keep) * constant
    change = values - values[:1]
    found = now * change
    found[1:] += (1 - keep - now) * change[:-1]
    span, kept = 1, np.empty_like(found)
    while span < len(values) and keep > GONE:
        found[span:] += np.multiply(keep, found[:-span], out=kept[span:])
        span, keep = 2 * span, keep * keep
    found += values[:1]
    return found


def _pause(campaign: Campaign, one: int, after: int) -> float:
    """Time from the end of trial `one` to the start of trial `after` [s]; inf where unknown."""
    if campaign.trials[one].run != campaign.trials[after].run:
        return np.inf
    pause = float(campaign.samples[after].t[0] - campaign.samples[one].t[-1])
    return pause if pause >= 0 else np.inf
