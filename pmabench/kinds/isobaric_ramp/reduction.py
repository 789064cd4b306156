"""Reduction of isobaric ramps: mean curve, K, F_ce, loop gap and work; at 0 kPa the rubber's force.

A, B1 and B2 of the rubber can be separated only where data come close to the pole at -B2; the curve itself needs less.

Uses the samples and the protocol's settings. One trial is evaluated in `ramp_loop`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import without_negative_friction
from pmabench.analysis.shared.lines import mean_of_cycles
from pmabench.analysis.shared.ramp_loop import measure_as_planned
from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.shared.trials import Reduction, grouped
from pmabench.analysis.verdict.agreement import Offer, Place, at_pressures, between, everywhere, values_of
from pmabench.base.quantities import show
from pmabench.kinds.isobaric_ramp import RESULTS
from pmabench.kinds.isobaric_ramp.cell import CURVE, GAP, LOCAL, Cell, Member, is_bent
from pmabench.kinds.isobaric_ramp.coefficients import judged, of_curve, of_gap
from pmabench.kinds.isobaric_ramp.creep import creeps_of
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

ONE_CYCLE = (
    "one cycle does not show whether the muscle creeps, and K holds what does: count two cycles and more"
    " (trial.cycles, `discard`)"
)
METHOD = "rubber term"
KINDS: Mapping[str, tuple[str, str]] = {"A": ("N", "force"), "B1": ("1", "ratio"), "B2": ("1", "ratio")}
NORMAL = 1.96
WIDE = 0.25
"""A coefficient is withheld where its interval is wider than this share of it."""
PLACES = 4
STARTS = ((0.1, 0.01), (0.2, 0.02), (0.4, 0.1), (0.9, 0.5))
"""Start values of B1, and of B2 minus the lowest contraction."""
FEWEST = 10
"""Fewest points of the mean curve."""
SHORT = "needs a stretch that comes close to the pole at -B2, and a longer range"


@dataclass(frozen=True)
class Fit:
    """Result of the least squares."""

    terms: Array
    """A [N], B1 and B2 [1], shape (3,)."""
    rms: float
    """Rms residual [N]."""
    misfit: Array
    """Half widths of the terms for a misfit of that size, shape (3,)."""


def rubber_force(eps: Array, A: float, B1: float, B2: float) -> Array:
    """F_e [N] at contractions eps [1] (paper 3 eq. 8)."""
    from pmabench.model.library.daerden import rubber_force as model

    return model(eps, np.float64(A), np.float64(B1), np.float64(B2))  # type: ignore[arg-type]


def fit(eps: Array, F: Array) -> Fit:
    """Least squares of F_e(eps) = A eps (eps - B1)/(eps + B2) through forces F [N] at eps [1], shapes (n,).

    A follows linearly for each B1 and B2, so only these are searched, from several starts; the pole -B2 stays below the
    lowest contraction, outside the data. The residual of a smooth curve does not average out, so half widths are those
    of a single point.
    """
    lowest = max(0.0, -float(eps.min()))
    size = max(float(np.max(np.abs(F))), 1e-12)

    def left(p: Array) -> Array:
        one = rubber_force(eps, 1.0, float(p[0]), float(p[1]))
        return np.asarray(one * (one @ F) / max(float(one @ one), 1e-300) - F) / size

    bounds = ([1e-3, lowest + 1e-5], [1.0, 2.0])
    tries = [
        least_squares(left, (B1, lowest + more), bounds=bounds, x_scale=(0.1, 0.02), xtol=1e-12, ftol=1e-14, gtol=1e-14)
        for B1, more in STARTS
    ]
    B1, B2 = min(tries, key=lambda one: float(one.cost)).x
    one = rubber_force(eps, 1.0, B1, B2)
    A = float(one @ F) / max(float(one @ one), 1e-300)
    terms = np.array([A, B1, B2])
    off = rubber_force(eps, A, B1, B2) - F
    rms = float(np.sqrt(np.mean(off**2)))
    jacobian = np.column_stack(
        [one, -A * eps / (eps + B2), -A * eps * (eps - B1) / (eps + B2) ** 2]
    ) * np.abs(terms)  # fmt: skip
    _, values, directions = np.linalg.svd(jacobian, full_matrices=False)
    inverse = (directions.T / np.maximum(values, 1e-12 * values[0]) ** 2) @ directions
    return Fit(terms, rms, NORMAL * rms * np.sqrt(len(eps) * np.diag(inverse)) * np.abs(terms))


def rubber(cell: Cell, scales: Scales) -> tuple[list[Estimate], list[Finding], list[Trace]]:
    """A, B1, B2 and the force along the stroke from loops without pressure."""
    length = _length(cell)
    if length is None:
        return [], [Finding("note", "no rubber term: the record gives no nominal length of the specimen")], []
    eps = cell.x / length
    if len(eps) < FEWEST or float(np.ptp(cell.curve)) <= 6 * max(m.loop.noise for m in cell.members):
        return [], [Finding("doubt", "no rubber term: the force at 0 kPa does not rise above its noise")], []
    whole = fit(eps, cell.curve)
    terms, rms = whole.terms, whole.rms
    A, B1, B2 = (float(value) for value in terms)
    # whether the search stopped at one of its bounds
    at_bound = B1 > 0.999 or B1 < 2e-3 or B2 > 1.99 or B2 < -float(eps.min()) + 2e-5
    each = [[fit(eps, curve).terms for curve in member.loop.mean] for member in cell.members]
    trials = tuple(member.trial.name for member in cell.members)
    found: list[Estimate] = []
    for place, (name, (unit, quantity)) in enumerate(KINDS.items()):
        _, half = mean_of_cycles([np.array([one[place] for one in cycles]) for cycles in each])
        value = float(terms[place])
        part = scales.part({"force" if name == "A" else "displacement": value})
        parts, note = Parts(half, float(whole.misfit[place]), part), "eps as a fraction of the nominal length"
        e = Estimate(name, value, unit, quantity, METHOD, {}, parts, len(trials), note=note, trials=trials)
        wide = parts.combined
        if wide is None or wide > WIDE * abs(value) or at_bound:
            texts = [show(one, quantity, 3) for one in (value, wide or 0.0)]
            how = "one loop shows no scatter" if wide is None else " within ".join(texts)
            e = replace(e, value=None, parts=Parts(), note=f"not identifiable ({how}): {SHORT}")
        found.append(e)
    reach = f"{show(rms, 'force', 2)} rms, from {100 * eps[0]:.3g} to {100 * eps[-1]:.3g} %"
    if unknown := " and ".join(e.symbol for e in found if e.value is None):
        text = f"rubber term: {unknown} not identifiable, it {SHORT}; the curve itself fits to {reach}"
        finding = Finding("doubt", text)
    else:
        finding = Finding("note", f"the rubber term fits the mean curve at 0 kPa to {reach}")
    for where in np.linspace(eps[0], eps[-1], PLACES):
        _, half = mean_of_cycles([np.array([float(rubber_force(where, *one)) for one in cycles]) for cycles in each])
        value = float(rubber_force(where, *terms))
        parts = Parts(half, rms, scales.part({"force": value}))
        at = {"contraction": round(float(where) * length, 7)}
        found.append(Estimate("F_e", value, "N", "force", METHOD, at, parts, len(trials), trials=trials))
    columns = {"displacement": cell.x, "force": cell.curve, "model": rubber_force(eps, A, B1, B2)}
    quantities = {"displacement": "length", "force": "force", "model": "force"}
    marks = {"A": A, "B1": B1, "B2": B2}
    return found, [finding], [Trace("rubber", "rubber", "Force of the rubber at 0 kPa", columns, quantities, marks)]


def _length(cell: Cell) -> float | None:
    """Nominal length of the specimen [m], as recorded; None if unknown."""
    specimen = cell.members[0].run.manifest.get("specimen")
    length = specimen.get("nominal_length") if isinstance(specimen, Mapping) else None
    return float(length) if isinstance(length, int | float) and 0 < length < 100 else None


KIND = "isobaric-ramp"
CHANNELS = ("displacement", "force")
UNPRESSED = 1.0
"""Set pressure up to which a loop is of the rubber alone [Pa]."""


def _measured(run: RunData, trial: TrialData, _options: Mapping[str, Any]) -> Member:
    if trial.point.get("speed", 1.0) <= 0:
        raise NotUsable("its point names a speed of 0")
    return Member(run, trial, measure_as_planned(run, trial))


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Mean curve F(x), K [N/m], F_ce [N], gap H [N] and work [J] of slow ramps at constant pressure (paper 3).

    The gap is the force while expanding minus that while contracting at mid stroke, positive where the contracting
    branch is the lower one. H = 2 F_c + (B_c + B_r) v is a line over the speed v, whose start is the static hysteresis.
    The mean of both branches is extrapolated to speed 0 in the same way; K is minus its slope. At 0 kPa it is the
    rubber's force, to which F_e = A eps (eps - B1)/(eps + B2) is fitted (paper 3 eq. 8).

    The plan's settings, or the map's, have `discard` (cycles at the start; else 1) and `turn` [m] (left out at both
    ends; else a twentieth of the stroke).
    """
    result = Reduction.of(KIND, RESULTS, runs, None, _measured)
    scales, cells = result.scales, _cells(result.measured)
    for cell, creep in zip(cells, creeps_of(cells), strict=True):
        near = _next_to(cell, cells)
        result.estimates += judged(cell, [*of_curve(cell, scales, near), *of_gap(cell, scales, near)], creep)
        result.findings += cell.findings()
        if creep is None:
            result.findings.append(Finding("doubt", f"at {show(cell.pressure, 'pressure')}, {ONE_CYCLE}"))
        result.traces += cell.traces()
    for cell in (one for one in cells if one.pressure <= UNPRESSED):
        result.add(*rubber(cell, scales))
    result.findings += _sentences(cells)
    result.estimates = sorted(without_negative_friction(result.estimates), key=lambda e: e.method != CURVE)
    result.findings += skew.findings(runs, CHANNELS, max((cell.skew for cell in cells), default=0.0), result.estimates)
    result.note_lack(("force", "displacement"))
    return result.analysis(cells=len(cells), loops=[cell.facts() for cell in cells])


def _cells(members: Sequence[Member]) -> list[Cell]:
    """The trials of one pressure and stroke together, by ascending pressure."""
    ends = ("pressure", "lower", "upper")
    groups = grouped(members, lambda one: tuple(round(one.trial.point.get(name, 0.0), 9) for name in ends))
    pressures = [key[0] for key in groups]
    return [
        Cell.of({"pressure": key[0]} | ({"lower": key[1], "upper": key[2]} if pressures.count(key[0]) > 1 else {}), g)
        for key, g in sorted(groups.items())
    ]


def _next_to(cell: Cell, cells: Sequence[Cell]) -> Cell | None:
    """The cell of the nearest other pressure that covers the middle of this one's stroke; None without one."""
    others = [c for c in cells if c.pressure != cell.pressure and c.x[0] <= cell.middle <= c.x[-1]]
    return min(others, key=lambda c: abs(c.pressure - cell.pressure), default=None)


def _sentences(cells: Sequence[Cell]) -> list[Finding]:
    """Which branch is the lower one, and where a single K is not enough."""
    if wrong := ", ".join(show(cell.pressure, "pressure") for cell in cells if cell.upside_down):
        text = (
            f"at {wrong} the force is larger while contracting than while expanding: no muscle gives work back like "
            "that; look for a wrong sign, or force and displacement that are apart in time"
        )
        return [Finding("fault", text)]
    if not cells:
        return []
    gaps = ", ".join(f"{show(cell.gap.start, 'force', 3)} at {show(cell.pressure, 'pressure')}" for cell in cells)
    found = [Finding("note", f"the contracting branch is the lower one; gap at mid stroke {gaps}")]
    if bent := [show(cell.pressure, "pressure") for cell in cells if cell.bent]:
        text = f"at {', '.join(bent)} the mean curve is bent: K by pressure alone is a mean over the stroke"
        found.append(Finding("note", f"{text}; that at each contraction is in the tables"))
    return found


def offers(analysis: Analysis) -> Iterator[Offer]:
    """F along the mean curves, K of those that are straight and along those that are bent, B, F_c."""
    K = at_pressures(analysis, "K", CURVE)
    for trace in analysis.traces:
        P = trace.marks.get("pressure")
        if trace.figure == "mean-curve" and P is not None:
            F_here, K_here = (
                sorted(((e.at["contraction"], e) for e in values_of(analysis, symbol, LOCAL) if e.at["pressure"] == P),
                       key=lambda one: one[0]) for symbol in ("F", "K")
            )  # fmt: skip
            if F_here:
                yield _along(P, F_here, trace)
            x, F = trace.columns["displacement"], trace.columns["force"]
            if P in K and len(x) > 2 and not is_bent(x, F):
                yield _of_stroke(P, K[P], trace)
            elif K_here:
                yield _along(P, K_here)
    yield from (everywhere(symbol, at_pressures(analysis, symbol, GAP)) for symbol in ("B", "F_c"))


def _along(P: float, known: Sequence[tuple[float, Estimate]], course: Trace | None = None) -> Offer:
    """F along the mean curve `course` of a pressure [Pa], with intervals interpolated between places; without `course`
    K.

    Between the places K is taken as a bent curve.
    """

    def at(place: Place) -> Estimate | None:
        x = place[1]
        found = None if place[0] != P or x is None else between(known, x, bent=course is None)
        if found is None or course is None or x is None:
            return found
        return replace(found, value=float(np.interp(x, course.columns["displacement"], course.columns["force"])))

    return Offer(known[0][1].symbol, {(P, x): e for x, e in known}, at, bent=course is None)


def _of_stroke(P: float, K: Estimate, course: Trace) -> Offer:
    """K of a straight mean curve: that at its middle; elsewhere with the difference by a parabola as method part."""
    x, F = course.columns["displacement"], course.columns["force"]
    bend = 2 * abs(float(np.polyfit(x, F, 2)[0]))

    def at(place: Place) -> Estimate | None:
        there = place[1]
        if place[0] != P or (there is not None and not x[0] <= there <= x[-1]):
            return None
        off = 0.0 if there is None else bend * abs(there - float(x.mean()))
        return replace(K, parts=replace(K.parts, method=hypot(K.parts.method or 0.0, off)))

    return Offer("K", {(P, None): K}, at)
