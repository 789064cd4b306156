"""The CSV files of an analysis: the numbers of its tables in display units, unrounded; no text for people.

Text cells are made inert: no spreadsheet can take one for a formula.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pmabench.plotting.wording import POINTS, WITHHELD, clean, in_order, plain_unit, point_shown, shown, symbol_text
from pmabench.report.writing import writing
from pmabench.store.analyses.folder import write_analysis
from pmabench.store.analyses.results import Analysis, Curve, Estimate

FORMULA = tuple("=+-@＝＋－＠")
"""A cell that begins with one of these is a formula to some spreadsheet; the wide ones are East Asian."""


def write_with_tables(analysis: Analysis, folder: Path) -> Path:
    """An analysis folder with its tables as CSV, as people want it; raises RecordError where it cannot be written."""
    write_analysis(analysis, folder)
    with writing(folder, "the tables"):
        write_tables(analysis, folder)
    return folder


def write_tables(analysis: Analysis, folder: Path) -> list[Path]:
    """CSV files in display units, the same bytes for the same analysis.

    `coefficients` (a row per method and operating point, units in headers), `estimates` (a row per estimate, with the
    interval in parts), `curves`, `dropped` and `findings`.
    """
    points = in_order((name for d in analysis.dropped for name in d.point), POINTS)
    dropped = [{"trial": d.trial} | point_cells(points, d.point) | {"reason": d.reason} for d in analysis.dropped]
    tables: dict[str, tuple[Sequence[Mapping[str, Any]], list[str]]] = {
        "coefficients": (coefficient_rows(analysis.estimates), ["method"]),
        "estimates": (estimate_rows([analysis]), ["kind", "symbol", "value", "unit"]),
        "curves": (curve_rows(analysis.curves), ["symbol", "method", "form", "power", "value", "unit"]),
        "dropped": (dropped, ["trial", "reason"]),
        "findings": ([{"level": f.level, "text": f.text} for f in analysis.findings], ["level", "text"]),
    }
    paths = []
    for name, (rows, heads) in tables.items():
        path = folder / f"{name}.csv"
        path.write_bytes(csv_text(rows, heads).encode())
        paths.append(path)
    return paths


def csv_text(rows: Sequence[Mapping[str, Any]], heads: Sequence[str]) -> str:
    """Rows as CSV with all columns that any of them has, in the order in which they come; `heads` where there is none.

    Numbers are written so that they read back as they are; what is not known is an empty cell. Text is inert.
    """
    columns = list(dict.fromkeys(name for row in rows for name in row)) or list(heads)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(inert, columns))
    writer.writerows([_cell(row.get(name)) for name in columns] for row in rows)
    return text.getvalue()


def _cell(value: Any) -> Any:
    return "" if value is None or value != value else inert(value)


def inert(value: Any) -> Any:
    """Text that a spreadsheet cannot take for a formula."""
    if not isinstance(value, str):
        return value
    text = clean(value, 100_000)
    return f"'{text}" if text.lstrip()[:1] in FORMULA else text


def coefficient_rows(estimates: Sequence[Estimate]) -> list[dict[str, Any]]:
    """One row per method and operating point; each symbol's value and half width as numbers in display units.

    Where a value is withheld its cell is empty, and the last column says why.
    """
    names = in_order((name for e in estimates for name in e.at), POINTS)
    rows: dict[tuple[str, tuple[float | None, ...]], dict[str, Any]] = {}
    held: dict[int, list[str]] = {}
    for e in estimates:
        unit = shown(e.quantity, e.unit)
        row = rows.setdefault((e.method, tuple(e.at.get(name) for name in names)), {"method": e.method})
        row |= point_cells(names, e.at)
        symbol = symbol_text(e.symbol, e.coordinate)
        row[unit.plain_label(symbol)] = unit.of(e.value)
        row[unit.plain_label(f"{symbol} half width 95 %")] = unit.of(e.parts.combined)
        if e.withheld:
            held.setdefault(id(row), []).append(f"{symbol}: {WITHHELD}: {e.note}")
    return [row | ({"withheld": "; ".join(held.get(id(row), []))} if held else {}) for row in rows.values()]


def estimate_rows(analyses: Sequence[Analysis]) -> list[dict[str, Any]]:
    """Every estimate as numbers: value, ends and parts of the interval in the unit of the row's `unit` column."""
    names = in_order((name for a in analyses for e in a.estimates for name in e.at), POINTS)
    rows = []
    for analysis in analyses:
        for e in analysis.estimates:
            unit = shown(e.quantity, e.unit)
            row: dict[str, Any] = {"kind": analysis.kind, "symbol": e.symbol, "coordinate": e.coordinate}
            row |= point_cells(names, e.at) | value_cells(e)
            numbers = {"repeats": e.parts.repeats, "method_part": e.parts.method, "calibration": e.parts.calibration}
            row |= {key: unit.of(value) for key, value in (numbers | {"skew": e.parts.skew, "bias": e.bias}).items()}
            row |= {"unit": plain_unit(unit.unit), "corrected": e.corrected, "n": e.n, "method": e.method}
            note = f"{WITHHELD}: {e.note}" if e.withheld else e.note
            rows.append(row | {"note": note, "trials": " ".join(e.trials)})
    return rows


def point_cells(names: Iterable[str], at: Mapping[str, float]) -> dict[str, float | None]:
    """Coordinates of an operating point under their heads; None for one that it has not."""
    return {plain_head(name): at[name] / point_shown(name)[1].scale if name in at else None for name in names}


def value_cells(e: Estimate) -> dict[str, float | None]:
    """Value and ends of the interval in the unit that people read."""
    numbers = zip(("value", "low95", "high95"), (e.value, *(e.ci95 or (None, None))), strict=True)
    return {name: shown(e.quantity, e.unit).of(number) for name, number in numbers}


def plain_head(name: str) -> str:
    """The head of a column with a coordinate of operating points."""
    label, unit = point_shown(name)
    return unit.plain_label(label)


def curve_rows(curves: Iterable[Curve]) -> list[dict[str, Any]]:
    """One row per term of each curve, numbers in the unit of the row."""
    rows = []
    for curve in curves:
        _, against = point_shown(curve.against)
        for power, term in enumerate(curve.terms):
            unit = shown(term.quantity, term.unit)
            row = {"symbol": curve.symbol, "method": curve.method, "form": curve.form, "power": power}
            row |= value_cells(term) | {"unit": plain_unit(unit.unit), "against": curve.against}
            places = {"from": curve.domain[0], "to": curve.domain[1]}
            places |= {"centre": curve.centre, "scale": curve.scale} if curve.normalised else {}
            row |= {f"{name} [{plain_unit(against.unit)}]": x / against.scale for name, x in places.items()}
            rows.append(row | {"r2": curve.r2})
    return rows
