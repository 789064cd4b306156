"""K_u and T_u from a campaign of contractions: its coefficients and its regulator's lag make the loop.

Uses the analysis, no samples. No loop was closed, and no step made, at the set-point itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, sqrt

import numpy as np

from pmabench.base.quantities import show
from pmabench.kinds.ultimate_gain import RESULTS
from pmabench.kinds.ultimate_gain.open_loop import DAMPING
from pmabench.kinds.ultimate_gain.ways import plain_lags
from pmabench.model.curve import Curve
from pmabench.model.loop import SPAN, Loop, loop_at, ultimate
from pmabench.model.muscle import Muscle
from pmabench.model.regulator import Regulator
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts

METHOD = "model"
SYMBOLS = ("F_ce", "K", "B_c", "B_r")
RESPONSE = "regulator-response"
SENSOR, FILTER = "displacement sensor", "filter of the sensor"
FEWEST = 3
"""Fewest pressures for slopes over pressure."""
LEAST = 0.1
"""Smallest value of an extrapolated coefficient, as a share of its last known value."""
KINK = 0.03
"""Error of k_g by a kink, as a share, from which on it is reported."""
NUDGE = 0.1
"""Share of a half width by which an estimate is changed to find its effect."""
TOGETHER = ("calibration", "skew", "drift")
"""Causes with an error common to all estimates, so that their effects are added with sign."""


@dataclass(frozen=True)
class Fitted:
    """The estimates of an analysis from which the loop is made."""

    estimates: tuple[Estimate, ...]
    """Coefficients over pressure, then dead time and lags of the regulator."""
    domain: tuple[float, float]
    """Pressures at which F_ce, K and B_c are known [Pa]."""

    @classmethod
    def of(cls, analysis: Analysis) -> Fitted:
        """The coefficients of the primary method; ValueError with a message where one is missing."""
        primary = analysis.estimates[0].method if analysis.estimates else ""
        known = [
            e
            for e in analysis.estimates
            if e.method == primary and e.symbol in SYMBOLS and set(e.at) == {"pressure"} and e.value is not None
        ]
        pressures = {symbol: {e.at["pressure"] for e in known if e.symbol == symbol} for symbol in SYMBOLS}
        missing = [symbol for symbol in SYMBOLS if not pressures[symbol]]
        if missing:
            raise ValueError(f"the analysis gives no {', '.join(missing)}")
        shared = pressures["F_ce"] & pressures["K"] & pressures["B_c"]
        if len(shared) < FEWEST:
            raise ValueError(
                f"F_ce, K and B_c are known at {len(shared)} pressures together; slopes over pressure need {FEWEST}"
            )
        whole = [e for e in analysis.estimates if e.method == RESPONSE and not e.at and e.value is not None]
        lacking = [name for name in ("dead time", "lag") if all(e.coordinate != name for e in whole)]
        if lacking:
            names = " and no ".join(lacking)
            raise ValueError(f"the analysis gives no {names} of the regulator; process the runs with --regulator")
        return cls((*known, *whole), (min(shared), max(shared)))

    def loop(
        self, values: Sequence[float], x: float, load: float, mass: float, period: float, way: str = ""
    ) -> tuple[float, Loop]:
        """Pressure [Pa] and loop at x [m], `load` [N]; `way` is whose damping counts, `B_c` or `B_r`; or both.

        A displacement sensor that is late has a delay, with the way `FILTER` a filter.
        """
        points: dict[str, list[tuple[float, float]]] = {symbol: [] for symbol in SYMBOLS}
        times = dict.fromkeys(("dead time", "lag", "second lag", SENSOR), 0.0)
        for e, value in zip(self.estimates, values, strict=True):
            if e.symbol in points:
                points[e.symbol].append((e.at["pressure"], value))
            else:
                times[e.coordinate] = value
        chosen = (points[way if way in points and symbol[0] == "B" else symbol] for symbol in SYMBOLS)
        F_ce, K, B_c, B_r = (_through(sorted(known), self.domain) for known in chosen)
        muscle = Muscle(METHOD, F_ce, K, B_c, B_r)
        delay, further = times["dead time"] + times[SENSOR], [times["second lag"]]
        if way == FILTER:
            delay, further = times["dead time"], [*further, times[SENSOR]]
        regulator = Regulator(max(0.0, delay), max(0.0, times["lag"]))
        P, loop = loop_at(muscle, regulator, x, load, self.domain, mass=mass, sample_period=period)
        return P, replace(loop, lags=(*loop.lags, *(lag for lag in further if lag > 0)))

    def bend(self, P: float, x: float, loop: Loop) -> float:
        """Relative error of k_g where F_ce or K may have a kink between the pressures of the campaign [1]."""
        known = {(e.symbol, e.at["pressure"]): e.value or 0.0 for e in self.estimates if e.at}
        F, K = (
            sorted((at, value) for (name, at), value in known.items() if name == symbol and ("K", at) in known)
            for symbol in ("F_ce", "K")
        )
        K_there = float(np.interp(P, *np.array(K).T))
        return hypot(kink(F, P), x * kink(K, P)) / (K_there * loop.gain)


def kink(points: Sequence[tuple[float, float]], P: float) -> float:
    """Error of the slope at P of a curve through points (x, y), x ascending, for a possible kink near P [y/x].

    For a smooth curve the change of slope is similar from point to point. So the difference of a change from its
    neighbours bounds the error of a central slope, and so does the most different slope of the pieces near P.
    """
    x, y = np.array(points).T
    slopes = np.diff(y) / np.diff(x)
    turns = np.concatenate((np.diff(slopes)[:1], np.diff(slopes), np.diff(slopes)[-1:]))
    here = int(np.clip(np.searchsorted(x, P, side="right") - 1, 0, len(slopes) - 1))
    reach = 0.999 * (x[here + 1] - x[here])
    near = [j for j in range(len(slopes)) if x[j] < P + reach and x[j + 1] > P - reach]
    low, high = max(x[0], P - SPAN), min(x[-1], P + SPAN)
    slope = (np.interp(high, x, y) - np.interp(low, x, y)) / (high - low)
    inner = range(max(1, near[0]), min(len(slopes), near[-1] + 1))
    unlike = max((max(abs(turns[k] - turns[k - 1]), abs(turns[k] - turns[k + 1])) for k in inner), default=0.0)
    return float(min(unlike, max(abs(slopes[j] - slope) for j in near)))


def _through(points: list[tuple[float, float]], domain: tuple[float, float]) -> Curve:
    """Straight lines through points by ascending pressure, extrapolated to the ends of the domain."""
    made = list(points)
    for end, place, (near, far) in ((domain[0], 0, (0, 1)), (domain[1], 1, (-1, -2))):
        P, value = points[near]
        if len(points) > 1 and (end < P if near == 0 else end > P):
            slope = (points[far][1] - value) / (points[far][0] - P)
            made.insert(place and len(made), (end, max(value + slope * (end - P), LEAST * value)))
    P_known, values = zip(*made, strict=True)
    return Curve.through(P_known, values)


def by_model(analysis: Analysis, setpoints: Sequence[float], load: float, mass: float, period: float) -> Analysis:
    """K_u [Pa/m] and T_u [s] at each set-point [m] under `load` F_L [N] with a moving `mass` [kg].

    Without set-points, at the rest positions for the campaign's pressures. `period` is the loop's sample period [s],
    half of which is dead time. Intervals follow from those of the coefficients, cause by cause.

    Raises ValueError where the analysis lacks a coefficient, or covers none of the set-points.
    """
    fitted = Fitted.of(analysis)
    values = [float(e.value or 0.0) for e in fitted.estimates]
    estimates, findings, loops, wrong = [], [], [], []
    for x in setpoints or _rests(fitted, load):
        try:
            P, loop = fitted.loop(values, x, load, mass, period)
            ultimate(loop)
        except ValueError as error:
            wrong.append(str(error))
            continue
        at = {"setpoint": x, "load": load} | ({"mass": mass} if mass > 0 else {})
        bend = fitted.bend(P, x, loop)
        estimates += _estimates(fitted, values, (x, load, mass, period), at, bend)
        if bend > KINK:
            where = f"about {show(P, 'pressure', 3)}, at {show(x, 'length', 3)}"
            text = f"F_ce or K has a kink {where}: K_u may be off by {bend:.0%}; test more pressures there"
            findings.append(Finding("doubt", text))
        loops.append({"at": at, "gain": loop.gain, "dead_time": loop.dead_time, "lags": plain_lags(loop)})
    if not loops:
        raise ValueError("; ".join(wrong) or f"nothing rests above 0 mm under {show(load, 'force', 3)}")
    findings += [Finding("doubt", f"{reason}: left out") for reason in wrong]
    findings += _doubts(analysis, fitted, load)
    return replace(
        analysis, kind="ultimate-gain", results=RESULTS, estimates=tuple(estimates), curves=(), dropped=(), traces=(),
        findings=tuple(findings), facts={"loops": loops},
    )  # fmt: skip


def _rests(fitted: Fitted, load: float) -> list[float]:
    """Rest positions of the muscle at the inner pressures of the campaign [m]; at the outer ones there is no slope."""
    known = {(e.symbol, e.at["pressure"]): e.value or 0.0 for e in fitted.estimates if e.at}
    low, high = fitted.domain
    shared = sorted(P for symbol, P in known if symbol == "F_ce" and ("K", P) in known and low < P < high)
    rests = [(known["F_ce", P] - load) / known["K", P] for P in shared]
    return [round(x, 6) for x in rests if x > 0]


def _estimates(
    fitted: Fitted, values: list[float], where: tuple[float, float, float, float], at: dict[str, float], bend: float
) -> list[Estimate]:
    """K_u and T_u at one set-point with their intervals; `bend` is the relative error of k_g by a kink [1]."""

    def pair(changed: Sequence[float], way: str = "") -> tuple[float, float]:
        found = ultimate(fitted.loop(changed, *where, way)[1])
        return found.gain, found.period

    found = pair(values)
    ways = [pair(values, way) for way in ("B_c", "B_r", FILTER)]
    slopes: list[tuple[float, float]] = []
    for i, e in enumerate(fitted.estimates):
        step = NUDGE * (e.parts.combined or 0.0) or 1e-6 * abs(values[i])
        moved = pair([*values[:i], values[i] + step, *values[i + 1 :]])
        slopes.append(((moved[0] - found[0]) / step, (moved[1] - found[1]) / step))
    made = []
    for place, (symbol, unit, quantity) in enumerate((("K_u", "Pa/m", "gain"), ("T_u", "s", "time"))):
        worth: dict[str, float | None] = {}
        for cause in vars(Parts()):
            terms = [(s[place], getattr(e.parts, cause)) for s, e in zip(slopes, fitted.estimates, strict=True)]
            halves = [slope * half for slope, half in terms if half is not None]
            assessed = halves and (cause in TOGETHER or len(halves) == len(terms))
            added = abs(sum(halves)) if cause in TOGETHER else sqrt(sum(h * h for h in halves))
            worth[cause] = added if assessed else None
        damping = DAMPING * abs(ways[0][place] - ways[1][place])
        bent = bend * found[place] if symbol == "K_u" else 0.0
        filtered = abs(ways[2][place] - found[place])
        worth["method"] = hypot(worth["method"] or 0.0, damping, bent, filtered)
        parts = Parts(**worth)  # type: ignore[arg-type]
        n = max(e.n for e in fitted.estimates)
        note = "from coefficients over pressure and the regulator's lag; no loop was closed"
        made.append(Estimate(symbol, found[place], unit, quantity, METHOD, at, parts, n, note=note))
    return made


def _doubts(analysis: Analysis, fitted: Fitted, load: float) -> list[Finding]:
    """Effects that a linear loop does not include, and coefficients that were extrapolated."""
    primary = analysis.estimates[0].method
    friction = next((e for e in analysis.estimates if e.symbol == "F_c" and e.method == primary and not e.at), None)
    said = []
    if friction is not None and friction.value and (friction.ci95 is None or friction.ci95[0] > 0):
        text = f"dry friction of {show(friction.value, 'force', 3)} is no part of the linear loop: small swings stick"
        said.append(Finding("doubt", f"{text}, and a closed loop makes a slower cycle than T_u"))
    relaxing = [e.at["pressure"] for e in fitted.estimates if e.symbol == "B_r"]
    low, high = min(relaxing), max(relaxing)
    if low > fitted.domain[0] or high < fitted.domain[1]:
        ends = f"from {show(low, 'pressure', 4)} to {show(high, 'pressure', 4)}"
        said.append(Finding("note", f"B_r is known {ends}; beyond, it goes on along straight lines"))
    sensor = next((e for e in fitted.estimates if e.coordinate == SENSOR), None)
    if sensor is not None:
        late = show(sensor.value or 0.0, "time", 3)
        said.append(
            Finding("note", f"the loop waits for its displacement sensor, {late}: with a faster one K_u is larger")
        )
    said.append(Finding("note", f"set-points hold for a load of {show(load, 'force', 4)} and its mass"))
    return said
