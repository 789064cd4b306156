"""The lines through driven sines of one pressure, mean and amplitude: K, B, F_c, loop widths and areas, with intervals.

Knows measured trials and what is known of the channels; not which runs they come from, nor settings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, pi
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.lines import Line, mean_half, weighted_line
from pmabench.analysis.shared.sine_loop import Sine, measure, replay
from pmabench.analysis.shared.skew import courses, settled
from pmabench.base.quantities import show
from pmabench.kinds.sinusoidal_displacement.form import Point, lost
from pmabench.store.analyses.results import Estimate, Finding, Parts
from pmabench.store.records import Array, RunData, TrialData

HARMONIC, WIDTH = "sine-harmonic", "loop-width"
DISTORTED = 0.05
CHANGES = 0.03
"""Relative change of K over frequency that is worth a sentence."""
BETWEEN = "displacement and force"
CYCLES = "one trial: the repeats part is the scatter of its cycles, and repeated tests may scatter more"
CYCLES_OF_EACH = CYCLES.replace("one trial", "one trial a frequency")
NO_REPEATS = "no repeats part: one trial of one cycle"
ALONE = "one frequency only: damping and friction cannot be separated"


def turned(sine: Sine, by: float) -> Point:
    """The trial had the force come `by` [s] earlier; the width at mid stroke grows by twice what the loss does."""
    ratio = sine.ratio * complex(np.exp(1j * sine.omega * by))
    loss = -ratio.imag * sine.amplitude
    width = sine.width + 2 * (loss - sine.loss)
    return Point(sine.frequency, sine.speed, -ratio.real, ratio, loss, width)


def each_cycle(sine: Sine) -> list[Point]:
    """Each cycle of a trial as a point of the lines."""
    f, omega, cycles = sine.frequency, sine.omega, sine.cycles
    rows = zip(cycles.ratio.tolist(), cycles.size.tolist(), cycles.width.tolist(), strict=True)
    return [Point(f, omega * size, -one.real, one, -one.imag * size, width) for one, size, width in rows]


def lines(points: Sequence[Sine] | Sequence[Point]) -> tuple[Line, Line, Line]:
    """K over all trials, and the lines of loss and width over speed."""
    frequency = np.array([point.frequency for point in points])
    speed = np.array([point.speed for point in points])
    K = np.array([point.stiffness for point in points])
    size = np.array([abs(point.ratio) for point in points])
    # Phase errors turn loss into stiffness: a K counts by the whole force at its frequency.
    pooled = weighted_line(frequency, None, K, size)
    loss = weighted_line(frequency, speed, np.array([point.loss for point in points]))
    width = weighted_line(frequency, speed, np.array([point.width for point in points]))
    return pooled, loss, width


@dataclass(frozen=True, eq=False)
class Member:
    """One usable trial, measured."""

    run: RunData
    trial: TrialData
    sine: Sine
    discard: float
    """Cycles at the start that are left out."""
    per_pressure: float = 0.0
    """Force that the pressure makes at the sine's frequency [N/Pa], taken off the measured one; 0 where unknown."""

    @classmethod
    def of(cls, run: RunData, trial: TrialData, discard: float) -> Member:
        """Measure a trial; raises `NotUsable`."""
        return cls(run, trial, measure(run, trial, discard), discard)

    def again(
        self, later: Mapping[str, float] | None = None, delay: float = 0.0, per_pressure: float | None = None
    ) -> Member:
        """The trial measured with other lags and another delay (`measure`), or with another force by pressure."""
        taken = self.per_pressure if per_pressure is None else per_pressure
        return replace(self, sine=measure(self.run, self.trial, self.discard, taken, later, delay), per_pressure=taken)

    @property
    def guess(self) -> float:
        """Force by pressure [N/Pa] where nothing tells it: F_ce/P."""
        sine = self.sine
        return (sine.force + max(0.0, sine.stiffness * sine.mean)) / sine.pressure

    @property
    def name(self) -> str:
        """`run/index`."""
        return self.trial.name


@dataclass(frozen=True)
class Muscle:
    """K [N/m], B [N.s/m], F_c [N] at one pressure; or their slopes over pressure, all by Pa."""

    K: float
    B: float
    F_c: float


@dataclass(frozen=True, eq=False)
class Fitted:
    """All trials of one pressure, mean and amplitude, and the lines through them."""

    group: Sequence[Member]
    skew: float
    """Bound on the time between displacement and force [s]."""
    K: Line
    """Over all frequencies: start [N/m]."""
    loss: Line
    """Of -Im(F/x) A over omega A: start 4 F_c/pi [N], slope B [N.s/m]."""
    width: Line
    """Of the loop's width over omega A: start 2 F_c [N], slope 2 B [N.s/m]."""
    bias: Mapping[str, float]
    """By replay, of K, B, F_c (both ways)."""
    again: Sequence[Sine]
    """The replay of each trial of the group."""
    replayed: Muscle
    """What was replayed."""

    @classmethod
    def of(cls, group: Sequence[Member], skew: float) -> Fitted:
        """Fit the lines, then replay the fitted muscle along each trial's motion and fit again.

        With one frequency all of the loss is replayed as damping, for want of a line.
        """
        sines = [member.sine for member in group]
        K, loss, width = lines(sines)
        alone = bool(np.isnan(loss.slope))
        damping = float(np.mean([sine.loss / sine.speed for sine in sines])) if alone else loss.slope
        muscle = Muscle(K.start, damping, 0.0 if alone else pi / 4 * loss.start)
        again = [replay(sine, muscle.K, muscle.B, muscle.F_c) for sine in sines]
        again_K, again_loss, again_width = lines(again)
        bias = {
            "K": again_K.start - muscle.K,
            "B": again_loss.slope - muscle.B,
            "F_c": pi / 4 * again_loss.start - muscle.F_c,
            "B width": again_width.slope / 2 - muscle.B,
            "F_c width": again_width.start / 2 - muscle.F_c,
        }
        return cls(group, skew, K, loss, width, bias, again, muscle)

    @property
    def alone(self) -> bool:
        """Whether there is one frequency only."""
        return bool(np.isnan(self.loss.slope))

    @property
    def muscle(self) -> Muscle:
        """What the lines say; 0 for what one frequency cannot tell."""
        return Muscle(self.K.start, 0.0, 0.0) if self.alone else self.replayed

    def estimates(self, at: Mapping[str, float], scales: Scales, slopes: Muscle | None) -> list[Estimate]:
        """K, B, F_c over all frequencies, then all of each frequency; `slopes` over pressure, None where not known.

        Calibration, to first order: K, B ~ F/x; F_c, H ~ F; W ~ F x; a phase has no scale. All of them are given for a
        pressure that may be off, too, and so are off by their slope over pressure times that.
        """
        return [*self._pooled(at, scales, slopes), *self._single(at, scales, slopes)]

    def _pooled(self, at: Mapping[str, float], scales: Scales, slopes: Muscle | None) -> list[Estimate]:
        parents = tuple(member.name for member in self.group)
        skewed, crept, halves, w = self.skewed(), self._crept(), self.halves(), self.width
        values = {
            "K": self.K.start,
            "B": self.loss.slope,
            "F_c": pi / 4 * self.loss.start,
            "B width": w.slope / 2,
            "F_c width": w.start / 2,
        }
        # The two readings of the same loops differ by what neither model holds, friction at low speed for instance.
        apart = {"B": values["B"] - values["B width"], "F_c": values["F_c"] - values["F_c width"]}
        true = "loop width at 0 Hz: true hysteresis"
        found = []
        for symbol, name, factor, note in (
            ("K", "K", 1, ""),
            ("B", "B", 1, "(B_c + B_r)/2"),
            ("F_c", "F_c", 1, ""),
            ("B", "B width", 1, "(B_c + B_r)/2"),
            ("F_c", "F_c width", 1, ""),
            ("H", "F_c width", 2, true),
        ):
            unit, quantity = {"K": ("N/m", "stiffness"), "B": ("N.s/m", "damping")}.get(symbol, ("N", "force"))
            method = WIDTH if "width" in name else HARMONIC
            where = at if factor == 1 else {**at, "frequency": 0.0}
            e = Estimate(symbol, None, unit, quantity, method, where, n=len(parents), note=ALONE, trials=parents)
            value, bias, half = factor * values[name], factor * self.bias[name], halves[name]
            if np.isnan(value):
                found.append(e)
                continue
            half = None if half is None else factor * half
            doubt = hypot(bias, apart.get(symbol, 0.0), factor * crept[name])
            slope = None if slopes is None else factor * getattr(slopes, name.removesuffix(" width"))
            gains = {"force": value, "displacement": -value if symbol in ("K", "B") else 0.0}
            part = _calibration(scales, gains, slope, at.get("pressure", 0.0))
            parts = Parts(half, doubt, part, factor * skewed[name])
            said = sentences(note, self._repeats_note(half))
            e = replace(e, value=value - bias, parts=parts, bias=bias, corrected=True, note=said)
            found.append(settled(e, BETWEEN, self.skew))
        return found

    def _crept(self) -> dict[str, float]:
        """What creep may do to K, B and F_c (both ways): half of what it does to K, the lines without its loss."""
        sines = [member.sine for member in self.group]
        most = dict.fromkeys(self.bias, 0.0)
        for loss, softer in lost(sines, [cycle for sine in sines for cycle in each_cycle(sine)]):
            points = [
                Point(s.frequency, s.speed, s.stiffness, s.ratio, s.loss - part, s.width - 2 * part)
                for s, part in zip(sines, loss * np.array([sine.amplitude for sine in sines]), strict=True)
            ]
            changes = self._changes(*lines(points)) | {"K": 0.5 * float(np.ptp(softer))}
            most = {name: max(most[name], abs(change)) for name, change in changes.items()}
        return most

    def _changes(self, K: Line, loss: Line, width: Line) -> dict[str, float]:
        """How far other lines give another K, B and F_c (both ways)."""
        return {
            "K": K.start - self.K.start,
            "B": loss.slope - self.loss.slope,
            "F_c": pi / 4 * (loss.start - self.loss.start),
            "B width": (width.slope - self.width.slope) / 2,
            "F_c width": (width.start - self.width.start) / 2,
        }

    def skewed(self) -> dict[str, float]:
        """What the time between displacement and force may do to K, B and F_c (both ways): the lines once more."""
        most = dict.fromkeys(self.bias, 0.0)
        both = self.skew * courses([member.trial for member in self.group])
        for course in (*both, *-both) if self.skew else ():
            moved = [turned(member.sine, float(by)) for member, by in zip(self.group, course, strict=True)]
            changes = self._changes(*lines(moved))
            most = {name: max(most[name], abs(change)) for name, change in changes.items()}
        return most

    def halves(self) -> dict[str, float | None]:
        """Of K, B and F_c (both ways): by the scatter of trials or by that of cycles, if wider.

        Cycles of one trial are no independent tests; `mean_half` widens for that where there is a single trial.
        """
        cycles = lines([cycle for member in self.group for cycle in each_cycle(member.sine)])
        (of_K, each_K), loss, width = zip((self.K, self.loss, self.width), cycles, strict=True)
        first = self.group[0].sine
        both = {
            "K": (of_K.half_start, each_K.half_start),
            "B": tuple(line.half_slope for line in loss),
            "F_c": tuple(_times(line.half_start, pi / 4) for line in loss),
            "B width": tuple(_times(line.half_slope, 0.5) for line in width),
            "F_c width": tuple(_times(line.half_start, 0.5) for line in width),
        }
        if len(self.group) == 1:
            both["K"] = (None, mean_half(np.array([first.stiffness]), [-first.cycles.ratio.real]))
        known = {name: [half for half in pair if half is not None] for name, pair in both.items()}
        return {name: max(halves) if halves else None for name, halves in known.items()}

    def _repeats_note(self, half: float | None) -> str:
        if half is None:
            return NO_REPEATS
        if len(self.group) == 1:
            return CYCLES
        return CYCLES_OF_EACH if self.loss.half_start is None and not self.alone else ""

    def _single(self, at: Mapping[str, float], scales: Scales, slopes: Muscle | None) -> list[Estimate]:
        """K, phase, loop width H and loop area W at each frequency; the method part is what the replay is off by."""
        found = []
        P = at.get("pressure", 0.0)
        for frequency, places in sorted(self._places().items()):
            sines = [self.group[i].sine for i in places]
            names = tuple(self.group[i].name for i in places)
            first, omega = sines[0], 2 * pi * frequency
            A, K = first.amplitude, first.stiffness
            moved = [turned(first, by) for by in (self.skew, -self.skew)]
            skewed_stiffness, skewed_loss = (
                max(abs(getattr(one, of) - getattr(first, of)) for one in moved) for of in ("stiffness", "loss")
            )
            truth = _truth(self.replayed, omega, A)
            slope = {} if slopes is None else _slopes(self.replayed, slopes, omega, A)
            rows: tuple[_Row, ...] = (
                ("K", "N/m", "stiffness", lambda s: s.stiffness, lambda s: -s.cycles.ratio.real,
                 {"force": K, "displacement": -K}, skewed_stiffness),
                ("phi", "rad", "angle", lambda s: s.phase,
                 lambda s: np.arctan2(-s.cycles.ratio.imag, -s.cycles.ratio.real), {}, omega * self.skew),
                ("H", "N", "force", lambda s: s.width, lambda s: s.cycles.width,
                 {"force": first.width}, 2 * skewed_loss),
                ("W", "J", "work", lambda s: s.area, lambda s: s.cycles.area,
                 {"force": first.area, "displacement": first.area}, pi * A * skewed_loss),
            )  # fmt: skip
            for symbol, unit, quantity, whole, by_cycle, gains, skewed in rows:
                values = np.array([whole(sine) for sine in sines])
                half = mean_half(values, [by_cycle(sine) for sine in sines])
                bias = float(np.mean([whole(self.again[i]) for i in places])) - truth[symbol]
                part = _calibration(scales, gains, slope.get(symbol), P)
                method = WIDTH if symbol in ("H", "W") else HARMONIC
                note = NO_REPEATS if half is None else CYCLES if len(sines) == 1 else ""
                one = Estimate(
                    symbol, float(values.mean()) - bias, unit, quantity, method, {**at, "frequency": frequency},
                    Parts(half, abs(bias), part, skewed), len(sines), bias, True, note, names,
                )  # fmt: skip
                found.append(settled(one, BETWEEN, self.skew))
        return found

    def _places(self) -> dict[float, list[int]]:
        """Places in the group by frequency [Hz]."""
        groups: dict[float, list[int]] = {}
        for place, member in enumerate(self.group):
            groups.setdefault(member.sine.frequency, []).append(place)
        return groups

    @property
    def by_frequency(self) -> dict[float, list[Sine]]:
        """Measured trials by frequency [Hz]."""
        return {frequency: [self.group[i].sine for i in places] for frequency, places in self._places().items()}

    def findings(self, at: Mapping[str, float]) -> list[Finding]:
        """What catches the eye."""
        where = show(at["pressure"], "pressure") if "pressure" in at else "this pressure"
        lines = []
        if self.K.start <= 0:
            text = f"at {where} the force rises with contraction: a sign is wrong in displacement or force"
            lines.append(Finding("fault", text))
        for member in self.group:
            if member.sine.distortion > DISTORTED:
                share = f"{member.sine.distortion:.0%} of the measured displacement is no sine"
                lines.append(Finding("doubt", f"trial {member.name}: {share}"))
        if self.alone:
            lines.append(Finding("note", f"at {where}, {ALONE}"))
        stiffness = {f: float(np.mean([sine.stiffness for sine in sines])) for f, sines in self.by_frequency.items()}
        spread = (max(stiffness.values()) - min(stiffness.values())) / abs(self.K.start)
        if spread > CHANGES:
            text = f"at {where} K changes by {spread:.0%} over frequency: one K is a mean of unlike values"
            lines.append(Finding("note", text))
        if self.skew > 0 and self.loss.slope > 0:
            part = self.skew * abs(self.K.start) / self.loss.slope
            text = f"at {where} displacement and force may be {self.skew * 1e3:.3g} ms apart: B is uncertain by "
            lines.append(Finding("doubt" if part > 0.05 else "note", f"{text}{part:.1%} for that alone"))
        return lines

    def facts(self) -> dict[str, Any]:
        """Numbers of the fit, plain data."""
        sines = [member.sine for member in self.group]
        speed = np.array([sine.speed for sine in sines])
        left = np.array([sine.loss for sine in sines]) - self.loss.start - self.loss.slope * speed
        rms = float(np.sqrt(np.mean(left**2)))
        return {
            "residual_rms": None if np.isnan(rms) else rms,
            "time_skew": self.skew,
            "cycles": [len(sine.cycles.area) for sine in sines],
            "distortion": max(sine.distortion for sine in sines),
        }


_Row = tuple[str, str, str, Callable[[Sine], float], Callable[[Sine], Array], Mapping[str, float], float]
"""Symbol, unit, quantity; value of a trial and by cycle; change by relative change of a channel; half width of skew."""


def _calibration(scales: Scales, gains: Mapping[str, float], slope: float | None, P: float) -> float | None:
    """The calibration part: scales of force, displacement and pressure."""
    gains = {name: change for name, change in gains.items() if change}
    if slope is not None:
        return scales.part({**gains, "pressure": slope * P}, {"pressure": slope})
    return scales.part(gains)


def _truth(muscle: Muscle, omega: float, A: float) -> dict[str, float]:
    """What a muscle gives at speed amplitude omega A [m/s] (paper 0, along a sine)."""
    loss = muscle.B * omega + 4 * muscle.F_c / (pi * A)
    return {
        "K": muscle.K,
        "phi": float(np.arctan2(loss, muscle.K)),
        "H": 2 * (muscle.B * omega * A + muscle.F_c),
        "W": pi * loss * A**2,
    }


def _slopes(muscle: Muscle, slopes: Muscle, omega: float, A: float) -> dict[str, float]:
    """Slopes of `_truth` over pressure, by a small step."""
    step = 1e3
    near = Muscle(muscle.K + step * slopes.K, muscle.B + step * slopes.B, muscle.F_c + step * slopes.F_c)
    here, there = _truth(muscle, omega, A), _truth(near, omega, A)
    return {symbol: (there[symbol] - here[symbol]) / step for symbol in here}


def _times(half: float | None, factor: float) -> float | None:
    return None if half is None else half * factor
