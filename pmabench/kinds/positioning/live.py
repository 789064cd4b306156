"""What one trial says by itself, for the display."""

from __future__ import annotations

from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.positioning.reduction import hold_of
from pmabench.kinds.positioning.tracking import tracked
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Steady-state error and overshoot of a held position, and its limit cycle where it hunts; errors along a path."""
    law = trial.found.get("position") or {}
    if law.get("path") and law.get("ended") == "time":
        one = tracked(run, trial, law)
        if isinstance(one, str):
            return [Measured("e_rms", "length", None)], [one]
        values = one.values()
        return [Measured("e_rms", "length", values["e_rms"]), Measured("OS", "ratio", values["OS"])], []
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
