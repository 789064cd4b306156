"""Torque of a joint over the pressures of its muscles: a plane at each angle, and a torque whose zero drifts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from pmabench.analysis.shared import student
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.joint import MUSCLES
from pmabench.base.quantities import show
from pmabench.kinds.joint_torque.staircase import Staircase
from pmabench.store.analyses.results import Estimate, Parts, withhold
from pmabench.store.records import Array

SURE = 0.9995
"""Probability of Student's t beyond which a common change of the torque from cycle to cycle is significant."""
FEWEST_TRIALS = 4
LASTING = 0.15
"""Largest relative difference of that change between both halves of a cycle for which it counts as a drift."""


def _by_cycle(one: Staircase) -> Array:
    """Rate of change of the torque from cycle to cycle, at angles reached from below and from above [N m/s]."""
    torques = one.rests.torques
    lasts = float(np.ptp(one.trial.t)) / len(torques)
    return np.asarray(np.median((torques[-1] - torques[0]) / (len(torques) - 1), axis=1) / lasts)


@dataclass(frozen=True)
class Drift:
    """Drift of the torque's zero: the same change from cycle to cycle in all trials, which also acts between them."""

    rate: float
    """[N m/s]; 0 if not significant."""
    since: Mapping[str, float]
    """Name of a trial -> time from the start of its run [s]."""

    @classmethod
    def of(cls, members: Sequence[Staircase]) -> Drift:
        """From all trials; creep after the move to the first angle slows down, a drift of the zero does not."""
        begins = {one.run.id: one.run.trials[0].t[0] for one in members}
        since = {one.trial.name: float(one.trial.t.mean() - begins[one.run.id]) for one in members}
        each = np.array([_by_cycle(one) for one in members]).reshape(-1, 2)
        (rising, falling), n = each.mean(axis=0) if len(each) else (0.0, 0.0), len(each)
        rate, rates = 0.5 * float(rising + falling), each.mean(axis=1)
        lasting = abs(rising - falling) < LASTING * abs(rate)
        if n < FEWEST_TRIALS or not lasting or abs(rate) < student.ppf(SURE, n - 1) * rates.std(ddof=1) / sqrt(n):
            return cls(0.0, since)
        return cls(rate, since)

    def by(self, e: Estimate) -> float:
        """Its effect on a torque [N m]."""
        return self.rate * float(np.mean([self.since[name] for name in e.trials]))

    def weigh(self, e: Estimate, half: float, scale: float | None = None) -> Estimate:
        """The estimate, widened or withheld for `half`, the effect of the drift on it."""
        if self.rate == 0:
            return e
        whole = show(abs(self.rate) * max(self.since.values()), "torque", 2)
        reason = (
            f"from cycle to cycle the torque changes alike in all trials, by {whole} from the first to the last if it "
            "goes on: its zero drifts. Take the zero again before each trial, or let the cell warm up"
        )
        return weighed(e, [Doubt("drift of the torque", "drift", abs(half), True, reason)], scale)


LEVELS = 3
"""Fewest levels of each pressure: with two, any torque fits a plane, even with a slack muscle."""
FEWEST = 5
"""Fewest pairs of pressures, two more than the plane has terms."""
OFF = 2.0
"""Largest distance of a torque from the plane, in half widths of its interval."""
COEFFICIENTS = (
    ("tau_0", "N.m", "torque", 1.0),
    ("s_1", "N.m/Pa", "torque per pressure", 1.0),
    ("s_2", "N.m/Pa", "torque per pressure", -1.0),
)


def plane_estimates(torques: Sequence[Estimate], scales: Scales, drift: Drift) -> Iterator[Estimate]:
    """tau_0 [N m], s_1 and s_2 [N m/Pa] of tau = tau_0 + s_1 P_1 - s_2 P_2 at each angle with pairs enough.

    With muscles whose force is S P + F_e these are R S_1, R S_2 and R (F_e1 - F_e2). Intervals: the wider of the
    scatter about the plane and of the torques' own intervals, and the gains of the scales.
    """
    planes, scale = [], np.array([1.0, 1e5, 1e5])
    for angle in sorted({e.at["angle"] for e in torques}):
        rows = [e for e in torques if e.at["angle"] == angle and e.value is not None]
        design = np.array([[1.0, *(e.at[name] for name in MUSCLES)] for e in rows]).reshape(-1, 3)
        levels = min(len({e.at[name] for e in rows}) for name in MUSCLES)
        if len(rows) >= FEWEST and levels >= LEVELS and np.linalg.matrix_rank(design / scale) == 3:
            planes.append((angle, rows, design, np.linalg.pinv(design / scale) / scale[:, None]))
    terms = np.array([inverse @ [e.value for e in rows] for _, rows, _, inverse in planes])
    over = np.gradient(terms, [angle for angle, *_ in planes], axis=0) if len(planes) > 1 else np.zeros_like(terms)
    for (angle, rows, design, inverse), by_angle in zip(planes, over, strict=True):
        yield from _plane(angle, rows, design, inverse, by_angle, scales, drift)


def _plane(
    angle: float, rows: Sequence[Estimate], design: Array, inverse: Array, by_angle: Array, scales: Scales, drift: Drift
) -> Iterator[Estimate]:
    """The terms at one angle; `by_angle`, shape (3,), is their change with it."""
    tau = np.array([e.value for e in rows])
    own = np.array([replace(e.parts, calibration=None).combined or 0.0 for e in rows])
    terms = inverse @ tau
    residual = tau - design @ terms
    freedom = len(rows) - 3
    spread = float(student.ppf(0.975, freedom)) * float(np.sqrt(residual @ residual / freedom))
    worst = int(np.argmax(np.abs(residual) - OFF * own))
    why = ""
    if abs(residual[worst]) > OFF * own[worst]:
        where = " and ".join(show(rows[worst].at[name], "pressure") for name in MUSCLES)
        off, half = (show(float(value), "torque", 2) for value in (abs(residual[worst]), own[worst]))
        why = (
            f"the torque at {where} is {off} off a plane over the pressures, "
            f"and known to {half}: a muscle is slack, or not linear in its pressure"
        )
    trials = tuple(name for e in rows for name in e.trials)
    for (symbol, unit, quantity, sign), term, row, over in zip(COEFFICIENTS, terms, inverse, by_angle, strict=True):
        repeats = max(spread * float(np.linalg.norm(row)), float(np.linalg.norm(row * own)))
        value = sign * float(term)
        gains = {"torque": value} | ({} if symbol == "tau_0" else {f"pressure_{symbol[-1]}": value})
        offsets = dict(zip(("torque", *MUSCLES), (1.0, *terms[1:].tolist()), strict=True)) if symbol == "tau_0" else {}
        offsets["angle"], gains["angle"] = float(over), float(over) * angle
        parts = Parts(repeats, None, scales.part(gains, offsets))
        one = Estimate(symbol, value, unit, quantity, "plane", {"angle": angle}, parts, len(rows), trials=trials)
        drifted = float(row @ [drift.by(e) for e in rows])
        scale = float(np.abs(tau).max()) if symbol == "tau_0" else None
        yield withhold(one, why) if why else drift.weigh(one, drifted, scale)
