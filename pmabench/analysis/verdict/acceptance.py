"""Acceptance limits of a protocol: one sentence for each that an analysis exceeds, with limit, value and place.

Limits are read from the plan (`accept`), which may be any file: invalid entries are ignored.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, inf
from typing import Any

import numpy as np

from pmabench.analysis.verdict.checks import NAMES, checks_of
from pmabench.base.quantities import QUANTITIES, show
from pmabench.store.analyses.results import Analysis, Curve, Estimate
from pmabench.store.records import RunData, is_number

MEASURES = {
    "relative_interval": ("±", "+-", ""),
    "of_specimen": ("±", "+-", " of the specimen file"),
    "of_static": ("±", "+-", " of static F_ce"),
    "of_static_by": ("±", "+-", " of static F_ce"),
    "static_E_n": ("≤", "at most ", " against static F_ce"),
    "at_most": ("≤", "at most ", ""),
    "at_least": ("≥", "at least ", ""),
}
"""Kind of limit -> its sign in a list, its sign in a sentence, and the reference as named in a list."""
Pairs = Mapping[float, tuple[Estimate, Estimate]]
"""Pressure [Pa] -> F_ce of a test and of static load."""


@dataclass(frozen=True)
class Limit:
    """One limit: of a coefficient, a check or R2."""

    what: str
    measure: str
    """A key of `MEASURES`."""
    limit: float
    place: str
    """File and line of the protocol."""
    expected: tuple[tuple[float, float], ...] = ()
    """Pressures [Pa] and values expected by the specimen file [SI]."""
    everywhere: float | None = None
    """Expected value [SI] of a coefficient that does not depend on pressure."""

    @property
    def asked(self) -> str:
        """The limit as text, with its place."""
        place = f" ({self.place})" if self.place else ""
        return f"accepted {MEASURES[self.measure][1]}{self.size}{place}"

    @property
    def short(self) -> str:
        """The limit for a list: `K ± 2 %`, `repeat spread ≤ 3 %`."""
        sign, _, of = MEASURES[self.measure]
        what = f"E_n of {self.what}" if self.measure == "static_E_n" else self.what
        return f"{what.replace('_', ' ') if self.measure == 'at_most' else what} {sign} {self.size}{of}"

    @property
    def size(self) -> str:
        """The limit as a number with its unit."""
        if self.measure == "of_static_by":
            return show(self.limit, "force", 4)
        return f"{self.limit:g}" if self.measure in ("at_least", "static_E_n") else f"{100 * self.limit:g} %"


def limits_of(run: RunData) -> list[Limit]:
    """Limits in a run's plan; older plans only have the widest interval of each coefficient."""
    limits = run.plan.get("accept")
    if not isinstance(limits, Mapping):
        return []
    found = [limit for entry in _list(limits.get("limits")) if (limit := _limit(entry)) is not None]
    known = {limit.what for limit in found if limit.measure == "relative_interval"}
    found += [
        Limit(str(name), "relative_interval", float(widest), "")
        for name, widest in limits.items()
        if name not in known and is_number(widest)
    ]
    return found


def _list(value: Any) -> Iterable[Any]:
    return value if isinstance(value, list | tuple) else ()


def _limit(entry: Any) -> Limit | None:
    if not isinstance(entry, Mapping):
        return None
    limit: Any
    what, measure, limit, place, expected = (
        entry.get(name) for name in ("what", "measure", "limit", "place", "expected")
    )
    if not isinstance(what, str) or not isinstance(measure, str) or measure not in MEASURES or not is_number(limit):
        return None
    everywhere = float(expected) if isinstance(expected, int | float) else None
    pairs = [point for point in _list(expected) if isinstance(point, list | tuple) and len(point) == 2]
    points = tuple((float(P), float(value)) for P, value in pairs if is_number(P) and is_number(value))
    return Limit(what, measure, float(limit), str(place or ""), points, everywhere)


def not_accepted_as_form(
    runs: Sequence[RunData], analysis: Analysis, named: Callable[[Estimate], str]
) -> Iterator[str]:
    """As `not_accepted`, for a form of all tests: its intervals are judged, and any other limit counts as exceeded."""
    given = {estimate.symbol for estimate in analysis.estimates}
    for limit in _limits(runs, analysis):
        if limit.measure != "relative_interval" or limit.what not in given:
            yield f"{limit.what}: the form of all tests says nothing of it, {limit.asked}"
        else:
            yield from _of_coefficient(analysis, limit, named)


def not_accepted(
    runs: Sequence[RunData], analysis: Analysis, named: Callable[[Estimate], str], static: Pairs | None = None
) -> Iterator[str]:
    """One sentence for each limit of the analysis' runs that is exceeded; `named` returns the name of a coefficient.

    Coefficients are those of the first method that gives them; where the specimen file expects no value they are not
    compared with it. `static` holds F_ce of this test and of the specimen's static-load test; None without that.
    """
    for limit in _limits(runs, analysis):
        if limit.measure in ("relative_interval", "of_specimen"):
            yield from _of_coefficient(analysis, limit, named)
        elif limit.measure in ("of_static", "of_static_by", "static_E_n"):
            yield from _against_static(static, limit, named)
        elif limit.measure == "at_least":
            yield from _r2(analysis, limit, _primary(analysis))
        elif why := _check(analysis, limit):
            yield why


def _limits(runs: Sequence[RunData], analysis: Analysis) -> list[Limit]:
    return list(dict.fromkeys(limit for run in runs if run.id in analysis.runs for limit in limits_of(run)))


def _primary(analysis: Analysis) -> dict[str, str]:
    """Symbol -> first method that gives it."""
    primary: dict[str, str] = {}
    for estimate in analysis.estimates:
        primary.setdefault(estimate.symbol, estimate.method)
    return primary


def _of_coefficient(analysis: Analysis, limit: Limit, named: Callable[[Estimate], str]) -> Iterator[str]:
    primary = _primary(analysis)
    mine = [
        e for e in analysis.estimates if e.symbol == limit.what and e.method == primary[e.symbol] and not e.withheld
    ]
    judge = _interval if limit.measure == "relative_interval" else _of_specimen
    known = any(e.value is not None for e in mine)
    for estimate in mine:
        if not estimate.coordinate and (why := judge(estimate, limit, known=known)):
            yield f"{named(estimate)}: {why}"


def _interval(e: Estimate, limit: Limit, *, known: bool) -> str:
    half = e.parts.combined
    if e.value is None or not e.value:
        return "" if known else f"not identifiable, {limit.asked}"
    if half is None:
        return f"no interval, {limit.asked}; {e.note}"
    wide = half > limit.limit * abs(e.value)
    return f"interval +-{_percent(half / abs(e.value))} %, {limit.asked}" if wide else ""


def _of_specimen(e: Estimate, limit: Limit, *, known: bool) -> str:
    if e.value is None:
        return "" if known else f"not identifiable, {limit.asked} of the specimen file"
    expected = _expected(limit, e.at.get("pressure"))
    off = e.value / expected - 1.0 if expected else 0.0
    if not expected or abs(off) <= limit.limit:
        return ""
    half = e.parts.combined
    value, reference = (show(v, e.quantity, 4) if e.quantity in QUANTITIES else f"{v:.4g}" for v in (e.value, expected))
    within = half is not None and abs(e.value - expected) - half <= limit.limit * abs(expected)
    unsure = "; its interval reaches into what is accepted" if within else ""
    size, where = _percent(abs(off)), "above" if off > 0 else "below"
    return f"{value} is {size} % {where} the specimen file's {reference}, {limit.asked}{unsure}"


def _expected(limit: Limit, pressure: float | None) -> float | None:
    """Value expected by the specimen file, interpolated over pressure [Pa]; None outside its points."""
    if limit.everywhere is not None or not limit.expected:
        return limit.everywhere
    P, values = (np.array(column) for column in zip(*sorted(limit.expected), strict=True))
    if pressure is None or not P[0] - 1.0 <= pressure <= P[-1] + 1.0:
        return None
    return float(np.interp(pressure, P, values))


def _against_static(pairs: Pairs | None, limit: Limit, named: Callable[[Estimate], str]) -> Iterator[str]:
    """Limits of F_ce against static load, at every common pressure."""
    lack = ""
    if pairs is None:
        lack = f"no static-load test of this specimen to compare with, {limit.asked}; process both runs together"
    elif not pairs:
        lack = f"the two tests give F_ce at no pressure in common, {limit.asked}; "
        lack += "loads of the static test around F_ce at the tested pressures would"
    if lack:
        yield f"F_ce against static load: {lack}"
    for mine, theirs in (pairs or {}).values():
        if why := _apart(mine, theirs, limit):
            yield f"{named(mine)}: {why}"


def _apart(mine: Estimate, theirs: Estimate, limit: Limit) -> str:
    value, reference = mine.value or 0.0, theirs.value or 0.0
    off, halves = value - reference, [e.parts.combined for e in (mine, theirs)]
    compared = f"{show(value, 'force', 4)} against {show(reference, 'force', 4)} of static load"
    if limit.measure == "static_E_n":
        if halves[0] is None or halves[1] is None:
            which = "neither has an" if halves == [None, None] else "one has no"
            return f"{compared}: {which} interval, E_n {limit.asked}"
        half = hypot(halves[0], halves[1])
        score = abs(off) / half if half else (0.0 if off == 0 else inf)
        return "" if score <= limit.limit else f"{compared}: E_n {score:.3g}, {limit.asked}"
    relative = limit.measure == "of_static"
    if abs(off) <= limit.limit * (abs(reference) if relative else 1.0):
        return ""
    far = f"{100 * abs(off / reference):.3g} %" if relative and reference else show(abs(off), "force", 3)
    return f"{compared}: {far} {'above' if off > 0 else 'below'}, {limit.asked}"


def _r2(analysis: Analysis, limit: Limit, primary: Mapping[str, str]) -> Iterator[str]:
    """Limit of R2 over pressure, for the best curve of each coefficient."""
    best: dict[str, Curve] = {}
    for curve in analysis.curves:
        before = best.get(curve.symbol)
        if curve.method == primary.get(curve.symbol, curve.method) and not (before and before.r2 >= curve.r2):
            best[curve.symbol] = curve
    if not best:
        yield f"R2: there is no curve over pressure, {limit.asked}"
    for symbol, curve in best.items():
        if not curve.r2 >= limit.limit:
            yield f"R2 of {symbol} over pressure ({curve.form}): {curve.r2:.4g}, {limit.asked}"


def _check(analysis: Analysis, limit: Limit) -> str:
    words = limit.what.replace("_", " ")
    check = next((check for check in checks_of(analysis) if check.name == limit.what), None)
    if check is None:
        meant = NAMES.get(limit.what, words)
        return f"{words}: not known, {limit.asked}; it is the {meant}, and needs repeats or loads"
    return "" if abs(check.value) <= limit.limit else f"{words}: {_percent(check.value)} %, {limit.asked}"


def _percent(share: float) -> str:
    """A share in %, without the sign, to two significant digits below 10."""
    size = 100 * share
    return f"{size:.2g}" if abs(size) < 10 else f"{size:.0f}"
