"""Agreement of independent tests of one specimen: values offered by each test, differences with combined intervals.

Each kind of test has a function `offers`, named in its record; its values are compared with those of all other kinds
wherever both have one.

Also conversion of several like muscles in parallel to a single one: forces and volumes add up, contraction and
pressure are shared (paper 2: the arm's force is 4 f). Friction between the muscles, or one that is longer than the
others, shows as a difference from a single muscle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import comb, hypot, inf, isnan, nan
from typing import Any

import numpy as np

from pmabench.analysis.shared import student
from pmabench.base.kind import Kind
from pmabench.base.quantities import show
from pmabench.store.analyses.results import POINT_QUANTITIES, Analysis, Curve, Estimate, Finding, Parts

SAME = 1e-6
"""Distance below which contractions are equal [m]."""
Place = tuple[float, float | None]
"""Pressure [Pa] and contraction [m]; None where there is no dependence on contraction, NaN for none on pressure."""
ANYWHERE: Place = (nan, None)
"""Place of a value for the whole campaign."""
At = Callable[[Place], Estimate | None]
Points = Mapping[Place, Estimate]


@dataclass(frozen=True)
class Offer:
    """A quantity measured by one test: values at its own places, and a function of the place."""

    symbol: str
    """`F`: static force, mean of both directions; `x`: contraction without load; K, B: of both directions; F_c."""
    points: Points
    at: At
    """Returns the value at a place; None outside the range of the test."""
    words: str = ""
    """Name of the method where it is not the primary one."""
    side: int = 0
    """1: an upper bound of the quantity, -1: a lower bound, 0: the value itself."""
    bent: bool = False
    """Whether it depends on contraction, so that a value for a whole stroke is another quantity."""
    rubs: bool = False
    """Whether it may contain friction of unknown sign, because it is not recorded how the length was reached."""
    why: str = ""
    """Reason for a difference to that side."""
    test: str = ""
    """`Kind.word` of the test, set by `offers_of`."""


def offers_of(analysis: Analysis, kind: Kind | None) -> list[Offer]:
    """All offers of an analysis; empty for kinds of test without any."""
    found = kind.part("offers")(analysis) if kind is not None and kind.offers else ()
    return [replace(offer, test=kind.word) for offer in found] if kind is not None else []


def values_of(analysis: Analysis, symbol: str, method: str) -> list[Estimate]:
    """Values of a symbol by a method at set pressures, without those of single frequencies or terms of curves."""
    return [
        e
        for e in analysis.estimates
        if (e.symbol, e.method, e.coordinate) == (symbol, method, "") and e.value is not None
        if "frequency" not in e.at and "pressure" in e.at
    ]


def at_pressures(analysis: Analysis, symbol: str, method: str) -> dict[float, Estimate]:
    """Pressure [Pa] -> estimate, from `values_of`."""
    return {e.at["pressure"]: e for e in values_of(analysis, symbol, method)}


def everywhere(symbol: str, known: Mapping[float, Estimate], words: str = "") -> Offer:
    """An offer for pressures [Pa], at any contraction."""
    return Offer(symbol, {(P, None): e for P, e in known.items()}, lambda place: known.get(place[0]), words)


def anywhere(symbol: str, known: Estimate, words: str = "") -> Offer:
    """An offer of one value for the whole campaign."""
    return Offer(symbol, {ANYWHERE: known}, lambda place: known, words)


def exactly(symbol: str, points: Points, words: str = "") -> Offer:
    """An offer at its own places only; a place without a contraction matches any."""

    def at(place: Place) -> Estimate | None:
        P, x = place
        for (P_here, x_here), estimate in points.items():
            if P_here == P and (x_here is None or x is None or abs(x_here - x) <= SAME):
                return estimate
        return None

    return Offer(symbol, points, at, words)


def straight(
    F_ce: Mapping[float, Estimate], K: Mapping[float, Estimate], furthest: Callable[[float], float], words: str = ""
) -> Offer:
    """F_ce - K x [N] at its pressures [Pa], from x = 0 to the `furthest` contraction [m] that was tested at each."""

    def at(place: Place) -> Estimate | None:
        P, x = place
        force, stiffness = F_ce.get(P), K.get(P)
        if x is None or force is None or (abs(x) > SAME and not 0 <= x <= furthest(P) + SAME):
            return None
        if abs(x) <= SAME:
            return force
        return None if stiffness is None else weighted([(force, 1.0), (stiffness, -x)], "F")

    return Offer("F", {(P, 0.0): e for P, e in F_ce.items()}, at, words)


def between(known: Sequence[tuple[float, Estimate]], at: float, *, bent: bool = False) -> Estimate | None:
    """Value at `at`, interpolated linearly in `known`, which has rising places; None outside of it.

    Half widths are interpolated, too; a calibration part that only one neighbour has falls to 0 towards the other. For
    a quantity that may be `bent`, even sharply as at the end of a dead band, the distance of the extrapolated
    neighbouring piece from the line is in the method part; without one there is none.
    """
    places = np.array([place for place, _ in known])
    if len(known) < 2 or not places[0] - SAME <= at <= places[-1] + SAME:
        return known[0][1] if len(known) and abs(places[0] - at) <= SAME else None

    def along(pair: Sequence[tuple[float, Estimate]]) -> float:
        """The line through two points, evaluated at `at`."""
        (low, one), (high, two) = pair
        return (one.value or 0.0) + ((two.value or 0.0) - (one.value or 0.0)) * (at - low) / (high - low)

    i = int(np.clip(np.searchsorted(places, at), 1, len(known) - 1))
    (low, one), (high, two) = known[i - 1 : i + 1]
    share = (at - low) / (high - low)
    if not 0 < share < 1:
        return one if share <= 0 else two
    value = (1 - share) * (one.value or 0.0) + share * (two.value or 0.0)
    pieces = [pair for pair in (known[max(0, i - 2) : i], known[i : i + 2]) if bent and len(pair) == 2]
    off = min((abs(along(pair) - value) for pair in pieces), default=None if bent else 0.0)

    def mean(halves: Sequence[float | None]) -> float | None:
        first, second = halves
        return None if first is None or second is None else (1 - share) * first + share * second

    half = mean([replace(e.parts, calibration=None).combined for e in (one, two)])
    declared = [e.parts.calibration for e in (one, two)]
    scales = None if declared == [None, None] else mean([scale or 0.0 for scale in declared])
    parts = Parts(repeats=None if off is None else half, method=off, calibration=scales)
    return replace(one, value=value, parts=parts, n=min(one.n, two.n))


def weighted(pairs: Sequence[tuple[Estimate, float]], symbol: str) -> Estimate:
    """Weighted sum of estimates, otherwise like the first; parts add as squares, as if independent."""
    parts: dict[str, float] = {}
    for name in vars(Parts()):
        known = [(getattr(e.parts, name), weight) for e, weight in pairs]
        halves = [abs(weight) * half for half, weight in known if half is not None]
        if halves and (name != "repeats" or len(halves) == len(pairs)):
            parts[name] = hypot(*halves)
    value = sum(weight * (e.value or 0.0) for e, weight in pairs)
    return replace(pairs[0][0], symbol=symbol, value=value, parts=Parts(**parts), n=min(e.n for e, _ in pairs))


KIND = "agreement"
FALSE_ALARM = 0.01
"""Probability of a false contradiction in all comparisons of one specimen together."""
BEYOND, UNLIKELY, MANY = 0.05, 1e-3, 5
"""Share of differences beyond their intervals by chance; probability of a count of them that chance does not make, and
the least count: differences at neighbouring places have causes in common.
"""
FEWEST = 3
"""Least degrees of freedom of a scatter; that of a single trial is the scatter of its cycles."""
OF_FORM = ("F_ce", "F", "K")
"""Quantities that also disagree where the force of the muscle is not linear over contraction."""


@dataclass(frozen=True)
class Comparison:
    """Values of two tests at one place."""

    symbol: str
    place: Place
    one: Estimate
    two: Estimate
    title: str
    tests: tuple[str, str]
    """`Offer.test` of both."""
    side: int = 0
    """1: the first is an upper bound, which must not be below the second; -1: a lower bound; 0: both are values."""
    why: str = ""
    """Reason for a difference to that side."""

    @property
    def known(self) -> bool:
        """Whether both values have an interval."""
        return self.one.parts.combined is not None and self.two.parts.combined is not None

    @property
    def value(self) -> float:
        """Difference of the first from the second [SI]."""
        return (self.one.value or 0.0) - (self.two.value or 0.0)

    @property
    def half(self) -> float:
        """Combined half width: root of the sum of squares of both [SI]."""
        return hypot(self.one.parts.combined or 0.0, self.two.parts.combined or 0.0)

    @property
    def score(self) -> float:
        """|E_n| (ISO/IEC 17043); for a bound only a difference to the wrong side counts."""
        off = max(-self.side * self.value, 0.0) if self.side else abs(self.value)
        return off / self.half if self.half else (0.0 if off == 0 else inf)

    def limit(self, count: int) -> float:
        """Largest |E_n| that is likely by chance among `count` comparisons (Bonferroni).

        Half widths from few trials are often too small by chance, hence Student's t with the effective degrees of
        freedom of Welch and Satterthwaite, which are infinite for all parts but the repeats.
        """
        scatter = sum((e.parts.repeats or 0.0) ** 4 / max(e.n - 1, FEWEST) for e in (self.one, self.two))
        freedom = self.half**4 / scatter if scatter else inf
        freedom = min(freedom, 1e6)
        return float(student.ppf(1 - FALSE_ALARM / (2 * count), freedom) / student.ppf(0.975, freedom))

    @property
    def at(self) -> dict[str, float]:
        """Operating point [SI]; without the contraction for F_ce."""
        P, x = self.place
        at = {} if isnan(P) else {"pressure": P}
        return at if x is None or self.symbol == "F_ce" else {**at, "contraction": x}

    @property
    def where(self) -> str:
        """The operating point as text, for instance ` at 300 kPa`; empty without one."""
        digits = {"pressure": ("pressure", 6), "contraction": ("length", 3)}
        places = [show(value, *digits[name]) for name, value in self.at.items()]
        return " at " + " and ".join(places) if places else ""

    def estimate(self) -> Estimate:
        """The difference as an estimate, for a table."""
        return Estimate(
            self.symbol, self.value, self.one.unit, self.one.quantity, self.title, self.at, Parts(repeats=self.half),
            self.one.n + self.two.n, coordinate="difference",
        )  # fmt: skip


def agreement(analyses: Sequence[Analysis], offers: Sequence[Offer], instead: str = "") -> Analysis | None:
    """Differences between tests of one specimen at common places; None where nothing can be compared.

    `offers` are those of all `analyses`; `instead` is the advice for a muscle whose force is not linear. Values without
    an interval are not compared, and reported in a finding.

    Two values agree where |E_n| is at most 1, which one in twenty comparisons exceeds by chance. Results are refused
    beyond `Comparison.limit`, which chance exceeds in one of a hundred campaigns. Calibration errors that both tests
    share are counted in both, which makes the judgement milder.
    """
    tests = [[offer for offer in offers if offer.test == test] for test in dict.fromkeys(o.test for o in offers)]
    friction = [e.value or 0.0 for o in offers if o.symbol == "F_c" and not o.side for e in o.points.values()]
    found = [one for pair in combinations(tests, 2) for one in _compared(*pair, max(friction, default=0.0))]
    known = [one for one in found if one.known]
    findings, refusals = [], []
    for symbol, title in dict.fromkeys((one.symbol, one.title) for one in found):
        group = [one for one in found if (one.symbol, one.title) == (symbol, title)]
        mine = [one for one in group if one.known]
        if mine:
            findings.append(_sentence(mine, len(known)))
            refusals += _refusal(mine, len(known), instead)
        if without := [one.where.removeprefix(" at ") for one in group if not one.known]:
            text = f"{symbol}, {title}: not compared at {', '.join(dict.fromkeys(without))}, where one has no interval"
            findings.append(Finding("note", text))
    if not findings:
        return None
    beyond = sum(one.score > 1.0 for one in known)
    findings += _many(beyond, len(known))
    return Analysis(
        KIND,
        tuple(dict.fromkeys(run for analysis in analyses for run in analysis.runs)),
        any(analysis.simulated for analysis in analyses),
        tuple(one.estimate() for one in known if not one.side),
        findings=tuple(findings),
        refusals=tuple(refusals),
        facts={"comparisons": len(known), "beyond_intervals": beyond},
    )


def _compared(left: Sequence[Offer], right: Sequence[Offer], rubs: float) -> Iterator[Comparison]:
    """Comparisons at common places of two kinds of test; `rubs` [N] is added to offers that may contain friction."""
    seen: set[tuple[object, ...]] = set()
    for one in left:
        for two in right:
            if not _are_one_quantity(one, two):
                continue
            title = ", ".join(word for word in (f"{one.test} against {two.test}", one.words, two.words) if word)
            side, why = (one.side, one.why) if one.side else (-two.side, two.why)
            for place in sorted(_places(one, two), key=_order):
                mine, theirs = (_with_friction(offer, offer.at(place), rubs) for offer in (one, two))
                if mine is None or theirs is None or (key := (title, place[0], mine.value, theirs.value)) in seen:
                    continue
                seen.add(key)
                symbol = "F_ce" if one.symbol == "F" and place[1] == 0.0 else one.symbol
                yield Comparison(symbol, place, mine, theirs, title, (one.test, two.test), side, why)


def _with_friction(offer: Offer, known: Estimate | None, rubs: float) -> Estimate | None:
    if known is None or not offer.rubs:
        return known
    return replace(known, parts=replace(known.parts, method=hypot(known.parts.method or 0.0, rubs)))


def _are_one_quantity(one: Offer, two: Offer) -> bool:
    """Whether two offers can be compared: not two bounds, nor a local value of a bent curve and one for a stroke."""
    local = all(x is not None for offer in (one, two) for _, x in offer.points)
    return one.symbol == two.symbol and not (one.side and two.side) and (local or not (one.bent or two.bent))


def _places(one: Offer, two: Offer) -> set[Place]:
    """Places of both, and those with the pressure of one and the contraction of the other."""
    crossed = {(P, x) for a in one.points for b in two.points for P, x in ((a[0], b[1]), (b[0], a[1])) if x is not None}
    return {*one.points, *two.points, *crossed}


def _order(place: Place) -> tuple[float, bool, float]:
    """Sort key: by pressure, then by contraction; places without one are last."""
    P, x = place
    return inf if isnan(P) else P, x is None, x or 0.0


def _sentence(group: Sequence[Comparison], count: int) -> Finding:
    """Finding about a quantity of two kinds of test, from the place with the largest difference."""
    worst = max(group, key=lambda one: one.score / one.limit(count))
    difference, half = (show(value, worst.one.quantity, 2) for value in (worst.value, worst.half))
    scope = f", furthest apart{worst.where}" if len(group) > 1 else f",{worst.where}" if worst.where else ""
    begin = f"{worst.symbol}, {worst.title}{scope}: difference {difference}, combined interval {half}; "
    if worst.score > worst.limit(count):
        return Finding("doubt", f"{begin}they do not agree within their intervals")
    if worst.side and worst.side * worst.value > worst.half:
        return Finding("note", f"{begin}they measure different things: {worst.why}")
    if worst.score <= 1.0:
        return Finding("note", f"{begin}they agree within their intervals")
    return Finding("note", f"{begin}beyond them, but no further than chance reaches in {count} comparisons")


def _many(beyond: int, count: int) -> list[Finding]:
    """A doubt where more differences are beyond their intervals than chance makes: one alone may tell nothing."""
    likely = [comb(count, n) * BEYOND**n * (1 - BEYOND) ** (count - n) for n in range(beyond)]
    if beyond < MANY or 1 - sum(likely) > UNLIKELY:
        return []
    text = f"{beyond} of {count} differences between the tests are beyond their intervals, where chance makes"
    return [Finding("doubt", f"{text} {max(1, round(BEYOND * count))}: a sensor, or the specimen, was not the same")]


def _refusal(group: Sequence[Comparison], count: int, instead: str) -> list[str]:
    """Reasons to refuse both tests; empty where they agree."""
    beyond = [one for one in group if one.score > one.limit(count)]
    if not beyond:
        return []
    worst = max(beyond, key=lambda one: one.score / one.limit(count))
    sides = [
        f"{test} {show(e.value or 0.0, e.quantity, 4)} +- {show(e.parts.combined or 0.0, e.quantity, 2)}"
        for test, e in zip(worst.tests, (worst.one, worst.two), strict=True)
    ]
    reason = "one of the two tests is wrong"
    if worst.symbol in OF_FORM:
        reason += ", or the muscle does not follow F = F_ce - K x" + (f": {instead}" if instead else "")
    more = f" ({len(beyond)} of {len(group)} places)" if len(group) > 1 else ""
    return [
        f"{worst.symbol}{worst.where}{more}: {' and '.join(sides)} disagree: the difference is {worst.score:.2g} times "
        f"the combined interval, and chance makes at most {worst.limit(count):.2g} in {count} comparisons; {reason}"
    ]


ADDED = ("force", "stiffness", "damping", "work", "volume", "mass flow", "impulse", "force rate")
"""Quantities that add up over parallel muscles, also per other quantities such as pressure."""


def side_by_side(specimen: object) -> int:
    """Number of parallel muscles of a specimen in a manifest; 1 where it is not given."""
    assembly = specimen.get("assembly") if isinstance(specimen, Mapping) else None
    return int(assembly.get("parallel", 1)) if isinstance(assembly, Mapping) else 1


def without_diameter(analysis: Analysis, count: int) -> Analysis:
    """The analysis of `count` parallel muscles without the diameter, which would be that of a single muscle."""
    if count == 1:
        return analysis
    note = f"{count} muscles side by side: the diameter would be that of one muscle with their force or volume"
    estimates = tuple(
        replace(e, value=None, parts=Parts(), bias=None, budget=(), bound=None, note=note) if e.symbol == "D_0" else e
        for e in analysis.estimates
    )
    return replace(analysis, estimates=estimates)


def adds_up(quantity: str) -> bool:
    """Whether a quantity of `QUANTITIES` adds up over parallel muscles."""
    return quantity.split(" per ")[0] in ADDED


def of_one(analysis: Analysis, count: int) -> Analysis:
    """The analysis of `count` like parallel muscles with quantities that add up divided by it, without traces."""

    def curve(one: Curve) -> Curve:
        share = 1 / count if any(adds_up(term.quantity) for term in one.terms) else 1.0
        terms = tuple(_of_one(term, count) for term in one.terms)
        return replace(one, terms=terms, residual_rms=share * one.residual_rms)

    estimates = tuple(_of_one(e, count) for e in analysis.estimates)
    return replace(analysis, estimates=estimates, curves=tuple(map(curve, analysis.curves)), traces=())


def _of_one(e: Estimate, count: int) -> Estimate:
    at = {name: value / count if adds_up(POINT_QUANTITIES.get(name, "")) else value for name, value in e.at.items()}
    if not adds_up(e.quantity):
        return replace(e, at=at)

    def share(value: float | None) -> float | None:
        return None if value is None else value / count

    parts: Mapping[str, Any] = {name: share(value) for name, value in vars(e.parts).items()}
    budget = tuple(replace(source, half=share(source.half)) for source in e.budget)
    return replace(
        e, at=at, value=share(e.value), parts=Parts(**parts), bias=share(e.bias), bound=share(e.bound), budget=budget
    )
