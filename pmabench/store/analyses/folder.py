"""An analysis as files: JSON, and the numbers behind its figures as Parquet; computes nothing.

The same analysis gives the same bytes. What is read back is untrusted: names stay inside the folder, types are checked.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.base.errors import RecordError, invalid
from pmabench.base.kind import Result
from pmabench.base.text import clean
from pmabench.store.analyses.results import SCHEMA, Analysis, Curve, Dropped, Estimate, Finding, Parts, Source, Trace
from pmabench.store.folder import plain
from pmabench.store.json_files import read_json

ANALYSIS = "analysis.json"
TRACES = "traces"
LONGEST = 50_000_000
"""Bytes of an `analysis.json` that is read."""
MOST_ROWS = 10_000_000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}")
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


def file_names(names: Iterator[str] | list[str]) -> list[str]:
    """A file name, legal everywhere and used once whatever the case, for each name of a trace."""
    taken: set[str] = set()
    result = []
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9._-]+", "-", name)[:100].strip("-.") or "trace"
        if _RESERVED.fullmatch(stem):
            stem = f"trace-{stem}"
        unique, count = stem, 1
        while unique.casefold() in taken:
            count += 1
            unique = f"{stem}-{count}"
        taken.add(unique.casefold())
        result.append(unique)
    return result


def write_analysis(analysis: Analysis, folder: Path) -> Path:
    """Write `analysis.json` and `traces/<name>.parquet` into `folder`; those of an earlier one go.

    Raises RecordError where it cannot be written.
    """
    try:
        (folder / TRACES).mkdir(parents=True, exist_ok=True)
        for old in (folder / TRACES).glob("*.parquet"):
            old.unlink()
        data = analysis.to_dict()
        for entry, trace, name in zip(
            data["traces"], analysis.traces, file_names([trace.name for trace in analysis.traces]), strict=True
        ):
            entry["file"] = f"{TRACES}/{name}.parquet"
            entry["columns"] = list(trace.columns)
            _write_trace(trace, folder / entry["file"])
        text = json.dumps(plain(data), indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False)
        (folder / ANALYSIS).write_bytes(f"{text}\n".encode())
    except OSError as error:
        raise RecordError(f"{folder}: the analysis cannot be written: {error.strerror or error}") from error
    return folder


def _write_trace(trace: Trace, path: Path) -> None:
    from pmabench.base.quantities import QUANTITIES
    from pmabench.store.arrow import pa, pq

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
    """The inverse of `write_analysis`; raises InvalidFile with what is wrong."""
    path = folder / ANALYSIS
    if not path.is_file():
        raise invalid(folder, f"is not an analysis folder: there is no {ANALYSIS} in it")
    data = read_json(path, SCHEMA, "analysis", LONGEST)
    with _told(path):
        return Analysis(
            kind=_text(data["kind"]),
            runs=tuple(_text(run) for run in data["runs"]),
            simulated=_flag(data["simulated"]),
            estimates=tuple(_estimate(e) for e in data["estimates"]),
            curves=tuple(_curve(c) for c in data["curves"]),
            dropped=tuple(Dropped(_text(d["trial"]), _point(d["point"]), _text(d["reason"])) for d in data["dropped"]),
            findings=tuple(Finding(_text(f["level"]), _text(f["text"])) for f in data["findings"]),
            traces=tuple(_trace(folder, t) for t in data["traces"]),
            facts=dict(data["facts"]),
            refusals=tuple(_text(reason) for reason in data.get("refusals", ())),
            results=tuple(_result(r) for r in data.get("results", ())),
        )


def analyses_below(path: Path) -> list[Path]:
    """The folder itself where it is an analysis, else the analyses up to two levels below it; none in a run."""
    if (path / "manifest.json").exists():
        return []
    for pattern in (ANALYSIS, f"*/{ANALYSIS}", f"*/*/{ANALYSIS}"):
        if found := sorted(path.glob(pattern)):
            return [file.parent for file in found]
    return []


def runs_of(folder: Path) -> list[Path]:
    """The folders of the runs behind an analysis, as far as they lie where `process` and `demo` leave them.

    Looked for beside the analysis folder and its parents, in a folder `runs` there, and where `analyses/each` has the
    same folders; what is not found is left out.
    """
    path = folder / ANALYSIS
    try:
        names = json.loads(path.read_bytes())["runs"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise invalid(folder, f"is not an analysis folder: {ANALYSIS} cannot be read") from error
    found = []
    parents = list(folder.resolve().parents)
    places = parents[:4]
    each = next((place for place in parents if (place.name, place.parent.name) == ("each", "analyses")), None)
    if each is not None:
        places.extend(each.parents[1] / part / parents[0].relative_to(each).parent for part in ("", "runs"))
    for name in names if isinstance(names, list) else ():
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            continue
        candidates = (place / part / name for place in places for part in ("", "runs"))
        known = next((c for c in candidates if (c / "manifest.json").is_file()), None)
        if known is not None:
            found.append(known)
    return found


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Whatever does not fit becomes one sentence."""
    try:
        yield
    except KeyError as error:
        raise invalid(path, f"lacks the entry {error}") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise invalid(path, f"is damaged: {error}") from error


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"text was expected, not {str(value)[:40]}")
    return clean(value, LONGEST)


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"true or false was expected, not {str(value)[:40]}")
    return value


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"a number was expected, not {str(value)[:40]}")
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{value} is not finite")
    return number


def _maybe(value: Any) -> float | None:
    return None if value is None else _number(value)


def _number_or_nan(value: Any) -> float:
    return math.nan if value is None else _number(value)


def _point(value: Any) -> dict[str, float]:
    if not isinstance(value, Mapping):
        raise TypeError(f"an operating point was expected, not {str(value)[:40]}")
    return {key: _number(item) for key, item in value.items()}


def _estimate(e: Mapping[str, Any]) -> Estimate:
    parts = e["parts"]
    return Estimate(
        symbol=_text(e["symbol"]),
        value=_maybe(e["value"]),
        unit=_text(e["unit"]),
        quantity=_text(e["quantity"]),
        method=_text(e["method"]),
        at=_point(e["at"]),
        parts=Parts(
            repeats=_maybe(parts["repeats"]),
            method=_maybe(parts["method"]),
            calibration=_maybe(parts["calibration"]),
            skew=_number(parts.get("skew", 0.0)),
            drift=_number(parts.get("drift", 0.0)),
        ),
        n=int(_number(e["n"])),
        bias=_maybe(e["bias"]),
        corrected=_flag(e["corrected"]),
        note=_text(e["note"]),
        trials=tuple(_text(trial) for trial in e["trials"]),
        coordinate=_text(e["coordinate"]),
        budget=tuple(_source(s) for s in e.get("budget", ())),
        withheld=_flag(e.get("withheld", False)),
    )


def _result(r: Mapping[str, Any]) -> Result:
    texts = {name: _text(r[name]) for name in ("symbol", "title", "quantity", "plot", "unit")}
    return Result(**texts, headline=_flag(r["headline"]))


def _source(s: Mapping[str, Any]) -> Source:
    return Source(_text(s["name"]), _text(s["part"]), _text(s["kind"]), _maybe(s["half"]), _text(s["note"]))


def _curve(c: Mapping[str, Any]) -> Curve:
    low, high = (_number(end) for end in c["domain"])
    scale = _number(c.get("scale", 1.0))
    if not scale > 0:
        raise ValueError(f"the scale of a curve is {scale:g}; a number above 0 is expected")
    return Curve(
        symbol=_text(c["symbol"]),
        form=_text(c["form"]),
        terms=tuple(_estimate(term) for term in c["terms"]),
        against=_text(c["against"]),
        domain=(low, high),
        r2=_number_or_nan(c["r2"]),
        residual_rms=_number_or_nan(c["residual_rms"]),
        method=_text(c["method"]),
        centre=_number(c.get("centre", 0.0)),
        scale=scale,
    )


def _trace(folder: Path, t: Mapping[str, Any]) -> Trace:
    from pmabench.store.arrow import pa, pq

    parts = _text(t["file"]).split("/")
    if len(parts) != 2 or parts[0] != TRACES or not _NAME.fullmatch(parts[1]):
        raise ValueError(f"the file of a trace, {t['file'][:80]!r}, does not lie in {TRACES}/")
    path = folder / TRACES / parts[1]
    wanted = [_text(name) for name in t["columns"]]
    try:
        if path.is_symlink() or pq.read_metadata(path).num_rows > MOST_ROWS:
            raise ValueError(f"{t['file']} is a link or too long")
        table = pq.read_table(path, columns=wanted)
        columns = {name: np.asarray(table.column(name).to_numpy(), dtype=np.float64) for name in wanted}
    except (OSError, pa.ArrowException) as error:
        raise ValueError(f"{t['file']} cannot be read: {error}") from error
    return Trace(
        name=_text(t["name"]),
        figure=_text(t["figure"]),
        title=_text(t["title"]),
        columns=columns,
        quantities={_text(key): _text(value) for key, value in t["quantities"].items()},
        marks=_point(t["marks"]),
    )
