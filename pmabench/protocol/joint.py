"""What protocols of a joint of two muscles share: names of its pressures, speeds, the way out; knows no kind."""

from __future__ import annotations

from pmabench.base.quantities import show
from pmabench.files.document import Location
from pmabench.protocol.common import Compilation
from pmabench.protocol.plan import Hold, Set, Step

MUSCLES = ("pressure_1", "pressure_2")
VENT_HOLD = 3.0
"""Rest after the last trial, without pressure [s]."""


def vented() -> list[Step]:
    """Both muscles to 0 together, and a rest."""
    return [*(Set("vent", name, 0.0) for name in MUSCLES), Hold("vent", VENT_HOLD)]


def not_faster(c: Compilation, speed: float, place: Location) -> None:
    """Note a problem where a speed [rad/s] is not above 0, or above what the drive of the joint can do."""
    c.positive(speed, place)
    output = next((o for o in c.mounted.bench.outputs if o.name == "angle"), None)
    if output is not None and output.rate and speed > output.rate * (1 + 1e-9):
        most = show(output.rate, "angular speed")
        c.fault(place, f"{show(speed, 'angular speed')} is faster than the drive of the joint, {most}")
