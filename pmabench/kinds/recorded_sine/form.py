"""Departures of a recorded sine from a steady one and their effects; also the bandwidth (-3 dB) of contraction.

The bandwidth is where the gain has fallen to 1/sqrt(2) of that at the lowest frequency, over the commanded pressure if
it is recorded, else the measured one. Between two frequencies 1/|G|^2 is a line over f^2, as for one lag; the
difference to a line in logarithms is the method part. Works on sines; knows no campaign.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import exp, hypot, log, pi, sqrt
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
"""Smallest share of samples at one extreme value for which a channel counts as cut off."""
RARER = 5.0
"""Least ratio of samples at a cut extreme to those at the next value; in an uncut sine of few counts it is 2."""
SURE = 5.0
"""Deviations by noise from which on a third harmonic is significant."""
MORE = 1.2
"""Factor for an assumed form that need not be exact: hysteresis blurred by noise, a plant of higher order."""


def changing(by_cycle: Sequence[Array], what: str) -> list[Doubt]:
    """A doubt if a value changes from cycle to cycle, since its mean is then not a steady state; else empty."""
    change = change_over(by_cycle)
    if change is None or not change.seen:
        return []
    share = change.size / max(abs(float(np.mean([one.mean() for one in by_cycle]))), 1e-30)
    reason = f"{what} changes by {share:.1%} from the first cycle to the last: it is not steady yet. Record more cycles"
    return [Doubt("change from cycle to cycle", "drift", change.most, seen=True, reason=f"{reason}, later")]


def cut_off(sines: Sequence[Sine], names: Sequence[str]) -> list[Doubt]:
    """Channels whose extremes are cut off, which withholds what needs them."""
    found = []
    for name in names:
        flat = max((_flat(sine.raw[name]) for sine in sines if name in sine.amplitudes), default=0.0)
        if flat:
            reason = (
                f"{name} is cut off: {flat:.0%} of its samples read one extreme value. Swing less, or use a sensor or "
                "converter with more range"
            )
            found.append(Doubt(f"cut off {name}", "method", 1.0, seen=True, reason=reason))
    return found


def _flat(values: Array) -> float:
    """Share of samples at an extreme value where it is cut off; 0 where it is not."""
    flat = 0.0
    for turned in (values, -values):
        levels, counts = np.unique(turned, return_counts=True)
        if len(levels) > 1 and counts[-1] > max(FLAT * len(values), RARER * counts[-2]):
            flat += float(counts[-1]) / len(values)
    return flat


def slower(sine: Sine, name: str) -> complex:
    """Relative change of a complex amplitude if the sensor's time constant is larger by its uncertainty [1]: that of
    ln(1 + j omega tau). If none is declared, the effect of `UNDECLARED` on amplitude and phase: time stamps say nothing
    of a filter.
    """
    turn = 1j * sine.omega * sine.lags[name]
    if not turn and name != "pressure_command":
        whole = 1 + 1j * sine.omega * UNDECLARED
        return complex(abs(whole) - 1, np.angle(whole))
    return LAG_KNOWN * turn / (1 + turn)


def stepped(sine: Sine, name: str) -> complex:
    """Half widths of the relative change of a complex amplitude, real and imaginary, because its channel is read in
    steps.
    """
    if not sine.amplitudes[name]:
        return 0j
    wave = np.real(sine.amplitudes[name] * np.exp(1j * sine.omega * sine.t))
    first, *others = three_parameter(sine.t, rounded(wave, step_of(sine.raw[name])).T, sine.omega / (2 * np.pi))[1]
    changes = np.array(others) / first - 1
    return 2 * complex(np.sqrt(np.mean(changes.real**2)), np.sqrt(np.mean(changes.imag**2)))


def sensors(sine: Sine, names: Sequence[str], *, phase: bool = False) -> list[Doubt]:
    """Effects of time constants and steps of sensors on a ratio of amplitudes [1], or on its `phase` [rad]."""
    found = []
    for what, change in (("time constants of the sensors", slower), (STEPS, stepped)):
        changes = [change(sine, name) for name in names]
        half = float(np.hypot.reduce([one.imag if phase else one.real for one in changes] or [0.0]))
        found += [Doubt(what, "method", half, seen=False)] if half else []
    return found


def _third(sines: Sequence[Sine]) -> tuple[complex, complex, float]:
    """Third harmonics of contraction and pressure, each over its first and from the phase of the pressure, and their
    deviation by noise [1].
    """
    found, noises = [], []
    for sine in sines:
        first = np.array([sine.amplitudes[name] for name in ("displacement", "pressure")])
        sizes, both = np.abs(first), np.column_stack([sine.x, sine.P])
        third = three_parameter(sine.t, both, 3 * sine.omega / (2 * pi))[1]
        found.append(third / sizes * (sizes[1] / first[1]) ** 3)
        noises.append(hypot(*([noise_of(one) for one in both.T] / sizes)) * sqrt(2 / len(sine.t)))
    x, P = np.mean(found, axis=0).tolist()
    return x, P, float(np.mean(noises)) / sqrt(len(noises))


def other_shape(sines: Sequence[Sine]) -> list[Doubt]:
    """Effect of third harmonics on the width of the loop, which is read where the pressure is at its mean [m]."""
    x, P, noise = _third(sines)
    X, driven = (sines[0].amplitudes[name] for name in ("displacement", "pressure"))
    share = abs(x.imag - P.imag * np.cos(np.angle(X / driven)))
    half = 2 * abs(X) * (share + 2 * noise)
    reason = (
        f"the loop is no ellipse: by its third harmonics its width at mean pressure may be {show(half, 'length', 2)} "
        "off: friction, or a bent curve. Read it off the figure of the loop"
    )
    return [Doubt("shape of the loop", "method", half, share > SURE * noise, reason)]


MOST_PLAY = 0.06
"""Largest third harmonic over the first that a play of a sensor makes: it would be an eighth of the amplitude."""
PLAY, TURNS = 5.8, 3.0
"""A play turns a sine by three times its third harmonic r, and shortens it by 5.8 r^1.5, within 6 % up to a fifth of
the amplitude (the first and third harmonic of a sine after a play).
"""


def play(sines: Sequence[Sine], *, phase: bool = False) -> list[Doubt]:
    """Effect on amplitude [1] or `phase` [rad] of a play in the sensor of the contraction, where the loop may have one.

    Friction of the muscle makes the same loop, and then the amplitude is right: nothing is withheld. The third harmonic
    of a bent curve is in phase with the motion, that of a play is not. One above `MOST_PLAY` is friction.
    """
    x, P, noise = _third(sines)
    X, driven = (sines[0].amplitudes[name] for name in ("displacement", "pressure"))
    third = abs(x)
    if third > MOST_PLAY or abs((x * np.exp(-3j * np.angle(X / driven))).imag) <= SURE * noise + abs(P):
        return []
    half = MORE * (TURNS * third if phase else PLAY * third**1.5)
    return [Doubt("play of the sensor, if it is no friction", "method", half, seen=False)]


def hysteresis(sines: Sequence[Sine], offsets: Mapping[str, float], names: Sequence[str]) -> list[Doubt]:
    """Largest error of a phase by hysteresis of the sensors, within the uncertainties of their offsets [rad].

    Hysteresis of +- u on a sine of amplitude A turns its first harmonic by 4 u / (pi A), and makes a third harmonic
    that is a third of it.
    """
    first, (x, P, noise) = sines[0], _third(sines)
    sizes = [offsets.get(name, 0.0) / abs(first.amplitudes[name]) for name in names if first.amplitudes[name]]
    half = min(4 / pi * hypot(*sizes), 3 * MORE * (hypot(abs(x), abs(P)) + 2 * noise))
    return [Doubt("hysteresis of the sensors", "method", half, seen=False)] if half else []


COMMAND, PRESSURE = "bandwidth, by sines of command", "bandwidth, by sines of pressure"
FEWEST = 3
"""Fewest frequencies for a bandwidth."""
LEAST = 1e-9
"""Smallest gain at the end of its interval, as a share of its value."""


def crossing(f: Array, gain: Array) -> tuple[float, float] | None:
    """Lowest frequency at which `gain` (n,) over ascending f (n,) [Hz] is 1/sqrt(2) of its first value; its method part
    [Hz].

    None where the gain stays above that. The method part is the difference to a line in logarithms, or to a parabola of
    1/|G|^2 over f^2 through one more frequency before or after, as for two lags or a resonance.
    """
    share = gain / gain[0]
    below = np.flatnonzero(share < sqrt(0.5))
    if not len(below):
        return None
    i = int(below[0])
    (f_1, f_2), (g_1, g_2) = f[i - 1 : i + 1], 1 / share[i - 1 : i + 1] ** 2
    square = f_1**2 + (2.0 - g_1) / (g_2 - g_1) * (f_2**2 - f_1**2)
    straight = exp(log(f_1) + (log(2.0) - log(g_1)) / (log(g_2) - log(g_1)) * log(f_2 / f_1))
    others = [abs(straight - sqrt(square))]
    for rows in (slice(i - 2, i + 1), slice(i - 1, i + 2)):
        if 0 <= rows.start and rows.stop <= len(f):
            terms = np.polyfit(f[rows] ** 2 - f_1**2, 1 / share[rows] ** 2 - 2.0, 2)
            roots = np.roots(terms).real + f_1**2
            inside = roots[(roots > f_1**2) & (roots < f_2**2)]
            others += [MORE * abs(sqrt(float(root)) - sqrt(square)) for root in inside]
    return sqrt(square), max(others)


def bandwidth(groups: Mapping[float, Sequence[Sine]]) -> list[Estimate]:
    """f_b [Hz] from trials by frequency [Hz]; without value where the gain does not fall enough; empty for few
    frequencies.
    """
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
    """Changes of f_b [Hz] by the uncertainty of each sensor's time constant; `sines` has one for each frequency."""
    found = []
    for name, sign in (("displacement", 1), (driven, -1)):
        change = np.array([sign * slower(sine, name).real for sine in sines])
        moved = crossing(at, gain * (1 + change)) if change.any() else None
        found.append(0.0 if moved is None else abs(moved[0] - value))
    return found
