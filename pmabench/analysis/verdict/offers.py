"""What one test says of quantities that other kinds of tests measure, too, and what kinds make it of; compares nothing.

Each kind has a function `offers` in its own room, named in its record: a new kind that measures a quantity of another
one is compared with all others from then on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, nan

import numpy as np

from pmabench.analysis.results import Analysis, Estimate, Parts
from pmabench.base.kind import Kind

SAME = 1e-6
"""Contractions nearer to each other are one [m]."""
Place = tuple[float, float | None]
"""Pressure [Pa] and contraction [m]; None for what does not depend on it, NaN for what belongs to no pressure."""
ANYWHERE: Place = (nan, None)
"""Of what holds for the whole campaign."""
At = Callable[[Place], Estimate | None]
Points = Mapping[Place, Estimate]


@dataclass(frozen=True)
class Offer:
    """A quantity as one test knows it: at its own places, and as a function wherever it has one."""

    symbol: str
    """`F`: the mean pull of both directions at rest; `x`: contraction without load; K, B: of both directions; F_c."""
    points: Points
    at: At
    """The value there; None outside of what the test knows."""
    words: str = ""
    """Of the method, where it is not the primary one."""
    side: int = 0
    """1: what others measure is at most this, -1: at least this; 0: it is this."""
    bent: bool = False
    """Whether it changes over contraction, so that a value for a whole stroke is another quantity."""
    rubs: bool = False
    """Whether friction may be in it, to a side that nothing tells: a muscle that is held came there from somewhere."""
    why: str = ""
    """Why it may differ to that side: a sentence."""
    test: str = ""
    """`Kind.word` of the test, which `offers_of` adds."""


def offers_of(analysis: Analysis, kind: Kind | None) -> list[Offer]:
    """All that one analysis of a kind offers."""
    found = kind.part("offers")(analysis) if kind is not None and kind.offers else ()
    return [replace(offer, test=kind.word) for offer in found] if kind is not None else []


def values_of(analysis: Analysis, symbol: str, method: str) -> list[Estimate]:
    """The values of a method at set pressures, without those of single frequencies or terms of curves."""
    return [
        e
        for e in analysis.estimates
        if (e.symbol, e.method, e.coordinate) == (symbol, method, "") and e.value is not None
        if "frequency" not in e.at and "pressure" in e.at
    ]


def at_pressures(analysis: Analysis, symbol: str, method: str) -> dict[float, Estimate]:
    """The same by pressure [Pa]."""
    return {e.at["pressure"]: e for e in values_of(analysis, symbol, method)}


def everywhere(symbol: str, known: Mapping[float, Estimate], words: str = "") -> Offer:
    """An offer at pressures [Pa], at any contraction."""
    return Offer(symbol, {(P, None): e for P, e in known.items()}, lambda place: known.get(place[0]), words)


def anywhere(symbol: str, known: Estimate, words: str = "") -> Offer:
    """An offer of one value for the whole campaign."""
    return Offer(symbol, {ANYWHERE: known}, lambda place: known, words)


def exactly(symbol: str, points: Points, words: str = "") -> Offer:
    """An offer at its places alone; one without a contraction is met at any."""

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
    """A value on the straight line between the neighbours of `at` in `known`, which rises; None outside of them.

    The half width there is at most what those of the neighbours are. Of what may be `bent` between them, even sharply
    as at the end of a dead band, the method part is how far the next straight piece, continued, is from that line.
    """
    places = np.array([place for place, _ in known])
    if len(known) < 2 or not places[0] - SAME <= at <= places[-1] + SAME:
        return known[0][1] if len(known) and abs(places[0] - at) <= SAME else None
    i = int(np.clip(np.searchsorted(places, at), 1, len(known) - 1))
    (low, one), (high, two) = known[i - 1 : i + 1]
    share = (at - low) / (high - low)
    if not 0 < share < 1:
        return one if share <= 0 else two
    value = (1 - share) * (one.value or 0.0) + share * (two.value or 0.0)
    pieces = [pair for pair in (known[max(0, i - 2) : i], known[i : i + 2]) if bent and len(pair) == 2]
    off = min((abs(_along(pair, at) - value) for pair in pieces), default=None if bent else 0.0)
    halves = [e.parts.combined for e in (one, two)]
    whole = None not in halves and off is not None
    half = (1 - share) * (halves[0] or 0.0) + share * (halves[1] or 0.0) if whole else None
    return replace(one, value=value, parts=Parts(repeats=half, method=off), n=min(one.n, two.n))


def _along(pair: Sequence[tuple[float, Estimate]], at: float) -> float:
    """The straight line through two points, at another place."""
    (low, one), (high, two) = pair
    return (one.value or 0.0) + ((two.value or 0.0) - (one.value or 0.0)) * (at - low) / (high - low)


def weighted(pairs: Sequence[tuple[Estimate, float]], symbol: str) -> Estimate:
    """A sum of estimates with weights, otherwise like the first; parts add as squares, as if independent."""
    parts: dict[str, float | None] = {}
    for name in vars(Parts()):
        known = [(getattr(e.parts, name), weight) for e, weight in pairs]
        halves = [abs(weight) * half for half, weight in known if half is not None]
        whole = bool(halves) and (name != "repeats" or len(halves) == len(pairs))
        parts[name] = hypot(*halves) if whole else None
    value = sum(weight * (e.value or 0.0) for e, weight in pairs)
    n = min(e.n for e, _ in pairs)
    found = Parts(**{name: half for name, half in parts.items() if half is not None})
    return replace(pairs[0][0], symbol=symbol, value=value, parts=found, n=n)
