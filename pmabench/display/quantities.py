"""What one trial says by itself, by kind of run, with the same functions that `process` uses; no intervals.

Knows trials and the prediction that stands beside them; judges nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from math import pi
from typing import Any

import numpy as np

from pmabench.base.quantities import show
from pmabench.display.expected import Expected
from pmabench.store.records import RunData, TrialData

DRIFT = 0.02
"""Share of a step that the last fifth of its hold may still move."""
DISTORTED = 0.05
"""Rms of what a sine leaves of the displacement, over its own rms, that is doubted."""


@dataclass(frozen=True)
class Measured:
    """One quantity of a trial [SI]."""

    symbol: str
    quantity: str
    value: float | None
    expected: float | None = None
    tolerance: float = 0.0
    """What friction may take away from the prediction [SI]."""
    noise: float = 0.0
    """Differences smaller than this between repeats mean nothing [SI]."""
    assumed: bool = False
    pooled: bool = False
    """Whether earlier trials are in it, so that it cannot be held against them."""


Found = tuple[list[Measured], list[str]]
"""Quantities, and what the samples themselves say against the trial."""


@dataclass
class Quick:
    """What is remembered: load [N] and final contraction [m] of each trial, by pressure [Pa]."""

    ends: dict[float, dict[int, tuple[float, float]]] = field(default_factory=dict)


_NEEDS = {
    "contraction-relaxation": ("contraction.segments", "contraction.steps"),
    "sinusoidal-displacement": ("driven.sine_loop",),
    "ultimate-gain": ("loops.gain_levels", "loops.relay_levels", "loops.open_loop"),
    "positioning": ("loops.positioning",),
    "validation": ("loops.validation",),
    "isobaric-ramp": ("driven.ramp_loop",),
    "step-displacement": ("driven.step_relaxation",),
    "isometric-pressurisation": ("statics.isometric_pressurisation",),
    "closed-volume": ("statics.closed_volume",),
    "free-contraction": ("statics.free_contraction",),
    "arm-angle": ("statics.arm_stairs",),
}
"""Kind of run -> modules of the analysis that its rule uses."""


def prepare(kind: str) -> None:
    """Import what the rule of a kind needs, which takes a second; so that the first trial's line holds up no key."""
    for name in _NEEDS.get(kind, ()):
        import_module(f"pmabench.analysis.{name}")


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """The quantities of a trial and what its own samples say against it; none for kinds without a rule."""
    rule = _RULES.get(run.kind)
    return rule(run, trial, expected, quick) if rule is not None else ([], [])


def _contraction(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """x_inf and tau of the contraction; K and F_ce over the loads of this pressure so far.

    Where a contraction comes to rest K x_inf = F_ce - F_c - F_L; the line over loads thus gives F_ce - F_c, and so is
    the prediction beside it.
    """
    from pmabench.analysis.contraction.segments import Gate, samples_of
    from pmabench.analysis.contraction.steps import regress, steps_of

    if "displacement" not in trial.channels or "pressure" not in trial.channels or len(trial.t) < 2:
        return [], ["pressure or displacement is not recorded"]
    if "from" in trial.point:
        return _single_step(run, trial)
    P, load = trial.point.get("pressure", 0.0), trial.point.get("load", 0.0)
    step = next((s for s in steps_of(samples_of(run, trial, 0), trial, Gate.lift) if s.phase == "contract"), None)
    K_e, F_e = (expected.at(name, P) if expected else None for name in ("K", "F_ce"))
    slip = expected.F_c if expected else 0.0
    pull = F_e - slip - load if F_e is not None else None  # what is left where the contraction comes to rest
    doubts: list[str] = []
    if step is None:
        if pull is None or pull > slip:
            doubts.append("no contraction step: the muscle did not lift the load")
        names = (("x_inf", "length"), ("tau", "time"), ("K", "stiffness"), ("F_ce", "force"))
        return [Measured(name, quantity, None) for name, quantity in names], doubts
    x = step.fit.end
    doubts += _drift(trial, step.fit.start)
    if trial.status == "finished":
        quick.ends.setdefault(round(P), {})[trial.index] = load, x
    ends = np.array(list(quick.ends.get(round(P), {}).values()))
    line = regress(ends[:, 0], ends[:, 1]) if len(ends) else None
    found: list[Measured] = [
        Measured(
            "x_inf",
            "length",
            x,
            expected=pull / K_e if pull is not None and K_e else None,
            tolerance=slip / K_e if K_e else 0.0,
            noise=20e-6,
        ),
        Measured("tau", "time", step.fit.tau, noise=0.01),
    ]
    rest = F_e - slip if F_e is not None else None
    if line is not None:
        found.append(Measured("K", "stiffness", line.K, K_e, pooled=True))
        found.append(Measured("F_ce", "force", line.F_ce, rest, tolerance=slip, pooled=True))
    else:
        one_K = pull / x if pull is not None and pull > 0 else None
        one_F = load + K_e * x if K_e is not None else None
        found.append(Measured("K", "stiffness", one_K, K_e, assumed=True, pooled=True))
        found.append(Measured("F_ce", "force", one_F, rest, assumed=True, pooled=True))
    return found, doubts


def _single_step(run: RunData, trial: TrialData) -> Found:
    """x_max and tau of one of paper 1's steps; K of a contraction, with F_ce from the braid."""
    from pmabench.analysis.contraction.contraction_paper1_steps import STILL, Braid, read
    from pmabench.analysis.contraction.segments import samples_of

    asked = (run.plan.get("settings") or {}).get("reduction") or {}
    step = read(samples_of(run, trial, 0), trial)
    if isinstance(step, str):
        return [Measured("x_max", "length", None), Measured("tau", "time", None)], [step]
    found = [Measured("x_max", "length", step.stroke, noise=20e-6), Measured("tau", "time", step.tau, noise=0.01)]
    if step.way > 0 and asked:
        K = Braid.of(asked).stiffness(step.held, step.stroke, step.load, str(asked.get("F_ce_at", "x0")))
        found.append(Measured("K", "stiffness", K))
    doubts = []
    if abs(step.creeps) > STILL:
        doubts.append(f"still drifting: {100 * abs(step.creeps):.2g} % of its stroke at the end of the hold")
    return found, doubts


def _drift(trial: TrialData, start: float) -> list[str]:
    """Whether the displacement still moves at the end of the contraction."""
    commands = [c for c in trial.commands if c.output == "pressure"]
    first = next((i for i, c in enumerate(commands) if c.phase == "contract"), None)
    if first is None:
        return []
    begin, end = commands[first].t, commands[first + 1].t if first + 1 < len(commands) else float(trial.t[-1])
    late = (trial.t > end - (end - begin) / 5) & (trial.t < end) & trial.usable
    t, x = trial.t[late], trial.channels["displacement"][late]
    if len(t) < 20:
        return []
    half = len(t) // 2
    moved = 2 * (float(x[half:].mean()) - float(x[:half].mean()))
    size = abs(float(x.mean()) - start)
    if abs(moved) <= DRIFT * size:
        return []
    return [f"still drifting: {show(moved, 'length', 2)} in the last {t[-1] - t[0]:.1f} s"]


def _static(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
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


def _sine(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K, and B at this frequency, with what Coulomb friction adds to it: -Im(F/x)/omega = B + 4 F_c/(pi omega A)."""
    from pmabench.analysis.driven.sine_loop import measure as harmonic
    from pmabench.analysis.shared.samples import NotUsable

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


def _gain(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Ultimate gain and period of one search."""
    from pmabench.analysis.loops.gain_levels import examine
    from pmabench.analysis.loops.open_loop import examine as examine_steps
    from pmabench.analysis.loops.open_loop import steps_of
    from pmabench.analysis.loops.relay_levels import examine as examine_relay
    from pmabench.analysis.loops.relay_levels import search_of
    from pmabench.model.loop import ultimate

    relay = search_of(trial)
    if steps_of(trial) and {"pressure", "displacement"} <= set(trial.channels):
        by_steps = examine_steps(run, trial)
        truth = None if by_steps.loop is None else ultimate(by_steps.loop)
        both = (None, None) if truth is None else (truth.gain, truth.period)
        return [Measured("K_u", "gain", both[0]), Measured("T_u", "time", both[1])], [
            *by_steps.refused,
            *by_steps.doubts,
        ]
    if relay is not None and "displacement" in trial.channels:
        by_relay = examine_relay(run, trial, relay)
        best = None if by_relay.refused else by_relay.best
        told = (float("nan"), float("nan")) if best is None else (best.K_u, best.T_u)
        values = [None if np.isnan(value) else float(value) for value in told]
        return [Measured("K_u", "gain", values[0]), Measured("T_u", "time", values[1])], [
            *by_relay.refused,
            *by_relay.doubts,
        ]
    search: Any = next((found for found in trial.found.values() if found.get("levels")), None)
    if search is None or "displacement" not in trial.channels:
        return [Measured("K_u", "gain", None), Measured("T_u", "time", None)], ["no levels of gain are recorded"]
    seen = examine(run, trial, search)
    K_u, T_u = (None if np.isnan(value) else float(value) for value in (seen.K_u, seen.T_u))
    reasons = [*seen.refused, *seen.doubts]
    return [Measured("K_u", "gain", K_u), Measured("T_u", "time", T_u)], reasons


def _isobaric(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K of the mean curve, the gap of its branches at mid stroke, and the pressure."""
    from pmabench.analysis.driven.ramp_loop import measure_as_planned
    from pmabench.analysis.shared.samples import NotUsable

    P, speed = trial.point.get("pressure"), trial.point.get("speed", 0.0)
    try:
        loop = measure_as_planned(run, trial, {})
    except NotUsable as reason:
        return [Measured("K", "stiffness", None), Measured("H", "force", None)], [str(reason)]
    gap = float(loop.middle_gap.mean())
    K_e = gap_e = None
    if expected is not None and P is not None:
        K_e, B_c, B_r = (expected.at(name, P) for name in ("K", "B_c", "B_r"))
        if B_c is not None and B_r is not None:
            gap_e = 2 * expected.F_c + (B_c + B_r) * speed
    doubts = []
    if gap < -max(loop.noise, 1e-3):
        doubts.append("the contracting branch is the upper one: a wrong sign, or force and displacement apart in time")
    return [
        Measured("K", "stiffness", -float(np.polyfit(loop.x, loop.mean.mean(axis=0), 1)[0]), K_e),
        Measured("H", "force", gap, gap_e, tolerance=0.25 * gap_e if gap_e else 0.0, noise=loop.noise),
        Measured("P", "pressure", None if np.isnan(loop.pressure) else loop.pressure, P or None),
    ], doubts


def _position(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Steady-state error and overshoot of a held position, and its limit cycle where it hunts."""
    from pmabench.analysis.loops.positioning import hold_of

    hold = hold_of(run, trial)
    if isinstance(hold, str):
        return [Measured("e_ss", "ratio", None), Measured("OS", "ratio", None)], [hold]
    response = hold.response
    aim = float(hold.law["setpoint"])
    found = [Measured("e_ss", "ratio", response.error / aim), Measured("OS", "ratio", response.overshoot)]
    doubts = [] if response.settling is not None else ["it does not settle in the band"]
    cycle = response.cycle
    if cycle is not None:
        found += [Measured("x_pp", "length", cycle.size), Measured("T_c", "time", cycle.period)]
        what = "stick-slip limit cycle" if cycle.sticks else "it oscillates"
        doubts.append(f"{what}: {show(cycle.size, 'length', 3)} peak to peak, {cycle.period:.3g} s")
    return found, doubts


def _validation(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """The contraction in the window beside the one that the specimen's file expects."""
    from pmabench.analysis.loops.validation import inside_window, unusable

    reason = unusable(run, trial)
    if reason:
        return [Measured("x", "length", None)], [reason]
    x = float(trial.channels["displacement"][inside_window(run, trial)].mean())
    P, load = trial.point.get("pressure", 0.0), trial.point.get("load", 0.0)
    K_e, F_e = (expected.at(name, P) if expected else None for name in ("K", "F_ce"))
    slip = expected.F_c if expected else 0.0
    predicted = (F_e - slip - load) / K_e if F_e is not None and K_e else None
    return [Measured("x", "length", x, predicted, tolerance=slip / K_e if K_e else 0.0, noise=20e-6)], []


def _isometric(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Slope of force over pressure, the pressure at which the force begins, the gap of the ramps, force at the top."""
    from pmabench.analysis.statics.isometric_curve import PHASES, begins
    from pmabench.analysis.statics.isometric_lines import as_test
    from pmabench.analysis.statics.isometric_pressurisation import cell_of, lack

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


def _free(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Contraction at rest, and what was left without pressure before it."""
    from pmabench.analysis.shared.samples import NotUsable
    from pmabench.analysis.statics.free_contraction import measure as rest_of

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


def _arm(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Angle at the preload, the largest one, and by how much both ways are apart at most."""
    from pmabench.analysis.shared.samples import NotUsable
    from pmabench.analysis.statics.arm_stairs import measure as stair_of

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


def _displacement_step(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K from relaxed forces, and the peak of the force beyond them, of the steps away from the start."""
    from pmabench.analysis.driven.step_relaxation import measure as steps_of
    from pmabench.analysis.shared.samples import NotUsable

    P = trial.point.get("pressure")
    try:
        steps = steps_of(run, trial, {}).there
    except NotUsable as reason:
        return [Measured("K", "stiffness", None)], [str(reason)]
    K = float(np.mean([step.static for step in steps]))
    beyond = float(np.mean([abs(step.peak - step.relaxed) for step in steps]))
    drift = max((abs(step.drift) for step in steps if abs(step.drift) > 3 * step.noise), default=0.0)
    doubts = [f"the force still drifts by {show(drift, 'force', 2)}"] if drift > DRIFT * beyond > 0 else []
    return [
        Measured("K", "stiffness", K, expected.at("K", P) if expected is not None and P is not None else None),
        Measured("overshoot", "force", beyond, noise=3 * steps[0].noise),
    ], doubts


def _closed(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """The volume at the end of the stroke, and the pressure that leaks away over the trial."""
    from pmabench.analysis.shared.samples import NotUsable
    from pmabench.analysis.statics.closed_stroke import Gas
    from pmabench.analysis.statics.closed_stroke import measure as stroke_of
    from pmabench.analysis.statics.closed_volume import LEAKS

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


_RULES: dict[str, Callable[..., Found]] = {
    "contraction-relaxation": _contraction,
    "static-load": _static,
    "sinusoidal-displacement": _sine,
    "ultimate-gain": _gain,
    "positioning": _position,
    "validation": _validation,
    "isobaric-ramp": _isobaric,
    "step-displacement": _displacement_step,
    "isometric-pressurisation": _isometric,
    "closed-volume": _closed,
    "free-contraction": _free,
    "arm-angle": _arm,
}
