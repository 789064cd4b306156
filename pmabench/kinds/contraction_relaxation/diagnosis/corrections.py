"""Explanations of a misfit and their corrections: samples shifted in time, a drift or a slip removed, forces added.

Faults of the bench are corrected in the samples. What the muscle does beyond the straight form is a force at each
segment, subtracted from the measured one so that the straight part remains. Also sentences: the cause, its size, and
what to check. Does not test fits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from pmabench.analysis.shared.samples import Samples
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.diagnosis import columns
from pmabench.kinds.contraction_relaxation.diagnosis.columns import BY_LOAD, BY_WAY, LOADED, TYPICAL
from pmabench.kinds.contraction_relaxation.pooled import Fit
from pmabench.kinds.contraction_relaxation.segments import Campaign, Segments, moved
from pmabench.store.records import Array

SOFTEST = 1.0
"""Least K for converting creep to a force [N/m]: a fit to almost no motion may give any K."""
MOST_LATE = 0.06
"""Longest time that a stream is moved or filtered by [s]."""
TIMES = ("late", "lag", "clock")
"""Explanations whose size is a time of a stream."""
GUIDE = "gain or guide"
"""Variant of a gain that may also be friction between cell and weight."""
AGAINST = 0.3
"""Largest part of a creep with opposite sign, as a share of its largest part, that noise and the spacing of the time
constants can cause.
"""


@dataclass(frozen=True)
class Explanation:
    """One cause with its sizes."""

    kind: str
    """`drift`, `gain`, `slip`, `late`, `lag`, `clock`, `bend`, `sensor`, `hysteresis` or `creep`."""
    which: str = ""
    """Channel of `late`, `lag` or `clock`; number of the first trial after a slip; or variant."""
    sizes: tuple[float, ...] = ()
    """[SI]: N, ratio, m or s. Drift: values at the ends of equal pieces of the campaign. Clock: delay in the middle of
    a run, and its growth from start to end. Muscle: one for each column of `columns`.
    """

    @property
    def of_muscle(self) -> bool:
        """Whether it is, or may be, a property of the muscle: a force that the straight form lacks."""
        return self.kind in columns.OF_MUSCLE

    @property
    def cause(self) -> str:
        """Key of the cause: delay, filter and clock error of one channel count as one, slips at any trial, too."""
        return f"late {self.which}" if self.kind in TIMES else self.kind

    @property
    def creeps(self) -> Array:
        """Sizes of a creep at a load of `LOADED`, one for each of its times."""
        return np.asarray(np.array(self.sizes).reshape(2 if self.which == columns.BY_LOAD else 1, -1).sum(axis=0))

    @property
    def family(self) -> str:
        """Key of alternatives of which a model needs one at most: bend of the muscle and of the displacement sensor are
        one.
        """
        return "bend" if self.kind == "sensor" else self.cause


def plausible(one: Explanation) -> bool:
    """Whether a muscle can behave like that: creep goes with the motion, hysteresis dissipates work, and K that is
    steep near zero contraction falls.
    """
    if one.kind == "creep":
        near = np.array([0.5, 0.5] if one.which.startswith("by time") else [1.0])
        decades = np.convolve(one.creeps, near, "valid")
        return bool(decades.min() > -AGAINST * decades.max())
    if one.kind == "hysteresis":
        return sum(one.sizes) > 0
    return one.which != "steep" or sum(one.sizes[2:]) > 0


def muscle_columns(
    one: Explanation, followed: columns.Followed, segments: Segments, fit: Fit, others: Sequence[Explanation]
) -> Array:
    """Columns of a property of the muscle; for a bend, over the contraction minus its creep."""
    creeps = [other for other in others if other.kind == "creep"] if one.family == "bend" else []
    for other in creeps:
        forces = columns.OF_MUSCLE["creep"][other.which](followed, segments, fit) @ np.array(other.sizes)
        crept = forces / np.maximum(fit.values("K", segments.pressure), SOFTEST)
        segments = replace(segments, x=segments.x - crept[:, None])
    return columns.OF_MUSCLE[one.kind][one.which](followed, segments, fit)


def in_samples(campaign: Campaign, explanations: Sequence[Explanation]) -> Campaign:
    """The campaign with faults of the bench corrected in its samples."""
    faults = [one for one in explanations if not one.of_muscle]
    if not faults:
        return campaign
    place, clock = columns.order(campaign), columns.clock(campaign)
    course = columns.course(campaign)
    samples = []
    for i, each in enumerate(campaign.samples):
        for one in faults:
            size = one.sizes[0]
            if one.kind == "drift" and each.force is not None:
                ends = np.linspace(0.0, 1.0, len(one.sizes) + 1)
                each = replace(each, force=each.force - np.interp(course(i), ends, (0.0, *one.sizes)))
            elif one.kind == "gain" and each.force is not None:
                each = replace(each, force=each.force / (1 + size))
            elif one.kind == "slip" and place[i] >= place[int(one.which)]:
                each = replace(each, x=each.x + size)
            elif one.kind in ("late", "clock"):
                each = moved(each, (one.which,), size + sum(one.sizes[1:]) * float(clock[i]))
            elif one.kind == "lag":
                each = _filtered(each, one.which, size, campaign.rate)
        samples.append(each)
    return replace(campaign, samples=tuple(samples))


def _filtered(samples: Samples, channel: str, constant: float, rate: float) -> Samples:
    """All other channels filtered like `channel`, by a time constant [s]; `channel` itself where the constant is
    negative.
    """
    return samples.having(
        {
            name: _behind(values, abs(constant) * rate)
            for name, values in samples.channels.items()
            if (name == channel) != (constant > 0)
        }
    )


def _behind(values: Array, constant: float) -> Array:
    """Samples after a first-order filter with a time constant in samples; gaps are interpolated for it and stay nan."""
    known = np.isfinite(values)
    if constant < 1e-3 or not known.any():
        return values
    rows = np.arange(len(values))
    whole = values if known.all() else np.interp(rows, rows[known], values[known])
    return np.where(known, columns.lagged(whole, constant), np.nan)


def forces_of(followed: columns.Followed, segments: Segments, fit: Fit, explanations: Sequence[Explanation]) -> Array:
    """Force of the muscle beyond the straight form [N], shape (n,); `fit` is that of the straight part."""
    mine = [one for one in explanations if one.of_muscle]
    forces = [muscle_columns(one, followed, segments, fit, mine) @ np.array(one.sizes) for one in mine]
    return np.asarray(np.sum(forces, axis=0)) if mine else np.zeros(len(segments))


LASTING = 100.0
"""Creep is stated for time constants below this [s]: slower creep hardly shows in one trial."""
KIND_IS_A_GUESS = 8e-3
"""Below this time [s] a delay cannot be distinguished from a filter."""
TO_TELL = "relax in steps (`relax.by`): after the way down a guide makes the cell read too little, a gain does not"
TITLES: Mapping[str, str] = {
    "drift": "drift of the force cell",
    "gain": "gain of the force cell",
    GUIDE: "gain of the force cell, or friction of a guide",
    "slip": "slip of a mount",
    "bend": "bend of the force over contraction",
    "sensor": "bend of the force over contraction, or of the displacement sensor",
    "hysteresis": "hysteresis",
    "creep": "creep",
    "late pressure": "time of the pressure",
    "late displacement": "time of the displacement",
    "late force": "time of the force",
    "clock": "clock of a device",
    "tube": "pressure that reaches the muscle late",
}
ADVICE: Mapping[str, str] = {
    "drift": "let the force cell warm up, zero it before and after, and keep side loads and cable pull off it",
    "gain": "calibrate the force cell, or weigh the weights",
    GUIDE: f"calibrate the force cell, or weigh the weights; {TO_TELL}",
    "slip": "look at the clamps of the muscle and at the mount of the displacement sensor: mark them before a test, "
    "and see whether the marks have moved",
    "late pressure": "look at the filter and the wire of the pressure gauge, and at the clock of its device",
    "late displacement": "look at the filter of the displacement sensor, and at the clock of its device",
    "late force": "look at the filter of the force cell's amplifier, and at the clock of its device",
    "clock": "record all channels with one device, or with clocks that are kept equal",
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
    """Key in `TITLES` and `ADVICE`."""
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
        """Advice on what to check."""
        found = ADVICE[self.key]
        one = self.explanation
        if one.kind == "late" or (one.kind == "lag" and abs(self.size) < KIND_IS_A_GUESS):
            found += f'; `pmabench recalibrate RUN... --skew "{one.which}={1e3 * self.size:.3g} ms"` takes this time'
        return found


def named(one: Explanation, off: Array, fit: Fit, highest: float, trial: str = "") -> Named:
    """An explanation in words.

    `off` (groups, sizes) [SI]: deviations of its sizes without each group of trials (jackknife); `fit`: to the
    corrected samples; `highest`: highest tested pressure [Pa]; `trial`: name of the first trial after a slip.
    """
    weights = _weights(one, fit, highest)
    size = float(weights @ np.array(one.sizes))
    count = max(1, len(off))
    error = sqrt(float(np.sum((off @ weights) ** 2)) * (count - 1) / count)
    text = _text(one, size, error, highest, trial)
    key = GUIDE if one.which == GUIDE else "clock" if one.kind == "clock" else one.cause
    return Named(one, "tube" if key == "late pressure" and size < 0 else key, size, error, text)


def _weights(one: Explanation, fit: Fit, highest: float) -> Array:
    """Weights that combine the sizes into one, shape (sizes,)."""
    if one.kind == "drift":  # its largest value
        return np.where(np.arange(len(one.sizes)) == np.argmax(np.abs(one.sizes)), 1.0, 0.0)
    if one.kind == "clock":
        return np.array([0.0, 1.0])
    if one.kind == "hysteresis":
        share = 0.5 if one.which == BY_WAY else 1.0
        return np.tile([share, share * highest / TYPICAL], len(one.sizes) // 2)
    if one.kind == "bend" and len(one.sizes) > 1:
        by_pressure = np.array([1.0, highest / TYPICAL]) / float(fit.values("K", np.array([highest]))[0])
        return np.tile(by_pressure, len(one.sizes) // 2)
    if one.kind == "creep" and len(one.sizes) > 1:
        felt = np.array(columns.TIMES)[:: len(columns.TIMES) // len(one.creeps)] < LASTING
        return np.tile(felt / felt.sum(), len(one.sizes) // len(one.creeps))
    return np.full(len(one.sizes), 1 / len(one.sizes))


def _text(one: Explanation, size: float, error: float, highest: float, trial: str) -> str:
    quantity = SIZES.get(one.kind, "time")
    much = f"{shown(size, quantity)} +- {shown(2 * error, quantity)}"
    if one.kind == "drift":
        course = "in the campaign, not evenly" if len(one.sizes) > 1 else "over the campaign"
        return f"the zero of the force cell drifted by {'-' if size < 0 else ''}{much} {course}"
    if one.kind == "gain":
        rubs = ", or a guide between it and the weights rubs" if one.which == GUIDE else ""
        return f"the force cell reads {much} too {'much' if size > 0 else 'little'}{rubs}"
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
    if one.kind == "clock":
        pace, middle = "slow" if size < 0 else "fast", f"{1e3 * one.sizes[0]:+.2g} ms"
        return f"the clock of the {one.which} runs {pace}, by {much} in a run, and is {middle} off in the middle"
    if one.which == "pressure" and size < 0:
        return f"the pressure in the muscle is {much} behind the gauge, or the gauge's clock is ahead"
    how = "behind" if size > 0 else "ahead of"
    kind = "delay or filter" if abs(size) < KIND_IS_A_GUESS else ("delay" if one.kind == "late" else "filter")
    return f"{one.which} is {much} {how} the other channels ({kind})"


def shown(value: float, quantity: str) -> str:
    """Absolute size with its unit."""
    if quantity == "time":
        return f"{1e3 * abs(value):.2g} ms"
    return f"{100 * abs(value):.2g} %" if quantity == "ratio" else show(abs(value), quantity, 2)
