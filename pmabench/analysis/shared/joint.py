"""What sweeps and locked torques of a joint share: turns, play, deviation from commands, an estimate of all cycles.

Where pressures or angle differ from their commands, the record does not show whether sensor or actuator is wrong: a
value is given for the command, and its interval covers both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, radians

import numpy as np

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.lines import mean_of_cycles
from pmabench.analysis.shared.ramp_loop import Axes, Turns
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Estimate, Finding, Parts
from pmabench.store.records import Array, RunData

MUSCLES = ("pressure_1", "pressure_2")
AXES = Axes("angle", "torque", MUSCLES, "rise", "fall")
TORQUE, STIFFNESS = ("N.m", "torque"), ("N.m/rad", "torsional stiffness")
"""Unit and quantity of each."""
CUT = 3.0
"""Distance after a turn, in multiples of w, from which on a branch is used: 5 % of the turn are left."""
NOT_SEEN = 4.0
"""A gap below this multiple of the noise of its points counts as none."""
SMALLEST = radians(10)
"""Least half width of a sweep without a gap [rad]: in a smaller one hysteresis has a gap below the noise, and yet
branches up to three times as steep. Turns of braided muscles fade within 0.5 to 2 % of contraction."""
BY_PRESSURE = 1.5
"""Factor on the relative change of stiffness over that of the pressures, because rubber adds to the stiffness."""
SCALE = 2e-3
"""Relative difference between encoder and drive that is not reported [1]."""
ZERO = radians(0.1)
"""Difference between their zeros that is not reported [rad]."""
FAR = 0.02
"""Share of the half sweep by which the encoder may be off the drive at an end before its turns are elsewhere."""
ORDER = 5
"""Order of the polynomial for the torque next to a step at its change of sign."""
SURE = 4.0
"""Standard errors above which such a step counts."""
SMEARED = 2.0
"""Factor by which a step that is spread over some angles may be larger than fitted."""
SHORT = 0.01
"""Relative deviation of a pressure from its command that is not reported."""


def why_no_turns(turns: Turns | None, half: float, gap: float, noise: float) -> str:
    """Why a gap [N m] has the wrong sign or is not fully open within +-`half` [rad]; empty where it is.

    `noise` is that of a point of the gap [N m].
    """
    seen = gap / NOT_SEEN
    if seen < -noise:
        return (
            "the torque is larger while the angle rises, and no muscles give work back like that: look for a wrong "
            "sign, or angle and torque that are apart in time"
        )
    if turns is None and (seen > noise or half < SMALLEST):
        return (
            f"the sweep of +-{show(half, 'angle', 3)} is too small for the hysteresis: its branches never become "
            "parallel, and may be three times as steep as the joint is stiff; sweep at least three times as far, or "
            "look for a filter on the torque"
        )
    return ""


@dataclass(frozen=True, eq=False)
class Kept:
    """Deviation of a joint from its commands: measured minus commanded."""

    pressures: Array
    """Of the pressures of both muscles [Pa], shape (2,)."""
    zero: float
    """Of the angle at 0 [rad]."""
    scale: float
    """Of the range of angles: measured over commanded, minus 1 [1]."""

    def turns_elsewhere(self, half: float) -> str:
        """Why a sweep of +-`half` [rad] does not turn at its ends by the encoder; empty where it does."""
        if abs(self.zero) + abs(self.scale) * half <= max(ZERO, FAR * half):
            return ""
        off = f"{show(self.zero, 'angle', 2)} where the drive was sent to 0"
        if abs(self.scale) * half > abs(self.zero):
            off = f"{1 + self.scale:.2g} times the way that the drive was sent"
        return (
            f"the encoder reads {off}, so the turns are not where the plan has them, and hysteresis looks like "
            "stiffness: correct its unit, scale or zero, or that of the drive"
        )


def place(kept: Sequence[Kept], angle: float, by_angle: float) -> Doubt:
    """Effect of a difference between encoder and drive on a value at `angle` [rad] with slope `by_angle` [1/rad]."""
    off = max(abs(one.zero + one.scale * angle) for one in kept)
    reason = f"the encoder reads {show(off, 'angle', 2)} off the angle that the drive was sent to: one of them is wrong"
    return Doubt("angle of the drive", "method", abs(by_angle) * off, off > ZERO, reason)


def way(kept: Sequence[Kept], stiffness: float) -> Doubt:
    """Effect on a stiffness [N m/rad] of a difference in scale between encoder and drive."""
    scale = max((one.scale for one in kept), key=abs)
    reason = f"the encoder reads {scale:+.1%} of the way that the drive was sent: one of them has a wrong scale"
    return Doubt("scale of the angle", "method", abs(scale * stiffness), abs(scale) > SCALE, reason)


def flank(x: Array, rising: Array, falling: Array, ends: tuple[float, float], turns: Turns | None) -> float:
    """Step of the torque at its change of sign [N m], mean of both branches; 0 where one of them shows none.

    There the joint moves through its play to the other flank. Branches over the angles `x` [rad] have shape (n,), NaN
    where they do not count; points within `CUT` after a turn, at one of the `ends`, are left out.
    """
    cut = 0.0 if turns is None else CUT * turns.w
    steps = []
    for torque, since in ((rising, x - ends[0]), (falling, ends[1] - x)):
        known = np.isfinite(torque) & (since >= cut)
        y, side = torque[known], np.sign(torque[known])
        if min(np.count_nonzero(side > 0), np.count_nonzero(side < 0)) <= ORDER:
            return 0.0
        z = 2 * (x[known] - x[known].mean()) / np.ptp(x[known])
        design = np.column_stack([np.vander(z, ORDER + 1), side])
        terms, *_ = np.linalg.lstsq(design, y, rcond=None)
        rest = y - design @ terms
        error = np.sqrt(rest @ rest / (len(y) - ORDER - 2) * np.linalg.inv(design.T @ design)[-1, -1])
        if terms[-1] > -SURE * error:
            return 0.0
        steps.append(-float(terms[-1]))
    return SMEARED * float(np.mean(steps))


def estimate(
    symbol: str, kind: tuple[str, str], method: str, values: Sequence[Array], extra: float, at: Mapping[str, float], *,
    trials: tuple[str, ...], kept: Sequence[Kept], scales: Scales,
    by_pressure: float = 0.0, by_angle: float = 0.0, by_gain: float = 0.0,
) -> Estimate:  # fmt: skip
    """The mean of `values`, the cycles of each of `trials`, at the operating point `at`; calibration to first order.

    Derivatives: `by_pressure` of either muscle [1/Pa], `by_angle` [1/rad], `by_gain` of the angle [1]. `extra` is the
    method part, to which the effect of pressures that differ from their commands is added.
    """
    value, half = mean_of_cycles(values)
    gains = {"torque": value, "angle": by_gain} | {name: by_pressure * at[name] for name in MUSCLES}
    offsets = {"torque": float(symbol == "tau"), "angle": by_angle} | dict.fromkeys(MUSCLES, by_pressure)
    known = ({name: change for name, change in each.items() if change} for each in (gains, offsets))
    short = max(float(np.abs(one.pressures).sum()) for one in kept)
    parts = Parts(half, hypot(extra, by_pressure * short), scales.part(*known))
    note = "one trial: the repeats part is the scatter of its cycles" if len(trials) == 1 else ""
    return Estimate(symbol, value, *kind, method, at, parts, len(trials), note=note, trials=trials)


def findings(
    runs: Sequence[RunData], kept: Sequence[tuple[Mapping[str, float], Kept]], scales: Scales,
    estimates: Sequence[Estimate],
) -> Iterator[Finding]:  # fmt: skip
    """Deviations from commands (`kept`, with the point of each trial), missing calibrations, skew of the streams."""
    for n, name in enumerate(MUSCLES):
        off = [(float(one.pressures[n]), point[name]) for point, one in kept if point[name] > 0]
        size, wanted = max(off, key=lambda pair: abs(pair[0]) / pair[1], default=(0.0, 1.0))
        if abs(size) > SHORT * wanted:
            text = (
                f"{name} is measured {show(abs(size), 'pressure', 2)} {'above' if size > 0 else 'below'} the "
                f"{show(wanted, 'pressure')} that were commanded: its regulator or its sensor is off. Values are given "
                "for the command, and their intervals hold either"
            )
            yield Finding("doubt", text)
    zero = max((one.zero for _, one in kept), key=abs, default=0.0)
    if abs(zero) > ZERO:
        text = f"the encoder reads {show(zero, 'angle', 2)} where the drive was sent to 0: one of their zeros is wrong"
        yield Finding("doubt", text)
    yield from scales.findings(estimates, ("torque", "angle", *MUSCLES))
    channels = (AXES.moved, AXES.pulls)
    yield from skew.findings(runs, channels, skew.apart(runs, channels), estimates)
