"""One trial of a closed volume: absolute pressures on a grid of contractions, the volumes that follow, and the fit of
V(eps).

P_abs V^k of a closed mass is constant (paper 3, chamber equation without flow): V + V_d = (V_0 + V_d) (m/m_0)
(P_0/P)^(1/k), P absolute: gauge reading plus room pressure. m/m_0 is 1 in the paper; a leak into the room takes dm/dt =
-c P_gauge P^(1/k - 1), with c from the pressure after return to the start.

V(eps) is that of the modified Daerden model, V = (pi/4) D0^2 l0 [1/sin^2 theta0 - (1 - eps)^alpha / tan^2 theta0] (1 -
eps) (paper 3). For a given alpha it is linear in D0^2/sin^2 theta0 and D0^2/tan^2 theta0, so only alpha is searched,
without start values.

Where P V = const does not hold for the enclosed air, volumes differ: between both directions by a lag (heat, a slow
sensor), at the start between two cycles by a leak that is not proportional to the pressure, between start pressures by
a wrong room pressure.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
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


def moved_by(eps: Array, V: Array, length: float, spreads: Iterable[Spread]) -> tuple[float, float, float]:
    """Changes of D0 [m], theta0 [rad] and alpha [1] of `fit_volume` by what the strokes leave open."""
    apart, aside = (np.mean(each, axis=0) for each in zip(*((one.apart, one.aside) for one in spreads), strict=True))
    # the differences may change sign over the contractions: tried as cosines with 0 to 4 half waves
    shapes = [apart * np.cos(order * np.pi * np.linspace(0.0, 1.0, len(V))) for order in range(5)]
    base, *fits = (fit_volume(eps, V * (1 + shape), length) for shape in (np.zeros(len(V)), *shapes, 2 * aside))
    D_0, theta_0, alpha = (hypot(*(fit[i] - base[i] for fit in fits if fit)) if base else 0.0 for i in range(3))
    return D_0, theta_0, alpha


SURE = 5.0
"""Standard deviations from which on a difference is significant."""
UNSEEN = 1e-4
"""Difference between gauge and drive that is tolerated [m]."""
APART = (
    "strokes there and back, returns to the start, rests at the far end and start pressures leave up to {} of the "
    "volume open: heat, a leak that changes, a pressure that comes late, a wrong pressure of the room, or a zero. "
    "Move more slowly, rest longer, read a barometer, and check the zero"
)
PLACE = (
    "at rest the displacement is not where the drive was sent, which is worth up to {} of the volume: the zero or the "
    "scale of the gauge or of the drive is wrong. Check them"
)


@dataclass(frozen=True, eq=False)
class Spread:
    """What the strokes from one start pressure leave open: shares of the volume at each contraction, shape (n,)."""

    apart: Array
    """Differences of ways and returns, motion at the far end, and the pressure of the room."""
    seen: bool
    aside: Array
    """A displacement that differs from the commanded position."""
    off: bool
    leaked: Array
    """Excess of the volume without correction for the leak."""

    def doubts(self, e: Estimate, place: int, *, leak: bool) -> list[Doubt]:
        """Effects on the volume at the contraction with the index `place`."""
        size = abs(e.value or 0.0)
        found = [
            Doubt(name, "method", size * float(share[place]), seen, reason.format(f"{float(share.max()):.2%}"))
            for name, share, seen, reason in (
                ("volumes that differ", self.apart, self.seen, APART),
                ("place of the drive", self.aside, self.off, PLACE),
            )
        ]
        if not leak:
            lost = abs(float(self.leaked[place]))
            reason = f"no leak is taken out, and what leaked makes the volume {lost:.2%} larger. Look for the leak"
            found.append(Doubt("leak", "method", size * lost, seen=True, reason=reason))
        return found


def spreads_of(cells: Mapping[float, Sequence[Stroke]], gas: Gas) -> dict[float, Spread]:
    """The spread by start pressure [Pa]."""
    each = {P: np.array([one.by(one.P, one.paid, gas) for one in strokes]) for P, strokes in cells.items()}
    means = {P: V.mean(axis=(0, 1)) for P, V in each.items()}
    noises = {P: _noise(strokes, gas) for P, strokes in cells.items()}
    low, high = min(cells), max(cells)
    room = means[high] - means[low]
    between = float(np.abs(room / means[low]).max()) > SURE * max(noises.values())
    # a wrong room pressure acts as the inverse of the absolute start pressure
    ends = (low + gas.atmosphere) * (high + gas.atmosphere) / max(high - low, 1.0)
    found = {}
    for P, strokes in cells.items():
        V, noise, by_room = means[P], noises[P], room * ends / (P + gas.atmosphere)
        gaps = (each[P][:, 0::2] - each[P][:, 1::2]).reshape(-1, len(V)) / V
        gap = np.abs(gaps.mean(axis=0))
        returns = np.array([one.by(one.returns[:, 0], one.returns[:, 1], gas) for one in strokes]) / gas.reference - 1
        most = float(np.abs(returns.mean(axis=0)).max(initial=0.0))
        further = left([held for one in strokes for held in one.far])
        still = further.most / (float(np.mean([one.P[:, -1].mean() for one in strokes])) + gas.atmosphere)
        seen = float(gap.max()) > SURE * noise * sqrt(2 / len(gaps)) or most > SURE * noise * sqrt(1.5 / len(strokes))
        apart = np.sqrt((0.5 * gap) ** 2 + most**2 + still**2 + (by_room / V) ** 2)
        plain = np.mean([one.volumes(gas, leak=False).mean(axis=0) for one in strokes], axis=0)
        found[P] = Spread(apart, seen or further.seen or between, *_aside(strokes, V), plain / V - 1)
    return found


def _aside(strokes: Sequence[Stroke], V: Array) -> tuple[Array, bool]:
    """Effect of a displacement that differs from the commanded position, as a share, and whether it is significant.

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
