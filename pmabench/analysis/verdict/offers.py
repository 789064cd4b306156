"""What each kind of test says of quantities that other kinds measure, too; compares nothing.

A new kind that measures one of them gets an entry in `OFFERS`, and is compared with all others from then on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from pmabench.analysis.results import Analysis, Estimate, Parts, Trace

STEPS, STATIC, SINES, HELD, ISOBARIC = (
    "contraction-relaxation", "static-load", "sinusoidal-displacement", "isometric-pressurisation", "isobaric-ramp",
)  # fmt: skip
PRIMARY = {
    STEPS: "measured-pressure",
    STATIC: "static-mean",
    SINES: "sine-harmonic",
    HELD: "isometric-sections",
    ISOBARIC: "mean-curve",
}
"""Kind of test -> the method that is compared."""
WORDS = {
    STATIC: "static load",
    SINES: "sine",
    HELD: "isometric",
    ISOBARIC: "isobaric",
    STEPS: "contraction",
}
"""Kind of test -> its name in a comparison; the order is that of naming."""
ASKED = {"joint": "joint fit", "output-error": "output-error fit"}
"""Further methods of contraction tests, which are there only where somebody asked for them, in words."""
PAPER = "contraction-relaxation-paper-1"
"""Kind of contraction tests whose protocol asks for paper 1's way; its first method is the one that it names."""
PAPER_WORDS = "paper 1's way"
SAME = 1e-6
"""Contractions nearer to each other are one [m]."""
STRAIGHT = 0.02
"""Rms of a mean curve about a straight line, as a share of its range, up to which it counts as one."""
Place = tuple[float, float | None]
"""Pressure [Pa] and contraction [m]; None for what does not depend on it."""
At = Callable[[Place], Estimate | None]
Points = Mapping[Place, Estimate]


@dataclass(frozen=True)
class Offer:
    """A quantity as one test knows it: at places of its own, and as a function wherever it has one."""

    symbol: str
    """`F`: the mean pull of both directions at rest; K, B: the mean of both directions, F_c."""
    kind: str
    words: str
    """Of the method, where it is not the primary one."""
    points: Points
    at: At
    """The value there; None outside of what the test knows."""


def offers_of(analysis: Analysis) -> list[Offer]:
    """All that one analysis offers."""
    maker = OFFERS.get(analysis.kind)
    return [] if maker is None else list(maker(analysis))


def values(analysis: Analysis, symbol: str, method: str) -> list[Estimate]:
    """The values of a method at set pressures, without those of single frequencies or terms of curves."""
    return [
        e
        for e in analysis.estimates
        if (e.symbol, e.method, e.coordinate) == (symbol, method, "") and e.value is not None
        if "frequency" not in e.at and "pressure" in e.at
    ]


def at_pressures(analysis: Analysis, symbol: str, method: str) -> dict[float, Estimate]:
    """The same by pressure [Pa]; B of steps is the mean of both directions, which is what a closed motion sees."""
    if symbol != "B" or analysis.kind != STEPS:
        return {e.at["pressure"]: e for e in values(analysis, symbol, method)}
    contracting, relaxing = (at_pressures(analysis, one, method) for one in ("B_c", "B_r"))
    both = {P: (one, relaxing[P]) for P, one in contracting.items() if P in relaxing}
    return {P: _combined([(one, 0.5), (two, 0.5)], "B") for P, (one, two) in both.items()}


def on_line(known: Mapping[float, Estimate], P: float) -> Estimate | None:
    """F_ce of static load at P [Pa], a straight line there, so between its points too; None outside of them.

    The half width between two points is at most what those of the ends are there.
    """
    if P in known:
        return known[P]
    low, high = (max((p for p in known if p < P), default=None), min((p for p in known if p > P), default=None))
    if low is None or high is None:
        return None
    share = (P - low) / (high - low)
    one, two = known[low], known[high]
    halves = [half for half in (one.parts.combined, two.parts.combined) if half is not None]
    half = (1 - share) * halves[0] + share * halves[1] if len(halves) == 2 else None
    value = (1 - share) * (one.value or 0.0) + share * (two.value or 0.0)
    return replace(one, value=value, at={"pressure": P}, parts=Parts(repeats=half))


def _combined(pairs: Sequence[tuple[Estimate, float]], symbol: str) -> Estimate:
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


def _exactly(points: Points) -> At:
    """Only at the places themselves."""

    def at(place: Place) -> Estimate | None:
        P, x = place
        for (P_here, x_here), estimate in points.items():
            if P_here == P and (x_here is None or x is None or abs(x_here - x) <= SAME):
                return estimate
        return None

    return at


def _everywhere(known: Mapping[float, Estimate]) -> At:
    """At its pressures, at any contraction."""
    return lambda place: known.get(place[0])


def _straight(F_ce: Mapping[float, Estimate], K: Mapping[float, Estimate], furthest: float = np.inf) -> At:
    """F_ce - K x [N] at its pressures, as far as the muscle pulls and to `furthest` [m]."""

    def at(place: Place) -> Estimate | None:
        P, x = place
        force, stiffness = F_ce.get(P), K.get(P)
        if x is None or force is None or not -SAME <= x <= furthest + SAME:
            return None
        if abs(x) <= SAME:
            return force
        if stiffness is None or (force.value or 0.0) - (stiffness.value or 0.0) * x < 0:
            return None
        return _combined([(force, 1.0), (stiffness, -x)], "F")

    return at


def _of_steps(analysis: Analysis) -> Iterator[Offer]:
    methods = {PRIMARY[STEPS]: ""} | {m: w for m, w in ASKED.items() if m in {e.method for e in analysis.estimates}}
    for method, words in methods.items():
        F_ce, K, B = (at_pressures(analysis, symbol, method) for symbol in ("F_ce", "K", "B"))
        yield Offer("F", STEPS, words, {(P, 0.0): e for P, e in F_ce.items()}, _straight(F_ce, K))
        for symbol, known in (("K", K), ("B", B)):
            yield Offer(symbol, STEPS, words, {(P, None): e for P, e in known.items()}, _everywhere(known))
        friction = next((e for e in analysis.estimates if (e.symbol, e.method) == ("F_c", method)), None)
        if friction is not None and friction.value is not None and not friction.at:
            yield Offer("F_c", STEPS, words, {}, lambda place, e=friction: e)  # type: ignore[misc]


def _of_paper(analysis: Analysis) -> Iterator[Offer]:
    first = next((e.method for e in analysis.estimates if e.symbol == "K"), "")
    known = at_pressures(analysis, "K", first)
    yield Offer("K", STEPS, PAPER_WORDS, {(P, None): e for P, e in known.items()}, _everywhere(known))


def _of_static(analysis: Analysis) -> Iterator[Offer]:
    known = at_pressures(analysis, "F_ce", PRIMARY[STATIC])

    def at(place: Place) -> Estimate | None:
        return on_line(known, place[0]) if place[1] is not None and abs(place[1]) <= SAME else None

    yield Offer("F", STATIC, "", {(P, 0.0): e for P, e in known.items()}, at)


def _of_sines(analysis: Analysis) -> Iterator[Offer]:
    for symbol in ("K", "B", "F_c"):
        for e in values(analysis, symbol, PRIMARY[SINES]):
            points: Points = {(e.at["pressure"], e.at.get("mean") if symbol == "K" else None): e}
            yield Offer(symbol, SINES, "", points, _exactly(points))
    for symbol in ("F_ce", "F"):
        for e in values(analysis, symbol, "sine-mean"):
            points = {(e.at["pressure"], 0.0 if symbol == "F_ce" else e.at.get("mean")): e}
            yield Offer("F", SINES, "", points, _exactly(points))


def _of_held(analysis: Analysis) -> Iterator[Offer]:
    F_ce, K = (at_pressures(analysis, symbol, PRIMARY[HELD]) for symbol in ("F_ce", "K"))
    furthest = max((e.at["contraction"] for e in analysis.estimates if "contraction" in e.at), default=0.0)
    yield Offer("F", HELD, "", {(P, 0.0): e for P, e in F_ce.items()}, _straight(F_ce, K, furthest))
    yield Offer("K", HELD, "", {(P, None): e for P, e in K.items()}, _everywhere(K))
    blocked: Points = {(e.at["pressure"], 0.0): e for e in values(analysis, "F_b", "blocked")}
    yield Offer("F", HELD, "blocked", blocked, _exactly(blocked))


def _of_ramps(analysis: Analysis) -> Iterator[Offer]:
    local = values(analysis, "F", "mean-curve, local")
    for trace in analysis.traces:
        if trace.figure == "mean-curve" and "pressure" in trace.marks:
            mine = [e for e in local if e.at["pressure"] == trace.marks["pressure"]]
            if mine:
                yield _along(trace, sorted(mine, key=lambda e: e.at["contraction"]))
            if _is_straight(trace):
                every, P_here = at_pressures(analysis, "K", PRIMARY[ISOBARIC]), trace.marks["pressure"]
                known = {P: e for P, e in every.items() if P == P_here}
                yield Offer("K", ISOBARIC, "", {(P, None): e for P, e in known.items()}, _everywhere(known))
    for symbol in ("B", "F_c"):
        known = at_pressures(analysis, symbol, "loop-gap")
        yield Offer(symbol, ISOBARIC, "", {(P, None): e for P, e in known.items()}, _everywhere(known))


def _along(trace: Trace, local: list[Estimate]) -> Offer:
    """The mean curve between the first and the last place where its force has an interval."""
    P = trace.marks["pressure"]
    places = np.array([e.at["contraction"] for e in local])
    halves = np.array([e.parts.combined or np.nan for e in local])

    def at(place: Place) -> Estimate | None:
        if place[1] is None or place[0] != P or not places[0] - SAME <= place[1] <= places[-1] + SAME:
            return None
        value = float(np.interp(place[1], trace.columns["displacement"], trace.columns["force"]))
        half = float(np.interp(place[1], places, halves))
        near = local[int(np.argmin(np.abs(places - place[1])))]
        return replace(near, value=value, parts=Parts() if np.isnan(half) else _scaled(near.parts, half))

    return Offer("F", ISOBARIC, "", {(P, e.at["contraction"]): e for e in local}, at)


def _scaled(parts: Parts, half: float) -> Parts:
    """The parts with a combined half width of `half`."""
    factor = half / (parts.combined or half)
    return Parts(*(None if part is None else part * factor for part in vars(parts).values()))  # type: ignore[arg-type]


def _is_straight(trace: Trace) -> bool:
    x, F = trace.columns["displacement"], trace.columns["force"]
    return len(x) > 2 and float(np.std(F - np.polyval(np.polyfit(x, F, 1), x))) <= STRAIGHT * float(np.ptp(F))


OFFERS: Mapping[str, Callable[[Analysis], Iterator[Offer]]] = {
    STEPS: _of_steps,
    PAPER: _of_paper,
    STATIC: _of_static,
    SINES: _of_sines,
    HELD: _of_held,
    ISOBARIC: _of_ramps,
}
"""Kind of test -> what it offers."""
