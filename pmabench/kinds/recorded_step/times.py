"""Time constant B/K and dead time to the motion of recorded steps: what pressure and position tell without a mass.

Knows measured steps of one load and one pair of pressures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot, sqrt

import numpy as np

from pmabench.analysis.shared.calibration import sentences
from pmabench.analysis.shared.student import mean_with_half
from pmabench.base.quantities import show
from pmabench.kinds.recorded_step.delayed import Delayed, fit_delayed
from pmabench.kinds.recorded_step.ringing import ILL_FITTED, ONCE, RINGS
from pmabench.kinds.recorded_step.step import SEEN, Step
from pmabench.store.analyses.results import Estimate, Finding, Parts
from pmabench.store.records import Array

DRIVEN = "driven-delay"
TO_MOTION = "command-to-motion"
SHARES = (0.002, 0.01)
"""Of the stroke: where the contraction is looked at for the root rule."""
ROOT = 8e-3
"""What the root rule leaves of a mass of up to 26 kg, with noise [s]."""
LONGEST = 0.02
"""A dead time whose interval is wider than this [s] either way says nothing of a delay."""


def delayed(step: Step, w: float | None = None) -> Delayed:
    """The motion of a step with its delay behind the pressure; `w` sqrt(K/M) [rad/s], where both are known."""
    return fit_delayed(*step.driven, step.best, w)


def times(at: Mapping[str, float], steps: Sequence[Step], stiffness: float | None, late: float) -> list[Estimate]:
    """B/K [s] at the pressure that steps end at, and the time from command to motion [s].

    `stiffness` [N/m] is known of two loads; `late` [s]: what pressure and position may be apart where nothing says it.
    The delay of the motion behind the measured pressure is free, so that B/K does not depend on the stamps of the
    pressure; the time from command to motion holds what the stamps of the position may be off, as far as that is known.
    """
    names = tuple(step.name for step in steps)
    rises = at["pressure"] > at["from"]
    symbol = "tau_c" if rises else "tau_r"
    B_K = Estimate(symbol, None, "s", "time", DRIVEN, at, n=len(steps), trials=names)
    if why := _of_another_kind(steps):
        return [replace(B_K, note=why)]
    mass = float(np.mean([step.trial.point.get("mass", 0.0) for step in steps]))
    w = sqrt(stiffness / mass) if stiffness is not None and mass > 0 else None
    found = [delayed(step, w) for step in steps]
    if why := _why_not(steps, found):
        return [replace(B_K, note=why)]
    tau, of_tau = mean_with_half([one.tau for one in found])
    where = f"B/K at {show(at['pressure'], 'pressure', 3)}, {'contracting' if rises else 'relaxing'}"
    note = sentences(where, ONCE if of_tau is None else "")
    B_K = replace(B_K, value=tau, parts=Parts(of_tau, max(one.half_tau for one in found), 0.0), note=note)
    t_d = _to_motion(at, steps, found, late)
    return [B_K] if t_d is None else [B_K, t_d]


def _to_motion(
    at: Mapping[str, float], steps: Sequence[Step], found: Sequence[Delayed], late: float
) -> Estimate | None:
    """The time from command to motion [s]; None where no step has a command."""
    commanded = [(step, one) for step, one in zip(steps, found, strict=True) if not step.found]
    if not commanded:
        return None
    dead, of_dead = mean_with_half([step.stamped + one.delay for step, one in commanded])
    half = hypot(max(one.half_delay for _, one in commanded), max(step.onset_half for step, _ in commanded)) + late
    names, note = tuple(step.name for step, _ in commanded), "" if of_dead is not None else ONCE
    note = sentences("the time that the pressure takes to overcome friction is in it", note)
    parts = Parts(of_dead, half, 0.0)
    t_d = Estimate("t_d", dead, "s", "time", DRIVEN, at, parts, len(names), note=note, trials=names)
    t_d = replace(t_d, coordinate=TO_MOTION)
    if half > LONGEST:
        text = f"a delay of {show(dead, 'time', 2)} and the lag of the mass cannot be distinguished"
        text = f"{text} (+- {show(half, 'time', 2)}): steps at two known loads give K, and with it that lag"
        t_d = replace(t_d, value=None, parts=Parts(), note=text)
    return t_d


def _of_another_kind(steps: Sequence[Step]) -> str:
    """The reason why these motions have no B/K of their own; empty where they may have one."""
    if min(step.best.D for step in steps) < RINGS:
        return "the motion rings, and friction would be taken for damping: a known mass gives K and B of it"
    if pulled := [step.name for step in steps if step.sprung]:
        return f"a spring pulls, too (trial {pulled[0]}): the time constant is B over K and the spring together"
    return ""


def _why_not(steps: Sequence[Step], found: Sequence[Delayed]) -> str:
    """The reason why the driven motion gives no B/K; empty where it does."""
    for step, one in zip(steps, found, strict=True):
        if one.rms > ILL_FITTED * abs(step.stroke):
            share = one.rms / abs(step.stroke)
            return f"the driven motion misses {share:.0%} of the stroke (trial {step.name}): friction, or a stop"
        if not one.bounded:
            return (
                f"the motion is {show(one.delay, 'time', 2)} +- {show(one.half_delay, 'time', 2)} behind the measured "
                f"pressure (trial {step.name}), as far as was looked: see to the clocks of both channels"
            )
    return ""


def root_rule(t: Array, x: Array, stroke: float, noise: float) -> float | None:
    """When a motion begins that rises like t^2 [s]: t1, t2 of two shares of the stroke, carried back by their roots.

    t [s] from the command and x [m] from its rest, shapes (n,). None where the noise hides the smaller share.
    """
    low, high = SHARES
    if SEEN * noise > low * abs(stroke):
        return None
    gone = x / stroke
    crossed = []
    for share in SHARES:
        above = np.flatnonzero((gone >= share) & (t > 0))
        if not len(above) or above[0] == 0:
            return None
        n = int(above[0])
        part = (share - gone[n - 1]) / (gone[n] - gone[n - 1])
        crossed.append(float(t[n - 1] + part * (t[n] - t[n - 1])))
    return (crossed[0] * sqrt(high) - crossed[1] * sqrt(low)) / (sqrt(high) - sqrt(low))


def check(at: Mapping[str, float], steps: Sequence[Step], t_d: Estimate) -> list[Finding]:
    """The root rule next to the time from command to motion of the driven motion."""
    if t_d.value is None:
        return []
    by_root = [
        begun
        for step in steps
        if (begun := root_rule(step.t, step.x - np.median(step.x[step.t < 0]), step.stroke, step.noise)) is not None
    ]
    if not by_root:
        return []
    mean, value = float(np.mean(by_root)), t_d.value
    where = f"{show(at['from'], 'pressure')} to {show(at['pressure'], 'pressure')}"
    text = f"{where}: command to motion {show(value, 'time', 3)}, by the root rule {show(mean, 'time', 3)}"
    apart = abs(mean - value) - (t_d.parts.combined or 0.0)
    if apart <= ROOT:
        return [Finding("note", text)]
    return [Finding("doubt", f"{text}: further apart than a mass explains; look at how the motion begins")]
