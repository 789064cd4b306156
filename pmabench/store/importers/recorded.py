"""What a reader of another program's format hands over: named columns of numbers, with units where there are any."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from pmabench.base.errors import InvalidFile, Problem, did_you_mean, invalid
from pmabench.store.records import Array

NEEDS = {"lvm": "", "tdms": "npTDMS", "mat": "h5py"}
"""Format -> the package of the extra "import" that it needs, by the name that people know."""


@dataclass(frozen=True)
class Column:
    """One column of a file: shape (n,), NaN where the file says that there is no value."""

    name: str
    values: Array
    unit: str = ""


@dataclass
class Recorded:
    """All columns of a file that hold numbers; they need not be equally long."""

    columns: list[Column]
    started: datetime | None = None
    """When the recording began, by the clock and the time zone of who recorded it."""
    first_line: int = 1
    """Line of the first row; 1 where the file has no lines, so that row 1 is the first."""
    cut_end: bool = False
    """The last row may be incomplete."""
    doubts: list[str] = field(default_factory=list)
    """What contradicts itself within the file."""
    left_out: list[str] = field(default_factory=list)
    """Names of what holds no columns of numbers."""


def chosen(
    path: str, recorded: Recorded, wanted: Sequence[str], optional: Sequence[str], ignored: Sequence[str]
) -> dict[str, Column]:
    """The wanted columns and those of `optional` that there are, all equally long; raises InvalidFile otherwise."""
    has = {column.name: column for column in recorded.columns}
    names = [*wanted, *(name for name in optional if name in has)]
    missing = [name for name in names if name not in has]
    if missing:
        there = [*has, *recorded.left_out]
        raise InvalidFile(
            Problem(path, 0, 0, f'has no column "{name}"{did_you_mean(name, there) or _some(there)}')
            for name in missing
        )
    known = {*names, *ignored}
    recorded.left_out += [name for name in has if name not in known]
    lengths = {name: len(has[name].values) for name in names}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f'"{name}" {length}' for name, length in lengths.items())
        raise invalid(path, f"the columns of the map are not equally long: {told}; they were not sampled together")
    if not lengths or not min(lengths.values()):
        raise invalid(path, "holds no samples in the columns of the map")
    return {name: has[name] for name in names}


def _some(names: list[str]) -> str:
    if not names:
        return "; it has no columns of numbers at all"
    shown = ", ".join(f'"{name[:60]}"' for name in names[:8])
    return f"; it has {shown}{' and others' if len(names) > 8 else ''}"


@contextmanager
def damaged(path: str, what: str) -> Iterator[None]:
    """Whatever a library makes of a damaged file is a sentence; what was explained before stays as it is."""
    try:
        yield
    except (InvalidFile, MemoryError):
        raise
    except Exception as error:  # libraries raise what they like on damaged files
        told = " ".join(str(error).split())[:160] or type(error).__name__
        raise invalid(path, f"cannot be read as {what}; it is damaged or of another kind ({told})") from error


def numbers(values: object) -> Array | None:
    """A vector as float64, or None where it holds no real numbers."""
    array = np.asarray(values)
    if array.ndim != 1 or array.dtype.kind not in "biuf":
        return None
    return np.ascontiguousarray(array, dtype=np.float64)
