"""One trial at rest: static load, isometric, free contraction, closed volume, angle of an arm."""

from __future__ import annotations

import numpy as np

from pmabench.analysis.shared.rest import left
from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.statics.arm_stairs import measure as stair_of
from pmabench.analysis.statics.closed_stroke import Gas
from pmabench.analysis.statics.closed_stroke import measure as stroke_of
from pmabench.analysis.statics.closed_volume import LEAKS
from pmabench.analysis.statics.free_contraction import measure as rest_of
from pmabench.analysis.statics.isometric_curve import PHASES, begins
from pmabench.analysis.statics.isometric_lines import as_test
from pmabench.analysis.statics.isometric_pressurisation import cell_of, lack
from pmabench.base.quantities import show
from pmabench.display.expected import Expected
from pmabench.display.quantities import DRIFT, Found, Measured, Quick
from pmabench.store.records import RunData, TrialData


def static_load(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Pressures at which the load lifts and sets down, their mean, and half the difference."""
    doubts: list[str] = []
    found: dict[str, float | None] = {}
    for phase in ("lift", "set-down"):
        result = trial.found.get(phase)
        value = result.get("pressure") if result and result.get("found", True) else None
        found[phase] = float(value) if isinstance(value, int | float) else None
        if result is not None and found[phase] is None:
            doubts.append(f"{phase}: {result.get('reason') or 'nothing found'}")
        elif result is None:
            doubts.append(f"{phase} was not looked for")
    lift, down = found["lift"], found["set-down"]
    load = trial.point.get("load")
    predicted = expected.lifts(load) if expected is not None and load is not None else None
    both = lift is not None and down is not None
    middle = 0.5 * (lift + down) if lift is not None and down is not None else None
    half = 0.5 * (lift - down) if lift is not None and down is not None else None
    if both and half is not None and half < 0:
        doubts.append("it sets down at a higher pressure than it lifts")
    return [
        Measured("lift", "pressure", lift, noise=1e3),
        Measured("set-down", "pressure", down, noise=1e3),
        Measured("mean", "pressure", middle, predicted, tolerance=3e3, noise=1e3),
        Measured("half", "pressure", half, noise=2e3),
    ], doubts


def isometric(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
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


def free_contraction(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
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


def closed_volume(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
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


def arm_angle(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
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
