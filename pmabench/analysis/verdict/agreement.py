"""Whether independent tests of one specimen say the same: differences with combined intervals; fits nothing.

What each kind of test offers is in `offers`; every pair of kinds is compared wherever both say something.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import hypot, inf

from pmabench.analysis.results import Analysis, Estimate, Finding, Parts
from pmabench.analysis.shared import student
from pmabench.analysis.verdict.offers import (
    HELD,
    ISOBARIC,
    PRIMARY,
    STATIC,
    STEPS,
    WORDS,
    Offer,
    Place,
    at_pressures,
    offers_of,
    on_line,
)
from pmabench.base.quantities import show

KIND = "agreement"
OF_STATIC = {
    STEPS: f"{WORDS[STATIC]} against {WORDS[STEPS]}",
    HELD: f"{WORDS[STATIC]} against {WORDS[HELD]}",
}
"""Kind of test whose F_ce a protocol can limit against that of static load -> what is compared."""
FALSE_ALARM = 0.01
"""Probability that tests which agree are called contradictory, over all comparisons of one specimen together."""
FEWEST = 3
"""Degrees of freedom of a scatter, at least: where there is one trial it is that of its cycles."""
REST = "static-half-difference"
"""Method of the friction of static load."""


@dataclass(frozen=True)
class Comparison:
    """Two tests at one place."""

    symbol: str
    place: Place
    one: Estimate
    two: Estimate
    title: str
    kinds: tuple[str, str]
    at_least: bool = False
    """The first need not be equal, only not below the second."""

    @property
    def known(self) -> bool:
        """Whether both have an interval."""
        return self.one.parts.combined is not None and self.two.parts.combined is not None

    @property
    def value(self) -> float:
        """The difference [SI]."""
        return (self.one.value or 0.0) - (self.two.value or 0.0)

    @property
    def half(self) -> float:
        """Root of the sum of squares of both half widths."""
        return hypot(self.one.parts.combined or 0.0, self.two.parts.combined or 0.0)

    @property
    def score(self) -> float:
        """|E_n| (ISO/IEC 17043); of what need only not be below, how far it is."""
        off = max(-self.value, 0.0) if self.at_least else abs(self.value)
        return off / self.half if self.half else (0.0 if off == 0 else inf)

    def limit(self, count: int) -> float:
        """|E_n| that is no chance any more among `count` comparisons (Bonferroni).

        A half width that rests on few trials is often too small by chance: Student's t with the effective degrees of
        freedom of Welch and Satterthwaite, of which all parts but the repeats have no end.
        """
        scatter = sum((e.parts.repeats or 0.0) ** 4 / max(e.n - 1, FEWEST) for e in (self.one, self.two))
        freedom = self.half**4 / scatter if scatter else inf
        freedom = min(freedom, 1e6)
        return float(student.ppf(1 - FALSE_ALARM / (2 * count), freedom) / student.ppf(0.975, freedom))

    @property
    def where(self) -> str:
        """The place in words."""
        P, x = self.place
        told = [show(P, "pressure")] if P == P else []  # NaN: of the whole campaign
        if x is not None and self.symbol != "F_ce":
            told.append(show(x, "length", 3))
        return " at " + " and ".join(told) if told else ""

    def estimate(self) -> Estimate:
        """The difference as a row of a table."""
        P, x = self.place
        at = {"pressure": P} if P == P else {}
        if x is not None and self.symbol != "F_ce":
            at["contraction"] = x
        return Estimate(
            self.symbol, self.value, self.one.unit, self.one.quantity, self.title, at, Parts(repeats=self.half),
            self.one.n + self.two.n, coordinate="difference",
        )  # fmt: skip


def agreement(analyses: Sequence[Analysis]) -> Analysis | None:
    """The differences between tests of one specimen at the same places; None where nothing can be compared.

    A value without an interval is compared with nothing, and a finding says so.

    Two values agree where their difference is smaller than the root of the sum of squares of their 95 % half widths
    (E_n number at most 1). Of many comparisons one in twenty is beyond that by chance: results are refused where a
    difference is larger than chance makes in one of a hundred campaigns. Calibration errors that both tests share are
    counted in both: the judgement is generous by that.
    """
    found = [one for pair in combinations(_in_order(analyses), 2) for one in _compared(*pair)]
    found += _of_rest(analyses)
    known = [one for one in found if one.known]
    findings, refusals = [], []
    for symbol, title in dict.fromkeys((one.symbol, one.title) for one in found):
        group = [one for one in found if (one.symbol, one.title) == (symbol, title)]
        mine = [one for one in group if one.known]
        if mine:
            findings.append(_sentence(mine, len(known)))
            refusals += _refusal(mine, len(known))
        if without := [one.where.removeprefix(" at ") for one in group if not one.known]:
            text = f"{symbol}, {title}: not compared at {', '.join(dict.fromkeys(without))}, where one has no interval"
            findings.append(Finding("note", text))
    if not findings:
        return None
    return Analysis(
        KIND,
        tuple(dict.fromkeys(run for analysis in analyses for run in analysis.runs)),
        any(analysis.simulated for analysis in analyses),
        tuple(one.estimate() for one in known if not one.at_least),
        findings=tuple(findings),
        refusals=tuple(refusals),
        facts={"comparisons": len(known), "beyond_intervals": sum(one.score > 1.0 for one in known)},
    )


def _in_order(analyses: Sequence[Analysis]) -> list[list[Offer]]:
    """What each kind of test offers, in the order of naming."""
    offers = [offer for analysis in analyses for offer in offers_of(analysis)]
    return [[offer for offer in offers if offer.kind == kind] for kind in WORDS]


def _compared(left: Sequence[Offer], right: Sequence[Offer]) -> Iterator[Comparison]:
    """Every place where two kinds of test both say something, once."""
    seen: set[tuple[object, ...]] = set()
    for one in left:
        for two in right:
            if one.symbol != two.symbol:
                continue
            title = f"{WORDS[one.kind]} against {WORDS[two.kind]}"
            title = ", ".join([title, *(words for words in (one.words, two.words) if words)])
            for place in sorted({*one.points, *two.points}, key=_order):
                mine, theirs = one.at(place), two.at(place)
                if mine is None or theirs is None or (key := (title, place[0], mine.value, theirs.value)) in seen:
                    continue
                seen.add(key)
                symbol = "F_ce" if one.symbol == "F" and place[1] == 0.0 else one.symbol
                yield Comparison(symbol, place, mine, theirs, title, (one.kind, two.kind))


def _order(place: Place) -> tuple[float, bool, float]:
    """By pressure, then by contraction; what has none comes last, for it is what others are compared with anywhere."""
    P, x = place
    return P, x is None, x or 0.0


def _of_rest(analyses: Sequence[Analysis]) -> Iterator[Comparison]:
    """The friction of static load, at which a muscle at rest begins to move, is not below F_c of one that moves."""
    at_rest = [
        e
        for analysis in analyses
        if analysis.kind == STATIC
        for e in analysis.estimates
        if e.method == REST and not e.at and e.value is not None
    ]
    moving = [(offer, e) for analysis in analyses for offer in offers_of(analysis) if offer.symbol == "F_c"
              for e in (offer.points.values() or [offer.at((float("nan"), None))])]  # fmt: skip
    for one in at_rest:
        for offer, two in moving:
            if two is not None:
                title = f"friction at rest of {WORDS[STATIC]} against F_c of {WORDS[offer.kind]}"
                place = (two.at.get("pressure", float("nan")), None)
                yield Comparison("F_f", place, one, two, title, (STATIC, offer.kind), at_least=True)


def against_static(analysis: Analysis, static: Analysis) -> dict[float, tuple[Estimate, Estimate]]:
    """F_ce of a test of `OF_STATIC` by its primary method and of static load, by pressure [Pa] that both cover."""
    theirs: Mapping[float, Estimate] = at_pressures(static, "F_ce", PRIMARY[STATIC])
    mine = at_pressures(analysis, "F_ce", PRIMARY[analysis.kind])
    pairs = {P: (one, on_line(theirs, P)) for P, one in sorted(mine.items())}
    return {P: (one, two) for P, (one, two) in pairs.items() if two is not None}


def _sentence(group: Sequence[Comparison], count: int) -> Finding:
    """What a pair of kinds says of a quantity, by its worst place."""
    worst = max(group, key=lambda one: one.score / one.limit(count))
    difference, half = (show(value, worst.one.quantity, 2) for value in (worst.value, worst.half))
    scope = f", furthest apart{worst.where}" if len(group) > 1 else f",{worst.where}" if worst.where else ""
    begin = f"{worst.symbol}, {worst.title}{scope}: difference {difference}, combined interval {half}; "
    if worst.score > worst.limit(count):
        return Finding("doubt", f"{begin}they do not agree within their intervals")
    if worst.at_least and worst.value > worst.half:
        two = "that of a muscle at rest is static friction, F_c is that of a moving one, and the smaller"
        return Finding("note", f"{begin}they measure different things: {two}")
    if worst.score <= 1.0:
        return Finding("note", f"{begin}they agree within their intervals")
    return Finding("note", f"{begin}beyond them, but no further than chance reaches in {count} comparisons")


def _refusal(group: Sequence[Comparison], count: int) -> list[str]:
    """Why neither of two tests is accepted; nothing where they agree."""
    beyond = [one for one in group if one.score > one.limit(count)]
    if not beyond:
        return []
    worst = max(beyond, key=lambda one: one.score / one.limit(count))
    sides = [
        f"{WORDS[kind]} {show(e.value or 0.0, e.quantity, 4)} +- {show(e.parts.combined or 0.0, e.quantity, 2)}"
        for kind, e in zip(worst.kinds, (worst.one, worst.two), strict=True)
    ]
    better = "the isobaric ramp measures the curve itself"
    if ISOBARIC not in worst.kinds:
        better = "an isobaric ramp (isobaric-ramp) measures the curve itself"
    more = f" ({len(beyond)} of {len(group)} places)" if len(group) > 1 else ""
    return [
        f"{worst.symbol}{worst.where}{more}: {' and '.join(sides)} disagree: the difference is {worst.score:.2g} times "
        f"the combined interval, and chance makes at most {worst.limit(count):.2g} in {count} comparisons; one of the "
        f"two tests is wrong, or the muscle does not follow F = F_ce - K x: {better}"
    ]
