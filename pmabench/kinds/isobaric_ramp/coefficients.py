"""Coefficients of one pressure and stroke: K, F_ce, force and stiffness from the mean curve; H, F_c, B and work from
the gap.

A late force, backlash, drift and creep widen their intervals or withhold them (`judged`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import hypot, inf, isnan

import numpy as np

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt, cut_off, half_steps, weighed
from pmabench.analysis.shared.lines import PROPORTIONAL, mean_of_cycles
from pmabench.analysis.shared.ramp_loop import Loop
from pmabench.analysis.shared.samples import lag_open
from pmabench.base.quantities import show
from pmabench.kinds.isobaric_ramp.cell import (
    CURVE,
    GAP,
    LOCAL,
    OF_MEAN,
    ONE_SPEED,
    RAW,
    Cell,
    each_local,
)
from pmabench.kinds.isobaric_ramp.creep import Creep, bound_of
from pmabench.store.analyses.results import Estimate, Parts, withhold
from pmabench.store.records import Array

BENT_NOTE = "the mean curve is bent: the interval reaches to the slope at any place of the stroke"
AT_SPEED = "one speed only: the two dampings may differ, so that the force at rest may be anywhere in the gap"
IN_A_RAMP = "one speed only: nothing shows what creeps in less than a ramp, and K holds some of it"
RECOVERED = "of isobaric cycles: work given while contracting, over work taken up while expanding; air is not measured"
"""Definition of eta, where it is reported."""


def of_curve(cell: Cell, scales: Scales, near: Cell | None) -> list[Estimate]:
    """K and F_ce of the mean curve, its force and stiffness along the stroke.

    Calibration to first order: forces ~ F, K ~ F/x, and the error of the contraction and pressure for which they are
    given. An error of the contraction also moves the turns, whose effect is taken off. `near`: the cell of the next
    pressure, None without another pressure.
    """
    x = cell.x
    lower, upper = cell.ends
    found, turned = list[Estimate](), cell.turned(scales.offsets.get("displacement", 0.0))

    def estimate(
        symbol: str, kind: tuple[str, str], method: str, of: Callable[[Loop], Array], over_P: float | None, *,
        place: float | None = None, extra: float = 0.0, note: str = "",
    ) -> None:  # fmt: skip
        line, force = cell.over_speed(of), symbol != "K"
        over_x = 0.0 if place is None else cell.over_x(place)[0 if force else 1]
        gains = {"force": line.start, "displacement": over_x * (place or 0.0) - (0.0 if force else line.start)}
        offsets = {"force": 1.0 if force else 0.0, "displacement": over_x}
        part = cell.part(scales, gains, offsets, over_P)
        if by_place := max((abs(float(of(other).mean() - of(loop).mean())) for loop, other in turned), default=0.0):
            part = hypot(part or 0.0, by_place)
        alone = (AT_SPEED if force else IN_A_RAMP) if cell.one_speed and method in OF_MEAN else ""
        within = abs(cell.gap.start) / 2 if alone and force else 0.0
        off = cell.off_command(line.start, over_P, force=force)
        parts = Parts(line.half_start, hypot(extra, within, off), part, 0.0)
        at = cell.at if method != LOCAL else {**cell.at, "contraction": round(float(place or 0.0), 7)}
        found.append(cell.estimate(symbol, line.start, kind, method, at, parts, sentences(note, alone)))

    newton, stiffness = ("N", "force"), ("N/m", "stiffness")
    by_turns = cell.of_turns(lambda curve: float(np.polyfit(x, curve, 1)[0]))
    kinds = [(CURVE, lambda loop: loop.mean), (RAW, lambda loop: loop.raw_mean)]
    for method, curve in kinds if any(m.loop.turns is not None for m in cell.members) else kinds[:1]:
        if cell.many_slopes:
            found.append(cell.estimate("K", None, stiffness, method, cell.at, Parts(), cell.many_slopes))
        else:
            estimate(
                "K", stiffness, method, lambda loop, of=curve: -np.polyfit(x, of(loop).T, 1)[0],  # type: ignore[misc]
                cell.over_pressure(near, lambda cell: -cell.straight),
                extra=hypot(cell.change, by_turns, cell.slow_turns(0.0)[1]), note=BENT_NOTE if cell.bent else "",
            )  # fmt: skip
        if lower <= 0 <= upper and cell.pressure > 0:
            estimate(
                "F_ce", newton, method, lambda loop, of=curve: each_local(x, of(loop), 0.0)[0],  # type: ignore[misc]
                cell.over_pressure(near, lambda cell: cell.force_at(0.0)), place=0.0,
                extra=cell.window_error(0.0)[0], note="force of the mean curve at x = 0",
            )  # fmt: skip
    for place in cell.places:
        error = cell.window_error(place)
        for i, (symbol, kind) in enumerate((("F", newton), ("K", stiffness))):

            def here(x: Array, curves: Array, place: float = place, i: int = i) -> Array:
                return (1 - 2 * i) * each_local(x, curves, place)[i]

            over_P = cell.over_pressure(near, lambda cell, of=here: float(of(cell.x, cell.curve[None])[0]))  # type: ignore[misc]
            estimate(
                symbol, kind, LOCAL, lambda loop, of=here: of(x, loop.mean), over_P, place=place, extra=error[i]  # type: ignore[misc]
            )  # fmt: skip
    return found


GUESSED = 1.5
"""Factor by which dF/dP may exceed F/P, which is used where only one pressure was tested."""
CYCLES = "one trial a speed: the repeats part is the scatter of its cycles, and repeated tests may scatter more"
SHRINKS = (
    "a gap that shrinks as the speed rises is no damping: what creeps in about the time of a ramp, or a friction that "
    "falls with the speed, makes part of it, and creep also of the slope of the mean curve. Ramp more slowly, and more "
    "quickly, until the gap changes no more"
)
TWO_SPEEDS = "two speeds only: nothing shows whether the friction falls with the speed, which is not all damping then"
_Row = tuple[str, tuple[str, str], Callable[[Loop], Array], tuple[str, ...], float, float]
"""Symbol; unit and quantity; value by cycle; channels to which it is proportional; method and skew part."""


def of_gap(cell: Cell, scales: Scales, near: Cell | None) -> list[Estimate]:
    """Gap and work; `near` as in `of_curve`.

    Calibration to first order: forces ~ F, work ~ F x, and the error of the contraction and pressure for which they are
    given.
    """
    K, dF_dP = abs(cell.straight), cell.over_pressure(near, lambda cell: cell.force_at(cell.middle))
    uneven = _uneven(cell, dF_dP)
    lines = _gap_lines(cell, scales, K, uneven, _rising(cell, dF_dP), near)
    return [*lines, *_work(cell, scales, K, uneven, near)]


def _work(cell: Cell, scales: Scales, K: float, uneven: float, near: Cell | None) -> Iterator[Estimate]:
    """Gap and work at each speed, and the share of the work that is recovered; `uneven` is the result of `_uneven`."""
    stroke, newton, joule = cell.stroke, ("N", "force"), ("J", "work")
    for speed in sorted({member.speed for member in cell.members}):
        mine = [member for member in cell.members if member.speed == speed]
        here, note = {**cell.at, "speed": speed}, CYCLES if len(mine) == 1 else ""
        late = 2 * K * speed * cell.skew
        work = ("force", "displacement")
        # at a turn the force changes by the gap, somewhere between two samples
        corners = max(2 * abs(float(m.loop.middle_gap.mean())) * speed / m.run.rate for m in mine)
        # motion to a turn and back between two samples is not recorded: at most half a sample at either end
        unseen = max(abs(float(m.loop.given.mean())) / stroke * speed / m.run.rate for m in mine)
        rows: tuple[_Row, ...] = (
            ("H", newton, lambda loop: loop.middle_gap, ("force",), uneven, late),
            ("W", joule, lambda loop: loop.lost, work, uneven * stroke + corners, late * stroke),
            ("W_c", joule, lambda loop: loop.given, work, unseen, 0.5 * late * stroke),
        )
        for symbol, kind, of, by, extra, skewed in rows:
            value, half = mean_of_cycles([of(member.loop) for member in mine])
            over_P = cell.over_pressure(near, lambda cell, of=of: cell.over_speed(of).start)  # type: ignore[misc]
            offsets = {"force": stroke if symbol == "W_c" else 0.0}
            part = cell.part(scales, dict.fromkeys(by, value), offsets, over_P)
            off = cell.off_command(cell.highest * stroke if symbol == "W_c" else value, over_P)
            parts = Parts(half, hypot(extra, off), part, skewed)
            yield cell.estimate(symbol, value, kind, GAP, here, parts, note, len(mine))
        each = [m.loop.given + m.loop.lost for m in mine]
        taken = float(np.mean([np.mean(one) for one in each]))
        if min(float(np.min(one)) for one in each) > 0:  # without pressure it may take up no work
            value, half = mean_of_cycles([m.loop.given / one for m, one in zip(mine, each, strict=True)])
            part = scales.part({}, {"force": stroke * (1 - value) / taken})
            given = (1 - value) * off / taken  # `off` is that of W_c
            parts = Parts(half, hypot((uneven * stroke + corners) / taken, given), part, late * stroke / taken)
            said = sentences(note, RECOVERED)
            yield cell.estimate("eta", value, ("1", "ratio"), GAP, here, parts, said, len(mine))


def _gap_lines(cell: Cell, scales: Scales, K: float, uneven: float, rising: float, near: Cell | None) -> list[Estimate]:
    """Hysteresis at speed 0, and damping from the slope over speed; `rising` [N.s/m] is the slope due to unequal
    pressure.
    """
    newton, damping = ("N", "force"), ("N.s/m", "damping")
    still = {**cell.at, "speed": 0.0}
    if cell.one_speed:
        return [
            cell.estimate("H", None, newton, GAP, still, Parts(), ONE_SPEED),
            cell.estimate("B", None, damping, GAP, cell.at, Parts(), ONE_SPEED),
        ]
    line, few = cell.gap, TWO_SPEEDS if len({member.speed for member in cell.members}) == 2 else ""
    start, slope = line.start, line.slope
    start_P = cell.over_pressure(near, lambda cell: cell.gap.start)
    slope_P = cell.over_pressure(near, lambda cell: cell.gap.slope)
    force = cell.part(scales, {"force": start}, {}, start_P)
    note = "gap at speed 0: true hysteresis"
    method = hypot(uneven, cell.off_command(start, start_P))
    H = cell.estimate("H", start, newton, GAP, still, Parts(line.half_start, method, force), note)
    gains = {"force": slope / 2, "displacement": -slope / 2}
    both = cell.part(scales, gains, {}, None if slope_P is None else slope_P / 2)
    low, high = cell.speeds
    least = PROPORTIONAL * abs(start) / (high - low) / 2
    off = cell.off_command(slope, slope_P) / 2
    parts = Parts(_halved(line.half_slope), hypot(least, rising / 2, off), both, K * cell.skew)
    B = cell.estimate("B", slope / 2, damping, GAP, cell.at, parts, sentences("(B_c + B_r)/2", few))
    friction, said = Parts(_halved(line.half_start), method / 2, _halved(force)), "half the gap at speed 0"
    F_c = cell.estimate("F_c", start / 2, newton, GAP, cell.at, friction, sentences(said, few))
    most = inf if B.value is None else B.value + (B.parts.combined or inf)
    why = f"B would be below {show(most, 'damping', 2)}; {SHRINKS}"
    return [H, B, F_c] if most >= 0 else [withhold(e, why) for e in (H, B, F_c)]


def _halved(half: float | None) -> float | None:
    return None if half is None else half / 2


def _uneven(cell: Cell, dF_dP: float | None) -> float:
    """Part of the gap that unequal pressure in the two branches may cause [N]."""
    apart = max((abs(m.loop.apart) for m in cell.members if not isnan(m.loop.apart)), default=0.0)
    return apart * cell.force_per_pressure(dF_dP)


def _rising(cell: Cell, dF_dP: float | None) -> float:
    """Increase with speed of the gap that unequal pressure in the branches may cause [N.s/m]."""
    known = [(m.speed, m.loop.apart) for m in cell.members if not isnan(m.loop.apart)]
    if cell.one_speed or len({speed for speed, _ in known}) < 2:
        return 0.0
    speeds, aparts = np.array(known).T
    guessed = GUESSED if dF_dP is None else 1.0
    return guessed * abs(float(np.polyfit(speeds, aparts, 1)[0])) * cell.force_per_pressure(dF_dP)


UPSIDE_DOWN = (
    "the force is larger while contracting than while expanding, and no muscle gives work back like that: look for a "
    "wrong sign, or force and displacement that are apart in time"
)
FALLS = 0.04
"""Share of the friction that its decrease with speed may add to it unnoticed at two speeds; more of them show it."""


def judged(cell: Cell, found: list[Estimate], creep: Creep | None) -> list[Estimate]:
    """The estimates, widened or withheld for possible errors."""
    if cell.upside_down:
        return [withhold(e, UPSIDE_DOWN) if e.value is not None else e for e in found]
    late, falls = _late(cell), _falls(cell)
    half = half_steps([(member.run, member.trial) for member in cell.members], ("force", "displacement"))
    level = cut_off(half, {"force": 1.0, "displacement": cell.straight})
    if shrinks := next((e.note for e in found if e.symbol == "F_c" and SHRINKS in e.note), ""):
        found = [withhold(e, shrinks) if e.method in OF_MEAN and e.value is not None else e for e in found]
    return [weighed(e, _doubts(cell, e, late, creep, falls, level)) for e in found]


def _doubts(
    cell: Cell, e: Estimate, late: Doubt, creep: Creep | None, falls: tuple[float, float, bool], level: Doubt
) -> list[Doubt]:
    """Effects of a late force, backlash, drift, creep and friction on an estimate `e`; the other arguments are of its
    cell.
    """
    K, stroke = abs(cell.straight), cell.stroke  # K converts a time times a speed into a force
    slowest, still = cell.speeds[0], e.at.get("speed") == 0
    gap = 2 * K * (e.at.get("speed", 0.0) or slowest) * late.half
    # with backlash the zero of a displacement is uncertain by half of it either way; the turns show part of it
    play = gap / 3 if late.seen else 0.0
    uneven = 0.5 * max(m.loop.uneven_drift for m in cell.members)
    whole = max(m.loop.whole_drift for m in cell.members)
    given = float(np.mean([np.mean(m.loop.given) for m in cell.members])) / stroke
    # backlash makes the measured stroke shorter by it, with a gap of K times the backlash
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
            "H": creep.gap if still else 0.0,
        }.get(e.symbol, 0.0)  # fmt: skip
        # local values have wide intervals; those that are wider without creep cover it, too
        withheld = e.method in (CURVE, RAW) and by_creep > (e.parts.combined or 0.0)
        reason = creep.reason if withheld else ""
        found.append(Doubt("creep", "method", by_creep, creep.seen, reason))
    friction, damping, seen = falls
    by_fall = {"F_c": friction, "H": 2 * friction if still else 0.0, "B": damping}.get(e.symbol, 0.0)
    found.append(Doubt("friction that falls with the speed", "method", by_fall, seen))
    return [*found, *([level] if e.symbol in ("F", "F_ce") else [])]


def _late(cell: Cell) -> Doubt:
    """Possible delay of the force [s], by the turns of the slowest loops, or by turns that grow longer with speed."""
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


def _falls(cell: Cell) -> tuple[float, float, bool]:
    """Errors of F_c [N] and B [N.s/m] because of friction that decreases with speed; whether the gap over the speed is
    bent by it.

    F_c is for motion. A bent gap is less steep at high speed than at low, by up to the error of B.
    """
    gaps = [member.loop.middle_gap / 2 for member in cell.members]
    speeds = np.repeat([member.speed for member in cell.members], [len(one) for one in gaps])
    each, more = np.concatenate(gaps), len(set(speeds.tolist())) - 1
    bent = bound_of([np.ones(len(speeds)), speeds], speeds**2, each) if more > 1 else None
    if bent is not None and bent.seen:
        damping = abs(float(np.polyfit(speeds, each, 2)[1]) - cell.gap.slope / 2)
        return damping * cell.speeds[1], damping, True
    friction = FALLS / max(more, 1) * abs(cell.gap.start) / 2
    return friction, friction / cell.speeds[1], False
