"""One sweep of a joint: its loop, the stiffness of its cycles, and what its record shows against them."""

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
"""Share of the sweep that is left out at each end in the first evaluation."""
HALF_SWEEP = 4.0
"""Smallest half sweep, in w: after a shorter one the turn has not decayed at mid sweep."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """One usable trial: its loop, the stiffness of its cycles [N m/rad], and the effect of the turns on it."""

    run: RunData
    trial: TrialData
    loop: Loop
    stiffness: Array
    taken_off: float
    """Change of the stiffness by the correction for the rest of the turns [N m/rad]."""
    second: Turns | None
    """Slower transition of the torque after a turn; None if not significant."""
    kept: Kept
    flank: float
    """Step of the torque at its change of sign, because of backlash [N m]; 0 if not significant."""
    apart: Array
    """Pressures while the angle falls minus while it rises [Pa], shape (cycles, 2)."""


def sweep_of(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Sweep:
    """Evaluation of one trial; raises `NotUsable`, with the sufficient size for a sweep that is too small."""
    low, high = (trial.point.get(name) for name in ("lowest_angle", "highest_angle"))
    if low is None or high is None:
        raise NotUsable("its plan names no lowest and highest angle, so its turns are not known")
    loop = measure(run, trial, int(settings_of(run, options).get("discard", 1)), TURN * (high - low), AXES)
    half, gap = 0.5 * (high - low), float(loop.middle_gap.mean())
    noise = float(np.sqrt(0.5 * np.mean(np.diff(loop.gap, axis=1) ** 2)))  # of one point, by its neighbours
    if why := why_no_turns(loop.turns, half, gap, noise):
        raise NotUsable(why)
    if loop.turns is not None and half < HALF_SWEEP * loop.turns.w:
        least, w = show(HALF_SWEEP * loop.turns.w, "angle", 3), show(loop.turns.w, "angle", 3)
        raise NotUsable(
            f"the sweep of +-{show(half, 'angle', 3)} is too small for the hysteresis: a turn fades on {w}, 3 of which "
            f"are cut after each turn, and mid sweep must lie one more beyond them; sweep at least +-{least}"
        )
    stiffness, plain = _slopes(loop), _slopes(loop, keep=True)
    kept, apart = _by_commands(run, trial, len(loop.gap))
    taken_off = abs(float(stiffness.mean() - plain.mean()))
    step = flank(loop.x, loop.contracting.mean(axis=0), loop.expanding.mean(axis=0), loop.ends, loop.turns)
    return Sweep(run, trial, loop, stiffness, taken_off, second_of(loop), kept, step, apart)


def flatter_by(one: Sweep) -> float:
    """Decrease of the stiffness at mid sweep by a step of the torque at its change of sign [N m/rad]."""
    x = one.loop.x - one.loop.x.mean()
    return abs(one.flank * float(np.polyfit(x, np.sign(one.loop.mean.mean(axis=0)), 3)[2]))


def _by_commands(run: RunData, trial: TrialData, cycles: int) -> tuple[Kept, Array]:
    """Deviation of pressures and angle from their commands; pressures while falling minus while rising, (cycles, 2).

    Over the last `cycles`. A lag of the drive cancels between both directions.
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
"""Widths of the first turn that are tried together with a second one, relative to that found without it."""
SLOWER = 1.5
"""Smallest ratio of the second width to the first."""
TRIED = 24
SURE = 4.0
"""Standard deviations by which a second turn must describe the gap better than a parabola."""


def second_of(loop: Loop) -> Turns | None:
    """A slower transition in the gap after turns: a second hysteresis, or creep; None if not significant.

    A gap that depends on the angle, or on pressures that depend on it, has another form: a parabola and a slope.
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
    """Increase of the stiffness at mid sweep by a second turn [N m/rad]."""
    half = 0.5 * (second.upper - second.lower)
    return 2 * second.h / second.w * float(np.exp(-half / second.w) / (1 + np.exp(-2 * half / second.w)))


def _slopes(loop: Loop, *, keep: bool = False) -> Array:
    """Stiffness of each cycle [N m/rad], mean of its branches; with `keep` without correction for the rest of the
    turns.
    """
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
