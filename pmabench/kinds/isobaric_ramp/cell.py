"""The loops of one pressure and stroke at all speeds: lines over the speed, mean curve, findings.

Gives no coefficient: those of the mean curve and of the gap are in `coefficients`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import off_command, off_command_findings
from pmabench.analysis.shared.lines import Line, mean_of_cycles, weighted_line
from pmabench.analysis.shared.ramp_loop import Loop, turns_of
from pmabench.analysis.shared.trials import thinned
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

CURVE, RAW, LOCAL = OF_MEAN = "mean-curve", "mean-curve, turns left in", "mean-curve, local"
GAP = "loop-gap"
WINDOW = 0.06
"""Half width of the range of a local cubic through the mean curve, as a share of the stroke."""
OPENED = 0.7
"""Share of the stroke, about its middle, in which the transitions after the turns have decayed."""
BENT = 0.02
"""Rms distance of the mean curve from a straight line, as a share of its range, from which on it counts as bent."""
UNEVEN = 0.05
"""Effect of unequal pressure in the two branches, as a share of the gap, from which on it is a doubt."""
LEFT_OF_TURNS = 0.4
"""Share of the correction for turns that may remain as an error, since turns need not decay exponentially.

For a Bouc-Wen muscle four tenths remained. Where a loop does not show its turns, because something else in the gap is
larger, the whole correction may be wrong.
"""
SLOW_TURNS = 0.2
"""Share of the hysteresis that may decay over most of the stroke: the gap does not show it, and it adds to the slope.
In a fluidic muscle, described by friction elements of several lengths, a fifth of it has a length of 16 mm.
"""
SLOW_REACH = 0.75
"""Length of that decay as a share of the stroke: a shorter one shows in the gap, a longer one adds less."""
BETWEEN = "displacement and force"
PLACES = 5
"""Number of places along the stroke at which force and stiffness are given."""
NO_REPEATS = "no repeats part: too few loops"
ONE_SPEED = "one speed only: hysteresis and damping cannot be separated"


@dataclass(frozen=True, eq=False)
class Member:
    """One usable trial, measured."""

    run: RunData
    trial: TrialData
    loop: Loop

    @property
    def speed(self) -> float:
        """Speed as commanded [m/s]; else as measured."""
        return float(self.trial.point.get("speed", self.loop.speed))


@dataclass(frozen=True, eq=False)
class Cell:
    """All trials of one pressure and stroke; `x` [m] is the part of the grid that all of them reach, shape (n,)."""

    at: Mapping[str, float]
    members: Sequence[Member]
    x: Array
    skew: float
    """Bound on the time between displacement and force [s]."""

    @classmethod
    def of(cls, at: Mapping[str, float], members: Sequence[Member]) -> Cell:
        """The trials with their loops cropped to the common part of the grid."""
        x = members[0].loop.x
        for member in members[1:]:
            x = x[np.isin(np.round(x, 9), np.round(member.loop.x, 9))]
        known = [member for member in members if member.loop.turns is not None]
        slowest = min(known, key=lambda m: m.speed).loop.turns if known else None
        # hysteresis is rate-independent: a loop that does not show its turns gets those of the slowest loop
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

    @cached_property
    def off(self) -> float:
        """Measured pressure minus the set one [Pa]: the largest of a trial or at speed 0; 0 if it is not recorded."""
        known = [m.loop.pressure for m in self.members if isfinite(m.loop.pressure)]
        if len(known) == len(self.members):
            known.append(self.over_speed(lambda loop: np.full(len(loop.middle_gap), loop.pressure)).start)
        return max((one - self.pressure for one in known), key=abs, default=0.0)

    @property
    def middle(self) -> float:
        """Middle of the stroke [m]."""
        return float(0.5 * (self.x[0] + self.x[-1]))

    @property
    def opened(self) -> tuple[Array, NDArray[np.bool_]]:
        """Position on the grid, scaled to -1 ... 1, and where the turns have decayed."""
        place = (self.x - self.middle) / (0.5 * np.ptp(self.x))
        return place, np.abs(place) < OPENED

    @property
    def ends(self) -> tuple[float, float]:
        """Lower and upper end of the stroke [m]."""
        points = [member.trial.point for member in self.members]
        return min(p.get("lower", self.x[0]) for p in points), max(p.get("upper", self.x[-1]) for p in points)

    @property
    def stroke(self) -> float:
        """Length of the stroke [m]."""
        lower, upper = self.ends
        return float(upper - lower)

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
        """The line of the gap at mid stroke [N] over speed."""
        return self.over_speed(lambda loop: loop.middle_gap)

    @cached_property
    def curve(self) -> Array:
        """Mean curve extrapolated to speed 0, or at the only speed [N], shape (n,)."""
        speeds = np.array([member.speed for member in self.members])
        means = np.array([member.loop.mean.mean(axis=0) for member in self.members])
        if self.one_speed:
            return np.asarray(means.mean(axis=0))
        design = np.column_stack([np.ones_like(speeds), speeds])
        return np.asarray(np.linalg.lstsq(design, means, rcond=None)[0][0])

    def force_at(self, x: float) -> float:
        """Force of the mean curve [N] at a contraction [m]."""
        return local(self.x, self.curve, x)[0]

    @property
    def bent(self) -> bool:
        """Whether the mean curve deviates from a straight line."""
        return is_bent(self.x, self.curve)

    @cached_property
    def straight(self) -> float:
        """Slope of a straight line through the mean curve [N/m]."""
        return float(np.polyfit(self.x, self.curve, 1)[0])

    @property
    def change(self) -> float:
        """Largest difference of a local slope of a bent mean curve to that of the straight line [N/m]; 0 if it is not
        bent.
        """
        if not self.bent:
            return 0.0
        slopes = {place: local(self.x, self.curve, place)[1] for place in self.places}
        return max(float(abs(s - self.straight)) + self.window_error(p)[1] for p, s in slopes.items())

    @property
    def places(self) -> list[float]:
        """Places along the stroke at which force and stiffness are given [m]."""
        return [float(place) for place in np.linspace(self.x[0], self.x[-1], PLACES)]

    @cached_property
    def many_slopes(self) -> str:
        """Reason why one stiffness does not describe the stroke: its slopes differ by as much as their mean; else
        empty.
        """
        if self.change < abs(self.straight):
            return ""
        slopes = [-local(self.x, self.curve, place)[1] for place in self.places]
        ends = " to ".join(show(K, "stiffness", 3) for K in (min(slopes), max(slopes)))
        return f"the mean curve is bent, K is {ends} along the stroke: it is given at each contraction instead"

    @property
    def speeds(self) -> tuple[float, float]:
        """Lowest and highest speed [m/s]."""
        speeds = [member.speed for member in self.members]
        return min(speeds), max(speeds)

    @cached_property
    def turns_of_each(self) -> bool:
        """Whether each loop shows its own turns, so that none was replaced by those of another (see `of`)."""
        turns = {member.loop.turns for member in self.members}
        return None not in turns and len(turns) == len(self.members)

    @property
    def upside_down(self) -> bool:
        """Whether the contracting branch is the upper one, by more than scatter."""
        return any(
            float(m.loop.middle_gap.mean()) < -max(2 * float(m.loop.middle_gap.std()), 0.5 * m.loop.noise, 1e-6)
            for m in self.members
        )

    # -- estimates ------------------------------------------------------------------------------------------------

    def over_pressure(self, near: Cell | None, of: Callable[[Cell], float]) -> float | None:
        """Change of a number `of` a cell with pressure [its unit per Pa], from this cell to the cell `near` at another
        pressure; None unless the stroke of `near` includes the middle of this one.
        """
        if near is None or not near.x[0] <= self.middle <= near.x[-1]:
            return None
        change = (of(near) - of(self)) / (near.pressure - self.pressure)
        return change if isfinite(change) else None

    def over_x(self, place: float) -> tuple[float, float]:
        """Derivative of the force [N/m] and of the stiffness [N/m2] by the contraction, on the mean curve."""
        _, bend, slope, _ = np.polyfit(self.x - place, self.curve, 3)
        return float(slope), -2 * float(bend)

    def part(
        self, scales: Scales, gains: Mapping[str, float], offsets: Mapping[str, float], over_P: float | None
    ) -> float | None:
        """Calibration part of a value whose derivative by the nominal pressure is `over_P` [per Pa]."""
        return scales.part_at(self.pressure, over_P if self.pressure > 0 else None, gains, offsets)

    def off_command(self, value: float, over_P: float | None, *, force: bool = False) -> float:
        """Possible error of a value that is given for the set pressure; a `force` changes as much along the stroke."""
        return off_command(self.off, self.pressure, self.highest if force else value, over_P)

    @property
    def highest(self) -> float:
        """Largest force of the mean curve [N]."""
        return float(np.max(np.abs(self.curve)))

    def estimate(
        self, symbol: str, value: float | None, kind: tuple[str, str], method: str, at: Mapping[str, float],
        parts: Parts, note: str, n: int | None = None,
    ) -> Estimate:  # fmt: skip
        """An estimate from all trials or, with `n`, from those of its speed; without value where the clock error is too
        large.
        """
        trials = tuple(member.trial.name for member in self.members if "speed" not in at or n is None
                       or member.speed == at["speed"])  # fmt: skip
        if value is not None and parts.repeats is None:
            note = sentences(NO_REPEATS, note)
        found = Estimate(symbol, value, *kind, method, dict(at), parts, len(trials), note=note, trials=trials)
        return skew.settled(found, BETWEEN, self.skew)

    def of_turns(self, of: Callable[[Array], float]) -> float:
        """Possible remaining error because of the turns in a number `of` the mean curve, in its unit."""
        found = [0.0]
        for loop in (m.loop for m in self.members):
            if loop.possible is not None:
                raw, turns = loop.raw_mean.mean(axis=0), loop.turns or loop.possible
                share = LEFT_OF_TURNS if self.turns_of_each else 1.0
                found.append(share * abs(of(raw) - of(raw - turns.of_mean(loop.x))))
        return max(found)

    def turned(self, offset: float) -> list[tuple[Loop, Loop]]:
        """Each loop, and with its turns as they are if the displacement is up to `offset` [m] off, either way."""
        found = []
        for loop in (m.loop for m in self.members) if offset else ():
            gap, (lower, upper) = loop.gap.mean(axis=0), loop.ends
            for by in (-offset, -offset / 2, offset / 2, offset):
                if turns := turns_of(loop.x, gap, lower + by, upper + by):
                    found.append((loop, replace(loop, turns=turns)))
        return found

    def window_error(self, place: float) -> tuple[float, float]:
        """Errors of local force [N] and slope [N/m] because of the width of the cubic, and of turns that decay fast or
        slowly.
        """
        wide, narrow = local(self.x, self.curve, place), local(self.x, self.curve, place, WINDOW / 2)
        turns = [self.of_turns(lambda curve, i=i: local(self.x, curve, place)[i]) for i in (0, 1)]  # type: ignore[misc]
        slow = self.slow_turns(place)
        return hypot(2 * (wide[0] - narrow[0]), turns[0], slow[0]), hypot(2 * (wide[1] - narrow[1]), turns[1], slow[1])

    def slow_turns(self, place: float) -> tuple[float, float]:
        """Force [N] and slope [N/m] that hysteresis with a decay over most of the stroke adds; 0 without turns."""
        if all(m.loop.turns is None for m in self.members):
            return 0.0, 0.0
        reach = SLOW_REACH * float(self.x[-1] - self.x[0])
        slope = SLOW_TURNS * abs(self.gap.start) / reach
        return slope * abs(place - self.middle), slope

    def force_per_pressure(self, dF_dP: float | None) -> float:
        """|dF/dP| [N/Pa]; if unknown, that of a force proportional to the pressure."""
        by_force = abs(self.force_at(self.middle)) / self.pressure if self.pressure > 0 else 0.0
        return by_force if dF_dP is None else abs(dF_dP)

    # -- the rest -------------------------------------------------------------------------------------------------

    def findings(self) -> list[Finding]:
        """Wrong sign, single speed, and unequal pressure in the branches."""
        where, found = show(self.pressure, "pressure"), []
        if self.straight >= 0:
            text = f"at {where} the force rises with contraction: a sign is wrong in displacement or force"
            found.append(Finding("fault", text))
        if self.one_speed:
            found.append(Finding("note", f"at {where}, {ONE_SPEED}"))
        found += off_command_findings(where, self.off, self.pressure)
        for member in self.members:
            gap = abs(float(member.loop.middle_gap.mean()))
            worth = abs(member.loop.apart) * self.force_per_pressure(None)
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
            columns = thinned(dict(zip(quantities, loop.last, strict=True)))
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


def is_bent(x: Array, curve: Array) -> bool:
    """Whether a curve [N] over `x` [m], shapes (n,), deviates from a straight line."""
    left = curve - np.polyval(np.polyfit(x, curve, 1), x)
    return bool(np.sqrt(np.mean(left**2)) > BENT * np.ptp(curve))


def each_local(x: Array, curves: Array, place: float, window: float = WINDOW) -> tuple[Array, Array]:
    """Value and slope at a place of each of `curves`, shape (m, n), by a cubic through the points near it."""
    reach = window * float(x[-1] - x[0])
    centre = min(max(place, float(x[0]) + reach), float(x[-1]) - reach)
    near = np.abs(x - centre) <= reach * (1 + 1e-9)
    terms = np.polyfit(x[near] - place, curves[:, near].T, min(3, int(near.sum()) - 1))
    return np.asarray(terms[-1]), np.asarray(terms[-2])


def local(x: Array, curve: Array, place: float, window: float = WINDOW) -> tuple[float, float]:
    """`each_local` for one curve, shape (n,)."""
    value, slope = each_local(x, curve[None, :], place, window)
    return float(value[0]), float(slope[0])
