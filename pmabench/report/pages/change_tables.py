"""What another calibration changed, as a table for a terminal, as CSV and as JSON; computes nothing."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmabench.analysis.results import Estimate
from pmabench.analysis.verdict.comparison import Change
from pmabench.base.errors import RecordError
from pmabench.plotting.rounding import rounded
from pmabench.plotting.wording import plain_unit as plain
from pmabench.plotting.wording import point_text, shown, symbol_text
from pmabench.report.files.csv_files import csv_text
from pmabench.report.terminal import print_grid
from pmabench.store.folder import plain as as_json

if TYPE_CHECKING:
    from rich.console import Console

NAME = "changes"
SCHEMA = "pmabench.changes/1"
SAME = 1e-7
"""Share of a value below which a difference is that of rounding and of where a fit stops."""
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
        half = None if change.half_width is None else change.half_width / unit.scale
        signed = "" if difference is None else _signed(difference / unit.scale, half, abs(base or 0.0) / unit.scale)
        where = (change.kind, symbol_text(e.symbol, e.coordinate), point_text(e.at), unit.unit)
        rows.append(
            [*where, _cell(change.before, unit.scale), _cell(change.after, unit.scale), signed, share, e.method]
        )
    print_grid(console, HEADS, rows, ("kind", "coefficient", "at", "unit", "method"), keys=3)


def _cell(estimate: Estimate | None, scale: float) -> str:
    if estimate is None or estimate.value is None:
        return "none"
    half = estimate.parts.combined
    return rounded(estimate.value / scale, None if half is None else half / scale)


def _signed(value: float, half: float | None, size: float) -> str:
    """A difference of values of this size, all in one unit; 0 where it is no more than rounding."""
    if abs(value) <= SAME * size:
        return "0"
    text = rounded(value, half or None)
    return text if text.startswith(("-", "−")) else f"+{text}"


def write_changes(
    changes: Sequence[Change], channels: Sequence[Mapping[str, Any]], who: Mapping[str, str], folder: Path
) -> list[Path]:
    """`changes.csv` in display units and `changes.json` in SI; raises RecordError where they cannot be written."""
    rows = []
    for change in changes:
        e = change.estimate
        unit = shown(e.quantity, e.unit)

        def scaled(value: float | None, by: float = unit.scale) -> float | None:
            return None if value is None else value / by

        row: dict[str, Any] = {"kind": change.kind, "symbol": e.symbol, "coordinate": e.coordinate}
        row |= {"at": point_text(e.at), "unit": plain(unit.unit)}
        for name, side in (("before", change.before), ("after", change.after)):
            ends = (side.ci95 if side is not None else None) or (None, None)
            row[name] = scaled(side.value if side is not None else None)
            row |= {f"{name} low95": scaled(ends[0]), f"{name} high95": scaled(ends[1])}
        row |= {"difference": scaled(change.difference), "half width 95 %": scaled(change.half_width)}
        rows.append(row | {"method": e.method})
    data = {
        "schema": SCHEMA,
        "recalibration": dict(who),
        "channels": list(channels),
        "changes": [change.to_dict() for change in changes],
    }
    paths = [folder / f"{NAME}.csv", folder / f"{NAME}.json"]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        paths[0].write_bytes(csv_text(rows, ["kind", "symbol"]).encode())
        text = json.dumps(as_json(data), indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False)
        paths[1].write_bytes(f"{text}\n".encode())
    except OSError as error:
        raise RecordError(f"{folder}: the changes cannot be written: {error.strerror or error}") from error
    return paths
