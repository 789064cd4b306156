"""What a late force, backlash, a drift and creep do to the values of one pressure and stroke: wider, or withheld."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmabench.analysis.shared.form import Doubt, cut_off, half_steps, weighed
from pmabench.analysis.shared.samples import lag_open
from pmabench.kinds.isobaric_ramp.cell import CURVE, OF_MEAN, RAW, Cell
from pmabench.kinds.isobaric_ramp.coefficients import SHRINKS
from pmabench.kinds.isobaric_ramp.creep import Creep, bound_of
from pmabench.store.analyses.results import Estimate, withhold

UPSIDE_DOWN = (
    "the force is larger while contracting than while expanding, and no muscle gives work back like that: look for a "
    "wrong sign, or force and displacement that are apart in time"
)
CREEPS = (
    "as the speed rises the gap shrinks at mid stroke more than near its ends: what creeps in about the time of a ramp "
    "makes part of it, and of the slope of the mean curve. Ramp more slowly, and more quickly, until neither changes"
)
UNIFORM = 0.5
"""Share of what the gap shrinks by at mid stroke that it shrinks less by near the ends: three quarters or all by creep,
none by friction."""
FALLS = 0.05
"""Share of the friction at rest that may fade unseen as the speed rises: two speeds show no more than a line."""
FADING = 8
"""Speeds that are tried over which it fades as an exponential, from half the lowest to half the highest: on a longer
way its fall is a line, and part of B."""


def judged(cell: Cell, found: list[Estimate], creep: Creep | None) -> list[Estimate]:
    """The values with what may be wrong of them in their intervals, or withheld."""
    if cell.upside_down:
        return [withhold(e, UPSIDE_DOWN) if e.value is not None else e for e in found]
    late, falls = _late(cell), _falls(cell)
    half = half_steps([(member.run, member.trial) for member in cell.members], ("force", "displacement"))
    level = cut_off(half, {"force": 1.0, "displacement": cell.straight})

    def doubts(e: Estimate) -> list[Doubt]:
        at_level = [level] if e.symbol in ("F", "F_ce") else []
        return [*_doubts(cell, e, late, creep), *_of_falls(e, *falls), *at_level]

    return [weighed(e, doubts(e)) for e in _without_creep(cell, found)]


def _doubts(cell: Cell, e: Estimate, late: Doubt, creep: Creep | None) -> list[Doubt]:
    """What a late force, backlash and a drift do to an estimate; `late` and `creep` are of the cell."""
    K, stroke = abs(cell.straight), cell.stroke  # K turns times into forces
    slowest, _ = cell.speeds
    gap = 2 * K * (e.at.get("speed", 0.0) or slowest) * late.half
    # the zero of a displacement with play is anywhere within it: half of it either way, and turns show a part of it
    play = gap / 3 if late.seen else 0.0
    uneven = 0.5 * max(m.loop.uneven_drift for m in cell.members)
    whole = max(m.loop.whole_drift for m in cell.members)
    given = float(np.mean([np.mean(m.loop.given) for m in cell.members])) / stroke
    # a displacement with play reads a stroke that is shorter by it, with a gap of K times the play
    widest = max(float(np.max(np.abs(m.loop.middle_gap))) for m in cell.members) / max(K, 1e-9)
    unread = min((1.0 if late.seen else 0.5) * slowest * late.half, widest)  # unseen, any part is as likely
    taken = max(float(np.mean([np.mean(m.loop.given + m.loop.lost) for m in cell.members])), 1e-9)
    effects = {
        "H": (gap, uneven), "F_c": (gap / 2, uneven / 2), "B": (K * late.half, 0.0), "K": (0.0, uneven / stroke),
        "W": (gap * stroke, uneven * stroke), "W_c": (gap * stroke / 2 + abs(given) * unread, whole * stroke),
        "eta": (gap * stroke / taken, uneven * stroke / taken), "F": (play, whole), "F_ce": (play, whole),
    }  # fmt: skip
    by_time, by_drift = effects.get(e.symbol, (0.0, 0.0))
    found = [replace(late, half=by_time), Doubt("drift", "drift", by_drift, False)]
    if creep is not None:
        place = e.at.get("contraction", cell.middle if e.symbol == "F" else 0.0)
        by_creep = {
            "K": creep.stiffness, "F": float(np.interp(place, cell.x, creep.force)), "F_c": creep.gap / 2,
            "F_ce": float(np.interp(place, cell.x, creep.force)), "B": creep.damping,
            "H": creep.gap if e.at.get("speed") == 0 else 0.0,
        }.get(e.symbol, 0.0)  # fmt: skip
        # values at a place have wide intervals, and any that is wider without creep holds it, too
        withheld = e.method in (CURVE, RAW) and by_creep > (e.parts.combined or 0.0)
        reason = creep.reason if withheld else ""
        found.append(Doubt("creep", "method", by_creep, creep.seen, reason))
    return found


def _late(cell: Cell) -> Doubt:
    """Time by which the force may come late [s], by turns of the slowest loops, or where turns fade over time."""
    slowest, _ = cell.speeds
    known = [m.loop.late for m in cell.members if m.speed == slowest]
    worst, half = max(known, key=lambda one: (one.seen, one.half)), float(np.mean([one.half for one in known]))
    late = replace(worst, half=half)
    faded = [(m.speed, m.loop.turns.w) for m in cell.members if m.loop.turns is not None]
    if cell.one_speed or len({speed for speed, _ in faded}) < 2:
        return late
    speeds, ways = np.array(faded).T
    longer = float(np.polyfit(speeds, ways, 1)[0])
    if longer <= max(lag_open(m.run, "force") for m in cell.members):
        return late
    reason = (
        f"the faster the motion, the longer the way on which its turns fade, by {1e3 * longer:.2g} ms: the force "
        "comes through a filter, which looks like damping; declare the `sensor_lag` of the force cell"
    )
    return replace(late, half=max(late.half, 2 * longer), seen=True, reason=reason)


def _without_creep(cell: Cell, found: list[Estimate]) -> list[Estimate]:
    """Without what the mean curve gives, where creep makes part of the gap and of its slope."""
    shrinks = any(e.symbol == "F_c" and SHRINKS in e.note for e in found)
    if not (shrinks and _shrinks_by_creep(cell)):
        return found
    return [withhold(e, CREEPS) if e.method in OF_MEAN and e.value is not None else e for e in found]


def _shrinks_by_creep(cell: Cell) -> bool:
    """Whether a gap that shrinks as the speed rises does so at mid stroke, and less near the ends.

    What creeps makes a gap that is 0 at both turns, and a mean curve that is too steep. Friction that falls with
    the speed takes as much of the gap everywhere. It is alike in both directions, whatever it changes with, and
    a displacement that lags or has play moves the mean curve as a whole: they leave K as it is.
    """
    place, inner = cell.opened
    dome = cell.over_speed(lambda loop: np.polyfit(place[inner], loop.gap[:, inner].T, 2)[0])
    return dome.slope > max(dome.half_slope or 0.0, -UNIFORM * cell.gap.slope)


def _of_falls(e: Estimate, friction: Doubt, damping: Doubt) -> list[Doubt]:
    if e.symbol == "B":
        return [damping]
    if e.symbol == "F_c" or (e.symbol == "H" and e.at.get("speed") == 0):
        return [friction if e.symbol == "F_c" else replace(friction, half=2 * friction.half)]
    return []


def _falls(cell: Cell) -> tuple[Doubt, Doubt]:
    """What a friction that falls with the speed does to F_c [N] and B [N.s/m], as far as the gaps allow.

    F_c is that of a muscle in motion: it is off by the start of a line through the most of c exp(-v/u) that is allowed.
    """
    gaps = [member.loop.middle_gap / 2 for member in cell.members]
    speeds = np.repeat([member.speed for member in cell.members], [len(one) for one in gaps])
    design, friction, damping, seen = np.column_stack([np.ones(len(speeds)), speeds]), 0.0, 0.0, False
    units = [np.exp(-speeds / u) for u in np.geomspace(0.5 * speeds.min(), 0.5 * speeds.max(), FADING)]
    unseen = FALLS * abs(cell.gap.start) / 2
    found = [] if cell.one_speed else [(unit, unseen) for unit in units]
    if len(set(speeds.tolist())) > 2:
        bounds = [bound_of([*design.T], unit, np.concatenate(gaps)) for unit in units]
        known = [(unit, bound) for unit, bound in zip(units, bounds, strict=True) if bound is not None]
        least = min((bound.left for _, bound in known), default=0.0)
        seen = any(bound.seen for _, bound in known)
        likely = [(unit, bound.most) for unit, bound in known if bound.left <= bound.likely * least]
        found = [(unit, most if seen else min(most, unseen)) for unit, most in likely]
    for unit, most in found:
        start, slope = most * np.linalg.lstsq(design, unit, rcond=None)[0]
        friction, damping = max(friction, start), max(damping, abs(slope))
    text = "friction that falls with the speed"
    return Doubt(text, "method", friction, seen), Doubt(text, "method", damping, seen)
