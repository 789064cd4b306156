"""What one trial says by itself, for the display."""

from __future__ import annotations

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.closed_volume.reduction import LEAKS
from pmabench.kinds.closed_volume.stroke import Gas
from pmabench.kinds.closed_volume.stroke import measure as stroke_of
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """The volume at the end of the stroke, and the pressure that leaks away over the trial."""
    settings = run.plan.get("settings") or {}
    try:
        stroke = stroke_of(run, trial, settings)
    except NotUsable as reason:
        return [Measured("V", "volume", None)], [str(reason)]
    gas = Gas(*(float(settings[name]) for name in ("reference_volume", "dead_volume", "atmosphere", "exponent")))
    V = stroke.volumes(gas, leak=True)[:, -1]
    share = stroke.lost / (stroke.before + gas.atmosphere)
    return [Measured("V", "volume", float(V.mean())), Measured("leak", "pressure", stroke.lost, noise=stroke.noise)], (
        [f"{share:.1%} of the air is lost over the trial"] if share > LEAKS else []
    )
