"""What one trial says by itself, for the display."""

from __future__ import annotations

from math import pi

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.shared.sine_loop import measure as harmonic
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.store.records import RunData, TrialData

DISTORTED = 0.05
"""Rms of what a sine leaves of the displacement, over its own rms, that is doubted."""


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K, and B at this frequency, with what Coulomb friction adds to it: -Im(F/x)/omega = B + 4 F_c/(pi omega A)."""
    settings = run.plan.get("settings") or {}
    P = trial.point.get("pressure")
    try:
        sine = harmonic(run, trial, float(settings.get("discard", 1)))
    except NotUsable as reason:
        return [Measured("K", "stiffness", None), Measured("B", "damping", None)], [str(reason)]
    K_e = B_e = None
    if expected is not None and P is not None:
        K_e = expected.at("K", P)
        B_c, B_r = expected.at("B_c", P), expected.at("B_r", P)
        if B_c is not None and B_r is not None:
            B_e = 0.5 * (B_c + B_r) + 4 * expected.F_c / (pi * sine.speed)
    doubts = []
    if sine.distortion > DISTORTED:
        doubts.append(f"the displacement is no sine: {sine.distortion:.0%} of it is something else")
    asked = trial.point.get("amplitude", settings.get("amplitude"))
    if isinstance(asked, int | float) and asked > 0 and abs(sine.amplitude / asked - 1) > 0.05:
        doubts.append(f"amplitude {show(sine.amplitude, 'length', 3)}, asked for {show(float(asked), 'length', 3)}")
    pressure = None if np.isnan(sine.pressure) else sine.pressure
    return [
        Measured("K", "stiffness", sine.stiffness, K_e),
        Measured("B", "damping", sine.loss / sine.speed, B_e, tolerance=0.25 * B_e if B_e else 0.0),
        Measured("P", "pressure", pressure, P),
        Measured("A", "length", sine.amplitude),
    ], doubts
