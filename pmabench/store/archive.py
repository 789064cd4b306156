"""A live stream turned into Parquet, re-read and compared; must not know runs, trials or SI values."""

from __future__ import annotations

import hashlib
import json
import mmap
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pmabench.store.arrow import pa, pq
from pmabench.store.folder import sync_folder
from pmabench.store.livestream import LiveReader, about_stream, raw_bytes

GROUP = 500_000
"""Rows of a row group."""
ARRIVALS = "arrivals"
"""Metadata of the file: two lists, the clock of the device and of the host [ns], for the last sample of batches."""


@dataclass(frozen=True)
class Archived:
    """What was kept of a live stream."""

    rows: int
    fault: str
    """Why reading the live stream stopped before its end mark; empty: it did not."""
    torn: bool
    """Whether bytes were left that belong to no whole batch."""


def archive(live: Path, target: Path) -> Archived:
    """Write the whole batches of `live` to the Parquet file `target`, synced, re-read and compared byte for byte.

    Raises OSError where it cannot be written, ValueError where `live` has no whole schema or what was read back
    differs; `target` then does not exist.
    """
    part = target.with_name(f".{target.name}.part")
    try:
        with live.open("rb") as file:
            source = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)  # closed with the last batch that is on it
        reader = LiveReader(pa.py_buffer(source))
        digests = _write(part, reader, source)
        arrivals = reader.arrivals
        with part.open("r+b") as file:
            os.fsync(file.fileno())
        with pq.ParquetFile(part) as written:
            same = _arrivals_of(written) == arrivals
        if not same or digests != [_digest(table) for table in _row_groups(part)]:
            raise ValueError("what was read back is not what was written")
        kept = Archived(reader.rows, reader.fault, reader.torn)
        part.replace(target)
        sync_folder(target.parent)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    return kept


def _write(part: Path, reader: LiveReader, source: mmap.mmap) -> list[bytes]:
    """The digest of each row group written; what was read of `source` does not stay in memory."""
    schema = reader.schema
    integers = [field.name for field in schema if pa.types.is_signed_integer(field.type)]
    others = [field.name for field in schema if pa.types.is_unsigned_integer(field.type)]  # flags: few different ones
    digests = []
    with pq.ParquetWriter(
        part,
        schema,
        compression="zstd",
        use_dictionary=others,
        column_encoding=dict.fromkeys(integers, "DELTA_BINARY_PACKED"),
        write_page_checksum=True,
    ) as writer:
        for table in _tables(reader, schema):
            writer.write_table(table, row_group_size=GROUP)
            digests.append(_digest(table))
            if hasattr(source, "madvise"):
                source.madvise(mmap.MADV_DONTNEED)
        if reader.arrivals:
            writer.add_key_value_metadata({ARRIVALS: json.dumps(list(zip(*reader.arrivals, strict=True)))})
    return digests


def _arrivals_of(file: Any) -> list[tuple[int, int]]:
    device, host = json.loads((file.metadata.metadata or {}).get(ARRIVALS.encode(), b"[[], []]"))
    return [(int(a), int(b)) for a, b in zip(device, host, strict=True)]


def _tables(batches: Iterable[Any], schema: Any) -> Iterator[Any]:
    """The batches as tables of GROUP rows, the last one shorter."""
    waiting: list[Any] = []
    rows = 0
    for batch in batches:
        waiting.append(batch)
        rows += batch.num_rows
        if rows >= GROUP:
            table = pa.Table.from_batches(waiting, schema)
            whole = rows - rows % GROUP
            yield from (table.slice(start, GROUP) for start in range(0, whole, GROUP))
            waiting, rows = table.slice(whole).to_batches(), rows - whole
    if rows:
        yield pa.Table.from_batches(waiting, schema)


def _digest(table: Any) -> bytes:
    digest = hashlib.sha256()
    for column in table.columns:
        for chunk in column.chunks:
            digest.update(raw_bytes(chunk))
    return digest.digest()


def _row_groups(path: Path) -> Iterator[Any]:
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        for index in range(file.num_row_groups):
            yield file.read_row_group(index)


def read_archive(source: Any) -> tuple[Any, dict[str, Any], list[tuple[int, int]]]:
    """The table of a Parquet stream (a buffer), what its schema says, and its arrivals; ValueError where it is damaged.

    Arrivals: clock of the device and of the host [ns] for the last sample of each batch that has it.
    """
    try:
        with pq.ParquetFile(source, page_checksum_verification=True) as file:
            about = about_stream(file.schema_arrow)
            return file.read(use_threads=False), about, _arrivals_of(file)
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"cannot be read as Parquet ({str(error).splitlines()[0]})") from error


def span_of(path: Path) -> tuple[int, int, int]:
    """Rows, and the lowest and highest time [ns], of a Parquet stream; ValueError where it is damaged."""
    try:
        with pq.ParquetFile(path) as file:
            groups = [file.metadata.row_group(index).column(0).statistics for index in range(file.num_row_groups)]
            low, high = min((g.min for g in groups), default=0), max((g.max for g in groups), default=0)
            return file.metadata.num_rows, low, high
    except (pa.ArrowException, OSError, AttributeError) as error:
        raise ValueError(f"cannot be read as Parquet ({error})") from error
