"""Comparison of two analyses by coefficient: difference, its 95 % interval, E_n number; changes by a recalibration.

E_n = (a - b) / sqrt(U_a^2 + U_b^2) with the 95 % half widths U (ISO/IEC 17043): values agree where |E_n| <= 1, which
correct ones exceed about once in twenty. b is the reference.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot
from typing import Any

from pmabench.analysis.shared.calibration import NOT_DECLARED
from pmabench.analysis.shared.trials import Point, grouped, six_digits
from pmabench.analysis.verdict import agreement
from pmabench.base.errors import UsageError
from pmabench.base.quantities import QUANTITIES, show
from pmabench.store.analyses.results import POINT_QUANTITIES, Analysis, Estimate, Finding


@dataclass(frozen=True)
class Change:
    """One coefficient before and after; None on a side that does not have it."""

    kind: str
    runs: tuple[str, ...]
    before: Estimate | None
    after: Estimate | None

    @property
    def estimate(self) -> Estimate:
        """The estimate after, or before where that is missing."""
        found = self.after or self.before
        assert found is not None  # noqa: S101
        return found

    @property
    def difference(self) -> float | None:
        """After minus before [SI]; None where one of them has no value."""
        if self.before is None or self.after is None or self.before.value is None or self.after.value is None:
            return None
        return self.after.value - self.before.value

    @property
    def half_width(self) -> float | None:
        """95 % half width of the difference [SI]; None where a calibration part is not known.

        Both values are from the same samples, so repeats and method cancel. The two calibrations are taken as
        independent; where both use one reference the half width is smaller.
        """
        if self.difference is None or self.before is None or self.after is None:
            return None
        one, other = self.before.parts.calibration, self.after.parts.calibration
        return None if one is None or other is None else hypot(one, other)

    def to_dict(self) -> dict[str, Any]:
        """The change as its documented JSON object."""
        e = self.estimate
        return {
            "kind": self.kind,
            **{name: getattr(e, name) for name in ("symbol", "coordinate")},
            "at": dict(e.at),
            **{name: getattr(e, name) for name in ("method", "unit", "quantity")},
            "before": _side(self.before),
            "after": _side(self.after),
            "difference": self.difference,
            "half_width": self.half_width,
        }


def _side(estimate: Estimate | None) -> dict[str, Any] | None:
    if estimate is None:
        return None
    ends = estimate.ci95
    return {"value": estimate.value, "ci95": None if ends is None else list(ends), "note": estimate.note}


def changes(before: Sequence[Analysis], after: Sequence[Analysis]) -> list[Change]:
    """Changes of all coefficients of either side, in the order of `after`, then those that only `before` has.

    Analyses are matched by kind and runs, coefficients by symbol, method and operating point to 1e-6. Measured points
    may differ by more, so the remaining coefficients are matched in their order.
    """
    found: list[Change] = []
    sides = {(analysis.kind, analysis.runs): analysis.estimates for analysis in before}
    for analysis in after:
        left = list(sides.pop((analysis.kind, analysis.runs), ()))
        pairs = [(estimate, _take(left, estimate)) for estimate in analysis.estimates]
        found += [
            Change(analysis.kind, analysis.runs, other or _take(left, estimate, exact=False), estimate)
            for estimate, other in pairs
        ]
        found += [Change(analysis.kind, analysis.runs, other, None) for other in left]
    found += [Change(kind, runs, other, None) for (kind, runs), estimates in sides.items() for other in estimates]
    return found


def _take(left: list[Estimate], estimate: Estimate, *, exact: bool = True) -> Estimate | None:
    """Remove the estimate of the same coefficient from `left` and return it; None where there is none."""

    def what(e: Estimate) -> tuple[object, ...]:
        return e.symbol, e.coordinate, e.method, tuple(e.at)

    for index, other in enumerate(left):
        near = not exact or all(abs(other.at.get(k, v) - v) <= 1e-6 * abs(v) for k, v in estimate.at.items())
        if what(other) == what(estimate) and near:
            return left.pop(index)
    return None


MOST_PLACES = 4
"""Most points that are named in a finding on what could not be compared."""
CHANCE = 0.05
"""Share of correct values that lie outside their intervals."""
SESSION = "session"
"""Name of the session among the calibrations of a side; zeros are taken in a session."""
NO_SCALE = ("time", "frequency")
"""Quantities that do not depend on the calibration of a channel."""

Series = tuple[str, str, str, tuple[str, ...]]
"""Kind of test, symbol, coordinate, and names of the entries of its operating points."""


@dataclass(frozen=True)
class Side:
    """One of the two sides of a comparison."""

    name: str
    """Name in texts: A, B, a method, a label."""
    analyses: tuple[Analysis, ...]
    about: str = ""
    """Its origin as text: folder, bench, days."""
    calibrations: frozenset[tuple[str, str]] | None = None
    """Name and hash of the runs' calibrations; None where the runs are not available."""
    published: bool = False
    """Whether values are from another source, which gives no interval."""

    @property
    def runs(self) -> set[str]:
        """Ids of all runs."""
        return {run for analysis in self.analyses for run in analysis.runs}

    @property
    def simulated(self) -> bool:
        """Whether any of its analyses is of simulated runs."""
        return any(analysis.simulated for analysis in self.analyses)


@dataclass(frozen=True)
class Difference:
    """One coefficient at one operating point on both sides, a - b [SI]."""

    kind: str
    a: Estimate
    b: Estimate
    half: float | None
    """95 % half width of the difference; None unless both sides have an interval."""
    between: str = ""
    """Sides that were interpolated between two of their points: `a`, `b`, `ab` or none."""
    lacks: tuple[str, ...] = ()
    """Names of the sides whose interval does not contain the uncertainty of their calibrations."""

    @property
    def value(self) -> float:
        """The difference a - b [SI]."""
        return (self.a.value or 0.0) - (self.b.value or 0.0)

    @property
    def relative(self) -> float | None:
        """(a - b) / |b|; None where b is 0."""
        return self.value / abs(self.b.value) if self.b.value else None

    @property
    def score(self) -> float | None:
        """E_n; None where one side has no interval, or both have zero width."""
        return self.value / self.half if self.half else None

    @property
    def agrees(self) -> bool | None:
        """Whether |E_n| <= 1; None without E_n."""
        return None if self.score is None else abs(self.score) <= 1.0


@dataclass(frozen=True)
class Comparison:
    """Result of `compare`."""

    differences: tuple[Difference, ...]
    findings: tuple[Finding, ...]


def compare(
    a: Side, b: Side, methods: tuple[str, str | None] | None = None, pressures: Sequence[float] | None = None
) -> Comparison:
    """Differences of all coefficients that both sides have.

    The method is the first one of each symbol on each side, or `methods` of a and b. Tests of the same kind are
    compared; where no kind is on both sides, tests of different kinds. Values over pressure are compared at common
    pressures [Pa], or at those of b where it is published. Without common ones, or at `pressures`, a side without a
    value is interpolated linearly. Raises UsageError where nothing can be compared.
    """
    left, right = _series(a, methods and methods[0]), _series(b, methods and methods[1])
    differences: list[Difference] = []
    missing: list[str] = []
    for one, other in _pairs(left, right):
        found, lacks = _compared(one, left[one], right[other], a, b, pressures)
        differences += found
        missing += [f"{_name(one[1:3])} {lack}" for lack in lacks]
    if not differences:
        more = f"; {'; '.join(missing)}" if missing else ""
        held = " and ".join(f"{side.name} holds {_held(_series(side, None))}" for side in (a, b))
        raise UsageError(f"{a.name} and {b.name} have no coefficient in common that could be compared: {held}{more}")
    return Comparison(tuple(differences), tuple(_findings(a, b, differences, missing)))


def not_accepted(differences: Iterable[Difference], measure: str, limit: float) -> list[str]:
    """A sentence for each difference above the limit or without a size; `measure` is `E_n` or `difference` [1]."""
    failed = []
    by_E_n = measure == "E_n"
    asked = f"accepted {limit:g}" if by_E_n else f"accepted {100 * limit:g} %"
    lack = "no E_n: it needs an interval of both" if by_E_n else "no relative difference: the reference is 0"
    for d in differences:
        size = d.score if by_E_n else d.relative
        if size is None:
            failed.append(f"{named(d)}: {lack}, {asked}")
        elif abs(size) > limit:
            measured = f"E_n {size:+.2f}" if by_E_n else f"difference {percent(size)} %"
            failed.append(f"{named(d)}: {measured}, {asked}")
    return failed


def named(d: Difference) -> str:
    """Coefficient and operating point as text: `K at 300 kPa`."""
    where = _where(d.a.at)
    return f"{_name((d.a.symbol, d.a.coordinate))}{f' at {where}' if where else ''}"


def percent(share: float) -> str:
    """A share in % with sign and two digits: `+4.2`, `-67`, `+240`."""
    size = abs(100 * share)
    return f"{100 * share:+.0f}" if 10 <= size < 1e5 else f"{100 * share:+.2g}"


def _name(series: tuple[str, ...]) -> str:
    return " ".join(part for part in series if part)


def _where(at: Mapping[str, float]) -> str:
    places = {
        name: show(value, POINT_QUANTITIES[name]) if name in POINT_QUANTITIES else f"{value:g}"
        for name, value in at.items()
        if name != "mass"
    }
    only = set(at) == {"pressure"}
    return ", ".join(text if only else f"{name} {text}" for name, text in places.items())


def _held(series: Iterable[Series]) -> str:
    return ", ".join(dict.fromkeys(_name(one[1:3]) for one in series)) or "no value"


def _series(side: Side, method: str | None) -> dict[Series, dict[Point, Estimate]]:
    """Series -> values by operating point, of one method; raises UsageError if ambiguous."""
    found: dict[Series, dict[Point, Estimate]] = {}
    kinds = [analysis.kind for analysis in side.analyses]
    twice = next((kind for kind in kinds if kinds.count(kind) > 1), None)
    if twice is not None:
        raise UsageError(f"{side.name} holds several analyses of {twice}; give one of their folders")
    known = list(dict.fromkeys(e.method for analysis in side.analyses for e in analysis.estimates))
    if method is not None and method not in known:
        raise UsageError(f'{side.name} has no method "{method}"; it has {", ".join(known) or "none"}')
    for analysis in side.analyses:
        chosen: dict[tuple[str, str], str] = {}
        for e in analysis.estimates:
            if chosen.setdefault((e.symbol, e.coordinate), method or e.method) == e.method:
                place = six_digits(e.at, "mass")
                series = (analysis.kind, e.symbol, e.coordinate, tuple(name for name, _ in place))
                found.setdefault(series, {}).setdefault(place, e)
    return found


def _pairs(left: Mapping[Series, object], right: Mapping[Series, object]) -> Iterator[tuple[Series, Series]]:
    """Pairs of series to compare: the same on both sides, else the same symbol of other kinds of test."""
    common = {series[0] for series in left} & {series[0] for series in right}
    for series in left:
        if series in right:
            yield series, series
        elif not common:
            yield from ((series, other) for other in right if other[1:] == series[1:])


def _compared(
    series: Series,
    ours: Mapping[Point, Estimate],
    theirs: Mapping[Point, Estimate],
    a: Side,
    b: Side,
    pressures: Sequence[float] | None,
) -> tuple[list[Difference], list[str]]:
    """Differences of one series at its operating points, and texts on what could not be compared."""
    places = dict.fromkeys((*ours, *theirs))
    asked = [(("pressure", float(f"{P:.6g}")),) for P in pressures or ()]
    over = series[3] == ("pressure",)
    common = [place for place in places if place in ours and place in theirs]
    if asked and over:
        places = dict.fromkeys(asked)
    elif b.published:
        places = dict.fromkeys(theirs)
    elif common:
        places = dict.fromkeys(common)
    shared = _shared(a, b)
    found, lacks = [], dict[str, list[str]]()
    for place in sorted(places):
        one, other = ours.get(place), theirs.get(place)
        between = ""
        if over and one is None:
            one, between = _on_line(ours, place[0][1]), "a"
        if over and other is None:
            other, between = _on_line(theirs, place[0][1]), f"{between}b"
        lack = _lack(one, a.name) or _lack(other, b.name)
        if lack or one is None or other is None:
            lacks.setdefault(lack, []).append(_where(dict(place)))
        elif one.unit != other.unit:
            lacks.setdefault(f"is given in {one.unit} and in {other.unit}", []).append("")
        else:
            sides = () if shared else ((a, one), (b, other))
            lacking = tuple(side.name for side, e in sides if _without_scale(e) and not side.published)
            found.append(Difference(series[0], one, other, _half(one, other, shared=shared), between, lacking))
    return found, [_at_places(lack, where) for lack, where in lacks.items()]


def _shared(a: Side, b: Side) -> bool:
    """Whether both sides have one scale and zero of each channel: those of the same runs, or of one session.

    A recalibration is compared, too: runs keep the calibrations with which they were recorded.
    """
    files = a.calibrations == b.calibrations and any(name == SESSION for name, _ in a.calibrations or ())
    anew = [[analysis.facts.get("recalibrated") for analysis in side.analyses] for side in (a, b)]
    return (files or a.runs == b.runs) and anew[0] == anew[1]


def _without_scale(e: Estimate) -> bool:
    """Whether the interval has no calibration part, or one that lacks a relevant channel."""
    if e.quantity in NO_SCALE:
        return False
    lines = [s.half for s in e.budget if s.part == "calibration"]
    return e.parts.calibration is None or None in lines or NOT_DECLARED in e.note


def _lack(e: Estimate | None, name: str) -> str:
    if e is None:
        return f"has no value in {name}"
    return f"is not identifiable in {name}" if e.value is None else ""


def _at_places(lack: str, places: Sequence[str]) -> str:
    known = [place for place in places if place]
    more = f" and {len(known) - MOST_PLACES} more" if len(known) > MOST_PLACES else ""
    return f"{lack} at {', '.join(known[:MOST_PLACES])}{more}" if known else lack


def _on_line(values: Mapping[Point, Estimate], P: float) -> Estimate | None:
    """Value at pressure P [Pa], interpolated between neighbours with the bend that further ones show; None outside."""
    known = sorted(((place[0][1], e) for place, e in values.items() if e.value is not None), key=lambda one: one[0])
    found = agreement.between(known, P, bent=True)
    return found and replace(found, at={"pressure": P})


def _half(one: Estimate, other: Estimate, *, shared: bool) -> float | None:
    """Half width of the difference: root of the sum of squares; None where one side has no interval.

    With one method, `shared` calibrations count by their difference.
    """
    if one.parts.combined is None or other.parts.combined is None:
        return None
    scales = [e.parts.calibration for e in (one, other)]
    if not shared or one.method != other.method or None in scales:
        return hypot(one.parts.combined, other.parts.combined)
    alone = [replace(e.parts, calibration=None).combined or 0.0 for e in (one, other)]
    return hypot(*alone, (scales[0] or 0.0) - (scales[1] or 0.0))


def _findings(a: Side, b: Side, differences: Sequence[Difference], missing: Sequence[str]) -> Iterator[Finding]:
    judged = [d for d in differences if d.agrees is not None]
    if len(judged) > 1:
        chance = CHANCE * len(judged)
        by_chance = f"about {chance:.0f}" if chance >= 1 else "less than one"
        beyond = sum(not d.agrees for d in judged)
        agree = "" if beyond else f"{a.name} and {b.name} agree: "
        text = f"{agree}{beyond} of {len(judged)} differences are larger than their 95 % interval"
        yield Finding(
            "note", f"{text}; of two that are the same {by_chance} would be, where the values are independent"
        )
    groups = grouped(differences, lambda d: (d.kind, d.a.symbol, d.a.coordinate, tuple(d.a.at)))
    names = Counter(key[:3] for key in groups)
    for (kind, symbol, coordinate, at), group in groups.items():
        yield _sentence(group, whole=not at and names[kind, symbol, coordinate] > 1)
    yield from (Finding("note", f"not compared: {text}") for text in missing)
    yield from _cautions(a, b, differences)


def _cautions(a: Side, b: Side, differences: Sequence[Difference]) -> Iterator[Finding]:
    """Findings on effects that E_n does not take into account."""
    bare = [d for d in differences if d.half is None]
    if bare and b.published:
        known = [d for d in bare if d.a.parts.combined is not None]
        inside = sum(abs(d.value) <= (d.a.parts.combined or 0.0) for d in known)
        text = f"no E_n: {b.name} gives no uncertainty, and E_n needs that of both sides"
        of_a = f"; {inside} of its {len(known)} values lie in the interval of {a.name}" if known else ""
        yield Finding("note", f"{text}{of_a}")
    elif bare:
        more = f" (and {len(bare) - 1} more)" if len(bare) > 1 else ""
        yield Finding("doubt", f"{named(bare[0])}{more} has no interval on one side: no E_n, which needs both")
    apart = [d for d in differences if d.agrees is False and d.lacks]
    if apart:
        names = " and ".join(dict.fromkeys(name for d in apart for name in d.lacks))
        yield Finding(
            "doubt",
            f"{len(apart)} of these differences are more than scatter, but how far the channels' scales are off is not "
            f"declared, or not in full, in {names}: a force cell or gauge that reads otherwise makes them as well as "
            "another muscle. Calibrate, and state expanded_uncertainty and gain_uncertainty, to tell the two apart",
        )
    if any(d.between for d in differences):
        yield Finding("note", "values marked ~ are read on lines between points; a third one shows how far these bend")
    if a.runs & b.runs:
        yield Finding("note", "both come from the same runs and share their scatter: E_n shows less than there is")
    elif not b.published:
        drops = "; the calibrations, which both used, drop out" if _shared(a, b) else ""
        yield Finding("note", f"errors that both share count in both: E_n shows less than there is{drops}")
    if a.simulated != b.simulated and not b.published:
        yield Finding("note", f"{(a if a.simulated else b).name} is SIMULATED, the other is not")


def _sentence(group: Sequence[Difference], *, whole: bool) -> Finding:
    """Finding for all points of one coefficient: how many agree, and where the difference is largest.

    `whole`: whether it is the value of all points together, of a coefficient that also has values at each point.
    """
    worst = max(group, key=lambda d: abs(d.score) if d.score is not None else abs(d.relative or 0.0))
    symbol, at = _name((worst.a.symbol, worst.a.coordinate)) + ", of all points" * whole, _where(worst.a.at)
    judged = [d for d in group if d.agrees is not None]
    beyond = sum(not d.agrees for d in judged)
    relative = "" if worst.relative is None else f" ({percent(worst.relative)} %)"
    value = (
        show(worst.value, worst.a.quantity, 3)
        if worst.a.quantity in QUANTITIES
        else f"{worst.value:.3g} {worst.a.unit}"
    )
    score = "" if worst.score is None else f", E_n {worst.score:+.2f}"
    size = f"{'+' if worst.value > 0 else ''}{value}{relative}{score}"
    place = f"at {at}: " if at else ""
    furthest = f"furthest apart {place}{size}" if len(group) > 1 else f"{place}difference {size}"
    if not judged:
        return Finding("note", f"{symbol}: {furthest}; without both intervals nobody knows if that is more than chance")
    if not beyond:
        points = "both points" if len(judged) == 2 else f"all {len(judged)} points"
        agree = "agree within their interval" if len(group) == 1 else f"agree at {points}"
        return Finding("note", f"{symbol}: {agree}; {furthest}")
    where = "" if len(group) == 1 else f" at {beyond} of {len(judged)} points"
    sides = " and ".join(dict.fromkeys(name for d in judged if not d.agrees for name in d.lacks))
    scales = f"; the interval is without the scales of {sides}" if sides else ""
    return Finding("doubt", f"{symbol}: differ by more than their interval{where}; {furthest}{scales}")
