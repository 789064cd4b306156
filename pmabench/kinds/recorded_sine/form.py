"""What a recorded sine lacks of a steady one, and what that does to its numbers; knows sines, no campaign.

And the bandwidth (-3 dB) of contraction over recorded sines: where its gain has fallen to 1/sqrt(2) of that at the
slowest.

The gain is that of the commanded pressure where it is recorded, else of the measured one. Between two frequencies
1/|G|^2 is a line over f^2, as it is for one lag; what a line in logarithms would give instead is the method part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import exp, hypot, log, sqrt
from typing import TYPE_CHECKING

import numpy as np

from pmabench.analysis.shared.calibration import sentences
from pmabench.analysis.shared.form import Doubt, change_over
from pmabench.analysis.shared.lines import mean_half
from pmabench.analysis.shared.samples import (
    LAG_KNOWN,
    STEPS,
    UNDECLARED,
    noise_of,
    rounded,
    step_of,
    three_parameter,
)
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Estimate, Parts
from pmabench.store.records import Array

if TYPE_CHECKING:
    from pmabench.kinds.recorded_sine.reduction import Sine

FLAT = 0.02
"""Share of the samples that must read one extreme value before it counts as cut off."""
RARER = 5.0
"""So much rarer is the next value to an extreme that is cut off; in a sine in few counts it is half as rare."""
BEYOND = 2.0
"""A cut that is found counts by so much more, for the samples near it are cut by noise, too."""
HARMONICS = 7


def changing(by_cycle: Sequence[Array], what: str) -> list[Doubt]:
    """Whether a value changes from cycle to cycle: a mean over all is no steady state."""
    change = change_over(by_cycle)
    if change is None or not change.seen:
        return []
    share = change.size / max(abs(float(np.mean([one.mean() for one in by_cycle]))), 1e-30)
    reason = f"{what} changes by {share:.1%} from the first cycle to the last: it is not steady yet. Record more cycles"
    return [Doubt("change from cycle to cycle", "drift", change.most, seen=True, reason=f"{reason}, later")]


def cut_off(sines: Sequence[Sine], names: Sequence[str]) -> list[Doubt]:
    """Channels whose extremes are cut off; the effect is the share of the amplitude that this takes."""
    found = []
    for name in names:
        each = [_missing(sine, name) for sine in sines if name in sine.amplitudes]
        share, flat = max(each, default=(0.0, 0.0))
        if flat:
            reason = (
                f"{name} is cut off: {flat:.0%} of its samples read one extreme value, which takes about {share:.1%} "
                "of its amplitude. Swing less, or use a sensor or converter with more range"
            )
            found.append(Doubt(f"cut off {name}", "method", BEYOND * share, seen=True, reason=reason))
    return found


def _missing(sine: Sine, name: str) -> tuple[float, float]:
    """Share of the amplitude that a cut takes, and of the samples that are cut; 0 without one."""
    values, frequency = sine.raw[name], sine.omega / (2 * np.pi)
    kept, flat = np.ones(len(values), dtype=bool), 0.0
    for turned in (values, -values):
        levels, counts = np.unique(turned, return_counts=True)
        if len(levels) > 1 and counts[-1] > max(FLAT * len(values), RARER * counts[-2]):
            kept &= turned < levels[-1]
            flat += float(counts[-1]) / len(values)
    if not flat:
        return 0.0, 0.0
    parts = ((sine.t[rows], values[rows, None]) for rows in (kept, slice(None)))
    uncut, whole = (abs(three_parameter(t, y, frequency)[1][0]) for t, y in parts)
    return float(abs(uncut / whole - 1)), flat


def slower(sine: Sine, name: str) -> complex:
    """Relative change of a complex amplitude where the sensor's time constant is larger by what it is known to [1]:
    that of ln(1 + j omega tau). Where none is declared, what `UNDECLARED` takes off the amplitude, and its phase: how
    late the stamps are says nothing of a filter.
    """
    turn = 1j * sine.omega * sine.lags[name]
    if not turn and name != "pressure_command":
        whole = 1 + 1j * sine.omega * UNDECLARED
        return complex(abs(whole) - 1, np.angle(whole))
    return LAG_KNOWN * turn / (1 + turn)


def stepped(sine: Sine, name: str) -> complex:
    """Half widths of the relative change of a complex amplitude, real and imaginary, by the steps of its channel."""
    if not sine.amplitudes[name]:
        return 0j
    wave = np.real(sine.amplitudes[name] * np.exp(1j * sine.omega * sine.t))
    first, *others = three_parameter(sine.t, rounded(wave, step_of(sine.raw[name])).T, sine.omega / (2 * np.pi))[1]
    changes = np.array(others) / first - 1
    return 2 * complex(np.sqrt(np.mean(changes.real**2)), np.sqrt(np.mean(changes.imag**2)))


def sensors(sine: Sine, names: Sequence[str], *, phase: bool = False) -> list[Doubt]:
    """What time constants and steps of sensors leave open of a ratio of amplitudes [1], or of its `phase` [rad]."""
    found = []
    for what, change in (("time constants of the sensors", slower), (STEPS, stepped)):
        changes = [change(sine, name) for name in names]
        half = float(np.hypot.reduce([one.imag if phase else one.real for one in changes] or [0.0]))
        found += [Doubt(what, "method", half, seen=False)] if half else []
    return found


def other_shape(sines: Sequence[Sine]) -> list[Doubt]:
    """How far the width of the loop at mean pressure differs from that of the ellipse of the first harmonics."""
    apart, errors = [], []
    for sine in sines:
        angle = sine.omega * sine.t[:, None] * np.arange(1, HARMONICS + 1)
        design = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
        fitted = np.linalg.lstsq(design, np.column_stack([sine.P, sine.x]), rcond=None)[0]
        fine = 2 * np.pi * np.arange(2001)[:, None] / 2000 * np.arange(1, HARMONICS + 1)
        P, x = (np.column_stack([np.ones(len(fine)), np.cos(fine), np.sin(fine)]) @ fitted).T
        off = P - fitted[0, 0]
        rows = np.flatnonzero(off[:-1] * off[1:] < 0)
        if len(rows) != 2:
            continue
        one, other = x[rows] + off[rows] / (off[rows] - off[rows + 1]) * (x[rows + 1] - x[rows])
        X, ratio = sine.amplitudes["displacement"], sine.amplitudes["displacement"] / sine.amplitudes["pressure"]
        apart.append(abs(float(one - other)) - 2 * abs(X) * abs(np.sin(np.angle(ratio))))
        slope = abs(X) / abs(sine.amplitudes["pressure"])
        noise = np.hypot(noise_of(sine.x), slope * noise_of(sine.P))
        errors.append(noise * np.sqrt(4 * HARMONICS / len(sine.t)))
    if not apart:
        return []
    half, error = abs(float(np.mean(apart))), float(np.mean(errors)) / np.sqrt(len(errors))
    text = f"the loop is no ellipse: at mean pressure its width differs by {show(half, 'length', 2)} from that of one"
    reason = f"{text}: friction, or a bent curve. Read it off the figure of the loop"
    return [Doubt("shape of the loop", "method", half + 2 * error, half > 5 * error, reason)]


COMMAND, PRESSURE = "bandwidth, by sines of command", "bandwidth, by sines of pressure"
FEWEST = 3
"""Frequencies that it needs."""
LEAST = 1e-9
"""Share of its value that a gain keeps within its interval."""


def crossing(f: Array, gain: Array) -> tuple[float, float] | None:
    """Where `gain` (n,) over rising f (n,) [Hz] first is 1/sqrt(2) of its first value, and the method part [Hz].

    None where it is above that everywhere.
    """
    share = gain / gain[0]
    below = np.flatnonzero(share < sqrt(0.5))
    if not len(below):
        return None
    i = int(below[0])
    (f_1, f_2), (g_1, g_2) = f[i - 1 : i + 1], 1 / share[i - 1 : i + 1] ** 2
    square = f_1**2 + (2.0 - g_1) / (g_2 - g_1) * (f_2**2 - f_1**2)
    straight = exp(log(f_1) + (log(2.0) - log(g_1)) / (log(g_2) - log(g_1)) * log(f_2 / f_1))
    return sqrt(square), abs(sqrt(square) - straight)


def bandwidth(groups: Mapping[float, Sequence[Sine]]) -> list[Estimate]:
    """f_b [Hz] from trials by frequency [Hz], without a value where the gain does not fall so far; none of few."""
    frequencies = sorted(groups)
    if len(frequencies) < FEWEST:
        return []
    sines = [sine for f in frequencies for sine in groups[f]]
    driven = "pressure_command" if all("pressure_command" in sine.amplitudes for sine in sines) else "pressure"
    gains, halves = [], list[float | None]()
    for f in frequencies:
        values = np.array([abs(s.amplitudes["displacement"] / s.amplitudes[driven]) for s in groups[f]])
        gains.append(float(values.mean()))
        by_cycle = [np.abs(s.cycles["displacement"] / s.cycles[driven]) for s in groups[f]]
        half, change = mean_half(values, by_cycle), change_over(by_cycle)
        halves.append(half if half is None or change is None or not change.seen else half + change.most)
    at, gain = np.array(frequencies), np.array(gains)
    names = tuple(sine.name for sine in sines)
    method = COMMAND if driven == "pressure_command" else PRESSURE
    found = crossing(at, gain) if np.isfinite(gain).all() and gain.min() > 0 else None
    if found is None:
        least = 20 * log(gain.min() / gain[0]) / log(10) if gain.min() > 0 else 0.0
        note = f"the gain falls by no more than {-least:.2g} dB, up to {frequencies[-1]:g} Hz"
        return [Estimate("f_b", None, "Hz", "frequency", method, {}, n=len(names), note=note, trials=names)]
    value, apart = found
    half = None
    steps = [hypot(*(stepped(groups[f][0], name).real for name in ("displacement", driven))) for f in frequencies]
    shares = [hypot(one / g, step) for one, g, step in zip(halves, gain, steps, strict=True) if one is not None]
    if len(shares) == len(halves):
        off = np.array([hypot(share, shares[0]) for share in shares])
        ends = [gain * np.maximum(LEAST, 1 + way * off) for way in (-1, 1)]
        moved = [crossing(at, np.concatenate([gain[:1], end[1:]])) for end in ends]
        half = max(abs(one[0] - value) for one in moved if one is not None) if any(moved) else None
    apart = hypot(apart, *_slow([groups[f][0] for f in frequencies], driven, at, gain, value))
    few = "" if half is not None else "no repeats part: single cycles"
    note, parts = sentences(f"against the gain at {frequencies[0]:g} Hz", few), Parts(half, apart, 0.0)
    return [Estimate("f_b", value, "Hz", "frequency", method, {}, parts, len(names), note=note, trials=names)]


def _slow(sines: Sequence[Sine], driven: str, at: Array, gain: Array, value: float) -> list[float]:
    """Change of f_b [Hz] by what the time constant of each sensor is known to; `sines` is one for each frequency."""
    found = []
    for name, sign in (("displacement", 1), (driven, -1)):
        change = np.array([sign * slower(sine, name).real for sine in sines])
        moved = crossing(at, gain * (1 + change)) if change.any() else None
        found.append(0.0 if moved is None else abs(moved[0] - value))
    return found
