"""Finds changes in the middle of a file: columns that are exchanged, and changes of gain or offset; arrays only.

They show that one part of a file is wrong, but not which: nothing is flagged, and results of the file are withheld.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import sqrt

import numpy as np

from pmabench.base.quantities import show
from pmabench.store.importers import motion
from pmabench.store.importers.found import Bools, Checked, Report, in_words, slope
from pmabench.store.records import Array


def edge(side: int) -> Array:
    """Weights, shape (2 side,), for a convolution that gives the jump of samples in the middle of a window.

    The jump is the difference of straight lines through the second and the first half, both evaluated at the middle.
    """
    k = np.arange(side) + 0.5
    at = 1.0 / side - (k - k.mean()) * k.mean() / float(((k - k.mean()) ** 2).sum())
    return np.asarray(np.concatenate([at[::-1], -at]))  # convolution reverses the weights


SIDE = 20
"""Number of samples on either side of a change that are compared."""
EDGE = edge(SIDE)
"""Weights for the jump between lines through both sides."""
ALONE = 3.0
"""A change must be this many times larger than the fourth largest of the file."""
JUMP = 0.03
"""Smallest change, as a share of the channel's span."""
CANDIDATES = 3
MOMENT = 0.5
"""Time before and after a jump that shows whether the pressure was moving [s]."""
FRICTION = 0.15
"""Largest jump of a force at a reversal of the pressure that friction may cause, as a share of its span."""
SHARP = 0.5
"""Least share of a change that must happen from one sample to the next."""
SAME = 0.25
"""Two columns are exchanged if each continues with the other's numbers, within this share of the jump."""
FAR, STRAIGHT = 60, 0.97
"""Number of samples on either side of a crossing that give the slope, and least correlation for that."""
CROSSINGS = 200
"""Largest number of crossings of two columns that are examined."""
LEVER = 0.4
"""Least change of the logarithm of the slope at an exchange."""
CYCLES = 4
"""Least number of cycles for a comparison of gains."""
GAIN = 0.06
"""Least relative change of gain between cycles that is reported [1]; it must also exceed `SCATTER` / 2 times the range
of the gains within either part."""
SCATTER = 5.0
SETTLES = 0.25
"""Largest change [1] that is allowed for the first or the last cycle alone, as of a muscle that had rested."""


def swapped(report: Report, channels: Sequence[Checked], good: Bools) -> bool:
    """Report where two columns are exchanged from some row on; returns whether any are. `good`: mask, shape (n,)."""
    rows = np.flatnonzero(good)
    if len(rows) < 4 * SIDE:
        return False
    numbers = {c.rule.role: c.numbers[rows] for c in channels}
    found = False
    for a, b in combinations(numbers, 2):
        if "command" in a + b and not {a, b} <= {"pressure_command", "displacement_command"}:
            continue
        at = _exchanges(numbers[a], numbers[b]) or _crossings(numbers[a], numbers[b])
        if not at:
            continue
        found = True
        text = f"{a} and {b} exchange their numbers"
        text += f", {len(at)} times, first" if len(at) > 1 else ""
        text += f": {a} goes from {numbers[a][at[0] - 1]:.4g} to {numbers[a][at[0]]:.4g}"
        text += f", {b} from {numbers[b][at[0] - 1]:.4g} to {numbers[b][at[0]]:.4g}"
        text += "; which part is right no rule can say: mend the columns, or cut the file there, and import it again"
        report.withhold("swap", text, a, int(rows[at[0]]))
    return found


def _exchanges(a: Array, b: Array) -> list[int]:
    """Rows at which `a` and `b`, both of shape (n,), continue with each other's numbers."""
    step = np.abs(np.diff(a)) + np.abs(np.diff(b))
    crossed = np.abs(a[1:] - b[:-1]) + np.abs(b[1:] - a[:-1])
    size = float(np.quantile(np.abs(a - b), 0.9))
    likely = np.flatnonzero((crossed < SAME * step) & (step > 0.1 * size)) + 1
    found: list[int] = []
    for at in likely[(likely >= 3) & (likely + 3 <= len(a))].tolist():
        side = slice(max(0, at - SIDE), at), slice(at, at + SIDE)
        others = [np.abs(np.diff(x[s])).max() for x in (a, b) for s in side]
        (a0, a1), (b0, b1) = ([float(np.median(x[s])) for s in side] for x in (a, b))
        leap = min(abs(a[at] - a[at - 1]), abs(b[at] - b[at - 1]))
        if leap > ALONE * max(others) and abs(a1 - b0) + abs(b1 - a0) < abs(a1 - a0) + abs(b1 - b0):
            found.append(at)
    return found


def _crossings(a: Array, b: Array) -> list[int]:
    """Rows at which `a` and `b` cross without a jump and the slope of one over the other is inverted."""
    below = a < b
    near = np.flatnonzero(below[1:] != below[:-1]) + 1
    near = near[np.diff(near, prepend=-SIDE) >= SIDE][:CROSSINGS]
    found: list[int] = []
    for at in near[(near >= FAR) & (near + FAR <= len(a))].tolist():
        sides = [(a[part], b[part]) for part in (slice(at - FAR, at - 2), slice(at + 2, at + FAR))]
        if any(np.ptp(x) == 0 or np.ptp(y) == 0 for x, y in sides):
            continue
        if min(float(np.corrcoef(x, y)[0, 1]) for x, y in sides) < STRAIGHT:
            continue
        before, after = (float(np.log(np.std(y) / np.std(x))) for x, y in sides)
        if abs(before - after) > LEVER and abs(before + after) < SAME * abs(before - after):
            found.append(at)
    return found


def jumped(report: Report, channel: Checked, pressure: Checked, good: Bools, follows: bool) -> bool:
    """Report lasting jumps of a channel relative to pressure between two samples; returns whether there are any.

    `follows`: the channel follows pressure without delay, as the force of a held muscle; otherwise only jumps at
    constant pressure count.
    """
    rows = np.flatnonzero(good)
    if len(rows) < 6 * SIDE:
        return False
    y, p = channel.si[rows], pressure.si[rows]
    span, range_p = (float(np.ptp(np.quantile(v, [0.002, 0.998]))) for v in (y, p))
    if span <= 0 or range_p <= 0:
        return False
    gain = abs(slope(p, y) or 0.0) if follows else 0.0
    leaps = [np.convolve(v, EDGE, mode="valid") for v in (y, p)]  # jump at the middle of each window
    step = np.maximum(np.abs(leaps[0]) - gain * np.abs(leaps[1]), gain * np.abs(leaps[1]) - np.abs(leaps[0]))
    steps, usual = np.diff(report.t[rows], prepend=report.t[rows[0]]), float(np.median(np.diff(report.t[rows])))
    step[np.convolve(steps > SIDE * usual, np.ones(2 * SIDE), mode="valid") > 0.5] = 0.0  # it may have moved in a gap
    wide = max(SIDE, int(MOMENT / max(usual, 1e-9)))
    peaks = _peaks(step, 2 * SIDE)
    if len(peaks) <= CANDIDATES:
        return False
    level = max(float(step[peaks[CANDIDATES]]), 0.0)
    found = False
    for peak in peaks[:CANDIDATES]:
        near = np.arange(peak + SIDE - 2, peak + SIDE + 3)
        sharp = np.abs(np.diff(y)[near - 1]) / span, np.abs(np.diff(p)[near - 1]) / range_p
        of = 0 if sharp[0].max() > sharp[1].max() else 1
        who, row = (channel.rule.role, "pressure")[of], near[np.argmax(sharp[of])]
        alone = abs(sharp[0][row - near[0]] - sharp[1][row - near[0]])
        size = float(leaps[0][peak])
        if step[peak] < max(JUMP * span, ALONE * level) or alone < SHARP * step[peak] / span:
            continue
        if not follows and float(np.abs(np.diff(p[max(0, row - SIDE) : row + SIDE])).max()) > 0.02 * range_p:
            continue
        both = float(leaps[0][peak]) / span, float(leaps[1][peak]) / range_p
        if follows and step[peak] < FRICTION * span and _friction(y, p, (int(row), wide), both):
            continue
        found = True
        sides = [slope(p[part], y[part]) for part in (slice(None, row), slice(row, None))] if follows else None
        _report_jump(report, channel, (size, who), sides, int(rows[row]))
    return found


def _friction(y: Array, pressure: Array, place: tuple[int, int], leaps: tuple[float, float]) -> bool:
    """Whether friction may cause a jump at `place` (row, width in samples); `leaps`: jumps of `y` and pressure [spans].

    It may where the pressure reverses or begins to move, where it is set in steps, or where there is no force yet.
    """
    row, wide = place
    before, after = (slice(max(0, row - wide), row), slice(row, row + wide))
    span = float(np.ptp(pressure))
    rates = [float(pressure[part][-1] - pressure[part][0]) for part in (before, after)]
    turns = abs(rates[1]) > 0.01 * span and rates[0] * float(np.sign(rates[1])) < 0.2 * abs(rates[1])
    slack = float(np.median(y[before])) < float(y.min()) + 0.1 * float(np.ptp(y))
    rests = min(abs(rate) for rate in rates) < 0.01 * span
    steps = abs(leaps[1]) > 0.02 and (rests or leaps[0] / leaps[1] > 0.3)
    return turns or slack or steps


def _peaks(values: Array, apart: int) -> list[int]:
    """Indices of the largest values, at least `apart` from larger ones; up to one more than `CANDIDATES`."""
    left = values.copy()
    found: list[int] = []
    while len(found) <= CANDIDATES:
        place = int(np.argmax(left))
        if left[place] < 0:
            break
        found.append(place)
        left[max(0, place - apart) : place + apart + 1] = -1.0
    return found


def _report_jump(
    report: Report, channel: Checked, jump: tuple[float, str], sides: Sequence[float | None] | None, row: int
) -> None:
    """Report a jump (size [SI], role of the channel that jumped) at a row.

    `sides`: slopes over pressure before and after; None where only jumps at rest are searched.
    """
    role = channel.rule.role
    text = f"leaps by {show(jump[0], channel.rule.quantity, 3)} from one sample to the next"
    if sides is None:
        report.add("doubt", "jump", f"{text} while the pressure rests: it slipped, or its zero changed", role, row)
        return
    found = [in_words(side, role) for side in sides if side is not None]
    slopes = f"; slope over pressure {found[0]} before, {found[1]} after" if len(found) == 2 else ""
    text = f"against pressure {role} {text}{slopes}; the gain or the zero of {jump[1]} changed, or something slipped: "
    report.withhold("jump", f"{text}cut the file there and import the part that is right", jump[1], row)


def regained(report: Report, channel: Checked, pressure: Checked, good: Bools) -> bool:
    """Report where the slope over pressure changes permanently between two cycles; returns whether it does."""
    rows = np.flatnonzero(good & motion.later(report.t))
    if len(rows) < CYCLES * SIDE:
        return False
    t, p, y = report.t[rows], pressure.si[rows], channel.si[rows]
    stride = max(1, len(rows) // 50_000)
    t, p, y = t[::stride], p[::stride], y[::stride]
    gains, begins = [], []
    for cycle in motion.cycles(t, p, 0.3 * float(np.ptp(np.quantile(p, [0.002, 0.998])))):
        inside = (t >= cycle.begin) & (t <= cycle.turn)
        if inside.sum() < SIDE:
            continue
        low, size = float(p[inside].min()), float(np.ptp(p[inside]))
        inside &= (np.abs(p - low - 0.5 * size) < 0.4 * size) & (y > y.min() + 0.2 * float(np.ptp(y[inside])))
        if inside.sum() < SIDE or np.corrcoef(p[inside], y[inside])[0, 1] < STRAIGHT:
            continue
        if (gain := slope(p[inside], y[inside]) or 0.0) > 0:
            gains.append(gain)
            begins.append(cycle.begin)
    if len(gains) < CYCLES:
        return False
    logs, n = np.log(gains), len(gains)
    # the means before and after it differ most, weighted with the numbers of cycles
    best = max(range(1, n), key=lambda k: float(abs(logs[:k].mean() - logs[k:].mean())) * sqrt(k * (n - k)))
    change = float(np.median(logs[best:]) - np.median(logs[:best]))
    within = max(float(np.ptp(part)) if len(part) > 1 else 0.0 for part in (logs[:best], logs[best:]))
    allowed = SETTLES if best in (1, n - 1) else GAIN
    if abs(np.expm1(change)) < allowed or abs(change) < SCATTER * within / 2.0:
        return False
    role = channel.rule.role
    before, after = (in_words(float(np.exp(np.median(part))), role) for part in (logs[:best], logs[best:]))
    text = f"slope over pressure {before} in {best} cycle{'' if best == 1 else 's'}, {after} in the {n - best} "
    text += f"after it ({np.expm1(change):+.1%}): a gain was changed in mid-file; import the part that is right"
    at = int(np.searchsorted(t, begins[best])) * stride
    report.withhold("gain", text, role, int(rows[min(at, len(rows) - 1)]))
    return True
