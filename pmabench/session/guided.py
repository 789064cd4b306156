"""What every guided run is made of: its plan, and what the operator is asked for, loads by hanger and plates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pmabench.bench.compile import Mounted
from pmabench.bench.session import Stack
from pmabench.protocol.common import FORCE_MASS
from pmabench.protocol.plan import Plan

RATE = 200.0
"""Rate at which a guided run samples [Hz]."""


def guided_plan(mounted: Mounted, kind: str, name: str, settings: Mapping[str, Any] | None = None) -> Plan:
    """A plan without steps for a guided run: every channel is recorded."""
    channels = tuple(channel.name for channel in mounted.bench.channels)
    return Plan(kind, name, "", mounted.bench.free_end, RATE, channels, (), (), settings or {})


def load_text(mounted: Mounted, mass: float) -> str:
    """The request to the operator for a load of `mass` [kg]."""
    weights = mounted.bench_file.weights
    if mass == 0 or weights is None:
        return "Take every weight off the free end; nothing may pull at the load cell."
    stack = Stack(weights.hanger, weights.plates)
    made_of = stack.text(mass) if stack.can_make(mass) else ""
    return f"Put {made_of or f'{mass:g} kg'} on the free end, on its support: {mass * weights.g:.2f} N."


def moving_mass(mounted: Mounted, mass: float) -> float:
    """Moving mass with a load of `mass`: load, carriage and muscle [kg]."""
    bench = mounted.bench
    return mass + bench.carriage if bench.hanging and mass + bench.carriage > 0 else FORCE_MASS
