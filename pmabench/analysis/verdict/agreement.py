"""Whether independent tests of one specimen say the same: differences with combined intervals; fits nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import hypot

from pmabench.analysis.results import Analysis, Estimate, Finding, Parts
from pmabench.base.quantities import show

KIND = "agreement"
STEPS, STATIC, SINES, HELD = (
    "contraction-relaxation", "static-load", "sinusoidal-displacement", "isometric-pressurisation",
)  # fmt: skip
PRIMARY = {STEPS: "measured-pressure", STATIC: "static-mean", SINES: "sine-harmonic", HELD: "isometric-sections"}
"""Kind of test -> the method that is compared."""
ASKED = {"joint": "joint fit", "output-error": "output-error fit"}
"""Further methods of contraction tests, which are there only where somebody asked for them, in words."""
PAPER = "contraction-relaxation-paper-1"
"""Kind of contraction tests whose protocol asks for paper 1's way; its first method is the one that it names."""
PAPER_WORDS = "paper 1's way"
PAIRS = (
    ("F_ce", "static load against contraction", STATIC, STEPS),
    ("K", "sine against steps", SINES, STEPS),
    ("B", "sine against (B_c + B_r)/2 of steps", SINES, STEPS),
    ("F_ce", "static load against isometric", STATIC, HELD),
    ("K", "isometric against steps", HELD, STEPS),
)
"""Symbol, what is compared, and the kinds of both sides."""
OF_STATIC = {STEPS: PAIRS[0][1], HELD: PAIRS[3][1]}
"""Kind of test whose F_ce a protocol can limit against that of static load -> what is compared."""
Values = Mapping[float, Estimate]
"""Pressure [Pa] -> estimate."""


def _values(analysis: Analysis, symbol: str, method: str) -> Values:
    """What a method says of a symbol by pressure; B of steps is the mean of both directions."""
    if symbol == "B" and analysis.kind == STEPS:
        return _mean_damping(analysis, method)
    return _at_pressures(analysis, symbol, method)


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


def _mean_damping(analysis: Analysis, method: str) -> dict[float, Estimate]:
    """(B_c + B_r)/2 of the steps, which is what a sine sees."""
    contracting, relaxing = (_at_pressures(analysis, symbol, method) for symbol in ("B_c", "B_r"))
    found = {}
    for pressure in contracting.keys() & relaxing.keys():
        one, two = contracting[pressure], relaxing[pressure]
        halves = [half for half in (one.parts.combined, two.parts.combined) if half is not None]
        half = hypot(*halves) / 2 if len(halves) == 2 else None
        mean = ((one.value or 0.0) + (two.value or 0.0)) / 2
        found[pressure] = replace(one, symbol="B", value=mean, parts=Parts(repeats=half))
    return found


def _sides(analysis: Analysis, symbol: str) -> Iterator[tuple[str, str]]:
    """The methods of a contraction test that are compared, with their words; none for the primary one."""
    if analysis.kind == PAPER:
        first = next((e.method for e in analysis.estimates if e.symbol == symbol), None)
        if first and symbol == "K":
            yield first, PAPER_WORDS
        return
    yield PRIMARY[analysis.kind], ""
    if analysis.kind == STEPS:
        known = {e.method for e in analysis.estimates}
        yield from ((method, words) for method, words in ASKED.items() if method in known)


def _on_line(values: Values, P: float) -> Estimate | None:
    """F_ce of static load at P [Pa], a straight line there, so between its points too; None outside of them.

    The half width between two points is at most what those of the ends are there.
    """
    if P in values:
        return values[P]
    low, high = (max((p for p in values if p < P), default=None), min((p for p in values if p > P), default=None))
    if low is None or high is None:
        return None
    one, two, share = values[low], values[high], (P - low) / (high - low)
    halves = [half for half in (one.parts.combined, two.parts.combined) if half is not None]
    half = (1 - share) * halves[0] + share * halves[1] if len(halves) == 2 else None
    value = (1 - share) * (one.value or 0.0) + share * (two.value or 0.0)
    return replace(one, value=value, at={"pressure": P}, parts=Parts(repeats=half))


def _pairs(one: Values, two: Values, kind: str) -> dict[float, tuple[Estimate, Estimate]]:
    """Both values at every pressure that both tell; `one` of kind static-load is a line."""
    found = {}
    for P, other in sorted(two.items()):
        mine = _on_line(one, P) if kind == STATIC else one.get(P)
        if mine is not None:
            found[P] = (mine, other)
    return found


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
    for symbol, title, left, right in PAIRS:
        for kind in (right, PAPER) if right == STEPS else (right,):
            if left not in by_kind or kind not in by_kind:
                continue
            for method, words in _sides(by_kind[kind], symbol):
                name = f"{title}, {words}" if words else title
                one, two = _values(by_kind[left], symbol, PRIMARY[left]), _values(by_kind[kind], symbol, method)
                both = _pairs(one, two, left)
                without = [P for P, pair in both.items() if any(e.parts.combined is None for e in pair)]
                differences = [_difference(*pair, P, name) for P, pair in both.items() if P not in without]
                if differences:
                    estimates += differences
                    findings.append(_sentence(symbol, name, differences))
                if without:
                    where = ", ".join(show(P, "pressure") for P in without)
                    text = f"{symbol}, {name}: not compared at {where}, where one has no interval, or several values"
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


def against_static(analysis: Analysis, static: Analysis) -> dict[float, tuple[Estimate, Estimate]]:
    """F_ce of a test of `OF_STATIC` by its primary method and of static load, by pressure [Pa] that both cover."""
    mine, theirs = _values(analysis, "F_ce", PRIMARY[analysis.kind]), _values(static, "F_ce", PRIMARY[STATIC])
    return {P: (other, one) for P, (one, other) in _pairs(theirs, mine, STATIC).items()}


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
