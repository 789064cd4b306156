"""Common parts of the format modules: the record `Format`, the layout from a map, and the columns that were read.

`formats` finds every format: those of this folder and those of other packages.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from functools import lru_cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from pmabench.base.errors import InvalidFile, invalid
from pmabench.base.system import registered
from pmabench.files.document import Strict
from pmabench.files.quantity import Time
from pmabench.store import formats as folder
from pmabench.store.records import Array

TIME = "@time"
"""Name of the column of times [s] calculated from the sampling period."""
TOGETHER = 0.5
"""Difference of starts, over the sampling period, up to which channels share a time column."""


class Layout(Strict):
    """Entry `file: {format: ...}` of a map; a format with options has a field for each."""

    holds_texts: ClassVar[bool] = False
    """Whether columns may hold texts, such as dates."""
    format: str
    period: Annotated[Time, Field(gt=0.0)] | None = None
    """Sampling period where the file gives no time; it makes the column `TIME`."""

    @property
    def given(self) -> Sequence[str]:
        """Names of all columns if the map gives them, else empty."""
        return ()

    @property
    def repeats(self) -> bool:
        """Whether a file may contain several tests, one below the other."""
        return False


@dataclass(frozen=True)
class Column:
    """One column of a file, shape (n,); NaN where the file has no value."""

    name: str
    values: Array
    unit: str = ""


@dataclass
class Recorded:
    """All numeric columns of a file, not necessarily equally long."""

    columns: list[Column]
    started: datetime | None = None
    """Start of the recording, in local time of the recording computer."""
    first_line: int = 1
    """Line number of the first row; 1 for a file without lines, so that rows count from 1."""
    cut_end: bool = False
    """The last row may be incomplete."""
    doubts: list[str] = field(default_factory=list)
    """Contradictions found in the file, in words."""
    left_out: list[str] = field(default_factory=list)
    """Names of parts without numeric columns."""


def begins(*marks: bytes) -> Callable[[bytes], bool]:
    """A function that returns whether a file begins with one of `marks`."""
    return lambda content: content.startswith(marks)


def in_groups(columns: Mapping[str, Array]) -> dict[str, str]:
    """Name of a column -> its part before the last `/`: a group, sheet or device with its own clock."""
    return {name: name.rpartition("/")[0] for name in columns}


@dataclass(frozen=True)
class Format:
    """One format of files that other programs write; either `read` or `reader` is given.

    Both run in a separate process without other open files and with limited memory, in case a file is damaged.
    """

    name: str
    """As in a map, `file: {format: ...}`."""
    title: str
    """Common name, for instance `LabVIEW measurement`."""
    layout: type[Layout]
    """Options of this format in a map; its field `format` has the name as its type."""
    recognise: Callable[[bytes], bool]
    """Whether a file is of this format, from its first bytes."""
    read: Callable[[str, bytes, Any, Collection[str] | None], Recorded] | None = None
    """(Path for messages, all bytes, layout, wanted columns or None for all) -> content of the file.

    Raises InvalidFile with the reason, and the line where there is one.
    """
    reader: Callable[..., Any] | None = None
    """Makes a reader that takes a file in pieces, for files that may not fit into memory; see `apart`."""
    modules: Sequence[str] = ()
    """Modules that `read` needs; they are imported before its time limit starts."""
    package: str = ""
    """Package that must be installed for it; empty where none."""
    together: Callable[[Mapping[str, Array]], Mapping[str, str]] = in_groups
    """Columns by name -> name of the group whose clock each shares; empty: the clock of the whole file."""


@contextmanager
def damaged(path: str, what: str) -> Iterator[None]:
    """Turn any error of a library on a damaged file into InvalidFile; InvalidFile and MemoryError pass unchanged."""
    try:
        yield
    except (InvalidFile, MemoryError):
        raise
    except Exception as error:  # libraries raise all kinds of errors on damaged files
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise invalid(path, f"cannot be read as {what}; it is damaged or of another kind ({reason})") from error


def numbers(values: object) -> Array | None:
    """A vector as float64, or None where it holds no real numbers."""
    array = np.asarray(values)
    if array.ndim != 1 or array.dtype.kind not in "biuf":
        return None
    return np.ascontiguousarray(array, dtype=np.float64)


def distinct(names: Sequence[str]) -> list[str]:
    """The names in order, repeated ones with a number: `name (2)`."""
    seen: Counter[str] = Counter()
    found = []
    for name in names:
        seen[name] += 1
        found.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return found


GROUP = "pmabench.formats"
"""Group of entry points; each has the name of its format and refers to a `Format`."""


@lru_cache(maxsize=1)
def formats() -> dict[str, Format]:
    """Every format by its name; a package cannot replace an existing one.

    Raises InvalidFile where an entry point cannot be loaded, is not a `Format`, or has another name.
    """
    modules = [each.name for each in iter_modules(folder.__path__, f"{folder.__name__}.") if not each.ispkg]
    records = [getattr(import_module(name), "FORMAT", None) for name in modules]
    known = {record.name: record for record in records if record is not None}
    for point in registered(GROUP):
        try:
            found = point.load()
        except Exception as error:  # a foreign package may raise anything
            raise invalid(point.value, f'the format "{point.name}" cannot be loaded: {error}') from error
        if not isinstance(found, Format) or found.name != point.name:
            raise invalid(point.value, f'is not the record of the format "{point.name}" that its package announces')
        known.setdefault(point.name, found)
    return known


def format_of(content: bytes) -> Format:
    """The format of a file from its first bytes; text where no format recognises them."""
    return next((each for each in formats().values() if each.recognise(content)), formats()["text"])
