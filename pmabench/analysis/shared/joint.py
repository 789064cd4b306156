"""What sweeps and locked torques of a joint share: turns, play, commands that are not kept, an estimate of all cycles.

Where pressures or angle are not those that were commanded, the record cannot say which of the two is wrong, a sensor or
what was to follow the command: a value is given for the command, and its interval holds both.
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
"""Unit and quantity."""
CUT = 3.0
"""So many w after a turn a branch is itself: 5 % of the turn are left."""
NOT_SEEN = 4.0
"""A gap below so many times the noise of its points counts as none."""
SMALLEST = radians(10)
"""Half a sweep that shows no gap must be as wide [rad]: in a smaller one the gap of any hysteresis is below the noise,
and its branches are three times as steep all the same. Turns of braided muscles fade on 0.5 to 2 % of contraction."""
BY_PRESSURE = 1.5
"""The stiffness may change by so many times its share with the pressures: rubber takes a part of it away."""
SCALE = 2e-3
"""Share by which encoder and drive may disagree unseen [1]."""
ZERO = radians(0.1)
"""Angle by which they may do so."""
ORDER = 5
"""Of the smooth torque next to a step where it changes its sign."""
SURE = 4.0
"""Standard errors from which on such a step counts."""
SMEARED = 2.0
"""A step that is spread over some angles may be so many times as large as it looks."""
SHORT = 0.01
"""Share of a commanded pressure by which the measured one may be off it without a word."""


def why_no_turns(turns: Turns | None, half: float, gap: float, noise: float) -> str:
    """Why a gap [N m] has the wrong sign, or is never open within +-`half` [rad], in words; empty where it is open.

    `noise` is that of a point of the gap [N m].
    """
    seen = gap / NOT_SEEN
    small = f"the sweep of +-{show(half, 'angle', 3)} is too small for the hysteresis: "
    if seen < -noise:
        return (
            "the torque is larger while the angle rises, and no muscles give work back like that: look for a wrong "
            "sign, or angle and torque that are apart in time"
        )
    if turns is None and seen > noise:
        return (
            f"{small}its branches are never parallel, and their slope is that of the turns, not the stiffness; sweep "
            "at least three times as far, or look for a filter on the torque"
        )
    if turns is None and half < SMALLEST:
        least = show(SMALLEST, "angle", 3)
        return (
            f"{small}it shows no gap, and may be three times as steep as the joint is stiff; sweep at least +-{least}"
        )
    return ""


@dataclass(frozen=True, eq=False)
class Kept:
    """How far a joint is from its commands, as measured: measured less commanded."""

    pressures: Array
    """Of both muscles [Pa], shape (2,)."""
    zero: float
    """Of the angle at 0 [rad]."""
    scale: float
    """Of the way: measured over commanded, less 1."""


def place(kept: Sequence[Kept], angle: float, by_angle: float) -> Doubt:
    """Effect of an encoder that disagrees with the drive on a value at `angle` [rad], changing `by_angle` [1/rad]."""
    off = max(abs(one.zero + one.scale * angle) for one in kept)
    reason = f"the encoder reads {show(off, 'angle', 2)} off the angle that the drive was sent to: one of them is wrong"
    return Doubt("angle of the drive", "method", abs(by_angle) * off, off > ZERO, reason)


def way(kept: Sequence[Kept], stiffness: float) -> Doubt:
    """Effect on a stiffness of an encoder that disagrees with the drive on how far the joint went."""
    scale = max((one.scale for one in kept), key=abs)
    reason = f"the encoder reads {scale:+.1%} of the way that the drive was sent: one of them has a wrong scale"
    return Doubt("scale of the angle", "method", abs(scale * stiffness), abs(scale) > SCALE, reason)


def flank(x: Array, rising: Array, falling: Array, ends: tuple[float, float], turns: Turns | None) -> float:
    """Step of the torque where it changes its sign, in both branches over the angles `x` (n,) alike [N m]; else 0.

    Play that the torque loads lets the joint over to its other flank there, and the torque stays behind. A branch,
    shape (n,), is NaN where it does not count; what lies within `CUT` after its turn, at one of the `ends`, does not.
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
    """The mean of `values`, the cycles of each of `trials`, at pressures and an angle `at`; calibration to first order.

    It changes `by_pressure` [1/Pa] of either muscle, `by_angle` [1/rad] and `by_gain` of the angle [1]. `extra` is its
    method part without pressures that are not those commanded, which both may add.
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
    """What is off the commands, `kept` with the point of each trial; what calibration lacks; times of the streams."""
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
