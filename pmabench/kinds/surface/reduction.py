"""All slow tests of a specimen as one muscle: rows from each kind of test, fit, values, sentences, loops.

Each kind of test defines its rows; none is named here. Values are given at round places within the tested range, except
where the interval is too wide or nothing was tested.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, floor
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.surface.fit import FEWEST, Choice, Data, Score, Spread, choose
from pmabench.analysis.surface.muscle import ALWAYS, CREEP_P, CREEP_X, SLIDING, STOPS_P, STOPS_X, Frame, Muscle
from pmabench.analysis.surface.trials import RATE, Record
from pmabench.base.quantities import QUANTITIES, show
from pmabench.kinds.surface import RESULTS
from pmabench.store.analyses.results import Analysis, Dropped, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

METHOD, SECANT = "surface", "surface, straight line"
NORMAL = 1.96
NEAR = 0.1
"""Largest distance of rows in pressure, or contraction, as a share of the range; a place counts as tested if such rows
lie on both sides of it in the other coordinate.
"""
MOST = 6
"""Most pressures, and most contractions at each."""
PRESSURES, PLACES = 13, 61
"""Most pressures at which the tested range is recorded, and its resolution."""
STILL = 1e-5
"""Range of speeds below which nothing moved [m/s]."""
WAVE = 0.25
"""Share of the range of contraction over which an error of the surface may be a slope."""
WIDE = {"force": 0.05, "K": 0.25, "K_s": 0.25}
"""Largest half width of a reported value as a share of it; for a force as a share of the full scale."""
LOOSE = 0.5
"""The same for all other symbols."""
FASTEST = 0.98
"""Quantile of the speeds at which damping is given."""
TOO_FEW = "its interval would say too little: test more loads, pressures or lengths around it"
MOVING, SEVERAL = 0.2, 1.5
"""Speeds above the share MOVING of the fastest count as motion. There are several speeds if their 90 % quantile exceeds
SEVERAL times their 10 % quantile.
"""
ONE_SPEED = (
    "the muscle was moved at one speed only, where damping is not distinguished from hysteresis: move it at a third or "
    "at three times that speed, too"
)
CREEP = (1.0, 30.0)
"""Times [s] between which creep is reported, up to the longest hold."""


@dataclass(frozen=True, eq=False)
class Tested:
    """Region covered by rows: pressures [Pa] and contractions [m] of those that are used."""

    P: Array
    x: Array
    wide_P: float
    wide_x: float

    def contractions(self, P: float) -> tuple[float, float] | None:
        """Lowest and highest contraction [m] tested near a pressure; None without any."""
        near = self.x[np.abs(self.P - P) <= self.wide_P]
        return (float(near.min()), float(near.max())) if len(near) else None

    def pressures(self, x: float) -> tuple[float, float] | None:
        """Lowest and highest pressure [Pa] tested near a contraction; None without any."""
        near = self.P[np.abs(self.x - x) <= self.wide_x]
        return (float(near.min()), float(near.max())) if len(near) else None

    def holds(self, P: float, x: float) -> bool:
        """Whether a place lies inside the tested region."""
        along_x, along_P = self.contractions(P), self.pressures(x)
        if along_x is None or along_P is None:
            return False
        return along_x[0] - 1e-9 <= x <= along_x[1] + 1e-9 and along_P[0] - 1.0 <= P <= along_P[1] + 1.0

    def ranges(self, frame: Frame) -> list[list[float]]:
        """Rows of a round pressure [Pa] and the lowest and highest tested contraction [m] there."""
        found = []
        for P in round_places(frame.P.low, frame.P.high, PRESSURES):
            ends = self.contractions(P)
            if ends and (held := [x for x in np.linspace(*ends, PLACES).tolist() if self.holds(P, x)]):
                found.append([P, held[0], held[-1]])
        return found


def tested(choice: Choice) -> Tested:
    """The tested region of a fit."""
    rows, frame = choice.data.rows, choice.data.frame
    return Tested(rows.P[rows.used], rows.x[rows.used], NEAR * frame.P.span + 1.0, NEAR * frame.x.span + 1e-6)


def round_places(low: float, high: float, most: int = MOST) -> list[float]:
    """At most `most` multiples of 1, 2, 2.5 or 5 times a power of ten between `low` and `high`; their middle if there
    is none.
    """
    if not high > low:
        return [low]
    power = 10.0 ** floor(np.log10((high - low) / most))
    for step in (power * factor for factor in (1, 2, 2.5, 5, 10, 20, 25, 50)):
        first, last = ceil(low / step - 1e-6), floor(high / step + 1e-6)
        if 0 <= last - first < most:
            return [round(number * step, 9) for number in range(first, last + 1)]
    return [0.5 * (low + high)]


FORCE, SLOPE, WORK = {"force": 1}, {"force": 1, "displacement": -1}, {"force": 1, "displacement": 1}
"""Channel -> power with which forces, stiffness and damping, and work grow with its scale."""
STEP = 1e-3
"""Half width of the difference for derivatives by place, as a share of the tested range."""


@dataclass(frozen=True, eq=False)
class Reporter:
    """Makes estimates from functions of the muscle."""

    choice: Choice
    spread: Spread
    scales: Scales
    trials: tuple[str, ...]

    @property
    def error(self) -> float:
        """Error of the force of trials that were left out [N], 95 %."""
        return NORMAL * self.choice.score.rms

    def estimate(
        self,
        symbol: str,
        quantity: str,
        value: partial[float],
        at: Mapping[str, float],
        *,
        misfit: float = 0.0,
        wide: float | None = None,
        note: str = "",
        method: str = METHOD,
        powers: Mapping[str, int] = FORCE,
    ) -> Estimate:
        """One value; `misfit` is its error by the prediction error of left-out trials, `wide` the largest half width
        [SI].

        Without `wide` a share of the value is used. `powers`: power of each channel's scale in the value; its arguments
        `P` and `x` have the errors of pressure and displacement.
        """
        known = self.spread.of_value(value)
        calibration = self._calibration(value, powers, offset=symbol == "F")
        parts = Parts(known.repeats, float(np.hypot(known.method, misfit)), calibration)
        found = Estimate(
            symbol, known.value, QUANTITIES[quantity].unit, quantity, method, at, parts, len(self.trials), note=note,
            trials=self.trials,
        )  # fmt: skip
        half = parts.combined
        if half is None:
            return _unknown(found, f"fewer than {FEWEST} different loads, pressures or lengths give no interval")
        if half > (WIDE.get(symbol, LOOSE) * abs(known.value) if wide is None else wide):
            return _unknown(found, TOO_FEW)
        return found

    def _calibration(self, value: partial[float], powers: Mapping[str, int], *, offset: bool) -> float | None:
        """Calibration part of a value; `offset`: whether the zero of the force shifts it."""
        muscle, frame = self.choice.muscle, self.choice.data.frame
        here = value(muscle)
        gains = {channel: power * here for channel, power in powers.items()}
        offsets = {"force": 1.0} if offset else {}
        for name, channel, axis in (("P", "pressure", frame.P), ("x", "displacement", frame.x)):
            if name not in value.keywords or not axis.span > 0:
                continue
            place, step = value.keywords[name], STEP * axis.span
            low, high = (value(muscle, **{name: place + way * step}) for way in (-1, 1))
            over = (high - low) / (2 * step)
            gains[channel] = gains.get(channel, 0.0) + over * place
            offsets[channel] = over
        return self.scales.part(gains, offsets)


def _unknown(found: Estimate, why: str) -> Estimate:
    """The estimate without a value, since there are too few tests for it; it is not withheld."""
    return replace(found, value=None, parts=Parts(), note=why)


def estimates(choice: Choice, scales: Scales) -> list[Estimate]:
    """All values of a muscle."""
    rows = choice.data.rows
    names = tuple(record.name for record in choice.data.records)
    maker = Reporter(choice, Spread.of(choice), scales, names)
    where = tested(choice)
    frame = choice.data.frame
    pressures = [P for P in round_places(frame.P.low, frame.P.high) if where.contractions(P) is not None]
    found = [*_points(maker, where, pressures), *_loops(maker, where, pressures)]
    if np.ptp(rows.v[rows.used]) > STILL and frame.x.span > 0:
        found += _damping(maker, pressures)
    return [*found, *_creep(maker, where)]


def _force(muscle: Muscle, P: float, x: float) -> float:
    """Force of the surface at one place [N]."""
    return float(muscle.static(np.array([P]), np.array([x]))[0])


def _stiffness(muscle: Muscle, P: float, x: float) -> float:
    """Minus the slope of the surface over contraction at one place [N/m]."""
    return float(muscle.stiffness(np.array([P]), np.array([x]))[0])


def _damping_of(muscle: Muscle, P: float, way: int) -> float:
    """Damping while contracting (`way` 0) or while expanding (1) [N.s/m]."""
    return muscle.damping(P)[way]


def _points(maker: Reporter, where: Tested, pressures: list[float]) -> Iterator[Estimate]:
    """Force and tangent stiffness at places, and the secant stiffness at each pressure.

    A force is half way between filling and emptying. Slow tests do not show whether a later move of the length leaves
    it there, so half of the difference is added to its interval.
    """
    choice, error, frame = maker.choice, maker.error, maker.choice.data.frame
    contractions = round_places(frame.x.low, frame.x.high)
    for P in pressures:
        low, high = where.contractions(P) or (0.0, 0.0)
        for x in contractions:
            if not where.holds(P, x):
                continue
            at = {"pressure": P, "contraction": x}
            side = 0.5 * choice.muscle.pressure_gap(x, 2 * float(frame.pressure_radii.max()))
            F, off, wide = partial(_force, P=P, x=x), float(np.hypot(error, side)), WIDE["force"] * choice.data.largest
            yield maker.estimate("F", "force", F, at, misfit=off, wide=wide)
            if frame.x.span > 0:
                K, off = partial(_stiffness, P=P, x=x), error / (WAVE * frame.x.span)
                yield maker.estimate("K", "stiffness", K, at, misfit=off, powers=SLOPE)
        if high - low > WAVE * frame.x.span > 0:
            at = {"pressure": P, "lower": round(low, 5), "upper": round(high, 5)}
            K_s, off = partial(Muscle.secant, P=P, first=low, last=high), error / (high - low)
            yield maker.estimate("K_s", "stiffness", K_s, at, misfit=off, method=SECANT, powers=SLOPE)


def _loops(maker: Reporter, where: Tested, pressures: list[float]) -> Iterator[Estimate]:
    """Width and area of loops over contraction, of half the tested stroke, and of loops over the tested pressures."""
    terms, frame, error = maker.choice.terms, maker.choice.data.frame, maker.error
    for P in pressures if {STOPS_X, SLIDING} & set(terms) else ():
        low, high = where.contractions(P) or (0.0, 0.0)
        if high - low < WAVE * frame.x.span:
            continue
        size = 0.25 * (high - low)
        at, note = {"pressure": P, "amplitude": round(size, 6)}, "around any contraction, at rest"
        H, W = (partial(of, P=P, amplitude=size) for of in (Muscle.gap, Muscle.area))
        yield maker.estimate("H", "force", H, at, misfit=error, note=note)
        yield maker.estimate("W", "work", W, at, misfit=2 * size * error, note=note, powers=WORK)
        if SLIDING in terms:
            yield maker.estimate("F_c", "force", partial(Muscle.friction, P=P), {"pressure": P}, misfit=0.5 * error)
    for x in round_places(frame.x.low, frame.x.high) if STOPS_P in terms else ():
        low, high = where.pressures(x) or (0.0, 0.0)
        if high - low < WAVE * frame.P.span:
            continue
        reach = f"at mid pressure between {show(low, 'pressure', 3)} and {show(high, 'pressure', 3)}"
        gap = partial(Muscle.pressure_gap, x=x, amplitude=0.5 * (high - low))
        yield maker.estimate("H_P", "force", gap, {"contraction": x}, misfit=error, note=reach)


def _damping(maker: Reporter, pressures: list[float]) -> Iterator[Estimate]:
    """Damping by direction; the error of the force at the highest speeds is in the interval.

    With a single speed it cannot be distinguished from hysteresis and has no value.
    """
    rows = maker.choice.data.rows
    speeds = np.abs(rows.v[rows.used])
    fast = float(np.quantile(speeds, FASTEST))
    low, high = np.quantile(speeds[speeds > MOVING * fast], (0.1, 0.9))
    for P in pressures:
        for way, symbol in enumerate(("B_c", "B_r")):
            B, off = partial(_damping_of, P=P, way=way), maker.error / fast
            found = maker.estimate(symbol, "damping", B, {"pressure": P}, misfit=off, powers=SLOPE)
            yield found if high > SEVERAL * low else _unknown(found, ONE_SPEED)


def _creep(maker: Reporter, where: Tested) -> Iterator[Estimate]:
    """Creep in each decade of time."""
    choice, (first, last) = maker.choice, CREEP
    reach = f"between {first:g} and {last:g} s after a step"
    if CREEP_X in choice.terms:
        c_x = partial(Muscle.creep_per_decade, first=first, last=last)
        yield maker.estimate("c_x", "ratio", c_x, {}, note=reach, powers={"displacement": 1})
    frame = choice.data.frame
    for x in round_places(frame.x.low, frame.x.high) if CREEP_P in choice.terms else ():
        if where.pressures(x) is not None:
            c_P = partial(Muscle.pressure_creep_per_decade, x=x, first=first, last=last)
            powers = {"force": 1, "pressure": -1}
            yield maker.estimate("c_P", "force per pressure", c_P, {"contraction": x}, note=reach, powers=powers)


KIND = "surface"
MOST_ROWS = 60_000
"""Number of rows above which they are thinned."""
SLACK = 0.02
"""Share of the largest force below which the muscle is slack or nearly so; such rows are not used."""
FEWEST_TRIALS = 3
"""Trials that a surface needs."""
PAUSE = 15.0
"""Longest time between two trials [s] for which the muscle is assumed to go straight from the end of one to the start
of the other; after a longer one, in which it may have been vented, the next trial starts from rest.
"""
LOOPS, POINTS = 8, 1200
"""Most measured loops in a figure, and points of each."""
Rows = Callable[[RunData, TrialData, float], Record | str]


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Force F [N] and stiffness K [N/m] at places, loops H [N] and W [J], damping [N.s/m] and creep of one muscle.

    `options`: `rows`, kind of run -> function that makes a `Record` of a trial, or a sentence why there is none; runs
    of other kinds are not used.
    """
    rows: Mapping[str, Rows] = (options or {}).get("rows", {})
    records, dropped = records_of(runs, rows)
    if len(records) < FEWEST_TRIALS:
        text = f"a surface needs at least {FEWEST_TRIALS} trials with force, pressure and contraction; there are "
        text += f"{len(records)}"
        return Analysis.of(KIND, runs, results=RESULTS, dropped=dropped, findings=[Finding("fault", text)])
    choice, scales = choose(Data.of(records)), Scales.of(runs)
    findings = [*sentences(choice), *scales.findings(records, ("force",))]
    return Analysis.of(
        KIND, runs, results=RESULTS, estimates=estimates(choice, scales), dropped=dropped, findings=findings,
        traces=loops(choice), facts=facts(choice),
    )  # fmt: skip


def records_of(runs: Sequence[RunData], rows: Mapping[str, Rows]) -> tuple[list[Record], list[Dropped]]:
    """The slow rows of all finished trials, and the trials that have none."""
    trials = [(run, trial) for run in runs if run.kind in rows for trial in run.trials if not trial.again]
    seconds = sum(float(trial.t[-1] - trial.t[0]) for _, trial in trials if len(trial.t))
    rate = min(RATE, MOST_ROWS / max(seconds, 1.0))
    found: list[Record] = []
    dropped = []
    before: tuple[str, float] = "", 0.0
    for run, trial in trials:
        one = rows[run.kind](run, trial, rate) if trial.status == "finished" else f"it is {trial.status}"
        if isinstance(one, str):
            dropped.append(Dropped(trial.name, trial.point, one))
        else:
            found.append(replace(one, goes_on=run.id == before[0] and one.t[0] - before[1] < PAUSE))
            before = run.id, float(one.t[-1])
    largest = max((float(np.max(one.F)) for one in found), default=0.0)
    found = [replace(one, used=one.used & (one.F > SLACK * largest)) for one in found]
    return found, dropped


def sentences(choice: Choice) -> list[Finding]:
    """Prediction of left-out trials, the terms that are needed, and what these tests cannot determine."""
    full = choice.data.largest
    best = choice.score
    named = ", ".join(best.terms[len(ALWAYS) :]) or "neither hysteresis nor creep"
    text = (
        f"trials that were left out are predicted to {_share(best, full)}, with {named}; by the smooth surface and "
        f"damping alone to {_share(choice.plain, full)}, by straight lines over contraction to "
        f"{_share(choice.straight, full)}"
    )
    found = [Finding("note", text)]
    for taken, other in choice.undecided:
        text = (
            f"{taken} explains the difference between both ways, and {other} in its place does nearly as well: one "
            "cycle at one speed does not tell hysteresis from creep. Add small loops inside the large one, another "
            "speed, and holds of at least 30 s"
        )
        found.append(Finding("doubt", text))
    if any(record.by_hand for record in choice.data.records):
        text = "lengths were set by hand: the force of each trial has a constant of its own, which is fitted"
        found.append(Finding("note", text))
    return found


def _share(score: Score, full: float) -> str:
    return f"{show(score.rms, 'force', 2)} rms ({100 * score.rms / full:.2g} % of {show(full, 'force', 4)})"


def facts(choice: Choice) -> dict[str, Any]:
    """Numbers of the fit."""
    frame = choice.data.frame
    return {
        "trials": len(choice.data.records),
        "rows": int(choice.data.rows.used.sum()),
        "pressure": [frame.P.low, frame.P.high],
        "contraction": [frame.x.low, frame.x.high],
        "tested": tested(choice).ranges(frame),
        "terms": list(choice.terms),
        "held_out_rms": choice.score.rms,
        "straight_form_rms": choice.straight.rms,
        "smoothness": choice.score.smooth,
        "tried": [{"terms": list(score.terms), "held_out_rms": score.rms} for score in choice.tried],
        "undecided": [list(pair) for pair in choice.undecided],
        "muscle": choice.muscle.identified("surface").to_dict(),
        "straight_form": choice.lines.straight_form(),
    }


def loops(choice: Choice) -> list[Trace]:
    """Measured force of trials that move at one pressure, and that of the muscle."""
    records, span = choice.data.records, choice.data.frame.x.span
    every = choice.muscle.force(records)
    ends = np.cumsum([0, *(len(one.t) for one in records)])
    moving = [i for i, one in enumerate(records) if span > 0 and np.ptp(one.x[one.used]) > 0.25 * span]
    found = []
    for i in moving[:LOOPS]:
        one = records[i]
        kept = np.flatnonzero(one.used)[:: max(1, int(one.used.sum()) // POINTS)]
        columns = {"displacement": one.x[kept], "force": one.F[kept], "model": every[ends[i] :][kept]}
        quantities = {"displacement": "length", "force": "force", "model": "force"}
        title, marks = f"Force over contraction, {one.group}", {"pressure": float(np.median(one.P))}
        found.append(Trace(f"loop-{i}-surface", "loop", title, columns, quantities, marks))
    return found
