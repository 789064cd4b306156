"""Steps of attitude of a platform: from level to phi and psi, held there, and back to level."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from pmabench.base.quantities import show
from pmabench.bench.files.specimen import above_zero
from pmabench.files.document import Strict
from pmabench.files.quantity import Pressure, Time, TorqueRate, TorsionalStiffness
from pmabench.kinds.platform_step import ACCELERATIONS, MUSCLES
from pmabench.protocol.common import OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.plan import Control, Plan, Record
from pmabench.protocol.sweep import AngleAxis, Point, Sweep, expand

REFERENCE_LAG, WIDE = 0.05, math.radians(10.0)
"""Time constant of each of the two lags of the reference [s] for steps up to `WIDE` [rad]; for larger steps in
proportion: air leaves a muscle at 10 bar/s, and 20 deg with the lags of 10 deg would overshoot to the trip.
"""
BACK = 1.0
"""Time of the return to level after the hold [s]: vented at level, it does not fall onto a stop."""
LEAST_LEVEL, LEAST_HOLD = 1.6, 1.5
"""Shortest times [s]: from a stop to level, and to see an attitude settle."""
SLOWEST = 100.0
"""Lowest sample rate [Hz]: the law acts once per sample, and with a lower rate its lags are meaningless."""


class PlatformAxes(Strict):
    """Attitudes: phi about the axis that is fixed to the base, psi about the other."""

    phi: AngleAxis
    psi: AngleAxis


class PlatformTrial(Strict):
    """One step: level, directly to the attitude, hold, back to level."""

    level: Annotated[Time, Field(ge=LEAST_LEVEL, le=3600)]
    hold: Annotated[Time, Field(ge=LEAST_HOLD, le=3600)]
    chain: Literal["reference", "measured"] = "reference"
    """Attitude from which the muscles' contractions are computed: the wanted one, or the measured one as in paper 3."""
    K_p: Annotated[TorsionalStiffness, AfterValidator(above_zero)] = 10.0
    """Moment per error of the attitude."""
    K_i: Annotated[TorqueRate, Field(ge=0)] = 180.0
    """Moment per integral of the error."""
    mean_pressure: Annotated[Pressure, AfterValidator(above_zero)] = 250e3
    """Mean of the three pressures, where their limits allow it."""


class PlatformSteps(ProtocolHead):
    """Protocol of kind platform-step."""

    cannot_do_without: ClassVar[tuple[str, ...]] = (*MUSCLES, *ACCELERATIONS)
    gives: ClassVar[tuple[str, ...]] = ("t_1", "OS_q", "e_q", "n_v")
    checks: ClassVar[tuple[str, ...]] = OF_TRIALS
    kind: Literal["platform-step"]
    sweep: Sweep[PlatformAxes]
    trial: PlatformTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: one closed loop per trial, all of it recorded; the valves are shut between trials."""
        bench, trial = c.mounted.bench, self.trial
        if self.sample_rate < SLOWEST:
            c.fault(("sample_rate",), f"the law steers at every sample; at least {SLOWEST:g} Hz")
        if not {"tilt", *MUSCLES} <= set(bench.commanded):
            return c.plan("platform-step", {})  # not a platform: said by `needs`
        for name in MUSCLES:
            c.within(name, trial.mean_pressure, ("trial", "mean_pressure"))
        if self.prepare.precondition is not None:
            c.fault(
                ("prepare", "precondition"),
                "the pressures of a platform come by pulses of its valves, and no cycles before the first trial do: "
                "leave it out, or put steps first whose results are not used",
            )
            return c.plan("platform-step", {})
        for point in expand(self.sweep, c.document):
            self._tilt(c, point)
            if c.too_long():
                break
            attitude = {name: point.values[name] for name in ("phi", "psi")}
            if math.hypot(*attitude.values()) == 0:
                c.fault(point.places["phi"], "phi and psi are both 0 deg: that is no step")
            index = c.add_trial(attitude, point.repeat)
            c.steps += [Record("step", True, index), self._control(c, attitude), Record("step", False, index)]
        settings = {name: getattr(trial, name) for name in ("level", "hold", "chain")}
        return c.plan("platform-step", {**settings, "height": bench.platform.get("accelerometer", 0.0)})

    @staticmethod
    def _tilt(c: Compilation, point: Point) -> None:
        """Check the total tilt of both angles, which is larger than either, against its limit."""
        tilt = math.acos(math.cos(point.values["phi"]) * math.cos(point.values["psi"]))
        limit = c.mounted.bench.commanded["tilt"]
        if tilt > limit.high * (1 + 1e-9):
            shown = f"phi and psi together are a tilt of {show(tilt, 'angle', 3)}, above the limit"
            c.fault(point.places["phi"], f"{shown} {show(limit.high, 'angle')} ({limit.high_from})")

    def _control(self, c: Compilation, attitude: dict[str, float]) -> Control:
        bench, trial = c.mounted.bench, self.trial
        duration = trial.level + trial.hold + BACK
        ranges = {name: (record.low, record.high) for name, record in bench.commanded.items()}
        parameters = {
            "goals": [[0.0, 0.0, 0.0], [trial.level, *attitude.values()], [trial.level + trial.hold, 0.0, 0.0]],
            "duration": duration,
            "K_p": trial.K_p,
            "K_i": trial.K_i,
            "mean": trial.mean_pressure,
            "low": max(ranges[name][0] for name in MUSCLES),
            "high": min(ranges[name][1] for name in MUSCLES),
            "chain": trial.chain,
            "reference_lag": REFERENCE_LAG * max(1.0, math.hypot(*attitude.values()) / WIDE),
            "platform": dict(bench.platform),
        }
        return Control("step", "platform", ranges, duration + 0.1, parameters)
