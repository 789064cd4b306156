"""Data of an analysis: estimates with the parts of their intervals, curves, dropped cells, findings, traces to plot.

Everything is SI and plain data; `to_dict` is the documented JSON. Nothing here computes an estimate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from math import isfinite, nan, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import UsageError
from pmabench.base.kind import Result
from pmabench.base.quantities import QUANTITIES, show
from pmabench.store.records import RunData

SCHEMA = "pmabench.analysis/1"
POINT_QUANTITIES = {
    "pressure": "pressure",
    "pressure_1": "pressure",
    "pressure_2": "pressure",
    "from": "pressure",
    "contraction": "length",
    "setpoint": "length",
    "mean": "length",
    "amplitude": "length",
    "frequency": "frequency",
    "speed": "speed",
    "start": "length",
    "step": "length",
    "lower": "length",
    "upper": "length",
    "load": "force",
    "bias": "pressure",
    "mass": "mass",
    "tip_mass": "mass",
    "displacement": "length",
    "angle": "angle",
    "goal": "angle",
    "lowest_angle": "angle",
    "highest_angle": "angle",
    "angular_speed": "angular speed",
    "phi": "angle",
    "psi": "angle",
    "integral": "angular integral gain",
    "cycles": "count",
    "side": "count",
}
"""Name of a coordinate of an operating point -> its quantity, in the order of table columns."""

NEVER_0 = ("stiffness", "gain", "frequency")
"""Quantities whose results, if declared positive, are never 0; friction, damping and times may be 0."""


@dataclass(frozen=True)
class Parts:
    """Half widths of the 95 % interval by cause; None where a cause was not assessed, 0 where it has no effect."""

    repeats: float | None = None
    """Scatter between trials."""
    method: float | None = None
    """Contribution of the estimator itself, found by replay of the fitted plant."""
    calibration: float | None = None
    """From the calibration files of the channels."""
    skew: float = 0.0
    """Effect of the possible time offset between streams; 0 if all channels share a clock."""
    drift: float = 0.0
    """Effect of drift of the specimen and of the zeros; 0 where no drift is found."""

    @property
    def combined(self) -> float | None:
        """Root sum of squares of the assessed parts; None without `repeats`: the others alone make no interval."""
        if self.repeats is None:
            return None
        return sqrt(sum(p * p for p in vars(self).values() if p is not None))

    def times(self, factor: float) -> Parts:
        """The parts for a value multiplied by `factor`."""
        halves: dict[str, Any] = {n: None if half is None else abs(factor) * half for n, half in vars(self).items()}
        return Parts(**halves)


@dataclass(frozen=True)
class Source:
    """One line of the uncertainty budget of an estimate, in the sense of the GUM (JCGM 100, 5.1).

    The root sum of squares of the half widths of one part is that part of `Parts`, over the whole budget it is
    `Parts.combined`. A share is half^2 / combined^2.
    """

    name: str
    """Name of the source, for instance `calibration of pressure, offset`."""
    part: str
    """The field of `Parts` that it belongs to."""
    kind: str
    """`A`, from the scatter of measurements, or `B`, from other knowledge."""
    half: float | None
    """Half width of the 95 % interval, in the unit of the estimate; None: not assessed, `note` says why."""
    note: str = ""


@dataclass(frozen=True)
class Estimate:
    """One coefficient: a value with unit, interval and parents, or the reason why there is none."""

    symbol: str
    """Symbol as in the literature: F_ce, K, B_c, B_r, F_c, t_d, K_u, T_u ..."""
    value: float | None
    """None: not identifiable; `note` says why."""
    unit: str
    quantity: str
    """Key of `QUANTITIES`, for display units."""
    method: str
    at: Mapping[str, float] = field(default_factory=dict)
    """Operating point [SI], for instance {"pressure": 3e5} or {"frequency": 0.5}; empty for the whole campaign."""
    parts: Parts = field(default_factory=Parts)
    n: int = 0
    """Number of trials behind it."""
    bias: float | None = None
    """Bias of the estimator found by replay; already subtracted from `value` if `corrected`."""
    corrected: bool = False
    note: str = ""
    trials: tuple[str, ...] = ()
    """Parents, as `run/index`."""
    coordinate: str = ""
    """For a coefficient of a curve: its name, for instance `slope`; else empty."""
    budget: tuple[Source, ...] = ()
    """Its uncertainty by source, largest first; empty where only the parts are known."""
    withheld: bool = False
    """The data contradict the assumptions behind the value: it is not reported, and `note` states why."""
    positive: bool = False
    """Whether it cannot be below 0; set by `Analysis` from the declared results."""
    bound: float | None = None
    """Upper bound of its magnitude where there is no value [unit of the value]; None where not known."""

    def __post_init__(self) -> None:
        """Drop a value that is not finite, and the interval where one of its parts is not finite."""
        if self.value is not None and not isfinite(self.value):
            self._lacks("no finite number came out", value=None, bias=None, corrected=False)
        elif not all(part is None or isfinite(part) for part in vars(self.parts).values()):
            self._lacks("no interval: one of its parts has no bound")

    def _lacks(self, why: str, **instead: Any) -> None:
        instead |= {"parts": Parts(), "budget": (), "note": f"{self.note}; {why}".removeprefix("; ")}
        for name, value in instead.items():
            object.__setattr__(self, name, value)

    @property
    def shares(self) -> tuple[float | None, ...]:
        """Share of the combined variance of each line of the budget [1]; None for a line that was not assessed."""
        total = (self.parts.combined or 0.0) ** 2
        return tuple(None if s.half is None else s.half**2 / total if total else 0.0 for s in self.budget)

    @property
    def ci95(self) -> tuple[float, float] | None:
        """The 95 % interval (low, high) from all parts; None without a repeats part.

        That of a positive quantity is cut off at 0, where its value is not below; this does not change its coverage.
        """
        half = self.parts.combined
        if self.value is None or half is None:
            return None
        low, high = self.value - half, self.value + half
        return (max(0.0, low) if self.positive and self.value >= 0 else low, high)

    def to_dict(self) -> dict[str, Any]:
        """The documented JSON object of an estimate."""
        ci = self.ci95
        data = {
            **vars(self),
            "at": dict(self.at),
            "ci95": None if ci is None else list(ci),
            "parts": dict(vars(self.parts)),
            "trials": list(self.trials),
            "budget": [{**vars(s), "share": share} for s, share in zip(self.budget, self.shares, strict=True)],
        }
        del data["positive"]  # it is said of the result as declared
        return data


def without_value(estimate: Estimate, why: str) -> Estimate:
    """The estimate without value and interval, because they cannot be determined; `why` becomes its note."""
    return replace(estimate, value=None, parts=Parts(), bias=None, corrected=False, budget=(), note=why)


def withhold(estimate: Estimate, reason: str) -> Estimate:
    """The estimate without its value and interval, because the data contradict it; `reason` completes "withheld: "."""
    return replace(without_value(estimate, reason), withheld=True)


BELOW = 1.5
"""A positive quantity this many half widths below 0 is withheld; by chance 1 in 600 of true zeros is."""


def is_below_0(e: Estimate) -> bool:
    """Whether a value is below 0 by more than `BELOW` half widths."""
    half = e.parts.combined
    return e.value is not None and half is not None and e.value < -BELOW * half


def _known(e: Estimate) -> Estimate:
    """The estimate of a positive result; withheld if clearly below 0, or if never 0 and its interval includes 0."""
    found = e.parts.combined
    if is_below_0(e) and e.value is not None:
        size = f"{show(e.value, e.quantity, 3)} +- {show(found or 0.0, e.quantity, 2)}"
        return withhold(e, f"{size} came out, and it is never below 0: a sensor or the form that is assumed is wrong")
    if e.quantity not in NEVER_0 or e.value is None or not found or found < abs(e.value):
        return e
    value, half = (show(number, e.quantity, 3) for number in (e.value, found))
    why = f"only the order of {value} +- {half} is known: the interval includes 0"
    widest = max((s for s in e.budget if s.half), key=lambda s: s.half or 0.0, default=None)
    return withhold(e, why if widest is None else f"{why}. Most of it is from: {widest.name}")


def _as_declared(e: Estimate, positive: Set[str]) -> Estimate:
    """The estimate, marked and checked as positive if its symbol is declared so.

    A coefficient of a curve may be negative, except for times.
    """
    if e.symbol not in positive or (e.coordinate and e.quantity != "time"):
        return e
    return replace(e, positive=True) if e.coordinate else _known(replace(e, positive=True))


@dataclass(frozen=True)
class Curve:
    """A regression of a coefficient on pressure (or another coordinate) with its domain; no extrapolation."""

    symbol: str
    form: str
    """`line`, `quadratic` or `order n in z`; `terms` are the coefficients in ascending powers of z."""
    terms: tuple[Estimate, ...]
    against: str
    domain: tuple[float, float]
    r2: float
    residual_rms: float
    method: str
    centre: float = 0.0
    scale: float = 1.0
    """z = (coordinate - centre) / scale [SI]."""

    @property
    def normalised(self) -> bool:
        """Whether the terms refer to z instead of the coordinate itself."""
        return (self.centre, self.scale) != (0.0, 1.0)

    def values(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """The coefficient [SI] at coordinates [SI], any shape; UsageError outside the domain."""
        at = np.asarray(at, dtype=np.float64)
        low, high = self.domain
        slack = 1e-9 * max(abs(low), abs(high))
        outside = ~((at >= low - slack) & (at <= high + slack))
        if outside.any():
            quantity = POINT_QUANTITIES.get(self.against, "count")
            asked, *ends = (show(float(value), quantity) for value in (at[outside].flat[0], low, high))
            text = f"{self.symbol} is asked for at {self.against} {asked}; it was fitted from {ends[0]} to {ends[1]}"
            raise UsageError(f"{text} and means nothing outside")
        z = (at - self.centre) / self.scale
        return np.asarray(np.polyval([nan if t.value is None else t.value for t in reversed(self.terms)], z))


@dataclass(frozen=True)
class Dropped:
    """A trial that was left out of the fit, and why."""

    trial: str
    point: Mapping[str, float]
    reason: str


@dataclass(frozen=True)
class Finding:
    """One sentence for the reader; `level` is `note`, `doubt` or `fault`."""

    level: str
    text: str


AGREEMENT = "agreement"
"""Kind of an analysis that compares several kinds of test."""
PUBLISHED = "published"
"""Kind of an analysis with published values, without a test of our own."""


@dataclass(frozen=True)
class PublishedPoints:
    """Published points for the figure of a trace; `columns` as in the trace, equally long, SI."""

    label: str
    columns: Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Trace:
    """Data of one figure: columns of numbers with their quantities.

    `columns` are equally long arrays, SI. `marks` are named numbers that the figure shows.
    """

    name: str
    figure: str
    """Kind of figure: `overlay`, `loop`, `oscillation`, `isometric`, `bode`, `lift` ..."""
    title: str
    columns: Mapping[str, NDArray[np.float64]]
    quantities: Mapping[str, str]
    marks: Mapping[str, float] = field(default_factory=dict)
    published: tuple[PublishedPoints, ...] = ()
    """Published points, for the figure alone; they are not stored."""


@dataclass(frozen=True)
class Analysis:
    """All results of one or more runs of one kind."""

    kind: str
    runs: tuple[str, ...]
    simulated: bool
    estimates: tuple[Estimate, ...] = ()
    curves: tuple[Curve, ...] = ()
    dropped: tuple[Dropped, ...] = ()
    findings: tuple[Finding, ...] = ()
    traces: tuple[Trace, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Further facts, such as numbers of trials and cells, residual rms, options; SI."""
    refusals: tuple[str, ...] = ()
    """Why these results are not accepted, whatever limits the protocol sets: one sentence each, with numbers."""
    results: tuple[Result, ...] = ()
    """Declared results of its kind of test; empty for a foreign or old file without declaration."""

    def __post_init__(self) -> None:
        """Check results against the declaration, if there is one (ValueError), and mark positive estimates."""
        if self.results:
            check_declared(self.kind, self.results, self.estimates, self.curves)
            positive = {result.symbol for result in self.results if result.positive}
            object.__setattr__(self, "estimates", tuple(_as_declared(e, positive) for e in self.estimates))

    @classmethod
    def of(
        cls,
        kind: str,
        runs: Sequence[RunData],
        *,
        results: Sequence[Result],
        estimates: Iterable[Estimate] = (),
        curves: Iterable[Curve] = (),
        dropped: Iterable[Dropped] = (),
        findings: Iterable[Finding] = (),
        traces: Iterable[Trace] = (),
        facts: Mapping[str, Any] | None = None,
        refusals: Iterable[str] = (),
    ) -> Analysis:
        """An analysis of `runs`; it counts as simulated if one of them is. `results`: the declared ones."""
        return cls(
            kind,
            tuple(run.id for run in runs),
            any(run.simulated for run in runs),
            tuple(estimates),
            tuple(curves),
            tuple(dropped),
            tuple(findings),
            tuple(traces),
            facts or {},
            tuple(refusals),
            tuple(results),
        )

    def to_dict(self) -> dict[str, Any]:
        """The documented JSON object; traces without their columns, which are in separate files."""
        return {
            "schema": SCHEMA,
            "kind": self.kind,
            "runs": list(self.runs),
            "simulated": self.simulated,
            "estimates": [e.to_dict() for e in self.estimates],
            "curves": [{**vars(c), "terms": [term.to_dict() for term in c.terms]} for c in self.curves],
            "dropped": [dict(vars(d)) for d in self.dropped],
            "findings": [dict(vars(f)) for f in self.findings],
            "traces": [{k: v for k, v in vars(t).items() if k not in ("columns", "published")} for t in self.traces],
            "facts": dict(self.facts),
            "refusals": list(self.refusals),
            "results": [dict(vars(result)) for result in self.results],
        }


def check_declared(
    kind: str, declared: Sequence[Result], estimates: Iterable[Estimate], curves: Iterable[Curve]
) -> None:
    """Raise ValueError where a result of an analysis of `kind` is not declared, or is in another quantity or unit.

    An estimate with a coordinate (a slope, a term) may have another quantity, in that quantity's unit.
    """
    known = {result.symbol: result for result in declared}
    if len(known) < len(declared):
        raise ValueError(f"{kind}: a symbol is declared twice in {', '.join(r.symbol for r in declared)}")
    estimates = list(estimates)
    symbols = [e.symbol for e in estimates]
    symbols += [symbol for c in curves for symbol in (c.symbol, *(term.symbol for term in c.terms))]
    missing = [symbol for symbol in dict.fromkeys(symbols) if symbol not in known]
    if missing:
        text = f"{kind}: not declared: {', '.join(missing)}; declared are {', '.join(known)}. Add the result to the "
        raise ValueError(f"{text}record of this kind of test, with title, quantity and whether it is a headline")
    for e in estimates:
        if e.quantity in QUANTITIES and e.unit != (right := QUANTITIES[e.quantity].unit):
            raise ValueError(f"{kind}: {e.symbol} is given in {e.unit}; a {e.quantity} is in {right}")
        wanted = known[e.symbol]
        if not e.coordinate and (e.quantity, e.unit if wanted.unit else "") != (wanted.quantity, wanted.unit):
            given = f"declared as {wanted.quantity or wanted.unit}, and was given as {e.quantity or e.unit}"
            raise ValueError(f"{kind}: {e.symbol} is {given}")
