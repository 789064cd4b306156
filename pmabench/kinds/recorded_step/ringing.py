"""K and B from steps after which a known mass rings, or why they do not tell them.

Knows measured steps; the mass is taken as exact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.student import mean_with_half
from pmabench.base.quantities import show
from pmabench.kinds.recorded_step.motion import (
    CLEAR,
    DAMPING,
    FREQUENCY,
    SHOWN,
    Swing,
    extremes,
    fit_motion,
    free_swings,
    lagged_motions,
)
from pmabench.kinds.recorded_step.step import Step
from pmabench.store.analyses.results import Estimate, Parts, withhold

RINGING = "ringing-of-known-mass"
RINGS = 0.5
"""Damping ratio from which on a motion does not ring: the mass shows in its fast pole only, which a few ms hide."""
RANGE = 0.15
"""K and B are given where they lie within so much of their value for all that is possible of times and lags."""
ILL_FITTED = 0.1
"""Rms of the misfit as a share of the stroke, above which K and B are withheld."""
INSTEAD = "with a column of force or the load, a map of `kind: contraction-relaxation` gives K from such steps"
ONCE = "no repeats part: one step only"
STOPPED = 0.3
"""Share of the swing that the motion should have, below which friction has stopped it."""


def ringing(
    at: Mapping[str, float], steps: Sequence[Step], options: Mapping[str, Any], apart: Sequence[float]
) -> list[Estimate]:
    """K and B where the motion rings, or why not; from times and a mass, no scale of a channel enters."""
    parents = tuple(step.name for step in steps)
    kinds = (("K", "N/m", "stiffness"), ("B", "N.s/m", "damping"))
    masses = [float(options.get("mass", step.trial.point.get("mass", 0.0))) for step in steps]
    unknown = "pressure and displacement at one load give ratios only; `point: {mass: ...}` gives the moving mass"
    why = "" if all(masses) else unknown
    held = False
    ranges: dict[str, list[tuple[float, float]]] = {"K": [], "B": []}
    for step, mass in zip(steps, masses, strict=True):
        if not why:
            why = _why_not(step)
            held = bool(why)
        if why:
            break
        near = step.driven
        possible = [
            *step.motions,
            *step.slower,
            *(fit_motion(*near, late) for late in apart),
            *lagged_motions(*near, step.best),
        ]
        for symbol, values in (
            ("K", [mass * motion.w**2 for motion in possible]),
            ("B", [2 * motion.D * motion.w * mass for motion in possible]),
        ):
            ranges[symbol].append((min(values), max(values)))
    found: list[Estimate] = []
    for symbol, unit, quantity in kinds:
        empty = Estimate(symbol, None, unit, quantity, RINGING, at, n=len(steps), trials=parents)
        if why:
            reason = f"{why}; {INSTEAD}"
            found.append(withhold(empty, reason) if held else replace(empty, note=reason))
            continue
        value, half = mean_with_half([(low + high) / 2 for low, high in ranges[symbol]])
        wide = max((high - low) / 2 for low, high in ranges[symbol])
        if wide > RANGE * value:
            spread = f"+-{wide / value:.0%} for what is known of the time between pressure and position"
            found.append(withhold(empty, f"it lies within {spread}, accepted is +-{RANGE:.0%}; {INSTEAD}"))
            continue
        parts = Parts(repeats=half, method=wide, calibration=0.0)
        once = ONCE if half is None else ""
        given = replace(empty, value=value, parts=parts, note=once)
        found.append(weighed(given, _free_doubts(symbol, value, wide, steps, masses)))
    return found


def _free_doubts(symbol: str, value: float, wide: float, steps: Sequence[Step], masses: Sequence[float]) -> list[Doubt]:
    """What the free swinging after the step says against K or B, beyond the range `wide`: it knows no times."""
    others, stopped = [], False
    for step, mass in zip(steps, masses, strict=True):
        after, best = step.t > 0, step.best
        swings = free_swings(step.t[after], step.P[after], step.x[after], best, step.noise)[:2]
        expected = [abs(step.stroke) * np.exp(-best.D * best.w * one.at) for one in swings]
        sizes = [(one.size, size) for one, size in zip(swings, expected, strict=True) if size > CLEAR * step.noise]
        stopped = stopped or any(size < STOPPED * more for size, more in sizes)
        if symbol == "K":
            others += [mass * one.w**2 for one in swings[:1] if one.size > CLEAR * step.noise]
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
        why = "dry friction holds it, and this form has none"
    return [Doubt("free swinging", "method", apart, seen=True, reason=f"{text}: {why}; {INSTEAD}")] if apart > 0 else []


def _without_friction(first: Swing, second: Swing, mass: float) -> float:
    """B [N s/m] of two stretches of free swinging: dry friction adds c/size, so a line over 1/size is B without it."""
    big, small = first.size, second.size
    one, other = (2 * mass * swing.D * swing.w for swing in (first, second))
    return (one * big - other * small) / (big - small) if big > small else one


def ill_fitted(step: Step) -> str:
    """The reason why the driven motion does not describe a step; empty where it does."""
    share = max(motion.rms for motion in step.motions) / abs(step.stroke)
    return f"the misfit is {share:.0%} of the stroke (trial {step.name})" if share > ILL_FITTED else ""


def _why_not(step: Step) -> str:
    """The reason why the motion of a step says nothing of K; empty where it does."""
    if step.sprung:
        return "a spring pulls, too, and swings with the mass"
    damped = max(motion.D for motion in step.motions)
    frequencies = [motion.w for motion in step.motions]
    hidden = "its mass shows in a fast pole only, which a few ms between pressure and position hide"
    if damped >= RINGS:
        most = f"{damped:.1f}" if damped < DAMPING[1] / 1.02 else f"{DAMPING[1]:g} or more"
        return f"the motion does not ring (damping ratio {most}, less than {RINGS:g} is needed): {hidden}"
    if min(frequencies) <= 1.02 * FREQUENCY[0] or max(frequencies) >= FREQUENCY[1] / 1.02:
        low, high = FREQUENCY
        return f"the motion does not ring (no natural frequency from {low:g} to {high:g} rad/s fits it): {hidden}"
    if why := ill_fitted(step):
        return why
    end = float(np.median(step.x[step.t > step.t[-1] - 1.0]))
    seen = extremes(step.x[step.t > 0], end, step.noise)
    if seen < 2:
        return f"the motion does not ring ({seen} extremes beyond {SHOWN:g} times its noise, 2 are needed): {hidden}"
    return ""
