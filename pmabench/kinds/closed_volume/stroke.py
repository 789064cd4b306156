"""One trial of a closed volume: absolute pressures on a grid of contractions, the volumes that follow, and the fit of
V(eps).

P_abs V^k of a closed mass is constant (paper 3, chamber equation without flow): V + V_d = (V_0 + V_d) (m/m_0)
(P_0/P)^(1/k), P absolute: gauge reading plus room pressure. m/m_0 is 1 in the paper; a leak into the room takes dm/dt =
-c P_gauge P^(1/k - 1), with c from the pressure after return to the start.

V(eps) is that of the modified Daerden model, V = (pi/4) D0^2 l0 [1/sin^2 theta0 - (1 - eps)^alpha / tan^2 theta0] (1 -
eps) (paper 3). For a given alpha it is linear in D0^2/sin^2 theta0 and D0^2/tan^2 theta0, so only alpha is searched,
without start values.

Departures from P V = const of the enclosed air: a lag (heat, a slow sensor) makes the volume differ between both
directions; a leak that is not proportional to the pressure makes it differ at the start between two cycles; a wrong
room pressure makes it differ between start pressures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import atan, hypot, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.samples import Held, NotUsable, ends, left, noise_of, on_time, refuse_unusable
from pmabench.store.analyses.results import Estimate
from pmabench.store.records import Array, RunData, TrialData

FOLLOWS = 0.01
"""Relative fall of the absolute pressure over a stroke below which the valve is taken to be open."""
FEWEST = 5
"""Fewest samples of a stroke near each contraction."""


@dataclass(frozen=True)
class Gas:
    """Known quantities apart from the pressure: volumes [m3], room pressure [Pa absolute], k [1]."""

    reference: float
    dead: float
    atmosphere: float
    exponent: float

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Gas:
        """From the plan's settings."""
        return cls(*(float(settings[name]) for name in ("reference_volume", "dead_volume", "atmosphere", "exponent")))


@dataclass(frozen=True, eq=False)
class Stroke:
    """Gauge pressures [Pa] of one trial at contractions `x` [m], in the order of time: shape (2 cycles, n)."""

    trial: TrialData
    x: Array
    P: Array
    paid: Array
    """Integral of P_gauge (P_gauge + room)^(1/k - 1) over time from the start, shape as `P`; a leak is proportional to
    it.
    """
    paid_at_end: float
    before: float
    after: float
    """Gauge pressure at the start, before the first stroke and after the last [Pa]."""
    returns: Array
    """Gauge pressure and `paid` at the start between two cycles, shape (cycles - 1, 2)."""
    far: tuple[Held, ...]
    """Pressure in the rests at the far end."""
    noise: float
    resting: int
    """Samples of a rest that are averaged."""
    aside: Array
    """Measured displacement minus commanded position at the start and at the far end [m], shape (2,)."""

    def by(self, P: Array, paid: Array, gas: Gas, *, leak: bool = True) -> Array:
        """V [m3] at gauge pressures P [Pa] and `paid` up to then, with or without correction for the leak."""
        begin, power = self.before + gas.atmosphere, 1 / gas.exponent
        lost = 1 - ((self.after + gas.atmosphere) / begin) ** power if leak else 0.0
        kept = 1 - lost * paid / self.paid_at_end
        return np.asarray((gas.reference + gas.dead) * kept * (begin / (P + gas.atmosphere)) ** power - gas.dead)

    def volumes(self, gas: Gas, *, leak: bool) -> Array:
        """V [m3], shape (cycles, n), mean of both directions; with or without correction for the leak."""
        V = self.by(self.P, self.paid, gas, leak=leak)
        return np.asarray(0.5 * (V[0::2] + V[1::2]))

    @property
    def lost(self) -> float:
        """Fall of the pressure from before the strokes to after them [Pa]."""
        return self.before - self.after


def measure(run: RunData, trial: TrialData, settings: Mapping[str, Any]) -> Stroke:
    """One trial from its samples; `NotUsable` where it ended early, lacks a channel or was never shut in."""
    refuse_unusable(trial, "pressure", "displacement")
    if not trial.found.get("closed", {}).get("found", False):
        raise NotUsable("the strokes with the valve shut were not finished")
    ramps = [c for c in trial.commands if c.output == "displacement" and c.kind == "ramp" and c.phase == "closed"]
    if len(ramps) < 2 or len(ramps) % 2:
        raise NotUsable("it holds no whole stroke there and back")
    rest, t, good = float(settings["rest"]), trial.t, trial.usable
    x, P = (on_time(run, trial, name) for name in ("displacement", "pressure"))
    arrived = [ends(ramp) for ramp in ramps]

    def resting(begin: float, end: float) -> NDArray[np.intp]:
        rows = np.flatnonzero(good & (t >= begin) & (t < end - 1e-9))
        if len(rows) < FEWEST:
            raise NotUsable(f"fewer than {FEWEST} samples in a rest with the valve shut")
        return rows

    first = resting(ramps[0].t - 0.5 * rest, ramps[0].t)
    last = resting(arrived[-1] + 0.5 * rest, arrived[-1] + 0.95 * rest)
    between = [resting(ramp.t - 0.5 * rest, ramp.t) for ramp in ramps[2::2]]
    at_far = [resting(end, ramp.t) for end, ramp in zip(arrived[::2], ramps[1::2], strict=True)]
    before, after = float(P[first].mean()), float(P[last].mean())
    room, k = float(settings["atmosphere"]), float(settings["exponent"])
    if min(before, after, float(np.nanmin(P[good]))) + room <= 0:
        raise NotUsable("an absolute pressure is not above zero: a wrong zero or sign of the pressure")
    shut = (t >= ramps[0].t) & (t < arrived[-1] + 0.95 * rest) & good
    flow = np.where(shut, P * np.maximum(P + room, 1.0) ** (1 / k - 1), 0.0)
    paid = np.concatenate(([0.0], np.cumsum(0.5 * (flow[1:] + flow[:-1]) * np.diff(t))))
    low, high, every = ramps[0].before, ramps[0].value, float(settings["every"])
    at_start, late = x[first].mean(), [rows[len(rows) // 2 :] for rows in at_far]
    aside = np.array([at_start - low, np.mean([x[rows].mean() for rows in late]) - high])
    grid = np.asarray(low + every * np.arange(int((high - low) / every + 1e-6) + 1), dtype=np.float64)
    ways = [np.flatnonzero(good & (t >= ramp.t) & (t <= ends(ramp) + 1e-9)) for ramp in ramps]
    both = np.array([[_about(x[rows], y[rows], grid, every) for y in (P, paid)] for rows in ways])
    stroke = Stroke(
        trial, grid, both[:, 0], both[:, 1], float(paid[last].mean()), before, after,
        np.array([[P[rows].mean(), paid[rows].mean()] for rows in between]).reshape(-1, 2),
        tuple(Held.of(t[rows], P[rows], float(t[rows[0]])) for rows in at_far), noise_of(P[first]), len(first), aside,
    )  # fmt: skip
    fall = float(np.mean(before - stroke.P[:, -1]))
    if fall < max(FOLLOWS * (before + room), 6 * stroke.noise):
        raise NotUsable(
            f"over the stroke the absolute pressure falls by {fall / (before + room):.2%} only: the valve was not "
            "shut, or the regulator feeds through it"
        )
    return stroke


def _about(x: Array, y: Array, grid: Array, every: float) -> Array:
    """Values of `y` at contractions `grid` [m], by a parabola through the samples within one step of each."""
    found = np.empty(len(grid))
    for i, place in enumerate(grid):
        near = np.abs(x - place) <= every
        if near.sum() < FEWEST:
            raise NotUsable(f"fewer than {FEWEST} samples about a contraction: sample faster or move slower")
        away = (x[near] - place) / every
        if np.ptp(away) < 0.5:
            raise NotUsable("the displacement does not follow the strokes")
        found[i] = float(np.polyfit(away, y[near], 2)[2])
    return found


ALPHAS = (1.0, 5.0)
"""Search range of alpha: the domain of the model."""
FEWEST_VOLUMES = 4


def fit_volume(eps: Array, V: Array, length: float) -> tuple[float, float, float] | None:
    """D0 [m], theta0 [rad], alpha [1] fitted to volumes V (n,) [m3] at eps (n,) [1]; None if the form does not fit."""
    if len(eps) < FEWEST_VOLUMES or not np.isfinite(V).all():
        return None
    size, y = pi / 4 * length, V / V.max()

    def solve(alpha: float) -> tuple[Array, float]:
        design = np.column_stack([1 - eps, -((1 - eps) ** (alpha + 1))])
        terms, *_ = np.linalg.lstsq(design, y, rcond=None)
        return np.asarray(terms), float(np.sum((y - design @ terms) ** 2))

    found = minimize_scalar(lambda a: solve(a)[1], bounds=ALPHAS, method="bounded", options={"xatol": 1e-9})
    alpha = float(found.x)
    (round_, straight), _ = solve(alpha)
    ends = min(alpha - ALPHAS[0], ALPHAS[1] - alpha)
    if not round_ > straight > 0 or ends < 1e-3:
        return None
    # round = D0^2/sin^2, straight = D0^2/tan^2: their difference is D0^2
    square = float((round_ - straight) * V.max() / size)
    return sqrt(square), atan(sqrt((round_ - straight) / straight)), alpha


def volume_at(eps: Array, length: float, D_0: float, theta_0: float, alpha: float) -> Array:
    """V [m3] at eps [1], any shape."""
    s = 1 - eps
    return np.asarray(pi / 4 * D_0**2 * length * (1 / np.sin(theta_0) ** 2 - s**alpha / np.tan(theta_0) ** 2) * s)


SURE = 5.0
"""Standard deviations from which on a difference is significant."""
UNSEEN = 1e-4
"""Difference between gauge and drive that is tolerated [m]."""
BOTH_WAYS, BETWEEN, STILL, ROOM = "both ways", "returns to the start", "motion in the rest", "pressure of the room"
PLACE = "place of the drive"
PARTS = {BOTH_WAYS: "method", BETWEEN: "drift", STILL: "method", ROOM: "method", PLACE: "method"}
ADVICE = {
    BOTH_WAYS: "on the way there the volume is up to {} of it different from that on the way back: the air has no time "
    "to take the temperature of the wall, or the pressure comes late. Move more slowly",
    BETWEEN: "back at the start between the cycles the volume comes out up to {} off: the leak changes, or the air is "
    "not at the temperature of the room. Wait longer after filling, and look for the leak",
    STILL: "in the rest at the far end the pressure may still change by {} of it: the air is not at the temperature of "
    "the wall. Rest longer",
    ROOM: "start pressures give volumes that would be the same if they were up to {} other: the pressure of the room, "
    "or the zero of the pressure, is wrong. Read a barometer, and check the zero",
    PLACE: "at rest the displacement is not where the drive was sent, which is worth up to {} of the volume: the zero "
    "or the scale of the gauge or of the drive is wrong. Check them",
}


Effect = tuple[Array, bool]
"""Effect of a departure: share of the volume at each contraction, shape (n,), and whether it is significant."""


@dataclass(frozen=True, eq=False)
class Form:
    """Effects of the departures on the volumes."""

    x: Array
    volumes: Array
    """Mean over all start pressures [m3]; shape (n,)."""
    shares: Mapping[float, Mapping[str, Effect]]
    """Start pressure -> departure -> effect."""
    leaked: Mapping[float, Array]
    """Start pressure -> relative excess of the volume at `x` without correction for the leak."""

    def of_volume(self, e: Estimate, *, leak: bool) -> list[Doubt]:
        """Effects on the volume at one start pressure and contraction."""
        P, place = round(e.at["pressure"], 6), int(np.argmin(np.abs(self.x - e.at["contraction"])))
        size = abs(e.value or 0.0)
        found = []
        for name, (share, seen) in self.shares[P].items():
            reason = ADVICE[name].format(f"{float(np.abs(share).max()):.2%}")
            found.append(Doubt(name, PARTS[name], size * abs(float(share[place])), seen, reason))
        if not leak:
            lost = abs(float(self.leaked[P][place]))
            reason = f"no leak is taken out, and what leaked makes the volume {lost:.2%} larger. Look for the leak"
            found.append(Doubt("leak", "method", size * lost, seen=True, reason=reason))
        return found

    def of_curve(self, index: int, length: float) -> list[Doubt]:
        """Effects on the `index`-th coefficient of V(eps); they only widen it, since each volume is withheld on its
        own.
        """
        base = fit_volume(self.x / length, self.volumes, length)
        found = []
        for name in ADVICE:
            share = np.mean([effects[name][0] for effects in self.shares.values()], axis=0)
            # the effect may change sign over the contractions: tried as cosines with 0 to 4 half waves
            along = np.pi * np.linspace(0.0, 1.0, len(share))
            shapes = [np.ones(len(share))] if name in (ROOM, PLACE) else [np.cos(order * along) for order in range(5)]
            moved = [fit_volume(self.x / length, self.volumes * (1 + shape * share), length) for shape in shapes]
            if base is None or None in moved:
                continue
            half = hypot(*(one[index] - base[index] for one in moved if one is not None))
            found.append(Doubt(name, PARTS[name], half, any(effects[name][1] for effects in self.shares.values())))
        return found


def form_of(cells: Mapping[float, Sequence[Stroke]], gas: Gas) -> Form:
    """The effects from the strokes by start pressure [Pa]."""
    shares: dict[float, dict[str, Effect]] = {}
    leaked, means = {}, {}
    room, beyond = _room(cells, gas)
    for P, strokes in cells.items():
        means[P], whole = (
            np.mean([one.volumes(gas, leak=leak).mean(axis=0) for one in strokes], axis=0) for leak in (True, False)
        )
        leaked[P] = whole / means[P] - 1
        shares[P] = _of_one(strokes, gas) | {ROOM: (room[P] / means[P], beyond), PLACE: _aside(strokes, means[P])}
    x = next(iter(cells.values()))[0].x
    return Form(x, np.mean(list(means.values()), axis=0), shares, leaked)


def _of_one(strokes: Sequence[Stroke], gas: Gas) -> dict[str, Effect]:
    """The effects that the strokes from one start pressure show."""
    noise = _noise(strokes, gas)
    by_way = np.array([one.by(one.P, one.paid, gas) for one in strokes])
    V = by_way.mean(axis=(0, 1))
    gaps = (by_way[:, 0::2] - by_way[:, 1::2]).reshape(-1, len(V)) / V
    gap = np.abs(gaps.mean(axis=0))
    returns = np.array([one.by(one.returns[:, 0], one.returns[:, 1], gas) for one in strokes]) / gas.reference - 1
    most = float(np.abs(returns.mean(axis=0)).max(initial=0.0))
    further = left([held for one in strokes for held in one.far])
    lowest = float(np.mean([one.P[:, -1].mean() for one in strokes])) + gas.atmosphere
    return {
        BOTH_WAYS: (0.5 * gap, float(gap.max()) > SURE * noise * sqrt(2 / len(gaps))),
        BETWEEN: (np.full(len(V), most), most > SURE * noise * sqrt(1.5 / len(strokes))),
        STILL: (np.full(len(V), further.most / lowest), further.seen),
    }


def _aside(strokes: Sequence[Stroke], V: Array) -> Effect:
    """Effect of a displacement that differs from the commanded position: gauge or drive is wrong.

    A gauge error moves each volume to another contraction, a drive error changes the reference volume at the start.
    """
    x, (start, far) = strokes[0].x, np.mean([one.aside for one in strokes], axis=0)
    per_metre = np.abs(np.gradient(V, x)) / V
    off = np.abs(np.interp(x, [x[0], x[-1]], [start, far]))
    share = np.maximum(per_metre * off, per_metre[0] * abs(start))
    return share, bool(max(abs(start), abs(far)) > UNSEEN)


def _noise(strokes: Sequence[Stroke], gas: Gas) -> float:
    """Noise of a volume from the mean of a rest, as a share of the volume."""
    return max(one.noise / (one.before + gas.atmosphere) / sqrt(one.resting) for one in strokes)


def _room(cells: Mapping[float, Sequence[Stroke]], gas: Gas) -> tuple[dict[float, Array], bool]:
    """Change of the volumes [m3] by the room pressure at which the start pressures agree best, and whether it is
    significant.
    """
    n = len(next(iter(cells.values()))[0].x)
    if len(cells) < 2:
        return {P: np.zeros(n) for P in cells}, False

    def mean_of(other: Gas) -> Array:
        each = [[one.volumes(other, leak=True).mean(axis=0) for one in strokes] for strokes in cells.values()]
        return np.array([np.mean(one, axis=0) for one in each])

    step = 100.0
    V = mean_of(gas)
    slope = (mean_of(replace(gas, atmosphere=gas.atmosphere + step)) - V) / step
    off, apart = slope - slope.mean(axis=0), V - V.mean(axis=0)
    power = float(np.sum(off**2))
    shift = -float(np.sum(off * apart)) / power if power else 0.0
    noise = max(_noise(strokes, gas) / sqrt(len(strokes)) for strokes in cells.values())
    error = noise * float(V.mean()) * sqrt(n) / sqrt(power) if power else 0.0
    size = abs(shift) + 2 * error
    return {P: one * size for P, one in zip(cells, slope, strict=True)}, abs(shift) > SURE * error
