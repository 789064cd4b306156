"""What was taken otherwise than it was recorded, by whom and why, and what that changed, as text; computes nothing.

All of it is in the facts of analyses that `recalibrate` made, which may come from a file of anybody's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeGuard

import pandas as pd

from pmabench.analysis.results import Analysis
from pmabench.plotting.wording import clean, point_text, rounded, shown, symbol_text
from pmabench.report.document.tables import Table

SAME = 1e-7
"""Share of a value below which a difference is that of rounding and of where a fit stops."""


def reduced_with(analyses: Sequence[Analysis]) -> dict[tuple[str, str], str]:
    """Run and channel -> what its samples were reduced with where that is not what they were recorded with."""
    found: dict[tuple[str, str], list[str]] = {}
    for analysis in analyses:
        for channel in _mappings(analysis.facts.get("recalibrated")):
            name, late = str(channel.get("channel", "")), channel.get("late")
            if _is_number(late):
                words = f"taken as {1e3 * late:.6g} ms older than its time stamps"
                places = [(run, words) for run in analysis.runs]
            else:
                scales = _mappings(channel.get("scales"))
                places = [(str(s.get("run", "")), _calibration(channel.get("calibration"), s)) for s in scales]
            for run, words in places:
                reasons = found.setdefault((run, name), [])
                if words not in reasons:
                    reasons.append(words)
    return {place: "; ".join(reasons) for place, reasons in found.items()}


def _calibration(record: Any, scale: Mapping[str, Any]) -> str:
    """The new calibration in words: id, date, reference and hash."""
    about = record if isinstance(record, Mapping) else {}
    after = scale.get("after")
    parts = [str(about.get("id") or (after.get("calibration") if isinstance(after, Mapping) else "") or "not named")]
    parts += [str(about[key]) for key in ("date", "reference") if about.get(key)]
    if about.get("sha256"):
        parts.append(f"sha256 {str(about['sha256'])[:12]}")
    return clean(", ".join(parts), 200)


def who(analyses: Sequence[Analysis]) -> Iterator[tuple[tuple[str, ...], str]]:
    """The runs of each recalibration, and a sentence: what, when, by whom and why."""
    for analysis in analyses:
        recalibration, channels = analysis.facts.get("recalibration"), _mappings(analysis.facts.get("recalibrated"))
        if not channels:
            continue
        about = recalibration if isinstance(recalibration, Mapping) else {}
        when, by, because = (clean(about.get(key) or "", 300) for key in ("at", "operator", "because"))
        day = f" on {when[:16].replace('T', ' ')} UTC" if when else ""
        why = f"because {because}" if because else "no reason was given"
        what = "; ".join(clean(channel.get("sentence", ""), 300) for channel in channels)
        yield analysis.runs, f"recalibrated{day}{f' by {by}' if by else ''}, {why}: {what}"


def change_tables(analysis: Analysis) -> Iterator[Table]:
    """Every coefficient before and after; one table, none without a recalibration."""
    recalibration = analysis.facts.get("recalibration")
    rows = [
        row
        for entry in _mappings(recalibration.get("changes") if isinstance(recalibration, Mapping) else None)
        if (row := _row(entry))
    ]
    if rows:
        caption = (
            "What the recalibration changed: as recorded, as reduced here, difference with the 95 % half width "
            "that the two calibrations leave it"
        )
        yield Table(caption, pd.DataFrame(rows, dtype=object))


def _row(entry: Mapping[str, Any]) -> dict[str, str]:
    """One row; empty for what is none."""
    symbol, at = entry.get("symbol"), entry.get("at")
    if not isinstance(symbol, str):
        return {}
    unit = shown(str(entry.get("quantity", "")), str(entry.get("unit", "")))
    point = {str(k): float(v) for k, v in at.items() if _is_number(v)} if isinstance(at, Mapping) else {}
    row = {
        "method": clean(entry.get("method", ""), 120),
        "coefficient": symbol_text(symbol, str(entry.get("coordinate", ""))),
        "at": point_text(point),
        "unit": unit.unit,
    }
    values = {}
    for side, head in (("before", "as recorded"), ("after", "as reduced here")):
        about = entry.get(side)
        value = about.get("value") if isinstance(about, Mapping) else None
        ends = about.get("ci95") if isinstance(about, Mapping) else None
        row[head] = "none"
        if _is_number(value):
            values[side] = float(value)
            reach = None
            if isinstance(ends, list | tuple) and len(ends) == 2 and all(_is_number(end) for end in ends):
                reach = (ends[1] - ends[0]) / 2 / unit.scale
            row[head] = rounded(value / unit.scale, reach)
    if len(values) == 2:
        difference, size = values["after"] - values["before"], abs(values["before"])
        half_width, small = entry.get("half_width"), abs(difference) <= SAME * size
        half = float(half_width) / unit.scale if _is_number(half_width) and half_width else None
        row["difference"] = "0" if small else rounded(difference / unit.scale, half)
        row["%"] = "" if not size else "0" if small else f"{100 * difference / size:+.2f}".replace("-", "\u2212")
    return row


def _mappings(value: Any) -> list[Mapping[str, Any]]:
    return [item for item in value if isinstance(item, Mapping)] if isinstance(value, list | tuple) else []


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
