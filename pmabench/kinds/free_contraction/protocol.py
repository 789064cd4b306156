"""Free contraction: length of a muscle without load, over pressure (paper 2, eqs. 1-2)."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from pmabench.base.quantities import show
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import PressureRate, Time
from pmabench.protocol.common import OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.plan import Hold, Plan, Ramp, Record, Step, TrialRecord
from pmabench.protocol.sweep import PressureAxis, Sweep, expand

LEAST = 0.5
"""Shortest rest and hold that can count as rest [s]."""
NOTHING = 1.0
"""Pressures closer than this count as equal [Pa]."""
SIDES = {"from-below": (0,), "from-both-sides": (-1, 1)}
"""Approach -> the sides from which a pressure is reached: from 0, and from the highest pressure of the sweep."""


class FreeAxes(Strict):
    """What is swept."""

    pressure: PressureAxis


class FreeTrial(Strict):
    """One trial: rest at 0 kPa, the pressure, and back."""

    rate: PressureRate
    """Rate of the pressure ramps."""
    rest: Time
    """Time at 0 kPa before each pressure."""
    hold: Time
    """Hold at the pressure; the length is the mean over the last fifth."""
    approach: Literal["from-below", "from-both-sides"] = "from-both-sides"


class FreeContraction(ProtocolHead):
    """Protocol of kind free-contraction."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement")
    gives: ClassVar[tuple[str, ...]] = ("L",)
    checks: ClassVar[tuple[str, ...]] = OF_TRIALS
    kind: Literal["free-contraction"]
    sweep: Sweep[FreeAxes]
    trial: FreeTrial
    compare: Literal["paper-2", "nothing"] = "paper-2"
    """Paper 2's formula for the length of a muscle of this nominal length; valid for 15 to 40 cm, up to 5 bar."""

    def compile(self, c: Compilation) -> Plan:
        """The plan, without load: per pressure a rest at 0, the pressure reached from below or above, and back."""
        trial = self.trial
        c.positive(trial.rate, ("trial", "rate"))
        for name in ("rest", "hold"):
            if getattr(trial, name) < LEAST:
                c.fault(("trial", name), f"must be at least {show(LEAST, 'time')}: the length is taken at rest")
        points = expand(self.sweep, c.document)
        for point in points:
            c.within("pressure", point.values["pressure"], point.places["pressure"])
        if self.compare == "paper-2":
            self._check_prediction(c, [(point.values["pressure"], point.places["pressure"]) for point in points])
        top = max(point.values["pressure"] for point in points)
        for point in points if not c.problems else ():
            if not c.trials:
                c.put_on(c.load(("mass", 0.0), ("kind",)))
                c.precondition()
            for side in SIDES[trial.approach]:
                if c.too_long():
                    break
                index = len(c.trials)
                values = {"pressure": point.values["pressure"]} | ({"side": float(side)} if side else {})
                c.trials.append(TrialRecord(index, values, point.repeat))
                c.steps += _steps(trial, point.values["pressure"], top if side > 0 else None, index)
        length = c.mounted.specimen_file.nominal_length
        return c.plan("free-contraction", {"nominal_length": length, "compare": self.compare})

    def _check_prediction(self, c: Compilation, points: list[tuple[float, Location]]) -> None:
        """Check that length and pressures lie in the range of paper 2's formula, and that no limit would trip."""
        from pmabench.model.library import MODELS  # slow to import

        model = MODELS["sigmoid-length"]
        known = {p.name: p for p in model.parameters}
        length, most = c.mounted.specimen_file.nominal_length, known["pressure"].high
        low, high = known["nominal_length"].low, known["nominal_length"].high
        other = 'or "compare: nothing", which measures and fits without it'
        if not low * (1 - 1e-9) <= length <= high * (1 + 1e-9):
            message = f"paper 2's length holds from {show(low, 'length')} to {show(high, 'length')}"
            nominal = f"the specimen is {show(length, 'length')} long (nominal_length)"
            where: Location = ("compare",) if "compare" in c.document.data else ("kind",)
            c.fault(where, f"{nominal}; {message}: take such a one, {other}")
            return
        channels = [t for t in c.mounted.bench.trips if t.channel == "displacement" and t.kind == "range"]
        trips = [(t.high, t.source) for t in channels if t.high is not None and t.action != "warn"]
        for pressure, place in points:
            if pressure > most * (1 + 1e-9):
                message = f"{show(pressure, 'pressure')} is above {show(most, 'pressure')}"
                c.fault(place, f"{message}, up to which paper 2's length holds: take less, {other}")
                continue
            at = {"pressure": np.array(min(max(pressure, 0.0), most)), "nominal_length": np.clip(length, low, high)}
            x = float(model.evaluate(at)["contraction"]) * length
            for trip, source in trips:
                if x >= trip:
                    message = f"at {show(pressure, 'pressure')} it is predicted to contract by {show(x, 'length', 3)}"
                    share = f"{x / length:.1%} of its length"
                    c.fault(place, f"{message}, {share}; the trip limit is {show(trip, 'length', 3)} ({source})")


def _steps(of: FreeTrial, pressure: float, top: float | None, index: int) -> list[Step]:
    """One trial; `top` [Pa] is the pressure from which it comes down, None for an approach from below.

    All of it is recorded, so that each trial begins and ends in the same state, whatever was done before.
    """
    first = pressure if top is None else top
    fill = [Ramp("fill", "pressure", 0.0, first, of.rate)] if first > NOTHING else []
    fall = [Hold("top", of.rest), Ramp("empty", "pressure", first, pressure, of.rate)]
    back = [Ramp("vent", "pressure", pressure, 0.0, of.rate)] if pressure > NOTHING else []
    return [
        Record("rest", True, index),
        Hold("rest", of.rest),
        *fill,
        *(fall if first - pressure > NOTHING else []),
        Hold("hold", of.hold),
        *back,
        Record("vent", False, index),
    ]
