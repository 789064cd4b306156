"""F_ce from sines about several means at one pressure; knows what the harmonics said at each mean, no samples.

The force over contraction of a muscle is bent most near x = 0, so that what a sine says of its own mean is not carried
far. Where one of the strokes holds x = 0, a cubic with that sine's harmonics is taken there, and how far a cubic
through all means (force and stiffness at each) lies from it bounds what both leave out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np

from pmabench.analysis.shared.calibration import sentences
from pmabench.base.quantities import show
from pmabench.kinds.sinusoidal_displacement.form import BETTER, Form
from pmabench.store.analyses.results import Estimate, Parts, withhold

SINE_CENTRES = "sine-centres"
FEWEST = 3
"""Means that a cubic needs, with force and stiffness at each: six values for four terms."""
APART = 1e-6
"""Means nearer to each other are one [m]."""
AGREE = 0.05
"""Share of F_ce that both cubics may lie apart; beyond it neither holds."""


@dataclass(frozen=True)
class Centre:
    """What the sines of one pressure, mean and amplitude say at their mean."""

    F: Estimate
    K: Estimate
    form: Form

    @property
    def mean(self) -> float:
        """[m]."""
        return self.form.mean

    @property
    def at_0(self) -> float:
        """The cubic with this sine's harmonics at x = 0 [N]."""
        r = self.form.reach
        bent = 2 * self.form.h2 * r**2 - 4 * self.form.h3 * r**3
        return (self.F.value or 0.0) + (self.K.value or 0.0) * self.mean + bent

    def part(self, name: str) -> float | None:
        """A part of the half width of `at_0` [N]."""
        force, stiffness = (getattr(e.parts, name) for e in (self.F, self.K))
        if force is None or stiffness is None:
            return None if force is None else float(force)
        return hypot(force, stiffness * self.mean)

    @property
    def harmonics(self) -> float:
        """What the half widths of the harmonics make of `at_0` [N]."""
        h2, h3, _ = self.form.half
        return hypot(2 * h2 * self.form.reach**2, 4 * h3 * self.form.reach**3)


def centre_of(found: Sequence[Estimate], form: Form) -> Centre | None:
    """From the estimates of one cell; None where force or stiffness at its mean is withheld."""
    known = {e.symbol: e for e in found if e.value is not None and not e.coordinate and "frequency" not in e.at}
    return Centre(known["F"], known["K"], form) if {"F", "K"} <= set(known) else None


def through_centres(at: Mapping[str, float], centres: Sequence[Centre]) -> Estimate | None:
    """F_ce [N] at the pressure of `at`; None with too few means, or none whose stroke holds x = 0."""
    means = np.unique(np.round([one.mean for one in centres], 6))
    near = [one for one in centres if one.form.holds_0]
    if len(means) < FEWEST or not near or np.ptp(means) < APART:
        return None
    nearest = min(near, key=lambda one: abs(one.mean))
    through = _cubic_at_0(centres)
    value, apart = nearest.at_0, abs(nearest.at_0 - through)
    method = hypot(nearest.part("method") or 0.0, apart, nearest.harmonics)
    parts = Parts(nearest.part("repeats"), method, nearest.part("calibration"), nearest.part("skew") or 0.0)
    note = sentences(
        f"{len(means)} means: those about {show(nearest.mean, 'length', 3)} carried to x = 0 ({nearest.form.shares})"
        f", {show(apart, 'force', 2)} from the cubic through all",
        nearest.F.note,
    )
    names = tuple(name for one in centres for name in one.F.trials)
    F_ce = Estimate("F_ce", value, "N", "force", SINE_CENTRES, dict(at), parts, len(names), note=note, trials=names)
    if apart <= AGREE * abs(value):
        return F_ce
    return withhold(
        F_ce,
        f"a cubic through the sines about {len(means)} means gives {show(through, 'force', 4)} at x = 0, the harmonics "
        f"of the nearest {show(value, 'force', 4)}: the curve is no cubic; {BETTER}",
    )


def _cubic_at_0(centres: Sequence[Centre]) -> float:
    """At x = 0 the cubic through force and stiffness at all means [N], each weighted by its half width."""
    rows, values, weights = [], [], []
    for one in centres:
        x = one.mean
        for row, e, sign in (([1.0, x, x**2, x**3], one.F, 1.0), ([0.0, 1.0, 2 * x, 3 * x**2], one.K, -1.0)):
            size = abs(e.value or 0.0)
            rows.append(row)
            values.append(sign * (e.value or 0.0))
            weights.append(1 / max(e.parts.combined or 0.0, 1e-3 * size, 1e-9))
    weight = np.array(weights)
    scale = np.array([1.0, 1e-2, 1e-4, 1e-6])
    design = np.array(rows) / scale * weight[:, None]
    fitted = np.linalg.lstsq(design, np.array(values) * weight, rcond=None)[0]
    return float(fitted[0])
