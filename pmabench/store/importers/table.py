"""The columns that a map wants of one file, whatever its format: numbers, lines, what the file says of itself."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import invalid
from pmabench.base.text import printable
from pmabench.store.importers.map_file import TIME, BinaryLayout, TextLayout
from pmabench.store.importers.warm import read_apart
from pmabench.store.records import Array

MAX_BYTES = 200_000_000


@dataclass(frozen=True)
class Table:
    """Columns of one file."""

    path: Path
    sha256: str
    content: bytes
    columns: dict[str, Array]
    """Name -> numbers, shape (n,); NaN where the file says that there is none."""
    lines: NDArray[np.int64]
    """Line in the file of each row, from 1; number of the row where the file has no lines."""
    cut_end: bool
    """The last row may be cut."""
    units: Mapping[str, str]
    """Name -> unit, as the file says."""
    started: datetime | None
    """When the recording began, as the file says, in the time zone of who recorded it."""
    doubts: tuple[str, ...]
    left_out: tuple[str, ...]
    """Columns of the file that were not asked for."""


def read_table(
    path: Path,
    layout: TextLayout | BinaryLayout,
    wanted: Sequence[str] | None,
    optional: Sequence[str] = (),
    ignored: Sequence[str] = (),
) -> Table:
    """The `wanted` columns of a file, and those of `optional` that it has, read in a process apart.

    `wanted` None: all of a format that names them itself; they may differ in length then. Raises InvalidFile with
    every fault, at file:line where there is one.
    """
    content = content_of(path)
    made = layout.period is not None
    asked = None if wanted is None else [name for name in wanted if not (made and name == TIME)]
    told = layout.model_dump(mode="json") if isinstance(layout, TextLayout) else None
    answer = read_apart(layout.format, str(path), content, asked, optional, ignored, told)
    columns: dict[str, Array] = dict(answer.columns)
    if layout.period is not None:
        if TIME in columns:
            raise invalid(path, f'has a column "{TIME}" of its own; leave out "period"')
        columns[TIME] = np.arange(len(answer.lines), dtype=np.float64) * np.float64(layout.period)
    head = answer.head
    started = head.get("started")
    units = dict(zip(answer.columns, head.get("units", []), strict=False))
    return Table(
        path=path,
        sha256=hashlib.sha256(content).hexdigest(),
        content=content,
        columns=columns,
        lines=answer.lines.astype(np.int64),
        cut_end=bool(head.get("cut_end")),
        units={**units, TIME: "s"} if made else units,
        started=datetime.fromisoformat(started) if started else None,
        doubts=tuple(printable(text) for text in head.get("doubts", [])),
        left_out=tuple(printable(text) for text in head.get("left_out", [])),
    )


def content_of(path: Path) -> bytes:
    """The bytes of a file; raises InvalidFile where it is none, is empty or larger than 200 MB."""
    try:
        if path.is_dir():
            raise invalid(path, "is a folder; give the files in it, for instance with /*.csv")
        if not path.is_file():
            raise invalid(path, "is not a file" if path.exists() else "there is no such file")
        if path.stat().st_size > MAX_BYTES:
            raise invalid(path, f"is larger than {MAX_BYTES // 1_000_000} MB; import it in parts")
        content = path.read_bytes()
    except OSError as error:
        raise invalid(path, f"cannot be read: {error.strerror or error}") from error
    if not content.strip():
        raise invalid(path, "is empty")
    return content
