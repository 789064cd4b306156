"""Explanations of a misfit and their corrections: samples moved in time, a drift or a slip taken off, forces added.

What is wrong with the bench is corrected in the samples. What the muscle does beyond the straight form is a force at
each segment, which is taken off the force there: then the straight part is left. Knows no test of a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmabench.analysis.shared.samples import Samples
from pmabench.kinds.contraction_relaxation.diagnosis import columns
from pmabench.kinds.contraction_relaxation.pooled import Solved
from pmabench.kinds.contraction_relaxation.segments import Segments, moved
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.store.records import Array

SOFTEST = 1.0
"""A fit to hardly anything may give any K; creep acts through one of at least this [N/m]."""
MOST_LATE = 0.06
"""Longest time that a stream is moved or filtered by [s]."""
CHANNELS = ("pressure", "displacement", "force")
AGAINST = 0.3
"""Share of the largest part of a creep that another may go against it, by noise and by time constants between ours."""


@dataclass(frozen=True)
class Explanation:
    """One cause with its sizes."""

    kind: str
    """`drift`, `gain`, `slip`, `late`, `lag`, `bend`, `sensor`, `hysteresis` or `creep`."""
    which: str = ""
    """Channel that is late or lagged, number of the first trial after a slip, or variant."""
    sizes: tuple[float, ...] = ()
    """[SI]: N, share, m, s; of a drift at the ends of so many even pieces of the campaign; of the muscle one for each
    column of `columns`.
    """

    @property
    def of_muscle(self) -> bool:
        """Whether it is, or may be, a property of the muscle: a force that the straight form lacks."""
        return self.kind in columns.OF_MUSCLE

    @property
    def cause(self) -> str:
        """What counts as one cause: a delay and a filter of one channel do, and slips at any trial."""
        return f"late {self.which}" if self.kind in ("late", "lag") else self.kind

    @property
    def creeps(self) -> Array:
        """Sizes of a creep at a load of `LOADED`, one for each of its times."""
        return np.asarray(np.array(self.sizes).reshape(2 if self.which == columns.BY_LOAD else 1, -1).sum(axis=0))

    @property
    def family(self) -> str:
        """Causes of which a model needs one at most: a bend of the muscle and of the displacement sensor are."""
        return "bend" if self.kind == "sensor" else self.cause


def plausible(one: Explanation) -> bool:
    """Whether a muscle can be so: it creeps the way that it went, hysteresis takes work away, and where K is steep near
    no contraction it falls.
    """
    if one.kind == "creep":
        near = np.array([0.5, 0.5] if one.which.startswith("by time") else [1.0])
        decades = np.convolve(one.creeps, near, "valid")
        return bool(decades.min() > -AGAINST * decades.max())
    if one.kind == "hysteresis":
        return sum(one.sizes) > 0
    return one.which != "steep" or sum(one.sizes[2:]) > 0


def columns_of(
    one: Explanation, campaign: Campaign, followed: columns.Followed, segments: Segments, fit: Solved,
    others: Sequence[Explanation] = (),
) -> Array:  # fmt: skip
    """Change of F_L by each size, at first order [N per SI], shape (n, sizes)."""
    if one.kind == "drift":
        return columns.drift(campaign, segments)[:, None]
    if one.kind == "slip":
        return columns.slip(campaign, segments, fit, int(one.which))[:, None]
    if one.kind in ("late", "lag"):
        return columns.late(segments, fit, campaign.cell)[one.which][0][:, None]
    return _of_muscle(one, followed, segments, fit, others)


def _of_muscle(
    one: Explanation, followed: columns.Followed, segments: Segments, fit: Solved, others: Sequence[Explanation]
) -> Array:
    """Columns of a property of the muscle: what creeps is not strained, and does not bend the force."""
    creeps = [other for other in others if other.kind == "creep"] if one.family == "bend" else []
    for other in creeps:
        forces = columns.OF_MUSCLE["creep"][other.which](followed, segments, fit) @ np.array(other.sizes)
        crept = forces / np.maximum(fit.values("K", segments.pressure), SOFTEST)
        segments = replace(segments, x=segments.x - crept[:, None])
    return columns.OF_MUSCLE[one.kind][one.which](followed, segments, fit)


def in_samples(campaign: Campaign, explanations: Sequence[Explanation]) -> Campaign:
    """The campaign with what is wrong with the bench corrected in its samples."""
    faults = [one for one in explanations if not one.of_muscle]
    if not faults:
        return campaign
    place = columns.order(campaign)
    course = columns.course(campaign) if any(one.kind == "drift" for one in faults) else ()
    samples = []
    for i, each in enumerate(campaign.samples):
        for one in faults:
            size = one.sizes[0]
            if one.kind == "drift" and each.force is not None:
                ends = np.linspace(0.0, 1.0, len(one.sizes) + 1)
                each = replace(each, force=each.force - np.interp(course[i], ends, (0.0, *one.sizes)))
            elif one.kind == "gain" and each.force is not None:
                each = replace(each, force=each.force / (1 + size))
            elif one.kind == "slip" and place[i] >= place[int(one.which)]:
                each = replace(each, x=each.x + size)
            elif one.kind == "late":
                each = moved(each, (one.which,), size)
            elif one.kind == "lag":
                each = _filtered(each, one.which, size, campaign.rate)
        samples.append(each)
    return replace(campaign, samples=tuple(samples))


def _filtered(samples: Samples, channel: str, constant: float, rate: float) -> Samples:
    """All other channels behind the filter that one has [s]; that one behind it where the constant is negative."""
    filtered = {name for name in CHANNELS if (name == channel) != (constant > 0)}

    def taken(name: str, values: Array) -> Array:
        return _behind(values, abs(constant) * rate) if name in filtered else values

    force = None if samples.force is None else taken("force", samples.force)
    return replace(samples, P=taken("pressure", samples.P), x=taken("displacement", samples.x), force=force)


def _behind(values: Array, constant: float) -> Array:
    """Samples behind a filter with a time constant in samples, gaps bridged."""
    known = np.isfinite(values)
    if constant < 1e-3 or not known.any():
        return values
    rows = np.arange(len(values))
    whole = values if known.all() else np.interp(rows, rows[known], values[known])
    return np.where(known, columns.lagged(whole, constant), np.nan)


def forces_of(
    followed: columns.Followed, segments: Segments, fit: Solved, explanations: Sequence[Explanation]
) -> Array:
    """What the muscle pulls beyond the straight form [N], shape (n,); `fit` is of the straight part."""
    mine = [one for one in explanations if one.of_muscle]
    forces = [_of_muscle(one, followed, segments, fit, mine) @ np.array(one.sizes) for one in mine]
    return np.asarray(np.sum(forces, axis=0)) if mine else np.zeros(len(segments))
