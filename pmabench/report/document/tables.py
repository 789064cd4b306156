"""Tables of what analyses found, as frames of text; no estimate.

Cells are text, rounded as their interval says; numbers for programs are in `csv_files`. Every header names its unit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import radians
from typing import Any

from pmabench.base.kind import Result
from pmabench.base.quantities import QUANTITIES
from pmabench.plotting.wording import (
    AT_MOST,
    POINTS,
    RAISED,
    RESOLVED,
    UNRESOLVED,
    WITHHELD,
    Frame,
    clean,
    cut,
    half_width,
    in_order,
    number,
    point_head,
    point_shown,
    point_text,
    rounded,
    shown,
    spoken,
    symbol_text,
)
from pmabench.report.words import declared, kind_title
from pmabench.store.analyses.results import AGREEMENT, Analysis, Estimate
from pmabench.store.records import is_number

LONGEST_JOINT = 60
COEFFICIENTS = {"F_ce", "K", "B_c", "B_r", "B"}
"""A method that gives one of these over pressure belongs in the coefficient table."""
PLACES = {"pressure", "mean", "amplitude"}
"""Coordinates of the table of primary methods; results with others (a frequency, a set-point) are under their test."""


@dataclass(frozen=True)
class Table:
    """A frame of text cells with a caption."""

    caption: str
    frame: Frame


def cell(estimate: Estimate) -> str:
    """An estimate as text in its display unit, without the unit: `7.552 ± 0.021`; a bound as `≤ 0.04`."""
    unit, half = shown(estimate.quantity, estimate.unit), estimate.parts.combined
    if estimate.value is None and estimate.bound is not None:
        return f"{AT_MOST}{unit.rounded(estimate.bound, digits=3)}"
    if estimate.value is None:
        return WITHHELD if estimate.withheld else "not identifiable"
    if 0 < max(abs(estimate.value), half or 0.0) / unit.scale < least(estimate):
        return UNRESOLVED
    if half is not None and estimate.positive and 0 <= estimate.value < half:
        return cut(estimate.value / unit.scale, half / unit.scale)
    return unit.rounded(estimate.value, half)


def note_text(estimate: Estimate) -> str:
    """What is said of an estimate; begins with `withheld: ` where its value is."""
    note = clean(estimate.note if estimate.note != estimate.coordinate else "")
    return f"{WITHHELD}: {note}" if estimate.withheld else note


def least(estimate: Estimate) -> float:
    """The smallest value that means anything, in the display unit of an estimate; 0 for terms of curves."""
    return RESOLVED if estimate.quantity in QUANTITIES else 0.0


def coefficient_table(analyses: Sequence[Analysis]) -> Frame:
    """F_ce, K, B_c, B_r, ... with their 95 % intervals: one row per method and pressure, rounded text."""
    return pivot_table(_over_pressure(e for a in analyses for e in a.estimates), declared(analyses))


def _over_pressure(estimates: Iterable[Estimate]) -> list[Estimate]:
    """Those over pressure alone, by the methods that give a coefficient of the table."""
    chosen = [e for e in estimates if set(e.at) == {"pressure"} and not e.coordinate]
    methods = {e.method for e in chosen if e.symbol in COEFFICIENTS}
    return [e for e in chosen if e.method in methods]


def primary_table(analyses: Sequence[Analysis]) -> tuple[Frame, str]:
    """The coefficients of each test's primary method, which comes first in it: one row per operating point; text.

    Next to the pressure, the columns have what a coefficient was found at in several places (a mean, an amplitude); the
    text says where it was one.
    """
    chosen = [
        e
        for a in analyses
        for e in a.estimates
        if "pressure" in e.at and set(e.at) <= PLACES and not e.coordinate and e.method == a.estimates[0].method
    ]
    by = {symbol: {e.method for e in chosen if e.symbol == symbol} for symbol in {e.symbol for e in chosen}}
    met = {name: {e.at[name] for e in chosen if name in e.at} for name in PLACES - {"pressure"}}
    alike = {name: next(iter(values)) for name, values in met.items() if len(values) == 1}
    slim = [replace(e, at={name: at for name, at in e.at.items() if name not in alike}) for e in chosen]

    def column(e: Estimate) -> str:
        return _column(e) + (f" {e.method}" if len(by[e.symbol]) > 1 else "")

    frame = pivot_table(slim, declared(analyses), column, by_method=False)
    methods = ", ".join(dict.fromkeys(e.method for e in chosen if set(e.at) & set(alike)))
    return frame, f"{clean(methods)} at {point_text(alike)}" if alike else ""


def method_tables(analyses: Sequence[Analysis]) -> list[Table]:
    """For each coefficient that several methods give, one row per pressure and one column per method; text."""
    chosen = _over_pressure(e for a in analyses for e in a.estimates)
    tables = []
    results = declared(analyses)
    for symbol, result in results.items():
        members = [e for e in chosen if e.symbol == symbol]
        if symbol in COEFFICIENTS and len({e.method for e in members}) > 1:
            name = ", ".join(part for part in (_column(members[0]), clean(result.title)) if part)
            tables.append(Table(name, pivot_table(members, results, lambda e: clean(e.method), by_method=False)))
    return tables


def other_tables(analysis: Analysis) -> list[Table]:
    """All estimates that are not in the coefficient table, one table for each kind of operating point."""
    elsewhere = {id(e) for e in _over_pressure(analysis.estimates)}
    groups: dict[tuple[str, ...], list[Estimate]] = {}
    for e in analysis.estimates:
        if id(e) not in elsewhere:
            groups.setdefault(tuple(sorted(e.at)), []).append(e)
    tables = []
    results = declared([analysis])
    for names, members in groups.items():
        if not names:
            tables.append(Table("Values for the whole campaign", whole_table(members, results)))
            continue
        constant = {name: members[0].at[name] for name in names if len({e.at[name] for e in members}) == 1}
        if len(constant) == len(names):
            del constant[in_order(names, POINTS)[0]]
        constant_text = point_text(constant)
        moving = [spoken(name) for name in in_order(names, POINTS) if name not in constant]
        at = f", at {constant_text}" if constant_text else ""
        caption = f"Values by {' and '.join(moving) or 'operating point'}{at}"
        slim = [replace(e, at={k: v for k, v in e.at.items() if k not in constant}) for e in members]
        tables.append(Table(caption, pivot_table(_merged(slim), results)))
    return tables


def _merged(estimates: Sequence[Estimate]) -> Sequence[Estimate]:
    """The estimates under one joint method name, where no two methods give the same symbol: fewer rows."""
    if len({(_column(e), e.method) for e in estimates}) > len({_column(e) for e in estimates}):
        return estimates
    joint = ", ".join(dict.fromkeys(e.method for e in estimates))
    joint = joint if len(joint) <= LONGEST_JOINT else "several methods"
    return [replace(e, method=joint) for e in estimates]


def _column(e: Estimate) -> str:
    return shown(e.quantity, e.unit).label(symbol_text(e.symbol, e.coordinate))


def pivot_table(
    estimates: Sequence[Estimate],
    results: Mapping[str, Result],
    column: Callable[[Estimate], str] = _column,
    *,
    by_method: bool = True,
) -> Frame:
    """One row per operating point, of each method or of all; columns named by `column` in the order of `results`; text.

    Points that differ by less than 1e-6 of the units that people read are one.
    """
    order, methods = list(results), list(dict.fromkeys(e.method for e in estimates))
    estimates = sorted(estimates, key=lambda e: order.index(e.symbol))
    heads = {name: point_head(name) for name in in_order((name for e in estimates for name in e.at), POINTS)}
    rows: dict[tuple[float, ...], dict[str, str]] = {}
    for e in estimates:
        at = {name: e.at[name] / point_shown(name)[1].scale for name in heads if name in e.at}
        first = {"method": clean(e.method)} if by_method else {}
        place = methods.index(e.method) if by_method else 0, *(round(at.get(name, float("-inf")), 6) for name in heads)
        row = rows.setdefault(place, first | {heads[name]: number(value) for name, value in at.items()})
        row[column(e)] = cell(e)
    columns = [*heads.values(), *dict.fromkeys(column(e) for e in estimates)]
    return Frame([rows[place] for place in sorted(rows)], columns=["method", *columns] if by_method else columns)


def two_coordinates(members: Sequence[Estimate], over: str) -> str:
    """The other coordinate of values of one symbol that differ in two; empty for any others."""
    others = {name for e in members for name in e.at} - {over, "mass"}
    return others.pop() if len(others) == 1 and len({(e.symbol, e.method) for e in members}) == 1 else ""


def matrix_table(members: Sequence[Estimate], over: str, across: str) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of values of one symbol: a row for each place in `over`, a column for each in `across`."""
    down, (label, unit) = point_shown(over)[1], point_shown(across)
    places, columns = (sorted({e.at[name] for e in members}) for name in (over, across))
    cells = {(e.at[over], e.at[across]): cell(e) for e in members}
    heads = [point_head(over), *(f"{number(value / unit.scale)} {unit.unit}" for value in columns)]
    heads[1] = f"{label} = {heads[1]}"
    rows = [[number(P / down.scale), *(cells.get((P, x), "–") for x in columns)] for P in places]
    return heads, rows


def whole_table(estimates: Sequence[Estimate], results: Mapping[str, Result]) -> Frame:
    """Estimates without an operating point, a row each."""
    rows = [
        {
            "symbol": symbol_text(e.symbol, e.coordinate),
            "quantity": clean(results[e.symbol].title),
            "value": cell(e),
            "unit": shown(e.quantity, e.unit).unit,
            "method": clean(e.method),
            "trials": str(e.n),
        }
        for e in estimates
    ]
    return Frame(rows)


def parts_table(analysis: Analysis, names: Mapping[str, str]) -> Frame:
    """Every estimate with the half widths of its 95 % interval by cause; text in the display units of the row.

    The column `skew` is there where streams have clocks of their own; `names` are the short names of runs.
    """
    rows = []
    skewed = any(e.parts.skew for e in analysis.estimates)
    methods = list(dict.fromkeys(e.method for e in analysis.estimates))
    for e in sorted(analysis.estimates, key=lambda e: methods.index(e.method)):
        unit = shown(e.quantity, e.unit)

        def half(value: float | None, scale: float = unit.scale, floor: float = least(e)) -> str:
            return "" if value is None else half_width(value / scale, floor)

        small = e.bias and abs(e.bias) / unit.scale < least(e)
        bias = "" if e.bias is None else UNRESOLVED if small else rounded(e.bias / unit.scale, None, 2)
        rows.append(
            {
                "method": clean(e.method),
                "symbol": symbol_text(e.symbol, e.coordinate),
                "at": point_text(e.at),
                "value": cell(e),
                "unit": unit.unit,
                "repeats": half(e.parts.repeats),
                "by method": half(e.parts.method),
                "calibration": half(e.parts.calibration),
                **({"skew": half(None if e.value is None else e.parts.skew)} if skewed else {}),
                "bias": bias if e.corrected or not bias else f"{bias} left",
                "trials": str(e.n),
                "from": trial_ranges(e.trials, names),
                "note": note_text(e),
            }
        )
    return Frame(rows)


def trial_ranges(trials: Sequence[str], names: Mapping[str, str]) -> str:
    """Trials, named `run/number`, as `R1: 1–8, 11; R2: 3`."""
    runs: dict[str, list[int]] = {}
    others = []
    for trial in trials:
        run, _, index = trial.rpartition("/")
        if index.isascii() and index.isdigit() and len(index) < 7:
            runs.setdefault(names.get(run) or clean(run, 60), []).append(int(index))
        else:
            others.append(clean(trial, 60))
    parts = [f"{run}: {_ranges(sorted(set(indices)))}" for run, indices in runs.items()]
    return "; ".join(parts + others)


def _ranges(numbers: Sequence[int]) -> str:
    spans: list[list[int]] = []
    for n in numbers:
        if spans and n == spans[-1][1] + 1:
            spans[-1][1] = n
        else:
            spans.append([n, n])
    return ", ".join(str(low) if low == high else f"{low}–{high}" for low, high in spans)


def curves_table(analyses: Sequence[Analysis]) -> Frame:
    """Regression coefficients of every curve in its own coordinate, with interval, domain, R2 and residual; text."""
    rows = []
    for curve in (c for analysis in analyses for c in analysis.curves if not c.normalised):
        label, unit = point_shown(curve.against)
        low, high = (f"{end / unit.scale:.4g}" for end in curve.domain)
        first = shown(curve.terms[0].quantity, curve.terms[0].unit) if curve.terms else shown("", "")
        row = {"coefficient": clean(curve.symbol), "method": clean(curve.method), "form": clean(curve.form)}
        row["at"] = point_text(curve.terms[0].at) if curve.terms else ""
        for power, term in enumerate(curve.terms):
            head = ("constant", f"× {label}", f"× {label}²")[power] if power < 3 else f"× {label}^{power}"
            row[head] = f"{cell(term)} {shown(term.quantity, term.unit).unit}".strip()
        row[unit.label(f"valid for {label}")] = f"{low} to {high}"
        row["R²"] = _r2(curve.r2)
        row["residual rms"] = f"{half_width(curve.residual_rms / first.scale)} {first.unit}".strip()
        rows.append(row)
    heads = in_order((head for row in rows for head in row), ("coefficient", "method", "at", "form"))
    heads.sort(key=lambda head: head.startswith("valid") or head in ("R²", "residual rms"))
    return Frame(rows, columns=heads)


def polynomials_table(analyses: Sequence[Analysis]) -> Frame:
    """Terms of every polynomial in z = (coordinate - centre) / scale, powers from 0 up, one unit a row; text."""
    rows = []
    for curve in (c for analysis in analyses for c in analysis.curves if c.normalised and c.terms):
        label, unit = point_shown(curve.against)
        first = shown(curve.terms[0].quantity, curve.terms[0].unit)
        low, high, centre, scale = (f"{x / unit.scale:.5g}" for x in (*curve.domain, curve.centre, curve.scale))
        row = {"coefficient": clean(curve.symbol), "unit": first.unit}
        where = f"z = ({label} − {centre}) / {scale}, {low} to {high} {unit.unit}"
        row["method"] = f"{clean(curve.method)}; {where}".strip()
        for n, term in enumerate(curve.terms):
            row["1" if n == 0 else "z" + str(n).translate(RAISED) * (n > 1)] = cell(term)
        row |= {"R²": _r2(curve.r2), "rms": half_width(curve.residual_rms / first.scale)}
        rows.append(row)
    heads = in_order((head for row in rows for head in row), ("coefficient", "method", "unit"))
    return Frame(rows, columns=sorted(heads, key=("R²", "rms").__contains__))


def _r2(value: float) -> str:
    return f"{value:.5f}" if not 0.999995 <= value < 1 else ">\u202f0.99999"


def dropped_table(analyses: Sequence[Analysis]) -> Frame:
    """Trials that did not enter a fit, with their operating point and the reason; text."""
    rows = [
        {"test": kind_title(a.kind), "trial": clean(d.trial), "at": point_text(d.point), "reason": clean(d.reason)}
        for a in analyses
        for d in a.dropped
    ]
    return Frame(rows, columns=["test", "trial", "at", "reason"])


def findings_table(analyses: Sequence[Analysis]) -> Frame:
    """Findings of all analyses, faults first, then doubts, then what is said of the agreement of tests; text."""
    rank = {"fault": 0, "doubt": 1}
    found = [(rank.get(f.level, 2 if a.kind == AGREEMENT else 3), a, f) for a in analyses for f in a.findings]
    rows = [
        {"level": clean(f.level), "test": kind_title(a.kind), "finding": clean(f.text)}
        for _, a, f in sorted(found, key=lambda entry: entry[0])
    ]
    return Frame(rows, columns=["level", "test", "finding"])


def tuning_table(analyses: Sequence[Analysis]) -> Frame:
    """Controller settings of every rule, ideal and parallel form, with margins where a model is known; text."""
    rows = []
    for entry in (e for a in analyses for e in mappings(a.facts.get("tuning"))):
        row = {"operating point": point_text(numbers_of(entry.get("at"))), "rule": clean(entry.get("rule", ""))}
        gains = entry.get("gains")
        for symbol, found in gains.items() if isinstance(gains, Mapping) else ():
            if not isinstance(found, Mapping):
                continue
            unit = shown(str(found.get("quantity", "")), str(found.get("unit", "")))
            value = found.get("value")
            if isinstance(value, int | float):
                row[unit.label(clean(symbol))] = unit.rounded(value, half_of(value, found.get("ci95")))
        margins = numbers_of(entry.get("margins"))
        row |= {head: rounded(margins[name] / scale, None, 3) for name, head, scale in _MARGINS if name in margins}
        rows.append(row)
    wanted = ("operating point", "rule", "K_p", "T_i", "T_d", "K_i", "K_d", *(head for _, head, _ in _MARGINS))
    heads = list(dict.fromkeys(head for row in rows for head in row))
    rank = {name: place for place, name in enumerate(wanted)}
    heads.sort(key=lambda head: rank.get(head, rank.get(head.partition(" [")[0], len(rank))))
    return Frame(rows, columns=heads)


_MARGINS = (
    ("M_s", "M_s", 1.0),
    ("gain_margin", "gain margin [×]", 1.0),
    ("phase_margin", "phase margin [deg]", radians(1)),
)


def mappings(value: Any) -> list[Mapping[str, Any]]:
    """The mappings in a list; facts may hold anything."""
    return [item for item in value if isinstance(item, Mapping)] if isinstance(value, list | tuple) else []


def half_of(value: float, ends: Any) -> float | None:
    """How far an interval in facts reaches from its value, one that was cut off at 0 too; None where it is none."""
    pair = isinstance(ends, list | tuple) and len(ends) == 2 and all(map(is_number, ends))
    return max(ends[1] - value, value - ends[0]) if pair else None


def numbers_of(value: Any) -> dict[str, float]:
    """The numbers of a mapping; facts may hold anything."""
    return {str(k): float(v) for k, v in value.items() if is_number(v)} if isinstance(value, Mapping) else {}
