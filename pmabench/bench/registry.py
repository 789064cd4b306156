"""Which drivers are installed: entry points of the group `pmabench.drivers`, by name; imports none of them."""

from __future__ import annotations

import re
from functools import lru_cache
from importlib.metadata import entry_points

from pmabench.base.errors import did_you_mean


@lru_cache(maxsize=1)
def drivers() -> dict[str, str]:
    """Name of each driver and its `module:Class`."""
    return {point.name: point.value for point in entry_points(group="pmabench.drivers")}


def driver_class(name: str) -> str:
    """`module:Class` of a driver given by its name, or given as `module:Class` itself; ValueError where unknown."""
    if re.fullmatch(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*", name):
        return name
    known = drivers()
    if name not in known:
        raise ValueError(f'no driver "{name}" is installed{did_you_mean(name, known)}')
    return known[name]
