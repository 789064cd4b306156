"""One trial of relaxation: the force after the step with the measured pressure divided out; knows no campaign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import log10
from typing import Any

import numpy as np

from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.samples import UNUSABLE_SHARE, NotUsable, noise_of
from pmabench.kinds.relaxation.fit import Relaxing, decades_of
from pmabench.store.records import Array, Command, RunData, TrialData

FEWEST_DECADES = 1.0
"""Decades of time that a slope needs."""
MOST_POINTS = 8000
"""Equal steps of time that a hold is averaged in."""
SEEN = 2.0
"""Half widths from which on a bend over log t is seen."""
CALM = 2.0
"""Time before the step and at the end of the trial whose mean is the zero of the force [s]."""
UNLIKE = 1.5
"""So many times what this hold shows may an earlier one have relaxed."""
BEND = "bend over log t"


@dataclass(frozen=True)
class Bend:
    """Difference between slopes of parts of a hold, per decade [1], and whether it is more than noise."""

    size: float
    seen: bool


@dataclass(frozen=True, eq=False)
class Course:
    """The force of one trial relative to its line at 1 s, from `begin` on."""

    relaxing: Relaxing
    raw: Relaxing
    """Without the pressure divided out."""
    zero: float
    """Change of the force without pressure over the trial [N]."""
    noise: float
    """Of its mean before the step [N]."""
    rise: float
    """Time that the pressure takes to get there [s]."""
    off: float
    """How far the mean pressure is from that of the step, as a share of it [1]."""
    before: tuple[tuple[float, float, float], ...]
    """Holds before this one in the run: pressure over that of this one [1], begin and end before this step [s]."""

    @property
    def start(self) -> float:
        """F_1 [N]."""
        return self.relaxing.line[0]

    @cached_property
    def per_decade(self) -> float:
        """Share s of F_1 that is lost in each decade [1]."""
        start, slope = self.relaxing.line
        return -slope / start

    @cached_property
    def half(self) -> float:
        """Half width of s from the noise [1]."""
        return self.relaxing.half(self.relaxing.slope_weights()) / abs(self.start)

    @cached_property
    def bend(self) -> Bend:
        """How far the slopes of parts of the decades differ: late and early half, middle third and the outer two."""
        one, found = self.relaxing, []
        outer = 0.5 * (one.slope_weights(0.0, 1 / 3) + one.slope_weights(2 / 3, 1.0))
        early, late, middle = (one.slope_weights(a, b) for a, b in ((0.0, 0.5), (0.5, 1.0), (1 / 3, 2 / 3)))
        for weights in (late - early, middle - outer):
            size, half = abs(float(weights @ one.y)), one.half(weights, order=3)
            found.append(Bend(size / abs(self.start), size > SEEN * half))
        return max(found, key=lambda bend: (bend.seen, bend.size))

    @property
    def left_behind(self) -> float:
        """What the holds before this one make of the force at 1 s [N], if they relaxed alike or half as much again."""
        return UNLIKE * abs(self.start * self.per_decade * sum(P * log10((1 + a) / (1 + b)) for P, a, b in self.before))

    def doubts(self) -> list[Doubt]:
        """What else than the rubber may make of s [1]."""
        one, F, s = self.relaxing, self.start, abs(self.per_decade)
        weights = one.slope_weights()
        found = []

        def add(name: str, half: float, reason: str, *, seen: bool, part: str = "method") -> None:
            found.append(Doubt(name, part, abs(half), seen, reason))

        bend = self.bend
        text = (
            f"parts of the hold relax by {bend.size:.2%} per decade unlike each other: this is no straight line over "
        )
        add(BEND, bend.size / 2, f"{text}log t. Hold longer, or take the exponentials", seen=bend.seen)
        ends = float(weights @ (self.zero * one.t / one.t[-1])) / F
        text = (
            f"without pressure the cell reads {self.zero:+.3g} N after the trial, against before: zero the cell, and "
        )
        add(
            "zero of the force",
            ends,
            f"{text}look for what warms it",
            seen=abs(self.zero) > 6 * self.noise,
            part="drift",
        )
        left = UNLIKE * sum(
            P * float(weights @ np.log10((one.t + begin) / (one.t + end))) for P, begin, end in self.before
        )
        text = f"what the holds before left behind changes s by about {abs(s * left):.2%} per decade: rest longer"
        add("holds before", s * left, text, seen=bool(self.before), part="drift")
        start, slope = self.raw.line
        other = -slope / start - self.per_decade
        text = f"the pressure changes along the hold: without it s would be {other:+.2%} per decade other"
        add("pressure", other / 2, f"{text}. Look at the regulator", seen=False)
        moment = float(weights @ np.log10((one.t + self.rise / 2) / one.t))
        add("moment of the step", s * moment, "", seen=False)
        return found


def measure(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Course:
    """One trial from its samples; `NotUsable` where it ended early, lacks a channel, or holds too few decades."""
    if trial.status != "finished":
        raise NotUsable(f"the trial is {trial.status}")
    missing = [name for name in ("pressure", "force") if name not in trial.channels]
    if missing:
        raise NotUsable(f"{' and '.join(missing)} not recorded")
    if float(np.mean(~trial.usable)) > UNUSABLE_SHARE:
        raise NotUsable(f"{np.mean(~trial.usable):.0%} of the samples are flagged")
    step, end = _step(trial)
    begin = float({**(run.plan.get("settings") or {}), **options}.get("begin", 5.0))
    t, F, P = (values[trial.usable] for values in (trial.t, trial.channels["force"], trial.channels["pressure"]))
    calm, last = (t >= step.t - CALM) & (t < step.t), t > t[-1] - CALM
    held = (t > step.t) & (t < end)
    if min(calm.sum(), last.sum(), held.sum()) < 8:
        raise NotUsable("fewer than 8 samples before the step, in the hold or after it")
    final, base = float(np.median(P[held])), float(P[calm].mean())
    risen = (P[held] - base) / (final - base) if abs(final - base) > 0 else np.zeros(held.sum())
    if not (risen > 0.95).any() or final <= 0:
        raise NotUsable("the pressure does not follow the step")
    half_way, there = (float(t[held][np.argmax(risen > share)]) for share in (0.5, 0.95))
    since = t - half_way
    rows = held & (since >= begin)
    decades = decades_of(begin, end - half_way)
    if decades < FEWEST_DECADES:
        raise NotUsable(
            f"the hold has {decades:.1f} decades of time from {begin:g} s on, {FEWEST_DECADES:g} are needed: hold for "
            f"{begin * 10**FEWEST_DECADES:.0f} s or more"
        )
    even, divided, plain = _even(since[rows], F[rows] * step.value / P[rows], F[rows])
    if np.mean(divided) <= 6 * noise_of(F[calm]):
        raise NotUsable("the force is not above its noise: the muscle is slack at this contraction and pressure")
    return Course(
        relaxing=Relaxing(even, divided),
        raw=Relaxing(even, plain),
        zero=float(F[last].mean() - F[calm].mean()),
        noise=noise_of(F[calm]) / float(np.sqrt(calm.sum())),
        rise=there - step.t,
        off=abs(float(P[rows].mean()) / step.value - 1),
        before=_earlier(run, trial, step),
    )


def _step(trial: TrialData) -> tuple[Command, float]:
    """The command of the step, and when the next one to the pressure ends its hold [s]."""
    commands = [c for c in trial.commands if c.output == "pressure"]
    for i, command in enumerate(commands):
        if command.phase == "step":
            return command, commands[i + 1].t if i + 1 < len(commands) else float(trial.t[-1])
    raise NotUsable("it holds no step of pressure")


def _earlier(run: RunData, trial: TrialData, step: Command) -> tuple[tuple[float, float, float], ...]:
    """Holds of the run before this one, by their commands."""
    found = []
    for other in run.trials:
        if other.t.size and other.t[0] < trial.t[0]:
            try:
                begin, end = _step(other)
            except NotUsable:
                continue
            found.append((begin.value / step.value, step.t - begin.t, step.t - end))
    return tuple(found)


def _even(t: Array, *values: Array) -> list[Array]:
    """Times and values as means over equal steps of time, none of them empty."""
    gap = 1.5 * float(np.max(np.diff(t)))
    count = max(8, min(MOST_POINTS, int((t[-1] - t[0]) / gap)))
    place = np.minimum(((t - t[0]) / (t[-1] - t[0]) * count).astype(int), count - 1)
    number = np.bincount(place, minlength=count)
    if (number == 0).any():
        raise NotUsable("there are gaps in the hold")
    return [np.bincount(place, column, count) / number for column in (t, *values)]
