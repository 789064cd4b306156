"""K and B from the ringing of a known mass after steps, or the reason why there are none.

Uses measured steps of one load and one pair of pressures; the mass is taken as exact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from pmabench.analysis.shared.calibration import sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.student import mean_with_half
from pmabench.base.quantities import show
from pmabench.kinds.recorded_step import motion
from pmabench.kinds.recorded_step.motion import Delayed, fit_swings
from pmabench.kinds.recorded_step.step import Step
from pmabench.store.analyses.results import Estimate, Parts, withhold
from pmabench.store.records import Array

RINGING = "ringing-of-known-mass"
RINGS = 0.5
"""Damping ratio from which on a motion does not ring: its mass then shows in a fast pole only, which a few ms hide."""
RANGE = 0.15
"""K and B are given if they lie within this share of their value for all possible times and lags."""
ILL_FITTED = 0.1
"""Rms of the misfit as a share of the stroke, above which K and B are withheld."""
INSTEAD = "with a column of force or the load, a map of `kind: contraction-relaxation` gives K from such steps"
ONCE = "no repeats part: one step only"
OF_SWINGS = {
    "K": "of small, fast swings: what creeps, and hysteresis, stiffen them",
    "B": "of contracting and relaxing together",
}
STOPPED = 0.3
"""Ratio of observed to expected amplitude below which friction has stopped the oscillation."""


def ringing(at: Mapping[str, float], steps: Sequence[Step]) -> list[Estimate]:
    """K and B where the motion rings, or the reason why not; they follow from times and a mass, without any scale."""
    parents = tuple(step.name for step in steps)
    masses = [step.trial.point.get("mass", 0.0) for step in steps]
    known = all(masses)
    unknown = "pressure and displacement at one load give ratios only; `point: {mass: ...}` gives the moving mass"
    why = "" if known else unknown
    possible: list[list[Delayed]] = []
    for step in steps if known else ():
        if why := _why_not(step):
            break
        possible.append(possible_motions(step.driven, step.best, step.others))
        if why := _unlike(step, possible[-1]):
            break
    found: list[Estimate] = []
    for symbol, unit, quantity in (("K", "N/m", "stiffness"), ("B", "N.s/m", "damping")):
        empty = Estimate(symbol, None, unit, quantity, RINGING, at, n=len(steps), trials=parents)
        if why:
            reason = f"{why}; {INSTEAD}"
            found.append(withhold(empty, reason) if known else replace(empty, note=reason))
            continue
        ranges = [_range(symbol, mass, forms) for mass, forms in zip(masses, possible, strict=True)]
        value, half = mean_with_half([(low + high) / 2 for low, high in ranges])
        wide = max((high - low) / 2 for low, high in ranges)
        if wide > RANGE * value:
            spread = f"+-{wide / value:.0%} for the motions that fit alike"
            found.append(withhold(empty, f"it lies within {spread}, accepted is +-{RANGE:.0%}; {INSTEAD}"))
            continue
        parts = Parts(repeats=half, method=wide, calibration=0.0)
        note = sentences(OF_SWINGS[symbol], ONCE if half is None else "")
        given = replace(empty, value=value, parts=parts, note=note)
        found.append(weighed(given, _free_doubts(symbol, value, wide, steps, masses)))
    K, B = found
    if K.withheld and not B.withheld:
        found[1] = withhold(B, f"{K.note}. So the same motion gives no B")
    return found


def possible_motions(
    driven: tuple[Array, Array, Array], best: motion.Motion, others: Sequence[tuple[Array, Array]] = ()
) -> list[Delayed]:
    """The motions of a step that fit equally well, with longer and shorter lags of its sensors, and with an undeclared
    one.

    `driven`: time [s], pressure [Pa], contraction [m], shapes (n,); `others`: the last two for other lags.
    """
    t, P, x = driven
    nominal = fit_swings(t, P, x, motion.place_of(best))
    first = nominal[0].place
    found = motion.alike(nominal)
    for pressure, contraction in others:
        found += motion.alike(fit_swings(t, pressure, contraction, first))
    least = min(one.rms for one in found)
    for lag in motion.LAGS:
        lagging = fit_swings(t, motion.behind(t, P, lag), x, first, nominal[0].rms)
        found += [one for one in lagging if one.rms <= least and one.bounded]
    return found


def _range(symbol: str, mass: float, forms: Sequence[Delayed]) -> tuple[float, float]:
    """Smallest and largest K or B of a moving mass over all forms, including their intervals."""
    values = [(mass * getattr(one, symbol), mass * getattr(one, f"half_{symbol}")) for one in forms]
    return min(value - half for value, half in values), max(value + half for value, half in values)


def _free_doubts(symbol: str, value: float, wide: float, steps: Sequence[Step], masses: Sequence[float]) -> list[Doubt]:
    """Contradiction of K or B by the free oscillation after the step, beyond the range `wide`; it does not depend on
    delays.
    """
    others, stopped = [], False
    for step, mass in zip(steps, masses, strict=True):
        swings = motion.free_swings(step.t, step.P, step.x, step.best, step.noise)[:2]
        sizes = [(one.size, one.expected) for one in swings if one.expected > motion.CLEAR * step.noise]
        stopped = stopped or any(size < STOPPED * more for size, more in sizes)
        if symbol == "K":
            others += [mass * one.w**2 for one in swings[:1] if one.size > motion.CLEAR * step.noise]
        elif len(sizes) > 1:
            others.append(_without_friction(swings[0], swings[1], mass))
    unit = "stiffness" if symbol == "K" else "damping"
    apart = abs(float(np.mean(others)) - value) - wide if others else 0.0
    text = f"the free swinging after the step gives a {symbol} that is {show(apart, unit, 2)} outside of its range"
    why = "the curve is bent, or the pressure is later than was said"
    if symbol == "B":
        why = "friction does not grow with the speed, for small swings die faster"
    if stopped:
        apart, text = abs(value), "the swinging after the step ends early"
        why = "dry friction holds it, longer than this form takes"
    return [Doubt("free swinging", "method", apart, seen=True, reason=f"{text}: {why}; {INSTEAD}")] if apart > 0 else []


def _without_friction(first: motion.Swing, second: motion.Swing, mass: float) -> float:
    """B [N s/m] from two stretches of free oscillation: dry friction adds c/size, so B is a line extrapolated to 1/size
    = 0.
    """
    big, small = first.size, second.size
    one, other = (2 * mass * swing.D * swing.w for swing in (first, second))
    return (one * big - other * small) / (big - small) if big > small else one


HIDDEN = "its mass shows in a fast pole only, which a few ms between pressure and position hide"


def _why_not(step: Step) -> str:
    """Reason why the motion of a step does not ring; empty if it may."""
    if step.sprung:
        return "a spring pulls, too, and swings with the mass"
    if step.best.D >= RINGS:
        return _damped(step.best.D)
    if not 1.02 * motion.FREQUENCY[0] < step.best.w < motion.FREQUENCY[1] / 1.02:
        low, high = motion.FREQUENCY
        return f"the motion does not ring (no natural frequency from {low:g} to {high:g} rad/s fits it): {HIDDEN}"
    end = float(np.median(step.x[step.t > step.t[-1] - 1.0]))
    seen = motion.extremes(step.x[step.t > 0], end, step.noise)
    if seen < 2:
        few = f"{seen} extremes beyond {motion.SHOWN:g} times its noise, 2 are needed"
        return f"the motion does not ring ({few}): {HIDDEN}"
    return ""


def _damped(ratio: float) -> str:
    most = f"{ratio:.1f}" if ratio < motion.DAMPING[1] / 1.02 else f"{motion.DAMPING[1]:g} or more"
    return f"the motion does not ring (damping ratio {most}, less than {RINGS:g} is needed): {HIDDEN}"


def _unlike(step: Step, possible: Sequence[Delayed]) -> str:
    """Reason why motions that fit equally well do not determine K; empty if they do."""
    damped = max(one.B / (2 * sqrt(one.K)) for one in possible)
    if damped >= RINGS:
        return _damped(damped)
    share = max(one.rms for one in possible) / abs(step.stroke)
    if share > ILL_FITTED:
        return f"the misfit is {share:.0%} of the stroke (trial {step.name})"
    if not all(one.bounded for one in possible):
        return f"the motion is more than {show(motion.FREE, 'time')} off the pressure (trial {step.name})"
    return ""
