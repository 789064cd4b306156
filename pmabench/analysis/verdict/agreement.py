"""Whether independent tests of one specimen say the same: differences with combined intervals; fits nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import hypot

from pmabench.analysis.results import Analysis, Estimate, Finding, Parts
from pmabench.base.quantities import show

KIND = "agreement"
Values = Mapping[float, Estimate]
"""Pressure [Pa] -> estimate."""


def _at_pressures(analysis: Analysis, symbol: str, method: str) -> dict[float, Estimate]:
    """The values of a method by pressure; of several at one pressure none can be compared, and one stands bare."""
    found: dict[float, Estimate] = {}
    for e in analysis.estimates:
        if (e.symbol, e.method, e.coordinate) != (symbol, method, "") or e.value is None:
            continue
        if "pressure" in e.at and "frequency" not in e.at:
            P = e.at["pressure"]
            found[P] = replace(e, parts=Parts()) if P in found else e
    return found


def _mean_damping(analysis: Analysis) -> dict[float, Estimate]:
    """(B_c + B_r)/2 of the steps, which is what a sine sees."""
    contracting = _at_pressures(analysis, "B_c", "measured-pressure")
    relaxing = _at_pressures(analysis, "B_r", "measured-pressure")
    found = {}
    for pressure in contracting.keys() & relaxing.keys():
        one, two = contracting[pressure], relaxing[pressure]
        halves = [half for half in (one.parts.combined, two.parts.combined) if half is not None]
        half = hypot(*halves) / 2 if len(halves) == 2 else None
        mean = ((one.value or 0.0) + (two.value or 0.0)) / 2
        found[pressure] = replace(one, symbol="B", value=mean, parts=Parts(repeats=half))
    return found


def _steps(symbol: str) -> Callable[[Analysis], Values]:
    return lambda analysis: _at_pressures(analysis, symbol, "measured-pressure")


PAIRS: tuple[tuple[str, str, str, Callable[[Analysis], Values], str, Callable[[Analysis], Values]], ...] = (
    (
        "F_ce",
        "static load against contraction",
        "static-load",
        lambda a: _at_pressures(a, "F_ce", "static-mean"),
        "contraction-relaxation",
        _steps("F_ce"),
    ),
    (
        "K",
        "sine against steps",
        "sinusoidal-displacement",
        lambda a: _at_pressures(a, "K", "sine-harmonic"),
        "contraction-relaxation",
        _steps("K"),
    ),
    (
        "B",
        "sine against (B_c + B_r)/2 of steps",
        "sinusoidal-displacement",
        lambda a: _at_pressures(a, "B", "sine-harmonic"),
        "contraction-relaxation",
        _mean_damping,
    ),
    (
        "F_ce",
        "static load against isometric",
        "static-load",
        lambda a: _at_pressures(a, "F_ce", "static-mean"),
        "isometric-pressurisation",
        lambda a: _at_pressures(a, "F_ce", "isometric-sections"),
    ),
    (
        "K",
        "isometric against steps",
        "isometric-pressurisation",
        lambda a: _at_pressures(a, "K", "isometric-sections"),
        "contraction-relaxation",
        _steps("K"),
    ),
)
"""Symbol, what is compared, and for both sides the kind of analysis and where its values are."""


def agreement(analyses: Sequence[Analysis]) -> Analysis | None:
    """The differences between tests of one specimen at the same pressures; None where nothing can be compared.

    A value without an interval is compared with nothing, and a finding says so.

    Two values agree where their difference is smaller than the root of the sum of squares of their 95 % half widths
    (E_n number at most 1, ISO/IEC 17043). Calibration errors that both tests share are counted in both: the judgement
    is generous by that.
    """
    by_kind = {analysis.kind: analysis for analysis in analyses}
    estimates: list[Estimate] = []
    findings: list[Finding] = []
    for symbol, title, left_kind, left, right_kind, right in PAIRS:
        if left_kind not in by_kind or right_kind not in by_kind:
            continue
        one, two = left(by_kind[left_kind]), right(by_kind[right_kind])
        both = sorted(one.keys() & two.keys())
        without = [p for p in both if one[p].parts.combined is None or two[p].parts.combined is None]
        differences = [_difference(one[p], two[p], p, title) for p in both if p not in without]
        if differences:
            estimates += differences
            findings.append(_sentence(symbol, title, differences))
        if without:
            where = ", ".join(show(p, "pressure") for p in without)
            text = f"{symbol}, {title}: not compared at {where}, where one has no interval, or several values"
            findings.append(Finding("note", text))
    if not findings:
        return None
    return Analysis(
        KIND,
        tuple(dict.fromkeys(run for analysis in analyses for run in analysis.runs)),
        any(analysis.simulated for analysis in analyses),
        tuple(estimates),
        findings=tuple(findings),
    )


def _difference(one: Estimate, two: Estimate, pressure: float, title: str) -> Estimate:
    return replace(
        one,
        value=(one.value or 0.0) - (two.value or 0.0),
        parts=Parts(repeats=hypot(one.parts.combined or 0.0, two.parts.combined or 0.0)),
        coordinate="difference",
        method=title,
        at={"pressure": pressure},
        n=one.n + two.n,
        bias=None,
        corrected=False,
        note="",
        trials=(),
    )


def _score(difference: Estimate) -> float:
    """|E_n|."""
    half = difference.parts.combined
    return abs(difference.value or 0.0) / half if half else float("inf")


def _sentence(symbol: str, title: str, differences: Sequence[Estimate]) -> Finding:
    worst = max(differences, key=_score)
    value = show(worst.value or 0.0, worst.quantity, 2)
    half = show(worst.parts.combined or 0.0, worst.quantity, 2)
    agree = _score(worst) <= 1.0
    where = show(worst.at["pressure"], "pressure")
    scope = f"furthest apart at {where}" if len(differences) > 1 else f"at {where}"
    told = "they agree within their intervals" if agree else "they do not agree within their intervals"
    return Finding(
        "note" if agree else "doubt",
        f"{symbol}, {title}, {scope}: difference {value}, combined interval {half}; {told}",
    )
