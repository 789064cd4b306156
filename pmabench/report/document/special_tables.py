"""Tables behind the coefficients, as text: budgets, checks, what a recalibration changed.

Facts of an analysis may come from a file of anybody's: what is odd in them is left out. Computes no estimate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pmabench.analysis.verdict.checks import NAMES, checks_of
from pmabench.plotting.wording import (
    Frame,
    clean,
    half_width,
    number,
    point_shown,
    point_text,
    rounded,
    shown,
    symbol_text,
)
from pmabench.report.document.provenance import get
from pmabench.report.document.tables import Table, half_of, least, mappings, numbers_of
from pmabench.report.words import kind_title
from pmabench.store.analyses.results import Analysis, Estimate
from pmabench.store.records import is_number

NAMED_ALONE = 0.01
"""Sources with a smaller share of the variance are given as one sum."""


def budget_table(analysis: Analysis) -> Table | None:
    """One row for each estimate that has a budget; the caption names what was not assessed. None without any."""
    members = [e for e in analysis.estimates if e.budget and e.value is not None and e.parts.combined is not None]
    if not members:
        return None
    rows = []
    for e in members:
        unit = shown(e.quantity, e.unit)
        rows.append(
            {
                "method": clean(e.method),
                "symbol": symbol_text(e.symbol, e.coordinate),
                "at": point_text(e.at),
                "± 95 %": half_width((e.parts.combined or 0.0) / unit.scale, least(e)),
                "unit": unit.unit,
                "sources, shares of the variance": _shares(e),
            }
        )
    open_sources = dict.fromkeys(
        f"{clean(s.name, 80)}" + (f" ({clean(s.note, 120)})" if s.note else "")
        for e in members
        for s in e.budget
        if s.half is None
    )
    caption = f"{kind_title(analysis.kind)}: uncertainty budgets"
    if open_sources:
        caption += f"; not assessed: {'; '.join(open_sources)}"
    return Table(caption, Frame(rows))


def _shares(e: Estimate) -> str:
    shares = [
        (share, clean(s.name, 80)) for s, share in zip(e.budget, e.shares, strict=True) if share is not None and s.half
    ]
    large = sorted((entry for entry in shares if entry[0] >= NAMED_ALONE), reverse=True)
    words = [f"{name} {100 * share:.0f} %" for share, name in large]
    rest = sum(share for share, _ in shares) - sum(share for share, _ in large)
    if others := len(shares) - len(large):
        words.append(f"{others} other{'s' if others > 1 else ''} {f'{100 * rest:.1f}' if rest >= 5e-4 else '< 0.1'} %")
    return ", ".join(words)


_RUN = (("nrmse", "NRMSE [%]", 0.01), ("contraction", "contracting [%]", 0.01), ("relaxation", "relaxing [%]", 0.01))


def check_tables(analysis: Analysis) -> Iterator[Table]:
    """The checks of an analysis, and the free runs by operating point; facts may come from a file of anybody's."""
    rows = [
        {
            "check": clean(check.name.replace("_", " "), 40),
            "value [%]": rounded(100 * check.value, None, 2),
            "what it is": NAMES.get(check.name, ""),
            "judged": "doubt" if check.level == "doubt" else "",
        }
        for check in checks_of(analysis)
        if check.quantity == "ratio" and check.name in NAMES
    ]
    if rows:
        yield Table("Checks other than the residual", Frame(rows))
    runs = [row for entry in mappings(analysis.facts.get("free_run")) if (row := _run(entry))]
    if runs:
        caption = (
            "The fitted muscle run freely through whole trials with the measured pressure: NRMSE = "
            "‖x − x_model‖ / ‖x − mean x‖, the fit in % is 100 − NRMSE. Contracting and relaxing: the rms error "
            "of that part by the standard deviation of the whole trial. Small strokes make large shares"
        )
        yield Table(caption, Frame(runs))


def _run(entry: Mapping[str, Any]) -> dict[str, str]:
    """One row; empty for what is none."""
    row = {}
    for name in ("pressure", "load"):
        label, unit = point_shown(name)
        if is_number(entry.get(name)):
            row[unit.label(label)] = rounded(entry[name] / unit.scale, None, 4)
    if len(row) < 2 or not is_number(entry.get("nrmse")):
        return {}
    row["trials"] = number(entry["trials"]) if is_number(entry.get("trials")) else ""
    row |= {head: rounded(entry[key] / scale, None, 2) for key, head, scale in _RUN if is_number(entry.get(key))}
    if is_number(entry.get("rms")):
        row["rms [mm]"] = rounded(entry["rms"] / 1e-3, None, 2)
    return row


SAME = 1e-7
"""Share of a value below which a difference is that of rounding and of where a fit stops."""


def reduced_with(analyses: Sequence[Analysis]) -> dict[tuple[str, str], str]:
    """Run and channel -> what its samples were reduced with where that is not what they were recorded with."""
    found: dict[tuple[str, str], list[str]] = {}
    for analysis in analyses:
        for channel in mappings(analysis.facts.get("recalibrated")):
            name, late = str(channel.get("channel", "")), channel.get("late")
            if is_number(late):
                words = f"taken as {1e3 * late:.6g} ms older than its time stamps"
                places = [(run, words) for run in analysis.runs]
            else:
                scales = mappings(channel.get("scales"))
                places = [(str(s.get("run", "")), _calibration(channel.get("calibration"), s)) for s in scales]
            for run, words in places:
                found.setdefault((run, name), []).append(words)
    return {place: "; ".join(dict.fromkeys(reasons)) for place, reasons in found.items()}


def _calibration(record: Any, scale: Mapping[str, Any]) -> str:
    """The new calibration in words: id, date, reference and hash."""
    parts = [str(get(record, "id") or get(scale, "after", "calibration") or "not named")]
    parts += [str(record[key]) for key in ("date", "reference") if get(record, key)]
    if get(record, "sha256"):
        parts.append(f"sha256 {str(record['sha256'])[:12]}")
    return clean(", ".join(parts), 200)


def who(analyses: Sequence[Analysis]) -> Iterator[tuple[tuple[str, ...], str]]:
    """The runs of each recalibration, and a sentence: what, when, by whom and why."""
    for analysis in analyses:
        channels = mappings(analysis.facts.get("recalibrated"))
        if not channels:
            continue
        when, by, because = (
            clean(get(analysis.facts, "recalibration", key) or "", 300) for key in ("at", "operator", "because")
        )
        day = f" on {when[:16].replace('T', ' ')} UTC" if when else ""
        why = f"because {because}" if because else "no reason was given"
        what = "; ".join(clean(channel.get("sentence", ""), 300) for channel in channels)
        yield analysis.runs, f"recalibrated{day}{f' by {by}' if by else ''}, {why}: {what}"


def change_tables(analysis: Analysis) -> Iterator[Table]:
    """Every coefficient before and after; one table, none without a recalibration."""
    if rows := change_rows(get(analysis.facts, "recalibration", "changes")):
        caption = (
            "What the recalibration changed: as recorded, as reduced here, difference with the 95 % half width "
            "that the two calibrations leave it"
        )
        yield Table(caption, Frame(rows))


def change_rows(changes: Any) -> list[dict[str, str]]:
    """A row of text for each change of a coefficient, as `Change.to_dict` has it."""
    return [row for entry in mappings(changes) if (row := _row(entry))]


def _row(entry: Mapping[str, Any]) -> dict[str, str]:
    """One row; empty for what is none."""
    symbol = entry.get("symbol")
    if not isinstance(symbol, str):
        return {}
    unit = shown(str(entry.get("quantity", "")), str(entry.get("unit", "")))
    row = {
        "method": clean(entry.get("method", ""), 120),
        "coefficient": symbol_text(symbol, str(entry.get("coordinate", ""))),
        "at": point_text(numbers_of(entry.get("at"))),
        "unit": unit.unit,
    }
    values = {}
    for side, head in (("before", "as recorded"), ("after", "as reduced here")):
        value = get(entry, side, "value")
        row[head] = "none"
        if is_number(value):
            values[side] = float(value)
            row[head] = unit.rounded(value, half_of(value, get(entry, side, "ci95")))
    if len(values) == 2:
        difference, size = values["after"] - values["before"], abs(values["before"])
        half_width, small = entry.get("half_width"), abs(difference) <= SAME * size
        half = float(half_width) / unit.scale if is_number(half_width) and half_width else None
        row["difference"] = "0" if small else rounded(difference / unit.scale, half)
        row["%"] = "" if not size else "0" if small else f"{100 * difference / size:+.2f}".replace("-", "\u2212")
    return row
