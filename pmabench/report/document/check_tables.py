"""Checks other than the residual, and how the fitted muscle follows whole trials, as tables of text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd

from pmabench.analysis.results import Analysis
from pmabench.analysis.verdict.checks import NAMES, checks_of
from pmabench.plotting.wording import clean, number, point_shown, rounded
from pmabench.report.document.tables import Table

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
        yield Table("Checks other than the residual", pd.DataFrame(rows, dtype=object))
    free_runs = analysis.facts.get("free_run")
    runs = [row for entry in (free_runs if isinstance(free_runs, list | tuple) else ()) if (row := _run(entry))]
    if runs:
        caption = (
            "The fitted muscle run freely through whole trials with the measured pressure: NRMSE = "
            "‖x − x_model‖ / ‖x − mean x‖, the fit in % is 100 − NRMSE. Contracting and relaxing: the rms error "
            "of that part by the standard deviation of the whole trial. Small strokes make large shares"
        )
        yield Table(caption, pd.DataFrame(runs, dtype=object).fillna(""))


def _run(entry: Any) -> dict[str, str]:
    """One row; empty for what is none."""
    if not isinstance(entry, Mapping):
        return {}
    row = {}
    for name in ("pressure", "load"):
        label, unit = point_shown(name)
        if _is_number(entry.get(name)):
            row[unit.label(label)] = rounded(entry[name] / unit.scale, None, 4)
    if len(row) < 2 or not _is_number(entry.get("nrmse")):
        return {}
    row["trials"] = number(entry["trials"]) if _is_number(entry.get("trials")) else ""
    row |= {head: rounded(entry[key] / scale, None, 2) for key, head, scale in _RUN if _is_number(entry.get(key))}
    if _is_number(entry.get("rms")):
        row["rms [mm]"] = rounded(entry["rms"] / 1e-3, None, 2)
    return row


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
