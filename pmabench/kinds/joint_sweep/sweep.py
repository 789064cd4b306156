"""One sweep of a joint: its loop, the stiffness of its cycles, and what its record says against them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmabench.analysis.shared.joint import AXES, CUT, MUSCLES, Kept, flank, why_no_turns
from pmabench.analysis.shared.lines import left_by
from pmabench.analysis.shared.ramp_loop import Loop, Turns, fading, measure
from pmabench.analysis.shared.samples import NotUsable, ends, on_time, settings_of
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

TURN = 0.02
"""Share of the sweep that is left out at each end before anything is looked at."""
HALF_SWEEP = 4.0
"""Least half sweep, in w: of a shorter one a branch would not be itself at mid sweep."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """One usable trial: its loop, the stiffness of its cycles [N m/rad], and by how much the turns matter there."""

    run: RunData
    trial: TrialData
    loop: Loop
    stiffness: Array
    taken_off: float
    """What taking off the rest of the turns changed [N m/rad]."""
    second: Turns | None
    """What else of the torque turns over after a turn, on a longer way; None where that does not show."""
    kept: Kept
    flank: float
    """Step of the torque where it changes its sign, as play makes it [N m]; 0 where none shows."""
    apart: Array
    """Pressures while the angle falls less those while it rises [Pa], shape (cycles, 2)."""


class OffForm(NotUsable):
    """A sweep whose loop has another form than the reduction needs: something is wrong at its operating point."""


def sweep_of(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Sweep:
    """One trial measured; raises `NotUsable`, for a sweep that is too small with what would be enough."""
    low, high = (trial.point.get(name) for name in ("lowest_angle", "highest_angle"))
    if low is None or high is None:
        raise NotUsable("its plan names no lowest and highest angle, so its turns are not known")
    loop = measure(run, trial, int(settings_of(run, options).get("discard", 1)), TURN * (high - low), AXES)
    half, gap = 0.5 * (high - low), float(loop.middle_gap.mean())
    noise = float(np.sqrt(0.5 * np.mean(np.diff(loop.gap, axis=1) ** 2)))  # of a point, as neighbours differ
    if why := why_no_turns(loop.turns, half, gap, noise):
        raise OffForm(why)
    if loop.turns is not None and half < HALF_SWEEP * loop.turns.w:
        least, w = show(HALF_SWEEP * loop.turns.w, "angle", 3), show(loop.turns.w, "angle", 3)
        raise OffForm(
            f"the sweep of +-{show(half, 'angle', 3)} is too small for the hysteresis: a turn fades on {w}, 3 of which "
            f"are cut after each turn, and mid sweep must lie one more beyond them; sweep at least +-{least}"
        )
    stiffness, plain = _slopes(loop), _slopes(loop, keep=True)
    kept, apart = _by_commands(run, trial, len(loop.gap))
    taken_off = abs(float(stiffness.mean() - plain.mean()))
    step = flank(loop.x, loop.contracting.mean(axis=0), loop.expanding.mean(axis=0), loop.ends, loop.turns)
    return Sweep(run, trial, loop, stiffness, taken_off, second_of(loop), kept, step, apart)


def flatter_by(one: Sweep) -> float:
    """What a step of the torque where it changes its sign takes off the stiffness at mid sweep [N m/rad]."""
    x = one.loop.x - one.loop.x.mean()
    return abs(one.flank * float(np.polyfit(x, np.sign(one.loop.mean.mean(axis=0)), 3)[2]))


def _by_commands(run: RunData, trial: TrialData, cycles: int) -> tuple[Kept, Array]:
    """How far pressures and angle are from their commands; pressures while falling less while rising, (cycles, 2).

    Of the last `cycles`. A drive that follows late is as far behind on one way as on the other.
    """
    moves = [c for c in trial.commands if c.output == AXES.moved and c.phase in (AXES.rises, AXES.falls)]
    angle, *pressures = (on_time(run, trial, name) for name in (AXES.moved, *MUSCLES))
    means, lines = [], []
    for ramp in moves[-2 * cycles :]:
        rows = (trial.t >= ramp.t) & (trial.t < ends(ramp)) & trial.usable
        way = (trial.t[rows] - ramp.t) / (ends(ramp) - ramp.t)
        wanted = ramp.before + (ramp.value - ramp.before) * way
        means.append([float(P[rows].mean()) for P in pressures])
        lines.append(np.polyfit(wanted, angle[rows] - wanted, 1))
    each, (scale, zero) = np.array(means), np.mean(lines, axis=0)
    off = each.mean(axis=0) - [trial.point[name] for name in MUSCLES]
    return Kept(off, float(zero), float(scale)), each[1::2] - each[::2]


SHORTER, LONGER = 0.4, 1.3
"""Widths of the turns that are tried next to a second one, in those that were found without it."""
SLOWER = 1.5
"""A second way is at least so many times the first."""
TRIED = 24
SURE = 4.0
"""Standard deviations by which the second turn must describe the gap better than a parabola does."""


def second_of(loop: Loop) -> Turns | None:
    """What in the gap turns over on a longer way, too: a second hysteresis, or what creeps.

    A gap that depends on the angle, or on pressures that do, has another form: a parabola and a slope.
    """
    if loop.turns is None:
        return None
    x, gap, (lower, upper) = loop.x, loop.gap.mean(axis=0), loop.ends
    z, one = (2 * x - lower - upper) / (upper - lower), np.ones_like(x)
    first = loop.turns.w * np.geomspace(SHORTER, LONGER, TRIED)
    longer = np.geomspace(SLOWER * loop.turns.w, upper - lower, TRIED)
    fades = {w: np.sum(fading(x, lower, upper, w), axis=0) for w in (*first, *longer)}
    pairs = [(w, v) for w in first for v in longer if v >= SLOWER * w]
    curved = left_by(np.stack([one, z, z**2]), np.array([[fades[w]] for w in first]), gap).min()
    left = left_by(np.stack([one, z]), np.array([[fades[w], fades[v]] for w, v in pairs]), gap)
    variance = float(left.min()) / (len(x) - 6)
    w, v = pairs[int(np.argmin(left))]
    terms, *_ = np.linalg.lstsq(np.column_stack([one, z, fades[w], fades[v]]), gap, rcond=None)
    h = -float(terms[3])
    if h <= 0 or curved - left.min() <= SURE**2 * variance:
        return None
    return Turns(h, v, lower, upper, float(np.sqrt(variance)))


def steeper_by(second: Turns) -> float:
    """What a second turn adds to the stiffness at mid sweep [N m/rad]."""
    half = 0.5 * (second.upper - second.lower)
    return 2 * second.h / second.w * float(np.exp(-half / second.w) / (1 + np.exp(-2 * half / second.w)))


def _slopes(loop: Loop, *, keep: bool = False) -> Array:
    """Stiffness of each cycle [N m/rad], the mean of its two branches; with `keep` the rest of the turns stays in."""
    x, turns, (lower, upper) = loop.x, loop.turns, loop.ends
    cut, rising, falling = 0.0 if turns is None else CUT * turns.w, np.zeros_like(x), np.zeros_like(x)
    if turns is not None and not keep:
        first, second = fading(x, lower, upper, turns.w)
        rising, falling = turns.h * first, -turns.h * second
    found = []
    for branches, way, rest in ((loop.contracting, x - lower, rising), (loop.expanding, upper - x, falling)):
        kept = way >= cut
        found.append(-np.polyfit(x[kept] - 0.5 * (x[0] + x[-1]), (branches - rest)[:, kept].T, 3)[2])
    return np.asarray(np.mean(found, axis=0))
