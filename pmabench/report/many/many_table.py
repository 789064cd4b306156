"""The one table of many runs: a row per run, method and operating point, numbers in display units, units in headers.

CSV and Parquet hold the table, JSON all estimates in SI. The same results give the same bytes, whoever worked them out.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pmabench.base.errors import RecordError
from pmabench.plotting.wording import POINTS, in_order, plain_unit, point_shown, shown, symbol_text
from pmabench.report.files.csv_files import csv_text
from pmabench.report.many.many import Many
from pmabench.report.words.names import in_common

NAME = "all-runs"
SCHEMA = "pmabench.process-many/1"
KEPT_TABLE = f".{NAME}.made-from.json"
"""Says of which results the table is, so that it is not written again."""
FIRST = {"run": "", "started": "", "specimen": "", "kind": "", "simulated": False, "method": ""}
LAST = {"trials": 0, "not accepted": "", "analysis": ""}
"""Columns before and after the numbers."""
KEPT = ("run", "runs", "kind", "started", "specimen", "simulated", "folder", "estimates", "dropped", "findings")
"""Keys of a run in JSON; verdicts and exclusions come with it."""


def write_table(many: Many) -> list[Path]:
    """`all-runs.csv`, `.parquet` and `.json` next to the analyses, as far as they are not there already.

    Raises RecordError where they cannot be written.
    """
    paths = [many.out / f"{NAME}.{suffix}" for suffix in ("csv", "parquet", "json")]
    key = many.key
    kept = many.out / KEPT_TABLE
    with suppress(OSError, ValueError):
        if json.loads(kept.read_bytes()) == [key, _stamps(paths)]:
            return paths
    rows, numbers = table_rows(many.results())
    columns = [*FIRST, *numbers, *LAST]
    ordered = [{name: row.get(name) for name in columns} for row in rows]
    try:
        paths[0].write_text(csv_text(ordered, columns), encoding="utf-8", newline="")
        _write_parquet(ordered, numbers, paths[1])
        with paths[2].open("w", encoding="utf-8", newline="") as file:
            file.writelines(_json_lines(many))
    except OSError as error:
        raise RecordError(f"{many.out}: the table cannot be written: {error.strerror or error}") from error
    with suppress(OSError):
        kept.write_text(json.dumps([key, _stamps(paths)]), encoding="utf-8")
    return paths


def _stamps(paths: Iterable[Path]) -> list[list[int]]:
    """Size and time of each file."""
    return [[info.st_size, info.st_mtime_ns] for info in (path.stat() for path in paths)]


def plain_entry(entry: Mapping[str, Any]) -> dict[str, Any]:
    """A result as in JSON, the same whether it was worked out now or before."""
    return {name: entry[name] for name in (*KEPT, "verdicts", "excluded", "since")}


def _json_lines(many: Many) -> Iterable[str]:
    """One object, a run on each line."""
    yield f'{{"schema": "{SCHEMA}",\n "runs": ['
    before = "\n  "
    for entry in many.results():
        yield before + json.dumps(plain_entry(entry), sort_keys=True, ensure_ascii=False, allow_nan=False)
        before = ",\n  "
    yield "\n ]\n}\n"


def table_rows(entries: Iterable[Mapping[str, Any]]) -> tuple[list[dict[str, Any]], dict[str, tuple[str, str]]]:
    """The rows, and of each column of numbers its quantity and unit, in the order of the table."""
    rows: list[dict[str, Any]] = []
    points: set[str] = set()
    symbols: set[tuple[str, str, str, str]] = set()
    orders: dict[str, list[str]] = {}
    for entry in entries:
        orders[entry["kind"]] = entry.get("symbols") or [e["symbol"] for e in entry["estimates"]]
        about = {name: entry[name] for name in ("run", "started", "specimen", "kind", "simulated")}
        about |= {"not accepted": "; ".join(entry["verdicts"]), "analysis": entry["folder"]}
        found: dict[tuple[Any, ...], dict[str, Any]] = {}
        for e in entry["estimates"]:
            row = found.setdefault((e["method"], *sorted(e["at"].items())), {**about, "method": e["method"]})
            row["trials"] = max(row.get("trials", 0), e["n"])
            for name, value in e["at"].items():
                points.add(name)
                row[_point_head(name)[0]] = value / point_shown(name)[1].scale
            symbol = (e["symbol"], e["coordinate"], e["quantity"], e["unit"])
            symbols.add(symbol)
            unit = shown(e["quantity"], e["unit"])
            for (head, _), value in zip(_heads(*symbol), (e["value"], e["half_width"]), strict=True):
                row[head] = None if value is None else value / unit.scale
        rows += found.values()
    numbers = dict(_point_head(name) for name in in_order(sorted(points), POINTS))
    for name in in_common(orders.values()):
        for symbol in sorted(symbol for symbol in symbols if symbol[0] == name):
            numbers |= dict(_heads(*symbol))
    return rows, numbers


def _point_head(name: str) -> tuple[str, tuple[str, str]]:
    label, unit = point_shown(name)
    return _with_unit(label, plain_unit(unit.unit)), ("point", plain_unit(unit.unit))


def _heads(symbol: str, coordinate: str, quantity: str, unit: str) -> list[tuple[str, tuple[str, str]]]:
    text, in_unit = symbol_text(symbol, coordinate), plain_unit(shown(quantity, unit).unit)
    return [
        (_with_unit(text, in_unit), (quantity, in_unit)),
        (_with_unit(f"{text} half width 95 %", in_unit), (quantity, in_unit)),
    ]


def _with_unit(text: str, unit: str) -> str:
    return f"{text} [{unit}]" if unit else text


def _write_parquet(rows: Sequence[Mapping[str, Any]], numbers: Mapping[str, tuple[str, str]], path: Path) -> None:
    from pmabench.store.arrow import pa, pq

    types = {str: pa.string(), bool: pa.bool_(), int: pa.int64()}
    fields = [pa.field(name, types[type(kind)]) for name, kind in FIRST.items()]
    fields += [
        pa.field(name, pa.float64(), metadata={"quantity": quantity, "unit": unit})
        for name, (quantity, unit) in numbers.items()
    ]
    fields += [pa.field(name, types[type(kind)]) for name, kind in LAST.items()]
    arrays = [pa.array([row[field.name] for row in rows], type=field.type) for field in fields]
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields))
    pq.write_table(table, path, compression="zstd", compression_level=3)
