"""One trial of a loop: ultimate gain and period, a held position; and one beside the model that the plan carries."""

from __future__ import annotations

from typing import Any

import numpy as np

from pmabench.analysis.loops.gain_levels import examine
from pmabench.analysis.loops.open_loop import examine as examine_steps
from pmabench.analysis.loops.open_loop import steps_of
from pmabench.analysis.loops.positioning import hold_of
from pmabench.analysis.loops.relay_levels import examine as examine_relay
from pmabench.analysis.loops.relay_levels import search_of
from pmabench.analysis.loops.validation import inside_window, unusable
from pmabench.base.quantities import show
from pmabench.display.expected import Expected
from pmabench.display.quantities import Found, Measured, Quick
from pmabench.model.loop import ultimate
from pmabench.store.records import RunData, TrialData


def ultimate_gain(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Ultimate gain and period of one search."""
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


def position(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Steady-state error and overshoot of a held position, and its limit cycle where it hunts."""
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


def validation(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """The contraction in the window beside the one that the specimen's file expects."""
    reason = unusable(run, trial)
    if reason:
        return [Measured("x", "length", None)], [reason]
    x = float(trial.channels["displacement"][inside_window(run, trial)].mean())
    P, load = trial.point.get("pressure", 0.0), trial.point.get("load", 0.0)
    K_e, F_e = (expected.at(name, P) if expected else None for name in ("K", "F_ce"))
    slip = expected.F_c if expected else 0.0
    predicted = (F_e - slip - load) / K_e if F_e is not None and K_e else None
    return [Measured("x", "length", x, predicted, tolerance=slip / K_e if K_e else 0.0, noise=20e-6)], []
