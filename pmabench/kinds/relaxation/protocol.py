"""Protocol of relaxation: a step to a pressure at a set contraction, held with the regulator on (paper 4)."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pmabench.base.quantities import show
from pmabench.files.document import Strict
from pmabench.files.quantity import Speed, Time
from pmabench.protocol.common import OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.driven import bearable, check_motion, leave
from pmabench.protocol.plan import Hold, Plan, Ramp, Record, Set
from pmabench.protocol.sweep import LengthAxis, PressureAxis, Sweep, expand

QUIET = 5.0
"""Rest without pressure at both ends of a trial [s], in which the slack muscle shows the zero of the force cell."""
SHORTEST, LONGEST = 10.0, 1e5
"""Range of the hold [s]."""


class RelaxationAxes(Strict):
    """What is swept; a contraction is at least 0, so that the vented muscle is slack."""

    contraction: LengthAxis
    pressure: PressureAxis


class RelaxationTrial(Strict):
    """One step and its hold."""

    approach: Speed
    """Speed from one contraction to the next, without pressure."""
    hold: Time
    """Hold from the step on."""
    begin: Annotated[Time, Field(gt=0)] = 5.0
    """Start of the evaluation after the step, since the air of a fast fill is warm at first."""
    rest: Time
    """Rest without pressure before the first trial and after each, at least as long as the hold, so that earlier holds
    fade.
    """


class Relaxation(ProtocolHead):
    """Protocol of kind relaxation."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "force")
    checks: ClassVar[tuple[str, ...]] = OF_TRIALS
    kind: Literal["relaxation"]
    sweep: Sweep[RelaxationAxes]
    trial: RelaxationTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per point move to the contraction without pressure, step up, hold, vent and rest."""
        trial = self.trial
        check_motion(c, trial, "rest")
        if not SHORTEST <= trial.hold <= LONGEST:
            c.fault(("trial", "hold"), f"a hold is {show(SHORTEST, 'time')} to {show(LONGEST, 'time')}")
        elif trial.hold <= trial.begin:
            c.fault(("trial", "begin"), "nothing of the hold is left after it")
        elif trial.rest < trial.hold:
            c.fault(("trial", "rest"), "is shorter than the hold, and what that leaves behind is in the next trial")
        at = 0.0
        for point in expand(self.sweep, c.document):
            x, (pressure,) = point.values["contraction"], c.swept(point, "pressure")
            c.within("displacement", x, point.places["contraction"])
            c.positive(pressure, point.places["pressure"])
            if x < 0:
                c.fault(point.places["contraction"], "the vented muscle must be slack: give 0 mm or more")
            bearable(c, pressure, [(x, 0.0)], point.places["contraction"], "the contraction")
            if c.problems or c.too_long():
                continue
            index = c.add_trial({"contraction": x, "pressure": pressure}, point.repeat)
            c.steps += [
                *([] if index else [Hold("rest", trial.rest)]),
                *([Ramp("approach", "displacement", at, x, trial.approach)] if abs(x - at) > 1e-9 else []),
                Record("quiet", True, index),
                Hold("quiet", QUIET),
                Set("step", "pressure", pressure),
                Hold("step", trial.hold),
                Set("vent", "pressure", 0.0),
                Hold("vent", QUIET),
                Record("vent", False, index),
                Hold("rest", trial.rest),
            ]
            at = x
        c.steps += leave(at, trial.approach)
        return c.plan("relaxation", {"begin": trial.begin})
