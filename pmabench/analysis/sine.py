"""Reduction of driven sines: K, B, F_c and loop widths from the first harmonics of displacement and force.

Knows the samples and the protocol's settings; not how the bench is built. One trial is measured in `sine_loop`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import nan, pi, sqrt
from typing import Any

import numpy as np

from pmabench.analysis.lines import Line, mean_half, weighted_line
from pmabench.analysis.results import Analysis, Dropped, Estimate, Finding, Parts, Trace
from pmabench.analysis.sine_loop import NotUsable, Sine, measure, replay
from pmabench.analysis.sine_traces import traces_of
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

KIND = "sinusoidal-displacement"
HARMONIC, WIDTH = "sine-harmonic", "loop-width"
CELL = ("pressure", "mean", "amplitude")
UNEVEN = 0.01
"""Share of the force that uncorrected pressure at the sine's frequency may be worth before it is doubted."""
DISTORTED = 0.05
CHANGES = 0.03
"""Relative change of K over frequency that is worth a sentence."""


@dataclass(frozen=True, eq=False)
class _Member:
    """One usable trial, measured."""

    run: RunData
    trial: TrialData
    sine: Sine

    @property
    def name(self) -> str:
        """`run/index`."""
        return f"{self.trial.run}/{self.trial.index}"


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """K [N/m], B [N.s/m], F_c [N], loop widths [N] and areas [J] of sinusoidal displacement at constant pressure.

    The muscle pulls with F = F_ce - K x - B x' - F_c sign x'. With the complex amplitudes of measured displacement and
    force at the known frequency (three-parameter sine fit, IEEE 1057): K = -Re(F/x), and -Im(F/x) A = B omega A +
    4 F_c/pi, a line over the speed omega A. B is (B_c + B_r)/2 where the two directions differ. The width of the loop
    at mid stroke is 2 B omega A + 2 F_c: what is left at 0 Hz is true hysteresis, the rest is phase lag.

    `options`: `discard` (cycles at the start; else the plan's setting, else 1), `time_skew` [s] (bound on the time
    between displacement and force; else the plan's setting, else 0), `force_per_pressure` dF/dP [N/Pa].
    """
    options = options or {}
    members, dropped = _members(runs, options)
    members, findings = _even_pressure(members, options)
    estimates: list[Estimate] = []
    traces: list[Trace] = []
    lines: list[dict[str, Any]] = []
    for key, group in sorted(_grouped(members, CELL).items()):
        fitted = _Fitted.of(group, _skew(group, options))
        estimates += [*fitted.pooled(dict(key)), *fitted.single(dict(key))]
        findings += fitted.findings(dict(key))
        lines.append({"at": dict(key), **fitted.facts()})
        sines = {f: [member.sine for member in members] for f, members in fitted.by_frequency.items()}
        traces += traces_of(dict(key), sines, fitted.muscle)
    return Analysis(
        kind=KIND,
        runs=tuple(run.id for run in runs),
        simulated=any(run.simulated for run in runs),
        estimates=tuple(estimates),
        dropped=tuple(dropped),
        findings=tuple(findings),
        traces=tuple(traces),
        facts={
            "options": dict(options),
            "trials": len(members),
            "cells": len(_grouped(members, (*CELL, "frequency"))),
            "lines": lines,
        },
    )


def _setting(run: RunData, options: Mapping[str, Any], name: str, default: float) -> float:
    """A setting: the option, else what the plan says, else the default."""
    settings = run.plan.get("settings") or {}
    return float(options.get(name, settings.get(name, default)))


def _skew(group: Sequence[_Member], options: Mapping[str, Any]) -> float:
    return max(_setting(member.run, options, "time_skew", 0.0) for member in group)


def _members(runs: Sequence[RunData], options: Mapping[str, Any]) -> tuple[list[_Member], list[Dropped]]:
    members: list[_Member] = []
    dropped: list[Dropped] = []
    for run in runs:
        discard = _setting(run, options, "discard", 1)
        for trial in run.trials:
            try:
                members.append(_Member(run, trial, measure(run, trial, discard)))
            except NotUsable as reason:
                dropped.append(Dropped(f"{trial.run}/{trial.index}", trial.point, str(reason)))
    return members, dropped


def _grouped(members: Sequence[_Member], names: Sequence[str]) -> dict[tuple[tuple[str, float], ...], list[_Member]]:
    groups: dict[tuple[tuple[str, float], ...], list[_Member]] = {}
    for member in members:
        point = member.trial.point
        groups.setdefault(tuple((name, round(point[name], 9)) for name in names if name in point), []).append(member)
    return groups


def _even_pressure(members: Sequence[_Member], options: Mapping[str, Any]) -> tuple[list[_Member], list[Finding]]:
    """Take off the force that pressure at the sine's own frequency makes: dF/dP times that pressure.

    dF/dP [N/Pa] is the option `force_per_pressure`, else the slope of mean force over mean pressure among trials of
    the same mean displacement. Where neither is known nothing is taken off; what it may be worth is then doubted.
    """
    even: list[_Member] = []
    findings: list[Finding] = []
    for _, group in sorted(_grouped(members, ("mean",)).items()):
        pressures = np.array([member.sine.pressure for member in group])
        forces = np.array([member.sine.force for member in group])
        slope = float(options.get("force_per_pressure", nan))
        if np.isnan(slope) and not np.isnan(pressures).any() and np.ptp(pressures) > 0.1 * pressures.max():
            slope = float(np.polyfit(pressures, forces, 1)[0])
        for member in group:
            sine = member.sine
            guess = sine.force / sine.pressure if np.isnan(slope) else slope
            share = abs(sine.ripple) * abs(guess) / (abs(sine.ratio) * sine.amplitude) if sine.ripple else 0.0
            if not np.isnan(slope) and share > 1e-4:
                discard = _setting(member.run, options, "discard", 1)
                even.append(_Member(member.run, member.trial, measure(member.run, member.trial, discard, slope)))
                continue
            even.append(member)
            if share > UNEVEN:
                findings.append(
                    Finding(
                        "doubt",
                        f"trial {member.name}: the pressure swings by {show(abs(sine.ripple), 'pressure', 3)} with the "
                        f"sine, worth about {share:.1%} of the force; give force_per_pressure, or run at two pressures",
                    )
                )
    return even, findings


@dataclass(frozen=True, eq=False)
class _Fitted:
    """All trials of one pressure, mean and amplitude, and the lines through them."""

    group: Sequence[_Member]
    skew: float
    K: tuple[float, float | None]
    """Over all frequencies [N/m], with its half width."""
    loss: Line
    """Of -Im(F/x) A over omega A: start 4 F_c/pi [N], slope B [N.s/m]."""
    width: Line
    """Of the loop's width over omega A: start 2 F_c [N], slope 2 B [N.s/m]."""
    bias: Mapping[str, float]
    """By replay, of K, B, F_c (both ways) and the width at 0 Hz."""

    @classmethod
    def of(cls, group: Sequence[_Member], skew: float) -> _Fitted:
        """Fit the lines, then replay the fitted muscle along each trial's motion and fit again."""
        sines = [member.sine for member in group]
        K, loss, width = _lines(sines)
        _, B, F_c = fitted = _muscle(K[0], loss)
        again_K, again, again_width = _lines([replay(sine, *fitted) for sine in sines])
        bias = {
            "K": again_K[0] - K[0],
            "B": again.slope - B,
            "F_c": pi / 4 * again.start - F_c,
            "B width": again_width.slope / 2 - B,
            "F_c width": again_width.start / 2 - F_c,
        }
        return cls(group, skew, K, loss, width, bias)

    @property
    def muscle(self) -> tuple[float, float, float]:
        """K [N/m], B [N.s/m], F_c [N]; 0 for what one frequency cannot tell."""
        return _muscle(self.K[0], self.loss)

    @property
    def scales(self) -> tuple[float, float]:
        """Relative expanded uncertainties of force and displacement [1]."""

        def worst(name: str) -> float:
            return max(m.run.channels[name].gain_uncertainty if name in m.run.channels else 0.0 for m in self.group)

        return worst("force"), worst("displacement")

    def pooled(self, at: Mapping[str, float]) -> list[Estimate]:
        """K, B, F_c and the width at 0 Hz: one value over all frequencies."""
        force, length = self.scales
        both = sqrt(force**2 + length**2)
        parents = tuple(member.name for member in self.group)
        alone = len({member.sine.frequency for member in self.group}) < 2
        missing = "one frequency only: damping and friction cannot be told apart" if alone else ""

        def estimate(
            symbol: str, kind: tuple[str, str], method: str, value: float, half: float | None,
            bias: float, calibration: float, note: str = "", where: Mapping[str, float] = at,
        ) -> Estimate:  # fmt: skip
            if np.isnan(value):
                return Estimate(symbol, None, *kind, method, where, note=missing, n=len(parents), trials=parents)
            doubt = sqrt(bias**2 + apart.get(symbol, 0.0) ** 2)
            return Estimate(
                symbol, value - bias, *kind, method, where, Parts(half, doubt, calibration), len(parents),
                bias, True, note, parents,
            )  # fmt: skip

        K, B, w = self.K[0], self.loss.slope, self.width
        stiffness, damping, newton = ("N/m", "stiffness"), ("N.s/m", "damping"), ("N", "force")
        fastest = max(member.sine.omega for member in self.group)
        skewed = self.skew * (abs(K) + abs(B) * fastest**2 * self.skew / 2)
        mean = "(B_c + B_r)/2"
        # The two readings of the same loops differ by what neither model holds, friction at low speed for instance.
        apart = {"B": self.loss.slope - w.slope / 2, "F_c": pi / 4 * self.loss.start - w.start / 2}
        start, loss_half = pi / 4 * self.loss.start, _times(self.loss.half_start, pi / 4)
        ratio = np.array([member.sine.ratio for member in self.group])
        omega = np.array([member.sine.omega for member in self.group])
        late = self.skew * float(np.average(omega * np.abs(ratio.imag), weights=np.abs(ratio) ** -2.0))
        return [
            estimate("K", stiffness, HARMONIC, K, self.K[1], self.bias["K"], sqrt((both * K) ** 2 + late**2)),
            estimate(
                "B", damping, HARMONIC, B, self.loss.half_slope, self.bias["B"], sqrt((both * B) ** 2 + skewed**2), mean
            ),
            estimate("F_c", newton, HARMONIC, start, loss_half, self.bias["F_c"], force * abs(start)),
            estimate(
                "B", damping, WIDTH, w.slope / 2, _times(w.half_slope, 0.5), self.bias["B width"],
                sqrt((both * w.slope / 2) ** 2 + skewed**2), mean,
            ),
            estimate(
                "F_c", newton, WIDTH, w.start / 2, _times(w.half_start, 0.5), self.bias["F_c width"],
                force * abs(w.start) / 2,
            ),
            estimate(
                "H", newton, WIDTH, w.start, w.half_start, 2 * self.bias["F_c width"], force * abs(w.start),
                "loop width at 0 Hz: true hysteresis", {**at, "frequency": 0.0},
            ),
        ]  # fmt: skip

    def single(self, at: Mapping[str, float]) -> list[Estimate]:
        """K, phase, loop width H and loop area W at each frequency."""
        force, length = self.scales
        both = sqrt(force**2 + length**2)
        found = []
        for frequency, members in sorted(self.by_frequency.items()):
            sines = [member.sine for member in members]
            omega = 2 * pi * frequency
            first = sines[0]
            loss = abs(first.loss / first.amplitude)
            late = omega * self.skew
            rows: tuple[tuple[str, str, str, Callable[[Sine], float], Callable[[Sine], Array], float], ...] = (
                ("K", "N/m", "stiffness", lambda s: s.stiffness, lambda s: -s.cycles.ratio.real,
                 sqrt((both * first.stiffness) ** 2 + (late * loss) ** 2)),
                ("phi", "rad", "angle", lambda s: s.phase,
                 lambda s: np.arctan2(-s.cycles.ratio.imag, -s.cycles.ratio.real), late),
                ("H", "N", "force", lambda s: s.width, lambda s: s.cycles.width,
                 sqrt((force * first.width) ** 2 + (2 * late * first.stiffness * first.amplitude) ** 2)),
                ("W", "J", "work", lambda s: s.area, lambda s: s.cycles.area,
                 sqrt((both * first.area) ** 2 + (pi * late * first.stiffness * first.amplitude**2) ** 2)),
            )  # fmt: skip
            for symbol, unit, quantity, whole, by_cycle, calibration in rows:
                values = np.array([whole(sine) for sine in sines])
                found.append(
                    Estimate(
                        symbol=symbol,
                        value=float(values.mean()),
                        unit=unit,
                        quantity=quantity,
                        method=WIDTH if symbol in ("H", "W") else HARMONIC,
                        at={**at, "frequency": frequency},
                        parts=Parts(repeats=mean_half(values, [by_cycle(s) for s in sines]), calibration=calibration),
                        n=len(sines),
                        trials=tuple(member.name for member in members),
                    )
                )
        return found

    @property
    def by_frequency(self) -> dict[float, list[_Member]]:
        """Members by frequency [Hz]."""
        groups: dict[float, list[_Member]] = {}
        for member in self.group:
            groups.setdefault(member.sine.frequency, []).append(member)
        return groups

    def findings(self, at: Mapping[str, float]) -> list[Finding]:
        """What catches the eye."""
        where = show(at["pressure"], "pressure") if "pressure" in at else "this pressure"
        lines = []
        if self.K[0] <= 0:
            lines.append(
                Finding(
                    "fault", f"at {where} the force rises with contraction: a sign is wrong in displacement or force"
                )
            )
        for member in self.group:
            if member.sine.distortion > DISTORTED:
                lines.append(
                    Finding(
                        "doubt",
                        f"trial {member.name}: {member.sine.distortion:.0%} of the measured displacement is no sine",
                    )
                )
        stiffness = {f: float(np.mean([m.sine.stiffness for m in members])) for f, members in self.by_frequency.items()}
        spread = (max(stiffness.values()) - min(stiffness.values())) / abs(self.K[0])
        if spread > CHANGES:
            lines.append(
                Finding(
                    "note", f"at {where} K changes by {spread:.0%} over frequency: one K is a mean of unlike values"
                )
            )
        if self.skew > 0 and self.loss.slope > 0:
            share = self.skew * abs(self.K[0]) / self.loss.slope
            lines.append(
                Finding(
                    "doubt" if share > 0.05 else "note",
                    f"at {where} displacement and force may be {self.skew * 1e3:.3g} ms apart: B is uncertain by "
                    f"{share:.1%} for that alone",
                )
            )
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


def _muscle(K: float, loss: Line) -> tuple[float, float, float]:
    alone = np.isnan(loss.slope)
    return K, 0.0 if alone else loss.slope, 0.0 if alone else pi / 4 * loss.start


def _times(half: float | None, factor: float) -> float | None:
    return None if half is None else half * factor


def _lines(sines: Sequence[Sine]) -> tuple[tuple[float, float | None], Line, Line]:
    """K with its half width, and the lines of loss and width over speed."""
    frequency = np.array([sine.frequency for sine in sines])
    speed = np.array([sine.speed for sine in sines])
    K = np.array([sine.stiffness for sine in sines])
    size = np.array([abs(sine.ratio) for sine in sines])
    # Phase errors turn loss into stiffness: a K counts by the whole force beside it.
    pooled = weighted_line(frequency, None, K, size)
    loss = weighted_line(frequency, speed, np.array([sine.loss for sine in sines]))
    width = weighted_line(frequency, speed, np.array([sine.width for sine in sines]))
    return (pooled.start, pooled.half_start), loss, width
