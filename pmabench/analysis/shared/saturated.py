"""Whether a measured channel ends at a ceiling that its cause passes: an amplifier or converter that saturates, a stop.

At a saturation the readings scatter about one level, which they reach with undiminished speed, while the cause moves
on. Motion that comes to rest by itself slows down before, where a ramp ends its cause ends too, and friction holds only
after the cause has turned back. So a plateau of a step, a regulator that holds, and a stage that stops are no ceilings.
A gauge behind a filter goes on after its cause has stopped: so the command must go on too or, where there is none, the
motion must be no slowing one.

What was beyond the ceiling is not known. So the reduction is repeated with these samples raised, and each value that
changes by it is withheld.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.changes import Change
from pmabench.analysis.shared.samples import LAG_KNOWN, lag_of, noise_of
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

EFFECTS = ("force", "torque", "displacement", "angle")
"""Channels that change with the pressure, unless they are driven."""
HUNG = {"load", "mass"}
"""Coordinates of the operating point of a muscle that moves freely with a weight."""
CAUSES = ("pressure", "pressure_1", "pressure_2")
NEAR = 1000
"""Number of samples before and after the highest one whose noise counts."""
COARSE = 0.01
"""Largest width of a step of a channel, as a share of its span, and largest share of it in which steps are sought."""
BAND = 8.0
"""Width of a ceiling, in standard deviations of the noise."""
ENOUGH = 32
"""Least number of samples of a trial."""
FEWEST, FULL = 8, 0.8
"""Least number of samples of a visit at a ceiling, and least share of those of its time."""
BELOW = (0.1, 0.05, 0.025, 0.0125)
"""Heights below the ceiling at which the speed is compared, as a share of the channel's span ..."""
CLEAR = 3.0
"""... if they are this many widths of the ceiling."""
UNSLOWED, SAMPLES = 0.8, 3.0
"""Least speed just below the ceiling, as a share of that before, and least number of samples for that."""
ONWARD, SLIGHTLY, FLAT = 0.04, 0.01, 4.0
"""Least expected motion beyond the ceiling, as a share of the channel's span, and least motion of its cause: the second
one for the way up where the channel is this many times longer at its ceiling than at its lowest.
"""
HALF, LAST = 0.4, 0.9
"""Share of the motion beyond the ceiling whose time is compared with that of as much again, which a filter makes twice
as long, and the end of that motion: noise counts least before.
"""
KINK = 2.0
"""Least change of speed within two samples at the begin of a ceiling, over the largest one elsewhere."""
SHOWN = 0.2
"""Least share of the trials that show the ceiling; fewer may contradict it."""
RAMP = 16
"""Fewest changes of a command that is no staircase: a step has ended when its pressure moves."""
MOVED, LAGS, IDLE, SLOWED = "moved", "lags", "idle", "slowed"
LIFTED = 0.2
"""What samples at the ceiling are raised by, as a share of the channel's span."""
KEPT = 1e-4
"""Relative change of a value that counts as none [1]."""


@dataclass(frozen=True)
class Ceiling(Change):
    """The change that raises by `lift` the samples of a channel within `width` of the highest one of a trial [SI].

    It leaves trials as they are that do not come near `level`. All of it is upside down where `lift` is below 0.
    """

    level: float = 0.0
    width: float = 0.0
    lift: float = 0.0

    def of(self, trial: TrialData) -> TrialData:
        """The trial with the samples at the ceiling raised, more and more, so that a loop within them changes too."""
        y = trial.channels.get(self.channel)
        if y is None:
            return trial
        raised = y + np.linspace(0.5, 1.5, len(y)) * self.lift * self.cut(trial)
        return replace(trial, channels={**trial.channels, self.channel: raised})

    def cut(self, trial: TrialData) -> NDArray[np.bool_]:
        """Samples of a trial with this channel that are at the ceiling, shape (n,)."""
        y = trial.channels[self.channel]
        up = np.copysign(1.0, self.lift) * y
        top = float(np.max(up, initial=-np.inf, where=trial.usable & np.isfinite(y)))
        return np.asarray((up > top - self.width) & (top > self.level))


def saturated(run: RunData, loop: bool = False) -> Iterator[Ceiling]:
    """The channels of a run that end at a ceiling, with its level.

    `loop`: a control holds a set-point, so that the motion itself shows whether it was cut off above it.
    """
    for name, sign in (*((name, 1) for name in (*EFFECTS, "pressure")), ("torque", -1)):
        trials = [trial for trial in run.trials if name in trial.channels and trial.status == "finished"]
        if name == "force":  # a weight is the most that a muscle pulls which lifts it
            trials = [trial for trial in trials if not HUNG & trial.point.keys()]
        every = (_course(run, trial, name, sign, loop) for trial in trials)
        courses = [course for course in every if len(course.y) >= ENOUGH]
        if courses and (found := _ceiling(run, name, sign, courses)):
            yield found


@dataclass(frozen=True, eq=False)
class _Cause:
    """Samples `z` of a channel that moves another one, `y`, and those of its command, `sent`, all of shape (n,).

    `sent` is None if it is not recorded or a staircase. `lag`: declared time constant of the sensor [s].
    """

    z: Array
    y: Array
    sent: Array | None = None
    lag: float = 0.0

    @cached_property
    def noise(self) -> float:
        return noise_of(self.z)

    @cached_property
    def way(self) -> float:
        """1 where the channel usually rises with its cause, -1 where it falls."""
        return float(np.sign((self.y - self.y.mean()) @ self.z))

    @cached_property
    def size(self) -> float:
        """Span of the cause, or its largest value if that is more: a regulated one hardly moves."""
        return float(max(np.ptp(self.z), np.abs(self.z).max()))

    def back(self) -> _Cause:
        """The cause with time turned round: a sensor's lag makes its motion before an end no longer."""
        return _Cause(self.z[::-1], self.y[::-1], None if self.sent is None else self.sent[::-1])

    def onward(self, t: Array, times: tuple[float, float], at: int, share: float, steady: bool) -> float:
        """Motion of the cause from sample `at` on, over that in the time before from `times` on [1]; 0 where it stops.

        Only motion in its usual way counts, and by `share` of its size at least. `steady`: only without slowing down,
        which a filter does, unless the command shows that it goes on.
        """
        begin, end = (self.way * float(value) for value in np.interp(times, t, self.z))
        after = self.way * self.z[at:] - end
        moves, whole = end - begin, float(np.max(after))
        further = whole - (1 + LAG_KNOWN) * self.lag * moves / (times[1] - times[0])
        if self.sent is not None:
            sent = self.way * self.sent
            further = min(further, float(np.max(sent[at:]) - np.interp(times[1], t, sent)))
        if not (moves > CLEAR * self.noise and further > max(BAND * self.noise, share * self.size)):
            return 0.0
        if steady and self.sent is None:
            parts = after[: int(np.argmax(after > LAST * whole))] / whole
            if UNSLOWED * np.count_nonzero((parts > HALF) & (parts < 2 * HALF)) > np.count_nonzero(parts <= HALF):
                return 0.0
        return (further - BAND / 2 * self.noise) / moves


@dataclass(frozen=True, eq=False)
class _Course:
    """Usable samples of a channel and its causes; of a cause that is known in several ways each must go on."""

    t: Array
    y: Array
    causes: Sequence[Sequence[_Cause]]
    loop: bool
    turned: bool = False

    def back(self) -> _Course:
        """The course with time turned round."""
        causes = [[one.back() for one in alike] for alike in self.causes]
        return replace(self, t=-self.t[::-1], y=self.y[::-1], causes=causes, turned=True)


def _course(run: RunData, trial: TrialData, name: str, sign: int, loop: bool) -> _Course:
    """The samples of a channel in a trial, times `sign`, with those of its causes; in a loop time is the cause."""
    y = trial.channels[name]
    usable = trial.usable & np.isfinite(y)
    good = slice(None) if usable.all() else usable  # without a copy: the courses of all trials are compared
    sent = f"{name}_command"
    causes: list[tuple[str, ...]]
    if name == "pressure":
        causes = [(sent, effect) for effect in EFFECTS]
    elif sent in trial.channels or any(command.output == name for command in trial.commands):
        causes = [(sent,)]
    else:
        driven = [one for one in ("displacement", "angle") if one != name]
        pressures = CAUSES if "pressure" in trial.channels else (*CAUSES, "pressure_command")
        causes = [(cause,) for cause in (*pressures, *(driven if name in ("force", "torque") else ()))]
    known = [alike for alike in causes if all(one in trial.channels for one in alike)]
    y = y[good] if sign > 0 else -y[good]

    def cause(one: str) -> _Cause:
        z, sent = trial.channels[one][good], trial.channels.get(f"{one}_command")
        ramps = sent is not None and np.count_nonzero(np.diff(sent[good])) >= RAMP
        return _Cause(z, y, sent[good] if sent is not None and ramps else None, lag_of(run, one))

    return _Course(trial.t[good], y, [[cause(one) for one in alike] for alike in known], loop)


def _ceiling(run: RunData, name: str, sign: int, courses: Sequence[_Course]) -> Ceiling | None:
    highest = max(courses, key=lambda course: float(course.y.max())).y
    at, top = int(highest.argmax()), float(highest.max())
    span = top - min(float(course.y.min()) for course in courses)
    near = highest[max(0, at - NEAR) : at + NEAR]
    steps = np.abs(np.diff(near[near > top - COARSE * span]))
    width = max(BAND * noise_of(near), 2 * float(steps[steps > 0].min(initial=COARSE * span)))
    level = top - width - COARSE * span
    tops = [(float(course.y.max()), course) for course in courses if course.causes or course.loop]
    seen = [_Level(own - width, width, span).cuts(course) for own, course in tops if own > level]
    if seen.count(True) <= max(seen.count(False), SHOWN * len(seen)):
        return None
    known, middle = run.channels.get(name), sign * (top - 0.5 * width)
    line = f"saturation of the {name}{' below 0' if sign < 0 else ''}"
    text = (
        f"{run.id}: saturation: the {name} does not pass {show(middle, known.quantity, 4) if known else middle}, which "
        "it reaches at full speed while its cause goes on: an amplifier or converter at its end, or a stop. What rests "
        "on these samples is withheld. Choose a wider range, and measure again"
    )
    return Ceiling(name, 1.0, 0.0, 0.0, text, line, KEPT, level, width, sign * LIFTED * span)


@dataclass(frozen=True)
class _Level:
    """A possible ceiling: its lower edge, its width, and the span of its channel [as the channel]."""

    level: float
    width: float
    span: float

    def cuts(self, course: _Course) -> bool | None:
        """Whether a course was cut off there; None where its motions to it speak neither for it nor against it."""
        heights = [share * self.span for share in BELOW if share * self.span >= CLEAR * self.width]
        visits = list(self._visits(course.y, heights[-1])) if heights else []
        if course.loop:
            return any(self._kinks(course.y, *visit) for visit in visits) or None
        back, last_row, y = course.back(), len(course.y) - 1, course.y
        flat = FLAT * np.count_nonzero(y < y.min() + self.width) > np.count_nonzero(y > self.level)
        judged = []
        for first, last in visits:
            begin = self._end(course, first, heights, ONWARD if flat else SLIGHTLY)
            end = self._end(back, last_row - last, heights, ONWARD)
            known = [one for one in (begin, end) if one]
            unknown = IDLE in known or set(known) <= {LAGS}
            judged.append(None if unknown else SLOWED not in known)
        counts = judged.count(True), judged.count(False)
        return counts[0] > counts[1] if any(counts) else None

    def _visits(self, y: Array, below: float) -> Iterator[tuple[int, int]]:
        """First and last sample of each visit at the ceiling, between samples that are `below` its edge."""
        rows = np.flatnonzero((y > self.level) | (y < self.level - below))
        high = y[rows] > self.level
        edges = np.flatnonzero(np.diff(np.concatenate([[False], high, [False]]).astype(np.int8)))
        for begin, end in edges.reshape(-1, 2).tolist():
            first, last = int(rows[begin]), int(rows[end - 1])
            if end - begin >= max(FEWEST, FULL * (last - first)):
                yield first, last

    def _kinks(self, y: Array, first: int, last: int) -> bool:
        """Whether a motion stops within two samples, as sharply as at no other time since, and comes back later."""
        since = max(0, first - (last - first) // 2)
        bends = np.abs(y[since + 3 :] - y[since + 2 : -1] - y[since + 1 : -2] + y[since:-3])
        ends = [slice(max(0, end - since - 4), end - since + 2) for end in (first, last)]
        sharp = float(np.max(bends[ends[0]], initial=0.0))
        for end in ends:
            bends[end] = 0.0
        usual = float(np.max(bends, initial=self.width / 2))
        return bool(sharp > KINK * usual and np.any(y[last:] < self.level - self.width))

    def _end(self, course: _Course, at: int, heights: Sequence[float], share: float) -> str:
        """How a motion comes to the ceiling at sample `at`: `SLOWED`, unslowed with a cause that stops too (`IDLE`),
        goes on (`MOVED`) or goes on as behind a filter (`LAGS`); empty where that is unknown.

        `share` of the motion of the cause is the least by which that goes on.
        """
        found = {self._from(course, at, below, share) for below in heights}
        return next((one for one in (MOVED, LAGS, IDLE, SLOWED) if one in found), "")

    def _from(self, course: _Course, at: int, below: float, share: float) -> str:
        t, y, times = course.t, course.y, []
        for level in (self.level - 2 * below, self.level - below):
            under = np.flatnonzero(y[:at] < level)
            if not len(under):
                return ""
            k = int(under[-1])
            times.append(float(t[k] + (level - y[k]) / (y[k + 1] - y[k]) * (t[k + 1] - t[k])))
        begin, middle, end = *times, float(t[at - 1])
        if middle - begin < SAMPLES * (t[at] - end):
            return ""
        if UNSLOWED * (end - middle) > middle - begin:
            return SLOWED
        for found, steady in ((MOVED, not course.turned), (LAGS, False)):
            causes = [[one.onward(t, (begin, end), at, share, steady) for one in alike] for alike in course.causes]
            further = max((min(alike) for alike in causes), default=0.0)
            if 2 * below * further > ONWARD * self.span + self.width:
                return found
        return IDLE
