"""The CSV files of an analysis: the numbers of its tables in display units, unrounded; no text for people.

Text cells are made inert: no spreadsheet can take one for a formula.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from pmabench.analysis.results import Analysis, Curve, Estimate
from pmabench.report.wording import POINTS, clean, in_order, plain_unit, point_shown, shown, symbol_text


def write_tables(analysis: Analysis, folder: Path) -> list[Path]:
    """CSV files in display units, the same bytes for the same analysis.

    `coefficients` (a row per method and operating point, units in headers), `estimates` (a row per estimate, with the
    interval in parts), `curves`, `dropped` and `findings`.
    """
    points = in_order((name for d in analysis.dropped for name in d.point), POINTS)
    dropped = [
        {"trial": d.trial}
        | {_head(name): d.point[name] / point_shown(name)[1].scale if name in d.point else None for name in points}
        | {"reason": d.reason}
        for d in analysis.dropped
    ]
    frames = {
        "coefficients": (coefficients_frame(analysis.estimates), ["method"]),
        "estimates": (estimates_frame([analysis]), ["kind", "symbol", "value", "unit"]),
        "curves": (curves_frame(analysis.curves), ["symbol", "method", "form", "power", "value", "unit"]),
        "dropped": (pd.DataFrame(dropped), ["trial", "reason"]),
        "findings": (pd.DataFrame([{"level": f.level, "text": f.text} for f in analysis.findings]), ["level", "text"]),
    }
    paths = []
    for name, (frame, heads) in frames.items():
        path = folder / f"{name}.csv"
        told = frame if len(frame.columns) else pd.DataFrame(columns=heads)
        inert = told.map(_inert).rename(columns=_inert)
        path.write_text(inert.to_csv(index=False, lineterminator="\n"), encoding="utf-8", newline="")
        paths.append(path)
    return paths


def _inert(value: Any) -> Any:
    """Text that a spreadsheet cannot take for a formula."""
    if not isinstance(value, str):
        return value
    told = clean(value, 100_000)
    return f"'{told}" if told.lstrip()[:1] in ("=", "+", "-", "@") else told


def coefficients_frame(estimates: Sequence[Estimate]) -> pd.DataFrame:
    """One row per method and operating point; each symbol's value and half width as numbers in display units."""
    names = in_order((name for e in estimates for name in e.at), POINTS)
    rows: dict[tuple[str, tuple[float | None, ...]], dict[str, Any]] = {}
    for e in estimates:
        unit = shown(e.quantity, e.unit)
        row = rows.setdefault((e.method, tuple(e.at.get(name) for name in names)), {"method": e.method})
        for name in names:
            row[_head(name)] = e.at[name] / point_shown(name)[1].scale if name in e.at else None
        symbol, half = symbol_text(e.symbol, e.coordinate), e.parts.combined
        ascii_unit = f" [{plain_unit(unit.unit)}]" if unit.unit else ""
        row[f"{symbol}{ascii_unit}"] = None if e.value is None else e.value / unit.scale
        row[f"{symbol} half width 95 %{ascii_unit}"] = None if half is None else half / unit.scale
    return pd.DataFrame(list(rows.values()))


def estimates_frame(analyses: Sequence[Analysis]) -> pd.DataFrame:
    """Every estimate as numbers: value, ends and parts of the interval in the unit of the row's `unit` column."""
    names = in_order((name for a in analyses for e in a.estimates for name in e.at), POINTS)
    rows = []
    for analysis in analyses:
        for e in analysis.estimates:
            unit = shown(e.quantity, e.unit)
            row: dict[str, Any] = {"kind": analysis.kind, "symbol": e.symbol, "coordinate": e.coordinate}
            for name in names:
                row[_head(name)] = e.at[name] / point_shown(name)[1].scale if name in e.at else None
            ends = e.ci95 or (None, None)
            told = {"value": e.value, "low95": ends[0], "high95": ends[1], "repeats": e.parts.repeats}
            told |= {"method_part": e.parts.method, "calibration": e.parts.calibration, "skew": e.parts.skew}
            told["bias"] = e.bias
            row |= {key: None if value is None else value / unit.scale for key, value in told.items()}
            row |= {"unit": plain_unit(unit.unit), "corrected": e.corrected, "n": e.n, "method": e.method}
            rows.append(row | {"note": e.note, "trials": " ".join(e.trials)})
    return pd.DataFrame(rows)


def _head(name: str) -> str:
    label, unit = point_shown(name)
    return f"{label} [{plain_unit(unit.unit)}]" if unit.unit else label


def curves_frame(curves: Iterable[Curve]) -> pd.DataFrame:
    """One row per term of each curve, numbers in the unit of the row."""
    rows = []
    for curve in curves:
        _, against = point_shown(curve.against)
        for power, term in enumerate(curve.terms):
            unit = shown(term.quantity, term.unit)
            ends = term.ci95 or (None, None)
            told = {"value": term.value, "low95": ends[0], "high95": ends[1]}
            rows.append(
                {"symbol": curve.symbol, "method": curve.method, "form": curve.form, "power": power}
                | {key: None if value is None else value / unit.scale for key, value in told.items()}
                | {"unit": plain_unit(unit.unit), "against": curve.against}
                | {
                    f"{end} [{plain_unit(against.unit)}]": x / against.scale
                    for end, x in zip(("from", "to"), curve.domain, strict=True)
                }
                | {
                    f"{name} [{plain_unit(against.unit)}]": x / against.scale
                    for name, x in (("centre", curve.centre), ("scale", curve.scale))
                    if curve.normalised
                }
                | {"r2": curve.r2}
            )
    return pd.DataFrame(rows)
