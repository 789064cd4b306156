"""One trial of a closed volume: absolute pressures on a grid of contractions, and the volumes that follow; no campaign.

P_abs V^k of a closed mass is constant (paper 3, chamber equation without flow): V + V_d = (V_0 + V_d) (m/m_0)
(P_0/P)^(1/k), P absolute: the room's pressure is added to what gauges read. m/m_0 is 1 as the paper prints it; a leak
into the room takes dm/dt = -c P_gauge P^(1/k - 1), and c follows from the pressure back at the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.samples import UNUSABLE_SHARE, Held, NotUsable, noise_of, on_time
from pmabench.store.records import Array, RunData, TrialData

FOLLOWS = 0.01
"""Fall of the absolute pressure over a stroke, as a share, below which the valve counts as open."""
FEWEST = 5
"""Samples of a stroke about each contraction."""


@dataclass(frozen=True)
class Gas:
    """What is known apart from the pressure: volumes [m3], the room's pressure [Pa absolute], k [1]."""

    reference: float
    dead: float
    atmosphere: float
    exponent: float


@dataclass(frozen=True, eq=False)
class Stroke:
    """Gauge pressures [Pa] of one trial at contractions `x` [m], in the order of time: shape (2 cycles, n)."""

    x: Array
    P: Array
    paid: Array
    """Integral of P_gauge (P_gauge + room)^(1/k - 1) from the start on, as `P`."""
    paid_at_end: float
    before: float
    after: float
    """Gauge pressure at the start, before the first stroke and after the last [Pa]."""
    returns: Array
    """Gauge pressure and `paid` at the start between two cycles, shape (cycles - 1, 2)."""
    far: tuple[Held, ...]
    """The pressure in the rests at the far end."""
    noise: float
    resting: int
    """Samples of a rest whose mean counts."""

    def by(self, P: Array, paid: Array, gas: Gas, *, leak: bool = True) -> Array:
        """V [m3] at gauge pressures P [Pa] and what was `paid` till then, with what leaked taken out or not."""
        begin, power = self.before + gas.atmosphere, 1 / gas.exponent
        lost = 1 - ((self.after + gas.atmosphere) / begin) ** power if leak else 0.0
        kept = 1 - lost * paid / self.paid_at_end
        return np.asarray((gas.reference + gas.dead) * kept * (begin / (P + gas.atmosphere)) ** power - gas.dead)

    def volumes(self, gas: Gas, *, leak: bool) -> Array:
        """V [m3], shape (cycles, n), the mean of both directions; with what leaked taken out or not."""
        V = self.by(self.P, self.paid, gas, leak=leak)
        return np.asarray(0.5 * (V[0::2] + V[1::2]))

    @property
    def lost(self) -> float:
        """Fall of the pressure from before the strokes to after them [Pa]."""
        return self.before - self.after


def measure(run: RunData, trial: TrialData, settings: Mapping[str, Any]) -> Stroke:
    """One trial from its samples; `NotUsable` where it ended early, lacks a channel or was never shut in."""
    if trial.status != "finished":
        raise NotUsable(f"the trial is {trial.status}")
    missing = [name for name in ("pressure", "displacement") if name not in trial.channels]
    if missing:
        raise NotUsable(f"{' and '.join(missing)} not recorded")
    if float(np.mean(~trial.usable)) > UNUSABLE_SHARE:
        raise NotUsable(f"{np.mean(~trial.usable):.0%} of the samples are flagged")
    if not trial.found.get("closed", {}).get("found", False):
        raise NotUsable("the strokes with the valve shut were not finished")
    ramps = [c for c in trial.commands if c.output == "displacement" and c.kind == "ramp" and c.phase == "closed"]
    if len(ramps) < 2 or len(ramps) % 2:
        raise NotUsable("it holds no whole stroke there and back")
    rest, t, good = float(settings["rest"]), trial.t, trial.usable
    x, P = (on_time(run, trial, name) for name in ("displacement", "pressure"))
    arrived = [c.t + abs(c.value - c.before) / c.data["rate"] for c in ramps]

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
    grid = np.asarray(low + every * np.arange(int((high - low) / every + 1e-6) + 1), dtype=np.float64)
    pressures, integrals = [], []
    for ramp, end in zip(ramps, arrived, strict=True):
        rows = np.flatnonzero(good & (t >= ramp.t) & (t <= end + 1e-9))
        values = [_about(x[rows], y[rows], grid, every) for y in (P, paid)]
        pressures.append(values[0])
        integrals.append(values[1])
    stroke = Stroke(
        grid, np.array(pressures), np.array(integrals), float(paid[last].mean()), before, after,
        np.array([[P[rows].mean(), paid[rows].mean()] for rows in between]).reshape(-1, 2),
        tuple(Held.of(t[rows], P[rows], float(t[rows[0]])) for rows in at_far), noise_of(P[first]), len(first),
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
