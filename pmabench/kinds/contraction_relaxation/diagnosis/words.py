"""Explanations in words: what it is and how large, and what to look at; texts and units only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt

import numpy as np

from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.diagnosis.columns import BY_LOAD, BY_WAY, LOADED, TIMES, TYPICAL
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import Explanation
from pmabench.kinds.contraction_relaxation.pooled import Solved
from pmabench.store.records import Array

LASTING = 100.0
"""Creep is stated for the decades of time below this one [s]: what is slower hardly shows in one trial."""
KIND_IS_A_GUESS = 8e-3
"""Below so long a time [s] nobody can tell a delay from a filter."""
TITLES: Mapping[str, str] = {
    "drift": "drift of the force cell",
    "gain": "gain of the force cell",
    "slip": "slip of a mount",
    "bend": "bend of the force over contraction",
    "sensor": "bend of the force over contraction, or of the displacement sensor",
    "hysteresis": "hysteresis",
    "creep": "creep",
    "late pressure": "time of the pressure",
    "late displacement": "time of the displacement",
    "late force": "time of the force",
    "tube": "pressure that reaches the muscle late",
}
ADVICE: Mapping[str, str] = {
    "drift": "let the force cell warm up, zero it before and after, and keep side loads and cable pull off it",
    "gain": "calibrate the force cell, or weigh the weights",
    "slip": "look at the clamps of the muscle and at the mount of the displacement sensor: mark them before a test, "
    "and see whether the marks have moved",
    "late pressure": "look at the filter and the wire of the pressure gauge, and at the clock of its device",
    "late displacement": "look at the filter of the displacement sensor, and at the clock of its device",
    "late force": "look at the filter of the force cell's amplifier, and at the clock of its device",
    "tube": "put the gauge at the muscle, or shorten and widen the tube between them; see that the gauge's clock is "
    "not ahead",
    "bend": "report K with the contraction at which it is the slope (printed with it)",
    "sensor": "calibrate the displacement sensor at several places; a muscle whose K and B change alike looks the same",
    "hysteresis": "repeat with strokes of other sizes: it belongs to the muscle",
    "creep": "state how long pressures were held: it belongs to the muscle",
}
SIZES = {"drift": "force", "gain": "ratio", "slip": "length", "bend": "ratio", "sensor": "ratio",
         "hysteresis": "force", "creep": "ratio"}  # fmt: skip
"""Kind -> quantity of its size; others are times."""


@dataclass(frozen=True, eq=False)
class Named:
    """An explanation with its size in one number."""

    explanation: Explanation
    key: str
    """Of `TITLES` and `ADVICE`."""
    size: float
    """[SI]"""
    error: float
    """Standard deviation [SI]."""
    text: str
    """A sentence without a full stop."""

    @property
    def of_muscle(self) -> bool:
        """Whether it is a property of the muscle."""
        return self.explanation.of_muscle and self.explanation.kind != "sensor"

    @property
    def advice(self) -> str:
        """What to look at."""
        found = ADVICE[self.key]
        one = self.explanation
        if one.kind == "late" or (one.kind == "lag" and abs(self.size) < KIND_IS_A_GUESS):
            found += f'; `pmabench recalibrate RUN... --skew "{one.which}={1e3 * self.size:.3g} ms"` takes this time'
        return found


def named(one: Explanation, off: Array, fit: Solved, highest: float, trial: str = "") -> Named:
    """An explanation in words.

    `off` (groups, sizes) [SI] is what its sizes are off by without each group of trials (jackknife), `fit` that to the
    corrected samples, `highest` the highest pressure tested [Pa], `trial` the name of the first one after a slip.
    """
    weights = _weights(one, fit, highest)
    size = float(weights @ np.array(one.sizes))
    count = max(1, len(off))
    error = sqrt(float(np.sum((off @ weights) ** 2)) * (count - 1) / count)
    text = _text(one, size, error, highest, trial)
    return Named(one, "tube" if one.cause == "late pressure" and size < 0 else one.cause, size, error, text)


def _weights(one: Explanation, fit: Solved, highest: float) -> Array:
    """What makes one size of all, shape (sizes,)."""
    if one.kind == "drift":  # the farthest that it went
        return np.where(np.arange(len(one.sizes)) == np.argmax(np.abs(one.sizes)), 1.0, 0.0)
    if one.kind == "hysteresis":
        share = 0.5 if one.which == BY_WAY else 1.0
        return np.tile([share, share * highest / TYPICAL], len(one.sizes) // 2)
    if one.kind == "bend" and len(one.sizes) > 1:
        by_pressure = np.array([1.0, highest / TYPICAL]) / float(fit.values("K", np.array([highest]))[0])
        return np.tile(by_pressure, len(one.sizes) // 2)
    if one.kind == "creep" and len(one.sizes) > 1:
        felt = np.array(TIMES)[:: len(TIMES) // len(one.creeps)] < LASTING
        return np.tile(felt / felt.sum(), len(one.sizes) // len(one.creeps))
    return np.full(len(one.sizes), 1 / len(one.sizes))


def _text(one: Explanation, size: float, error: float, highest: float, trial: str) -> str:
    quantity = SIZES.get(one.kind, "time")
    much = f"{shown(size, quantity)} +- {shown(2 * error, quantity)}"
    if one.kind == "drift":
        course = "in the campaign, not evenly" if len(one.sizes) > 1 else "over the campaign"
        return f"the zero of the force cell drifted by {'-' if size < 0 else ''}{much} {course}"
    if one.kind == "gain":
        return f"the force cell reads {much} too {'much' if size > 0 else 'little'}"
    if one.kind == "slip":
        return f"the mount or the displacement sensor slipped by {much} before trial {trial}"
    if one.kind == "bend":
        way = "falls" if size > 0 else "rises"
        return f"the force over contraction is bent: K {way} by {much} over the contractions tested"
    if one.kind == "sensor":
        way = "fall" if size > 0 else "rise"
        return f"K and B {way} alike by {much} over the contractions tested, or the displacement sensor is not straight"
    if one.kind == "hysteresis":
        return f"the muscle has hysteresis of {much} at {show(highest, 'pressure', 3)}"
    if one.kind == "creep":
        load = f" under a load of {show(LOADED, 'force', 3)}" if one.which == BY_LOAD else ""
        return f"the muscle creeps by {much} of its contraction in a decade of time{load}"
    if one.which == "pressure" and size < 0:
        return f"the pressure in the muscle is {much} behind the gauge, or the gauge's clock is ahead"
    how = "behind" if size > 0 else "ahead of"
    kind = "delay or filter" if abs(size) < KIND_IS_A_GUESS else ("delay" if one.kind == "late" else "filter")
    return f"{one.which} is {much} {how} the other channels ({kind})"


def shown(value: float, quantity: str) -> str:
    """A size without its sign, in the units that people read."""
    if quantity == "time":
        return f"{1e3 * abs(value):.2g} ms"
    return f"{100 * abs(value):.2g} %" if quantity == "ratio" else show(abs(value), quantity, 2)
