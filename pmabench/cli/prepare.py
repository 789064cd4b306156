"""From file names to a checked plan, with the problems of all files together; and whether the disk holds its run."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pmabench.base.errors import InvalidFile, Problem
from pmabench.bench.compile import Mounted, mount, mount_alone
from pmabench.files.shipped import find_file
from pmabench.kinds.compile import PlannedRun, planned_run, read_protocol
from pmabench.protocol.plan import Plan, Step


def prepare(protocol: str, bench: str, specimen: str, settings: Sequence[tuple[str, str]] = ()) -> PlannedRun:
    """Read and compile everything; raises `InvalidFile` with every problem of every file."""
    problems: list[Problem] = []
    paths: dict[str, Path] = {}
    for kind, name in (("bench", bench), ("specimen", specimen), ("protocol", protocol)):
        try:
            paths[kind] = find_file(kind, name)
        except InvalidFile as error:
            problems.extend(error.problems)
    mounted = read = None
    try:
        if "bench" in paths and "specimen" in paths:
            mounted = mount(paths["bench"], paths["specimen"])
    except InvalidFile as error:
        problems.extend(error.problems)
    try:
        if "protocol" in paths:
            read = read_protocol(paths["protocol"], settings)
    except InvalidFile as error:
        problems.extend(error.problems)
    if mounted is None or read is None or problems:
        raise InvalidFile(problems)
    return planned_run(paths, *read, mounted, settings)


def mounted_of(bench: str, specimen: str | None = None) -> Mounted:
    """A bench by file or name, with the specimen's limits where one is given."""
    path = find_file("bench", bench)
    return mount_alone(path) if specimen is None else mount(path, find_file("specimen", specimen))


def seeded(mounted: Mounted, seed: int) -> Mounted:
    """The same bench with another seed in each device that has one."""
    devices = tuple(
        replace(device, options={**device.options, "seed": seed}) if "seed" in device.options else device
        for device in mounted.bench.devices
    )
    return replace(mounted, bench=replace(mounted.bench, devices=devices))


REQUIRED = 2
"""So many times what is recorded must be free: a run that is closed is written once more before that is deleted."""


def needed(plan: Plan, steps: Sequence[Step] | None = None) -> int:
    """Most bytes that the samples of a plan take, or those of the `steps` that are left of it."""
    rows = plan.rows() if steps is None else replace(plan, steps=tuple(steps)).rows()
    return rows * (8 * (1 + len(plan.record)) + 2)


def too_little(count: int, out: Path) -> str:
    """A sentence where no folder can be made at `out`, or less than twice `count` bytes are free there."""
    place = next((there for there in (out, *out.absolute().parents) if there.exists()), Path("/"))
    if not place.is_dir():
        return f"{place} is no folder; record elsewhere with --out"
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
