"""A channel as one line of signs: its course in the terminal before anything is written."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

LEVELS = "▁▂▃▄▅▆▇█"
NONE = " "


def sparkline(values: Sequence[float], width: int = 60) -> str:
    """`values` in order as `width` signs or fewer, lowest to highest; each sign is the middle of its part."""
    if not values:
        return ""
    count = min(width, len(values))
    parts = [values[k * len(values) // count : (k + 1) * len(values) // count] for k in range(count)]
    middles = [sorted(good)[len(good) // 2] if (good := [v for v in part if isfinite(v)]) else None for part in parts]
    known = [v for v in middles if v is not None]
    low, span = (min(known), max(known) - min(known)) if known else (0.0, 0.0)
    return "".join(
        NONE if v is None else LEVELS[min(7, int((v - low) / span * 8))] if span > 0 else LEVELS[0] for v in middles
    )
