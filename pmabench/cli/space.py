"""Whether the disk holds what a run may record: what it needs, what is free where it would lie."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pmabench.protocol.plan import Plan, Step

REQUIRED = 2
"""So many times what is recorded must be free: a run that is closed is written once more before that is deleted."""


def needed(plan: Plan, steps: Sequence[Step] | None = None) -> int:
    """Most bytes that the samples of a plan take, or those of the `steps` that are left of it."""
    rows = plan.rows() if steps is None else replace(plan, steps=tuple(steps)).rows()
    return rows * (8 * (1 + len(plan.record)) + 2)


def too_little(count: int, out: Path) -> str:
    """A sentence where less than twice `count` bytes are free at `out`, or at the folder that it would be made in."""
    place = next((folder for folder in (out, *out.absolute().parents) if folder.is_dir()), Path("/"))
    free = shutil.disk_usage(place).free
    if free >= REQUIRED * count:
        return ""
    return (
        f"{place}: {size(free)} are free, and {size(REQUIRED * count)} are needed, twice what the run may record; "
        "make room, or record elsewhere with --out"
    )


def size(count: int) -> str:
    """A number of bytes for people."""
    for unit, factor in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if count > factor:
            return f"{count / factor:,.1f} {unit}"
    return f"{count / 1e3:.0f} kB"
