"""The plan of a guided run: no steps, every channel recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pmabench.bench.compile import Mounted
from pmabench.protocol.plan import Plan

RATE = 200.0
"""Rate at which a guided run samples [Hz]."""


def guided_plan(mounted: Mounted, kind: str, name: str, settings: Mapping[str, Any] | None = None) -> Plan:
    """A plan without steps for a guided run: every channel is recorded."""
    channels = tuple(channel.name for channel in mounted.bench.channels)
    return Plan(kind, name, "", mounted.bench.free_end, RATE, channels, (), (), settings or {})
