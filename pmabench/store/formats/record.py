"""What a module of a format needs: the record `Format`, the layout that a map gives, columns to hand over.

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
"""Column of times [s] that are made from the distance of the samples."""
TOGETHER = 0.5
"""Channels that begin within this share of a sample have one clock."""


class Layout(Strict):
    """What a map says of a file in `file: {format: ...}`; a format with options has a field for each."""

    holds_texts: ClassVar[bool] = False
    """Whether columns may hold texts, such as dates."""
    format: str
    period: Annotated[Time, Field(gt=0.0)] | None = None
    """Distance of the samples where nothing in the file gives the time; it makes the column `TIME`."""

    @property
    def given(self) -> Sequence[str]:
        """Names of all columns, where the map gives them."""
        return ()

    @property
    def repeats(self) -> bool:
        """Whether a file may hold several tests, one below the other."""
        return False


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


def begins(*marks: bytes) -> Callable[[bytes], bool]:
    """Recognises files whose first bytes are one of `marks`."""
    return lambda content: content.startswith(marks)


def in_groups(columns: Mapping[str, Array]) -> dict[str, str]:
    """Name of a column -> what is before its last `/`: groups, sheets or devices that have a clock each."""
    return {name: name.rpartition("/")[0] for name in columns}


@dataclass(frozen=True)
class Format:
    """One format of files that other programs write; either `read` or `reader` is given.

    Both run in a separate process that has no other file open and little memory, since a damaged file may do anything.
    """

    name: str
    """As in a map, `file: {format: ...}`."""
    title: str
    """As people call it: `LabVIEW measurement`."""
    layout: type[Layout]
    """What a map may say of such a file; the type of its field `format` is the name."""
    recognise: Callable[[bytes], bool]
    """Whether a file is of this format, from its first bytes."""
    read: Callable[[str, bytes, Any, Collection[str] | None], Recorded] | None = None
    """Path for messages, all bytes, layout, and the columns that are wanted (None: all) -> what the file holds.

    Raises InvalidFile with what is wrong, at its line where there is one.
    """
    reader: Callable[..., Any] | None = None
    """Makes a reader that takes a file in pieces, for a format whose files may not fit into memory; see `apart`."""
    modules: Sequence[str] = ()
    """Modules that `read` imports: imported before the time that a file may take is counted."""
    package: str = ""
    """The package that has to be installed for it, as people know it; empty where none."""
    together: Callable[[Mapping[str, Array]], Mapping[str, str]] = in_groups
    """Columns by name -> name of the group with which each was sampled; empty: with the file as a whole."""


@contextmanager
def damaged(path: str, what: str) -> Iterator[None]:
    """Turns whatever a library raises on a damaged file into a sentence; an InvalidFile stays as it is."""
    try:
        yield
    except (InvalidFile, MemoryError):
        raise
    except Exception as error:  # libraries raise what they like on damaged files
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise invalid(path, f"cannot be read as {what}; it is damaged or of another kind ({reason})") from error


def numbers(values: object) -> Array | None:
    """A vector as float64, or None where it holds no real numbers."""
    array = np.asarray(values)
    if array.ndim != 1 or array.dtype.kind not in "biuf":
        return None
    return np.ascontiguousarray(array, dtype=np.float64)


def distinct(names: Sequence[str]) -> list[str]:
    """The names in order; one that was there before with its number: `name (2)`."""
    seen: Counter[str] = Counter()
    found = []
    for name in names:
        seen[name] += 1
        found.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return found


GROUP = "pmabench.formats"
"""Group of entry points; each is called as its format and names a `Format`."""


@lru_cache(maxsize=1)
def formats() -> dict[str, Format]:
    """Every format by its name; a package cannot replace one that is here already.

    Raises InvalidFile where an entry point names no `Format`, or one with another name.
    """
    modules = [each.name for each in iter_modules(folder.__path__, f"{folder.__name__}.") if not each.ispkg]
    records = [getattr(import_module(name), "FORMAT", None) for name in modules]
    known = {record.name: record for record in records if record is not None}
    for point in registered(GROUP):
        try:
            found = point.load()
        except Exception as error:  # a package of somebody else may raise anything
            raise invalid(point.value, f'the format "{point.name}" cannot be loaded: {error}') from error
        if not isinstance(found, Format) or found.name != point.name:
            raise invalid(point.value, f'is not the record of the format "{point.name}" that its package announces')
        known.setdefault(point.name, found)
    return known


def format_of(content: bytes) -> Format:
    """The format of a file by its first bytes; text where no format recognises them."""
    return next((each for each in formats().values() if each.recognise(content)), formats()["text"])
