"""An analysis as files: JSON, and the numbers behind its figures as Parquet; computes nothing.

The record `.made-from.json` next to them states what they were made from. Stored analyses are reused only if runs,
notes, options and program are the same (`key_of`) and their files are unchanged. The same analysis gives the same
bytes. Files that are read are not trusted: names must stay inside the folder, and types are checked.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from pmabench.base.errors import RecordError, invalid
from pmabench.base.kind import Result
from pmabench.base.quantities import QUANTITIES
from pmabench.base.text import clean, unused
from pmabench.store import folder as files
from pmabench.store.analyses.results import SCHEMA, Analysis, Curve, Trace
from pmabench.store.folder import open_regular, plain, sha256_of
from pmabench.store.json_files import read_json
from pmabench.store.livestream import numbers, pa, pq
from pmabench.store.since import fingerprint, program, stamp

RECORD = ".made-from.json"
MADE_FROM_SCHEMA = "pmabench.made-from/1"
MADE_FROM_LONGEST = 50_000_000
"""Largest size of such a record that is read [bytes]."""


@dataclass(frozen=True)
class Kept:
    """Stored analyses that can be reused; without `folders` there are none."""

    folders: tuple[Path, ...] = ()
    entry: Mapping[str, Any] = field(default_factory=dict)
    """Additional data stored with them."""
    why: str = ""
    """Why they are not reused, where a user should know; else empty."""


def key_of(runs: Iterable[Path], options: Mapping[str, Any]) -> str:
    """Hash of the runs (with those that they continue), the options by kind and the program; empty for an open run."""
    return fingerprint(runs, f"{program()} {json.dumps(options, sort_keys=True)}")


def keep(
    place: Path,
    key: str,
    runs: Iterable[Path],
    options: Mapping[str, Any],
    folders: Sequence[Path],
    entry: Mapping[str, Any] | None = None,
) -> None:
    """Record what the analyses in `folders`, all in `place`, were made from; without a key there is no record."""
    with suppress(OSError):
        (place / RECORD).unlink(missing_ok=True)
        if key:
            record = {
                "schema": MADE_FROM_SCHEMA,
                "key": key,
                "program": program(),
                "options": options,
                "runs": {run.name: sha256_of(run / files.SEAL) for run in runs},
                "analyses": {folder.name: stamp(folder) for folder in folders},
                "entry": dict(entry or {}),
            }
            (place / RECORD).write_text(json.dumps(record, allow_nan=False), encoding="utf-8")


def kept(place: Path, key: str, options: Mapping[str, Any]) -> Kept:
    """The stored analyses in `place` if they were made with this `key` (of runs and `options`) and are unchanged."""
    try:
        with open_regular(place / RECORD) as file:
            record = json.loads(file.read(MADE_FROM_LONGEST))
        found, before, entry = record["analyses"], record["options"], record["entry"]
        whole = isinstance(entry, dict) and all(Path(name).name == name for name in found)
        same = whole and all(stamp(place / name) == mark != "" for name, mark in found.items())
    except FileNotFoundError:
        return Kept()
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return Kept(why=f"{place / RECORD} is damaged")
    if record.get("key") != key or not key:
        other = before != options and record.get("program") == program()
        return Kept(why=f"{place} was made with other options ({_words(before)})" if other else "")
    if not same:
        return Kept(why=f"{place} was changed after it was written")
    return Kept(tuple(place / name for name in found), entry)


def _words(options: Any) -> str:
    """Names of the options that were given, for a message; `none` without any."""
    mine = [one for one in options.values() if isinstance(one, Mapping)] if isinstance(options, Mapping) else []
    return ", ".join(dict.fromkeys(str(name) for one in mine for name in one)) or "none"


ANALYSIS = "analysis.json"
TRACES = "traces"
LONGEST = 50_000_000
"""Largest size of an `analysis.json` that is read [bytes]."""
MOST_ROWS = 10_000_000
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


def file_names(names: Iterator[str] | list[str]) -> list[str]:
    """A file name for each trace: legal on every system, and unique even if upper and lower case are the same."""
    taken: set[str] = set()
    stems = (re.sub(r"[^A-Za-z0-9._-]+", "-", name)[:100].strip("-.") or "trace" for name in names)
    return [unused(f"trace-{stem}" if _RESERVED.fullmatch(stem) else stem, taken) for stem in stems]


def write_analysis(analysis: Analysis, folder: Path) -> Path:
    """Write `analysis.json` and `traces/<name>.parquet` into `folder`; traces of an earlier analysis are deleted.

    Raises RecordError where it cannot be written.
    """
    try:
        (folder / TRACES).mkdir(parents=True, exist_ok=True)
        for old in (folder / TRACES).glob("*.parquet"):
            old.unlink()
        data, names = analysis.to_dict(), file_names([trace.name for trace in analysis.traces])
        for entry, trace, name in zip(data["traces"], analysis.traces, names, strict=True):
            entry |= {"file": f"{TRACES}/{name}.parquet", "columns": list(trace.columns)}
            _write_trace(trace, folder / entry["file"])
        (folder / ANALYSIS).write_bytes(in_lines(plain(data)).encode())
    except OSError as error:
        raise RecordError(f"{folder}: the analysis cannot be written: {error.strerror or error}") from error
    return folder


def in_lines(data: Mapping[str, Any]) -> str:
    """JSON with a line for each entry and for each item of a list entry; `indent` would be ten times slower."""
    text = json.JSONEncoder(sort_keys=True, ensure_ascii=False, allow_nan=False).encode
    lists = {key: ",\n  ".join(map(text, value)) for key, value in data.items() if isinstance(value, list) and value}
    values = {key: f"[\n  {lists[key]}\n ]" if key in lists else text(value) for key, value in data.items()}
    entries = [f"{text(key)}: {value}" for key, value in sorted(values.items())]
    return "{\n " + ",\n ".join(entries) + "\n}\n"


def _write_trace(trace: Trace, path: Path) -> None:
    fields = []
    for name in trace.columns:
        quantity = trace.quantities.get(name, "")
        unit = QUANTITIES[quantity].unit if quantity in QUANTITIES else ""
        fields.append(pa.field(name, pa.float64(), metadata={"quantity": quantity, "unit": unit}))
    columns = [np.ascontiguousarray(values, dtype=np.float64) for values in trace.columns.values()]
    # `pa.array` would import pandas
    arrays = [pa.Array.from_buffers(pa.float64(), len(values), [None, pa.py_buffer(values)]) for values in columns]
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields))
    pq.write_table(table, path, compression="zstd", compression_level=3, use_dictionary=False)


def read_analysis(folder: Path) -> Analysis:
    """The analysis in `folder`, as written by `write_analysis`; raises InvalidFile with the reason."""
    data, path = _data(folder), folder / ANALYSIS
    try:
        curves, traces = (data.pop(name) for name in ("curves", "traces"))
        needed = {name: data[name] for name in ("estimates", "dropped", "findings", "facts")}
        rest: Analysis = _read(Analysis, {**data, **needed, "results": []})
        return replace(
            rest,
            curves=tuple(_curve(curve) for curve in curves),
            traces=tuple(_trace(folder, trace) for trace in traces),
            results=_read(tuple[Result, ...], data.get("results", [])),
        )
    except KeyError as error:
        raise invalid(path, f"lacks the entry {error}") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise invalid(path, f"is damaged: {error}") from error


def _data(folder: Path) -> dict[str, Any]:
    if not (folder / ANALYSIS).is_file():
        raise invalid(folder, f"is not an analysis folder: there is no {ANALYSIS} in it")
    return read_json(folder / ANALYSIS, SCHEMA, "analysis", LONGEST)


def analyses_below(path: Path) -> list[Path]:
    """The folder itself where it is an analysis, else the analyses up to two levels below it; none in a run."""
    if (path / "manifest.json").exists():
        return []
    for pattern in (ANALYSIS, f"*/{ANALYSIS}", f"*/*/{ANALYSIS}"):
        if found := sorted(path.glob(pattern)):
            return [file.parent for file in found]
    return []


def runs_of(folder: Path) -> list[Path]:
    """Folders of the runs behind an analysis that are in the places used by `process` and `demo`.

    These are next to the analysis folder and its parents, in a folder `runs` there, and for `analyses/each` at the same
    relative path. Runs that are not found are left out.
    """
    names = _data(folder).get("runs")
    found = []
    parents = list(folder.resolve().parents)
    places = parents[:4]
    each = next((place for place in parents if (place.name, place.parent.name) == ("each", "analyses")), None)
    if each is not None:
        places.extend(each.parents[1] / part / parents[0].relative_to(each).parent for part in ("", "runs"))
    for name in names if isinstance(names, list) else ():
        if not isinstance(name, str) or not files.PLAIN_NAME.fullmatch(name):
            continue
        candidates = (place / part / name for place in places for part in ("", "runs"))
        known = next((c for c in candidates if (c / "manifest.json").is_file()), None)
        if known is not None:
            found.append(known)
    return found


@lru_cache
def _fields(record: type) -> tuple[tuple[str, Any, bool], ...]:
    """Name and type of each field of a record, and whether it must be there."""
    types = get_type_hints(record)
    return tuple((f.name, types[f.name], f.default is MISSING and f.default_factory is MISSING) for f in fields(record))


@lru_cache
def _made_of(kind: Any) -> tuple[Any, tuple[Any, ...], bool]:
    """Origin and arguments of a type, and whether it is a record."""
    return get_origin(kind), get_args(kind), isinstance(kind, type) and is_dataclass(kind)


def _read(kind: Any, value: Any) -> Any:
    """Convert a JSON value to the type `kind` of a field; TypeError or ValueError where it does not fit.

    Missing entries of a record get their default, unknown ones are ignored.
    """
    origin, inner, record = _made_of(kind)
    if record and isinstance(value, Mapping):
        known = [(name, type_) for name, type_, needed in _fields(kind) if needed or name in value]
        return kind(**{name: _read(type_, value[name]) for name, type_ in known})
    if origin is UnionType:  # something or None
        return None if value is None else _read(inner[0], value)
    if origin is Mapping and isinstance(value, Mapping):
        return {_read(str, key): _read(inner[1], item) for key, item in value.items()}
    if origin is tuple and isinstance(value, list):
        kinds = [inner[0]] * len(value) if inner[-1] is Ellipsis else inner
        if len(kinds) != len(value):
            raise ValueError(f"{len(value)} values are there where {len(kinds)} are expected")
        return tuple(map(_read, kinds, value))
    if kind is str and isinstance(value, str):
        return clean(value, LONGEST)
    if kind is Any or (kind is bool and isinstance(value, bool)):
        return value
    if kind in (int, float) and isinstance(value, int | float) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise ValueError(f"{value} is not finite")
        return kind(value)
    expected = getattr(kind, "__name__", str(kind))
    raise TypeError(f"{str(value)[:40]} is there where {expected} is expected")


def _curve(data: Mapping[str, Any]) -> Curve:
    """A curve from JSON, where NaN was written as null."""
    r2, residual = (math.nan if data[name] is None else _read(float, data[name]) for name in ("r2", "residual_rms"))
    curve: Curve = _read(Curve, {**data, "r2": 0.0, "residual_rms": 0.0})
    if not curve.scale > 0:
        raise ValueError(f"the scale of a curve is {curve.scale:g}; a number above 0 is expected")
    return replace(curve, r2=r2, residual_rms=residual)


def _trace(folder: Path, t: Mapping[str, Any]) -> Trace:
    parts = _read(str, t["file"]).split("/")
    if len(parts) != 2 or parts[0] != TRACES or not files.PLAIN_NAME.fullmatch(parts[1]):
        raise ValueError(f"the file of a trace, {t['file'][:80]!r}, does not lie in {TRACES}/")
    path = folder / TRACES / parts[1]
    wanted = list(_read(tuple[str, ...], t["columns"]))
    try:
        file = None if path.is_symlink() else pq.ParquetFile(path)  # `read_table` would import all of pyarrow
        if file is None or file.metadata.num_rows > MOST_ROWS:
            raise ValueError(f"{t['file']} is a link or too long")
        table = file.read(wanted)
        found = {name: table.column(name).combine_chunks() for name in wanted}
        columns = {name: np.asarray(numbers(values), dtype=np.float64) for name, values in found.items()}
    except (OSError, pa.ArrowException) as error:
        raise ValueError(f"{t['file']} cannot be read: {error}") from error
    return Trace(
        **{name: _read(str, t[name]) for name in ("name", "figure", "title")},
        columns=columns,
        quantities=_read(Mapping[str, str], t["quantities"]),
        marks=_read(Mapping[str, float], t["marks"]),
    )
