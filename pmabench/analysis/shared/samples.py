"""Samples of one trial: noise, quantisation and lag of channels, onset of motion, change still to come at rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.store.analyses.results import Analysis, Finding
from pmabench.store.records import Array, Command, RunData, TrialData

UNUSABLE_SHARE = 0.02
"""Share of flagged samples above which a trial is not used."""


class NotUsable(Exception):
    """Raised with the reason where a trial cannot be measured."""


def refuse_incomplete(trial: TrialData, *channels: str) -> None:
    """Raise `NotUsable` for a trial that ended early or lacks one of `channels`."""
    if trial.status != "finished":
        raise NotUsable(f"the trial is {trial.status}")
    refuse_missing(trial, *channels)


def refuse_missing(trial: TrialData, *channels: str) -> None:
    """Raise `NotUsable` for a trial that lacks one of `channels`."""
    if missing := [name for name in channels if name not in trial.channels]:
        raise NotUsable(f"{' and '.join(missing)} not recorded")


def refuse_flagged(usable: NDArray[np.bool_]) -> None:
    """Raise `NotUsable` where more than `UNUSABLE_SHARE` of the samples are not `usable`."""
    if (bad := float(np.mean(~usable))) > UNUSABLE_SHARE:
        raise NotUsable(f"{bad:.0%} of the samples are flagged")


def refuse_unusable(trial: TrialData, *channels: str) -> None:
    """Raise `NotUsable` for a trial that ended early, lacks one of `channels` or has too many flagged samples."""
    refuse_incomplete(trial, *channels)
    refuse_flagged(trial.usable)


def settings_of(run: RunData, options: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Settings of the plan for the reduction, overridden by `options`."""
    return {**(run.plan.get("settings") or {}), **(options or {})}


def ends(ramp: Command) -> float:
    """End of a commanded ramp [s]; it needs a rate above 0."""
    return ramp.t + abs(ramp.value - ramp.before) / ramp.data["rate"]


@dataclass(frozen=True)
class Samples:
    """Successive samples of one trial: arrays of shape (n,), SI.

    `force` is the measured F_L, None without a load cell; `load` [N] is what hangs there, `mass` [kg] moves with it.
    """

    trial: int
    t: Array
    P: Array
    x: Array
    force: Array | None
    ok: NDArray[np.bool_]
    load: float
    mass: float

    @property
    def channels(self) -> dict[str, Array]:
        """Recorded channels and their samples [SI]."""
        found = {"pressure": self.P, "displacement": self.x}
        return found if self.force is None else {**found, "force": self.force}

    def having(self, channels: Mapping[str, Array]) -> Samples:
        """A copy with other samples of the given channels."""
        P, x = channels.get("pressure", self.P), channels.get("displacement", self.x)
        return replace(self, P=P, x=x, force=channels.get("force", self.force))


@dataclass(frozen=True)
class Noise:
    """Standard deviation of the white noise of each channel [SI]."""

    pressure: float = 0.0
    displacement: float = 0.0
    force: float = 0.0


def noise_of(y: Array) -> float:
    """Standard deviation of the white noise on `y`, shape (n,), from third differences; 0 with fewer than 8 samples.

    The third difference of white noise has 20 times its variance.
    """
    if len(y) < 8:
        return 0.0
    for _ in range(3):
        y = y[1:] - y[:-1]
    third, half = np.abs(y), len(y) // 2  # `np.diff` and `np.median` take three times as long
    third.partition((half - 1, half, -1))  # NaN comes last
    middle = third[half] if len(y) % 2 else (third[half - 1] + third[half]) / 2
    return float((middle + 0.0 * third[-1]) / 0.6745 or np.sqrt(np.mean(third**2))) / sqrt(20.0)


def autocorrelation(y: Array, most: int) -> Array:
    """Sums of y(k) y(k + lag), y of shape (n,), for lags from 0 to `most` samples, shape (most + 1,); by FFT."""
    size = 2 ** int(np.ceil(np.log2(2 * len(y))))
    return np.asarray(np.fft.irfft(np.abs(np.fft.rfft(y, size)) ** 2, size)[: most + 1])


LAG_KNOWN = 0.2
"""Relative uncertainty of a declared sensor time constant: data sheets give typical values with one digit."""
UNDECLARED = 5e-3
"""Assumed largest time constant of a sensor whose channel declares no `sensor_lag` [s]."""

STEPS = "steps of the channels"
OF_TWO = 1.55
"""95 % error of the difference of two quantised means over that of one (`unresolved`)."""
PLACES = 8
FINE = 1e-3
"""Steps up to this share of a swing are neglected."""


def lag_of(run: RunData, channel: str) -> float:
    """Declared time constant of a channel's sensor [s]; 0 where none is declared."""
    info = run.channels.get(channel)
    return 0.0 if info is None else info.sensor_lag


def lags_of(run: RunData, trial: TrialData) -> dict[str, float]:
    """Channel of the trial -> declared time constant of its sensor [s]; 0 where none is declared."""
    return {name: lag_of(run, name) for name in trial.channels}


def lag_open(run: RunData, channel: str) -> float:
    """Uncertainty of a sensor's declared time constant [s], or its largest value where none is declared."""
    lag = lag_of(run, channel)
    return LAG_KNOWN * lag if lag > 0 else UNDECLARED


def count_of(run: RunData, trial: TrialData, channel: str) -> float:
    """One count of a channel that is recorded in counts, else its quantisation step in the trial [SI]; 0 for none."""
    info = run.channels.get(channel)
    if info is not None and info.unit in ("count", "counts"):
        return abs(info.slope)
    step = step_of(trial.channels[channel][trial.usable])
    return step if step < np.inf else 0.0


EVEN, MOSTLY = 0.1, 0.8
"""Changes equal within the first share of a step; a ramp without noise has more than the second share of these."""


def step_of(y: Array) -> float:
    """Quantisation step of samples (n,) in order of time [as y]; inf where all are equal.

    0 where they are not multiples of a step, or are so only because they form a ramp without noise.
    """
    apart = np.diff(np.unique(y))
    apart = apart[apart > 1e-9 * float(apart.sum())]
    least = float(apart.min(initial=np.inf))
    if np.any(np.abs(apart / least - np.round(apart / least)) >= 0.05):
        return 0.0
    moves = np.diff(y)
    again = np.abs(np.diff(moves))[np.abs(moves[:-1]) > EVEN * least] < EVEN * least
    return 0.0 if len(again) and np.mean(again) > MOSTLY else least


FEWEST_NEW, FEWEST_JUMPS = 12, 5
"""Fewest new values of a channel that counts as held, and fewest changes by more than two quantisation steps."""
HELD, RARELY, AGAIN = 0.3, 0.05, 1.85
"""A held channel has new values sooner than the first share of its usual interval, or twice in a row, in at most the
second share of cases; after the third multiple of the interval it was read again with the same value."""


def fresh(y: Array) -> NDArray[np.bool_]:
    """Mask of new samples, shape (n,), of a channel that may be read less often than it is recorded; all if it is not.

    Such a channel holds its value for about the same number of samples. A slow quantised channel holds values too, but
    changes with every sample while it moves by several steps. A value held for longer was read again.
    """
    new, every = np.append(True, y[1:] != y[:-1]), np.ones(len(y), dtype=bool)
    if 3 * np.count_nonzero(new) > 2 * len(y) + 3:
        return every
    at = np.flatnonzero(new)[1:]
    runs, jumps = np.diff(at), np.abs(y[at] - y[at - 1])[1:] > 2 * step_of(y)
    if len(runs) < FEWEST_NEW or np.count_nonzero(jumps) < FEWEST_JUMPS:
        return every
    usual = float(np.median(runs[jumps]))
    if usual <= 1 or max(np.mean(runs < 2), np.mean(runs[jumps] < HELD * usual)) > RARELY:
        return every
    begins = np.flatnonzero(new)
    for begin, size in zip(begins, np.diff(np.append(begins, len(y))), strict=True):
        if size > AGAIN * usual:
            new[begin + np.arange(round(size / usual)) * size // round(size / usual)] = True
    return new


STAYS = 0.7
"""Share of samples with a change below which a reading often stays."""


def sticks(y: Array) -> bool:
    """Whether a reading (n,) shows hysteresis: it often stays, and then moves by more than one quantisation step."""
    moves = np.abs(np.diff(y))
    moved = moves[moves > 0]
    often = len(moved) > 0 and len(moved) < STAYS * len(moves)
    return bool(often and fresh(y).all() and np.quantile(moved, 0.25) > 1.5 * step_of(y))


def between_new(t: Array, y: Array) -> tuple[Array, float]:
    """The channel interpolated between its new values, and the interval of these [s]; 0 where all are new."""
    new = fresh(y)
    if new.all():
        return y, 0.0
    return np.interp(t, t[new], y[new]), float(np.median(np.diff(t[new])))


def unresolved(y: Array, step: float) -> float:
    """Largest error of the mean of samples at rest `y` (n,) that are quantised in steps of `step` [as y].

    Small noise reaches the next step now and then: with the variance v [steps^2] of the readings the error is
    sqrt(1/4 - v). Larger noise leaves exp(-2 pi^2 (v - 1/12)) / pi (the characteristic function of Gaussian noise at
    one turn per step: Widrow), up to 1.31 times that where v depends on the place between two steps.
    """
    if not 0 < step < np.inf or len(y) < FEWEST:
        return 0.0
    v = 0.5 * float(np.mean(np.diff(y) ** 2)) / step**2
    return step * max(sqrt(max(0.0, 0.25 - v)), 1.31 / pi * float(np.exp(-2 * pi**2 * max(0.0, v - 1 / 12))))


def rounded(y: Array, step: float, channel: int = 0) -> Array:
    """`y` (n,) and `PLACES` quantised versions of it with different offset and size of the steps, (1 + PLACES, n).

    Unlike noise, quantisation does not average out over cycles, which all meet the same steps. `channel` is the seed.
    """
    swing = float(np.ptp(y))
    if not FINE * swing < step < np.inf:
        return np.tile(y, (1 + PLACES, 1))
    by, longer = np.random.default_rng(channel).random((2, PLACES, 1))
    steps = step * (1 + 2 * longer * step / swing)
    return np.vstack([y, steps * (np.round(y / steps + by) - by)])


def on_time(run: RunData, trial: TrialData, name: str) -> Array:
    """A channel shifted earlier by the lag of its sensor, which is exact on ramps; NaN where it is not recorded."""
    values = trial.channels.get(name, np.full(trial.t.shape, np.nan))
    lag = lag_of(run, name)
    return np.interp(trial.t + lag, trial.t, values) if lag else values


def least_squares(design: Array, values: Array) -> Array:
    """Least-squares coefficients of the columns of `design`, shape (n, p), for `values`, shape (n,) or (n, m).

    By the normal equations, in a fifth of the time of a decomposition: for columns that are far from parallel.
    """
    try:
        return np.asarray(np.linalg.solve(design.T @ design, design.T @ values), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(design, values, rcond=None)[0])


def on_time_run(run: RunData, *names: str) -> RunData:
    """The run with these channels corrected by `on_time`."""
    late = [name for name in names if name in run.channels and run.channels[name].sensor_lag > 0]

    def moved(trial: TrialData) -> TrialData:
        return replace(trial, channels={**trial.channels, **{name: on_time(run, trial, name) for name in late}})

    return replace(run, trials=tuple(moved(one) if len(one.t) else one for one in run.trials)) if late else run


def three_parameter(t: Array, signals: Array, frequency: float) -> tuple[Array, NDArray[np.complex128]]:
    """Means, shape (m,), and complex amplitudes A with Re(A exp(j 2 pi f t)), shape (m,), of `signals`, shape (n, m).

    Least squares of c + a cos + b sin at the known frequency (IEEE 1057, three-parameter sine fit).
    """
    angle = 2 * pi * frequency * t
    fitted = least_squares(np.column_stack([np.ones_like(t), np.cos(angle), np.sin(angle)]), signals)
    return np.asarray(fitted[0]), np.asarray(fitted[1] - 1j * fitted[2], dtype=np.complex128)


PARTS = 40
"""Most parts of a trial whose means are compared, ..."""
LEAST_SAMPLES = 10
"""... and fewest samples of a part, so that noise averages out and motion does not."""
MOST_NAMES = 3
"""Most trials that are named in a finding."""
SPREADS = 3.0
"""Standard deviations of the noise above which a change counts."""
LEAST_MOTION = {"displacement": 20e-6}
"""Channel -> smallest change that counts [SI]: the repeatability of a gauge."""
DRIVEN = ("frequency", "speed", "step", "amplitude", "lower", "upper", "setpoint")
"""Entries of an operating point that show that the free end is driven."""
Holds = Callable[[float, float], bool]
"""Returns whether the muscle at a pressure [Pa] does not lift a load [N]."""


def never(_pressure: float, _load: float) -> bool:
    """`Holds` of an unknown muscle: False, it is expected to lift every load."""
    return False


def not_moved(channel: str, trial: TrialData, holds: Holds) -> bool:
    """Whether `channel` should have changed in the trial and did not.

    No change is expected without pressure, or under a load that the muscle `holds`, unless the free end is driven.
    """
    pressure, load = trial.point.get("pressure"), trial.point.get("load")
    if pressure is None or any(name in trial.point for name in DRIVEN):
        return nothing_moved(trial, channel)
    held = load is not None and holds(pressure, load)
    return not held and (pressure > 0 or "from" in trial.point) and nothing_moved(trial, channel)


def with_motion(analysis: Analysis, runs: Sequence[RunData], channel: str) -> Analysis:
    """The analysis with a doubt where `channel` did not change in trials that lift their load by the F_ce found."""
    found = {e.at["pressure"]: e.value for e in analysis.estimates if e.symbol == "F_ce" and "pressure" in e.at}
    known = sorted((pressure, value) for pressure, value in found.items() if value is not None)
    friction = max((abs(e.value) for e in analysis.estimates if e.symbol == "F_c" and e.value is not None), default=0.0)

    def holds(pressure: float, load: float) -> bool:
        pulls = [value for at, value in known if at >= pressure - 1.0]  # F_ce grows with the pressure
        return bool(pulls) and min(pulls) - load <= 2 * friction

    trials = [trial for run in runs for trial in run.trials if trial.status == "finished" and not trial.again]
    still = [trial.name for trial in trials if not_moved(channel, trial, holds)]
    if not still:
        return analysis
    names = ", ".join(still[:MOST_NAMES]) + (" ..." if len(still) > MOST_NAMES else "")
    text = (
        f"nothing moved in {len(still)} of {len(trials)} trials ({names}): {channel} changed by less than its "
        "noise; look at its gauge, at the hose to the muscle and at the load"
    )
    return replace(analysis, findings=(*analysis.findings, Finding("doubt", text)))


def nothing_moved(trial: TrialData, channel: str) -> bool:
    """Whether a channel of a trial changed by less than its noise; False with too few samples.

    The change is the range of the means over parts of the trial; the noise is the scatter of neighbouring samples.
    """
    if channel not in trial.channels:
        return False
    y = trial.channels[channel][trial.usable]
    y = y[np.isfinite(y)]
    if len(y) < 2 * LEAST_SAMPLES:
        return False
    edges = np.linspace(0, len(y), min(PARTS, len(y) // LEAST_SAMPLES) + 1).astype(np.intp)
    means = np.add.reduceat(y, edges[:-1]) / np.diff(edges)
    noise = float(np.diff(y).std()) / np.sqrt(2.0)
    return bool(np.ptp(means) <= max(SPREADS * noise, LEAST_MOTION.get(channel, 0.0)))


SEEN = 6.0
"""Standard deviations of the baseline above which a change counts."""
LEAST = {"pressure": 200.0, "displacement": 10e-6}
"""Channel -> least change that counts [SI]."""
RISE = 4.0
"""Multiple of the threshold up to which samples are used for the line back to the baseline."""
KINDS = ("command-to-pressure", "pressure-to-motion", "command-to-motion")


def onset(t: Array, y: Array, command: float, least: float) -> float | None:
    """Time at which `y` leaves its level before `command` [s]; None where it does not, or with too few samples before.

    The threshold is `SEEN` times the noise before the command, at least `least`. The line through the first samples
    above it is extrapolated back to the level; where that is well before the last sample at rest, y has jumped between
    two samples.
    """
    before = y[t < command - 1e-9]
    if len(before) < 8:
        return None
    level = float(np.mean(before))
    threshold = max(least, SEEN * noise_of(before))
    rise = y - level
    above = np.flatnonzero((rise > threshold) & (t >= command - 1e-9))
    held = above[:-2][(above[2:] - above[:-2]) == 2]
    if not len(held):
        return None
    first = int(held[0])
    beyond = np.flatnonzero(rise[first:] > RISE * threshold)
    last = first + max(2, int(beyond[0]) if len(beyond) else 2)
    part = slice(first, last + 1)
    since, risen = t[part] - t[first], rise[part]
    off = since - since.mean()
    slope = float(off @ risen / (off @ off))
    height = float(risen.mean()) - slope * float(since.mean())
    still = np.flatnonzero(rise[:first] <= threshold / SEEN)
    reached, earliest = float(t[first]), float(t[still[-1]]) if len(still) else command
    at = reached - height / slope if slope > 0 else command
    if at >= earliest - float(t[first] - t[first - 1]):
        return min(reached, max(earliest, at))
    return reached if rise[first] > RISE * threshold else earliest


def dead_times(t: Array, channels: Mapping[str, Array], usable: NDArray[np.bool_], command: float) -> dict[str, float]:
    """Times of `KINDS` [s] for a contraction commanded at `command` [s]; those that cannot be found are left out."""
    near = usable & (t < command + 2.0)
    pressure, motion = (onset(t[near], channels[name][near], command, least) for name, least in LEAST.items())
    result = {}
    if pressure is not None:
        result["command-to-pressure"] = pressure - command
    if motion is not None:
        result["command-to-motion"] = motion - command
        if pressure is not None:
            result["pressure-to-motion"] = motion - pressure
    return result


BLOCKS = 20
"""Most parts of a hold whose means are used."""
FEWEST = 5
TIMES = np.geomspace(0.15, 4.0, 10)
"""Time constants that are fitted, over the length of the hold; slower motion looks like a drift."""
ALIKE = 4.0
"""Variances by which the sum of squares of a time constant may exceed the least (95 %)."""
MORE = 1.2
"""Factor on the change still to come, because the motion may not be a single exponential."""
SURE = 5.0
"""Standard deviations above which a motion is significant."""


@dataclass(frozen=True)
class Left:
    """Change of a signal still to come after the mean of its end, by a fitted exponential [as the signal]."""

    size: float
    """Best estimate."""
    most: float
    """Upper bound of its absolute value (95 %)."""
    seen: bool
    """Whether the motion is significant."""


@dataclass(frozen=True, eq=False)
class Held:
    """Means of a signal over parts of a hold, shape (parts,)."""

    t: Array
    """Time since the first sample [s]."""
    y: Array
    late: Array
    """1 for parts at the end, whose mean counts, else 0."""

    @classmethod
    def of(cls, t: Array, y: Array, since: float) -> Held:
        """Means of samples `y` (n,) at `t` (n,) [s]; those from the time `since` on count as the end."""
        parts = np.array_split(np.arange(len(t)), max(1, min(BLOCKS, len(t) // 3)))
        at, mean = (np.array([float(values[part].mean()) for part in parts]) for values in (t - t[0], y))
        return cls(at, mean, np.where(at >= min(since - t[0], at[-1]), 1.0, 0.0))


def left(holds: Sequence[Held]) -> Left:
    """Change still to come after the ends of similar holds, from the mean of these.

    An exponential with each of `TIMES` is fitted; those with nearly the least residual bound the result. With fewer
    than `FEWEST` parts the range of the means is the bound.
    """
    count = min(len(one.t) for one in holds)
    at, mean, late = np.mean([[one.t[:count], one.y[:count], one.late[:count]] for one in holds], axis=0)
    mean -= mean.mean()
    if count < FEWEST or not late.any():
        return Left(0.0, float(np.ptp(mean)), seen=False)
    shapes = np.exp(-at / (float(at[-1]) * TIMES[:, None]))
    off = shapes - shapes.mean(axis=1, keepdims=True)
    power = np.sum(off**2, axis=1)
    size = off @ mean / power
    cost = np.sum((mean - size[:, None] * off) ** 2, axis=1)
    best, beyond = int(np.argmin(cost)), shapes @ late / late.sum()
    variance = float(cost[best]) / (count - 3)
    fits = cost <= cost[best] + ALIKE * variance
    most = MORE * beyond * (np.abs(size) + 2 * np.sqrt(variance / power))
    seen = abs(float(size[best])) * sqrt(float(power[best])) > SURE * sqrt(variance)
    return Left(-float(size[best] * beyond[best]), float(most[fits].max()), seen)
