"""The value of a ramp or sine at a moment, for devices that take single set-points only. Standard library only."""

from __future__ import annotations

import math

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Segment


def refuse_nonsense(device: str, output: str, segment: Segment) -> None:
    """DeviceError where a segment is neither a ramp nor a sine, or has a number that is none, or no rate."""
    ends = (segment.start, segment.origin, segment.target, segment.amplitude)
    paces = (segment.rate, segment.frequency, segment.cycles)
    if segment.kind not in {"ramp", "sine"} or not all(map(math.isfinite, (*ends, *paces))):
        raise DeviceError(device, f"cannot follow {segment}", output)
    if not (segment.rate if segment.kind == "ramp" else segment.frequency) > 0:
        raise DeviceError(device, f"a {segment.kind} needs a rate above zero", output)


def stepped(segment: Segment, now: float, resolution: float = 0.0) -> tuple[float | None, bool]:
    """Set-point [device units] at bench time `now` [s], and whether it is the last one; None before the start.

    On the device's steps where it has any, and never outside the segment: between origin and target of a ramp, between
    the crests of a sine.
    """
    since = now - segment.start
    if since < 0:
        return None, False
    if segment.kind == "ramp":
        low, high = sorted((segment.origin, segment.target))
        way = abs(segment.rate) * since
        if way >= high - low:
            return segment.target, True
        return _on_step(
            segment.origin + math.copysign(way, segment.target - segment.origin), resolution, low, high
        ), False
    if since >= segment.cycles / segment.frequency:
        return segment.origin, True
    swing = abs(segment.amplitude)
    value = segment.origin + segment.amplitude * math.sin(2 * math.pi * segment.frequency * since)
    return _on_step(value, resolution, segment.origin - swing, segment.origin + swing), False


def _on_step(value: float, resolution: float, low: float, high: float) -> float:
    """The nearest whole step, inside `low` to `high`."""
    if resolution > 0:
        value = round(value / resolution) * resolution
    return min(max(value, low), high)
