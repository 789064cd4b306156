"""Trials of ultimate-gain runs at one operating point, and the comparison of several methods for K_u and T_u."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales, listed, sentences
from pmabench.analysis.shared.isometric_lines import spread
from pmabench.analysis.shared.student import half_of_trials
from pmabench.analysis.shared.trials import by_point, grouped, thinned
from pmabench.base.quantities import show
from pmabench.model.loop import Loop, Ultimate, ultimate
from pmabench.store.analyses.results import Dropped, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

SYMBOLS = (("K_u", "Pa/m", "gain"), ("T_u", "s", "time"))
"""Symbol, unit and quantity that every method gives."""
LEAST_DEAD = 0.1
"""Smallest remaining share of a dead time after correction for the time between clocks."""
COLUMNS = {"t": "time", "displacement": "length", "model": "length", "pressure": "pressure",
           "pressure_command": "pressure", "gain": "gain", "log_ratio": "count", "fit": "count", "period": "time",
           "used": "count"}  # fmt: skip
"""Column of a trace -> its quantity."""


@dataclass(frozen=True)
class Pair:
    """K_u [Pa/m] and T_u [s]; NaN where there is none."""

    value: tuple[float, float] = (nan, nan)
    half: tuple[float, float] = (nan, nan)
    """Half widths of the 95 % intervals by the scatter within one trial; NaN where it is unknown."""

    @classmethod
    def of(cls, loop: Loop | None, parts: Sequence[Ultimate]) -> Pair:
        """From the loop of a trial, with the scatter of parts of the trial."""
        if loop is None:
            return NOTHING
        truth = ultimate(loop)
        K, T = (spread([getattr(one, name) for one in parts]) for name in ("gain", "period"))
        return cls((truth.gain, truth.period), (nan if K is None else K, nan if T is None else T))


NOTHING = Pair()


@dataclass(frozen=True, eq=False, kw_only=True)
class Examined:
    """Result of one trial."""

    refused: tuple[str, ...] = ()
    """Reasons why it gives no value; empty if it does."""
    doubts: tuple[str, ...] = ()
    """Weaknesses of its value."""
    loop: Loop | None = None
    """The loop that explains the trial; None if none was found."""

    @property
    def pair(self) -> Pair:
        """K_u and T_u of the trial."""
        return NOTHING


Found = TypeVar("Found", bound=Examined)


@dataclass(frozen=True, eq=False)
class Member(Generic[Found]):
    """A trial and its result."""

    run: RunData
    trial: TrialData
    found: Found


@dataclass(frozen=True)
class GainCell(ABC, Generic[Found]):
    """The trials of one operating point `at` [SI], in chronological order, evaluated by one method."""

    called: ClassVar[str] = "trials"
    """Name of its trials in findings."""
    method: ClassVar[str]
    alone: ClassVar[str]
    """Note on a value of a single trial."""
    note: ClassVar[str] = ""
    """Note on every value."""
    by_command: ClassVar[bool] = True
    """Whether the calibration is that of the commanded pressure, if it has one; else that of the measured pressure."""
    at: Mapping[str, float]
    members: tuple[Member[Found], ...]

    @property
    def loop(self) -> Loop | None:
        """The loop of the first trial that has one."""
        return next((loop for one in self.good if (loop := one.found.loop) is not None), None)

    @cached_property
    def estimates(self) -> list[Estimate]:
        """K_u and T_u, with the reasons where there is no value."""
        return [self._estimate(place) if self.good else self._empty(place) for place in range(len(SYMBOLS))]

    @abstractmethod
    def _estimate(self, place: int) -> Estimate:
        """K_u (`place` 0) or T_u (1): mean of the trials, with its interval in parts; there is a trial with a value."""

    @abstractmethod
    def traces(self) -> list[Trace]:
        """Traces of the first trial with a value, else of the first."""

    @property
    def good(self) -> list[Member[Found]]:
        """Trials with a value."""
        return [one for one in self.members if not one.found.refused]

    @property
    def shown(self) -> Member[Found]:
        """The first trial with a value, else the first."""
        return (self.good or self.members)[0]

    @property
    def where(self) -> str:
        """The operating point in words."""
        return show(self.at["setpoint"], "length") if "setpoint" in self.at else "this operating point"

    @property
    def apart(self) -> float:
        """Bound of the time between pressure and displacement [s], all of which is in the loop's dead time."""
        return skew.apart([one.run for one in self.members], ("pressure", "displacement"))

    @property
    def dropped(self) -> list[Dropped]:
        """Trials without result, with the reason."""
        refused = [one for one in self.members if one.found.refused]
        return [Dropped(one.trial.name, one.trial.point, "; ".join(one.found.refused)) for one in refused]

    @classmethod
    def all_of(
        cls, members: Sequence[tuple[RunData, TrialData]], examine: Callable[[RunData, TrialData], Found]
    ) -> list[Self]:
        """The trials by operating point, each examined."""
        return [
            cls(point, tuple(Member(run, trial, examine(run, trial)) for run, trial in group))
            for point, group in by_point(members)
        ]

    def _empty(self, place: int) -> Estimate:
        """K_u (`place` 0) or T_u (1) without value, with the reasons for which all trials were refused."""
        symbol, unit, quantity = SYMBOLS[place]
        note = "; ".join(dict.fromkeys(reason for one in self.members for reason in one.found.refused))
        parents = tuple(one.trial.name for one in self.members)
        return Estimate(symbol, None, unit, quantity, self.method, self.at, note=note, trials=parents)

    def mean(self, place: int) -> float:
        """The mean of K_u (`place` 0) or T_u (1) over the trials."""
        return float(np.mean([one.found.pair.value[place] for one in self.good]))

    def estimate(self, place: int, parts: Parts) -> Estimate:
        """K_u (`place` 0) or T_u (1) with those of its parts that are by method and clocks."""
        scales, good = Scales.of(one.run for one in self.members), self.good
        pairs = [one.found.pair for one in good]
        numbers, halves = [pair.value[place] for pair in pairs], [pair.half[place] for pair in pairs]
        value = self.mean(place)
        pressure = "pressure_command" if self.by_command and "pressure_command" in scales.gains else "pressure"
        used = () if place else (pressure, "displacement")
        calibration = scales.part(dict.fromkeys(used, value))
        parts = replace(parts, repeats=half_of_trials(numbers, halves), calibration=calibration)
        doubts, alone = (doubt for one in good for doubt in one.found.doubts), self.alone if len(good) == 1 else ""
        note, names = sentences(*doubts, alone, self.note, scales.lack(used)), tuple(one.trial.name for one in good)
        return replace(self._empty(place), value=value, parts=parts, n=len(good), note=note, trials=names)

    def findings(self) -> list[Finding]:
        """Each reason and doubt with the number of trials concerned."""
        said = [("fault", reason) for one in self.members for reason in one.found.refused]
        said += [("doubt", doubt) for one in self.members for doubt in one.found.doubts]
        return [
            Finding(level, f"{said.count((level, text))} of {len(self.members)} {self.called} at {self.where}: {text}")
            for level, text in dict.fromkeys(said)
        ]

    def trace(self, figure: str, title: str, columns: Mapping[str, Array], marks: Mapping[str, float]) -> Trace:
        """Columns of a figure, thinned."""
        at = "-".join(f"{self.at.get(name, 0.0):g}" for name in ("setpoint", "load"))
        title = f"{title}, set-point {show(self.at.get('setpoint', 0.0), 'length')}"
        quantities = {name: COLUMNS[name] for name in columns}
        return Trace(f"{figure}-{at}", figure, title, thinned(columns), quantities, marks)

    def by_clocks(self, place: int) -> float:
        """Change of K_u (`place` 0) or T_u (1) by clock errors: the time between pressure and displacement, either
        sign, is all in the dead time.
        """
        if self.apart <= 0 or self.loop is None:
            return 0.0
        dead = self.loop.dead_time
        times = (dead, dead + self.apart, max(dead - self.apart, LEAST_DEAD * dead))
        known, *ends = (Pair.of(replace(self.loop, dead_time=time), ()).value[place] for time in times)
        return max(abs(end - known) for end in ends)


def lags_of(tau: float, beta: float) -> tuple[complex, ...]:
    """Lags [s] of beta s^2 + tau s + 1: a complex pair where tau^2 < 4 beta, else two real ones; one for beta <= 0."""
    root = complex(tau * tau - 4 * beta) ** 0.5
    pair = [(tau + root) / 2, (tau - root) / 2] if beta > 0 else [complex(tau)]
    return tuple(lag if lag.imag else lag.real for lag in pair)


def oscillating(gain: float, dead_time: float, lags: Sequence[complex]) -> Loop | None:
    """The loop with this gain, dead time and lags [SI]; None if it could not oscillate."""
    try:
        loop = Loop(gain, dead_time, tuple(lags))
        ultimate(loop)
    except ValueError:
        return None
    return loop


def plain_lags(loop: Loop) -> list[Any]:
    """The lags of a loop as plain data [s]: a number, or real and imaginary part."""
    return [[lag.real, lag.imag] if lag.imag else lag.real for lag in map(complex, loop.lags)]


def described(loop: Loop) -> str:
    """Gain, dead time and lags of a loop."""
    lags = listed([f"{complex(lag).real:.3g} s" for lag in loop.lags])
    dead_time = f"dead time {loop.dead_time * 1e3:.3g} ms (half a sample period in it)"
    return f"{loop.gain * 1e6:.4g} mm/kPa, {dead_time} and lags {lags}"


def limit_of(loop: Loop) -> str:
    """At which gain and period a loop would oscillate."""
    truth = ultimate(loop)
    return f"it would oscillate at K_u = {show(truth.gain, 'gain', 4)}, T_u = {truth.period:.4g} s"


APART = {"K_u": 0.25, "T_u": 0.1}
"""Largest relative difference between open-loop steps, relay and rising gain without friction; with friction 30 % to
300 %.
"""


def findings(estimates: Sequence[Estimate]) -> list[Finding]:
    """Differences of the methods for K_u and T_u at one operating point."""
    lines = []
    for symbol in ("K_u", "T_u"):
        known = [e for e in estimates if e.symbol == symbol and e.value]
        for found in grouped(known, lambda e: tuple(sorted(e.at.items()))).values():
            if len(found) < 2:
                continue
            where = show(found[0].at["setpoint"], "length") if "setpoint" in found[0].at else "one operating point"
            values = ", ".join(f"{show(e.value or 0.0, e.quantity, 4)} ({e.method})" for e in found)
            exact = [e.value for e in found if e.value]
            apart = max(exact) / min(exact) - 1
            text = f"{symbol} at {where}: {values}; the ways are {apart:.1%} apart"
            if apart > APART[symbol]:
                text += ", more than without friction: stiction, or a muscle that bends within the swings"
            lines.append(Finding("doubt" if apart > APART[symbol] else "note", text))
    return lines
