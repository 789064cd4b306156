"""What the operator is asked for: loads by hanger and plates, in the words of the protocols."""

from __future__ import annotations

from pmabench.bench.compile import Mounted
from pmabench.bench.session import Stack
from pmabench.protocol.common import FORCE_MASS


def load_text(mounted: Mounted, mass: float) -> str:
    """What is asked for a load of `mass` [kg]."""
    weights = mounted.bench_file.weights
    if mass == 0 or weights is None:
        return "Take every weight off the free end; nothing may pull at the load cell."
    stack = Stack(weights.hanger, weights.plates)
    made_of = stack.text(mass) if stack.can_make(mass) else ""
    return f"Put {made_of or f'{mass:g} kg'} on the free end, on its support: {mass * weights.g:.2f} N."


def moving_mass(mounted: Mounted, mass: float) -> float:
    """What moves with a load of `mass` [kg]."""
    bench = mounted.bench
    return mass + bench.carriage if bench.hanging and mass + bench.carriage > 0 else FORCE_MASS
