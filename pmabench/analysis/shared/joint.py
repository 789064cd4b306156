"""What reductions of tests of a joint of two muscles share: its channels, and hysteresis that a test is too small for.

Knows no protocol, and no muscle model.
"""

from __future__ import annotations

from math import radians

from pmabench.analysis.shared.ramp_loop import Axes, Turns
from pmabench.analysis.shared.samples import NotUsable
from pmabench.base.quantities import show

MUSCLES = ("pressure_1", "pressure_2")
AXES = Axes("angle", "torque", MUSCLES, "rise", "fall")
CUT = 3.0
"""So many w after a turn a branch is itself: 5 % of the turn are left."""
NOT_SEEN = 4.0
"""A gap below so many times the noise of its points counts as none."""
SMALLEST = radians(10)
"""Half a sweep that shows no gap must be as wide [rad]: in a smaller one the gap of any hysteresis is below the noise,
and its branches are three times as steep all the same. Turns of braided muscles fade on 0.5 to 2 % of contraction."""
BY_PRESSURE = 1.5
"""The stiffness may change by so many times its share with the pressures: rubber takes a part of it away."""


def refuse_turns(turns: Turns | None, half: float, gap: float, noise: float) -> None:
    """Raise `NotUsable` for a gap [N m] of the wrong sign, or one that is never open within +-`half` [rad].

    `noise` is that of a point of the gap [N m].
    """
    seen = gap / NOT_SEEN
    if seen < -noise:
        raise NotUsable(
            "the torque is larger while the angle rises, and no muscles give work back like that: look for a wrong "
            "sign, or angle and torque that are apart in time"
        )
    if turns is None and seen > noise:
        raise NotUsable(
            f"the sweep of +-{show(half, 'angle', 3)} is too small for the hysteresis: its branches are never "
            "parallel, and their slope is that of the turns, not the stiffness; sweep at least three times as far, or "
            "look for a filter on the torque"
        )
    if turns is None and half < SMALLEST:
        raise NotUsable(
            f"the sweep of +-{show(half, 'angle', 3)} is too small for the hysteresis: it shows no gap, and "
            f"may be three times as steep as the joint is stiff; sweep at least +-{show(SMALLEST, 'angle', 3)}"
        )
