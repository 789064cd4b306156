"""Single steps as paper 1 reads them: stroke, time constant, stiffness from the braid; K and B_c with F_ce known.

One load cannot tell F_ce from K x: every solution of F_L = F_ce - K x - B x' can be scaled. F_ce from elsewhere settles
it; K and B are then fitted to all contractions at once as in `pooled`. Knows samples and geometry; no interval.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import exp
from typing import Any

import numpy as np

from pmabench.analysis.shared.samples import LEAST, Samples, onset
from pmabench.kinds.contraction_relaxation.pooled import FLOOR, SYMBOLS, design_of, first_knots, prior_of
from pmabench.kinds.contraction_relaxation.segments import Gate, cut
from pmabench.model.library.braid import braid_force
from pmabench.store.records import Array, TrialData

FEWEST = 3
"""Fewest segments near a pressure for a coefficient there."""


def fit_known_force(
    samples: Sequence[Samples], rate: float, tested: Array, force: Callable[[Array], Array]
) -> dict[float, tuple[float, float]]:
    """K [N/m] and B_c [N.s/m] at the tested pressures [Pa] where samples move near them, from contractions alone.

    `force` gives F_ce [N] at pressures [Pa]. Friction, which always points one way here, is held for less F_ce.
    """
    knots = first_knots(tested, np.empty(0))
    gate = Gate()
    segments = cut(samples, rate, gate)
    low, high = knots[0] - 1e3, knots[-1] + (knots[-1] - knots[-2])
    segments = segments.where((segments.way > 0) & (segments.P.min(axis=1) >= low) & (segments.P.max(axis=1) <= high))
    if len(segments) < FEWEST:
        return {}
    design = design_of(segments, knots)
    k = len(knots)
    wanted = slice(SYMBOLS.index("K") * k, (SYMBOLS.index("B_c") + 1) * k)
    known = force(segments.P) @ segments.weights
    noise = FLOOR * float(np.sqrt(np.mean(known**2)))
    prior = prior_of(segments, design, knots, noise)
    rows = prior[np.any(prior[:, wanted] != 0, axis=1)][:, wanted]
    columns = np.vstack([design[:, wanted], rows])
    target = np.concatenate([segments.force - known, np.zeros(len(rows))])
    theta = np.linalg.lstsq(columns, target, rcond=None)[0]
    found = {}
    for P in tested:
        knot = int(np.argmin(np.abs(knots - P)))
        near = np.abs(segments.pressure - P) <= 0.5 * float(np.min(np.abs(np.delete(knots, knot) - P)))
        if near.sum() >= FEWEST:
            found[float(P)] = float(theta[knot]), float(theta[k + knot])
    return found


SHARE = 1 - exp(-1)
"""Share of the stroke that is reached after one time constant, 0.63212."""
SETTLED = 0.2
"""The ends of a stroke are means over this last share of a hold."""
STILL = 2e-3
"""Share of the stroke that may still be moved within that time."""
LEAST_STROKE = 0.2e-3
"""Steps that move less are not read [m]."""


@dataclass(frozen=True)
class Braid:
    """What F_ce is computed from [m, rad]: F = pi r0^2 P (a (1 - x / L0)^2 - b) (paper 1 eqs. 5-10)."""

    radius: float
    nominal_length: float
    braid_angle: float

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Braid:
        """From the settings of a plan."""
        return cls(*(float(settings[name]) for name in ("radius", "nominal_length", "braid_angle")))

    def force(self, P: Array | float, x: Array | float) -> Array:
        """F_ce [N] at pressures P [Pa gauge] and contractions x [m], not below 0; broadcast."""
        P, x = np.broadcast_arrays(np.asarray(P, dtype=np.float64), np.asarray(x, dtype=np.float64))
        one = np.ones(P.shape)
        return braid_force(P, x / self.nominal_length, self.radius * one, self.braid_angle * one, one)[0]

    def stiffness(self, P: float, x_max: float, load: float, at: str) -> float:
        """S = (F_ce - L) / x_max [N/m], F_ce at x = 0 (`x0`) or at x_max (`xmax`); 0 or less: no pull is left."""
        return (float(self.force(P, x_max if at == "xmax" else 0.0)) - load) / x_max


@dataclass(frozen=True)
class Step:
    """One trial, read. `way` is +1 from 0 to `pressure`, -1 from there to 0 [Pa, commanded]."""

    trial: int
    way: int
    pressure: float
    held: float
    """Pressure measured at the end of the contraction, or before the release [Pa]."""
    load: float
    stroke: float
    """x_max of a contraction, what a relaxation gives back [m]."""
    t_d: float
    """From the command to the first motion [s]."""
    tau: float
    """From the first motion to 63.2 % of the stroke [s]."""
    creeps: float
    """Share of the stroke that it still moves in the last part of the hold."""


def read(samples: Samples, trial: TrialData) -> Step | str:
    """The trial's step, or why there is none."""
    high, start = trial.point.get("pressure", 0.0), trial.point.get("from", 0.0)
    way = 1 if high > start else -1
    phase = "contract" if way > 0 else "relax"
    command = next((c for c in trial.commands if c.output == "pressure" and c.phase == phase), None)
    if command is None:
        return f"no pressure is commanded in the phase {phase}"
    before = samples.ok & (samples.t < command.t - 1e-9)
    after = samples.ok & (samples.t >= command.t - 1e-9)
    last = after & (samples.t > samples.t[-1] - SETTLED * (samples.t[-1] - command.t))
    if before.sum() < 8 or last.sum() < 8:
        return "too few usable samples before the step or at its end"
    origin, end = float(np.mean(samples.x[before])), float(np.mean(samples.x[last]))
    stroke = way * (end - origin)
    if stroke < LEAST_STROKE:
        return f"too little motion: {1e3 * stroke:.3g} mm"
    gone = way * (samples.x - origin)
    begun = onset(samples.t[samples.ok], gone[samples.ok], command.t, LEAST["displacement"])
    rows = np.flatnonzero(after)
    beyond = np.flatnonzero(gone[rows] >= SHARE * stroke)
    if begun is None or not len(beyond) or beyond[0] == 0:
        return "the first motion, or 63.2 % of the stroke, is not seen"
    left, right = rows[beyond[0] - 1], rows[beyond[0]]
    reached = float(np.interp(SHARE * stroke, gone[[left, right]], samples.t[[left, right]]))
    half = np.flatnonzero(last)
    middle = len(half) // 2
    creep = 2 * way * float(np.mean(samples.x[half[middle:]]) - np.mean(samples.x[half[:middle]]))
    held = float(np.mean(samples.P[last if way > 0 else before]))
    return Step(
        trial=samples.trial,
        way=way,
        pressure=max(high, start),
        held=held,
        load=samples.load,
        stroke=stroke,
        t_d=begun - command.t,
        tau=reached - begun,
        creeps=creep / stroke,
    )
