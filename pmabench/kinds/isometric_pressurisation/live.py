"""What one trial says by itself, for the display."""

from __future__ import annotations

import numpy as np

from pmabench.analysis.shared.isometric_lines import as_test
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.isometric_pressurisation.curve import PHASES, begins
from pmabench.kinds.isometric_pressurisation.reduction import cell_of, lack
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Slope of force over pressure, the pressure at which the force begins, the gap of the ramps, force at the top."""
    test, reason = as_test(run, trial, PHASES)
    reason = reason if test is None else lack(test)
    if test is None or reason:
        return [Measured("m", "force per pressure", None), Measured("p_0", "pressure", None)], [reason]
    cell = cell_of(trial.point["contraction"], [test])
    found = [value for value in begins(trial) if value is not None]
    top = float(test.P.max())
    F_e, K_e = (expected.at(name, top) if expected else None for name in ("F_ce", "K"))
    pull = F_e - K_e * cell.contraction if F_e is not None and K_e is not None else None
    doubts = [] if cell.pooled is not None else ["force over pressure has no straight part"]
    line = cell.pooled.line if cell.pooled else None
    return [
        Measured("m", "force per pressure", line.m if line else None),
        Measured("p_0", "pressure", float(np.mean(found)) if found else None, noise=1e3),
        Measured("H", "force", float(cell.mean.gaps(cell.low or 0.0)[0]), noise=1.0),
        Measured("F", "force", float(test.F.max()), pull, tolerance=2 * expected.F_c if expected else 0.0),
    ], doubts
