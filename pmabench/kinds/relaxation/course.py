"""One trial of relaxation: its force at the nominal pressure, and what else may have changed it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import log10
from typing import Any

import numpy as np

from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.samples import NotUsable, noise_of, refuse_unusable, settings_of
from pmabench.base.quantities import show
from pmabench.kinds.relaxation.relaxing import TIMES, Relaxing
from pmabench.kinds.relaxation.vented import CALM, UNLIKE, ZERO_SEEN, Vented, left_by
from pmabench.store.records import Array, Command, RunData, TrialData

FEWEST_DECADES = 1.0
"""Decades of time that a slope needs."""
MOST_POINTS = 8000
"""Most time steps in which a hold is averaged."""
SEEN = 2.0
"""Half widths from which on a bend over log t is significant."""
AWAY, CLOSEST, UNKNOWN_LENGTH = 0.2, 0.05, 0.1
"""Contraction at which a muscle has no force left, and least distance to it, as shares of its length; the length where
that is not known [m].
"""
UNPROPORTIONAL = 3.0
"""Bound for the force growing faster than in proportion to the pressure: reached by a muscle at a quarter of its force
without contraction.
"""
BEND, BEFORE, JUMP = "bend over log t", "holds before", "jump of the force"
ZERO, OFFSET = "zero of the force", "force before the step"


@dataclass(frozen=True)
class Bend:
    """Difference between slopes of parts of a hold, per decade [1], and whether it is significant."""

    size: float
    seen: bool


@dataclass(frozen=True, eq=False)
class Course:
    """The force of one trial from `begin` on, at the nominal pressure."""

    trial: TrialData
    relaxing: Relaxing
    raw: Relaxing
    """The same without division by the measured pressure."""
    zero: float
    """Change of the force without pressure over the trial, or to its vent, without the muscle's own recovery [N]."""
    noise: float
    """Noise of the force's mean before the step [N]."""
    rise: float
    """Time until the pressure is reached [s]."""
    off: float
    """Relative deviation of the mean pressure from that of the step [1]."""
    before: tuple[tuple[float, float, float], ...]
    """Earlier holds of the run: pressure relative to this one [1], start and end as times before this step [s]."""
    unsure: float = 0.0
    """Uncertainty of `zero` where a recovery is taken off [N]."""
    recovered: float = 0.0
    """Part of the change of the force without pressure that the muscle's own recovery explains [N]."""
    offset: float = 0.0
    """Force before the step, without pressure, beyond what is declared for the cell and earlier holds left [N]."""
    yields: Relaxing | None = None
    """The displacement, in force: divided by the way on which a muscle loses its force [as `relaxing`]."""
    drifted: float = 0.0
    """Change of the force without pressure since the start of the run [N], if it went on as within this trial."""

    @property
    def start(self) -> float:
        """Force F_1 of the line at 1 s [N]."""
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
        """Largest difference between slopes of parts of the decades: early and late half, middle third and outer
        thirds.
        """
        one = self.relaxing
        outer = 0.5 * (one.slope_weights(0.0, 1 / 3) + one.slope_weights(2 / 3, 1.0))
        early, late, middle = (one.slope_weights(a, b) for a, b in ((0.0, 0.5), (0.5, 1.0), (1 / 3, 2 / 3)))
        found, cubic = [], one.residual(3)
        for weights in (late - early, middle - outer):
            size = abs(float(weights @ one.y))
            found.append(Bend(size / abs(self.start), size > SEEN * one.half(weights, cubic)))
        return max(found, key=lambda bend: (bend.seen, bend.size))

    @property
    def left_behind(self) -> float:
        """Effect of earlier holds on the force at 1 s [N], if they relax up to `UNLIKE` times as much as this one."""
        return UNLIKE * abs(float(left_by(self.before, np.ones(1), self.relaxing.by_line)[0]))

    def doubts_of_start(self) -> list[Doubt]:
        """Effects on F_1 [N]: the line is read at 1 s, away from the middle of the decades that give its slope."""
        one, away = self.relaxing, abs(self.start * float(self.relaxing.decades.mean()))
        bend = self.bend
        # if parts differ, the slope before the first of them is unknown
        off = max(abs(one.bent), away * bend.size if bend.seen else 0.0)
        reason = (
            f"parts of the hold relax by {bend.size:.2%} per decade unlike each other: the line may be "
            f"{show(off, 'force', 2)} off at 1 s. Begin earlier"
        )
        # the effect of earlier holds at 1 s is known better from `left_behind`
        others = [d for d in self.doubts() if d.name not in {BEND, BEFORE, ZERO, OFFSET, JUMP}]
        text = f"without pressure the cell may read {self.drifted:+.3g} N more than at first: zero it, and look "
        return [
            Doubt(BEND, "method", off, bend.seen, reason),
            Doubt(ZERO, "drift", abs(self.drifted), self.drifts, f"{text}for what warms it"),
            Doubt(OFFSET, "method", abs(self.offset), bool(self.offset), self.of_offset),
            *(Doubt(d.name, d.part, away * d.half, d.seen) for d in others),
        ]

    @property
    def drifts(self) -> bool:
        """Whether the force without pressure changes by more than its noise, and than recoveries of muscles differ."""
        return abs(self.zero) > max(ZERO_SEEN * self.noise, (UNLIKE - 1) * abs(self.recovered), 2 * self.unsure)

    def doubts(self) -> list[Doubt]:
        """Effects of other causes than the rubber on s [1]."""
        bend = self.bend
        bent = (
            f"parts of the hold relax by {bend.size:.2%} per decade unlike each other: this is no straight line over "
            "log t. Hold longer, or take the exponentials"
        )
        of_all = self.doubts_of(-self.relaxing.slope_weights(), self.per_decade, "s", " per decade")
        return [Doubt(BEND, "method", abs(bend.size / 2), bend.seen, bent), *of_all]

    def doubts_of_share(self, term: int) -> list[Doubt]:
        """Effects on the share of the exponential `term` of `prony` [1]; F_1, of which it is a share, is the line's."""
        sizes, weights, _ = self.relaxing.prony
        share = float(sizes[term]) / self.start
        bend = next(d for d in self.doubts_of_start() if d.name == BEND)
        of_start = Doubt(BEND, "method", abs(share * bend.half / self.start), seen=False)
        return [of_start, *self.doubts_of(weights[term], share, "this share")]

    def doubts_of(self, weights: Array, share: float, name: str, per: str = "") -> list[Doubt]:
        """Effects of other causes than the rubber on a `share` [1], the sum of `weights` (n,) and the force over F_1.

        `name` and `per` are for the reasons.
        """
        one, F, s = self.relaxing, self.start, abs(self.per_decade)
        courses = [one.t, *(1 - np.exp(-one.t / T) for T in TIMES)]  # of a drift that nobody saw
        ends = max(abs(float(weights @ course) / course[-1]) for course in courses) * (abs(self.zero) + self.unsure) / F
        left = UNLIKE * float(weights @ left_by(self.before, one.t, one.by_line)) / F
        other = float(weights @ self.raw.y) / self.raw.line[0] - float(weights @ one.y) / F
        moment = float(weights @ np.log10((one.t + self.rise / 2) / one.t))
        zero = (
            f"without pressure the cell reads {self.zero:+.3g} N after the hold, against before: zero the cell, and "
            "look for what warms it"
        )
        before = f"what the holds before left behind changes {name} by about {abs(left):.2%}{per}: rest longer"
        pressure = f"the pressure changes along the hold: without it {name} would be {other:+.2%}{per} other"
        return [
            Doubt(ZERO, "drift", abs(ends), self.drifts, zero),
            Doubt(OFFSET, "method", abs(share * self.offset / F), bool(self.offset), self.of_offset),
            Doubt(BEFORE, "drift", abs(left), bool(self.before), before),
            Doubt("pressure", "method", UNPROPORTIONAL * abs(other), False, f"{pressure}. Look at the regulator"),
            Doubt("moment of the step", "method", abs(s * moment), False),
            self._yielding(weights),
            Doubt(JUMP, "drift", abs(float(weights @ self.jumped.y) / F), bool(one.jump[0]), self.of_jump),
        ]

    def _yielding(self, weights: Array) -> Doubt:
        """Effect of a displacement that changes along the hold; none where it is within its noise."""
        if self.yields is None:
            return Doubt("displacement", "method", 0.0, False)
        half = abs(float(weights @ self.yields.y))
        seen = half > SEEN * self.yields.half(weights)
        reason = (
            f"the displacement changes along the hold, which may be worth {half / abs(self.start):.2%}: what holds the "
            "muscle gives way, or the sensor drifts. Clamp it"
        )
        return Doubt("displacement", "method", half / abs(self.start) if seen else 0.0, seen, reason)

    @property
    def of_offset(self) -> str:
        """The sentence about the force before the step."""
        return (
            f"before the step the cell reads {self.offset:+.3g} N without pressure, which is not declared: its zero is "
            "off, or the muscle is stretched. Zero the cell"
        )

    @property
    def jumped(self) -> Relaxing:
        """What the jump adds to the force [N]."""
        size, since = self.relaxing.jump
        return replace(self.relaxing, y=np.where(self.relaxing.t >= since, size, 0.0))

    @property
    def of_jump(self) -> str:
        """The sentence about the jump of the force; empty without one."""
        size, since = self.relaxing.jump
        if not size:
            return ""
        return (
            f"{since:.0f} s after the step of trial {self.trial.number} the force jumps by {size / self.start:+.1%}, "
            "not with the pressure: the gain of the cell or of the gauge changed, or a mount slipped. Whether trials "
            "before or after it are right is not known. Look for the cause, and measure again"
        )


def measure(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Course:
    """Evaluation of one trial; `NotUsable` where it ended early, lacks a channel, or has too few decades."""
    refuse_unusable(trial, "pressure", "force")
    step, end = _step(trial)
    if end >= trial.t[-1]:
        raise NotUsable(
            f"it ends under pressure: without {CALM:g} s after the vent a drift of the cell looks like relaxation"
        )
    begin = float(settings_of(run, options).get("begin", 5.0))
    t, F, P = (values[trial.usable] for values in (trial.t, trial.channels["force"], trial.channels["pressure"]))
    calm, held = (t >= step.t - CALM) & (t < step.t), (t > step.t) & (t < end)
    if min(calm.sum(), (t > t[-1] - CALM).sum(), held.sum()) < 8:
        raise NotUsable("fewer than 8 samples before the step, in the hold or after it")
    final, base = float(np.median(P[held])), float(P[calm].mean())
    risen = (P - base) / (final - base) if abs(final - base) > 0 else np.zeros(len(P))
    if not (risen[held] > 0.95).any() or final <= 0:
        raise NotUsable("the pressure does not follow the step")
    half_way, there = (float(t[held][np.argmax(risen[held] > share)]) for share in (0.5, 0.95))
    since = t - half_way
    rows = held & (since >= begin)
    decades = log10((end - half_way) / begin) if 0 < begin < end - half_way else 0.0
    if decades < FEWEST_DECADES:
        raise NotUsable(
            f"the hold has {decades:.1f} decades of time from {begin:g} s on, {FEWEST_DECADES:g} are needed: hold for "
            f"{begin * 10**FEWEST_DECADES:.0f} s or more"
        )
    x = trial.channels.get("displacement", np.full(len(trial.t), np.nan))[trial.usable][rows]
    even, divided, plain, way = _even(since[rows], F[rows] * step.value / P[rows], F[rows], x)
    if np.mean(divided) <= 6 * noise_of(F[calm]):
        raise NotUsable("the force is not above its noise: the muscle is slack at this contraction and pressure")
    course = Course(
        trial=trial,
        relaxing=Relaxing(even, divided),
        raw=Relaxing(even, plain),
        zero=0.0,
        noise=noise_of(F[calm]) / float(np.sqrt(calm.sum())),
        rise=there - step.t,
        off=abs(float(P[rows].mean()) / step.value - 1),
        before=_earlier(run, trial, step),
        yields=Relaxing(even, float(np.mean(divided)) * way / _loses_on(run, way)) if np.isfinite(way).all() else None,
    )
    holds, one = (*course.before, (1.0, 0.0, step.t - end)), course.relaxing
    forms = [(one.by_line, True), *([(one.by_exponentials, False)] if course.bend.seen else [])]
    found = min((Vented(t - step.t, F, risen, holds, *form) for form in forms), key=lambda each: abs(each.end))
    info = run.channels.get("force")
    declared = info.offset_uncertainty if info else 0.0
    passed = max(1.0, float((t[-1] - min(other.t[0] for other in run.trials if len(other.t))) / (t[-1] - t[0])))
    return replace(
        course,
        zero=found.zero,
        recovered=found.recovered,
        unsure=found.unsure,
        drifted=found.zero * passed,
        offset=found.offset if abs(found.offset) > declared + ZERO_SEEN * course.noise else 0.0,
    )


def _loses_on(run: RunData, contraction: Array) -> float:
    """Way on which a muscle at a contraction [m] loses its force [m]."""
    specimen = run.manifest.get("specimen")
    known = specimen.get("nominal_length") if isinstance(specimen, Mapping) else None
    length = float(known) if isinstance(known, int | float) and known > 0 else UNKNOWN_LENGTH
    return max(AWAY * length - abs(float(contraction.mean())), CLOSEST * length)


def _step(trial: TrialData) -> tuple[Command, float]:
    """The command of the step, and the end of its hold, when the next pressure command comes [s]."""
    commands = [c for c in trial.commands if c.output == "pressure"]
    for i, command in enumerate(commands):
        if command.phase == "step":
            return command, commands[i + 1].t if i + 1 < len(commands) else float(trial.t[-1])
    raise NotUsable("it holds no step of pressure")


def _earlier(run: RunData, trial: TrialData, step: Command) -> tuple[tuple[float, float, float], ...]:
    """Earlier holds of the run, from their commands; see `Course.before`."""
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
    """Times and values as means over equal time steps; raises `NotUsable` if one is empty."""
    gap = 1.5 * float(np.max(np.diff(t)))
    count = max(8, min(MOST_POINTS, int((t[-1] - t[0]) / gap)))
    place = np.minimum(((t - t[0]) / (t[-1] - t[0]) * count).astype(int), count - 1)
    number = np.bincount(place, minlength=count)
    if (number == 0).any():
        raise NotUsable("there are gaps in the hold")
    return [np.bincount(place, column, count) / number for column in (t, *values)]
