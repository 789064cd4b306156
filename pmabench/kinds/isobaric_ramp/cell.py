"""The loops of one pressure and stroke at all their speeds: mean curve, stiffness, gap, work, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot, inf, isfinite, isnan, log
from typing import Any

import numpy as np

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.lines import PROPORTIONAL, Line, mean_of_cycles, weighted_line
from pmabench.analysis.shared.ramp_loop import Loop
from pmabench.analysis.shared.samples import lag_open
from pmabench.analysis.shared.sine_loop import RECOVERED
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import Array, RunData, TrialData

CURVE, RAW, LOCAL = OF_MEAN = "mean-curve", "mean-curve, turns left in", "mean-curve, local"
GAP, MEAN_GAP, OPEN = "loop-gap", "loop-gap, mean over the stroke", "loop-gap, open loop"
PLACES = 5
"""Places along the stroke at which force and stiffness are given."""
WINDOW = 0.06
"""Half width of the cubic through the mean curve for force and slope at a place, as a share of the stroke."""
BENT = 0.02
"""Rms of the mean curve about a straight line, as a share of its range, that is worth a sentence."""
BENT_NOTE = "the mean curve is bent: the interval reaches to the slope at any place of the stroke"
UNEVEN = 0.05
"""Share of the gap that unequal pressure of the branches may be worth before it is doubted."""
GUESSED = 1.5
"""dF/dP may be so many times F/P, which is taken where one pressure was tested."""
LEFT_OF_TURNS = 0.4
"""Share of what taking off the turns changes that may still be in a value: they need not fade as an exponential.

Those of a Bouc-Wen muscle left four tenths. Where they are not taken off, as something else in the gap is larger, all
may be left.
"""
SLOW_TURNS = 0.2
"""Share of the hysteresis that may fade over most of the stroke: the gap does not show it, and it adds to the slope.
In a fluidic muscle, described by stops of several widths, a fifth of it has a reach of 16 mm."""
SLOW_REACH = 0.75
"""Share of the stroke over which that fades: on a shorter way the gap shows it, on a longer one it adds less."""
UPSIDE_DOWN = (
    "the force is larger while contracting than while expanding, and no muscle gives work back like that: look for a "
    "wrong sign, or force and displacement that are apart in time"
)
LONGEST_TRACE = 1500
BETWEEN = "displacement and force"
CYCLES = "one trial a speed: the repeats part is the scatter of its cycles, and repeated tests may scatter more"
NO_REPEATS = "no repeats part: too few loops"
SHRINKS = (
    "a gap that shrinks as the speed rises is no damping: what creeps in about the time of a ramp, or a friction that "
    "falls with the speed, makes part of it. Ramp more slowly, and more quickly, until the gap changes no more"
)
CREEPS = (
    "as the speed rises the gap shrinks at mid stroke more than near its ends: what creeps in about the time of a ramp "
    "makes part of it, and of the slope of the mean curve. Ramp more slowly, and more quickly, until neither changes"
)
UNIFORM = 0.5
"""Share of what the gap shrinks by at mid stroke that it shrinks less by near the ends: three quarters or all by creep,
none by friction."""
OPENED = 0.7
"""Share of the stroke, about its middle, in which turns have faded."""
STEEPER = 5e-4
"""Share by which a mean curve is steeper at the highest speed than at the lowest at least, where a muscle creeps."""
CREPT = 3.0
"""What creeps makes a gap of pi/2 times the stroke times what the slope grows by with the logarithm of the speed, where
many time constants do (local Kramers-Kronig relation, Booij and Thoone 1982); one alone makes up to twice that."""
ONE_SPEED = "one speed only: hysteresis and damping cannot be separated"
AT_SPEED = "one speed only: the two dampings may differ, so that the force at rest may be anywhere in the gap"


@dataclass(frozen=True, eq=False)
class Member:
    """One usable trial, measured."""

    run: RunData
    trial: TrialData
    loop: Loop

    @property
    def speed(self) -> float:
        """As it was asked for [m/s]."""
        return float(self.trial.point.get("speed", self.loop.speed))


@dataclass(frozen=True, eq=False)
class Cell:
    """All trials of one pressure and stroke; `x` [m] is what of the grid all of them reach, shape (n,)."""

    at: Mapping[str, float]
    members: Sequence[Member]
    x: Array
    skew: float
    """Bound on the time between displacement and force [s]."""

    @classmethod
    def of(cls, at: Mapping[str, float], members: Sequence[Member]) -> Cell:
        """Crop the loops to what all of them reach."""
        x = members[0].loop.x
        for member in members[1:]:
            x = x[np.isin(np.round(x, 9), np.round(member.loop.x, 9))]
        known = [member for member in members if member.loop.turns is not None]
        slowest = min(known, key=lambda m: m.speed).loop.turns if known else None
        # hysteresis knows no rate: where the turns do not show they are those of the slowest loop
        loops = [m.loop if m.loop.turns is not None else replace(m.loop, turns=slowest) for m in members]
        if len(x):
            loops = [loop.cropped(x) for loop in loops]
        cropped = [Member(m.run, m.trial, loop) for m, loop in zip(members, loops, strict=True)]
        apart = skew.apart([m.run for m in members], ("displacement", "force"))
        return cls(at, cropped, x if len(x) else members[0].loop.x, apart)

    @property
    def pressure(self) -> float:
        """Set pressure [Pa]."""
        return self.at["pressure"]

    @property
    def middle(self) -> float:
        """[m]."""
        return float(0.5 * (self.x[0] + self.x[-1]))

    @property
    def one_speed(self) -> bool:
        """Whether all trials have the same speed."""
        return len({member.speed for member in self.members}) == 1

    def over_speed(self, of: Callable[[Loop], Array]) -> Line:
        """The line of a quantity of shape (cycles,) over speed; at one speed its mean, without a slope.

        Intervals by the scatter of trials or by that of cycles, if wider.
        """
        values = [of(member.loop) for member in self.members]
        speeds = np.array([member.speed for member in self.members])
        if self.one_speed:
            mean, half = mean_of_cycles(values)
            return Line(mean, float("nan"), half, None)
        by_trial = weighted_line(speeds, speeds, np.array([float(np.mean(v)) for v in values]))
        each = np.repeat(speeds, [len(v) for v in values])
        by_cycle = weighted_line(each, each, np.concatenate(values))
        pairs = ((by_trial.half_start, by_cycle.half_start), (by_trial.half_slope, by_cycle.half_slope))
        wider = (max((half for half in pair if half is not None), default=None) for pair in pairs)
        return Line(by_trial.start, by_trial.slope, *wider)

    @cached_property
    def gap(self) -> Line:
        """Of the gap at mid stroke [N] over speed."""
        return self.over_speed(lambda loop: loop.middle_gap)

    @cached_property
    def curve(self) -> Array:
        """Mean curve at speed 0 (at the only speed, where there is one) [N], shape (n,)."""
        speeds = np.array([member.speed for member in self.members])
        means = np.array([member.loop.mean.mean(axis=0) for member in self.members])
        if self.one_speed:
            return np.asarray(means.mean(axis=0))
        design = np.column_stack([np.ones_like(speeds), speeds])
        return np.asarray(np.linalg.lstsq(design, means, rcond=None)[0][0])

    def force_at(self, x: float) -> float:
        """Of the mean curve [N] at a contraction [m]."""
        return _local(self.x, self.curve, x)[0]

    @property
    def bent(self) -> bool:
        """Whether the mean curve is no straight line."""
        left = self.curve - np.polyval(np.polyfit(self.x, self.curve, 1), self.x)
        return bool(np.sqrt(np.mean(left**2)) > BENT * np.ptp(self.curve))

    @cached_property
    def straight(self) -> float:
        """Slope of a straight line through the mean curve [N/m]."""
        return float(np.polyfit(self.x, self.curve, 1)[0])

    @property
    def change(self) -> float:
        """How far the slope anywhere on a bent mean curve is from that of the straight line [N/m]; 0 for no bend."""
        if not self.bent:
            return 0.0
        slopes = {place: _local(self.x, self.curve, place)[1] for place in self.places}
        return max(float(abs(s - self.straight)) + self._window_error(p)[1] for p, s in slopes.items())

    @property
    def places(self) -> list[float]:
        """Places along the stroke at which force and stiffness are given [m]."""
        return [float(place) for place in np.linspace(self.x[0], self.x[-1], PLACES)]

    @cached_property
    def many_slopes(self) -> str:
        """Why no one stiffness describes the stroke: its slopes differ as much as their mean; empty where one does."""
        if self.change < abs(self.straight):
            return ""
        local = [-_local(self.x, self.curve, place)[1] for place in self.places]
        ends = " to ".join(show(K, "stiffness", 3) for K in (min(local), max(local)))
        return f"the mean curve is bent, K is {ends} along the stroke: it is given at each contraction instead"

    @cached_property
    def _shrinks_by_creep(self) -> bool:
        """Whether a gap that shrinks as the speed rises does so at mid stroke, and less near the ends.

        What creeps makes a gap that is 0 at both turns, and a mean curve that is too steep. Friction that falls with
        the speed takes as much of the gap everywhere. It is alike in both directions, whatever it changes with, and
        a displacement that lags or has play moves the mean curve as a whole: they leave K as it is.
        """
        place = (self.x - self.middle) / (0.5 * np.ptp(self.x))
        inner = np.abs(place) < OPENED
        dome = self.over_speed(lambda loop: np.polyfit(place[inner], loop.gap[:, inner].T, 2)[0])
        return dome.slope > max(dome.half_slope or 0.0, -UNIFORM * self.gap.slope)

    @cached_property
    def _creep(self) -> float:
        """What the slope of the mean curve grows by with the logarithm of the speed [N/m]; 0 where that is not seen."""
        line = self.over_speed(lambda loop: -np.polyfit(self.x, loop.mean.T, 1)[0])
        low, high = self._speeds
        seen = (line.slope - (line.half_slope or 0.0)) * (high - low) > STEEPER * abs(self.straight)
        return line.slope * (high - low) / log(high / low) if seen else 0.0

    @property
    def _speeds(self) -> tuple[float, float]:
        """The lowest and the highest [m/s]."""
        speeds = [member.speed for member in self.members]
        return min(speeds), max(speeds)

    @property
    def upside_down(self) -> bool:
        """Whether the contracting branch is the upper one, by more than scatter."""
        return any(
            float(m.loop.middle_gap.mean()) < -max(2 * float(m.loop.middle_gap.std()), 0.5 * m.loop.noise, 1e-6)
            for m in self.members
        )

    # -- estimates ------------------------------------------------------------------------------------------------

    def estimates(self, scales: Scales, near: Cell | None) -> list[Estimate]:
        """K and F_ce of the mean curve, its force and stiffness along the stroke, gap and work.

        Calibration, to first order: forces ~ F, K ~ F/x, work ~ F x; all are given for a contraction and a pressure
        that may be off, too. `near`: the cell of the pressure next to this one, None without another pressure.
        """
        x = self.x
        lower = min(m.trial.point.get("lower", x[0]) for m in self.members)
        upper = max(m.trial.point.get("upper", x[-1]) for m in self.members)
        found: list[Estimate] = []

        def estimate(
            symbol: str, kind: tuple[str, str], method: str, of: Callable[[Loop], Array], over_P: float | None, *,
            place: float | None = None, extra: float = 0.0, note: str = "",
        ) -> None:  # fmt: skip
            line, force = self.over_speed(of), symbol != "K"
            over_x = 0.0 if place is None else self._over_x(place)[0 if force else 1]
            gains = {"force": line.start, "displacement": over_x * (place or 0.0) - (0.0 if force else line.start)}
            offsets = {"force": 1.0 if force else 0.0, "displacement": over_x}
            part = self._part(scales, gains, offsets, over_P)
            alone = AT_SPEED if self.one_speed and method in OF_MEAN and force else ""
            within = abs(self.gap.start) / 2 if alone else 0.0
            parts = Parts(line.half_start, hypot(extra, within), part, 0.0)
            at = self.at if method != LOCAL else {**self.at, "contraction": round(float(place or 0.0), 7)}
            found.append(self._estimate(symbol, line.start, kind, method, at, parts, sentences(note, alone)))

        newton, stiffness = ("N", "force"), ("N/m", "stiffness")
        dF_dP = self._over_pressure(near, lambda cell: cell.force_at(self.middle))
        uneven = self._uneven(dF_dP)
        by_turns = self._of_turns(lambda curve: float(np.polyfit(x, curve, 1)[0]))
        kinds = [(CURVE, lambda loop: loop.mean), (RAW, lambda loop: loop.raw_mean)]
        for method, curve in kinds if any(m.loop.turns is not None for m in self.members) else kinds[:1]:
            if self.many_slopes:
                found.append(self._estimate("K", None, stiffness, method, self.at, Parts(), self.many_slopes))
            else:
                estimate(
                    "K", stiffness, method, lambda loop, of=curve: -np.polyfit(x, of(loop).T, 1)[0],  # type: ignore[misc]
                    self._over_pressure(near, lambda cell: -cell.straight),
                    extra=hypot(self.change, by_turns, self._slow_turns(0.0)[1]), note=BENT_NOTE if self.bent else "",
                )  # fmt: skip
            if lower <= 0 <= upper and self.pressure > 0:
                estimate(
                    "F_ce", newton, method, lambda loop, of=curve: _locals(x, of(loop), 0.0)[0],  # type: ignore[misc]
                    self._over_pressure(near, lambda cell: cell.force_at(0.0)), place=0.0,
                    extra=self._window_error(0.0)[0], note="force of the mean curve at x = 0",
                )  # fmt: skip
        for place in self.places:
            error = self._window_error(place)
            for i, (symbol, kind) in enumerate((("F", newton), ("K", stiffness))):

                def here(x: Array, curves: Array, place: float = place, i: int = i) -> Array:
                    return (1 - 2 * i) * _locals(x, curves, place)[i]

                over_P = self._over_pressure(near, lambda cell, of=here: float(of(cell.x, cell.curve[None])[0]))  # type: ignore[misc]
                estimate(
                    symbol, kind, LOCAL, lambda loop, of=here: of(x, loop.mean), over_P, place=place, extra=error[i]  # type: ignore[misc]
                )  # fmt: skip
        K = abs(self.straight)
        found += self._gap_lines(scales, K, uneven, self._rising(dF_dP), near)
        found += self._work(scales, K, uneven, float(upper - lower), near)
        found = self._without_creep(found)
        if self.upside_down:
            return [withhold(e, UPSIDE_DOWN) if e.value is not None else e for e in found]
        return [weighed(e, self._doubts(e, K, float(upper - lower))) for e in found]

    def _without_creep(self, found: list[Estimate]) -> list[Estimate]:
        """Without what the mean curve gives, where creep makes part of the gap and of its slope."""
        shrinks = any(e.symbol == "F_c" and SHRINKS in e.note for e in found)
        if not (shrinks and self._shrinks_by_creep):
            return found
        return [withhold(e, CREEPS) if e.method in OF_MEAN and e.value is not None else e for e in found]

    def _over_pressure(self, near: Cell | None, of: Callable[[Cell], float]) -> float | None:
        """Change of a number of the cell with the pressure [per Pa]; None without another pressure at its middle."""
        if near is None or not near.x[0] <= self.middle <= near.x[-1]:
            return None
        change = (of(near) - of(self)) / (near.pressure - self.pressure)
        return change if isfinite(change) else None

    def _over_x(self, place: float) -> tuple[float, float]:
        """Change of the force [N/m] and of the stiffness [N/m2] of the mean curve with the contraction."""
        _, bend, slope, _ = np.polyfit(self.x - place, self.curve, 3)
        return float(slope), -2 * float(bend)

    def _part(
        self, scales: Scales, gains: Mapping[str, float], offsets: Mapping[str, float], over_P: float | None
    ) -> float | None:
        """The calibration part of a value that changes by `over_P` [per Pa] with the pressure for which it is given."""
        if over_P is not None and self.pressure > 0:
            gains, offsets = {**gains, "pressure": over_P * self.pressure}, {**offsets, "pressure": over_P}
        return scales.part(*({k: v for k, v in one.items() if v} for one in (gains, offsets)))

    def _doubts(self, e: Estimate, K: float, stroke: float) -> list[Doubt]:
        """What a late force, backlash and a drift do to an estimate; `K` [N/m] turns times into forces."""
        late, (slowest, fastest) = self._late, self._speeds
        gap = 2 * K * (e.at.get("speed", 0.0) or slowest) * late.half
        # the zero of a displacement with play is anywhere within it: half of it either way, and turns show a part of it
        play = gap / 3 if late.seen else 0.0
        uneven = 0.5 * max(m.loop.uneven_drift for m in self.members)
        whole = max(m.loop.whole_drift for m in self.members)
        taken = max(float(np.mean([np.mean(m.loop.given + m.loop.lost) for m in self.members])), 1e-9)
        effects = {
            "H": (gap, uneven), "F_c": (gap / 2, uneven / 2), "B": (K * late.half, 0.0), "K": (0.0, uneven / stroke),
            "W": (gap * stroke, uneven * stroke), "W_c": (gap * stroke / 2, whole * stroke),
            "eta": (gap * stroke / taken, uneven * stroke / taken), "F": (play, whole), "F_ce": (play, whole),
        }  # fmt: skip
        by_time, by_drift = effects.get(e.symbol, (0.0, 0.0))
        found = [replace(late, half=by_time), Doubt("drift", "drift", by_drift, False)]
        if self._creep and (e.symbol in ("F_c", "B") or e.at.get("speed") == 0):
            share = {"F_c": 0.5, "B": 0.5 / (fastest - slowest)}.get(e.symbol, 1.0)
            found.append(Doubt("creep", "method", share * CREPT * self._creep * stroke, seen=True))
        return found

    @cached_property
    def _late(self) -> Doubt:
        """Time by which the force may come late [s], by turns of the slowest loops, or where turns fade over time."""
        slowest, _ = self._speeds
        known = [m.loop.late for m in self.members if m.speed == slowest]
        worst, half = max(known, key=lambda one: (one.seen, one.half)), float(np.mean([one.half for one in known]))
        late = replace(worst, half=half)
        faded = [(m.speed, m.loop.turns.w) for m in self.members if m.loop.turns is not None]
        if self.one_speed or len({speed for speed, _ in faded}) < 2:
            return late
        speeds, ways = np.array(faded).T
        longer = float(np.polyfit(speeds, ways, 1)[0])
        if longer <= max(lag_open(m.run, "force") for m in self.members):
            return late
        reason = (
            f"the faster the motion, the longer the way on which its turns fade, by {1e3 * longer:.2g} ms: the force "
            "comes through a filter, which looks like damping; declare the `sensor_lag` of the force cell"
        )
        return replace(late, half=max(late.half, 2 * longer), seen=True, reason=reason)

    def _work(self, scales: Scales, K: float, uneven: float, stroke: float, near: Cell | None) -> Iterator[Estimate]:
        """Gap and work at each speed, and the share of the work that comes back; `uneven` as `_uneven` gives it."""
        newton, joule = ("N", "force"), ("J", "work")
        for speed in sorted({member.speed for member in self.members}):
            mine = [member for member in self.members if member.speed == speed]
            here, note = {**self.at, "speed": speed}, CYCLES if len(mine) == 1 else ""
            late = 2 * K * speed * self.skew
            work = ("force", "displacement")
            # between the two samples at a turn the force jumps by the gap, somewhere on the way between them
            corners = max(2 * abs(float(m.loop.middle_gap.mean())) * speed / m.run.rate for m in mine)
            # and what is gone on the way to a turn and back between two samples is not seen: half of it at either end
            unseen = max(abs(float(m.loop.given.mean())) / stroke * speed / m.run.rate for m in mine)
            rows: tuple[_Row, ...] = (
                ("H", newton, lambda loop: loop.middle_gap, ("force",), uneven, late),
                ("W", joule, lambda loop: loop.lost, work, uneven * stroke + corners, late * stroke),
                ("W_c", joule, lambda loop: loop.given, work, unseen, 0.5 * late * stroke),
            )
            for symbol, kind, of, by, extra, skewed in rows:
                value, half = mean_of_cycles([of(member.loop) for member in mine])
                over_P = self._over_pressure(near, lambda cell, of=of: cell.over_speed(of).start)  # type: ignore[misc]
                offsets = {"force": stroke if symbol == "W_c" else 0.0}
                part = self._part(scales, dict.fromkeys(by, value), offsets, over_P)
                parts = Parts(half, extra, part, skewed)
                yield self._estimate(symbol, value, kind, GAP, here, parts, note, len(mine))
            each = [m.loop.given + m.loop.lost for m in mine]
            taken = float(np.mean([np.mean(one) for one in each]))
            if min(float(np.min(one)) for one in each) > 0:  # unpressed, it may take up nothing
                value, half = mean_of_cycles([m.loop.given / one for m, one in zip(mine, each, strict=True)])
                part = scales.part({}, {"force": stroke * (1 - value) / taken})
                parts = Parts(half, (uneven * stroke + corners) / taken, part, late * stroke / taken)
                said = sentences(note, RECOVERED)
                yield self._estimate("eta", value, ("1", "ratio"), GAP, here, parts, said, len(mine))

    def _gap_lines(self, scales: Scales, K: float, uneven: float, rising: float, near: Cell | None) -> list[Estimate]:
        """Hysteresis at speed 0, and what rises with speed; `rising` [N.s/m] is what unequal pressure makes of that."""
        newton, damping = ("N", "force"), ("N.s/m", "damping")
        still = {**self.at, "speed": 0.0}
        found = []
        ways: dict[str, Callable[[Loop], Array]]
        ways = {GAP: lambda loop: loop.middle_gap, MEAN_GAP: lambda loop: loop.mean_gap}
        if all(member.loop.turns is not None for member in self.members):  # one open gap for all cycles of a loop
            ways[OPEN] = lambda loop: np.full(1, 2 * loop.turns.h if loop.turns is not None else np.nan)
        for method, of in ways.items():
            line = self.over_speed(of)
            if self.one_speed:
                found.append(self._estimate("H", None, newton, method, still, Parts(), ONE_SPEED))
                found.append(self._estimate("B", None, damping, method, self.at, Parts(), ONE_SPEED))
                continue
            start, slope = line.start, line.slope
            start_P, slope_P = (
                self._over_pressure(near, lambda cell, of=of, name=name: float(getattr(cell.over_speed(of), name)))  # type: ignore[misc]
                for name in ("start", "slope")
            )
            force = self._part(scales, {"force": start}, {}, start_P)
            note = "gap at speed 0: true hysteresis"
            H = self._estimate("H", start, newton, method, still, Parts(line.half_start, uneven, force), note)
            gains = {"force": slope / 2, "displacement": -slope / 2}
            both = self._part(scales, gains, {}, None if slope_P is None else slope_P / 2)
            low, high = self._speeds
            least = PROPORTIONAL * abs(start) / (high - low) / 2
            parts = Parts(_halved(line.half_slope), hypot(least, rising / 2), both, K * self.skew)
            B = self._estimate("B", slope / 2, damping, method, self.at, parts, "(B_c + B_r)/2")
            friction = Parts(_halved(line.half_start), uneven / 2, _halved(force))
            F_c = self._estimate("F_c", start / 2, newton, method, self.at, friction, "half the gap at speed 0")
            found += [H, B, F_c]
        least = min((e.value + (e.parts.combined or inf) for e in found if e.symbol == "B" and e.value), default=0.0)
        why = f"B would be below {show(least, 'damping', 2)}; {SHRINKS}"
        return found if least >= 0 else [withhold(e, why) for e in found]

    def _estimate(
        self, symbol: str, value: float | None, kind: tuple[str, str], method: str, at: Mapping[str, float],
        parts: Parts, note: str, n: int | None = None,
    ) -> Estimate:  # fmt: skip
        trials = tuple(member.trial.name for member in self.members if "speed" not in at or n is None
                       or member.speed == at["speed"])  # fmt: skip
        if value is not None and parts.repeats is None:
            note = sentences(NO_REPEATS, note)
        found = Estimate(symbol, value, *kind, method, dict(at), parts, len(trials), note=note, trials=trials)
        return skew.settled(found, BETWEEN, self.skew)

    def _of_turns(self, of: Callable[[Array], float]) -> float:
        """What the turns may still make of a number of the mean curve [as the number]."""
        found = [0.0]
        for loop in (m.loop for m in self.members):
            if loop.possible is not None:
                raw, turns = loop.raw_mean.mean(axis=0), loop.turns or loop.possible
                share = 1.0 if loop.turns is None else LEFT_OF_TURNS
                found.append(share * abs(of(raw) - of(raw - turns.of_mean(loop.x))))
        return max(found)

    def _window_error(self, place: float) -> tuple[float, float]:
        """What the width of the cubic, and turns that fade fast or slowly, make of force [N] and slope [N/m]."""
        wide, narrow = _local(self.x, self.curve, place), _local(self.x, self.curve, place, WINDOW / 2)
        turns = [self._of_turns(lambda curve, i=i: _local(self.x, curve, place)[i]) for i in (0, 1)]  # type: ignore[misc]
        slow = self._slow_turns(place)
        return hypot(2 * (wide[0] - narrow[0]), turns[0], slow[0]), hypot(2 * (wide[1] - narrow[1]), turns[1], slow[1])

    def _slow_turns(self, place: float) -> tuple[float, float]:
        """What hysteresis that fades over most of the stroke adds to force [N] and slope [N/m]; 0 without turns."""
        if all(m.loop.turns is None for m in self.members):
            return 0.0, 0.0
        reach = SLOW_REACH * float(self.x[-1] - self.x[0])
        slope = SLOW_TURNS * abs(self.gap.start) / reach
        return slope * abs(place - self.middle), slope

    def _uneven(self, dF_dP: float | None) -> float:
        """What of the gap unequal pressure of the two branches may be worth [N]."""
        apart = max((abs(m.loop.apart) for m in self.members if not isnan(m.loop.apart)), default=0.0)
        return apart * self._force_per_pressure(dF_dP)

    def _rising(self, dF_dP: float | None) -> float:
        """How fast what unequal pressure of the branches may be worth rises with the speed [N.s/m]."""
        known = [(m.speed, m.loop.apart) for m in self.members if not isnan(m.loop.apart)]
        if self.one_speed or len({speed for speed, _ in known}) < 2:
            return 0.0
        speeds, aparts = np.array(known).T
        guessed = GUESSED if dF_dP is None else 1.0
        return guessed * abs(float(np.polyfit(speeds, aparts, 1)[0])) * self._force_per_pressure(dF_dP)

    def _force_per_pressure(self, dF_dP: float | None) -> float:
        """|dF/dP| [N/Pa]; where it is not known, by a force that is proportional to the pressure."""
        by_force = abs(self.force_at(self.middle)) / self.pressure if self.pressure > 0 else 0.0
        return by_force if dF_dP is None else abs(dF_dP)

    # -- the rest -------------------------------------------------------------------------------------------------

    def findings(self) -> list[Finding]:
        """What catches the eye."""
        where, found = show(self.pressure, "pressure"), []
        if self.straight >= 0:
            text = f"at {where} the force rises with contraction: a sign is wrong in displacement or force"
            found.append(Finding("fault", text))
        if self.one_speed:
            found.append(Finding("note", f"at {where}, {ONE_SPEED}"))
        for member in self.members:
            gap = abs(float(member.loop.middle_gap.mean()))
            worth = abs(member.loop.apart) * self._force_per_pressure(None)
            if worth > UNEVEN * gap and worth > member.loop.noise:
                text = (
                    f"trial {member.trial.name}: the pressure is {show(member.loop.apart, 'pressure', 3)} higher while "
                    f"expanding than while contracting, worth about {show(worth, 'force', 2)} of the gap: slower, or a "
                    "larger regulator"
                )
                found.append(Finding("doubt", text))
        return found

    def traces(self) -> Iterator[Trace]:
        """The last cycle of the first trial at each speed; mean curve and gap over contraction."""
        name = "-".join(f"{value:g}" for value in self.at.values())
        where, quantities = show(self.pressure, "pressure"), {"displacement": "length", "force": "force"}
        for speed in sorted({member.speed for member in self.members}):
            loop = next(m.loop for m in self.members if m.speed == speed)
            stride = max(1, -(-len(loop.last[0]) // LONGEST_TRACE))
            columns = dict(zip(quantities, (values[::stride] for values in loop.last), strict=True))
            title = f"{where}: isobaric loop at {show(speed, 'speed')}"
            marks = {**self.at, "speed": speed, "H": float(loop.middle_gap.mean())}
            yield Trace(f"isobaric-{name}-{speed:g}", "isobaric", title, columns, quantities, marks)
        slowest = min(self.members, key=lambda m: m.speed).loop
        columns = {"displacement": self.x, "force": self.curve, "gap": slowest.gap.mean(axis=0)}
        marks, title = {**self.at, "H": float(self.gap.start)}, f"{where}: mean of the branches"
        yield Trace(f"mean-curve-{name}", "mean-curve", title, columns, quantities | {"gap": "force"}, marks)

    def facts(self) -> dict[str, Any]:
        """Numbers of the cell, plain data."""
        loops = [member.loop for member in self.members]
        turns = [loop.turns for loop in loops]
        return {
            "at": dict(self.at),
            "speeds": sorted({member.speed for member in self.members}),
            "cycles": [len(loop.lost) for loop in loops],
            "pressure": float(np.mean([loop.pressure for loop in loops])),
            "turns": [None if one is None else {"h": one.h, "w": one.w, "rms": one.rms} for one in turns],
            "pressure_apart": float(np.max([abs(loop.apart) for loop in loops])),
            "contraction": [float(self.x[0]), float(self.x[-1])],
        }


_Row = tuple[str, tuple[str, str], Callable[[Loop], Array], tuple[str, ...], float, float]
"""Symbol; unit and quantity; value by cycle; channels to which it is proportional; method and skew part."""


def _halved(half: float | None) -> float | None:
    return None if half is None else half / 2


def _locals(x: Array, curves: Array, place: float, window: float = WINDOW) -> tuple[Array, Array]:
    """Value and slope at a place of each of `curves`, shape (m, n), by a cubic through the points about it."""
    reach = window * float(x[-1] - x[0])
    centre = min(max(place, float(x[0]) + reach), float(x[-1]) - reach)
    near = np.abs(x - centre) <= reach * (1 + 1e-9)
    terms = np.polyfit(x[near] - place, curves[:, near].T, min(3, int(near.sum()) - 1))
    return np.asarray(terms[-1]), np.asarray(terms[-2])


def _local(x: Array, curve: Array, place: float, window: float = WINDOW) -> tuple[float, float]:
    value, slope = _locals(x, curve[None, :], place, window)
    return float(value[0]), float(slope[0])
