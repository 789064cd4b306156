"""Samples written to disk during a run: an Arrow stream whose batches carry seq, crc32 and an end mark.

Knows no run folder.

A batch's crc32 covers the schema message (names, types, scales), the text "seq rows end", `host_ns` where it is given,
and the bytes of each column in order. `rows` counts all rows up to and including the batch; the first batch is empty
and the last has `end` 1. `host_ns` is the arrival of the batch's last sample, on the clock of the host.
"""

from __future__ import annotations

import json
import threading
import time
import zlib
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from pmabench.base.errors import RecordError
from pmabench.base.quantities import QUANTITIES
from pmabench.store.folder import AppendFile, plain

pa: Any = pyarrow  # pyarrow has no type hints: other modules import these names
pq: Any = pyarrow.parquet
arrow_csv: Any = pyarrow.csv
DAMAGED: tuple[type[Exception], ...] = (pa.ArrowException, OSError, ValueError, KeyError, TypeError, RecursionError)
"""Errors raised on reading damaged files."""
STREAM_SCHEMA = "pmabench.stream/1"
TIME, FLAGS = "time_ns", "flags"
KEY = b"pmabench"
_END_OF_STREAM = b"\xff\xff\xff\xff\x00\x00\x00\x00"
_TORN: tuple[type[Exception], ...] = (*DAMAGED, NotImplementedError, MemoryError)
_TYPES = {"int32": pa.int32(), "float64": pa.float64()}


def describe(name: str, columns: Sequence[Mapping[str, Any]], rate: float) -> dict[str, Any]:
    """Description of a stream for its JSON file and schema: name, rate [Hz], and each column as its ChannelRecord."""
    return {"schema": STREAM_SCHEMA, "stream": name, "rate": rate, "columns": [plain(column) for column in columns]}


def arrow_schema(about: Mapping[str, Any]) -> Any:
    """The Arrow schema of a stream: `time_ns`, the channels as raw values, `flags`."""
    fields = [pa.field(TIME, pa.int64(), False, {"unit": "ns"})]
    for column in about["columns"]:
        name, raw_type = column["name"], column.get("raw_type", "float64")
        if raw_type not in _TYPES or name in (TIME, FLAGS, *(field.name for field in fields)):
            raise RecordError(f'stream {about["stream"]}: "{name}" of type "{raw_type}" cannot be a column')
        known = QUANTITIES.get(column.get("quantity", ""))
        scale = column.get("scale") or {}
        notes = {
            "unit": str(column.get("raw_unit", "")),
            "quantity": str(column.get("quantity", "")),
            "si_unit": known.unit if known else "",
            "slope": repr(float(scale.get("slope", 1.0))),
            "offset": repr(float(scale.get("offset", 0.0))),
            "calibration": json.dumps(column.get("calibration") or {}, sort_keys=True),
        }
        fields.append(pa.field(name, _TYPES[raw_type], False, notes))
    fields.append(pa.field(FLAGS, pa.uint16(), False, {"unit": ""}))
    return pa.schema(fields, {KEY: json.dumps(dict(about), sort_keys=True).encode()})


def about_stream(schema: Any) -> dict[str, Any]:
    """The description in a schema from `arrow_schema`; raises ValueError for any other schema."""
    about = json.loads((schema.metadata or {}).get(KEY, b"null"))
    if not isinstance(about, dict) or about.get("schema") != STREAM_SCHEMA:
        raise ValueError(f"is not of the schema {STREAM_SCHEMA}")
    if schema.names != [TIME, *(column["name"] for column in about["columns"]), FLAGS]:
        raise ValueError("its columns are not those that it describes")
    return about


class _Sink(BytesIO):
    """Buffers Arrow's output, so that each batch is written to disk in one piece."""

    def take(self) -> bytes:
        """The bytes since the last call."""
        piece = self.getvalue()
        self.seek(0)
        self.truncate()
        return piece


class LiveStream:
    """Writes one stream; `put` and `drain` may be called by different threads, and a failed write loses nothing."""

    def __init__(self, path: Path, about: Mapping[str, Any]) -> None:
        """Create the file with its schema and an empty first batch. Raises OSError or RecordError."""
        self.about = about
        self.rows = 0
        self.last_ns: int | None = None
        self._schema = arrow_schema(about)
        self._types = {field.name: field.type.to_pandas_dtype() for field in self._schema}
        self._pending: deque[tuple[dict[str, NDArray[Any]], int | None]] = deque()
        self._since = 0.0
        self._lock = threading.Lock()
        self._block = b""
        self._seq = 0
        head = pa.BufferOutputStream()
        pa.ipc.new_stream(head, self._schema).close()
        self._head = _crc_of_head(head.getvalue())
        self._sink = _Sink()
        self._arrow = pa.ipc.new_stream(self._sink, self._schema)
        self._build({name: np.empty(0, kind) for name, kind in self._types.items()})
        self.file = AppendFile(path).open()
        self.drain()

    def put(self, time_ns: Any, columns: Mapping[str, Any], flags: Any, host_ns: int | None = None) -> None:
        """Take a copy of samples, arrays of length n for all columns. Raises RecordError where they do not fit.

        `host_ns`: their arrival on the host's monotonic clock since the start of the run [ns].
        """
        given = {TIME: time_ns, **columns, FLAGS: flags}
        if given.keys() != self._types.keys():
            odd = ", ".join(sorted(given.keys() ^ self._types.keys()))
            raise RecordError(f"{self._where()}: samples and columns differ in {odd}")
        kept = {name: self._exact(name, given[name], kind) for name, kind in self._types.items()}
        if len({column.shape for column in kept.values()}) != 1 or kept[TIME].ndim != 1:
            raise RecordError(f"{self._where()}: columns of unequal length")
        if len(kept[TIME]):
            if not self._pending:
                self._since = time.monotonic()
            self._pending.append((kept, None if host_ns is None else int(host_ns)))

    def _where(self) -> str:
        return f"stream {self.about['stream']}"

    def _exact(self, name: str, values: Any, kind: Any) -> NDArray[Any]:
        given = np.asarray(values)
        if given.dtype == kind:
            return given.copy()
        with np.errstate(invalid="ignore"):
            kept = given.astype(kind)
        if given.dtype != kept.dtype and kept.dtype.kind != "f" and not np.array_equal(kept, given):
            raise RecordError(f"{self._where()}, column {name}: a value does not fit {kept.dtype}")
        return kept

    def waiting(self) -> float:
        """Time that the oldest unwritten sample has waited [s]; 0 without one."""
        return time.monotonic() - self._since if self._pending else 0.0

    def drain(self) -> None:
        """Write all waiting samples as one batch; a failed batch is kept for the next call. Raises OSError."""
        with self._lock:
            while self._block or self._pending:
                if not self._block:
                    parts = [self._pending.popleft() for _ in range(len(self._pending))]
                    columns = {name: np.concatenate([part[name] for part, _ in parts]) for name in self._types}
                    self._build(columns, host_ns=parts[-1][1])
                self.file.write(self._block)
                self._block = b""

    def _build(self, columns: Mapping[str, NDArray[Any]], end: int = 0, host_ns: int | None = None) -> None:
        count = len(columns[TIME])
        # `pa.array` would import pandas
        arrays = [pa.Array.from_buffers(f.type, count, [None, pa.py_buffer(columns[f.name])]) for f in self._schema]
        batch = pa.RecordBatch.from_arrays(arrays, schema=self._schema)
        rows = self.rows + count
        host = {} if host_ns is None else {"host_ns": str(host_ns)}
        crc = zlib.crc32(b"%d %d %d" % (self._seq, rows, end) + host.get("host_ns", "").encode(), self._head)
        for column in columns.values():
            crc = zlib.crc32(column.data, crc)
        notes = {"seq": str(self._seq), "rows": str(rows), "end": str(end), **host, "crc32": f"{crc:08x}"}
        self._arrow.write_batch(batch, custom_metadata=notes)
        self._block = self._sink.take()
        self._seq, self.rows = self._seq + 1, rows
        if count:
            self.last_ns = int(columns[TIME][-1])

    def finish(self) -> None:
        """Write all waiting samples and the end mark, sync, and close the file. Raises OSError."""
        self.drain()
        with self._lock:
            self._build({name: np.empty(0, kind) for name, kind in self._types.items()}, end=1)
            self._arrow.close()
            self._block += self._sink.take()
            self.file.write(self._block)
            self._block = b""
        self.file.sync()
        self.file.close()


def _crc_of_head(data: Any) -> int:
    """Crc32 of the schema message at the beginning of a stream."""
    return zlib.crc32(data[: 8 + int.from_bytes(data[4:8].to_pybytes(), "little")])


def raw_bytes(array: Any) -> Any:
    """The bytes of the values of an Arrow array of numbers, as a buffer; ValueError where values are missing.

    Arrow's `to_numpy` would do, but imports pandas.
    """
    if array.null_count:
        raise ValueError("a value is missing")
    width = array.type.bit_width // 8
    buffer = array.buffers()[1]
    return buffer[array.offset * width : (array.offset + len(array)) * width] if len(array) else b""


def numbers(array: Any) -> NDArray[Any]:
    """The values of an Arrow array of numbers, shape (n,), not copied; ValueError where values are missing."""
    return np.frombuffer(raw_bytes(array), dtype=array.type.to_pandas_dtype())


class LiveReader:
    """Iterates over the batches of a live stream and stops before the first damaged or incomplete one."""

    def __init__(self, data: Any, batches: int = 0, rows: int = 0) -> None:
        """`data`: a `pyarrow.Buffer` with the file's bytes. Raises ValueError where even the schema is incomplete.

        To continue after `batches` batches with `rows` rows, `data` is the schema message and the bytes after these
        batches.
        """
        self.batches = batches
        self.rows = rows
        self.ended = False
        self.fault = ""
        self.torn = False
        self.arrivals: list[tuple[int, int]] = []
        """Times of device and host [ns] for the last sample of each batch with `host_ns`."""
        self._data = data
        try:
            self._source = pa.BufferReader(data)
            self._reader = pa.ipc.open_stream(self._source)
            self.position = self.head = self._source.tell()
            self.schema = self._reader.schema
            self.about = about_stream(self.schema)
        except DAMAGED as error:
            raise ValueError(f"has no whole schema ({error})") from error

    def __iter__(self) -> Iterator[Any]:
        """Batches in order; afterwards `rows`, `ended` and `fault` state how far it came and why it stopped.

        `torn`: whether bytes remain that belong to no complete batch; `position`: end of the complete batches in the
        data, `head`: begin of the first.
        """
        head = _crc_of_head(self._data)
        seq = self.batches
        self.torn = True
        while not self.ended:
            try:
                batch, notes = self._reader.read_next_batch_with_custom_metadata()
                batch.validate(full=True)
                rows, end = self.rows + batch.num_rows, notes[b"end"]
                host = notes.get(b"host_ns", b"")
                crc = zlib.crc32(b"%d %d %s" % (seq, rows, end) + host, head)
                for column in batch.columns:
                    crc = zlib.crc32(raw_bytes(column), crc)
                whole = notes[b"crc32"] == b"%08x" % crc
                pair = [(batch.column(0)[-1].as_py(), int(host))] if whole and host and batch.num_rows else []
            except StopIteration:
                self.fault = f"stops after batch {seq - 1} without its end mark"
                self.torn = False
                return
            except _TORN as error:
                reason = (str(error).splitlines() or [type(error).__name__])[0]
                self.fault = f"batch {seq} is torn or altered ({reason})"
                return
            if not whole:
                self.fault = f"batch {seq} is altered: its crc32 does not fit"
                return
            seq, self.rows, self.ended = seq + 1, rows, end == b"1"
            self.arrivals += pair
            self.batches, self.position = seq, self._source.tell()
            yield batch
        self.torn = self._data[self._source.tell() :].to_pybytes() not in (b"", _END_OF_STREAM)
        if self.torn:
            self.fault = "something follows the end mark"
