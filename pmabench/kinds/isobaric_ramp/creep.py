"""Creep that no gap shows, because damping hides it there or because it is slower than the ramps: what it adds to K.

A spring K_1 whose far end e follows the contraction, e' = (x - e)/tau, pulls by -K_1 (x - e). In ramps much faster than
tau it is a spring like any other, and what still shows is small: e goes from where the muscle rested to the middle of
the stroke, so that the force drifts from cycle to cycle; slower ramps are less steep; and the gap has a dome that fades
as the speed rises. Each of them bounds K_1 for each tau, by least squares over the cycles of all trials.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

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
"""The largest, as a share of how long a cell is tested: what takes longer is a spring like any other in all of it."""
FASTEST = 0.5
"""The least, as a share of the shortest ramp; that ramp itself where one speed shows no faster ones."""
OTHERS = 2.0
"""In one cell of a test the muscle may creep so many times as much as in another, as a share of the stiffness."""
LATE = 0.1
"""A trial may begin so much before the ramp before it is over by its rate [s]."""
FORCE, STIFFNESS, DOME = range(3)


@dataclass(frozen=True)
class Creep:
    """The most that creep of any time constant may add to a cell, as far as the cycles allow."""

    stiffness: float
    """[N/m]"""
    force: Array
    """To the mean curve [N], either way, shape (n,)."""
    gap: float
    """At speed 0 [N]."""
    damping: float
    """[N.s/m], either way."""
    time: float
    """Time constant of the stiffest [s]."""
    seen: bool
    """Whether one is significant."""

    @property
    def reason(self) -> str:
        """What was found, and what to do."""
        return (
            "the force drifts from cycle to cycle, or the mean curve is less steep where ramps are slower, as where a "
            f"muscle creeps: K may hold {show(self.stiffness, 'stiffness', 2)} of that, in about "
            f"{show(self.time, 'time', 2)}. Check the zero of the cell, do more cycles before those that count, and "
            "ramp more slowly"
        )


@dataclass(frozen=True, eq=False)
class _Tried:
    """A spring of 1 N/m in one cell with each of the time constants, shape (k,), and what the cycles allow of it."""

    counts: NDArray[np.bool_]
    """Whether it is neither too fast nor too slow for the cell."""
    most: Array
    """K_1 [N/m]; inf where the cycles do not show it."""
    stiffness: Array
    force: Array
    """Shape (k, n)."""
    gap: Array
    damping: Array
    seen: bool


def creeps_of(cells: Sequence[Cell]) -> list[Creep | None]:
    """What creep may be in each cell; None where its cycles do not show it, as one alone.

    A cell that is tested after others moves about the same middle, to which the end of the spring has come. What they
    allow, as a share of the stiffness, holds for it too, but for a factor.
    """
    if not cells:
        return []
    spans = np.array([_span(cell) for cell in cells])
    times = np.geomspace(spans[:, 0].min(), spans[:, 1].max(), TRIED)
    tried = [_tried(cell, times, *span) for cell, span in zip(cells, spans.tolist(), strict=True)]
    shares = [one.most / max(abs(cell.straight), 1e-9) for cell, one in zip(cells, tried, strict=True)]
    return [_creep(cell, one, times, np.min(shares, axis=0)) for cell, one in zip(cells, tried, strict=True)]


def _creep(cell: Cell, one: _Tried, times: Array, least: Array) -> Creep | None:
    """`least` is the lowest share of the stiffness that any cell allows, shape (k,)."""
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
    """The least and the largest time constant [s] that are tried for a cell."""
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
        # one of each sign: its first
        together = joined(dict(reversed(known)).values())
        most[k] = min((spring.most for spring in [*(one for _, one in known), *together]), default=np.inf)
        seen |= any(sign != DOME and counts[k] and spring.seen for sign, spring in known)
    gaps = np.array([(two - one).mean(axis=1)[:, cell.x.size // 2] for one, two in pulls])
    speeds = [member.speed for member in cell.members]
    damping, gap = (np.zeros(len(times)), gaps.max(axis=0)) if cell.one_speed else np.polyfit(speeds, gaps, 1)
    force = np.mean([0.5 * (one + two).mean(axis=1) for one, two in pulls], axis=0)
    return _Tried(counts, most, units[STIFFNESS].mean(axis=1), force, gap, damping / 2, seen)


def _columns(cell: Cell, slow: bool) -> Iterator[tuple[int, Sequence[Array]]]:
    """A sign and what else may change it, shape (cycles,) each.

    Each trial has a force of its own. The stiffness may also rise with the speed, by a pressure that moves; two speeds
    cannot distinguish that from creep. The dome is a parabola where creep is slower than any ramp (`slow`).
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
    """Times [s] and contractions [m] between which the free end moves in straight lines, until the trial is over."""
    knots: list[tuple[float, float]] = []
    for trial in member.run.trials:
        if knots and len(trial.t) and trial.t[0] < knots[-1][0] - LATE:
            knots = []  # a clock of its own
        ramps = [c for c in trial.commands if c.output == "displacement" and c.kind == "ramp"]
        for c, next_one in zip(ramps, [*ramps[1:], None], strict=True):
            later = float(trial.t[-1]) if next_one is None else next_one.t
            knots += [(c.t, c.before), (ends(c) if c.data.get("rate", 0.0) > 0 else later, c.value)]
        if trial.name == member.trial.name:
            break
    t, x = np.array(knots).T
    return np.maximum.accumulate(t), x


def _behind(path: tuple[Array, Array], times: Array, at: Array) -> Array:
    """How far the end of each spring is behind, x - e [m], at moments [s]: exact, and 0 where the path begins.

    `times`, shape (k,), are the time constants; shape (k, *shape of `at`).
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
    """Both branches of a spring of 1 N/m with each time constant, as those of a loop [N], shape (k, cycles, n)."""
    path, loop = _path(member), member.loop
    lower, upper = loop.ends
    begins, turns = loop.moments[:, :1], loop.moments[:, 1:2]
    moments = begins + (cell.x - lower) / loop.speed, turns + (upper - cell.x) / loop.speed
    return -_behind(path, times, moments[0]), -_behind(path, times, moments[1])


def _signs(cell: Cell, loops: Sequence[tuple[Array, Array]]) -> tuple[Array, Array, Array]:
    """Mean force [N], stiffness [N/m] and dome of the gap [N] of the cycles of all loops, shape (k, cycles)."""
    place, inner = cell.opened
    means = np.concatenate([0.5 * (contracting + expanding) for contracting, expanding in loops], axis=1)
    gaps = np.concatenate([expanding - contracting for contracting, expanding in loops], axis=1)[..., inner]
    shape = means.shape[:2]
    slopes = np.polyfit(cell.x, means.reshape(-1, len(cell.x)).T, 1)[0].reshape(shape)
    domes = np.polyfit(place[inner], gaps.reshape(-1, int(inner.sum())).T, 2)[0].reshape(shape)
    return means.mean(axis=2), -slopes, domes


ONE_SIDE = 0.95
"""Probability below the most: only that side is open."""


@dataclass(frozen=True)
class Bound:
    """A size, and its standard error times Student's t for `ONE_SIDE` and for `SURE`; what is left [square]."""

    size: float
    open: float
    sure: float
    left: float = 0.0
    likely: float = 1.0
    """Another form is as likely that leaves up to so many times as much."""

    @property
    def most(self) -> float:
        """The largest size that is allowed; what is seen the other way may hide as much."""
        return max(self.size, 0.0) + self.open if self.size > -self.sure else self.open - self.size

    @property
    def seen(self) -> bool:
        """Whether it is significant."""
        return self.size > self.sure


def bound_of(columns: Sequence[Array], unit: Array, shown: Array, exact: bool = False) -> Bound | None:
    """How many times `unit` is in what is `shown`, next to `columns`, shape (n,) each; None if unknown.

    Without `exact` that is where as many are shown as are asked for, so that nothing says how sure they are: with it
    it may be as much again, and is not significant.
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
    """The mean of several by the squares of their errors."""
    if len(bounds) > 1 and min(bound.open for bound in bounds) > 0:
        weights = np.array([bound.open**-2 for bound in bounds])
        mean = float(weights @ [bound.size for bound in bounds] / weights.sum())
        yield Bound(mean, float(weights.sum() ** -0.5), float(np.sum([one.sure**-2 for one in bounds]) ** -0.5))
