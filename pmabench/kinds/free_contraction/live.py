"""What one trial says by itself, for the display."""

from __future__ import annotations

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import DRIFT, Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.free_contraction.reduction import measure as rest_of
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Contraction at rest, and what was left without pressure before it."""
    try:
        rest = rest_of(run, trial)
    except NotUsable as reason:
        return [Measured("x", "length", None), Measured("x_0", "length", None)], [str(reason)]
    drifts = abs(rest.drift) > max(DRIFT * abs(rest.x - rest.start), 20e-6, 6 * rest.noise)
    doubts = [f"the length still changes by {show(rest.drift, 'length', 2)}"] if drifts else []
    noise = max(20e-6, 6 * rest.noise)
    return [
        Measured("x", "length", rest.x, noise=noise),
        Measured("x_0", "length", rest.start, noise=noise),
        Measured("P", "pressure", rest.pressure, trial.point["pressure"] or None, tolerance=2e3, noise=1e3),
    ], doubts
