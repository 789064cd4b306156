"""Lines through driven sines of one pressure, mean and amplitude: K, B, F_c, loop widths and areas, with intervals.

Uses measured trials and the channels' uncertainties; knows no run and no settings.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot, pi
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales, changes, sentences
from pmabench.analysis.shared.lines import Line, mean_half, weighted_line
from pmabench.analysis.shared.sine_loop import Sine, Swing, measure, replay
from pmabench.analysis.shared.skew import courses, settled
from pmabench.analysis.shared.trials import Point, grouped
from pmabench.kinds.sinusoidal_displacement.form import Form, lost, pressure_of
from pmabench.store.analyses.results import Estimate, Finding, Parts
from pmabench.store.records import Array, RunData, TrialData

HARMONIC, WIDTH = "sine-harmonic", "loop-width"
DISTORTED = 0.05
CHANGES = 0.03
"""Relative change of K over frequency from which on it is reported."""
BETWEEN = "displacement and force"
CYCLES = "one trial: the repeats part is the scatter of its cycles, and repeated tests may scatter more"
CYCLES_OF_EACH = CYCLES.replace("one trial", "one trial a frequency")
NO_REPEATS = "no repeats part: one trial of one cycle"
ALONE = "one frequency only: damping and friction cannot be separated"


NUMBERS = {
    "K": ("K", "start", 1.0),
    "B": ("loss", "slope", 1.0),
    "F_c": ("loss", "start", pi / 4),
    "B width": ("width", "slope", 0.5),
    "F_c width": ("width", "start", 0.5),
}
"""K [N/m], and B [N.s/m] and F_c [N] from the loss and from the width -> line, its start or slope, and a factor."""


@dataclass(frozen=True)
class Lines:
    """The lines through driven sines, or through their cycles."""

    K: Line
    """Over all frequencies: start [N/m]."""
    loss: Line
    """-Im(F/x) A over omega A: start 4 F_c/pi [N], slope B [N.s/m]."""
    width: Line
    """Loop width over omega A: start 2 F_c [N], slope 2 B [N.s/m]."""

    @classmethod
    def of(cls, swings: Sequence[Swing]) -> Lines:
        """K over all frequencies, and the lines of loss and width over speed."""
        frequency, speed, K, size, loss, width = (
            np.array(column)
            for column in zip(*((s.frequency, s.speed, s.stiffness, abs(s.ratio), s.loss, s.width) for s in swings),
                              strict=True)
        )  # fmt: skip
        # phase errors turn loss into stiffness, so the error of K is a share of the whole force at its frequency
        pooled = weighted_line(frequency, None, K, size)
        return cls(pooled, weighted_line(frequency, speed, loss), weighted_line(frequency, speed, width))

    @property
    def values(self) -> dict[str, float]:
        """Each of `NUMBERS`; NaN where one frequency does not determine it."""
        return {name: by * float(getattr(getattr(self, line), of)) for name, (line, of, by) in NUMBERS.items()}

    @property
    def halves(self) -> dict[str, float | None]:
        """Half widths of the same."""
        known = {name: getattr(getattr(self, line), f"half_{of}") for name, (line, of, _) in NUMBERS.items()}
        return {name: None if half is None else NUMBERS[name][2] * half for name, half in known.items()}

    def largest_changes(self, others: Iterable[Sequence[Swing]]) -> dict[str, float]:
        """The largest change of each of `NUMBERS` to those of the lines through other swings."""
        return changes(self.values, *(Lines.of(swings).values for swings in others))


@dataclass(frozen=True, eq=False)
class Member:
    """One usable trial, measured."""

    run: RunData
    trial: TrialData
    sine: Sine
    discard: float
    """Cycles at the start that are left out."""
    per_pressure: float = 0.0
    """Derivative of the force by pressure [N/Pa], for its correction at the sine's frequency; 0 where unknown."""

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
        """Estimate F_ce/P of the force per pressure [N/Pa] where it is unknown."""
        sine = self.sine
        return (sine.force + max(0.0, sine.stiffness * sine.mean)) / sine.pressure

    @property
    def name(self) -> str:
        """`run/index`."""
        return self.trial.name


@dataclass(frozen=True)
class Muscle:
    """K [N/m], B [N.s/m], F_c [N] at one pressure; or their derivatives by pressure [per Pa]."""

    K: float
    B: float
    F_c: float


@dataclass(frozen=True, eq=False)
class Fitted:
    """All trials of one pressure, mean and amplitude, and the lines through them."""

    group: Sequence[Member]
    skew: float
    """Bound on the time between displacement and force [s]."""
    lines: Lines
    bias: Mapping[str, float]
    """Bias of each of `NUMBERS` by replay."""
    again: Sequence[Sine]
    """The replay of each trial of the group."""
    replayed: Muscle
    """The muscle that was replayed."""

    @classmethod
    def of(cls, group: Sequence[Member], skew: float) -> Fitted:
        """Fit the lines, then replay the fitted muscle along each trial's motion and fit again.

        With one frequency all of the loss is replayed as damping, for want of a line.
        """
        sines = [member.sine for member in group]
        lines = Lines.of(sines)
        K, B, F_c, *_ = lines.values.values()
        if np.isnan(B):
            B, F_c = float(np.mean([sine.loss / sine.speed for sine in sines])), 0.0
        muscle, again = Muscle(K, B, F_c), [replay(sine, K, B, F_c) for sine in sines]
        of_replay = Lines.of(again).values
        bias = {name: value - getattr(muscle, name.removesuffix(" width")) for name, value in of_replay.items()}
        return cls(group, skew, lines, bias, again, muscle)

    @property
    def alone(self) -> bool:
        """Whether there is only one frequency."""
        return bool(np.isnan(self.lines.loss.slope))

    @property
    def muscle(self) -> Muscle:
        """The muscle from the lines; 0 for what one frequency does not determine."""
        return Muscle(self.replayed.K, 0.0, 0.0) if self.alone else self.replayed

    @property
    def sines(self) -> list[Sine]:
        """The sines of all trials."""
        return [member.sine for member in self.group]

    @cached_property
    def form(self) -> Form:
        """Harmonics of their force."""
        return Form.of(self.sines, self.replayed.B)

    def estimates(self, at: Mapping[str, float], scales: Scales, slopes: Muscle | None) -> list[Estimate]:
        """K, B, F_c over all frequencies, then the values at each frequency; `slopes` by pressure, None where unknown.

        Calibration to first order: K, B ~ F/x; F_c, H ~ F; W ~ F x; a phase has no scale. An error of the pressure for
        which they are given enters through their slope over pressure.
        """
        return [*self._pooled(at, scales, slopes), *self._single(at, scales, slopes)]

    def _pooled(self, at: Mapping[str, float], scales: Scales, slopes: Muscle | None) -> list[Estimate]:
        parents = tuple(member.name for member in self.group)
        skewed, crept, halves, values = self.skewed(), self._crept(), self.halves(), self.lines.values
        # loss and width of the same loops differ by what neither model has, for instance friction at low speed
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
            part = scales.part_at(at.get("pressure", 0.0), slope, gains, {})
            parts = Parts(half, doubt, part, factor * skewed[name])
            said = sentences(note, self._repeats_note(half))
            e = replace(e, value=value - bias, parts=parts, bias=bias, corrected=True, note=said)
            found.append(settled(e, BETWEEN, self.skew))
        return found

    def _crept(self) -> dict[str, float]:
        """Possible effect of creep on each of `NUMBERS`: half of the effect on K, and the lines without its loss."""
        creeps = lost(self.sines, [cycle for sine in self.sines for cycle in sine.cycles])
        softer = max((0.5 * float(np.ptp(change)) for _, change in creeps), default=0.0)
        others = (
            [sine.less(part * sine.amplitude) for sine, part in zip(self.sines, loss, strict=True)]
            for loss, _ in creeps
        )
        return self.lines.largest_changes(others) | {"K": softer}

    def skewed(self) -> dict[str, float]:
        """Effect on each of `NUMBERS` of the time between displacement and force at its bound."""
        both = self.skew * courses([member.trial for member in self.group])
        ways = (*both.tolist(), *(-both).tolist()) if self.skew else ()
        return self.lines.largest_changes(
            [sine.turned(by) for sine, by in zip(self.sines, course, strict=True)] for course in ways
        )

    def halves(self) -> dict[str, float | None]:
        """Half width of each of `NUMBERS`, from the scatter of trials or of cycles, whichever is wider.

        Cycles of one trial are not independent; `mean_half` widens for that if there is a single trial.
        """
        first, cycles = self.sines[0], Lines.of([cycle for sine in self.sines for cycle in sine.cycles])
        by_trial, by_cycle = self.lines.halves, cycles.halves
        if len(self.group) == 1:
            by_trial["K"] = None
            by_cycle["K"] = mean_half(np.array([first.stiffness]), [np.array([one.stiffness for one in first.cycles])])
        known = {name: [h for h in (by_trial[name], by_cycle[name]) if h is not None] for name in NUMBERS}
        return {name: max(halves, default=None) for name, halves in known.items()}

    def _repeats_note(self, half: float | None) -> str:
        if half is None:
            return NO_REPEATS
        if len(self.group) == 1:
            return CYCLES
        return CYCLES_OF_EACH if self.lines.loss.half_start is None and not self.alone else ""

    def _single(self, at: Mapping[str, float], scales: Scales, slopes: Muscle | None) -> list[Estimate]:
        """K, phase, loop width H and loop area W at each frequency; the method part is the bias by replay."""
        found = []
        P = at.get("pressure", 0.0)
        places = grouped(range(len(self.group)), lambda place: self.group[place].sine.frequency)
        for frequency, mine in sorted(places.items()):
            sines = [self.group[i].sine for i in mine]
            first, omega = sines[0], 2 * pi * frequency
            A, K = first.amplitude, first.stiffness
            moved = [first.turned(by) for by in (self.skew, -self.skew)]
            skewed_stiffness, skewed_loss = (
                max(abs(getattr(one, of) - getattr(first, of)) for one in moved) for of in ("stiffness", "loss")
            )
            truth = _truth(self.replayed, omega, A)
            slope = {} if slopes is None else _slopes(self.replayed, slopes, omega, A)
            rows: tuple[tuple[str, str, str, str, Mapping[str, float], float], ...] = (
                ("K", "stiffness", "N/m", "stiffness", {"force": K, "displacement": -K}, skewed_stiffness),
                ("phi", "phase", "rad", "angle", {}, omega * self.skew),
                ("H", "width", "N", "force", {"force": first.width}, 2 * skewed_loss),
                ("W", "area", "J", "work", {"force": first.area, "displacement": first.area}, pi * A * skewed_loss),
            )
            for symbol, of, unit, quantity, gains, skewed in rows:
                values = np.array([getattr(sine, of) for sine in sines])
                cycles = [np.array([getattr(one, of) for one in sine.cycles]) for sine in sines]
                bias = float(np.mean([getattr(self.again[i], of) for i in mine])) - truth[symbol]
                method = WIDTH if symbol in ("H", "W") else HARMONIC
                parts = Parts(None, abs(bias), scales.part_at(P, slope.get(symbol), gains, {}), skewed)
                here, names = {**at, "frequency": frequency}, [self.group[i].name for i in mine]
                e = of_cycles(symbol, (unit, quantity), method, here, names, values - bias, cycles, parts)
                found.append(settled(replace(e, bias=bias, corrected=True), BETWEEN, self.skew))
        return found

    @property
    def by_frequency(self) -> dict[float, list[Sine]]:
        """Measured trials by frequency [Hz]."""
        return grouped(self.sines, lambda sine: sine.frequency)

    def findings(self, at: Mapping[str, float]) -> list[Finding]:
        """Distortion, changes of K over frequency, and similar observations."""
        where, lines = pressure_of(at), []
        if self.lines.K.start <= 0:
            text = f"at {where} the force rises with contraction: a sign is wrong in displacement or force"
            lines.append(Finding("fault", text))
        for member in self.group:
            if member.sine.distortion > DISTORTED:
                share = f"{member.sine.distortion:.0%} of the measured displacement is no sine"
                lines.append(Finding("doubt", f"trial {member.name}: {share}"))
        if self.alone:
            lines.append(Finding("note", f"at {where}, {ALONE}"))
        stiffness = {f: float(np.mean([sine.stiffness for sine in sines])) for f, sines in self.by_frequency.items()}
        spread = (max(stiffness.values()) - min(stiffness.values())) / abs(self.lines.K.start)
        if spread > CHANGES:
            text = f"at {where} K changes by {spread:.0%} over frequency: one K is a mean of unlike values"
            lines.append(Finding("note", text))
        if self.skew > 0 and self.lines.loss.slope > 0:
            part = self.skew * abs(self.lines.K.start) / self.lines.loss.slope
            text = f"at {where} displacement and force may be {self.skew * 1e3:.3g} ms apart: B is uncertain by "
            lines.append(Finding("doubt" if part > 0.05 else "note", f"{text}{part:.1%} for that alone"))
        return lines

    def facts(self) -> dict[str, Any]:
        """Numbers of the fit, plain data."""
        sines, line = self.sines, self.lines.loss
        rms = float(np.sqrt(np.mean([(sine.loss - line.start - line.slope * sine.speed) ** 2 for sine in sines])))
        return {
            "residual_rms": None if np.isnan(rms) else rms,
            "time_skew": self.skew,
            "cycles": [len(sine.cycles) for sine in sines],
            "distortion": max(sine.distortion for sine in sines),
        }


def of_cycles(
    symbol: str, kind: tuple[str, str], method: str, at: Mapping[str, float], trials: Sequence[str], values: Array,
    cycles: Sequence[Array], parts: Parts, note: str = "", coordinate: str = "",
) -> Estimate:  # fmt: skip
    """The mean of one value of each trial, `values` (n,), with the half width of their `cycles` or their scatter."""
    half = mean_half(values, cycles)
    said = sentences(NO_REPEATS if half is None else CYCLES if len(trials) == 1 else "", note)
    return Estimate(
        symbol, float(values.mean()), *kind, method, dict(at), replace(parts, repeats=half), len(trials), note=said,
        trials=tuple(trials), coordinate=coordinate,
    )  # fmt: skip


def of_like_motion(fits: Mapping[Point, Fitted]) -> list[list[Point]]:
    """Groups of two or more cells that differ in pressure only, by ascending pressure."""
    pressed = sorted(key for key in fits if "pressure" in dict(key))
    groups = grouped(pressed, lambda key: tuple(item for item in key if item[0] != "pressure"))
    return [keys for keys in groups.values() if len(keys) > 1]


def _truth(muscle: Muscle, omega: float, A: float) -> dict[str, float]:
    """K, phase, H and W of a muscle at speed amplitude omega A [m/s] (paper 0, along a sine)."""
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
