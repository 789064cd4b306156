"""Creep that the gap does not show, because damping hides it or because it is slower than the ramps: its part in K.

Model: a spring K_1 whose far end e follows the contraction, e' = (x - e)/tau, with force -K_1 (x - e). In ramps much
faster than tau it acts like any spring. Small signs remain: e moves from the rest position to the middle of the stroke,
so that the force drifts from cycle to cycle; slower ramps are less steep; and the gap has a parabolic part that
decreases with speed. Each bounds K_1 for each tau, by least squares over the cycles of all trials.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import student
from pmabench.analysis.shared.form import SURE
from pmabench.analysis.shared.samples import ends
from pmabench.base.quantities import show
from pmabench.kinds.isobaric_ramp.cell import Cell, Member
from pmabench.store.records import Array

TRIED = 24
"""Time constants that are tried."""
LONGEST = 2.0
"""Largest time constant, relative to the test time of a cell: slower creep acts like a spring throughout."""
FASTEST = 0.5
"""Smallest time constant, relative to the shortest ramp; 1 where there is one speed only."""
OTHERS = 2.0
"""Factor by which the relative creep may differ between cells of a test."""
LATE = 0.1
"""Overlap with the preceding ramp that is allowed before a trial counts as having a different clock [s]."""
FORCE, STIFFNESS, DOME = range(3)


@dataclass(frozen=True)
class Creep:
    """Largest effect of creep of any time constant in a cell, as far as the cycles allow it."""

    stiffness: float
    """[N/m]"""
    force: Array
    """Change of the mean curve [N], either sign, shape (n,)."""
    gap: float
    """Gap at speed 0 [N]."""
    damping: float
    """[N.s/m], either way."""
    time: float
    """Time constant with the largest stiffness [s]."""
    seen: bool
    """Whether creep with any time constant is significant."""

    @property
    def reason(self) -> str:
        """Sentence: what was found, and what to do."""
        return (
            "the force drifts from cycle to cycle, or the mean curve is less steep where ramps are slower, as where a "
            f"muscle creeps: K may hold {show(self.stiffness, 'stiffness', 2)} of that, in about "
            f"{show(self.time, 'time', 2)}. Check the zero of the cell, do more cycles before those that count, and "
            "ramp more slowly"
        )


@dataclass(frozen=True, eq=False)
class _Tried:
    """Springs of 1 N/m with each of the time constants, shape (k,), in one cell, and what the cycles allow."""

    counts: NDArray[np.bool_]
    """Whether the time constant is in the range of the cell."""
    most: Array
    """Largest K_1 [N/m]; inf where the cycles give no bound."""
    stiffness: Array
    force: Array
    """Force on the mean curve, shape (k, n)."""
    gap: Array
    damping: Array
    seen: bool


def creeps_of(cells: Sequence[Cell]) -> list[Creep | None]:
    """Possible creep in each cell; None where its cycles give no bound, such as a single one.

    A cell tested after others moves about the same middle, which the end of the spring has already reached. The bound
    of the other cells, relative to the stiffness, is used for it, too, times a factor.
    """
    if not cells:
        return []
    spans = np.array([_span(cell) for cell in cells])
    times = np.geomspace(spans[:, 0].min(), spans[:, 1].max(), TRIED)
    tried = [_tried(cell, times, *span) for cell, span in zip(cells, spans.tolist(), strict=True)]
    shares = [one.most / max(abs(cell.straight), 1e-9) for cell, one in zip(cells, tried, strict=True)]
    return [_creep(cell, one, times, np.min(shares, axis=0)) for cell, one in zip(cells, tried, strict=True)]


def _creep(cell: Cell, one: _Tried, times: Array, least: Array) -> Creep | None:
    """The largest creep of a cell; `least`, shape (k,), is the smallest relative bound of all cells. None without a
    bound.
    """
    most = one.most if one.seen else np.minimum(one.most, OTHERS * least * abs(cell.straight))
    known = one.counts & np.isfinite(most)
    if not known.any():
        return None
    K = np.where(known, most, 0.0)
    time = float(times[np.argmax(K * one.stiffness)])
    force = np.max(K[:, None] * np.abs(one.force), axis=0)
    stiffness, gap, damping = (float(np.max(K * unit)) for unit in (one.stiffness, one.gap, np.abs(one.damping)))
    return Creep(stiffness, force, gap, damping, time, one.seen)


def _span(cell: Cell) -> tuple[float, float]:
    """Smallest and largest time constant [s] for a cell."""
    begun = {member.run.id: float(member.trial.t[0]) for member in reversed(cell.members)}
    lasts = max(float(member.loop.moments[-1, 2]) - begun[member.run.id] for member in cell.members)
    return (1.0 if cell.one_speed else FASTEST) * cell.stroke / cell.speeds[1], LONGEST * lasts


def _tried(cell: Cell, times: Array, fastest: float, slowest: float) -> _Tried:
    pulls = [_pulls(cell, member, times) for member in cell.members]
    units = _signs(cell, pulls)
    shown = _signs(cell, [(m.loop.contracting[None], m.loop.expanding[None]) for m in cell.members])
    counts = (times >= fastest * (1 - 1e-9)) & (times <= slowest * (1 + 1e-9))
    seen, most, longest = False, np.full(len(times), np.inf), cell.stroke / cell.speeds[0]
    for k, time in enumerate(times):
        asked = _columns(cell, time > longest)
        springs = [(sign, bound_of(columns, units[sign][k], shown[sign][0], sign == FORCE)) for sign, columns in asked]
        known = [(sign, spring) for sign, spring in springs if spring is not None]
        # of each kind of sign the first
        together = joined(dict(reversed(known)).values())
        most[k] = min((spring.most for spring in [*(one for _, one in known), *together]), default=np.inf)
        seen |= any(sign != DOME and counts[k] and spring.seen for sign, spring in known)
    gaps = np.array([(two - one).mean(axis=1)[:, cell.x.size // 2] for one, two in pulls])
    speeds = [member.speed for member in cell.members]
    damping, gap = (np.zeros(len(times)), gaps.max(axis=0)) if cell.one_speed else np.polyfit(speeds, gaps, 1)
    force = np.mean([0.5 * (one + two).mean(axis=1) for one, two in pulls], axis=0)
    return _Tried(counts, most, units[STIFFNESS].mean(axis=1), force, gap, damping / 2, seen)


def _columns(cell: Cell, slow: bool) -> Iterator[tuple[int, Sequence[Array]]]:
    """A sign of creep and other regressors for it, shape (cycles,) each.

    Each trial has its own mean force. The stiffness may also increase with speed because of a varying pressure; two
    speeds cannot separate that from creep. The gap is a parabola where creep is slower than all ramps (`slow`).
    """
    cycles = [len(member.loop.lost) for member in cell.members]
    speeds = np.repeat([member.speed for member in cell.members], cycles)
    same, trial = np.ones(len(speeds)), np.repeat(np.arange(len(cycles)), cycles)
    yield FORCE, [np.asarray(trial == k, dtype=np.float64) for k in range(len(cycles))]
    yield STIFFNESS, [same]
    if len(set(speeds.tolist())) > 2:
        yield STIFFNESS, [same, speeds]
    if slow:
        yield DOME, [same]


def _path(member: Member) -> tuple[Array, Array]:
    """Times [s] and contractions [m] of the corners of the motion, up to the end of the trial."""
    knots: list[tuple[float, float]] = []
    for trial in member.run.trials:
        if knots and len(trial.t) and trial.t[0] < knots[-1][0] - LATE:
            knots = []  # this trial has another clock
        ramps = [c for c in trial.commands if c.output == "displacement" and c.kind == "ramp"]
        for c, next_one in zip_longest(ramps, ramps[1:]):
            later = float(trial.t[-1]) if next_one is None else next_one.t
            knots += [(c.t, c.before), (ends(c) if c.data.get("rate", 0.0) > 0 else later, c.value)]
        if trial.name == member.trial.name:
            break
    t, x = np.array(knots).T
    return np.maximum.accumulate(t), x


def _behind(path: tuple[Array, Array], times: Array, at: Array) -> Array:
    """Lag x - e [m] of each spring at times `at` [s]; exact, 0 at the start of the path.

    `times`, shape (k,), are the time constants; the result has shape (k, *shape of `at`).
    """
    t, x = path
    dt, way = np.diff(t), np.diff(x)
    moves = dt > 0
    speed = np.where(moves, way / np.where(moves, dt, 1.0), 0.0)
    keep = np.exp(-dt / times[:, None])
    added = np.where(moves, speed * times[:, None] * (1 - keep), way)
    behind = np.zeros((len(times), len(t)))
    for i in range(len(dt)):
        behind[:, i + 1] = behind[:, i] * keep[:, i] + added[:, i]
    last = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(dt) - 1)
    constant = times.reshape(-1, *(1,) * at.ndim)
    fades = np.exp(-(at - t[last]) / constant)
    return np.asarray(behind[:, last] * fades + speed[last] * constant * (1 - fades))


def _pulls(cell: Cell, member: Member, times: Array) -> tuple[Array, Array]:
    """Force on both branches of a spring of 1 N/m with each time constant [N], shape (k, cycles, n) each."""
    path, loop = _path(member), member.loop
    lower, upper = loop.ends
    begins, turns = loop.moments[:, :1], loop.moments[:, 1:2]
    moments = begins + (cell.x - lower) / loop.speed, turns + (upper - cell.x) / loop.speed
    return -_behind(path, times, moments[0]), -_behind(path, times, moments[1])


def _signs(cell: Cell, loops: Sequence[tuple[Array, Array]]) -> tuple[Array, Array, Array]:
    """Mean force [N], stiffness [N/m] and parabolic part of the gap [N] in the cycles of all loops, shape (k, cycles)
    each.
    """
    place, inner = cell.opened
    means = np.concatenate([0.5 * (contracting + expanding) for contracting, expanding in loops], axis=1)
    gaps = np.concatenate([expanding - contracting for contracting, expanding in loops], axis=1)[..., inner]
    shape = means.shape[:2]
    slopes = np.polyfit(cell.x, means.reshape(-1, len(cell.x)).T, 1)[0].reshape(shape)
    domes = np.polyfit(place[inner], gaps.reshape(-1, int(inner.sum())).T, 2)[0].reshape(shape)
    return means.mean(axis=2), -slopes, domes


ONE_SIDE = 0.95
"""One-sided probability for the upper bound."""


@dataclass(frozen=True)
class Bound:
    """A size, its standard error times Student's t for `ONE_SIDE` (`open`) and `SURE`, and the residual sum of squares
    `left`.
    """

    size: float
    open: float
    sure: float
    left: float = 0.0
    likely: float = 1.0
    """Forms with a residual up to this factor larger are equally likely."""

    @property
    def most(self) -> float:
        """Largest size that is allowed; a significant negative size may hide as much."""
        return max(self.size, 0.0) + self.open if self.size > -self.sure else self.open - self.size

    @property
    def seen(self) -> bool:
        """Whether it is significant."""
        return self.size > self.sure


def bound_of(columns: Sequence[Array], unit: Array, shown: Array, exact: bool = False) -> Bound | None:
    """Multiple of `unit` in `shown`, fitted together with `columns`, shape (n,) each; None if not determined.

    `exact`: also where there are as many values as unknowns, so without an error estimate: the size may then be twice
    as large, and is not significant.
    """
    design = np.column_stack([*columns, unit])
    freedom = len(shown) - design.shape[1]
    terms, _, rank, _ = np.linalg.lstsq(design, shown, rcond=None)
    if freedom < (0 if exact else 1) or rank < design.shape[1]:
        return None
    if freedom == 0:
        return Bound(float(terms[-1]), abs(float(terms[-1])), np.inf)
    left = shown - design @ terms
    error = float(np.sqrt(left @ left / freedom * np.linalg.inv(design.T @ design)[-1, -1]))
    once, both, sure = (float(student.ppf(share, freedom)) for share in (ONE_SIDE, 0.975, SURE))
    return Bound(float(terms[-1]), once * error, sure * error, float(left @ left), 1 + both**2 / freedom)


def joined(bounds: Collection[Bound]) -> Iterator[Bound]:
    """The mean of several bounds, weighted by the inverse squares of their errors; nothing for fewer than two."""
    if len(bounds) > 1 and min(bound.open for bound in bounds) > 0:
        weights = np.array([bound.open**-2 for bound in bounds])
        mean = float(weights @ [bound.size for bound in bounds] / weights.sum())
        yield Bound(mean, float(weights.sum() ** -0.5), float(np.sum([one.sure**-2 for one in bounds]) ** -0.5))
