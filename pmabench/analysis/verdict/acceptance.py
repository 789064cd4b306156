"""Acceptance limits of a protocol: one sentence for each that an analysis exceeds, with limit, value and place.

Limits are read from the plan (`accept`), which may be any file: invalid entries are ignored, and limits that only an
older version judged are not met.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmabench.analysis.verdict.checks import NAMES, checks_of
from pmabench.base.quantities import QUANTITIES, show
from pmabench.store.analyses.results import Analysis, Estimate
from pmabench.store.records import RunData, is_number

MEASURES = {
    "relative_interval": ("±", "+-", ""),
    "of_specimen": ("±", "+-", " of the specimen file"),
    "at_most": ("≤", "at most ", ""),
}
"""Kind of limit -> its sign in a list, its sign in a sentence, and the reference as named in a list."""


@dataclass(frozen=True)
class Limit:
    """One limit: of a coefficient or a check."""

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
        return f"{self.what.replace('_', ' ') if self.measure == 'at_most' else self.what} {sign} {self.size}{of}"

    @property
    def size(self) -> str:
        """The limit as a number with its unit."""
        return f"{100 * self.limit:g} %"


def limits_of(run: RunData) -> list[Limit]:
    """Limits in a run's plan."""
    limits = run.plan.get("accept")
    if not isinstance(limits, Mapping):
        return []
    return [limit for entry in _list(limits.get("limits")) if (limit := _limit(entry)) is not None]


def no_longer_known(run: RunData) -> list[str]:
    """Limits in a run's plan, as text, that an older version judged and this one cannot."""
    accept = run.plan.get("accept")
    if not isinstance(accept, Mapping):
        return []
    named = [(e["what"], e.get("measure")) for e in _list(accept.get("limits"))
             if isinstance(e, Mapping) and isinstance(e.get("what"), str)]  # fmt: skip
    # plans also hold the relative intervals by name beside all limits; the oldest ones hold nothing else
    plain = [what for what, limit in accept.items() if is_number(limit) and what not in {"limits", *dict(named)}]
    removed = [f"{what} {measure}" for what, measure in named if isinstance(measure, str) and measure not in MEASURES]
    return [*removed, *map(str, plain)]


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
    yield from _not_judged(runs, analysis)
    given = {estimate.symbol for estimate in analysis.estimates}
    for limit in _limits(runs, analysis):
        if limit.measure != "relative_interval" or limit.what not in given:
            yield f"{limit.what}: the form of all tests says nothing of it, {limit.asked}"
        else:
            yield from _of_coefficient(analysis, limit, named)


def not_accepted(runs: Sequence[RunData], analysis: Analysis, named: Callable[[Estimate], str]) -> Iterator[str]:
    """One sentence for each limit of the analysis' runs that is exceeded; `named` returns the name of a coefficient.

    Coefficients are those of the first method that gives them; where the specimen file expects no value they are not
    compared with it.
    """
    yield from _not_judged(runs, analysis)
    for limit in _limits(runs, analysis):
        if limit.measure in ("relative_interval", "of_specimen"):
            yield from _of_coefficient(analysis, limit, named)
        elif why := _check(analysis, limit):
            yield why


def _not_judged(runs: Sequence[RunData], analysis: Analysis) -> list[str]:
    unknown = dict.fromkeys(name for run in runs if run.id in analysis.runs for name in no_longer_known(run))
    return [f"{name}: this limit is no longer known, so it is not judged" for name in unknown]


def _limits(runs: Sequence[RunData], analysis: Analysis) -> list[Limit]:
    return list(dict.fromkeys(limit for run in runs if run.id in analysis.runs for limit in limits_of(run)))


def _of_coefficient(analysis: Analysis, limit: Limit, named: Callable[[Estimate], str]) -> Iterator[str]:
    every = [e for e in analysis.estimates if e.symbol == limit.what]
    mine = [e for e in every if e.method == every[0].method and not e.withheld]
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
