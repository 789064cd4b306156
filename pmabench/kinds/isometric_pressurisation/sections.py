"""Isometric tests of several contractions together: F_ce and K at a pressure, blocked force.

Works on the mean curves (of filling and emptying) at each contraction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.isometric_lines import by_repeat, spread
from pmabench.analysis.shared.lines import PROPORTIONAL, Line, weighted_line
from pmabench.analysis.shared.student import mean_with_half
from pmabench.analysis.shared.trials import session_of
from pmabench.analysis.verdict.agreement import side_by_side
from pmabench.base.quantities import show
from pmabench.kinds.isometric_pressurisation.curve import BEYOND, NEAR, Cell
from pmabench.store.analyses.results import Estimate, Finding, Parts, Trace
from pmabench.store.records import Array

GRID, PLACES = 50e3, 60
"""Pressures at which F_ce and K are given are multiples of this [Pa]; their largest number."""
PULLS = 0.02
"""Least force, as a share of the largest of all, for a muscle to be used in a line over contractions."""
APART = 1e-5
"""Contractions closer than this cannot make a line [m]."""
CLEAR = 4.0
"""Standard errors from which on a bend is significant."""


@dataclass(frozen=True)
class Across:
    """F = F_ce - K x over the contractions at one pressure (the three-element model of paper 0)."""

    pressure: float
    line: Line
    off: float
    """Largest distance of a contraction's mean from the line [N]."""
    span: float
    """Range of the mean forces at the contractions [N]."""
    between: tuple[float, ...]
    """-dF/dx between neighbouring contractions [N/m]."""
    names: tuple[str, ...]
    bend: Bend
    zeros: Mapping[str, Array]
    """Channel -> change of slope and start by its zero, another one in each session (`_by_zeros`), shape (2,)."""


@dataclass(frozen=True)
class Bend:
    """Difference between a parabola and the line over the contractions: an equally good choice, or a better one if
    significant.
    """

    start: float
    """Difference in F_ce [N]."""
    slope: float
    """Larger difference in K at the ends of the contractions [N/m]."""
    seen: bool
    F_ce: float
    """From the line [N]."""

    @classmethod
    def of(cls, x: Array, F: Array, line: Line) -> Bend:
        """From forces F (n,) [N] at contractions x (n,) [m] of the same pressure."""
        bend, tilt, start = np.polyfit(x - x.mean(), F, 2)
        off = F - np.polyval([bend, tilt, start], x - x.mean())
        design = np.vander(x - x.mean(), 3)
        scaled = design / np.linalg.norm(design, axis=0)
        floor = PROPORTIONAL * float(np.abs(F).max())
        freedom = len(F) - 3
        spread = max(floor, sqrt(float(off @ off) / freedom) if freedom > 0 else 0.0)
        error = sqrt(np.linalg.pinv(scaled.T @ scaled)[0, 0]) * spread / float(np.linalg.norm(design[:, 0]))
        at_0 = float(np.polyval([bend, tilt, start], -x.mean()))
        tangents = [-(tilt + 2 * bend * (end - x.mean())) for end in (x.min(), x.max())]
        slope = max(abs(tangent + line.slope) for tangent in tangents)
        return cls(at_0 - line.start, slope, bool(abs(bend) > CLEAR * error), line.start)

    def doubt(self, symbol: str) -> Doubt:
        """Effect on `F_ce`, which is extrapolated to zero contraction, or `K`, which applies to the whole stroke."""
        if symbol == "K":
            return Doubt("bend over the contraction", "method", self.slope if self.seen else 0.0, self.seen)
        reason = (
            f"the force over contraction is bent: a parabola gives {show(self.F_ce + self.start, 'force', 4)} without "
            f"contraction, the line {show(self.F_ce, 'force', 4)}. The blocked force F_b is measured there"
        )
        return Doubt("bend over the contraction", "method", BEYOND * abs(self.start), self.seen, reason)


def across(cells: Sequence[Cell]) -> list[Across]:
    """F_ce and K at each pressure of the grid at which at least three contractions have force."""
    found: list[Across] = []
    if not cells:
        return found
    known = [cell.mean.force[np.isfinite(cell.mean.force)] for cell in cells]
    strongest = max((float(F.max()) for F in known if len(F)), default=0.0)
    for P in pressures(cells).tolist():
        rows = [
            (cell.contraction, x, F, test.name, session_of(test.run), _slope(cell, P))
            for cell in cells
            for x, F, test in zip(cell.place, cell.force_at(P), cell.tests, strict=True)
            if np.isfinite(F) and F > PULLS * strongest
        ]
        group, x, F = (np.array([row[i] for row in rows], dtype=np.float64) for i in range(3))
        places = np.unique(group)
        centres = np.sort([float(x[group == g].mean()) for g in places])
        if len(places) < 3 or np.min(np.diff(centres)) < APART:
            continue
        line = weighted_line(group, x, F, np.full(len(F), float(F.max())))
        line = _wider(line, x, F, [row[4] for row in rows])
        means = sorted((float(x[group == g].mean()), float(F[group == g].mean())) for g in places)
        off = max(abs(f - line.start - line.slope * at) for at, f in means)
        between = tuple(-(f2 - f1) / (x2 - x1) for (x1, f1), (x2, f2) in pairwise(means))
        span, names = float(np.ptp([f for _, f in means])), tuple(row[3] for row in rows)
        sessions = np.array([row[4] for row in rows])
        units = {
            "force": np.ones(len(F)),
            "pressure": np.array([row[5] for row in rows]),
            "displacement": np.full(len(F), -line.slope),
        }
        zeros = {name: _by_zeros(x, sessions, unit) for name, unit in units.items()}
        found.append(Across(P, line, off, span, between, names, Bend.of(x, F, line), zeros))
    return found


def _by_zeros(x: Array, sessions: NDArray[np.str_], unit: Array) -> Array:
    """Change of slope and start (2,) by a zero that is off by 1 in one session after the other, root of the sum of
    squares; 0 with one session, whose zero is in all forces alike. `unit`: force by a zero that is off by 1, (n,).
    """
    names = np.unique(sessions)
    each = [np.polyfit(x, unit * (sessions == name), 1) for name in names]
    return np.linalg.norm(each, axis=0) if len(names) > 1 else np.zeros(2)


def _wider(line: Line, x: Array, F: Array, sessions: Sequence[str]) -> Line:
    """The line with half widths by Student's t over the lines of the sessions, where those are wider."""
    names = dict.fromkeys(sessions)
    mine = [np.array([session == name for session in sessions]) for name in names]
    each = [np.polyfit(x[rows], F[rows], 1) for rows in mine if np.ptp(x[rows]) > APART]
    if len(each) < 2 or len(each) < len(names):
        return line
    slope, start = (mean_with_half([float(one[i]) for one in each])[1] or 0.0 for i in (0, 1))
    return replace(line, half_start=max(line.half_start or 0.0, start), half_slope=max(line.half_slope or 0.0, slope))


def given_of(specimen: object) -> Mapping[str, float]:
    """`nominal_length` and `inner_diameter` [m] of a manifest's specimen, those that are numbers > 0.

    For muscles side by side, the diameter of a single muscle with the force of all.
    """
    entries = specimen if isinstance(specimen, Mapping) else {}
    values = {name: entries.get(name) for name in ("nominal_length", "inner_diameter")}
    given = {name: float(value) for name, value in values.items() if isinstance(value, int | float) and value > 0}
    if "inner_diameter" in given:
        given["inner_diameter"] *= sqrt(side_by_side(specimen))
    return given


FLATTEST, STEEPEST = 1.4, 20.5
"""Force per pressure over the bore's area of long muscles of 43 and 17 deg at no contraction (`size_findings`) [1]."""
LONG, SHORTENED = 5.0, 0.05
"""Length over diameter, and relative contraction, for which that holds."""


def size_findings(cells: Sequence[Cell], given: Mapping[str, float]) -> list[Finding]:
    """A doubt where m does not suit the bore: it is (3 cos^2 a - 1) / sin^2 a of its area (Chou and Hannaford 1996)."""
    length, bore = (given.get(name, 0.0) for name in ("nominal_length", "inner_diameter"))
    near = [cell for cell in cells if cell.pooled is not None and abs(cell.contraction) <= SHORTENED * length]
    if not near or not bore or length < LONG * bore:
        return []
    cell = min(near, key=lambda one: abs(one.contraction))
    times = cell.pooled.line.m / (pi * bore**2 / 4) if cell.pooled else 0.0
    if FLATTEST <= times <= STEEPEST:
        return []
    text = (
        f"at contraction {show(cell.contraction, 'length', 2)} the force rises by {times:.2g} times the area of a bore "
        f"of {show(bore, 'length', 3)}; braided muscles give {FLATTEST:g} to {STEEPEST:g} times: the unit or the scale "
        "of force or pressure is wrong (is the force in kg?), or the inner diameter"
    )
    return [Finding("doubt", text)]


BLOCKED = "blocked"
FIGURE = "characteristic"
LENGTH = 0.25
"""Nominal length for that if none is given [m]."""
EXACT = 1e-4
"""Contractions below this are exactly 0 for the correction [m]."""
MOST = 5.0
"""Largest distance of the contraction on the other side of 0, relative to that of the blocked test."""
STEP = 0.02
"""Half width of the line for dF/dP, as a share of the range of pressures."""


def pressures(cells: Sequence[Cell]) -> Array:
    """Multiples of `GRID` up to the highest pressure of the tests [Pa], from the first one on; fewer where they were
    more than `PLACES`, as after a wrong unit.
    """
    top = max(float(1.5 * cell.mean.P[-1] - 0.5 * cell.mean.P[-2]) for cell in cells)
    count = int(np.floor(top / GRID + 0.05))
    every = max(1, -(-count // PLACES))
    return GRID * every * np.arange(1, count // every + 1, dtype=np.float64)


def blocked_estimates(cells: Sequence[Cell], given: Mapping[str, float], scales: Scales) -> list[Estimate]:
    """F_b [N] at each pressure, if there are tests at zero contraction.

    With contractions on both sides of 0, the force is interpolated by a parabola through three of them, and the
    difference to a line is the method part. Otherwise the method part is K times the distance from the nominal length.
    It also includes a possible bend between the means over pressure. Calibration to first order: gains and offsets of
    force, of pressure by dF/dP, of displacement by K.
    """
    near = NEAR * given.get("nominal_length", LENGTH)
    blocked = min(cells, key=lambda cell: abs(cell.contraction), default=None)
    if blocked is None or abs(blocked.contraction) > near:
        return []
    others = [cell for cell in cells if cell.contraction > blocked.contraction + near]
    nearest = min(others, key=lambda cell: cell.contraction, default=None)
    off = float(np.abs(blocked.place).max())
    late = blocked.rate * skew.apart([test.run for test in blocked.tests], ("pressure", "force"))
    found = []
    for P in pressures(cells).tolist():
        each = blocked.force_at(P)
        known = np.isfinite(each)
        if not known.any():
            continue
        tests = [test for test, usable in zip(blocked.tests, known, strict=True) if usable]
        values = by_repeat(tests, each[known])
        F = float(values.mean())
        K = 0.0
        if nearest is not None and np.isfinite(F_nearest := float(np.mean(nearest.force_at(P)))):
            apart = float(nearest.place.mean() - blocked.place.mean())
            K = (F - F_nearest) / apart if apart > APART else 0.0
        between = _between(cells, blocked, P)
        shift, doubt = (0.0, K * off) if between is None else between
        F += shift
        slope = _slope(blocked, P)
        gains = {"force": F, "pressure": slope * P}
        offsets = {"force": 1.0, "pressure": slope} | ({"displacement": K} if K else {})
        half, method = spread(values), hypot(doubt, _bend(blocked, P))
        parts = Parts(half, method, scales.part(gains, offsets), abs(slope) * late)
        note = sentences(
            "no repeats part: one test only" if half is None else "",
            "" if between is None else "between the contractions on both sides of 0",
            scales.lack(gains, offsets),
        )
        at, n, names = {"pressure": P}, len(values), tuple(test.name for test in tests)
        found.append(Estimate("F_b", F, "N", "force", BLOCKED, at, parts, n, note=note, trials=names))
    return found


def _between(cells: Sequence[Cell], blocked: Cell, P: float) -> tuple[float, float] | None:
    """Correction of the force of `blocked` to zero contraction by a parabola with the nearest contractions, and its
    difference to a line [N].

    None where `blocked` is at 0, or nothing on the other side was tested; with two contractions the correction is by a
    line.
    """
    known = {float(cell.place.mean()): float(np.mean(F)) for cell in cells if np.isfinite(F := cell.force_at(P)).all()}
    x_0 = float(blocked.place.mean())
    near = sorted((x for x in known if abs(x - x_0) > APART), key=abs)
    beyond = [x for x in near if x * x_0 < 0]
    if abs(x_0) < EXACT or x_0 not in known or not beyond or abs(beyond[0]) > MOST * abs(x_0):
        return None
    x_1 = beyond[0]
    slope = (known[x_1] - known[x_0]) / (x_1 - x_0)
    shift = -slope * x_0
    third = [x for x in near if abs(x - x_1) > APART]
    if not third:
        return shift, abs(shift)
    x_2 = third[0]
    bend = ((known[x_2] - known[x_1]) / (x_2 - x_1) - slope) / (x_2 - x_0)
    return shift + bend * x_0 * x_1, abs(bend * x_0 * x_1)


def _slope(cell: Cell, P: float) -> float:
    """dF/dP of the mean curve near a pressure [N/Pa]."""
    known = np.isfinite(cell.mean.force)
    at, F = cell.mean.P[known], cell.mean.force[known]
    width = max(STEP * float(np.ptp(at)), 1.5 * float(cell.mean.P[1] - cell.mean.P[0]))
    near = np.abs(at - P) <= width
    if near.sum() < 2:  # holds of a staircase have larger distances
        near = np.isin(np.arange(len(at)), np.argsort(np.abs(at - P))[:2])
    return float(np.polyfit(at[near], F[near], 1)[0]) if near.sum() > 1 else 0.0


def _bend(cell: Cell, P: float) -> float:
    """Error of the means near a pressure because of the curvature of F(P) [N]: an eighth of their second difference."""
    at, F = cell.mean.P, cell.mean.force
    i = int(np.clip(np.searchsorted(at, P), 1, len(at) - 2))
    near = F[max(0, i - 2) : i + 3]
    bends = np.abs(np.diff(near[np.isfinite(near)], n=2))
    return float(bends.max()) / 8 if len(bends) else 0.0


def blocked_trace(cells: Sequence[Cell]) -> list[Trace]:
    """Force at each pressure of the grid and each contraction; none with a single contraction."""
    rows = [
        (float(P), float(cell.place.mean()), float(np.mean(F[np.isfinite(F)])))
        for P in (pressures(cells) if len(cells) > 1 else ())
        for cell in cells
        if np.isfinite(F := cell.force_at(float(P))).any()
    ]
    if len(rows) < 2:
        return []
    quantities = {"pressure": "pressure", "displacement": "length", "force": "force"}
    columns = dict(zip(quantities, np.array(rows).T, strict=True))
    title = "Force over contraction at set pressures, held at one length"
    return [Trace(FIGURE, FIGURE, title, columns, quantities)]


BENT = 0.05
"""A distance from the line over contractions that is reported, as a share of the span of the forces."""


def of_across(found: Sequence[Across]) -> list[Finding]:
    """Whether the three-element model holds over the contractions."""
    if not found:
        return [Finding("note", "F_ce and K are not reported: fewer than three contractions pull at the same pressure")]
    worst = max(found, key=lambda one: one.off / one.span if one.span else 0.0)
    share = worst.off / worst.span if worst.span else 0.0
    where = show(worst.pressure, "pressure")
    text = f"F over contraction leaves a straight line by up to {show(worst.off, 'force', 2)} ({share:.1%}) at {where}"
    if share <= BENT:
        return [Finding("note", f"{text}: the three-element model holds over these contractions")]
    low, high = min(worst.between), max(worst.between)
    between = f"{show(low, 'stiffness', 3)} to {show(high, 'stiffness', 3)}"
    text += f": -dF/dx between neighbours is {between}; F_ce and K are those of a straight line through that"
    return [Finding("doubt", text)]
