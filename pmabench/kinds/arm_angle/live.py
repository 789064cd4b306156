"""What one trial says by itself, for the display."""

from __future__ import annotations

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import DRIFT, Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.arm_angle.stairs import measure as stair_of
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Angle at the preload, the largest one, and by how much both ways are apart at most."""
    try:
        stair = stair_of(run, trial, run.plan.get("settings") or {})
    except NotUsable as reason:
        return [Measured("alpha_0", "angle", None), Measured("alpha_max", "angle", None)], [str(reason)]
    sets = [rest.set for rest in stair.rests if rest.side < 0]
    up, down = stair.column(sets, -1), stair.column(sets, 1)
    noise = 6 * max(rest.noise for rest in stair.rests)
    worst = max(stair.rests, key=lambda rest: abs(rest.drift))
    drifts = abs(worst.drift) > max(DRIFT * float(np.ptp(up)) / 4, noise)
    doubts = [f"the angle still changes by {show(worst.drift, 'angle', 2)}"] if drifts else []
    if up[-1] < up[0]:
        doubts.append("the angle falls where the pressure rises")
    gaps = (down - up)[np.isfinite(down)]
    apart = [Measured("alpha_H", "angle", float(gaps[np.argmax(np.abs(gaps))]), noise=noise)] if len(gaps) else []
    return [
        Measured("alpha_0", "angle", float(up[0]), noise=noise),
        Measured("alpha_max", "angle", float(up.max()), noise=noise),
        *apart,
    ], doubts
