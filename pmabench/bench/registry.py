"""Which drivers are installed: entry points of the group `pmabench.drivers`, by name; imports none of them."""

from __future__ import annotations

import re
from functools import lru_cache
from importlib.metadata import EntryPoint

from pmabench.base.errors import did_you_mean
from pmabench.base.system import registered

EMULATOR_ONLY = "emulator only"
"""Verification of a driver without a class attribute `verified`."""
HARDWARE = "hardware"
"""Start of `verified` for a driver that was tried on a device: `hardware (who, date, firmware)`."""


@lru_cache(maxsize=1)
def _points() -> dict[str, EntryPoint]:
    return {point.name: point for point in registered("pmabench.drivers")}


def drivers() -> dict[str, str]:
    """Name of each driver -> `module:Class`."""
    return {name: point.value for name, point in _points().items()}


def driver_class(name: str) -> str:
    """`module:Class` of a driver by its name, or as given in that form; ValueError if unknown."""
    if re.fullmatch(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*", name):
        return name
    known = drivers()
    if name not in known:
        raise ValueError(f'no driver "{name}" is installed{did_you_mean(name, known)}')
    return known[name]


def driver_version(target: str) -> str:
    """Version of the package that installed the driver `module:Class`; empty without one."""
    found = next((point for point in _points().values() if point.value == target and point.dist is not None), None)
    return found.dist.version if found is not None and found.dist is not None else ""


def verified(driver: object) -> str:
    """How a driver class was verified: `hardware (who, date, firmware)`, or `emulator only`."""
    return str(getattr(driver, "verified", EMULATOR_ONLY))
