"""Whether the force along driven sines has the straight form: harmonics of the force and doubts that follow from them.

With x = x_m + A sin(theta), h1 the coefficient of sin(theta) in F, h2 minus that of cos(2 theta), h3 minus that of
sin(3 theta) and q3 that of cos(3 theta), a curve F_m - K u + c u^2 + d u^3 about x_m gives h2 = c A^2/2 and h3 = d
A^3/4; a friction F_c gives q3 = 4 F_c/(3 pi) and no h3; damping that differs between directions gives an h2 that
increases with the speed, which the extrapolation to speed 0 removes. A friction that changes with the speed in one
direction only also gives an h2 and shifts the mean force; mean force minus h2 then is not half way between the branches
at mid stroke. Uses measured trials of one pressure, mean and amplitude; computes no coefficient.

The loss due to creep of the muscle is bounded by the stiffness over frequency. A contraction that creeps after x in
parts c/(1 + i omega tau), equally many in each decade of tau, reduces K at low frequency and adds loss: F/x = -K (1 - c
sum 1/(1 + i omega tau)). If tau extends below all periods, the loss is the same at each frequency, pi/(2 ln 10) of K
for each part of c in a decade, and looks like friction; if tau ends within them, the loss falls with frequency and B
comes out too small. So the change of K over the frequencies, with its interval, bounds the loss.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, inf, pi

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import sentences
from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.lines import weighted_line
from pmabench.analysis.shared.samples import least_squares
from pmabench.analysis.shared.sine_loop import Sine, Swing, at_middle
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Estimate, Finding, withhold
from pmabench.store.records import Array

CLEAR = 2.0
"""A harmonic is significant above this many half widths of its 95 % interval."""
MOST_BENT = 0.1
"""h2/h1 up to which the higher harmonics correct K and F: beyond it the corrected values are worse than the others."""
STRAIGHT = 0.02
"""Largest h2/h1 for which one sine with x = 0 in its stroke gives F_ce."""
EDGE = 1.02
"""Distance of x = 0 from the mean, in amplitudes, up to which it counts as inside the stroke: a drive may stop a little
short.
"""
LEAST = 0.01
"""Share of K that may be due to a third harmonic of friction, where friction is not constant."""
REMAINS = 0.3
"""Share of a correction that is added to the interval."""
WOUND = 0.4
"""Greatest third harmonic in phase, as a share of F_c, of a friction that builds up over a part of the stroke."""
QUICKLY, SLOWLY = 2.0, 5.0
"""Contribution to the first harmonic in phase, over F_c, of a friction that builds up over less than the amplitude
after each turn (third harmonic in phase < 0), or over more (> 0).
"""
COULOMB = 0.2
"""Largest relative deviation of the third harmonic in quadrature from that of a constant friction."""
DIRECTIONS = 2 / (3 * pi)
"""h2 over B omega A if one direction has no damping and the other 2 B, the largest that damping can cause."""
TURNS = 2.0
"""Ratio of h2 to the shift of mean force minus h2, for a friction that differs near the turns in one direction."""
BUILDS_UP = "friction that builds up on the way"
BETTER = "an isobaric ramp (isobaric-ramp) measures the curve itself"
AT_0 = "static load gives F_ce"


@dataclass(frozen=True)
class Form:
    """Harmonics of the force of a cell at speed 0 [N], each with the half width of its 95 % interval."""

    h1: float
    h2: float
    h3: float
    q3: float
    half: tuple[float, float, float]
    """Half widths of h2, h3, q3; inf without degrees of freedom."""
    mean: float
    """Mean contraction of the sines [m]."""
    reach: float
    """Mean contraction over amplitude [1]; above 1, x = 0 lies outside the stroke."""
    apart: float
    """Mean force minus h2 minus the middle of both branches at mid stroke [N]: shift by friction in one direction."""

    @classmethod
    def of(cls, sines: Sequence[Sine], damping: float) -> Form:
        """From each cycle of all trials; with one frequency, `damping` [N.s/m] bounds its effect on h2."""
        rows = [row for sine in sines for row in _harmonics(sine)]
        frequency, speed, h1, *higher = (np.array(column) for column in zip(*rows, strict=True))
        alone = len(np.unique(frequency)) < 2
        *lines, apart = [weighted_line(frequency, None if alone else speed, y, np.abs(h1)) for y in higher]
        half = [inf if line.half_start is None else line.half_start for line in lines]
        if alone:
            half[0] = hypot(half[0], DIRECTIONS * abs(damping) * float(speed.mean()))
        mean = float(np.mean([sine.mean for sine in sines]))
        reach = mean / float(np.mean([sine.amplitude for sine in sines]))
        h2, h3, q3 = (line.start for line in lines)
        return cls(float(np.mean(h1)), h2, h3, q3, (half[0], half[1], half[2]), mean, reach, apart.start)

    @property
    def holds_0(self) -> bool:
        """Whether x = 0 lies inside the stroke."""
        return abs(self.reach) <= EDGE

    @property
    def bent(self) -> bool:
        """Whether the force over contraction is significantly curved."""
        return abs(self.h2) > CLEAR * self.half[0] or abs(self.h3) > CLEAR * self.half[1]

    @property
    def shares(self) -> str:
        """h2 and h3 over h1, in words."""
        return f"second harmonic {self.h2 / self.h1:.1%}, third {self.h3 / self.h1:.1%} of the first"

    def _carried(self, h2: float, h3: float) -> float:
        r = self.reach
        return -h2 + 3 * h3 * r + 2 * h2 * r**2 - 4 * h3 * r**3

    @property
    def carried(self) -> tuple[float, float]:
        """Difference at x = 0 between a cubic through the stroke and the straight line [N], and its half width."""
        if not np.isfinite(self.half[:2]).all():
            return self._carried(self.h2, self.h3), inf
        friction = hypot(self.apart, 2 * TURNS * self.apart * self.reach**2)
        half = hypot(self._carried(self.half[0], 0), self._carried(0, self.half[1]), friction)
        return self._carried(self.h2, self.h3), half

    def findings(self, at: Mapping[str, float]) -> list[Finding]:
        """A note if the curve is bent, with the harmonics."""
        if not self.bent:
            return []
        text = f"at {pressure_of(at)} the force over contraction is bent along the sines: {self.shares}"
        return [Finding("note", f"{text}; a value of K is that at their mean contraction")]

    def _least(self, share: float) -> float:
        """Smallest second harmonic [N] above both a share of the first and its own interval."""
        return max(share * abs(self.h1), CLEAR * self.half[0])

    def why_no_f_ce(self) -> tuple[str, bool]:
        """Reason why this cell alone gives no F_ce, else empty; and whether its data contradict the form."""
        if not self.holds_0:
            far = f"x = 0 lies {abs(self.reach):.2g} amplitudes from the mean of these sines, beyond what they measured"
            bent = f"; along them the force over contraction is bent ({self.shares})" if self.bent else ""
            return f"{far}{bent}; {AT_0}; {BETTER}", self.bent
        if abs(self.h2) > self._least(STRAIGHT):
            bent = f"the force over contraction is bent along these sines ({self.shares}; {STRAIGHT:.0%} is accepted)"
            return f"{bent}; {AT_0}; {BETTER}", True
        return "", False

    def why_no_tangent(self) -> str:
        """Reason why the harmonics give no force and stiffness at the mean; else empty."""
        if abs(self.h2) <= self._least(MOST_BENT):
            return ""
        most = f"the harmonics correct K and F up to a second one of {MOST_BENT:.0%}"
        return (
            f"the force over contraction is bent along the stroke ({self.shares}; {most}): K_A is the stiffness over "
            f"this amplitude; take a smaller one, or {BETTER}"
        )

    def stiffness(self, F_c: float | None) -> tuple[float, float]:
        """K at the mean relative to that of the first harmonic [1], and its half width due to the form.

        A cubic has h1 = K A - 3 h3. A friction F_c [N] that builds up over a part of the stroke also has a third
        harmonic in phase, at most `WOUND` F_c, and increases the first by one to two times that: K lies between the
        results with and without it.
        """
        wound = self._wound(F_c or 0.0)
        share = (3 * self.h3 + wound) / self.h1
        return 1 + share, min(1.0, hypot(wound / self.h1, REMAINS * share, 3 * self.half[1] / self.h1))

    def _wound(self, F_c: float) -> float:
        """Possible third harmonic in phase [N] of a friction `F_c` [N] that builds up gradually."""
        return min(WOUND * abs(F_c), max(0.0, -self.h3) + self.half[1])

    def friction_at_0(self, F_c: float) -> Doubt:
        """Effect on F_ce, extrapolated to x = 0 by K and the harmonics, of a friction `F_c` [N] that builds up
        gradually.

        Unlike a constant friction it adds to K; where it is significant, all of it may act like a spring.
        """
        reason, r = self.doubt_of_friction(F_c), abs(self.reach)
        wound = self._wound(F_c) if self.h3 < -self.half[1] else 0.0
        spring = (SLOWLY if self.h3 > 0 else QUICKLY) * abs(F_c) if reason else QUICKLY * wound
        half = spring * r + abs(self._carried(0.0, wound))
        reason += "; it adds to K, which carries the force to x = 0" if reason else ""
        return Doubt(BUILDS_UP, "method", half, bool(reason), reason)

    def why_no_stiffness(self, F_c: float | None) -> str:
        """The reason to withhold K; empty where the harmonics correct it."""
        if reason := self.why_no_tangent():
            return reason
        if F_c is None or not self._shaped or not (friction := self.doubt_of_friction(F_c)):
            return ""
        return (
            f"the third harmonic of the force in phase with the displacement ({self.h3 / self.h1:.1%} of the first) "
            f"may be of a bent curve or of friction, and a part of K, too: {friction}"
        )

    @property
    def _shaped(self) -> bool:
        """Whether a third harmonic in phase is significant: bent curve, or friction that builds up gradually."""
        return abs(self.h3) > max(CLEAR * self.half[1], LEAST * abs(self.h1) / 3)

    def doubt_of_friction(self, F_c: float) -> str:
        """The reason to withhold F_c [N]: its third harmonic is not that of a constant friction."""
        expected = 4 * F_c / (3 * pi)
        room = COULOMB * abs(expected) + CLEAR * self.half[2] + (0.0 if self._shaped else LEAST * abs(self.h1))
        if abs(self.q3 - expected) <= room:
            return ""
        return (
            f"a constant friction of {show(F_c, 'force', 3)} makes a third harmonic of {show(expected, 'force', 2)} in "
            f"quadrature, found is {show(self.q3, 'force', 2)}: the friction is not constant along the stroke; the gap "
            f"of an isobaric ramp measures it"
        )


def pressure_of(at: Mapping[str, float]) -> str:
    """The pressure of a cell in words."""
    return show(at["pressure"], "pressure") if "pressure" in at else "this pressure"


def judged(found: Sequence[Estimate], form: Form) -> list[Estimate]:
    """Estimates with K corrected by the harmonics to the tangent at the mean; F_c and the loop width at 0 Hz unchanged.

    They are withheld where the form contradicts them; `K_A`, from the first harmonic over this amplitude, is then given
    as well.
    """
    F_c = next((e.value for e in found if e.symbol == "F_c" and e.value is not None), None)
    factor, half = form.stiffness(F_c)
    reasons = {"K": form.why_no_stiffness(F_c), "F_c": "" if F_c is None else form.doubt_of_friction(F_c)}
    kept: list[Estimate] = []
    for e in found:
        reason = reasons.get("F_c" if e.symbol == "H" and e.at.get("frequency") == 0.0 else e.symbol, "")
        if e.value is None:
            kept.append(e)
        elif reason:
            over = sentences(f"over this amplitude: {form.shares}; not the slope of the curve at the mean", e.note)
            kept += [withhold(e, reason), *([replace(e, symbol="K_A", note=over)] if e.symbol == "K" else [])]
        elif e.symbol == "K":
            parts = replace(e.parts, method=hypot(e.parts.method or 0.0, half * e.value))
            bias = None if e.bias is None else e.bias + (1 - factor) * e.value
            note = sentences(f"at the mean; {form.shares}" if form.bent else "", e.note)
            kept.append(replace(e, value=factor * e.value, bias=bias, corrected=True, parts=parts, note=note))
        else:
            kept.append(e)
    return kept


def rows_of_cycles(sine: Sine) -> list[NDArray[np.bool_]]:
    """For each cycle, which samples belong to it."""
    number = np.floor((sine.t - sine.t[0]) * sine.frequency + 1e-6)
    return [number == one for one in np.unique(number)]


def _harmonics(sine: Sine) -> list[tuple[float, ...]]:
    """Frequency [Hz], speed [m/s], |h1|, h2, h3, q3 [N] of each cycle, and its value for `Form.apart` [N].

    Harmonics of the displacement are corrected by subtracting K times them.
    """
    orders = np.array([1, 2, 3])
    angles = np.outer(sine.omega * sine.t, orders)
    design = np.column_stack([np.ones(len(sine.t)), np.cos(angles), np.sin(angles)])
    both = np.column_stack([sine.x, sine.F])
    rows: list[tuple[float, ...]] = []
    for one in rows_of_cycles(sine)[: len(sine.cycles)]:
        if np.count_nonzero(one) <= design.shape[1]:
            continue
        fitted = least_squares(design[one], both[one])
        waves = fitted[1:4] - 1j * fitted[4:7]  # shape (3, 2): Re(wave exp(j k omega t))
        turn = -1j * np.conj(waves[0, 0]) / abs(waves[0, 0])  # rotates omega t to theta
        X, F = (waves * turn ** orders[:, None]).T
        K = -(F[0] / X[0]).real
        left = F + K * X
        size = abs(K * X[0])
        h2, (x, mean) = -left[1].real, fitted[0]
        middle = at_middle(sine.t[one], sine.x[one], sine.F[one], x, waves[0, 0], sine.omega)
        apart = mean - h2 - 0.5 * sum(middle)
        rows.append((sine.frequency, sine.omega * abs(X[0]), size, h2, left[2].imag, left[2].real, apart))
    return rows


SHORTEST = tuple(10 ** np.arange(-2.0, 0.1, 0.25))
"""Shortest time constants of creep that are tried [s]: creep shows within a second of a step."""
WORSE = 3.0
"""Those with an uncertainty of the stiffness change above this factor of the smallest are left out."""
LONGEST = 1e3
"""Longest time constant [s]; slower creep does not show in sines."""
PER_DECADE = 2
"""Parts of creep in a decade of time constants."""
MOST = 0.02
"""Largest part of creep, as a share of the contraction: 4 % per decade."""


def lost(sines: Sequence[Sine], cycles: Sequence[Swing]) -> list[tuple[Array, Array]]:
    """For each shortest time constant: possible contribution of creep to the loss and to K of each sine.

    Loss divided by the amplitude, and stiffness [N/m], shape (n,) each. `cycles` are those of all sines: without
    repeats their scatter gives the uncertainty of the change of K. Empty with one frequency, which does not show it.
    """
    frequency, K, size = _columns(sines)
    if len(np.unique(frequency)) < 2:
        return []
    every, K_each, size_each = _columns(cycles)
    found, unsure = [], []
    for shortest in SHORTEST:
        tau = shortest * 10 ** (np.arange(0.0, PER_DECADE * np.log10(LONGEST / shortest) + 1.0) / PER_DECADE)
        parts = _parts(frequency, tau)
        line = weighted_line(frequency, parts.real, K, size)
        each = weighted_line(every, _parts(every, tau).real, K_each, size_each)
        halves = [half for half in (line.half_slope, each.half_slope) if half is not None]
        if not halves or not line.start > 0:
            continue
        share = min(MOST, (max(0.0, -line.slope) + max(halves)) / line.start)
        found.append((-share * line.start * parts.imag, share * line.start * parts.real))
        unsure.append(max(halves) * float(np.ptp(parts.real)))
    return [one for one, half in zip(found, unsure, strict=True) if half <= WORSE * min(unsure)]


def _columns(points: Sequence[Swing]) -> tuple[Array, Array, Array]:
    """Frequency [Hz], stiffness and the size of the whole ratio [N/m]."""
    rows = [(point.frequency, point.stiffness, abs(point.ratio)) for point in points]
    frequency, K, size = np.array(rows, dtype=np.float64).T
    return frequency, K, size


def _parts(frequency: Array, tau: Array) -> NDArray[np.complex128]:
    return np.asarray((1 / (1 + 2j * np.pi * frequency[:, None] * tau)).sum(axis=1))
