"""Pressures and angle of a joint that are not those that were commanded: what that does to its values, and in words.

Which of the two is wrong, a sensor or what was to follow the command, the record cannot say: a value is given for the
command, and its interval holds both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import radians

import numpy as np

from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.ramp_loop import MUSCLES
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Finding
from pmabench.store.records import Array

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


@dataclass(frozen=True, eq=False)
class Kept:
    """How far a joint is from its commands, as measured: measured less commanded."""

    pressures: Array
    """Of both muscles [Pa], shape (2,)."""
    zero: float
    """Of the angle at 0 [rad]."""
    scale: float
    """Of the way: measured over commanded, less 1."""

    @property
    def short(self) -> float:
        """Both pressures' distances from their commands [Pa], which may add."""
        return float(np.abs(self.pressures).sum())

    def aside(self, angle: float) -> float:
        """By how much the encoder is off the drive at an angle [rad]."""
        return abs(self.zero + self.scale * angle)


def place(kept: Sequence[Kept], angle: float, by_angle: float) -> Doubt:
    """What it does to a value that changes `by_angle` [1/rad] that the joint was not at `angle` [rad]."""
    worst = max(kept, key=lambda one: one.aside(angle))
    off = worst.aside(angle)
    reason = f"the encoder reads {show(off, 'angle', 2)} off the angle that the drive was sent to: one of them is wrong"
    return Doubt("angle of the drive", "method", abs(by_angle) * off, off > ZERO, reason)


def way(kept: Sequence[Kept], stiffness: float) -> Doubt:
    """What it does to a stiffness that encoder and drive disagree on how far the joint went."""
    scale = max((one.scale for one in kept), key=abs)
    reason = f"the encoder reads {scale:+.1%} of the way that the drive was sent: one of them has a wrong scale"
    return Doubt("scale of the angle", "method", abs(scale * stiffness), abs(scale) > SCALE, reason)


def flanks(x: Array, branches: Sequence[Array]) -> float:
    """Step of the torque where it changes its sign, in both `branches` over the angles `x` (n,) alike [N m]; else 0.

    Play that the torque loads lets the joint over to its other flank there, and the torque stays behind. A branch is
    NaN where it does not count.
    """
    steps = []
    for torque in branches:
        known = np.isfinite(torque)
        y, side = torque[known], np.sign(torque[known])
        if min(np.count_nonzero(side > 0), np.count_nonzero(side < 0)) <= ORDER:
            return 0.0
        z = 2 * (x[known] - x[known].mean()) / np.ptp(x[known])
        design = np.column_stack([*(z**k for k in range(ORDER + 1)), side])
        terms, *_ = np.linalg.lstsq(design, y, rcond=None)
        rest = y - design @ terms
        error = np.sqrt(rest @ rest / (len(y) - ORDER - 2) * np.linalg.inv(design.T @ design)[-1, -1])
        if terms[-1] > -SURE * error:
            return 0.0
        steps.append(-float(terms[-1]))
    return SMEARED * float(np.mean(steps))


def findings(kept: Sequence[tuple[Mapping[str, float], Kept]]) -> Iterator[Finding]:
    """What is off the commands, in words; each with the point of its trial."""
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
    worst = max((one for _, one in kept), key=lambda one: abs(one.zero), default=None)
    if worst is not None and abs(worst.zero) > ZERO:
        zero = show(worst.zero, "angle", 2)
        yield Finding("doubt", f"the encoder reads {zero} where the drive was sent to 0: one of their zeros is wrong")
