"""What one trial says by itself, for the display."""

from __future__ import annotations

from pmabench.analysis.shared.samples import NotUsable, left
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
    further = left([rest.hold])
    moves = further.seen and abs(further.size) > max(DRIFT * abs(rest.x - rest.start), 20e-6)
    doubts = [f"the length would still change by {show(further.size, 'length', 2)}"] if moves else []
    noise = max(20e-6, 6 * rest.noise)
    return [
        Measured("x", "length", rest.x, noise=noise),
        Measured("x_0", "length", rest.start, noise=noise),
        Measured("P", "pressure", rest.pressure, trial.point["pressure"] or None, tolerance=2e3, noise=1e3),
    ], doubts
