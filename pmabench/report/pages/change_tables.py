"""Changes by another calibration, as a table for a terminal, as CSV and as JSON; computes nothing."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmabench.analysis.verdict.comparison import Change
from pmabench.plotting.wording import Shown, plain_unit, point_text, shown, symbol_text
from pmabench.report.document.special_tables import SAME
from pmabench.report.files.csv_files import csv_text
from pmabench.report.terminal import print_grid
from pmabench.report.writing import write_file
from pmabench.store.analyses.results import Estimate
from pmabench.store.folder import plain

if TYPE_CHECKING:
    from rich.console import Console

NAME = "changes"
SCHEMA = "pmabench.changes/1"
HEADS = ("kind", "coefficient", "at", "unit", "before", "after", "difference", "%", "method")


def print_changes(changes: Sequence[Change], console: Console) -> None:
    """A row for each coefficient in display units; the half width of the difference is that of the calibrations."""
    rows = []
    for change in changes:
        e = change.estimate
        unit = shown(e.quantity, e.unit)
        difference = change.difference
        base = None if change.before is None else change.before.value
        share = "" if difference is None or not base else f"{100 * difference / abs(base):+.2f}"
        signed = "" if difference is None else _signed(difference, change.half_width, abs(base or 0.0), unit)
        where = (change.kind, symbol_text(e.symbol, e.coordinate), point_text(e.at), unit.unit)
        rows.append([*where, _cell(change.before, unit), _cell(change.after, unit), signed, share, e.method])
    print_grid(console, HEADS, rows, ("kind", "coefficient", "at", "unit", "method"), keys=3)


def _cell(estimate: Estimate | None, unit: Shown) -> str:
    if estimate is None or estimate.value is None:
        return "none"
    return unit.rounded(estimate.value, estimate.parts.combined)


def _signed(value: float, half: float | None, size: float, unit: Shown) -> str:
    """Text of a difference between values of this size [SI]; 0 where it is only rounding."""
    if abs(value) <= SAME * size:
        return "0"
    text = unit.rounded(value, half or None)
    return text if text.startswith(("-", "−")) else f"+{text}"


def write_changes(
    changes: Sequence[Change], channels: Sequence[Mapping[str, Any]], who: Mapping[str, str], folder: Path
) -> list[Path]:
    """`changes.csv` in display units and `changes.json` in SI; raises RecordError where they cannot be written."""
    rows = []
    for change in changes:
        e = change.estimate
        unit = shown(e.quantity, e.unit)

        row: dict[str, Any] = {"kind": change.kind, "symbol": e.symbol, "coordinate": e.coordinate}
        row |= {"at": point_text(e.at), "unit": plain_unit(unit.unit)}
        for name, side in (("before", change.before), ("after", change.after)):
            ends = (side.ci95 if side is not None else None) or (None, None)
            row[name] = unit.of(side.value if side is not None else None)
            row |= {f"{name} low95": unit.of(ends[0]), f"{name} high95": unit.of(ends[1])}
        row |= {"difference": unit.of(change.difference), "half width 95 %": unit.of(change.half_width)}
        rows.append(row | {"method": e.method})
    data = {
        "schema": SCHEMA,
        "recalibration": dict(who),
        "channels": list(channels),
        "changes": [change.to_dict() for change in changes],
    }
    text = json.dumps(plain(data), indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False)
    files = {f"{NAME}.csv": csv_text(rows, ["kind", "symbol"]), f"{NAME}.json": f"{text}\n"}
    return [write_file(folder / name, data, "the changes") for name, data in files.items()]
