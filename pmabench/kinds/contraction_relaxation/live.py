"""One trial of contraction and relaxation: x_inf, tau, K and F_ce as known so far."""

from __future__ import annotations

import numpy as np

from pmabench.analysis.shared.student import half_width
from pmabench.analysis.trial import DRIFT, Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.exponentials import regress, steps_of
from pmabench.kinds.contraction_relaxation.segments import Gate, samples_of
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """x_inf and tau of the contraction; K and F_ce from the loads done so far at this pressure.

    At the end of a contraction K x_inf = F_ce - F_c - F_L, so the line over loads gives F_ce - F_c; the prediction that
    is compared with it is reduced by F_c, too.
    """
    if "displacement" not in trial.channels or "pressure" not in trial.channels or len(trial.t) < 2:
        return [], ["pressure or displacement is not recorded"]
    if "from" in trial.point:
        return _single_step(run, trial)
    P, load = trial.point.get("pressure", 0.0), trial.point.get("load", 0.0)
    steps = steps_of([(samples_of(run, trial, 0), trial)], Gate.lift)
    step = next((s for s in steps if s.phase == "contract"), None)
    K_e, F_e = (expected.at(name, P) if expected else None for name in ("K", "F_ce"))
    slip = expected.F_c if expected else 0.0
    pull = F_e - slip - load if F_e is not None else None  # F_ce - F_c - F_L, which is K x_inf
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
    x_e, tolerance = pull / K_e if pull is not None and K_e else None, slip / K_e if K_e else 0.0
    found = [
        Measured("x_inf", "length", x, expected=x_e, tolerance=tolerance, noise=20e-6),
        Measured("tau", "time", step.fit.tau, noise=0.01),
    ]
    rest = F_e - slip if F_e is not None else None
    if line is not None:
        half = half_width(line.se_K, line.n - 2)
        found.append(Measured("K", "stiffness", line.K, K_e, pooled=True, half=half))
        found.append(Measured("F_ce", "force", line.F_ce, rest, tolerance=slip, pooled=True))
    else:
        one_K = pull / x if pull is not None and pull > 0 else None
        one_F = load + K_e * x if K_e is not None else None
        found.append(Measured("K", "stiffness", one_K, K_e, assumed=True, pooled=True))
        found.append(Measured("F_ce", "force", one_F, rest, assumed=True, pooled=True))
    return found, doubts


def _single_step(run: RunData, trial: TrialData) -> Found:
    """x_max and tau of one of paper 1's steps; K of a contraction, with F_ce from the braid."""
    from pmabench.kinds.contraction_relaxation.paper1_steps import STILL, Braid, read  # 50 MB with all models

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
    """Warning if the displacement still moves at the end of the contraction; else empty."""
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
